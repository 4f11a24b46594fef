# SPDX-License-Identifier: Apache-2.0
"""Wires of a block as resistances and capacitances, and its netlist as Verilog.

The values are not extracted from shapes. The capacitance of a net is computed from its length on
each metal, with the LEF file's values for area and edge. The resistance to a pin is that of the
direct way. Coupling is not included.
"""

import re
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

from attrs import frozen

from ..liberty import Cell
from ..power import MW_PER_FJ_MHZ
from ..yosys import CLOCK_BUFFER
from .drawn import Placed, Strips, pin_places

VIA_OHM, PIN_FF, WITHOUT_WIRE_OHM = 20.0, 0.05, 3.0
OUTPUTS = {"Z", "ZN", "Q", "QN", "CO", "S", "GCK"}
SELECTS = ("MUX",)  # cells in which S is an input
FF_PER_PF = 1000
Lengths = dict[str, dict[int, float]]  # net -> metal -> um


def metals(lef: Path) -> dict[int, tuple[float, float]]:
    """Return routing layer -> (capacitance in fF per um, ohm per um) of a wire of least width,
    from a LEF file.
    """
    found = {}
    for number, body in re.findall(
        r"^LAYER metal(\d+)\n(.*?)^END metal\d+",
        lef.read_text(encoding="utf-8"),
        re.MULTILINE | re.DOTALL,
    ):
        value = {name: float(number) for name, number in re.findall(r"(\w+) ([\d.eE+-]+) ;", body)}
        width = value["WIDTH"]
        capacitance = value["CPERSQDIST"] * width + 2 * value["EDGECAPACITANCE"]
        found[int(number)] = FF_PER_PF * capacitance, value["RPERSQ"] / width
    return found


def lengths_um(routed: Path) -> Lengths:
    """Return net -> metal -> length from a routed DEF file. The nets of the clock are special
    nets there.
    """
    text = routed.read_text(encoding="utf-8")
    units = re.search(r"^UNITS DISTANCE MICRONS (\d+)", text, re.MULTILINE)
    nets = re.findall(r"^((?:SPECIAL)?NETS) (.*?)^END \1", text, re.MULTILINE | re.DOTALL)
    if units is None or not nets:
        raise ValueError(f"{routed.name}: no units, or no nets")
    lengths: Lengths = {}
    for net in (
        net for _, part in nets for net in re.split(r"^\s*- ", part, flags=re.MULTILINE)[1:]
    ):
        on = lengths.setdefault(net.split()[0], defaultdict(float))
        for level, points in re.findall(r"(?:ROUTED|NEW)\s+metal(\d+)\s([^;]*?)(?=NEW|;|\Z)", net):
            on[int(level)] += _way(re.findall(r"\( (\S+) (\S+)[^)]*\)", points)) / int(units[1])
    return lengths


def _way(points: list[tuple[str, str]]) -> int:
    """Return the length of a wire through points of a DEF file. `*` repeats a coordinate."""
    total, x, y = 0, 0, 0
    for k, (next_x, next_y) in enumerate(points):
        new = x if next_x == "*" else int(next_x), y if next_y == "*" else int(next_y)
        total += abs(new[0] - x) + abs(new[1] - y) if k else 0
        x, y = new
    return total


def is_output(kind: str, pin: str) -> bool:
    return pin in OUTPUTS and not (pin == "S" and kind.startswith(SELECTS))


@frozen
class Wired:
    """All wires of a block: their SPEF, their length, net -> capacitance in fF, and the number
    of inputs at their ends.
    """

    spef: str
    length_um: float
    farads: Mapping[str, float]
    sinks: int


