# SPDX-License-Identifier: Apache-2.0
"""Draws several estimates of a scene's depth or light side by side, on one scale."""

from collections.abc import Sequence

import matplotlib
import numpy as np
from attrs import frozen
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ..model.depth.belief import SENTENCES, Reason
from ..model.depth.quality import TOLERANCE_M, wrong_pixels, wrong_share
from ..model.shared.files import FilePath
from .palette import ALARM, AMBER, BLUE, GREY, INK, MAUVE, NO_VALUE, SKY, VERMILION
from .plot_style import DEPTH_MAP, legend_below, new_figure, save_figure, style

PANEL_IN = 3.1
PANELS_ACROSS = 5  # panels per row
# light enough for black numbers up to the controller's highest threshold
BLOCK_MAP, BLOCK_MAX = "Blues", 10
REASONS = {  # colours of the marks
    Reason.NO_LIGHT: INK,
    Reason.BACKGROUND: AMBER,
    Reason.TWO_SURFACES: MAUVE,
    Reason.FOLDED: BLUE,
    Reason.GATE_EDGE: SKY,
    Reason.EVENTS_LOST: VERMILION,
    Reason.FEW_PHOTONS: GREY,
}
LIGHT_SPAN = 1e4  # of the brightest light to the darkest that is told from none
LIGHT_MARGIN = 1.5  # factor at both ends of the scale of light
NO_LIGHT = "#4f6d8f"  # no grey level: no estimate
SCALE_MARGIN = 0.05  # margin at both ends of the colour bar, relative to the range of depths


@frozen(eq=False)
class Panel:
    """A depth picture. depth_m: float64[rows, cols], NaN = no depth; reason: `belief.Reason`,
    uint8[rows, cols], if known.
    """

    title: str
    depth_m: np.ndarray
    reason: np.ndarray | None = None


def depth_row(
    path: FilePath,
    panels: Sequence[Panel],
    truth_m: np.ndarray,
    heading: str = "",
    *,
    blocks: tuple[str, np.ndarray] | None = None,
    tolerance_m: float = TOLERANCE_M,
) -> list[float]:
    """Write the figure of `draw_row` to `path` (.png or .svg); return the share of wrong pixels of
    each panel.
    """
    figure, shares = draw_row(panels, truth_m, heading, blocks=blocks, tolerance_m=tolerance_m)
    save_figure(figure, path)
    return shares


