# SPDX-License-Identifier: Apache-2.0
"""Layout of a minigroup: from Verilog to a routed GDS, which is checked and timed with its wires.

The standard cells are NanGate's for 45 nm. Coriolis places and routes, KLayout checks, and
OpenSTA computes the timing. Coriolis runs in a separate process with a time limit. If it leaves
nets open, the flow tries the next of `ATTEMPTS`, and fails after the last one.
"""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from attrs import asdict, astuple, frozen

from ...hdl.export import units_files
from ...hdl.front_end_views import POLYPHASE, View
from ...hdl.unit import Unit
from ...model.shared.folders import build_root
from ...tools.build import ToolchainError
from ...tools.wheels import TAIL_LINES, yosys_once
from ..liberty import read_cells, supply_v
from ..mapped import LONGEST_PATHS, least_slacks_ns, timing_report
from ..yosys import CLOCK_BUFFER, LIBERTY, bound, cells_script, library_files
from . import drawn, wires
from .drawn import Placed
from .pins import Strip, cell_widths_um, strips
from .tools import layout_cells

LEFS, GDS = ("rtk-tech.lef", "stdcells.lef"), "stdcells.gds"  # of `cells_folder`
BLIF = "mapped.blif"
VERILOG, SPEF, SDF, FINAL = "routed.v", "routed.spef", "routed.sdf", "routed.gds"
PLACED, STRIPS, JOB, LOG, FACTS = (
    "placed.json",
    "strips.json",
    "job.json",
    "coriolis.log",
    "facts.json",
)
LIMIT_S = 300  # time limit of an attempt
NOT_ROUTED = 3  # exit code of `place_route.py`
CLOCK = "clk"
BEHIND = ("document", "delays")  # files on which a routed block does not depend


@frozen
class Attempt:
    """How much room the router gets.

    margin: share of free area. um2_per_pin: least area of a cell for each of its pins.
    tracks_reserved: horizontal and vertical tracks that the global router leaves to the detailed
    router, and their least number in any place.
    """

    margin: float
    um2_per_pin: float
    tracks_reserved: tuple[int, int, int]


ATTEMPTS = (
    Attempt(0.45, 0.70, (4, 5, 3)),
    Attempt(0.45, 0.83, (5, 6, 4)),
    Attempt(0.45, 1.00, (6, 7, 5)),
    Attempt(0.60, 1.20, (6, 7, 5)),
)


def lay_out(
    unit: Unit, clock_mhz: float, tell: Callable[[str], None], view: View = POLYPHASE
) -> tuple[Path, dict[str, Any]]:
    """Return the layout of a flattened block without its macros: the folder of its files, and
    the facts of `finish`.

    A layout is made once for each version of the Verilog. The nets of the block have one bit and
    plain names, and cells drive constants. Raises `InputError` if the tools are missing, and
    `ToolchainError` if no attempt succeeds or the wires differ from the netlist.
    """
    cells = layout_cells()
    top = unit.unit_name
    files = bound(units_files([unit], cells=True), gated=False)
    files |= {path.name: path.read_text(encoding="utf-8") for path in (*view.cells, *view.macros)}

    def make(folder: Path) -> None:
        route(top, cells, folder, tell)
        (folder / FACTS).write_text(
            json.dumps(finish(top, cells, clock_mhz, folder), indent=1), encoding="utf-8"
        )

    script = [
        f"read_verilog -sv {' '.join(files)}",
        *cells_script(top, flatten=True, gated=False),  # the layout has a single clock tree
        "setundef -zero",
        "hilomap -singleton -hicell LOGIC1_X1 Z -locell LOGIC0_X1 Z",
        "opt_clean -purge",
        "splitnets -ports -format _",
        "splitnets -format _",
        "rename -hide */w:*",
        "rename -enumerate -pattern n% */w:*",
        "rename -hide */c:*",
        "rename -enumerate -pattern u% */c:*",
        f"write_blif -buf BUF_X1 A Z {BLIF}",
    ]
    code = (
        path for path in sorted(Path(__file__).parent.iterdir()) if path.suffix in (".py", ".toml")
    )
    state = [
        str(clock_mhz),
        *(path.read_text(encoding="utf-8") for path in code if path.stem not in BEHIND),
    ]
    folder = yosys_once(
        build_root() / "layout" / top, {**files, **library_files()}, script, state, make
    )
    return folder, json.loads((folder / FACTS).read_text(encoding="utf-8"))


def route(top: str, cells: Path, folder: Path, tell: Callable[[str], None]) -> None:
    """Place and route the BLIF file of `folder`. Raises `ToolchainError` if no attempt succeeds."""
    used = set(
        re.findall(
            r"^\.(?:gate|subckt) (\S+)", (folder / BLIF).read_text(encoding="utf-8"), re.MULTILINE
        )
    )
    # for the clock tree, nets with many pins, and constants
    used |= {"BUF_X4", "BUF_X1", "LOGIC0_X1", "LOGIC1_X1"}
    places = strips(cells / LEFS[1], used)
    flat = {
        cell: {pin: astuple(strip) for pin, strip in pins.items()} for cell, pins in places.items()
    }
    (folder / STRIPS).write_text(json.dumps(flat), encoding="utf-8")
    files = {
        "blif": BLIF.removesuffix(".blif"),
        "lef": [str(cells / lef) for lef in LEFS],
        "strips": STRIPS,
    }
    for attempt in ATTEMPTS:
        tell(f"{top}: placing and routing, {attempt.margin:.0%} of the area free")
        (folder / JOB).write_text(
            json.dumps(files | {"clock": CLOCK} | asdict(attempt)), encoding="utf-8"
        )
        if run_coriolis(folder):
            return
    raise failed(f"{top}: {len(ATTEMPTS)} attempts did not route every net", folder)


