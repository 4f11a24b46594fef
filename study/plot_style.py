# SPDX-License-Identifier: Apache-2.0
"""The common style of all pictures, and functions that write them: each appears whole, and equal
data give equal bytes.
"""

import io
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..model.shared.files import FilePath, whole_file
from .palette import GREEN, INK, LEGEND_PT, ORANGE, PINK, TEXT_PT, TITLE_PT, VIOLET

# element names of an SVG are hashes of this and a counter, so they are the same in every run
HASH_SALT = "coincid"
STYLE: dict[Any, Any] = {
    "font.size": TEXT_PT,
    "axes.titlesize": TITLE_PT,
    "axes.labelsize": TEXT_PT,
    "legend.fontsize": LEGEND_PT,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.5,
    "image.interpolation": "nearest",
    "figure.dpi": 120,
    "savefig.dpi": 120,
    "svg.hashsalt": HASH_SALT,
    "svg.fonttype": "none",
}
DEPTH_MAP = "viridis_r"  # near is bright
SOURCES: dict[str, dict[str, Any]] = {  # line style by the source of a number
    "literal": {"color": ORANGE, "linestyle": "--"},
    "corrected": {"color": GREEN, "linestyle": "-"},
    "Monte Carlo": {"color": INK, "linestyle": "", "marker": "o"},
    "RTL": {"color": PINK, "linestyle": "", "marker": "x"},
    "paper": {"color": VIOLET, "linestyle": ":", "marker": "s"},
}
_UNDATED = {"png": {"Software": None}, "svg": {"Date": None, "Creator": None}}


def style(**others: Any) -> AbstractContextManager[None]:
    """Return a context in which figures have the common style; `others` are further rc parameters,
    with `_` for the first `.`.
    """
    return matplotlib.rc_context(
        STYLE | {name.replace("_", ".", 1): value for name, value in others.items()}
    )


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return a figure without a window or global state. Call this within `style`."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def legend_below(figure: Figure, columns: int = 6) -> None:
    """Draw one legend below all axes, with each label once."""
    entries: dict[str, Any] = {}
    for axis in figure.axes:
        entries |= {
            label: handle
            for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
            if label not in entries
        }
    figure.legend(
        list(entries.values()),
        list(entries),
        loc="outside lower center",
        ncols=min(columns, len(entries)),
    )


def share_axis(axis: Axes, **others: Any) -> None:
    """Scale an axis for shares from 0 to 1: linear up to 0.1 %, then logarithmic; `others` are for
    `Axes.set`.
    """
    axis.set(**others)
    axis.set_yscale("symlog", linthresh=1e-3, linscale=0.4)
    axis.set_ylim(0, 1)
    axis.set_yticks([0, 1e-3, 1e-2, 1e-1, 1], labels=["0", "0.1 %", "1 %", "10 %", "100 %"])


def save_figure(figure: Figure, *paths: FilePath) -> None:
    """Write `figure` to each path (.png or .svg)."""
    for path in map(Path, paths):
        content = figure_bytes(figure, path.suffix[1:])
        with whole_file(path) as file:
            file.write(content)


def figure_bytes(figure: Figure, kind: str) -> bytes:
    """Return `figure` as the bytes of a png or svg file."""
    with style():
        data = io.BytesIO()
        figure.savefig(data, format=kind, metadata=_UNDATED[kind])
    return data.getvalue()
