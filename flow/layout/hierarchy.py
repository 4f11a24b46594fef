# SPDX-License-Identifier: Apache-2.0
"""Tree and subgroup: routed minigroups are macros on a grid, and the other cells and buffers stand between them.

The router cannot finish these blocks, so their wires are estimated: the length of a net is `DETOUR` times half the
perimeter of the box around its pins. Timing covers the whole block, with the routed wires inside the macros.
"""

import json
import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from attrs import frozen

from ...hdl.export import units_files
from ...hdl.unit import Unit
from ...tools.build import ToolchainError
from ..yosys import bound
from . import buffers, drawn, flow, wires
from .delays import shell
from .drawn import Placed, Strips
from .pins import Strip, cell_widths_um

MACRO_LEF = "macro.lef"
ROOM = flow.Attempt(0.45, 0.83, (5, 6, 4))  # for the cells outside the macros
LIMIT_S = 400  # time limit of the placer
COLUMNS = 4  # in the grid of macros
CHANNEL_UM, BORDER_UM = 26.0, 16.0  # least widths between macros, and around them
STEP_UM = 5.7, 8.4  # after these steps in x and y, sites (or pairs of rows) and the tracks of all metals repeat
DETOUR = 1.23  # mean over the nets of the tree that Coriolis routed
ESTIMATED_ON = 3, 4, 5, 6  # metals that share an estimated wire in equal parts


@frozen(kw_only=True)
class Hierarchy(flow.Block):
    """A placed block with its macros. Cells, nets and wires do not include those of the macros."""

    macros: int
    wire_mm: float


@frozen
class Macro:
    """A routed block inside a larger block. pins: port -> the strip of metal2 to which a wire connects."""

    kind: str
    placed: Placed
    strips: Strips
    lengths: wires.Lengths
    pins: dict[str, Strip]


def lay_out(unit: Unit, leaf: Unit, layout: flow.Layout, clock_mhz: float, tell: Callable[[str], None]) -> Hierarchy:
    """Return a placed block. It is made once for each state of its Verilog. Raises `ToolchainError`.

    leaf: the unit whose instances are macros; layout: its routed layout.
    """
    cells, files = flow.require_tools(), bound(units_files([unit], cells=True), gated=False)
    ports, kind = used_ports((layout.folder / flow.VERILOG).read_text()), f"{leaf.unit_name}_routed"
    files[f"{leaf.unit_name}.v"] = shell(leaf, ports)
    declared = "".join(f"  {way} {name};\n" for name, way in ports.items())
    files["macro.v"] = f"(* blackbox *)\nmodule {kind} ({', '.join(ports)});\n{declared}endmodule\n"
    state = [str(clock_mhz), layout.folder.name, *flow.sources("document")]

    def make(folder: Path) -> dict[str, Any]:
        tell(f"{unit.unit_name}: placing it around its minigroups")
        macro = read_macro(leaf.unit_name, layout, ports)
        (folder / MACRO_LEF).write_text(macro_lef(macro, ports))
        number = len(re.findall(rf"^\.\w+ {kind} ", (folder / flow.BLIF).read_text(), re.MULTILINE))
        plan = floorplan(kind, layout.width_um, layout.height_um, number)
        flow.write_job(folder, cells, ROOM, plan, {kind: macro.pins}, folder / MACRO_LEF)
        flow.run_coriolis(folder, LIMIT_S)
        if not (folder / flow.PLACED).exists():
            raise ToolchainError(f"{unit.unit_name}: not placed within {LIMIT_S} s")
        return _finish(unit.unit_name, macro, cells, clock_mhz, folder)

    folder, facts = flow.made_once(unit.unit_name, files, state, make)
    return Hierarchy(folder=folder, **facts)


def used_ports(netlist: str) -> dict[str, str]:
    """Return port -> direction of a routed netlist, without inputs that no cell uses."""
    used = set(re.findall(r"\.\w+\((\w+)\)", netlist))
    ports = re.findall(r"^  (input|output) (\w+);", netlist, re.MULTILINE)
    return {name: way for way, name in ports if name in used}


def floorplan(kind: str, width_um: float, height_um: float, macros: int) -> dict[str, Any]:
    """Return the grid of the macros and the size of the block, in um. Sites, rows and tracks lie alike under all macros."""
    x, y = (math.ceil(BORDER_UM / step) * step for step in STEP_UM)
    dx, dy = (math.ceil((size + CHANNEL_UM) / step) * step for size, step in zip((width_um, height_um), STEP_UM))
    rows = math.ceil(macros / COLUMNS)
    sizes = x, y, dx, dy, 2 * x + (COLUMNS - 1) * dx + width_um, 2 * y + (rows - 1) * dy + height_um
    names = "x", "y", "dx", "dy", "width", "height"
    return {"kind": kind, "columns": COLUMNS} | {name: round(um, 4) for name, um in zip(names, sizes)}


def read_macro(name: str, layout: flow.Layout, ports: Mapping[str, str]) -> Macro:
    """Return a routed block as a macro, with one pin for every port."""
    placed, strips = json.loads((layout.folder / flow.PLACED).read_text()), flow.read_strips(layout.folder)
    pins: dict[str, Strip] = {}
    for net, _, _, strip in drawn.placed_strips(placed, strips):
        if net in ports:
            pins.setdefault(net, strip)
    return Macro(f"{name}_routed", placed, strips, wires.lengths_um(layout.folder / f"{name}_export.def"), pins)


