# SPDX-License-Identifier: Apache-2.0
"""Views of a pixel's histogram and of a laser period: everything on one axis, in its unit."""

from types import SimpleNamespace

import numpy as np
import pytest
from attrs import evolve
from bokeh.models import HoverTool, PanTool, ResetTool, WheelZoomTool

from coincid.model.contract.config import parse_config
from coincid.model.contract.edges import Fate
from coincid.model.contract.pixels import pixel_table
from coincid.study.show.figures import (
    CHOSEN,
    FATES,
    OTHER,
    VERDICTS,
    HistogramFigure,
    TimelineFigure,
    Views,
    cursor_columns,
    light_columns,
    period_columns,
)
from coincid.study.show.frame_content import HISTOGRAM_BIN_M
from coincid.study.show.timeline import Period, Verdict, Windows

CONFIG = parse_config(
    {
        "sensor": {
            "rows": 4,
            "cols": 8,
            "subgroup": [4, 4],
            "phases": 8,
            "window_max": 16,
            "fifo_depth": 4,
        },
        "frame": {"period": 50, "clock_mhz": 400},
    }
)
CYCLE_NS, TICK_NS = 2.5, 2.5 / 8
WINDOWS = Windows(
    start=np.array([16, 80, 160]),
    end=np.array([24, 88, 176]),
    count=np.array([3, 1, 5]),
    verdict=np.array([Verdict.COMMITTED, Verdict.REJECTED, Verdict.DROPPED], np.uint8),
    commit=np.array([12, 20, 32]),
)
PERIOD = Period(
    tick=np.array([16, 18, 80]),
    pixel=np.array([0, 15, 7]),
    fate=np.array([Fate.OPENING, Fate.COUNTED, Fate.BLIND], np.uint8),
    windows=WINDOWS,
    fill_cycle=np.array([0, 12, 40]),
    fill=np.array([2, 3, 1]),
    gate_cycles=(6, 44),
    threshold=2,
)
VIEW = SimpleNamespace(config=CONFIG)


def test_edges_windows_gate_and_fill_have_one_axis_in_ns():
    """Edges are in the middle of their ticks; the gate is what is closed."""
    edges, windows, gate, fill = period_columns(VIEW, PERIOD)
    assert edges["x"].tolist() == pytest.approx([16.5 * TICK_NS, 18.5 * TICK_NS, 80.5 * TICK_NS])
    assert edges["y"].tolist() == [0, 15, 7]
    assert windows["left"].tolist() == pytest.approx([5.0, 25.0, 50.0])
    assert windows["right"].tolist() == pytest.approx([7.5, 27.5, 55.0])
    assert windows["middle"].tolist() == pytest.approx([6.25, 26.25, 52.5])
    assert windows["commit"].tolist() == pytest.approx([30.0, 50.0, 80.0])
    assert (windows["commit"] > windows["right"]).all()
    assert windows["count"].tolist() == [3, 1, 5]
    assert gate == {"left": [0, 44 * CYCLE_NS], "right": [6 * CYCLE_NS, 50 * CYCLE_NS]}
    assert fill["x"].tolist() == pytest.approx([0.0, 30.0, 100.0, 125.0])
    assert fill["fill"].tolist() == [2, 3, 1, 1]


def test_fates_and_verdicts_have_their_own_marks():
    edges, windows, _, _ = period_columns(VIEW, PERIOD)
    fates = [FATES[fate] for fate in (Fate.OPENING, Fate.COUNTED, Fate.BLIND)]
    assert list(zip(edges["colour"], edges["marker"], edges["fate"], strict=True)) == fates
    shown = list(zip(windows["colour"], windows["hatch"], windows["verdict"], strict=True))
    assert shown == [VERDICTS[verdict] for verdict in Verdict]
    assert len(set(windows["commit_mark"])) == 3
    assert windows["commit_mark"][2] == "x"


