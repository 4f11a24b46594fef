# SPDX-License-Identifier: Apache-2.0
"""Installs the packages of lock files into this Python's environment: with uv if it is there,
otherwise with pip.

uv looks where pip's settings (PIP_FIND_LINKS, PIP_NO_INDEX, PIP_INDEX_URL, pip.conf) tell pip to
look. This file uses only the standard library, because the set-up runs it as a script before
anything is installed: `python tools/locked.py LOCK...` with the Python of the environment, and
the path of uv in COINCID_UV and the words of pip's command, one per line, in COINCID_PIP.
"""

import ast
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TextIO
from urllib.parse import unquote, urlparse

LOG = Path(sys.prefix) / "install.log"
PIP_OPTIONS = ("--no-input", "--disable-pip-version-check", "--retries", "1", "--timeout", "15")
PLACES = {  # pip's settings, by the names of its variables without PIP_: uv's options
    "FIND_LINKS": "--find-links",
    "INDEX_URL": "--default-index",
    "EXTRA_INDEX_URL": "--index",
}
NAMED_MAX = 3  # packages that a message names


def install(locks: Sequence[str]) -> None:
    """Install the packages of lock files, without what they ask for. Raises `SystemExit` with
    what to do if that fails.
    """
    files = [part for lock in locks for part in ("-r", lock)]
    pip = os.environ["COINCID_PIP"].splitlines()
    uv = os.environ.get("COINCID_UV")
    with LOG.open("w", encoding="utf-8") as log:
        if uv and _run([*uv_command(uv, uv_options(_pip_settings(pip))), "--no-deps", *files], log):
            return
        # Python compiles the modules that it imports, a sixth of all.
        if _run([*pip, "install", *PIP_OPTIONS, "--no-deps", "--no-compile", *files], log):
            return
    sys.exit(_what_to_do(locks))


def uv_command(uv: str, options: Sequence[str]) -> list[str]:
    return [uv, "--quiet", "pip", "install", "--python", sys.executable, *options]


def uv_options(settings: str) -> list[str]:
    """Return uv's options for the output of `pip config list`. Folders that do not exist are
    left out, as pip does.
    """
    options = []
    for name, text in re.findall(r"^[^.\n]+\.([\w-]+)=(.*)$", settings, re.MULTILINE):
        value = str(ast.literal_eval(text))
        variable = name.upper().replace("-", "_")
        if variable in PLACES:
            for place in filter(_may_exist, value.split()):
                options += [PLACES[variable], place]
        elif variable == "NO_INDEX" and value.lower() in ("1", "true", "yes", "on"):
            options.append("--no-index")
    return options


def missing(locks: Sequence[str]) -> list[str]:
    """Return the lines of lock files whose packages are not installed in that version."""
    lines = [
        line.strip()
        for lock in locks
        for line in Path(lock).read_text(encoding="utf-8").splitlines()
    ]
    return [
        line
        for line in lines
        if "==" in line and not line.startswith("#") and not _is_installed(line)
    ]


def _is_installed(line: str) -> bool:
    name, _, wanted = line.partition("==")
    try:
        return version(name) == wanted
    except PackageNotFoundError:
        return False


def _may_exist(place: str) -> bool:
    """Return whether a place of packages is on the network, or a folder that is there."""
    parts = urlparse(place)
    return Path(unquote(parts.path)).exists() if parts.scheme in ("", "file") else True


def _pip_settings(pip: Sequence[str]) -> str:
    command = [*pip, "config", "list"]
    return subprocess.run(
        command, capture_output=True, text=True, encoding="utf-8", check=False
    ).stdout


def _run(command: Sequence[str], log: TextIO) -> bool:
    print("$", shlex.join(command), file=log, flush=True)
    return (
        subprocess.run(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, check=False
        ).returncode
        == 0
    )


def _what_to_do(locks: Sequence[str]) -> str:
    lost = missing(locks)
    more = f" and {len(lost) - NAMED_MAX} more" if len(lost) > NAMED_MAX else ""
    files = " ".join(f"-r {lock}" for lock in locks)
    return (
        f"missing Python packages: {', '.join(lost[:NAMED_MAX])}{more}; {LOG} says why; without a network, make wheels of them "
        f"elsewhere (python3 -m pip wheel --no-deps -w FOLDER {files}), and set PIP_NO_INDEX=1 PIP_FIND_LINKS=FOLDER"
    )


if __name__ == "__main__":
    install(sys.argv[1:])
