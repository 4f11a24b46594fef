# SPDX-License-Identifier: Apache-2.0
"""Wires of a routed block as resistances and capacitances, and its netlist as Verilog.

Not an extraction: a net's capacitance is that of its length on each metal, by the LEF file's values for area and edge; its resistance to each
pin is that of the direct way there. Coupling to neighbours is not in it.
"""

import re
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

from attrs import frozen

from .drawn import Placed, Strips, pin_places

VIA_OHM, PIN_FF, WITHOUT_WIRE_OHM = 20.0, 0.05, 3.0
OUTPUTS = {"Z", "ZN", "Q", "QN", "CO", "S", "GCK"}
SELECTS = ("MUX",)  # cells whose S is an input
FF_PER_PF = 1000


@frozen
class Metal:
    """Of a layer: fF per um of a wire of its width, and ohm per um."""

    farads: float
    ohms: float


def metals(lef: Path) -> dict[int, Metal]:
    """The routing layers of a technology's LEF file."""
    found = {}
    for number, body in re.findall(r"^LAYER metal(\d+)\n(.*?)^END metal\d+", lef.read_text(), re.MULTILINE | re.DOTALL):
        value = {name: float(number) for name, number in re.findall(r"(\w+) ([\d.eE+-]+) ;", body)}
        width = value["WIDTH"]
        capacitance = value["CPERSQDIST"] * width + 2 * value["EDGECAPACITANCE"]
        found[int(number)] = Metal(FF_PER_PF * capacitance, value["RPERSQ"] / width)
    return found


def lengths_um(routed: Path) -> dict[str, dict[int, float]]:
    """Net -> metal -> length, of a routed DEF file."""
    lengths: dict[str, dict[int, float]] = {}
    units, net, level, at = 1.0, None, None, None
    for line in routed.read_text().splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "UNITS":
            units = float(words[3])
        elif words[0] in ("NETS", "END"):
            net = None
        elif words[0] == "-":
            net, level = words[1], None
            lengths.setdefault(net, defaultdict(float))
            continue
        if net is None or net not in lengths:
            continue
        start = re.search(r"(?:ROUTED|NEW) (\S+)", line)
        if start:
            named = re.fullmatch(r"metal(\d+)", start[1])
            level, at = (int(named[1]) if named else None), None
        if level is None:
            continue
        for x, y in re.findall(r"\( (\S+) (\S+)[^)]*\)", line):
            here = (at[0] if x == "*" else int(x), at[1] if y == "*" else int(y))
            if at is not None:
                lengths[net][level] += (abs(here[0] - at[0]) + abs(here[1] - at[1])) / units
            at = here
    return lengths


def is_output(kind: str, pin: str) -> bool:
    return pin in OUTPUTS and not (pin == "S" and kind.startswith(SELECTS))


@frozen
class Wired:
    """All wires of a block: SPEF text, their length, their capacitance, and the pins that they reach as inputs."""

    spef: str
    length_um: float
    capacitance_ff: float
    sinks: int


def wired(top: str, placed: Placed, strips: Strips, routed: Path, lef: Path) -> Wired:
    """The wires of a routed block."""
    layer, lengths = metals(lef), lengths_um(routed)
    kinds = {one["name"]: one["kind"] for one in placed["cells"]}
    pins: dict[str, list[tuple[str, str, float, float]]] = defaultdict(list)
    for net, cell, pin, x, y in pin_places(placed, strips):
        pins[net].append((cell, pin, x, y))
    lines = [
        '*SPEF "IEEE 1481-1998"', f'*DESIGN "{top}"', '*DATE ""', '*VENDOR ""', '*PROGRAM "coincid"', '*VERSION ""',
        '*DESIGN_FLOW ""', "*DIVIDER /", "*DELIMITER :", "*BUS_DELIMITER [ ]", "*T_UNIT 1 NS", "*C_UNIT 1 FF",
        "*R_UNIT 1 OHM", "*L_UNIT 1 HENRY", "",
    ]  # fmt: skip
    length = capacitance = 0.0
    sinks_of_all = 0
    for net, ends in pins.items():
        on = lengths.get(net, {})
        total = sum(on.values())
        ohms = sum(layer[i].ohms * um for i, um in on.items()) / total if total else WITHOUT_WIRE_OHM
        farads = sum(layer[i].farads * um for i, um in on.items()) + PIN_FF * len(ends)
        drivers = [end for end in ends if is_output(kinds[end[0]], end[1])]
        sinks = [end for end in ends if end not in drivers]
        port = placed["ports"].get(net)
        if drivers or port:
            lines += _net(net, farads, ohms, drivers[0] if drivers else None, sinks, port)
            length, capacitance, sinks_of_all = length + total, capacitance + farads, sinks_of_all + len(sinks)
    return Wired("\n".join(lines) + "\n", length, capacitance, sinks_of_all)


def _net(
    net: str,
    farads: float,
    ohms: float,
    driver: tuple[str, str, float, float] | None,
    sinks: list[tuple[str, str, float, float]],
    port: str | None,
) -> list[str]:
    """A net as a star of resistances around its driver."""
    root = f"{driver[0]}:{driver[1]}" if driver else net
    ends = {f"{cell}:{pin}": (x, y) for cell, pin, x, y in sinks}
    lines = [f"*D_NET {net} {farads:.4f}", "*CONN"]
    if port:
        lines.append(f"*P {net} {'O' if driver else 'I'}")
    if driver:
        lines.append(f"*I {root} O")
    lines += [f"*I {end} I" for end in ends]
    nodes = [root, *ends, *([net] if port and driver else [])]
    lines += ["*CAP", *(f"{k} {node} {farads / len(nodes):.5f}" for k, node in enumerate(nodes, 1)), "*RES"]
    for k, node in enumerate(nodes[1:], 1):
        far = 1.0
        if driver and node in ends:
            far = abs(ends[node][0] - driver[2]) + abs(ends[node][1] - driver[3])
        lines.append(f"{k} {root} {node} {far * ohms + VIA_OHM:.2f}")
    return [*lines, "*END", ""]


def netlist(top: str, placed: Placed) -> str:
    """Verilog of the placed cells, without fillers."""
    ports: Mapping[str, str] = placed["ports"]
    cells = [one for one in placed["cells"] if not one["kind"].startswith("FILL")]
    nets = sorted({net for one in cells for net in one["nets"].values()} - set(ports))
    lines = [f"module {top} ({', '.join(ports)});", *(f"  {way} {name};" for name, way in ports.items())]
    lines += [f"  wire {net};" for net in nets]
    lines += [
        f"  {one['kind']} {one['name']} ({', '.join(f'.{pin}({net})' for pin, net in one['nets'].items())});"
        for one in cells
    ]
    return "\n".join([*lines, "endmodule", ""])
