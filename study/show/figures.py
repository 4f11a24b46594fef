# SPDX-License-Identifier: Apache-2.0
"""Draws the views of a frame as linked Bokeh figures: maps, the histogram of a pixel, one laser
period of a subgroup.

The same figures appear in the explorer, in `report.html` and in notebooks. Axes and texts have
colours that are CSS variables of the page (`study/show/page.css`), so they follow its theme. Fates
and verdicts also differ in shape or hatching. Their colours are those of Okabe and Ito, and the
maps use viridis and cividis, which colour-blind people can read.
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from bokeh.events import DoubleTap, Press, Tap
from bokeh.models import (
    BasicTicker,
    ColorBar,
    ColumnDataSource,
    CustomJS,
    FixedTicker,
    HoverTool,
    Legend,
    LegendItem,
    LinearAxis,
    LinearColorMapper,
    PanTool,
    Range1d,
    ResetTool,
    WheelZoomTool,
)
from bokeh.models.glyphs import Glyph, Image, Quad, Rect, Scatter, Step, Text, VAreaStep, VSpan
from bokeh.models.renderers import GlyphRenderer
from bokeh.palettes import Cividis256, Viridis256, cividis
from bokeh.plotting import figure

from ...model.contract.edges import Fate
from ...model.contract.pixels import pixel_table
from ...model.depth.belief import SENTENCES, Reason
from ...model.depth.quality import TOLERANCE_M
from ...model.shared.constants import SPEED_OF_LIGHT_M_S
from ..palette import (
    AMBER,
    BLUE,
    GREY,
    LABEL_PX,
    MAUVE,
    NO_VALUE_ON_PAGE,
    PAGE_INK,
    SKY,
    TEAL,
    TEXT_PX,
    TITLE_PX,
    VERMILION,
)
from ..pictures import REASONS
from .frame_content import HISTOGRAM_BIN_M, FrameView
from .timeline import Period, Verdict

Columns: TypeAlias = dict[str, Any]  # columns of a Bokeh data source

STYLESHEET = """
:host {
  --bk-outline-line-color: var(--line);
  --bk-axis-label-text-color: var(--ink); --bk-major-label-text-color: var(--ink); --bk-title-text-color: var(--ink);
  --bk-axis-line-color: var(--line); --bk-major-tick-line-color: var(--line); --bk-minor-tick-line-color: var(--line);
  --bk-grid-line-color: var(--line); --bk-text-color: var(--ink);
}
"""
ON_PAGE: dict[str, Any] = {  # for all figures: as wide as the page allows, and in its colours
    "sizing_mode": "stretch_width",
    "stylesheets": [STYLESHEET],
    "background_fill_color": None,
    "border_fill_color": None,
}
FATES = {  # of an edge: (colour, marker, meaning)
    Fate.OPENING: (VERMILION, "triangle", "opened a window"),
    Fate.COUNTED: (BLUE, "circle", "counted in a window"),
    Fate.DUPLICATE: (SKY, "x", "the pixel was counted already"),
    Fate.MASKED: (GREY, "dash", "pixel masked off"),
    Fate.GATED: (AMBER, "square_pin", "outside the gate"),
    Fate.BLIND: (MAUVE, "inverted_triangle", "tree not armed"),
}
VERDICTS = {  # of a window: (colour, hatching, meaning)
    Verdict.COMMITTED: (TEAL, " ", "committed"),
    Verdict.REJECTED: (GREY, "/", "rejected: too few pixels"),
    Verdict.DROPPED: (VERMILION, "x", "dropped: FIFO full"),
}
_SHAPES = {
    "triangle": "▲",
    "circle": "●",
    "x": "×",
    "dash": "▬",
    "square_pin": "■",
    "inverted_triangle": "▼",
}
FATE_MARKS = [
    (_SHAPES[marker], colour, meaning) for colour, marker, meaning in FATES.values()
]  # of the key beside the figures
REASON_MARKS = [
    ("■", colour, SENTENCES[reason].partition(":")[0]) for reason, colour in REASONS.items()
]
VERDICT_MARKS = [
    (sign, colour, meaning)
    for sign, (colour, _, meaning) in zip("▌▨▩", VERDICTS.values(), strict=True)
]
TRUTH, CHOSEN, OTHER = VERMILION, TEAL, SKY
ERROR_PALETTE = tuple(  # blue, white, orange: too near, right, too far
    "#" + "".join(f"{round(a + (b - a) * share):02x}" for a, b in zip(start, end, strict=True))
    for start, end in (((0, 114, 178), (247, 247, 247)), ((247, 247, 247), (213, 94, 0)))
    for share in np.linspace(0, 1, 64)
)
ERROR_SHOWN_M = 0.5  # the colour saturates here
COUNTS = ("threshold", "drops")  # maps of whole numbers
LIGHT = (
    "reflectivity",
    "signal",
    "estimated",
    "estimated_error",
    "background",
    "bound_mm",
)  # further values of a pixel under the mouse
WHOLE_COLOURS_MAX = 8  # up to this value, each whole number has a colour of its own
COMPARED = ("depth_m", "error_m", "drops")  # maps that are shown when two frames are compared
MAP_SIZE_PX, BAR_WIDTH_PX, BAR_AND_LABELS_PX = 168, 8, 44
DEPTH_MARGIN = 0.05  # margin at both ends of the colour scale, relative to the range of the truth
# clicks on a map: Bokeh tells the second of two quick ones, and a slow one, as other events
CLICKS = (Tap, DoubleTap, Press)
CHOICE_MARKS = ("diamond", "circle")  # the chosen return, the others
# clear where the depth is believed
REASON_PALETTE = tuple(REASONS.get(reason, "#00000000") for reason in Reason)
_SENTENCES = "|".join(SENTENCES[reason] for reason in Reason)


MAPS: dict[str, tuple[str, tuple[str, ...]]] = {  # attribute of `FrameView`: title, palette
    "truth_m": ("truth, m", Viridis256[::-1]),
    "depth_m": ("depth, m", Viridis256[::-1]),
    "error_m": ("error, m", ERROR_PALETTE),
    "threshold": ("threshold, pixels", Cividis256),
    "drops": ("drops, events", Cividis256),
    "confidence": ("confidence, or why not", Cividis256),
}


def map_columns(view: FrameView) -> Columns:
    """Return the columns of the maps: one row, in which each column holds a picture."""
    sensor = view.config.sensor
    row, col = np.indices((sensor.rows, sensor.cols))
    with np.errstate(over="ignore"):  # a bound without light is beyond any float32
        pictures = {name: getattr(view, name).astype(np.float32) for name in (*MAPS, *LIGHT)}
    subgroup = pixel_table(sensor).subgroup.reshape(row.shape)
    pictures |= {
        "row": row.astype(np.int32),
        "col": col.astype(np.int32),
        "subgroup": subgroup.astype(np.int32),
    }
    pictures["reason"] = view.reason.astype(np.int32)
    where = {
        "x": [-0.5],
        "y": [-0.5],
        "dw": [sensor.cols],
        "dh": [sensor.rows],
        "sentences": [_SENTENCES],
    }
    return {name: [picture] for name, picture in pictures.items()} | where


def map_scales(views: list[FrameView]) -> dict[str, tuple[float, float]]:
    """Return (low, high) of the colour scale of each map; all `views` share it, so they can be
    compared.
    """
    near_m = min(
        (np.nanmin(view.truth_m) for view in views if not np.isnan(view.truth_m).all()), default=0.0
    )
    far_m = max(
        (np.nanmax(view.truth_m) for view in views if not np.isnan(view.truth_m).all()), default=1.0
    )
    margin_m = max(DEPTH_MARGIN * (far_m - near_m), TOLERANCE_M)
    depth = (near_m - margin_m, far_m + margin_m)
    return {
        "truth_m": depth,
        "depth_m": depth,
        "error_m": (-ERROR_SHOWN_M, ERROR_SHOWN_M),
        "threshold": (0, max(2.0, *(view.threshold.max() for view in views))),
        "drops": (0, max(1.0, *(view.drops.max() for view in views))),
        "confidence": (0, 1),
    }


def cursor_columns(view: FrameView, row: int, col: int) -> tuple[Columns, Columns]:
    """Return the columns of two rectangles: around the pixel, and around its subgroup."""
    height, width = view.config.sensor.subgroup
    top, left = row // height * height, col // width * width
    pixel = {"x": [col], "y": [row], "w": [1], "h": [1]}
    around = {
        "x": [left + (width - 1) / 2],
        "y": [top + (height - 1) / 2],
        "w": [width],
        "h": [height],
    }
    return pixel, around


class MapFigure:
    """A map of the array that reacts to the mouse. shows: key of `MAPS`; name: of the figure;
    source: holds `map_columns`.
    """

    def __init__(
        self,
        shows: str,
        name: str,
        source: ColumnDataSource,
        cursor: ColumnDataSource,
        around: ColumnDataSource,
    ) -> None:
        self.shows, (self._title, self._full_palette) = shows, MAPS[shows]
        over = CustomJS(args={"source": source}, code="overMap(source, cb_data.geometry)")
        touched = CustomJS(args={"source": source}, code="overMap(source, cb_obj)")
        self._palette = self._full_palette
        self.mapper = LinearColorMapper(
            palette=self._palette, low=0, high=1, nan_color=NO_VALUE_ON_PAGE
        )
        self.figure = plot = figure(
            title=self._title,
            width=MAP_SIZE_PX + BAR_AND_LABELS_PX,
            height=MAP_SIZE_PX + 20,
            max_width=MAP_SIZE_PX + BAR_AND_LABELS_PX,
            x_range=Range1d(-0.5, 31.5),
            y_range=Range1d(31.5, -0.5),
            x_axis_type=None,
            y_axis_type=None,
            tools=[HoverTool(tooltips=None, callback=over)],
            toolbar_location=None,
            name=name,
            **ON_PAGE,
        )
        for click in CLICKS:  # a finger never hovers
            plot.js_on_event(click, touched)
        plot.title.text_font_size = TITLE_PX
        plot.min_border = 4
        # room for the labels of any scale, so that all maps have one size
        plot.min_border_right = BAR_AND_LABELS_PX
        image = _draw(plot, source, _picture(shows, self.mapper))
        plot.hover.renderers = [image]
        if shows == "confidence":
            why = LinearColorMapper(
                palette=REASON_PALETTE, low=-0.5, high=len(REASON_PALETTE) - 0.5
            )
            _draw(plot, source, _picture("reason", why))
        for frame, dash in ((around, "dashed"), (cursor, "solid")):
            for colour, line in (("black", 3), ("white", 1.2)):
                frame_glyph = Rect(
                    x="x",
                    y="y",
                    width="w",
                    height="h",
                    fill_color=None,
                    line_color=colour,
                    line_width=line,
                    line_dash=dash,
                )
                _draw(plot, frame, frame_glyph)
        bar = ColorBar(
            color_mapper=self.mapper,
            ticker=BasicTicker(desired_num_ticks=5, min_interval=1 if shows in COUNTS else 0),
            width=BAR_WIDTH_PX,
            # Bokeh 3.9 draws them beside the bar after a change of the page's width
            major_tick_in=0,
            padding=2,
            major_label_text_font_size=TEXT_PX,
            background_fill_color=None,
            major_label_text_color=PAGE_INK,
        )
        plot.add_layout(bar, "right")

    def show(self, view: FrameView, scale: tuple[float, float], prefix: str = "") -> None:
        """Set title, colours and ranges for `view`, whose columns are set separately. scale: (low,
        high) of the colours.
        """
        self.figure.title.text = prefix + self._title
        (low, high), palette = scale, self._full_palette
        if self.shows in COUNTS and high <= WHOLE_COLOURS_MAX:
            low, high, palette = low - 0.5, high + 0.5, cividis(int(high) + 1)
        if self._palette != palette:  # because Bokeh checks every colour
            self._palette = self.mapper.palette = palette
        self.mapper.update(low=low, high=high)
        sensor = view.config.sensor
        self.figure.x_range.update(start=-0.5, end=sensor.cols - 0.5)
        self.figure.y_range.update(start=sensor.rows - 0.5, end=-0.5)


def _picture(name: str, mapper: LinearColorMapper) -> Image:
    """Return the glyph of one of the pictures of `map_columns`."""
    return Image(image=name, x="x", y="y", dw="dw", dh="dh", color_mapper=mapper)


def _draw(plot: figure, source: ColumnDataSource, glyph: Glyph) -> GlyphRenderer:
    """Add a glyph to a figure.

    Nothing on these pages can be selected or muted. Bokeh would prepare every glyph for it twice
    more, here and in the browser.
    """
    never_drawn = {"selection_glyph": None, "nonselection_glyph": None, "muted_glyph": None}
    return plot.add_glyph(source, glyph, **never_drawn)


def histogram_columns(view: FrameView, row: int, col: int) -> tuple[Columns, Columns, Columns]:
    """Return the columns (bars, returns, truth) of a pixel's histogram; distances are in metres."""
    of_pixel, of_subgroup = view.histogram(row, col)
    left = np.arange(len(of_pixel)) * HISTOGRAM_BIN_M
    bars = {
        "left": left,
        "right": left + HISTOGRAM_BIN_M,
        "pixel": of_pixel,
        "subgroup": of_subgroup,
    }
    known = ~np.isnan(view.candidate_m[row, col])
    at_m, confidence = view.candidate_m[row, col][known], view.candidate_confidence[row, col][known]
    truth_m = float(view.truth_m[row, col])
    return bars, return_columns(at_m, confidence), {"x": [] if np.isnan(truth_m) else [truth_m]}


