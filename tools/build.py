# SPDX-License-Identifier: Apache-2.0
"""Builds that are made once, and the programs that make them; errors say in one line what to do."""

import errno
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from filelock import FileLock

from ..model.shared.errors import InputError
from ..model.shared.interrupts import program
from .system import MissingPackagesError, system_packages

LOG_TAIL_LINES = 40
NO_SPACE = os.strerror(errno.ENOSPC)
FULL_BELOW_BYTES = 1 << 20  # less than any compiler's output
# Settings of the calling make or shell must not change a build, because its key does not include
# them.
COMPILER_VARIABLES = {
    "MAKEFLAGS",
    "MFLAGS",
    "MAKELEVEL",
    "CXXFLAGS",
    "CPPFLAGS",
    "LDFLAGS",
    "LDLIBS",
    "VERILATOR_ROOT",
}

Compile: TypeAlias = Callable[[Sequence[str]], None]


class ToolchainError(InputError):
    """A tool or resource is missing, or a design does not compile; the message tells in one line
    what to do.
    """


def build_once(directory: Path, make: Callable[[Path], None]) -> Path:
    """Return `directory`; `make(scratch)` makes it unless it exists.

    `make` fills a new folder beside it, which is then renamed: a failed or interrupted build
    leaves nothing that could be taken for a finished one. Processes that need the same folder
    wait for the first. Raises `ToolchainError` if the file system refuses.
    """
    if directory.is_dir():
        return directory
    try:
        directory.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(f"{directory}.lock"):
            if not directory.is_dir():
                for leftover in directory.parent.glob(f"{directory.name}.part*"):
                    shutil.rmtree(leftover, ignore_errors=True)
                scratch = Path(
                    tempfile.mkdtemp(prefix=f"{directory.name}.part", dir=directory.parent)
                )
                try:
                    make(scratch)
                    scratch.chmod(0o755)
                    scratch.rename(directory)
                finally:
                    shutil.rmtree(scratch, ignore_errors=True)
    except OSError as error:
        raise ToolchainError(
            f"build directory {directory.parent}: {_reason(error)}; COINCID_BUILD names another"
        ) from None
    return directory


def compile_once(directory: Path, make: Callable[[Path, Compile], None]) -> Path:
    """As `build_once`, for `make(scratch, run)`, which compiles: `run(command)` runs a compiler
    as `compile_in` does.

    The log of the last build stays beside the directory.
    """
    log = directory.with_name(f"{directory.name}.log")

    def logged(scratch: Path) -> None:
        log.unlink(missing_ok=True)
        make(scratch, lambda command: compile_in(scratch, log, command))

    return build_once(directory, logged)


def _reason(error: OSError) -> str:
    if isinstance(error, shutil.Error):  # for a tree: a list of (from, to, why)
        return error.args[0][0][2]
    name = error.filename2 or error.filename
    return f"{error.strerror}{f': {name}' if name else ''}"


def execute(
    command: Sequence[str],
    cwd: Path,
    log: Path,
    environment: Mapping[str, str],
    echo: bool | Callable[[str], None] = False,
) -> int:
    """Run `command`, append its output to `log` (and to `echo`), and return its exit code.
    Exceptions end it.
    """
    show = sys.stdout.write if echo is True else echo
    with log.open("a", buffering=1, encoding="utf-8") as output:
        with program(
            command,
            cwd=cwd,
            env={**environment, "PYTHONUNBUFFERED": "1"} if show else environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE if show else output,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            encoding="utf-8",
        ) as process:
            if show and process.stdout:
                with process.stdout as told:
                    for line in told:
                        output.write(line)
                        show(line)
            return process.wait()


def compile_in(cwd: Path, log: Path, command: Sequence[str]) -> None:
    """Run a compiler in `cwd`, and append its output to `log`. Raises `ToolchainError` with the
    end of the log.
    """
    environment = {
        name: value for name, value in os.environ.items() if name not in COMPILER_VARIABLES
    }
    if execute(command, cwd, log, environment):
        program, places = Path(command[0]).name, f"{log.parent} or {tempfile.gettempdir()}"
        # On a full disk, the log itself may be cut off.
        if (
            NO_SPACE in log.read_text(errors="replace", encoding="utf-8")
            or shutil.disk_usage(log.parent).free < FULL_BELOW_BYTES
        ):
            raise ToolchainError(
                f"{program}: {NO_SPACE}, in {places}; COINCID_BUILD and TMPDIR name others"
            )
        raise ToolchainError(f"{program} failed{tail(log)}")


def tail(log: Path) -> str:
    lines = log.read_text(errors="replace", encoding="utf-8").splitlines()
    return "\n".join(["", *lines[-LOG_TAIL_LINES:], f"the whole log: {log}"])


def install(*packages: str) -> None:
    try:
        system_packages(*packages)
    except MissingPackagesError as error:
        raise ToolchainError(str(error)) from None


def require_programs(packages: Mapping[str, str]) -> None:
    """Ensure that the programs in the keys exist; the values are the Debian packages that
    contain them.
    """
    if missing := [package for program, package in packages.items() if not shutil.which(program)]:
        install(*missing)
    if lost := [program for program in packages if not shutil.which(program)]:
        raise ToolchainError(f"{lost[0]}: not on PATH, though its package is installed")
