# SPDX-License-Identifier: Apache-2.0
"""Draws the summary of a sweep: one axis across, one as lines, the others as bands."""

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes

from ..model.contract.config import SETTINGS
from .plot_style import legend_below, new_figure, save_figure, style
from .sweep_spec import Spec

PANELS = {  # measure: (label of its axis, factor)
    "wrong_share": ("wrong pixels in %", 100),
    "depth_share": ("pixels with depth in %", 100),
    "right_rms_m": ("RMS error of right pixels in mm", 1000),
    "commits_per_pulse": ("commits per laser pulse", 1),
    "dropped_share": ("dropped commits in %", 100),
    "stream_load": ("load of the busiest stream in %", 100),
}
ACROSS = 3
WIDTH_IN, HEIGHT_IN = 3.6, 2.7  # of a panel
LOG_RATIO = 20  # ratio of the largest to the smallest value above which an axis is logarithmic
BRIGHTEST = 0.9  # used share of the colour map; its bright end is hard to see on white
REPEATS = {"seed"}  # an axis with only these keys shows noise, so it becomes a band at any position
# key: (meaning, unit)
LABELS = {setting.key: ("", setting.unit) for setting in SETTINGS.values()} | {
    "klux": ("background light", "klux"),
    "clock_mhz": ("system clock", "MHz"),
    "frame.clock_mhz": ("system clock", "MHz"),
}


def write_plot(path: Path, title: str, spec: Spec, found: dict[str, dict[str, Any]]) -> None:
    """Draw `PANELS` for the points whose keys are in `found` into `path` (.png); the bytes depend
    only on the arguments.

    The first axis of the SPEC runs across, and the second one gives the lines; an axis of seeds is
    used only if there is no other. Lines are means over the remaining axes, and bands span minimum
    and maximum.
    """
    order = sorted(range(len(spec.axes)), key=lambda i: set(spec.axes[i]) <= REPEATS)
    across, lines = (spec.axes[i] if i is not None else {} for i in (order + [None, None])[:2])
    if set(lines) <= REPEATS:
        order, lines = order[:1], {}
    others = [_label(spec.axes[i]) for i in range(len(spec.axes)) if i not in order[:2]]
    cells: dict[tuple[int, ...], list[dict[str, Any]]] = {}
    for point in spec.points:
        if point.key in found:
            cells.setdefault(tuple(point.at[i] for i in order[:2]), []).append(found[point.key])
    names = _texts(lines) or [""]
    colours = matplotlib.colormaps["viridis"](np.linspace(0, BRIGHTEST, len(names)))
    with style():
        down = -(-len(PANELS) // ACROSS)
        figure = new_figure(WIDTH_IN * ACROSS, HEIGHT_IN * down + 0.8)
        places = figure.subplots(down, ACROSS, sharex=True).ravel()
        # the last row may have room
        for axis, (measure, (label, factor)) in zip(places, PANELS.items(), strict=False):
            x = _scale(axis, across)
            for k, (name, colour) in enumerate(zip(names, colours, strict=True)):
                at = [(i, k)[: min(2, len(order))] for i in range(len(x))]
                low, mean, high = (
                    np.array([_span(cells.get(cell, []), measure) for cell in at]).T * factor
                )
                axis.plot(x, mean, "-o", color=colour, label=name or None)
                axis.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)
            axis.set_ylabel(label)
            axis.set_ylim(bottom=0)
        for axis in figure.axes[-ACROSS:]:
            axis.set_xlabel(_label(across))
        if lines:
            legend_below(figure, columns=8)
            figure.legends[0].set_title(_label(lines))
        figure.suptitle(
            title + (f"; mean and span over {', '.join(others)}" if others else ""), fontsize=11
        )
    save_figure(figure, path)


def _scale(axis: Axes, swept: dict[str, list[Any]]) -> np.ndarray:
    """Set scale and ticks of a plot for an axis of the SPEC; return the positions of its values."""
    texts, values = _texts(swept) or [""], next(iter(swept.values()), [])
    numeric = len(swept) == 1 and all(
        isinstance(value, (int, float)) and not isinstance(value, bool) for value in values
    )
    x = np.array(values if numeric else range(len(texts)), float)
    if numeric and x.min() > 0 and x.max() >= LOG_RATIO * x.min():
        axis.set_xscale("log")
        axis.minorticks_off()
    axis.set_xticks(x, texts)
    return x


def _span(cell: list[dict[str, Any]], measure: str) -> tuple[float, float, float]:
    """Return minimum, mean and maximum of a measure; NaN if no point has it."""
    values = [point[measure] for point in cell if point[measure] is not None]
    return (min(values), float(np.mean(values)), max(values)) if values else (np.nan,) * 3


def _texts(swept: dict[str, list[Any]]) -> list[str]:
    return [
        ", ".join(format(value, "g") if isinstance(value, float) else str(value) for value in step)
        for step in zip(*swept.values(), strict=True)
    ]


def _label(swept: dict[str, list[Any]]) -> str:
    """Return the names of the keys that an axis of the SPEC sweeps, with their units."""
    parts = []
    for key in swept:
        name, unit = LABELS.get(key, ("", ""))
        parts.append((name or key, unit))
    units = {unit for _, unit in parts if unit}
    if len(units) == 1:
        return f"{', '.join(name for name, _ in parts)} in {units.pop()}"
    return ", ".join(f"{name} in {unit}" if unit else name for name, unit in parts)
