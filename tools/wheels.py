# SPDX-License-Identifier: Apache-2.0
"""Programs from PyPI wheels, Yosys first of all."""

import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from ..model.shared.interrupts import program
from ..model.shared.sources import digest
from .build import ToolchainError, build_once

TAIL_LINES = 20
YOSYS = "pyosys"
YOSYS_PROGRAM = Path(__file__).with_name("yosys_program.py")
YOSYS_SCRIPT, YOSYS_LOG = "script.ys", "yosys.log"  # in the folder in which Yosys runs
EXTRAS, OTHER = {YOSYS: "rtl"}, "flow"  # extras of pyproject.toml that install the wheels


def run_yosys(folder: Path, *lines: str) -> None:
    """Run the lines of a Yosys script in `folder`. Raises `ToolchainError` with the end of the
    log if Yosys fails or is missing.
    """
    run_yosys_scripts(folder, {YOSYS_SCRIPT: lines})


def run_yosys_scripts(folder: Path, scripts: Mapping[str, Sequence[str]]) -> None:
    """Run several Yosys scripts (name -> lines) in `folder`, each in a fresh Yosys, and some at the
    same time. Raises `ToolchainError` as `run_yosys` does.
    """
    wheel_folder(YOSYS)
    for name, lines in scripts.items():
        (folder / name).write_text("\n".join([*lines, ""]), encoding="utf-8")
    command = [*yosys_command(), "-q", "-l", YOSYS_LOG, *scripts]
    try:
        run_program(command, folder, YOSYS)
    except ToolchainError as error:
        log = (folder / YOSYS_LOG).read_text(encoding="utf-8", errors="replace").splitlines()
        raise ToolchainError("\n".join([str(error), *log[-TAIL_LINES:]])) from None


def yosys_command() -> list[str]:
    """Return the command that starts Yosys, without its options, which `yosys_program.py` names."""
    return [sys.executable, "-P", str(YOSYS_PROGRAM)]


def yosys_once(
    folder: Path,
    files: Mapping[str, str],
    script: Sequence[str],
    state: Sequence[str] = (),
    then: Callable[[Path], object] = lambda folder: None,
) -> Path:
    """Return a folder with `files` (name -> text) and all that a Yosys script writes beside
    them. Raises `ToolchainError`.

    It is made once for every state of files and script, beside `folder` and with its name and a
    digest. then: called with the folder before the folder counts as made. state: texts that
    change whenever `then` does something else.
    """

    def make(scratch: Path) -> None:
        for name, text in files.items():
            (scratch / name).write_text(text, encoding="utf-8")
        run_yosys(scratch, *script)
        then(scratch)

    wheel_folder(YOSYS)
    key = digest(
        version(YOSYS), *script, *state, *(part for item in sorted(files.items()) for part in item)
    )
    return build_once(folder.with_name(f"{folder.name}-{key}"), make)


def wheel_folder(package: str) -> Path:
    """Return the folder of a wheel's files. Raises `ToolchainError` if it is missing."""
    found = find_spec(package)
    if found is None or found.origin is None:
        raise ToolchainError(
            f"{package.replace('_', '-')} is not installed; run: pip install 'coincid[{EXTRAS.get(package, OTHER)}]'"
        )
    return Path(found.origin).parent


def run_wheel(package: str, function: str, arguments: Sequence[str], folder: Path) -> str:
    """Run a program of a YoWASP wheel in `folder` and return its output."""
    wheel_folder(package)
    call = f"import sys; from {package} import {function}; sys.exit({function}(sys.argv[1:]))"
    return run_program([sys.executable, "-c", call, *arguments], folder, package)


def run_program(command: Sequence[str], folder: Path, name: str) -> str:
    """Run a command in `folder` and return its output. Raises `ToolchainError` with the end of
    the output if it fails.
    """
    log = {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.STDOUT,
        "text": True,
        "errors": "replace",
    }
    with program(command, cwd=folder, **log) as process:
        output: str = process.communicate()[0]
    if process.returncode:
        raise ToolchainError(
            "\n".join([f"{name} failed in {folder}", *output.splitlines()[-TAIL_LINES:]])
        )
    return output
