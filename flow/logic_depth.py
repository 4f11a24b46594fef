# SPDX-License-Identifier: Apache-2.0
"""Logic depth of a netlist of two-input gates: number of gates on the longest path between registers, by block.

This measure is our choice: every flip-flop is a plain one (enables and resets are gates in front of it), an inverter
does not count, and ports count as registers. A gate of a standard-cell library is worth one to two levels.
"""

import re
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter
from typing import Any, TypeAlias

from attrs import frozen

Bit: TypeAlias = int | str  # a net's number in the netlist, or a constant
FREE = ("$_NOT_", "$_BUF_")


@frozen
class Path:
    """A longest path: its number of two-input gates, and the names of the registers or ports at its ends."""

    levels: int
    start: str
    end: str


def longest_paths(module: Mapping[str, Any], clocked: str = "$_DFF") -> dict[str, Path]:
    """Return the longest path into the registers of every block of a flattened module.

    module: from Yosys's JSON, gates of one bit. Blocks are named by their path, "" for the module's own registers and
    outputs. Blocks that are not flattened have registers at their ports. Raises `ValueError` for a combinational loop.
    """
    names = {bit: name for name, net in module["netnames"].items() if not net.get("hide_name") for bit in net["bits"]}
    gates: dict[Bit, tuple[bool, list[Bit]]] = {}  # whether it costs a level, and its inputs
    flops: list[tuple[str, Bit, Bit]] = []  # block, data, output
    level: dict[Bit, int] = {}
    source: dict[Bit, Bit] = {}
    for name, cell in module["cells"].items():
        bits = cell["connections"]
        if not cell["type"].startswith("$"):  # a block that is not flattened: it has registers at its ports
            for port, direction in cell["port_directions"].items():
                if direction == "input":
                    flops += [("", bit, bit) for bit in bits[port]]
                else:
                    level |= dict.fromkeys(bits[port], 0)
        elif cell["type"].startswith(clocked):
            flops.append((_block(name), bits["D"][0], bits["Q"][0]))
            level[bits["Q"][0]] = 0
        else:
            inputs = [bits[port][0] for port, direction in cell["port_directions"].items() if direction == "input"]
            gates |= {
                bits[port][0]: (cell["type"] not in FREE, inputs)
                for port, direction in cell["port_directions"].items()
                if direction == "output"
            }
    for port in module["ports"].values():
        if port["direction"] == "input":
            level |= dict.fromkeys(port["bits"], 0)

    try:
        order = list(TopologicalSorter({bit: inputs for bit, (_, inputs) in gates.items()}).static_order())
    except CycleError as error:
        raise ValueError(f"combinational loop through {names.get(error.args[1][0], error.args[1][0])}") from None
    for bit in order:
        if bit in gates and bit not in level:
            cost, inputs = gates[bit]
            source[bit] = max(inputs, key=level.__getitem__)
            level[bit] = level[source[bit]] + cost
        level.setdefault(bit, 0)
    worst: dict[str, Path] = {}
    outputs = [
        ("", bit, bit) for port in module["ports"].values() if port["direction"] == "output" for bit in port["bits"]
    ]
    for block, data, register in flops + outputs:
        levels = level.get(data, 0)
        if block not in worst or levels > worst[block].levels:
            start = data
            while start in source:
                start = source[start]
            worst[block] = Path(levels, names.get(start, str(start)), names.get(register, str(register)))
    return worst


def _block(cell: str) -> str:
    """Return the block of a flattened module's cell: `$flatten\\a.\\b.$auto$ff$1` came from `a.b`."""
    path = re.match(r"\$flatten((?:\\[^.\\]+\.)+)", cell)
    return path[1].replace("\\", "")[:-1] if path else ""
