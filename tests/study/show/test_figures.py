# SPDX-License-Identifier: Apache-2.0
"""Figures of the views: what lies where on arrays that are no squares, and scales that all views
share.
"""

import html
import re
from itertools import permutations
from types import SimpleNamespace

import numpy as np
import pytest
from bokeh.models import ColorBar, ColumnDataSource, CustomJS
from jinja2 import Environment, FileSystemLoader

import coincid
from coincid.model.contract.config import parse_config
from coincid.model.contract.edges import Fate
from coincid.model.contract.pixels import pixel_table
from coincid.model.depth.belief import Reason
from coincid.model.shared.errors import InputError
from coincid.study.palette import NO_VALUE_ON_PAGE, PAGE_INK
from coincid.study.pictures import REASONS
from coincid.study.show import notebook
from coincid.study.show.assets import FILES, SHOW
from coincid.study.show.figures import (
    CLICKS,
    COMPARED,
    COUNTS,
    FATE_MARKS,
    FATES,
    LIGHT,
    MAPS,
    REASON_MARKS,
    VERDICT_MARKS,
    VERDICTS,
    HistogramFigure,
    MapFigure,
    TimelineFigure,
    Views,
    cursor_columns,
    histogram_title,
    map_columns,
    map_scales,
)
from coincid.study.show.timeline import Verdict
from coincid.study.show.words import number_rows, story

ROWS, COLS = 12, 20
CONFIG = parse_config({"sensor": {"rows": ROWS, "cols": COLS, "subgroup": [4, 10]}})
NAMES = (*MAPS, *LIGHT)


def view_of(seed, scale=1.0, config=CONFIG):
    """Return a view whose maps are all different."""
    rng = np.random.default_rng(seed)
    shape = config.sensor.rows, config.sensor.cols
    maps = {name: scale * (k + rng.random(shape)) for k, name in enumerate(NAMES)}
    reason = rng.integers(0, 3, shape, np.uint8)
    return SimpleNamespace(config=config, reason=reason, **maps)


def covered(rectangle):
    """Return the flat numbers of the pixels in a rectangle of `cursor_columns`."""
    x, y, width, height = (rectangle[name][0] for name in "xywh")
    row, col = np.indices((ROWS, COLS))
    inside = (abs(row - y) <= (height - 1) / 2) & (abs(col - x) <= (width - 1) / 2)
    return np.flatnonzero(inside)


@pytest.mark.parametrize("pixel", [0, 19, 47, 103, 139, ROWS * COLS - 1])
def test_the_cursor_frames_the_pixel_and_its_subgroup(pixel):
    at, around = cursor_columns(view_of(1), *divmod(pixel, COLS))
    assert covered(at).tolist() == [pixel]
    subgroup = pixel_table(CONFIG.sensor).subgroup
    assert covered(around).tolist() == np.flatnonzero(subgroup == subgroup[pixel]).tolist()


def test_maps_have_the_shape_of_the_array():
    view = view_of(1)
    columns = map_columns(view)
    assert (columns["dw"], columns["dh"]) == ([COLS], [ROWS])
    for name in NAMES:
        assert np.array_equal(columns[name][0], getattr(view, name).astype(np.float32))
    row, col = np.indices((ROWS, COLS))
    assert np.array_equal(columns["row"][0], row)
    assert np.array_equal(columns["col"][0], col)
    assert np.array_equal(columns["subgroup"][0].ravel(), pixel_table(CONFIG.sensor).subgroup)


def test_all_views_share_a_scale_that_holds_them_in_any_order():
    views = [view_of(1), view_of(2, scale=3.0), view_of(3, scale=0.2)]
    scales = map_scales(views)
    for order in permutations(views):
        assert map_scales([*order]) == scales
    for name in ("truth_m", *COUNTS):
        low, high = scales[name]
        assert all(low <= getattr(one, name).min() for one in views)
        assert all(getattr(one, name).max() <= high for one in views)
    assert scales["truth_m"] == scales["depth_m"]
    assert scales["error_m"] == (-0.5, 0.5) and scales["confidence"] == (0, 1)