def test_without_gating_nothing_is_closed():
    _, _, gate, _ = period_columns(VIEW, evolve(PERIOD, gate_cycles=None))
    assert gate == {"left": [], "right": []}


def test_light_of_a_pixel_arrives_there_and_back():
    """15 m away, 100 ns later, in the rows of the subgroup's pixels with a truth."""
    truth_m = np.full((4, 8), 14.9896229)
    truth_m[1, 5] = np.nan
    view = SimpleNamespace(config=CONFIG, truth_m=truth_m)
    table = pixel_table(CONFIG.sensor)
    for subgroup, number in ((0, 16), (1, 15)):
        columns = light_columns(view, subgroup)
        assert columns["x"].tolist() == pytest.approx([100.0] * number)
        own = set(range(16)) - ({int(table.inside[8 + 5])} if subgroup else set())
        assert set(columns["y"].tolist()) == own


def pixel_view(truth_m=9.0, far_m=12.0, range_m=20.0):
    """Return a view of a pixel with two returns, in a picture up to `far_m`."""
    truths_m = np.full((4, 8), far_m)
    truths_m[2, 3] = truth_m
    candidates_m = np.full((4, 8, 3), np.nan)
    candidates_m[2, 3, :2] = 8.5, 3.5
    bins = round(range_m / HISTOGRAM_BIN_M)
    of_pixel, of_subgroup = np.zeros(bins, int), np.zeros(bins, int)
    of_pixel[4], of_subgroup[4], of_subgroup[6] = 10, 50, 200
    return SimpleNamespace(
        config=CONFIG,
        truth_m=truths_m,
        depth_m=candidates_m[:, :, 0],
        candidate_m=candidates_m,
        candidate_confidence=np.full((4, 8, 3), 0.25),
        range_m=range_m,
        histogram=lambda row, col: (of_pixel, of_subgroup),
    )


def test_both_histograms_of_a_pixel_fill_their_own_scale():
    drawn = HistogramFigure()
    drawn.show(pixel_view(), 2, 3)
    for span, most in ((drawn.figure.y_range, 10), (drawn.subgroup_range, 200)):
        assert most < span.end < 1.3 * most
        assert -0.3 * most < span.start < 0
        assert span.start / span.end == pytest.approx(
            drawn.figure.y_range.start / drawn.figure.y_range.end
        )
    bars = drawn.bars.data
    assert bars["left"][4] == pytest.approx(4 * HISTOGRAM_BIN_M)
    assert (bars["right"] - bars["left"]).tolist() == pytest.approx(
        [HISTOGRAM_BIN_M] * len(bars["left"])
    )
    assert (bars["pixel"][4], bars["subgroup"][6]) == (10, 200)


def test_histograms_without_an_event_have_room_for_a_few():
    """As those of a pixel in the dark."""
    view = pixel_view()
    view.histogram = lambda row, col: (np.zeros(8, int), np.zeros(8, int))
    drawn = HistogramFigure()
    drawn.show(view, 2, 3)
    for span in (drawn.figure.y_range, drawn.subgroup_range):
        assert span.start < 0 and 3 < span.end < 4


def test_each_histogram_of_a_pixel_stands_on_the_axis_with_its_name():
    """The scale of the pixel is on the left, that of its subgroup on the right."""
    drawn = HistogramFigure()
    plot = drawn.figure
    bars = {one.glyph.top: one for one in plot.renderers if one.data_source is drawn.bars}
    assert bars.keys() == {"pixel", "subgroup"}
    assert bars["pixel"].y_range_name == "default"
    assert plot.extra_y_ranges[bars["subgroup"].y_range_name] is drawn.subgroup_range
    (left,), (right,) = plot.left, plot.right
    assert (left.axis_label, left.y_range_name) == ("events of the pixel", "default")
    assert right.axis_label == "events of its subgroup"
    assert right.y_range_name == bars["subgroup"].y_range_name
    assert plot.below[0].axis_label == "distance in m"
    for name, one in bars.items():
        assert (one.glyph.left, one.glyph.right, one.glyph.bottom) == ("left", "right", 0)
        labels = [item.label.value for item in plot.legend[0].items if one in item.renderers]
        assert labels == [name]


