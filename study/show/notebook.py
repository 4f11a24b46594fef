# SPDX-License-Identifier: Apache-2.0
"""Shows a run in a notebook: a self-contained summary, and the figures of the explorer, each in a
frame without network.
"""

import base64
from collections.abc import Callable
from functools import partial
from html import escape
from typing import Any

import numpy as np
from attrs import frozen

from ...lab.outcomes import Run
from ...model.depth.histograms import pixel_histogram
from ...model.depth.methods import Method
from ...model.shared.errors import InputError, check_integer, extra
from ...model.shared.files import FilePath, check_suffix, whole_file
from ..pictures import Panel, draw_row
from ..plot_style import figure_bytes
from .assets import FILES
from .frame_content import FrameView
from .words import number_rows, story

# of all views, in the widest and in the narrowest output of a notebook in which nothing is cut
PLOT_HEIGHT_PX = 1360


@frozen
class Shown:
    """A page that displays itself in a notebook. html: self-contained; height_px: height of its
    frame.
    """

    html: str
    height_px: int

    def _repr_html_(self) -> str:
        return f'<iframe srcdoc="{escape(self.html)}" style="width: 100%; height: {self.height_px}px; border: 0"></iframe>'

    def save(self, path: FilePath) -> None:
        """Write the page, whole or not at all. Raises `InputError` for another suffix than
        .html.
        """
        check_suffix(path, ".html")
        with whole_file(path, "w") as file:
            file.write(self.html)


def run_view(run: Run, frame: int = 0, method: Method | None = None) -> FrameView:
    """Return the view of a frame of a run. method: None is the first estimator of the run. Raises `InputError`."""
    frame = check_integer("frame", frame, 0, run.config.frames - 1)
    return FrameView(f"frame {frame}", run.frame(frame, method))


def summary(run: Run) -> str:
    """Return HTML with truth, depth and numbers of the first frame."""
    view = run_view(run)
    figure, _ = draw_row([Panel("depth", view.depth_m, view.reason)], view.truth_m, run.scene.name)
    picture = base64.b64encode(figure_bytes(figure, "png")).decode()
    rows = "".join(
        f"<tr><td>{escape(label)}</td><td>{escape(value)}</td></tr>"
        for label, value in number_rows(view)
    )
    return (
        f'<p>{escape(story(view))}</p><img alt="truth and depth" src="data:image/png;base64,{picture}">'
        f"<table>{rows}</table>"
    )


def plot(run: Run, frame: int = 0, method: Method | None = None) -> Shown:
    """Return all views of a frame, linked as in `report.html`."""
    with extra("explore"):
        from .report import report_html

    html = report_html(run.scene.name, [run_view(run, frame, method)])
    return Shown(html, PLOT_HEIGHT_PX)


class PixelHistogram(np.ndarray):
    """`pixel_histogram` of a run, int32[period_ticks]. A notebook draws it with truth, candidates
    and the chosen return.
    """

    draw: Callable[[], Shown] | None  # None for arrays computed from it

    @classmethod
    def of(
        cls, run: Run, pixel: int, *, source: str = "map", frame: int | None = None
    ) -> "PixelHistogram":
        """Return the histogram of pixel row * cols + column. frame None: hits of all frames, drawn
        with the depth of the first.
        """
        hits = pixel_histogram(run.result, run.config, pixel, source=source, frame=frame).view(cls)
        hits.draw = partial(plot_histogram, run, pixel, frame or 0)
        return hits

    def __array_finalize__(self, other: object) -> None:
        self.draw = None

    def __repr__(self) -> str:
        """Return one line about a whole histogram; arrays that are computed from it show their
        numbers.
        """
        if self.draw is None:
            return super().__repr__()
        hits = np.asarray(self)
        return f"<PixelHistogram: {hits.sum()} hits in {len(hits)} ticks, {hits.max()} at most>"

    def _repr_html_(self) -> str | None:
        """Return the picture; None if there is none, and then a notebook prints the array."""
        try:
            return None if self.draw is None else self.draw()._repr_html_()
        except InputError:  # the extra `explore` is not installed
            return None


def plot_histogram(run: Run, pixel: int, frame: int = 0, method: Method | None = None) -> Shown:
    """Return a pixel's histogram with truth, candidates and the chosen return; pixel = row * cols + column."""
    with extra("explore"):
        from .figures import HistogramFigure

    view = run_view(run, frame, method)
    pixel = check_integer("pixel", pixel, 0, view.config.sensor.array_pixels - 1)
    one = HistogramFigure(width=860, height=300)
    one.show(view, *divmod(pixel, view.config.sensor.cols))
    return _page([one.figure], 320)


def plot_timeline(run: Run, subgroup: int, pulse: int, frame: int = 0) -> Shown:
    """Return one laser period of a subgroup: edges with their fates, windows, gate, commits,
    FIFO.
    """
    subgroup = check_integer("subgroup", subgroup, 0, run.config.sensor.subgroups - 1)
    pulse = check_integer("pulse", pulse, 0, run.config.pulses - 1)
    with extra("explore"):
        from .figures import TimelineFigure

    one = TimelineFigure(width=860, height=380)
    one.show(run_view(run, frame), subgroup, pulse)
    return _page([one.figure, one.below], 400)


def _page(figures: list[Any], height_px: int) -> Shown:
    from bokeh.embed import file_html
    from bokeh.resources import INLINE

    head = f"<style>{FILES['page.css']}</style><script>{FILES['tables.js']}</script>"
    template = "{% block postamble %}" + head + "{% endblock %}"
    return Shown(file_html(figures, INLINE, "Coincid", template=template), height_px)