FATE_KEY = {  # fate: marker in the figure, the same sign beside it, meaning
    Fate.OPENING: ("triangle", "▲", "opened a window"),
    Fate.COUNTED: ("circle", "●", "counted in a window"),
    Fate.DUPLICATE: ("x", "×", "the pixel was counted already"),
    Fate.MASKED: ("dash", "▬", "pixel masked off"),
    Fate.GATED: ("square_pin", "■", "outside the gate"),
    Fate.BLIND: ("inverted_triangle", "▼", "tree not armed"),
}
VERDICT_KEY = {  # verdict: hatching in the figure, the same beside it, meaning
    Verdict.COMMITTED: (" ", "▌", "committed"),
    Verdict.REJECTED: ("/", "▨", "rejected: too few pixels"),
    Verdict.DROPPED: ("x", "▩", "dropped: FIFO full"),
}


@pytest.mark.parametrize(
    ("key", "drawn", "beside"),
    [(FATE_KEY, FATES, FATE_MARKS), (VERDICT_KEY, VERDICTS, VERDICT_MARKS)],
    ids=["fates", "verdicts"],
)
def test_the_key_beside_a_figure_has_the_sign_the_colour_and_the_meaning_of_each_mark(
    key, drawn, beside
):
    assert drawn.keys() == key.keys()
    for (kind, (form, sign, meaning)), mark in zip(key.items(), beside, strict=True):
        colour, *others = drawn[kind]
        assert others == [form, meaning]
        assert mark == (sign, colour, meaning)
    assert len({colour for colour, *_ in drawn.values()}) == len(drawn)


def test_the_key_below_the_views_has_the_marks_of_edges_windows_and_reasons():
    """Each behind its own word, below all figures: the maps, what is to be chosen, and the rest."""
    page = Environment(loader=FileSystemLoader(SHOW)).from_string(
        "{% from 'views.html' import views %}"
        "{% call views(embed, roots, maps, fates, verdicts, reasons) %}<choice>{% endcall %}"
    )
    names = "map_a", "map_b", "histogram", "timeline", "fifo"
    marks = {"fates": FATE_MARKS, "verdicts": VERDICT_MARKS, "reasons": REASON_MARKS}
    roots = {name: f"<figure {name}>" for name in names}
    text = page.render(embed=str, roots=roots, maps=names[:2], **marks)
    drawn = [roots[name] for name in names]
    assert re.findall("<figure .*?>|<choice>", text) == [*drawn[:2], "<choice>", *drawn[2:]]
    own = r'data-mark="(.)" style="--mark: (.*?)">(.*?)</span>'
    words = "edges: ", "windows: ", "light expected", "depth not to be believed: "
    parts = re.split("|".join(words), text)[1:]
    shown = [re.findall(own, part) for part in parts]
    assert shown == [FATE_MARKS, VERDICT_MARKS, [], REASON_MARKS]


def luminance(colour):
    """Return the relative luminance of a colour, as WCAG has it."""
    shares = np.frombuffer(bytes.fromhex(colour[1:]), np.uint8) / 255
    linear = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


def contrast(one, other):
    low, high = sorted(map(luminance, (one, other)))
    return (high + 0.05) / (low + 0.05)


THEMES = {
    theme: dict(re.findall(r"--([\w-]+): (#\w+)", block)) | {"scheme": scheme}
    for theme, block, scheme in re.findall(
        r':root(?:\[data-theme="(\w+)"\])? \{(.*?)color-scheme: (\w+)', FILES["page.css"], re.DOTALL
    )
}


@pytest.mark.parametrize("theme", ["", "dark"])
def test_words_can_be_read_in_either_theme(theme):
    """Each on its background, and those of a figure on both."""
    colours = THEMES[theme]
    assert colours.keys() == THEMES[""].keys()
    assert colours["scheme"] == (theme or "light")
    for words in ("ink", "quiet", "bad", "good"):
        for ground in ("surface", "raised", "plot"):
            assert contrast(colours[words], colours[ground]) >= 4.5, (words, ground)
    assert contrast(colours["on-accent"], colours["accent"]) >= 4.5
    assert contrast(colours["accent"], colours["surface"]) >= 3
    for words in (PAGE_INK, NO_VALUE_ON_PAGE):
        assert contrast(words, colours["plot"]) >= 3
    assert (luminance(colours["surface"]) < 0.2) == (theme == "dark")