@pytest.mark.parametrize("drawn", [HistogramFigure, TimelineFigure])
def test_distance_and_time_can_be_moved_and_zoomed_and_nothing_else(drawn):
    plot = drawn().figure
    for tool in (PanTool, WheelZoomTool):
        assert [one.dimensions for one in plot.select(type=tool)] == ["width"]
    assert len([*plot.select(type=ResetTool)]) == 1


def test_what_is_told_over_a_bar_or_a_return_is_its_own():
    drawn = HistogramFigure()
    tools = {one.renderers[0].data_source: one for one in drawn.figure.select(type=HoverTool)}
    assert tools.keys() == {drawn.bars, drawn.returns}
    told = dict(tools[drawn.bars].tooltips)
    assert told["distance"].startswith("@left") and "to @right" in told["distance"]
    assert (told["pixel"], told["subgroup"]) == ("@pixel", "@subgroup")
    ((what, values),) = tools[drawn.returns].tooltips
    assert what == "@what" and values.startswith("@x") and "confidence @confidence" in values


def test_the_histogram_tells_the_returns_and_the_truth():
    drawn = HistogramFigure()
    drawn.show(pixel_view(), 2, 3)
    returns = drawn.returns.data
    assert returns["x"].tolist() == [8.5, 3.5]
    assert returns["what"] == ["chosen", "also possible"]
    assert returns["colour"] == [CHOSEN, OTHER]
    assert drawn.truth.data == {"x": [9.0]}
    assert drawn.figure.title.text == "row 2, column 3: truth 9.00 m, depth 8.50 m"
    drawn.show(pixel_view(truth_m=np.nan), 2, 3)
    assert drawn.truth.data == {"x": []}
    assert "no truth" in drawn.figure.title.text


@pytest.mark.parametrize(("far_m", "shown_m"), [(12.0, 18.0), (16.0, 20.0), (np.nan, 20.0)])
def test_the_histogram_shows_the_scene_and_no_more_than_the_range(far_m, shown_m):
    drawn = HistogramFigure()
    drawn.show(pixel_view(truth_m=far_m, far_m=far_m), 2, 3)
    assert drawn.figure.x_range.end == pytest.approx(shown_m)
    assert drawn.figure.x_range.reset_end == 20.0


def period_view(threshold=2):
    """Return a view whose subgroups and pulses all have `PERIOD`."""
    period = evolve(PERIOD, threshold=threshold)
    truth_m = np.arange(32.0).reshape(4, 8)
    return SimpleNamespace(config=CONFIG, truth_m=truth_m, period=lambda subgroup, pulse: period)


@pytest.mark.parametrize(("threshold", "told"), [(1, "1 pixel"), (2, "2 pixels")])
def test_the_title_of_a_period_tells_its_place_and_its_threshold(threshold, told):
    drawn = TimelineFigure()
    drawn.show(period_view(threshold), 1, 3)
    assert drawn.figure.title.text == f"subgroup 1, pulse 3: a window needs {told}"


def test_a_period_fills_its_axes():
    """Time is that of the period, above and below; beside it all pixels, and the whole FIFO."""
    drawn = TimelineFigure()
    drawn.show(period_view(), 1, 3)
    across, pixels, fill = drawn.figure.x_range, drawn.figure.y_range, drawn.below.y_range
    assert drawn.below.x_range is across
    assert (across.start, across.end) == (0, pytest.approx(125.0))
    depth = CONFIG.sensor.fifo_depth
    for span, last in ((pixels, 15.5), (fill, depth)):
        assert -0.2 * last < span.start < 0 and last < span.end < 1.3 * last
    assert drawn.below.yaxis[0].ticker.ticks == [0, depth]
    assert (drawn.figure.yaxis.axis_label, drawn.below.yaxis.axis_label) == ("pixel", "FIFO")
    assert drawn.below.xaxis.axis_label == "ns after the laser's trigger"