def draw_row(
    panels: Sequence[Panel],
    truth_m: np.ndarray,
    heading: str = "",
    *,
    blocks: tuple[str, np.ndarray] | None = None,
    tolerance_m: float = TOLERANCE_M,
    span_m: tuple[float, float] | None = None,
) -> tuple[Figure, list[float]]:
    """Draw the truth and `panels` side by side, at most five per row; return the figure, and each
    panel's wrong share.

    blocks: title and small integers [subgroups down, across]; the last panel shows them as numbers
    on the subgroups. All panels share one colour scale in metres. It spans the truth, or `span_m`;
    depths beyond it have the colour of the nearer end. Pixels without an estimate are grey; pixels
    without a truth also have a cross. Titles give the share of wrong pixels (`wrong_share`).
    """
    shares = [wrong_share(panel.depth_m, truth_m, tolerance_m) for panel in panels]
    near_m, far_m = span_m or (np.nanmin(truth_m), np.nanmax(truth_m))
    margin_m = max(SCALE_MARGIN * (far_m - near_m), tolerance_m)
    rows, cols = truth_m.shape
    height_in = PANEL_IN * rows / cols
    places = 1 + len(panels) + (blocks is not None)
    across = min(places, PANELS_ACROSS)
    down = -(-places // across)
    with style(axes_grid=False):
        figure = new_figure(
            PANEL_IN * across + 0.9, (height_in + 0.75) * down + (0.6 if heading else 0.35)
        )
        grid = figure.subplots(down, across, squeeze=False)
        axes = grid.ravel()
        colours = matplotlib.colormaps[DEPTH_MAP].with_extremes(bad=NO_VALUE)
        of_panels = axes[1 : 1 + len(panels)]
        for axis, panel in zip(
            (axes[0], *of_panels), (Panel("truth", truth_m), *panels), strict=True
        ):
            image = axis.imshow(
                panel.depth_m, cmap=colours, vmin=near_m - margin_m, vmax=far_m + margin_m
            )
            for row, col in np.argwhere(np.isnan(truth_m)):
                axis.plot(
                    [col - 0.3, col + 0.3], [row - 0.3, row + 0.3], color="black", linewidth=0.6
                )
                axis.plot(
                    [col - 0.3, col + 0.3], [row + 0.3, row - 0.3], color="black", linewidth=0.6
                )
            axis.set_title(panel.title)
            axis.set_xlabel("column")
            axis.spines[:].set_visible(False)
        for axis in grid[:, 0]:
            axis.set_ylabel("row")
        for axis in axes[places:]:
            axis.set_visible(False)
        if blocks is not None:
            _draw_blocks(axes[places - 1], *blocks, truth_m.shape)
        for axis, panel, share in zip(of_panels, panels, shares, strict=True):
            axis.set_title(f"{panel.title}\n{share:.1%} of pixels wrong")
            wrong = np.argwhere(wrong_pixels(panel.depth_m, truth_m, tolerance_m))
            frames = [Rectangle((col - 0.5, row - 0.5), 1, 1) for row, col in wrong]
            axis.add_collection(
                PatchCollection(frames, facecolor="none", edgecolor=ALARM, linewidth=0.5)
            )
            if panel.reason is not None:
                _draw_reasons(axis, panel.reason)
        figure.colorbar(image, ax=list(axes), label="depth in m", extend="both", pad=0.01)
        notes = f"red frames: wrong, |error| > {100 * tolerance_m:.3g} cm"
        if np.isnan(truth_m).any():
            notes += "; crosses: no truth, not counted"
        if any(axis.get_legend_handles_labels()[1] for axis in axes):
            legend_below(figure, len(REASONS))
            figure.legends[0].set_title(f"{notes}; dots: depth that is not to be believed")
        else:
            figure.supxlabel(notes, fontsize=9)
        if heading:
            figure.suptitle(heading, fontsize=12)
    return figure, shares


def light_row(
    path: FilePath, panels: Sequence[tuple[str, np.ndarray]], truth: np.ndarray, heading: str = ""
) -> None:
    """Write pictures of light side by side, the true one first, to `path` (.png or .svg).

    panels: titles and estimates, float64[rows, cols], photons per pulse, NaN = none (blue); truth:
    the same. All share one logarithmic scale of grey levels, which spans the truth; its titles give
    the median of estimate / truth.
    """
    lit = truth > 0
    brightest = truth.max() if lit.any() else 1.0
    darkest = max(truth[lit].min() if lit.any() else brightest, brightest / LIGHT_SPAN)
    least = darkest / LIGHT_MARGIN
    scale = LogNorm(least, brightest * LIGHT_MARGIN)
    rows, cols = truth.shape
    across = 1 + len(panels)
    with style(axes_grid=False):
        figure = new_figure(PANEL_IN * across + 0.9, PANEL_IN * rows / cols + 1.1)
        axes = figure.subplots(1, across, squeeze=False)[0]
        colours = matplotlib.colormaps["gray"].with_extremes(bad=NO_LIGHT)
        for axis, (title, light) in zip(axes, (("truth", truth), *panels), strict=True):
            shown = np.where(np.isnan(light), np.nan, np.maximum(light, least))
            image = axis.imshow(shown, cmap=colours, norm=scale)
            known = lit & ~np.isnan(light)
            told = title
            if light is not truth and known.any():
                ratio = np.median(light[known] / truth[known])
                told = f"{title}\nmedian of estimate / truth {ratio:.2f}"
            axis.set_title(told)
            axis.set_xlabel("column")
            axis.spines[:].set_visible(False)
        axes[0].set_ylabel("row")
        figure.colorbar(image, ax=list(axes), label="photons per pulse", extend="both", pad=0.01)
        if heading:
            figure.suptitle(heading, fontsize=12)
    save_figure(figure, path)


def _draw_reasons(axis: Axes, reason: np.ndarray) -> None:
    """Mark the pixels whose depth is not to be believed, by reason."""
    for one, colour in REASONS.items():
        row, col = np.nonzero(reason == one)
        if len(row):
            told = SENTENCES[one].partition(":")[0]
            axis.plot(col, row, "o", color=colour, markersize=2.5, markeredgewidth=0, label=told)


def _draw_blocks(axis: Axes, title: str, blocks: np.ndarray, shape: tuple[int, ...]) -> None:
    """Draw numbers on the subgroups of the array; higher numbers are darker."""
    rows, cols = shape
    extent = (-0.5, cols - 0.5, rows - 0.5, -0.5)
    axis.imshow(blocks, cmap=BLOCK_MAP, vmin=0, vmax=BLOCK_MAX, extent=extent)
    for (i, j), value in np.ndenumerate(blocks):
        x, y = (j + 0.5) * cols / blocks.shape[1] - 0.5, (i + 0.5) * rows / blocks.shape[0] - 0.5
        axis.text(x, y, str(value), ha="center", va="center", color="black")
    axis.set_title(title)
    axis.set_xlabel("column")
    axis.spines[:].set_visible(False)
