# SPDX-License-Identifier: Apache-2.0
"""Draws blocks.svg: the sensor's blocks and the signals between them.

python -m coincid.study.drawings.block_diagram
"""

from typing import TypeAlias

import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from ..palette import DEEP_INK, FRAME, FRAME_LINE, NOTE, OURS, PAPER, WIRE
from . import save

BLOCKS = {  # name: (x, y, width, height, title, notes, from the paper?)
    "spads": (0.2, 3.35, 2.0, 2.5, "SPADs", "32 x 32, a line each:\n8 x 8 a subgroup", True),
    "gate": (3.2, 5.0, 1.9, 1.0, "gating, mask", "logic gate, SPAD gate,\nprogressive", True),
    "leaves": (3.2, 3.2, 1.9, 1.4, "16 minigroups", "2 x 2: OR, hits,\ncoarse stamp,\nown coincidence", True),
    "tree": (5.6, 3.2, 1.9, 2.8, "coincID tree", "root, window,\nID map, winner,\nself-reset", True),
    "dpcu": (8.0, 4.6, 1.9, 1.4, "DPCU", "count >= threshold,\nthreshold controller,\ncounters", True),
    "fifo": (8.0, 3.2, 1.9, 1.0, "FIFO", "16 events; 1 record", True),
    "packets": (
        10.4,
        3.2,
        1.7,
        2.8,
        "packetizer",
        "event words:\nshort, ID map,\nfull; minigroup\nrecord;\ncounters",
        False,
    ),
    "tdc": (5.6, 1.25, 1.9, 1.25, "TDC", "always on: coarse\ncounter, 32 phases,\ntwo lines", True),
    "other": (8.0, 1.25, 4.1, 1.25, "subgroup 2k + 1", "the same, on the TDC's other line", True),
    "readout": (13.2, 3.2, 1.9, 2.8, "readout", "round robin,\nframe start and\nend packets,\noutput buffer", False),
    "registers": (3.2, 7.0, 4.3, 0.95, "registers", "one table; settings are taken at frame start", False),
    "sequencer": (8.0, 7.0, 4.1, 0.95, "frame sequencer", "laser periods back to back", False),
}
Place: TypeAlias = tuple[float, float]
WIRES: tuple[
    tuple[tuple[Place, ...], str, Place | None, str], ...
] = (  # (points, label, position of the label, alignment)
    (((2.2, 4.0), (3.2, 4.0)), "edge\nwords", (2.62, 4.12), "center"),
    (((5.1, 4.0), (5.6, 4.0)), "", None, ""),
    (((4.15, 5.0), (4.15, 4.6)), "accept", (4.22, 4.8), "left"),
    (((6.35, 3.2), (6.35, 2.5)), "root", (6.22, 2.61), "right"),
    (((6.75, 2.5), (6.75, 3.2)), "stamp", (6.82, 2.61), "left"),
    (((8.0, 2.0), (7.5, 2.0)), "", None, ""),
    (((7.5, 1.7), (8.0, 1.7)), "", None, ""),
    (((7.5, 5.3), (8.0, 5.3)), "", None, ""),
    (((8.95, 4.6), (8.95, 4.2)), "commit", (9.02, 4.4), "left"),
    (((9.9, 3.7), (10.4, 3.7)), "", None, ""),
    (((12.1, 4.9), (13.2, 4.9)), "beats", (12.78, 5.0), "center"),
    (((13.2, 4.3), (12.1, 4.3)), "grants", (12.78, 4.4), "center"),
    (((12.1, 1.9), (14.15, 1.9), (14.15, 3.2)), "", None, ""),
    (((15.1, 4.6), (16.0, 4.6)), "AXI4-\nStream", (15.65, 4.72), "center"),
    (((2.2, 7.48), (3.2, 7.48)), "AXI4-Lite", (2.1, 7.48), "right"),
    (((7.5, 7.48), (8.0, 7.48)), "", None, ""),
    (((12.1, 7.48), (13.2, 7.48)), "laser", (13.3, 7.48), "left"),
    (((5.35, 7.0), (5.35, 6.45)), "settings", (5.42, 6.72), "left"),
    (((10.05, 7.0), (10.05, 6.45)), "time, strobes", (10.12, 6.72), "left"),
    (((3.2, 5.45), (2.2, 5.45)), "spad_\ngate", (2.55, 5.53), "center"),
)


def draw() -> Figure:
    """The picture."""
    figure, axes = plt.subplots(figsize=(12, 6.1))
    for x, y, width, height, text in (
        (2.75, 0.75, 9.75, 5.75, "module k, one of 8"),
        (2.95, 2.72, 9.35, 3.48, "subgroup 2k"),
    ):
        axes.add_patch(
            FancyBboxPatch(
                (x, y), width, height, boxstyle="round,pad=0,rounding_size=0.12", fc=FRAME, ec=FRAME_LINE, lw=1
            )
        )
        axes.text(x + 0.12, y + 0.08, text, fontsize=9, color=NOTE, style="italic", va="bottom")
    for x, y, width, height, title, notes, paper in BLOCKS.values():
        axes.add_patch(
            FancyBboxPatch(
                (x, y),
                width,
                height,
                boxstyle="round,pad=0,rounding_size=0.08",
                fc=PAPER if paper else OURS,
                ec=WIRE,
                lw=1.3,
            )
        )
        lines = notes.count("\n") + 1
        centre, top = x + width / 2, y + height / 2 + 0.125 * lines
        axes.text(centre, top, title, ha="center", va="center", fontsize=10.5, weight="bold", color=DEEP_INK)
        axes.text(centre, top - 0.17, notes, ha="center", va="top", fontsize=8.3, color=NOTE, linespacing=1.25)
    for points, label, at, align in WIRES:
        *start, end = points
        axes.plot(*zip(*points), color=WIRE, lw=1.3, solid_capstyle="butt", zorder=3)
        arrow = {"arrowstyle": "-|>", "color": WIRE, "lw": 1.3, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 11}
        axes.annotate("", end, start[-1], arrowprops=arrow, zorder=3)
        if at:
            axes.text(
                *at,
                label,
                fontsize=8.3,
                color=DEEP_INK,
                ha=align,
                va="bottom" if align == "center" else "center",
                linespacing=1.1,
            )
    for x, color, text in (
        (3.2, PAPER, "named in the paper (Fig. 3); its circuit is our choice"),
        (8.8, OURS, "our choice altogether"),
    ):
        axes.add_patch(
            FancyBboxPatch((x, 0.12), 0.35, 0.25, boxstyle="round,pad=0,rounding_size=0.05", fc=color, ec=WIRE, lw=1)
        )
        axes.text(x + 0.5, 0.245, text, fontsize=8.6, color=NOTE, va="center")
    axes.set_xlim(0, 16.2)
    axes.set_ylim(0, 8.1)
    axes.axis("off")
    figure.subplots_adjust(0.005, 0.005, 0.995, 0.995)
    return figure


if __name__ == "__main__":
    save(draw(), "blocks.svg")