def test_what_has_no_value_is_grey_on_every_map():
    """As no value is."""
    source, empty = ColumnDataSource(map_columns(view_of(1))), ColumnDataSource({})
    for shows, (_, palette) in MAPS.items():
        one = MapFigure(shows, "map", source, empty, empty)
        assert one.mapper.nan_color == NO_VALUE_ON_PAGE
        assert NO_VALUE_ON_PAGE not in palette


def test_errors_are_blue_in_front_white_where_right_and_orange_behind():
    empty = ColumnDataSource({})
    one = MapFigure("error_m", "map", ColumnDataSource(map_columns(view_of(1))), empty, empty)
    one.show(view_of(1), map_scales([view_of(1)])["error_m"])
    colours = [colour_of(one.mapper, error_m) for error_m in (-0.5, -0.001, 0.001, 0.5)]
    assert colours == ["#0072b2", "#f7f7f7", "#f7f7f7", "#d55e00"]


@pytest.mark.parametrize("shows", COUNTS)
def test_each_small_number_has_a_colour_of_its_own_whatever_was_shown_before(shows):
    """In the middle of its part of the scale; larger ones share a scale without steps."""
    empty = ColumnDataSource({})
    one = MapFigure(shows, "map", ColumnDataSource(map_columns(view_of(1))), empty, empty)
    for high in (3.0, 20.0, 5.0, 8.0, 9.0, 2.0):
        one.show(view_of(1), (0, high))
        mapper = one.mapper
        if high <= 8:
            numbers = range(int(high) + 1)
            assert len({colour_of(mapper, number) for number in numbers}) == len(numbers)
            assert all(
                colour_of(mapper, number - 0.4) == colour_of(mapper, number + 0.4)
                for number in numbers
            )
        else:
            assert (mapper.low, mapper.high, len(mapper.palette)) == (0, high, 256)


def scale_of(one):
    return one.mapper.low, one.mapper.high, tuple(one.mapper.palette)


def test_compared_maps_have_their_letters_and_one_scale():
    """A and B, whichever has the larger numbers, each of its own array; alone, a frame has no
    letter.
    """
    config = parse_config({"sensor": {"rows": 8, "cols": 16}})
    small, large = view_of(1), view_of(2, scale=3.0, config=config)
    views = Views(compared=True)
    for b, a in ((small, large), (large, small)):
        views.show(b, a)
        of_b = {one.shows: one for one in views.maps}
        for one in views.a_maps:
            title = MAPS[one.shows][0]
            assert one.figure.title.text == f"A: {title}"
            assert of_b[one.shows].figure.title.text == f"B: {title}"
            assert scale_of(one) == scale_of(of_b[one.shows])
        assert scale_of(of_b["depth_m"])[:2] == map_scales([small, large])["depth_m"]
        for source, view in ((views.pictures, b), (views.others, a)):
            assert np.array_equal(source.data["depth_m"][0], view.depth_m.astype(np.float32))
        for maps, view in ((views.maps, b), (views.a_maps, a)):
            ends = view.config.sensor.cols - 0.5, view.config.sensor.rows - 0.5
            for one in maps:
                assert (one.figure.x_range.end, one.figure.y_range.start) == ends
    views.show(small)
    assert [one.figure.title.text for one in views.maps] == [title for title, _ in MAPS.values()]


@pytest.mark.parametrize(
    ("truth_m", "depth_m", "told"),
    [
        (4.125, 5.5, "truth 4.12 m, depth 5.50 m"),
        (np.nan, 5.5, "no truth, depth 5.50 m"),
        (4.0, np.nan, "truth 4.00 m, no depth"),
    ],
)
def test_the_title_of_a_histogram_tells_the_place_and_what_is_known(truth_m, depth_m, told):
    maps = {name: np.full((ROWS, COLS), 9.0) for name in ("truth_m", "depth_m")}
    maps["truth_m"][3, 17], maps["depth_m"][3, 17] = truth_m, depth_m
    assert histogram_title(SimpleNamespace(**maps), 3, 17) == f"row 3, column 17: {told}"


@pytest.mark.parametrize("compared", [False, True])
def test_a_click_on_any_map_picks_the_pixel_below_it(compared):
    """By a mouse or a finger."""
    views = Views(compared=compared)
    picked = []
    views.on_pick(lambda row, col: picked.append((row, col)))
    maps = [*views.a_maps, *views.maps]
    assert len(maps) == len(MAPS) + compared * len(COMPARED)
    for one in maps:
        for click in CLICKS:
            one.figure._trigger_event(click(one.figure, x=17.4, y=2.6))
    assert picked == [(3, 17)] * len(maps) * len(CLICKS)