def test_each_part_of_a_period_is_drawn_from_its_own_columns():
    """The FIFO keeps its level until the next change; below a window is its commit."""
    drawn = TimelineFigure()
    view = period_view()
    drawn.show(view, 1, 3)
    expected = (*period_columns(view, PERIOD), light_columns(view, 1))
    sources = drawn.edges, drawn.windows, drawn.gate, drawn.fill, drawn.light
    for source, columns in zip(sources, expected, strict=True):
        assert source.data.keys() == columns.keys()
        assert all(np.array_equal(source.data[name], columns[name]) for name in columns)
    above = [(one.data_source, one.glyph) for one in drawn.figure.renderers]
    below = [(one.data_source, one.glyph) for one in drawn.below.renderers]
    quads = {source: one for source, one in above if hasattr(one, "right")}
    assert quads.keys() == {drawn.gate, drawn.windows}
    for one in quads.values():
        assert (one.left, one.right) == ("left", "right")
    assert (quads[drawn.windows].top, quads[drawn.windows].bottom) == ("top", -0.5)
    (count,) = [one for source, one in above if hasattr(one, "text")]
    assert (count.x, count.y, count.text) == ("middle", "top", "count")
    marks = {source: one for source, one in above if hasattr(one, "marker")}
    assert marks.keys() == {drawn.light, drawn.edges}
    for one in marks.values():
        assert (one.x, one.y) == ("x", "y")
    assert marks[drawn.edges].marker == "marker"
    area, line, commit = (one for _, one in below)
    assert (area.x, area.y1, area.y2, area.step_mode) == ("x", 0, "fill", "after")
    assert (line.x, line.y, line.mode) == ("x", "fill", "after")
    assert (commit.x, commit.y, commit.marker) == ("commit", 0, "commit_mark")
    assert [source for source, _ in below] == [drawn.fill, drawn.fill, drawn.windows]


def test_what_happens_in_a_period_has_the_colours_of_its_columns():
    """Outlines and fillings, numbers and hatching."""
    drawn = TimelineFigure()
    quads, counts, edges = (
        [
            one.glyph
            for one in drawn.figure.renderers
            if one.data_source is source and hasattr(one.glyph, of_kind)
        ]
        for source, of_kind in (
            (drawn.windows, "right"),
            (drawn.windows, "text"),
            (drawn.edges, "marker"),
        )
    )
    commits = [one.glyph for one in drawn.below.renderers if one.data_source is drawn.windows]
    assert [len(glyphs) for glyphs in (quads, counts, edges, commits)] == [1, 1, 1, 1]
    for glyph in (*quads, *edges, *commits):
        assert (glyph.fill_color, glyph.line_color) == ("colour", "colour")
    assert (quads[0].hatch_pattern, quads[0].hatch_color) == ("hatch", "colour")
    assert counts[0].text_color == "colour"


def test_a_picked_pixel_is_framed_and_told_with_its_subgroup():
    """On the maps, in the histogram and in the laser period."""
    parts = vars(pixel_view()) | vars(period_view())
    view = SimpleNamespace(**parts, subgroup_of=lambda row, col: col // 4)
    views = Views()
    for row, col, pulse in ((2, 5, 3), (3, 1, 0)):
        views.pick(view, row, col, pulse)
        assert (views.cursor.data, views.around.data) == cursor_columns(view, row, col)
        assert views.histogram.figure.title.text.startswith(f"row {row}, column {col}: ")
        title = views.timeline.figure.title.text
        assert title.startswith(f"subgroup {col // 4}, pulse {pulse}: ")
