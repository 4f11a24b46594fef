# SPDX-License-Identifier: Apache-2.0
"""Area and slack of single blocks in standard cells. Each block is synthesized alone and flattened.

The cells are NanGate 45 nm at the typical corner (1.1 V, 25 degrees C). OpenSTA gives the slack
between registers, without wires and with an ideal clock.
"""

import json
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from attrs import frozen

from ..hdl.export import units_files
from ..hdl.front_end_views import POLYPHASE, View
from ..hdl.unit import Unit
from ..model.shared.folders import build_root
from ..tools.build import ToolchainError
from ..tools.wheels import run_program, yosys_once
from .yosys import LIBERTY, bound, cells_script, library_files

FLOP, LATCH, GATE = (re.compile(kinds) for kinds in (r"S?DFF", r"DL[HL]|TLAT", "CLKGATE"))
MACRO = re.compile(r"(?:\$paramod\S*\\)?(coincid_(?:phases|window|delay|mutex))\b")
NETLIST = "netlist.v"
LONGEST_PATHS = """\
puts "FLOPS"
report_checks -path_delay max -to [all_registers -edge_triggered -data_pins]
puts "LATCHES"
set latches [all_registers -level_sensitive -data_pins]
if {[llength $latches]} {report_checks -path_delay max -to $latches}
puts "OPENING"
report_checks -path_delay max -path_group **clock_gating_default**
puts "ENABLES"
set enables [get_pins -quiet -hierarchical */E]
if {[llength $enables]} {report_checks -path_delay max -to $enables}
"""


@frozen
class Mapped:
    """A flattened block in standard cells. folder: contains the netlist. cells, macros: type ->
    number.
    """

    name: str
    folder: Path
    cells: Mapping[str, int]
    macros: Mapping[str, int]
    area_um2: float

    def count(self, kind: re.Pattern[str]) -> int:
        """Return the number of cells whose type begins with a pattern."""
        return sum(n for name, n in self.cells.items() if kind.match(name))


def map_block(
    unit: Unit, view: View = POLYPHASE, changed: Mapping[str, str] | None = None, gated: bool = True
) -> Mapped:
    """Return a block in standard cells. It is made once for each state of its Verilog.

    Memories consist of latches, and macros are black boxes.
    changed: files that replace or supplement those of the block, name -> text. gated: as in
    `cells_script`. Raises `ToolchainError`.
    """
    files = bound(units_files([unit], cells=True), gated)
    files |= {
        path.name: path.read_text(encoding="utf-8") for path in (*view.cells, *view.macros)
    } | dict(changed or {})
    script = [
        f"read_liberty -lib {LIBERTY}",
        f"read_verilog -sv {' '.join(files)}",
        *cells_script(unit.unit_name, flatten=True, gated=gated),
        f"tee -q -o stat.json stat -json -liberty {LIBERTY}",
        f"write_verilog -simple-lhs -noexpr -noattr {NETLIST}",
    ]
    folder = yosys_once(build_root() / "mapped" / unit.unit_name, files | library_files(), script)
    statistics = json.loads((folder / "stat.json").read_text(encoding="utf-8"))["modules"][
        f"\\{unit.unit_name}"
    ]
    cells, macros = Counter[str](), Counter[str]()
    for kind, number in statistics["num_cells_by_type"].items():
        macro = MACRO.match(kind)
        if macro:
            macros[macro[1]] += number
        elif not kind.startswith("$scope"):
            cells[kind] += number
    return Mapped(unit.unit_name, folder, dict(cells), dict(macros), float(statistics["area"]))


def slacks_ns(folder: Path, block: str, clock_ns: float) -> dict[str, float]:
    """Return the least slacks between registers of a block by the kind of end: `FLOPS`,
    `LATCHES`, `OPENING`, `ENABLES`.

    OpenSTA reads the netlist in `folder`; wires are not included. A latch may take its data
    until it closes. The lines that open latches must settle by mid-cycle, and the enables of
    clock gates by the end of the cycle. The clock is ideal, also behind a clock gate.
    """
    timed = f"{block}.timed.v"
    (folder / timed).write_text(
        without_parameters((folder / NETLIST).read_text(encoding="utf-8")), encoding="utf-8"
    )
    report = timing_report(folder, block, timed, clock_ns, LONGEST_PATHS)
    if found := least_slacks_ns(report):
        return found
    raise ToolchainError(f"sta: no path in {block}")


def without_parameters(verilog: str) -> str:
    """Return a netlist for OpenSTA, which does not know parameters."""
    return re.sub(r"#\(\n(?:    \..*\n)*  \) ", "", verilog)


def timing_report(folder: Path, block: str, netlist: str, clock_ns: float, commands: str) -> str:
    """Return the answer of OpenSTA to some commands about a netlist in `folder`, where also the
    cells are.
    """
    script = f"""\
read_liberty {LIBERTY}
read_verilog {netlist}
link_design {block}
create_clock -name clk -period {clock_ns:g} [get_ports clk]
{commands}"""
    (folder / f"{block}.tcl").write_text(script, encoding="utf-8")
    report = run_program(["sta", "-exit", f"{block}.tcl"], folder, "sta")
    if errors := [line for line in report.splitlines() if line.startswith("Error")]:
        raise ToolchainError(f"sta: {errors[0]}")
    return report


def least_slacks_ns(report: str) -> dict[str, float]:
    """Return kind of end -> least slack from the report of `LONGEST_PATHS`, for all kinds that
    have a path.
    """
    _, *parts = re.split(r"^(FLOPS|LATCHES|OPENING|ENABLES)$", report, flags=re.MULTILINE)
    slacks = {}
    for kind, part in zip(parts[::2], parts[1::2], strict=True):
        found = [float(n) for n in re.findall(r"(-?[\d.]+) +slack", part)]
        lent = re.findall(r"^(?:max|actual) time borrow +(-?[\d.]+)", part, re.MULTILINE)
        if kind == "LATCHES" and len(lent) == 2:
            found = [float(lent[0]) - float(lent[1])]
        if found:
            slacks[kind] = min(found)
    return slacks