def test_a_click_on_any_map_of_a_page_picks_its_pixel_and_tells_its_numbers():
    """By a mouse or a finger, which never hovers; a mouse that hovers is told them, too."""
    views, code = Views(), CustomJS(code="picked()")
    views.pick_in_page(code)
    for one in views.maps:
        run = one.figure.js_event_callbacks
        assert run.keys() == {click.event_name for click in CLICKS}
        told, picks = zip(*run.values(), strict=True)
        hover = one.figure.hover.callback
        assert {*picks} == {code} and len(set(told)) == 1
        for numbers, at in ((told[0], "cb_obj"), (hover, "cb_data.geometry")):
            assert numbers.code == f"overMap(source, {at})"
            assert numbers.args == {"source": views.pictures}


@pytest.mark.parametrize("shows", MAPS)
def test_a_map_stands_upright_and_has_the_scale_that_it_is_given(shows):
    empty = ColumnDataSource({})
    one = MapFigure(shows, "map", ColumnDataSource(map_columns(view_of(1))), empty, empty)
    one.show(view_of(1), (0, 20.0), "A: ")
    across, down = one.figure.x_range, one.figure.y_range
    assert (across.start, across.end) == (-0.5, COLS - 0.5)
    assert (down.start, down.end) == (ROWS - 0.5, -0.5)
    assert (one.mapper.low, one.mapper.high) == (0, 20.0)
    assert one.figure.title.text == f"A: {MAPS[shows][0]}"


@pytest.mark.parametrize(
    ("shows", "rises"),
    [("truth_m", False), ("depth_m", False), ("threshold", True), ("drops", True), ("confidence", True)],
)  # fmt: skip
def test_what_is_near_is_bright_and_so_is_what_is_much(shows, rises):
    brightness = [sum(bytes.fromhex(colour[1:7])) for colour in MAPS[shows][1]]
    assert (np.diff(brightness[::32]) > 0).all() == rises
    assert (np.diff(brightness[::32]) < 0).all() == (not rises)


def renderers_of(one, column):
    """Return the renderers of a figure that draw a column as a picture or as a place."""
    return [
        renderer
        for renderer in one.figure.renderers
        if column in (getattr(renderer.glyph, "image", None), renderer.glyph.x)
    ]


def colour_of(mapper, value):
    """Return the colour of a value, as the page finds it: the scale has parts of one width."""
    share = (value - mapper.low) / (mapper.high - mapper.low)
    return mapper.palette[min(int(share * len(mapper.palette)), len(mapper.palette) - 1)]


def test_every_reason_has_its_colour_over_the_confidence():
    """What is believed lets the confidence below it through; no other map has reasons."""
    source, empty = ColumnDataSource(map_columns(view_of(1))), ColumnDataSource({})
    of_name = {name: MapFigure(name, name, source, empty, empty) for name in MAPS}
    drawn = {name: renderers_of(one, "reason") for name, one in of_name.items()}
    assert [name for name, found in drawn.items() if found] == ["confidence"]
    (reasons,) = drawn["confidence"]
    shown = {reason: colour_of(reasons.glyph.color_mapper, int(reason)) for reason in Reason}
    assert shown == REASONS | {Reason.BELIEVED: "#00000000"}
    (below,) = renderers_of(of_name["confidence"], "confidence")
    order = of_name["confidence"].figure.renderers
    assert order.index(below) < order.index(reasons)


@pytest.mark.parametrize("shows", MAPS)
def test_a_map_draws_its_own_picture_bar_and_frames(shows):
    """The frame of the subgroup is dashed, that of the pixel is not; both are seen on any colour."""
    source = ColumnDataSource(map_columns(view_of(1)))
    cursor, around = (ColumnDataSource(dict.fromkeys("xywh", [])) for _ in range(2))
    one = MapFigure(shows, "map", source, cursor, around)
    (picture,) = renderers_of(one, shows)
    assert picture.glyph.color_mapper is one.mapper and picture.data_source is source
    assert one.figure.hover.renderers == [picture]
    (bar,) = one.figure.select(type=ColorBar)
    assert bar.color_mapper is one.mapper
    assert bar.ticker.min_interval == (1 if shows in COUNTS else 0)
    for frame, dash in ((around, "dashed"), (cursor, "solid")):
        lines = [drawn.glyph for drawn in one.figure.renderers if drawn.data_source is frame]
        assert [line.line_color for line in lines] == ["black", "white"]
        assert lines[0].line_width > lines[1].line_width
        assert all(line.line_dash == dash for line in lines)


