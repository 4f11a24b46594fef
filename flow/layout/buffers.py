# SPDX-License-Identifier: Apache-2.0
"""Buffers for a placed block with macros: a clock tree, and trees for other nets with many sinks.

Neighbouring sinks share a buffer, and neighbouring buffers share one, too. A buffer stands in the free place that is
nearest to the centre of its sinks. The clock passes the same number of buffers on its way to every flip-flop. A macro
contains its own clock tree.
"""

import re
from collections import defaultdict
from collections.abc import Collection, Mapping
from typing import Any

from ..yosys import CLOCK_BUFFER, SINKS_MAX
from .drawn import ROW_UM, SITE_UM, Placed, Strips, pin_places
from .wires import is_output

BUFFERS_MAX = 8  # largest number of buffers, or of cells at the same level, below a buffer
FANOUT_MAX = 10  # largest number of sinks of a net without buffers
# Levels of buffers before flip-flops only: macros and the gates that open latches have as many fewer.
EARLY_LEVELS = 2
FLOP = re.compile("DFF|DL[HL]")
Sink = tuple[float, float, dict[str, Any], str]  # x, y, cell, its pin
Gaps = dict[int, list[tuple[float, float]]]  # row -> (from, to) of its free places


def grow(
    placed: Placed,
    clock: str,
    strips: Strips,
    widths_um: Mapping[str, float],
    macro: str,
    outputs: Collection[str],
    height_um: float,
) -> Placed:
    """Return the placed block with a clock tree, and with buffers in all nets of more than `FANOUT_MAX` sinks.

    widths_um: of all kinds of cells. macro, outputs, height_um: the kind of the macros, their output pins, their height.
    """
    cells = {one["name"]: one for one in placed["cells"]}
    sinks: dict[str, list[Sink]] = defaultdict(list)
    for net, name, pin, x, y in pin_places(placed, strips):
        kind = cells[name]["kind"]
        if not (pin in outputs if kind == macro else is_output(kind, pin)):
            sinks[net].append((x, y, cells[name], pin))
    gaps, width_um = free_places(placed, widths_um, macro, height_um), widths_um[CLOCK_BUFFER]
    added = []
    for net, ends in sorted(sinks.items()):
        if net == clock:
            early = [end for end in ends if not FLOP.match(end[2]["kind"])]
            added += tree(net, [end for end in ends if FLOP.match(end[2]["kind"])], early, gaps, width_um)
        elif len(ends) > FANOUT_MAX:
            added += tree(net, ends, [], gaps, width_um)
    return placed | {"cells": [*placed["cells"], *added]}


def tree(net: str, level: list[Sink], early: list[Sink], gaps: Gaps, width_um: float) -> list[dict[str, Any]]:
    """Return buffers between the driver of a net and its sinks, and connect the sinks to them.

    level: the sinks. early: sinks behind `EARLY_LEVELS` fewer buffers than the others.
    """
    added: list[dict[str, Any]] = []
    number, limit = 0, SINKS_MAX
    while early or len(level) > (BUFFERS_MAX if number else 0):
        groups, level = near(level, limit), []
        for group in groups:
            name = f"{net}_tree_{len(added)}"
            buffer = _place(group, gaps, width_um) | {"name": f"tree_{name}", "nets": {"A": net, "Z": name}}
            for _, _, cell, pin in group:
                cell["nets"][pin] = name
            added.append(buffer)
            level.append((buffer["x"], buffer["y"], buffer, "A"))
        number, limit = number + 1, BUFFERS_MAX
        if number == EARLY_LEVELS:
            level, early = level + early, []
    return added


def near(sinks: list[Sink], most: int) -> list[list[Sink]]:
    """Return groups of neighbouring sinks. All groups are halved across their longer side until none has more than `most`."""
    groups = [sinks]
    while max(map(len, groups)) > most:
        groups = [half for group in groups for half in _halves(group)]
    return groups


def _halves(sinks: list[Sink]) -> tuple[list[Sink], list[Sink]]:
    xs, ys = [sink[0] for sink in sinks], [sink[1] for sink in sinks]
    wide = max(xs) - min(xs) >= max(ys) - min(ys)
    ordered = sorted(sinks, key=lambda sink: (sink[0] if wide else sink[1], sink[2]["name"]))
    return ordered[: len(sinks) // 2], ordered[len(sinks) // 2 :]


def free_places(placed: Placed, widths_um: Mapping[str, float], macro: str, height_um: float) -> Gaps:
    """Return the free places of every row, between the cells and macros."""
    taken: dict[int, list[tuple[float, float]]] = defaultdict(list)
    for one in placed["cells"]:
        if not one["kind"].startswith("FILL"):
            row, rows = round(one["y"] / ROW_UM), round(height_um / ROW_UM) if one["kind"] == macro else 1
            for k in range(row, row + rows):
                taken[k].append((one["x"], one["x"] + widths_um[one["kind"]]))
    gaps: Gaps = {}
    for row in range(round(placed["height"] / ROW_UM)):
        ends = [0.0, *(to for _, to in sorted(taken[row]))], [*(at for at, _ in sorted(taken[row])), placed["width"]]
        gaps[row] = list(zip(*ends, strict=True))
    return gaps


def _place(group: list[Sink], gaps: Gaps, width_um: float) -> dict[str, Any]:
    """Return a buffer in the free place nearest to the centre of a group, and remove this place from `gaps`."""
    x, y = sum(sink[0] for sink in group) / len(group), sum(sink[1] for sink in group) / len(group)

    def away(place: tuple[int, int]) -> float:
        row, k = place
        at, to = gaps[row][k]
        return abs(row * ROW_UM - y) + abs(min(max(x, at), to - width_um) - x)

    fitting = ((row, k) for row, free in gaps.items() for k, (at, to) in enumerate(free) if to - at >= width_um)
    row, k = min(fitting, key=away)
    at, to = gaps[row].pop(k)
    left = round(at + round((min(max(x, at), to - width_um) - at) / SITE_UM - 0.5) * SITE_UM, 4)
    left = max(left, at)
    gaps[row] += [(at, left), (left + width_um, to)]
    return {"kind": CLOCK_BUFFER, "x": left, "y": round(row * ROW_UM, 4), "flipped": row % 2 == 1}
