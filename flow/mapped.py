# SPDX-License-Identifier: Apache-2.0
"""Blocks in standard cells: one block with all its parts, flattened, as in a synthesis of that block alone.

NanGate 45 nm, typical corner (1.1 V, 25 degrees C). Slack is from OpenSTA, between registers, without wires and with an
ideal clock.
"""

import json
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from attrs import frozen

from ..hdl.export import units_files
from ..hdl.unit import Unit
from ..hdl.views import POLYPHASE, View
from ..model.shared.folders import build_root
from ..model.shared.sources import digest
from ..tools.build import ToolchainError, build_once
from ..tools.wheels import run_program, run_yosys
from .yosys import CELLS_VERSION, LIBERTY, cells_script, put_cells

FLOP, LATCH = re.compile(r"S?DFF"), re.compile(r"DL[HL]|TLAT")
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
"""


@frozen
class Mapped:
    """A flattened block in standard cells. cells, macros: type -> number; `folder` contains the netlist."""

    name: str
    folder: Path
    cells: Mapping[str, int]
    macros: Mapping[str, int]
    area_um2: float

    def count(self, kind: re.Pattern[str]) -> int:
        """Return the number of cells whose type begins with a pattern."""
        return sum(n for name, n in self.cells.items() if kind.match(name))


def map_block(unit: Unit, view: View = POLYPHASE, changed: Mapping[str, str] | None = None) -> Mapped:
    """Map a block to standard cells, once for the state of its Verilog; memories are latches, macros are black boxes.

    changed: file name -> text that replaces or supplements the block's own files. Raises `ToolchainError`.
    """
    files = units_files([unit], latches=True)
    files |= {path.name: path.read_text() for path in (*view.cells, *view.macros)} | dict(changed or {})
    script = "\n".join(
        [
            f"read_verilog -sv {' '.join(files)}",
            *cells_script(unit.unit_name, flatten=True),
            f"tee -q -o stat.json stat -json -liberty {LIBERTY}",
            f"write_verilog -simple-lhs -noexpr -noattr {NETLIST}",
            "",
        ]
    )

    def make(folder: Path) -> None:
        for name, text in files.items():
            (folder / name).write_text(text)
        put_cells(folder)
        run_yosys(folder, script)

    key = digest(script, CELLS_VERSION, *(part for item in sorted(files.items()) for part in item))
    folder = build_once(build_root() / "mapped" / f"{unit.unit_name}-{key}", make)
    statistics = json.loads((folder / "stat.json").read_text())["modules"][f"\\{unit.unit_name}"]
    cells, macros = Counter[str](), Counter[str]()
    for kind, number in statistics["num_cells_by_type"].items():
        macro = MACRO.match(kind)
        if macro:
            macros[macro[1]] += number
        elif not kind.startswith("$scope"):
            cells[kind] += number
    return Mapped(unit.unit_name, folder, dict(cells), dict(macros), float(statistics["area"]))


def slack_ns(folder: Path, block: str, clock_ns: float) -> float:
    """Return the least slack between registers of a block, by OpenSTA without wires; `folder` has the netlist.

    A latch may take its data until it closes. The lines that open latches must be at rest by mid-cycle.
    """
    # OpenSTA knows no parameters.
    (folder / f"{block}.timed.v").write_text(re.sub(r"#\(\n(?:    \..*\n)*  \) ", "", (folder / NETLIST).read_text()))
    script = f"""\
read_liberty {LIBERTY}
read_verilog {block}.timed.v
link_design {block}
create_clock -name clk -period {clock_ns} [get_ports clk]
{LONGEST_PATHS}"""
    (folder / f"{block}.tcl").write_text(script)
    report = run_program(["sta", "-exit", f"{block}.tcl"], folder, "sta")
    errors = [line for line in report.splitlines() if line.startswith("Error")]
    found = least_slack_ns(report)
    if errors or found is None:
        raise ToolchainError(f"sta: {(errors or [f'no path in {block}'])[0]}")
    return found


def least_slack_ns(report: str) -> float | None:
    """Return the least slack of what `LONGEST_PATHS` reported; None: there is no path."""
    _, *parts = re.split(r"^(?:FLOPS|LATCHES|OPENING)$", report, flags=re.MULTILINE)
    found = [re.findall(r"(-?[\d.]+) +slack", part) for part in parts]
    if not found[0]:
        return None
    slacks = [float(n) for n in found[0] + found[2]]
    lent = re.findall(r"^(?:max|actual) time borrow +(-?[\d.]+)", parts[1], re.MULTILINE)
    slacks += [float(lent[0]) - float(lent[1])] if len(lent) == 2 else [float(n) for n in found[1]]
    return min(slacks)