def return_columns(at_m: np.ndarray, confidence: np.ndarray) -> Columns:
    """Return the columns of a pixel's returns, the chosen one first."""
    chosen = np.arange(len(at_m)) == 0
    return {
        "x": at_m,
        "confidence": confidence,
        "colour": np.where(chosen, CHOSEN, OTHER).tolist(),
        "marker": np.where(chosen, *CHOICE_MARKS).tolist(),
        "what": np.where(chosen, "chosen", "also possible").tolist(),
    }


def _axes_figure(**options: Any) -> figure:
    """Return a figure with an inner toolbar, which can be moved and zoomed along its x axis."""
    plot = figure(
        x_range=Range1d(0, 1),
        y_range=Range1d(0, 1),
        tools=[PanTool(dimensions="width"), WheelZoomTool(dimensions="width"), ResetTool()],
        toolbar_location="right",
        **ON_PAGE,
        **options,
    )
    plot.toolbar.update(logo=None, autohide=True)
    plot.toolbar_inner = True
    plot.title.text_font_size = TITLE_PX
    plot.grid.visible = False
    return plot


class HistogramFigure:
    """The events of a pixel over distance; behind them, in grey and with an own scale, the events
    of its subgroup.
    """

    def __init__(self, width: int = 480, height: int = 226):
        self.bars = ColumnDataSource({"left": [], "right": [], "pixel": [], "subgroup": []})
        self.returns = ColumnDataSource(return_columns(np.empty(0), np.empty(0)))
        self.truth = ColumnDataSource({"x": []})
        self.figure = plot = _axes_figure(
            title="click a pixel",
            width=width,
            height=height,
            x_axis_label="distance in m",
            y_axis_label="events of the pixel",
            active_scroll=None,
            name="histogram",
        )
        self.subgroup_range = Range1d(0, 1)
        plot.extra_y_ranges = {"subgroup": self.subgroup_range}
        plot.add_layout(
            LinearAxis(
                y_range_name="subgroup",
                axis_label="events of its subgroup",
                stylesheets=[STYLESHEET],
            ),
            "right",
        )
        behind = _draw(
            plot,
            self.bars,
            Quad(
                left="left",
                right="right",
                top="subgroup",
                bottom=0,
                fill_color=GREY,
                fill_alpha=0.6,
                line_color=None,
            ),
        )
        behind.y_range_name = "subgroup"
        bars = _draw(
            plot,
            self.bars,
            Quad(
                left="left", right="right", top="pixel", bottom=0, fill_color=BLUE, line_color=BLUE
            ),
        )
        truth = _draw(
            plot,
            self.truth,
            VSpan(x="x", line_color=TRUTH, line_width=2, line_dash="dashed"),
        )
        marks = _draw(
            plot,
            self.returns,
            Scatter(
                x="x", y=0.0, marker="marker", size=12, fill_color="colour", line_color="black"
            ),
        )
        plot.add_tools(
            HoverTool(renderers=[bars], tooltips=[("distance", "@left{0.00} to @right{0.00} m"), ("pixel", "@pixel"), ("subgroup", "@subgroup")]),
            HoverTool(renderers=[marks], tooltips=[("@what", "@x{0.000} m, confidence @confidence{0.00}")]),
        )  # fmt: skip
        _add_legend(
            plot, {"subgroup": behind, "pixel": bars, "truth": truth, "chosen return": marks}
        )

    def show(self, view: FrameView, row: int, col: int) -> None:
        bars, returns, truth = histogram_columns(view, row, col)
        self.bars.data, self.returns.data, self.truth.data = bars, returns, truth
        self.figure.title.text = histogram_title(view, row, col)
        for name, span in (("pixel", self.figure.y_range), ("subgroup", self.subgroup_range)):
            most = max(3, int(bars[name].max(initial=0)))
            span.update(start=-0.12 * most, end=1.15 * most)
        far_m = (
            min(view.range_m, 1.5 * np.nanmax(view.truth_m))
            if not np.isnan(view.truth_m).all()
            else view.range_m
        )
        self.figure.x_range.update(
            start=0, end=float(far_m), reset_start=0, reset_end=float(view.range_m)
        )