def run_coriolis(folder: Path) -> bool:
    """Run the job of `folder`; return whether everything was routed in time."""
    command = [sys.executable, "-m", "coincid.flow.layout.place_route", JOB]
    environment = os.environ | {"PYTHONHASHSEED": "0"}
    with (folder / LOG).open("a", encoding="utf-8") as log:
        try:
            code = subprocess.run(
                command,
                cwd=folder,
                stdout=log,
                stderr=log,
                timeout=LIMIT_S,
                check=False,
                env=environment,
            ).returncode
        except subprocess.TimeoutExpired:
            return False
    if code not in (0, NOT_ROUTED):
        raise failed(f"Coriolis failed in {folder}", folder)
    return code == 0


def failed(what: str, folder: Path) -> ToolchainError:
    tail = (folder / LOG).read_text(errors="replace", encoding="utf-8").splitlines()[-TAIL_LINES:]
    return ToolchainError("\n".join([what, *tail]))


def finish(top: str, cells: Path, clock_mhz: float, folder: Path) -> dict[str, Any]:
    """Draw, check and time the routed block of `folder`; return its facts. Raises
    `ToolchainError` on an open or a short.

    Slacks are of paths between registers. sinks: number of inputs that the wires reach. rules:
    (rule, violations).
    """
    placed: Placed = json.loads((folder / PLACED).read_text(encoding="utf-8"))
    stored, widths_um = (
        json.loads((folder / STRIPS).read_text(encoding="utf-8")),
        cell_widths_um(cells / LEFS[1]),
    )
    places = {
        cell: {pin: Strip(*values) for pin, values in pins.items()} for cell, pins in stored.items()
    }
    layout = drawn.draw(folder / f"{top}.gds", cells / GDS, placed, places, widths_um, top)
    nets, opens, shorts, off = drawn.connect(layout, top, placed, places)
    if opens or shorts or off:
        raise ToolchainError(
            f"{top}: open nets {opens[:5]}, shorts {shorts[:5]}, pins without metal of {off[:5]}"
        )
    layout.write(str(folder / FINAL))
    drawn.draw_picture(folder / FINAL, folder / f"{top}.png")
    wired = wires.wired(
        top, placed, places, wires.lengths_um(folder / f"{top}_export.def"), cells / LEFS[0]
    )
    (folder / SPEF).write_text(wired.spef, encoding="utf-8")
    (folder / VERILOG).write_text(wires.netlist(top, placed), encoding="utf-8")
    slack_ns, hold_ns = time_wires(top, clock_mhz, folder)
    kinds = [one["kind"] for one in placed["cells"] if not one["kind"].startswith("FILL")]
    library = read_cells(folder / LIBERTY, set(kinds))
    return {
        "cells": len(kinds),
        "cell_area_um2": sum(widths_um[kind] for kind in kinds) * drawn.ROW_UM,
        "width_um": placed["width"],
        "height_um": placed["height"],
        "buffers": kinds.count(CLOCK_BUFFER),
        "nets": nets,
        "slack_ns": slack_ns,
        "hold_ns": hold_ns,
        "clock_tree_mw": wires.clock_tree_mw(
            placed, wired, library, supply_v(folder / LIBERTY), clock_mhz
        ),
        "wire_um": wired.length_um,
        "wire_ff": sum(wired.farads.values()),
        "sinks": wired.sinks,
        "rules": drawn.check_rules(layout, top),
    }


def time_wires(top: str, clock_mhz: float, folder: Path) -> tuple[float, float]:
    """Write the delays as SDF; return the slack of the longest and of the shortest path between
    registers, in ns.

    Paths include wires and the clock tree.
    """
    commands = f"""\
set_input_transition 0.05 [all_inputs]
set_load 0.005 [all_outputs]
read_spef {SPEF}
set_propagated_clock [all_clocks]
{LONGEST_PATHS}puts "SHORTEST"
report_checks -path_delay min -format full
write_sdf {SDF}
"""
    report = timing_report(folder, top, VERILOG, 1000 / clock_mhz, commands)
    longest, shortest = report.split("SHORTEST")
    slacks, holds = least_slacks_ns(longest), re.findall(r"(-?[\d.]+) +slack", shortest)
    if not slacks or not holds:
        raise ToolchainError(f"sta: no timing of {top}: {report[-500:]}")
    sdf = (folder / SDF).read_text(encoding="utf-8")
    # Icarus ignores a triplet with an empty middle. There is one corner, so all three values are
    # the same.
    (folder / SDF).write_text(
        re.sub(r"\(([-\d.]+)::([-\d.]+)\)", r"(\1:\2:\2)", sdf), encoding="utf-8"
    )
    return min(slacks.values()), min(map(float, holds))
