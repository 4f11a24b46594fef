# SPDX-License-Identifier: Apache-2.0
"""Logic depth of a netlist of two-input gates: number of gates on the longest path between
registers, by block.

This measure is our choice: every flip-flop is a plain one (enables and resets are gates in front
of it), an inverter does not count, and ports count as registers. A gate of a standard-cell
library is worth one to two levels.
"""

import re
from collections import defaultdict
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter
from typing import Any, TypeAlias

Bit: TypeAlias = int | str  # a net's number in the netlist, or a constant
FREE = ("$_NOT_", "$_BUF_")


def depths(module: Mapping[str, Any]) -> dict[str, int]:
    """Return the number of gates on the longest path into the registers of every block of a
    flattened module.

    module: from Yosys's JSON, gates of one bit. Blocks are named by their path, "" for the
    module's own registers and outputs. Blocks that are not flattened have registers at their
    ports. Raises `ValueError` for a combinational loop.
    """
    gates: dict[Bit, tuple[bool, list[Bit]]] = {}  # whether it costs a level, and its inputs
    ends: list[tuple[str, Bit]] = []  # block, and the data of a register or an output
    level: dict[Bit, int] = {}
    for port in module["ports"].values():
        if port["direction"] == "input":
            level |= dict.fromkeys(port["bits"], 0)
        else:
            ends += [("", bit) for bit in port["bits"]]
    for name, cell in module["cells"].items():
        bits, kind = cell["connections"], cell["type"]
        inputs = [
            bit
            for port, way in cell["port_directions"].items()
            if way == "input"
            for bit in bits[port]
        ]
        outputs = [
            bit
            for port, way in cell["port_directions"].items()
            if way == "output"
            for bit in bits[port]
        ]
        if not kind.startswith("$"):  # a block that is not flattened
            ends += [("", bit) for bit in inputs]
            level |= dict.fromkeys(outputs, 0)
        elif kind.startswith("$_DFF"):
            ends.append((_block(name), bits["D"][0]))
            level[bits["Q"][0]] = 0
        else:
            gates |= dict.fromkeys(outputs, (kind not in FREE, inputs))
    try:
        order = list(
            TopologicalSorter({bit: inputs for bit, (_, inputs) in gates.items()}).static_order()
        )
    except CycleError as error:
        raise ValueError(f"combinational loop through net {error.args[1][0]}") from None
    for bit in order:
        if bit in gates and bit not in level:
            cost, inputs = gates[bit]
            level[bit] = max(level[one] for one in inputs) + cost
        level.setdefault(bit, 0)
    worst: dict[str, int] = defaultdict(int)
    for block, bit in ends:
        worst[block] = max(worst[block], level.get(bit, 0))
    return dict(worst)


def _block(cell: str) -> str:
    """Return the block of a flattened module's cell: `$flatten\\a.\\b.$auto$ff$1` came from
    `a.b`.
    """
    path = re.match(r"\$flatten((?:\\[^.\\]+\.)+)", cell)
    return path[1].replace("\\", "")[:-1] if path else ""