def histogram_title(view: FrameView, row: int, col: int) -> str:
    truth_m, depth_m = view.truth_m[row, col], view.depth_m[row, col]
    truth = "no truth" if np.isnan(truth_m) else f"truth {truth_m:.2f} m"
    depth = "no depth" if np.isnan(depth_m) else f"depth {depth_m:.2f} m"
    return f"row {row}, column {col}: {truth}, {depth}"


def light_columns(view: FrameView, subgroup: int) -> Columns:
    """Return the columns with the expected arrival of the laser light at each pixel, in ns after
    the trigger.
    """
    table = pixel_table(view.config.sensor)
    chosen = (table.subgroup == subgroup) & ~np.isnan(view.truth_m.ravel())
    return {"x": 2e9 / SPEED_OF_LIGHT_M_S * view.truth_m.ravel()[chosen], "y": table.inside[chosen]}


def commit_mark(verdict: Verdict) -> str:
    """Return the marker below a window's commit, at the FIFO."""
    return {Verdict.COMMITTED: "inverted_triangle", Verdict.DROPPED: "x", Verdict.REJECTED: "dot"}[
        verdict
    ]


def period_columns(view: FrameView, period: Period) -> tuple[Columns, Columns, Columns, Columns]:
    """Return the columns (edges, windows, gate, fill) of one laser period; times are in ns after
    the trigger.
    """
    sensor = view.config.sensor
    tick_ns = view.config.tick_s * 1e9
    cycle_ns = tick_ns * sensor.phases
    fates = [Fate(f) for f in period.fate]
    edges = {
        "x": (period.tick + 0.5) * tick_ns,
        "y": period.pixel,
        "colour": [FATES[f][0] for f in fates],
        "marker": [FATES[f][1] for f in fates],
        "fate": [FATES[f][2] for f in fates],
    }
    windows, top = period.windows, sensor.pixels - 0.5
    verdicts = [Verdict(v) for v in windows.verdict]
    bars = {
        "left": windows.start * tick_ns,
        "right": windows.end * tick_ns,
        "middle": (windows.start + windows.end) / 2 * tick_ns,
        "top": np.full(len(verdicts), top),
        "count": windows.count,
        "colour": [VERDICTS[v][0] for v in verdicts],
        "hatch": [VERDICTS[v][1] for v in verdicts],
        "verdict": [VERDICTS[v][2] for v in verdicts],
        "commit": windows.commit * cycle_ns,
        "commit_mark": [commit_mark(v) for v in verdicts],
    }  # fmt: skip
    gate: Columns = {"left": [], "right": []}
    if period.gate_cycles is not None:
        first, end = period.gate_cycles
        gate = {
            "left": [0, end * cycle_ns],
            "right": [first * cycle_ns, view.config.period * cycle_ns],
        }
    fill = {
        "x": np.append(period.fill_cycle, view.config.period) * cycle_ns,
        "fill": np.append(period.fill, period.fill[-1]),
    }
    return edges, bars, gate, fill