def test_a_view_in_a_notebook_is_that_of_its_frame_and_method(monkeypatch):
    monkeypatch.setattr(notebook, "FrameView", lambda title, frame: (title, frame))
    run = SimpleNamespace(config=SimpleNamespace(frames=3), frame=lambda *given: given)
    assert notebook.run_view(run) == ("frame 0", (0, None))
    assert notebook.run_view(run, 2, "planes") == ("frame 2", (2, "planes"))
    for frame in (-1, 3):
        with pytest.raises(InputError, match=f"frame = {frame}: must be an integer from 0 to 2"):
            notebook.run_view(run, frame)


def test_a_period_in_a_notebook_is_that_of_its_subgroup_pulse_and_frame(monkeypatch):
    asked, shown = [], []
    monkeypatch.setattr(notebook, "run_view", lambda *given: asked.append(given) or "a view")
    monkeypatch.setattr(TimelineFigure, "show", lambda self, *given: shown.append(given))
    run = SimpleNamespace(config=SimpleNamespace(sensor=CONFIG.sensor, pulses=9))
    notebook.plot_timeline(run, 5, 8, frame=2)
    assert asked == [(run, 2)] and shown == [("a view", 5, 8)]


def test_a_histogram_in_a_notebook_is_that_of_the_pixel_by_rows(monkeypatch):
    """Of the frame and by the method that were asked for."""
    asked, shown = [], []
    view = view_of(1)
    monkeypatch.setattr(notebook, "run_view", lambda *given: asked.append(given) or view)
    monkeypatch.setattr(HistogramFigure, "show", lambda self, *given: shown.append(given))
    for pixel in (0, COLS - 1, COLS, 3 * COLS + 7, ROWS * COLS - 1):
        notebook.plot_histogram("a run", pixel, 2, "planes")
        assert asked[-1] == ("a run", 2, "planes")
        assert shown[-1] == (view, pixel // COLS, pixel % COLS)
    for pixel in (-1, ROWS * COLS):
        told = f"pixel = {pixel}: must be an integer from 0 to {ROWS * COLS - 1}"
        with pytest.raises(InputError, match=told):
            notebook.plot_histogram("a run", pixel)


@pytest.mark.parametrize(("frame", "drawn"), [(None, 0), (0, 0), (2, 2)])
def test_a_histogram_draws_itself_with_the_depth_of_its_frame(monkeypatch, frame, drawn):
    """Of all frames, with that of the first. What is computed from it has no picture, and neither has
    it where nothing draws.
    """
    counted = []

    def noted(*given, **how):
        counted.append((given, how))
        return np.array([3, 0, 4], np.int32)

    monkeypatch.setattr(notebook, "pixel_histogram", noted)
    monkeypatch.setattr(notebook, "plot_histogram", lambda *given: notebook.Shown(str(given), 9))
    run = SimpleNamespace(result="result", config="config")
    hits = notebook.PixelHistogram.of(run, 7, source="records", frame=frame)
    assert counted == [(("result", "config", 7), {"source": "records", "frame": frame})]
    assert hits.tolist() == [3, 0, 4]
    assert hits.draw() == notebook.Shown(str((run, 7, drawn)), 9)
    assert hits._repr_html_() == hits.draw()._repr_html_()
    assert hits[:1].draw is None and (hits + 1).draw is None

    def refused():
        raise InputError("bokeh is not installed")

    hits.draw = refused
    assert hits._repr_html_() is None


def test_the_summary_of_a_run_is_that_of_its_first_frame():
    """With all its numbers; the text of a cell is no markup."""
    run = coincid.simulate(None, "flat:5", rows=8, cols=8, pulses=20, frames=2, klux=50)
    first, last = (notebook.run_view(run, number) for number in range(2))
    shown = notebook.summary(run)
    assert html.escape(story(first)) in shown and html.escape(story(last)) not in shown
    rows = [f"<td>{label}</td><td>{html.escape(told)}</td>" for label, told in number_rows(first)]
    assert all(row in shown for row in rows)
