# SPDX-License-Identifier: Apache-2.0
"""System packages (Debian): installed if that is allowed; otherwise an error names the command
that installs them.

This file uses only the standard library, because the set-up runs it as a script before anything
is installed: `python3 tools/system.py PACKAGE...`.
"""

import fcntl
import os
import subprocess
import sys
from shutil import which


class MissingPackagesError(OSError):
    """Packages are missing and cannot be installed from here; the message contains the command
    that installs them.
    """


def system_packages(*names: str) -> None:
    """Install the Debian packages `names`: as root, or by a `sudo` that asks for no password.

    Raises `MissingPackagesError` if neither is possible, if there is no apt-get, or if apt-get
    fails. Its message is one line with the command to run.
    """
    root = os.geteuid() == 0
    sudo = "sudo " if which("sudo") and not root else ""
    command = f"{sudo}apt-get update && {sudo}apt-get install -y {' '.join(names)}"
    missing = MissingPackagesError(
        f"missing system packages; run{'' if root or sudo else ' as root'}: {command}"
    )
    prefix = [] if root else ["sudo", "-n"]
    if not which("apt-get") or not (root or sudo) or _run(*prefix, "true").returncode:
        raise missing
    print(f"installing system packages: {' '.join(names)}", file=sys.stderr, flush=True)
    apt = [*prefix, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "-qq"]
    with open(__file__, encoding="utf-8") as lock:  # apt-get does not wait for its list lock
        fcntl.flock(lock, fcntl.LOCK_EX)
        _run(*apt, "update")  # its failure matters only if the packages then cannot be found
        done = _run(
            *apt,
            "-o",
            "DPkg::Lock::Timeout=600",
            "install",
            "-y",
            "--no-install-recommends",
            *names,
        )
    if done.returncode:
        print(done.stdout, file=sys.stderr)
        raise missing


def _run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        encoding="utf-8",
    )


if __name__ == "__main__":
    try:
        system_packages(*sys.argv[1:])
    except MissingPackagesError as error:
        sys.exit(str(error))