class TimelineFigure:
    """One laser period of a subgroup: edges, windows, gate and commits above, the fill level of the
    FIFO below.
    """

    def __init__(self, width: int = 480, height: int = 226):
        self.edges = ColumnDataSource({name: [] for name in ("x", "y", "colour", "marker", "fate")})
        names = (
            "left",
            "right",
            "middle",
            "top",
            "count",
            "colour",
            "hatch",
            "verdict",
            "commit",
            "commit_mark",
        )
        self.windows = ColumnDataSource({name: [] for name in names})
        self.gate = ColumnDataSource({"left": [], "right": []})
        self.fill = ColumnDataSource(
            {"x": [0, 0], "fill": [0, 0]}
        )  # Bokeh 3.9 paints a stepped area without points forever
        self.light = ColumnDataSource({"x": [], "y": []})
        self.figure = plot = _axes_figure(
            title="click a subgroup",
            width=width,
            height=height - 80,
            y_axis_label="pixel",
            name="timeline",
        )
        plot.xaxis.visible = False
        gate = _draw(
            plot,
            self.gate,
            Quad(
                left="left",
                right="right",
                top=1e6,
                bottom=-1e6,
                fill_color=AMBER,
                fill_alpha=0.18,
                line_color=None,
            ),
        )
        gate.level = "underlay"
        bars = _draw(
            plot,
            self.windows,
            Quad(
                left="left",
                right="right",
                top="top",
                bottom=-0.5,
                fill_color="colour",
                fill_alpha=0.25,
                line_color="colour",
                hatch_pattern="hatch",
                hatch_color="colour",
                hatch_alpha=0.5,
                hatch_scale=8,
            ),
        )
        _draw(
            plot,
            self.windows,
            Text(
                x="middle",
                y="top",
                text="count",
                text_align="center",
                text_baseline="bottom",
                text_font_size=TEXT_PX,
                text_color="colour",
            ),
        )
        _draw(
            plot,
            self.light,
            Scatter(
                x="x",
                y="y",
                marker="dash",
                angle=np.pi / 2,
                size=5,
                line_color=GREY,
                line_width=2,
            ),
        )
        marks = _draw(
            plot,
            self.edges,
            Scatter(
                x="x", y="y", marker="marker", size=7, fill_color="colour", line_color="colour"
            ),
        )
        plot.add_tools(
            HoverTool(renderers=[marks], tooltips=[("edge", "pixel @y, @x{0.00} ns"), ("fate", "@fate")]),
            HoverTool(renderers=[bars], tooltips=[("window", "@left{0.0} to @right{0.0} ns"), ("count", "@count"), ("verdict", "@verdict")]),
        )  # fmt: skip
        self.below = figure(
            width=width,
            height=80,
            x_range=plot.x_range,
            y_range=Range1d(0, 1),
            x_axis_label="ns after the laser's trigger",
            y_axis_label="FIFO",
            tools=[],
            toolbar_location=None,
            name="fifo",
            **ON_PAGE,
        )
        self.below.grid.visible = False
        self.fill_ticker = FixedTicker(ticks=[])
        self.below.yaxis.ticker = self.fill_ticker
        _draw(
            self.below,
            self.fill,
            VAreaStep(x="x", y1=0, y2="fill", fill_color=BLUE, fill_alpha=0.4, step_mode="after"),
        )
        _draw(self.below, self.fill, Step(x="x", y="fill", mode="after", line_color=BLUE))
        _draw(
            self.below,
            self.windows,
            Scatter(
                x="commit",
                y=0,
                marker="commit_mark",
                size=8,
                fill_color="colour",
                line_color="colour",
            ),
        )
        for one in (plot, self.below):
            one.min_border_left = 50
            one.axis.axis_label_text_font_size = LABEL_PX

    def show(self, view: FrameView, subgroup: int, pulse: int) -> None:
        period = view.period(subgroup, pulse)
        edges, windows, gate, fill = period_columns(view, period)
        self.edges.data, self.windows.data, self.gate.data, self.fill.data = (
            edges,
            windows,
            gate,
            fill,
        )
        self.light.data = light_columns(view, subgroup)
        needed = f"{period.threshold} pixel{'s' * (period.threshold > 1)}"
        self.figure.title.text = f"subgroup {subgroup}, pulse {pulse}: a window needs {needed}"
        self.fit(view)

    def fit(self, view: FrameView) -> None:
        """Set the ranges for the sensor of `view`."""
        sensor = view.config.sensor
        end_ns = view.config.period_ticks * view.config.tick_s * 1e9
        self.figure.x_range.update(start=0, end=end_ns)
        self.figure.y_range.update(start=-1, end=sensor.pixels * 1.12)
        self.below.y_range.update(start=-0.15 * sensor.fifo_depth, end=1.1 * sensor.fifo_depth)
        self.fill_ticker.ticks = [0, sensor.fifo_depth]