def wired(top: str, placed: Placed, strips: Strips, lengths: Lengths, lef: Path) -> Wired:
    """Return the wires of a block from their lengths."""
    layer = metals(lef)
    kinds = {one["name"]: one["kind"] for one in placed["cells"]}
    pins: dict[str, list[tuple[str, str, float, float]]] = defaultdict(list)
    for net, cell, pin, x, y in pin_places(placed, strips):
        pins[net].append((cell, pin, x, y))
    lines = [
        '*SPEF "IEEE 1481-1998"', f'*DESIGN "{top}"', '*DATE ""', '*VENDOR ""', '*PROGRAM "coincid"', '*VERSION ""',
        '*DESIGN_FLOW ""', "*DIVIDER /", "*DELIMITER :", "*BUS_DELIMITER [ ]", "*T_UNIT 1 NS", "*C_UNIT 1 FF",
        "*R_UNIT 1 OHM", "*L_UNIT 1 HENRY", "",
    ]  # fmt: skip
    length, sinks_of_all = 0.0, 0
    of_net: dict[str, float] = {}
    for net, ends in pins.items():
        on = lengths.get(net, {})
        total = sum(on.values())
        ohms = sum(layer[i][1] * um for i, um in on.items()) / total if total else WITHOUT_WIRE_OHM
        farads = sum(layer[i][0] * um for i, um in on.items()) + PIN_FF * len(ends)
        drivers = [end for end in ends if is_output(kinds[end[0]], end[1])]
        sinks = [end for end in ends if end not in drivers]
        port = placed["ports"].get(net)
        if drivers or port:
            lines += _net(net, farads, ohms, drivers[0] if drivers else None, sinks, port)
            of_net[net] = farads
            length, sinks_of_all = length + total, sinks_of_all + len(sinks)
    return Wired("\n".join(lines) + "\n", length, of_net, sinks_of_all)


def _net(
    net: str,
    farads: float,
    ohms: float,
    driver: tuple[str, str, float, float] | None,
    sinks: list[tuple[str, str, float, float]],
    port: str | None,
) -> list[str]:
    """Return the SPEF lines of a net, which is a star of resistances around its driver."""
    root = f"{driver[0]}:{driver[1]}" if driver else net
    ends = {f"{cell}:{pin}": (x, y) for cell, pin, x, y in sinks}
    lines = [f"*D_NET {net} {farads:.4f}", "*CONN"]
    if port:
        lines.append(f"*P {net} {'O' if driver else 'I'}")
    if driver:
        lines.append(f"*I {root} O")
    lines += [f"*I {end} I" for end in ends]
    nodes = [root, *ends, *([net] if port and driver else [])]
    lines += [
        "*CAP",
        *(f"{k} {node} {farads / len(nodes):.5f}" for k, node in enumerate(nodes, 1)),
        "*RES",
    ]
    for k, node in enumerate(nodes[1:], 1):
        far = 1.0
        if driver and node in ends:
            far = abs(ends[node][0] - driver[2]) + abs(ends[node][1] - driver[3])
        lines.append(f"{k} {root} {node} {far * ohms + VIA_OHM:.2f}")
    return [*lines, "*END", ""]


def clock_tree_mw(
    placed: Placed, wires: Wired, cells: Mapping[str, Cell], supply_v: float, clock_mhz: float
) -> float:
    """Return the power of the buffers and wires of the clock tree, without the pins of
    flip-flops and latches.

    Every net of the tree changes twice per cycle. cells: from `liberty.read_cells`.
    """
    # nothing else in a placed block has it
    tree = [one for one in placed["cells"] if one["kind"] == CLOCK_BUFFER]
    loads = {one["nets"]["A"]: 0.0 for one in tree} | {one["nets"]["Z"]: 0.0 for one in tree}
    pins = dict.fromkeys(loads, 0.0)
    for one in placed["cells"]:
        for pin, net in one["nets"].items():
            if net in loads and not is_output(one["kind"], pin):
                farads = cells[one["kind"]].pins[pin].capacitance_ff
                loads[net] += farads
                pins[net] += farads * (one["kind"] == CLOCK_BUFFER)
    energy = 0.0
    for one in tree:
        net, own = one["nets"]["Z"], cells[CLOCK_BUFFER].pins["Z"].energies
        energy += 2 * (own.at(loads[net] + wires.farads[net]) if own else 0.0)
    energy += sum((pins[net] + wires.farads[net]) * supply_v**2 for net in loads)
    return MW_PER_FJ_MHZ * energy * clock_mhz


def netlist(top: str, placed: Placed) -> str:
    """Return the Verilog of the placed cells, without fillers."""
    ports: Mapping[str, str] = placed["ports"]
    cells = [one for one in placed["cells"] if not one["kind"].startswith("FILL")]
    nets = sorted({net for one in cells for net in one["nets"].values()} - set(ports))
    lines = [
        f"module {top} ({', '.join(ports)});",
        *(f"  {way} {name};" for name, way in ports.items()),
    ]
    lines += [f"  wire {net};" for net in nets]
    lines += [
        f"  {one['kind']} {one['name']} ({', '.join(f'.{pin}({net})' for pin, net in one['nets'].items())});"
        for one in cells
    ]
    return "\n".join([*lines, "endmodule", ""])
