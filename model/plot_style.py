"""How every picture looks, and how it is written: whole or not at all, the same bytes for the same data."""

import io
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from .files import whole_file

STYLE = {
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.labelsize": 10,
    "legend.fontsize": 8.5,
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
    "svg.hashsalt": "coincid",  # element names are hashes of this and a count: the same in every run
    "svg.fonttype": "none",
}
DEPTH_MAP, INVALID_COLOUR = "viridis_r", "#d9d9d9"  # near is dark; grey is in no part of the map
_UNDATED = {"png": {"Software": None}, "svg": {"Date": None, "Creator": None}}


def new_figure(width_in: float, height_in: float, **options) -> Figure:
    """A figure in the common style, without any window or global state."""
    with matplotlib.rc_context(STYLE):
        return Figure(figsize=(width_in, height_in), layout="constrained", **options)


def save_figure(figure: Figure, *paths) -> None:
    """Writes `figure` to each path (.png or .svg)."""
    for path in map(Path, paths):
        kind = path.suffix[1:]
        with matplotlib.rc_context(STYLE):
            data = io.BytesIO()
            figure.savefig(data, format=kind, metadata=_UNDATED[kind])
        with whole_file(path) as file:
            file.write(data.getvalue())