def _add_legend(plot: figure, meanings: dict[str, GlyphRenderer]) -> None:
    """Add a legend above a figure. meanings: what each label stands for."""
    legend = Legend(
        items=[LegendItem(label=label, renderers=[drawn]) for label, drawn in meanings.items()],
        orientation="horizontal",
        label_text_font_size=TEXT_PX,
        glyph_height=12,
        glyph_width=12,
        label_height=12,
        margin=0,
        padding=0,
        spacing=8,
        background_fill_color=None,
        border_line_color=None,
        label_text_color=PAGE_INK,
    )
    plot.add_layout(legend, "above")


class Views:
    """All figures, linked: a click on a map selects a pixel and its subgroup. compared: adds maps
    of another frame, A.
    """

    def __init__(self, compared: bool = False) -> None:
        self.pictures, self.others = (ColumnDataSource(_no_picture()) for _ in range(2))
        self.cursor, self.around = (
            ColumnDataSource({name: [] for name in "xywh"}) for _ in range(2)
        )
        frames = self.cursor, self.around
        self.a_maps = [
            MapFigure(name, f"map_a_{name}", self.others, *frames)
            for name in (COMPARED if compared else ())
        ]
        self.maps = [MapFigure(name, f"map_{name}", self.pictures, *frames) for name in MAPS]
        self.histogram, self.timeline = HistogramFigure(), TimelineFigure()

    def roots(self) -> list[figure]:
        """All figures."""
        maps = [one.figure for one in (*self.a_maps, *self.maps)]
        return [*maps, self.histogram.figure, self.timeline.figure, self.timeline.below]

    def show(
        self,
        view: FrameView,
        other: FrameView | None = None,
        scales: dict[str, tuple[float, float]] | None = None,
    ) -> None:
        """Show all maps of a frame; with another frame, label them B and show the maps of A beside
        them.
        """
        scales = scales or map_scales([view] if other is None else [view, other])
        for one in self.maps:
            one.show(view, scales[one.shows], "" if other is None else "B: ")
        self.pictures.data = map_columns(view)
        if other is not None:
            for one in self.a_maps:
                one.show(other, scales[one.shows], "A: ")
            self.others.data = map_columns(other)

    def pick(self, view: FrameView, row: int, col: int, pulse: int) -> None:
        """Show the histogram of a pixel and a laser period of its subgroup."""
        self.cursor.data, self.around.data = cursor_columns(view, row, col)
        self.histogram.show(view, row, col)
        self.timeline.show(view, view.subgroup_of(row, col), pulse)

    def on_pick(self, picked: Callable[[int, int], None]) -> None:
        """Call picked(row, col) after a click, for pages with a server."""
        for one in (*self.a_maps, *self.maps):
            for click in CLICKS:
                one.figure.on_event(click, lambda event: picked(round(event.y), round(event.x)))

    def pick_in_page(self, code: CustomJS) -> None:
        """Run `code` after a click, for pages without a server."""
        for one in self.maps:
            for click in CLICKS:
                one.figure.js_on_event(click, code)


def _no_picture() -> Columns:
    names = (*MAPS, "reason", *LIGHT, "row", "col", "subgroup", "x", "y", "dw", "dh")
    return {name: [] for name in names}