def macro_lef(macro: Macro, ports: Mapping[str, str]) -> str:
    """Return the LEF of a macro: its size, and the strips of its ports."""
    lines = ["VERSION 5.7 ;", f"MACRO {macro.kind}", "  CLASS BLOCK ;", "  ORIGIN 0 0 ;"]
    lines += [f"  SIZE {macro.placed['width']} BY {macro.placed['height']} ;"]
    half = drawn.HALF_WIRE_UM
    for port, way in ports.items():
        strip = macro.pins[port]
        lines += [
            f"  PIN {port}",
            f"    DIRECTION {way.upper()} ;",
            "    USE SIGNAL ;",
            "    PORT",
            "      LAYER metal2 ;",
        ]
        lines += [f"        RECT {strip.x - half:.4f} {strip.low:.4f} {strip.x + half:.4f} {strip.high:.4f} ;"]
        lines += ["    END", f"  END {port}"]
    for supply, use in (("VDD", "POWER"), ("VSS", "GROUND")):
        lines += [f"  PIN {supply}", "    DIRECTION INOUT ;", f"    USE {use} ;", f"  END {supply}"]
    return "\n".join([*lines, f"END {macro.kind}", "", "END LIBRARY", ""])


def macros_of(placed: Placed, macro: Macro) -> list[dict[str, Any]]:
    """Return the macros of a placed block, in the order of their names."""
    return sorted((one for one in placed["cells"] if one["kind"] == macro.kind), key=lambda one: one["name"])


def flat(placed: Placed, macro: Macro) -> Placed:
    """Return the placed block with cells in place of macros. Cells and nets inside macro k have the prefix `m<k>_`."""
    cells = [one for one in placed["cells"] if one["kind"] != macro.kind]
    for k, one in enumerate(macros_of(placed, macro)):
        for inner in macro.placed["cells"]:
            place = {"name": f"m{k}_{inner['name']}", "x": inner["x"] + one["x"], "y": inner["y"] + one["y"]}
            nets = {pin: one["nets"].get(net, f"m{k}_{net}") for pin, net in inner["nets"].items()}
            cells.append(inner | place | {"nets": nets})
    return placed | {"cells": cells}


def lengths_um(placed: Placed, macro: Macro, estimated_um: Mapping[str, float]) -> wires.Lengths:
    """Return net -> metal -> length in the flat block: routed wires inside the macros, and estimated wires above them."""
    lengths: wires.Lengths = defaultdict(lambda: defaultdict(float))
    for net, um in estimated_um.items():
        for metal in ESTIMATED_ON:
            lengths[net][metal] += um / len(ESTIMATED_ON)
    for k, one in enumerate(macros_of(placed, macro)):
        for net, on in macro.lengths.items():
            for metal, um in on.items():
                lengths[one["nets"].get(net, f"m{k}_{net}")][metal] += um
    return lengths


def estimates_um(placed: Placed, strips: Strips) -> dict[str, float]:
    """Return net -> estimated length, for all nets with two or more pins."""
    ends: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for net, _, _, x, y in drawn.pin_places(placed, strips):
        ends[net].append((x, y))
    return {
        net: DETOUR * sum(max(along) - min(along) for along in zip(*places))
        for net, places in ends.items()
        if len(places) > 1
    }


def drivers_lost(whole: Placed) -> list[str]:
    """Return the nets of a flat block with no driver or several."""
    drivers = Counter({port: 1 for port, way in whole["ports"].items() if way == "input"})
    nets = set()
    for one in whole["cells"]:
        nets.update(one["nets"].values())
        drivers.update(net for pin, net in one["nets"].items() if wires.is_output(one["kind"], pin))
    return sorted(net for net in nets if drivers[net] != 1)


def _finish(top: str, macro: Macro, cells: Path, clock_mhz: float, folder: Path) -> dict[str, Any]:
    """Add buffers to the placed block of `folder`, time it, and return its facts."""
    strips, widths_um = flow.read_strips(folder) | dict(macro.strips), cell_widths_um(cells / flow.LEFS[1])
    widths_um[macro.kind] = macro.placed["width"]
    outputs = [port for port, way in macro.placed["ports"].items() if way == "output"]
    placed: Placed = json.loads((folder / flow.PLACED).read_text())
    floating = drivers_lost(flat(placed, macro))  # already in the netlist from Yosys
    placed = buffers.grow(placed, flow.CLOCK, strips, widths_um, macro.kind, outputs, macro.placed["height"])
    estimated_um, whole = estimates_um(placed, strips), flat(placed, macro)
    wired = wires.wired(top, whole, strips, lengths_um(placed, macro, estimated_um), cells / flow.LEFS[0])
    if lost := set(drivers_lost(whole)) - set(floating):
        raise ToolchainError(f"{top}: buffers left nets without a driver, or with several: {sorted(lost)[:5]}")
    return flow.timed_facts(top, placed, whole, wired.spef, widths_um, clock_mhz, folder, macro.kind) | {
        "macros": len(macros_of(placed, macro)),
        "nets": len(estimated_um),
        "wire_mm": sum(estimated_um.values()) / 1000,
    }
