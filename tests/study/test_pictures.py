# SPDX-License-Identifier: Apache-2.0
"""Pictures of depth: what stands where, in an array that is no square."""

from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from coincid.model.depth.belief import SENTENCES, Reason
from coincid.study import animation, pictures
from coincid.study.pictures import Panel, draw_row, light_row
from coincid.study.plot_style import (
    figure_bytes,
    legend_below,
    new_figure,
    save_figure,
    share_axis,
    style,
)

ROWS, COLS = 8, 24


def test_numbers_stand_in_the_middle_of_their_subgroups():
    thresholds = np.arange(1, 13).reshape(2, 6)
    truth_m = np.full((ROWS, COLS), 5.0)
    panels = [Panel("depth", truth_m)]
    figure, shares = draw_row(panels, truth_m, blocks=("thresholds", thresholds))
    assert shares == [0.0]
    (axis,) = [one for one in figure.axes if one.get_title() == "thresholds"]
    found = {text.get_position(): int(text.get_text()) for text in axis.texts}
    expected = {}
    for (down, across), threshold in np.ndenumerate(thresholds):
        expected[across * 4 + 1.5, down * 4 + 1.5] = threshold
    assert found == expected
    assert axis.images[0].get_extent() == [-0.5, COLS - 0.5, ROWS - 0.5, -0.5]


def test_wrong_pixels_are_framed_and_pixels_without_a_truth_are_crossed():
    truth_m = np.full((ROWS, COLS), 5.0)
    truth_m[1, 20] = np.nan
    depth_m = np.full((ROWS, COLS), 5.0)
    depth_m[6, 3] = 7.0
    depth_m[1, 20] = 7.0
    figure, shares = draw_row([Panel("depth", depth_m)], truth_m)
    assert shares == [1 / (ROWS * COLS - 1)]
    truth, depth = figure.axes[:2]
    (frame,) = depth.collections[0].get_paths()
    assert frame.get_extents().bounds == (3 - 0.5, 6 - 0.5, 1, 1)
    for axis in (truth, depth):
        crosses = [line.get_xydata().mean(axis=0).tolist() for line in axis.lines]
        assert crosses == [[20, 1], [20, 1]]
    figure, shares = draw_row([Panel("depth", depth_m)], truth_m, tolerance_m=3.0)
    assert shares == [0.0]
    assert not any(one.get_paths() for one in figure.axes[1].collections)


def test_depths_that_are_not_believed_have_dots_of_their_reason():
    """Each on its own pixel; the legend has the reasons that occur."""
    depth_m = np.full((ROWS, COLS), 5.0)
    reason = np.full((ROWS, COLS), Reason.BELIEVED, np.uint8)
    reason[6, 3] = reason[1, 20] = Reason.BACKGROUND
    reason[2, 9] = Reason.FEW_PHOTONS
    panels = [Panel("all", depth_m), Panel("some", depth_m, reason)]
    figure, _ = draw_row(panels, depth_m)
    _, everything, some = figure.axes[:3]
    assert not everything.lines
    dots = {line.get_label(): (line.get_color(), line.get_xydata().tolist()) for line in some.lines}
    expected = {
        Reason.BACKGROUND: [[20, 1], [3, 6]],
        Reason.FEW_PHOTONS: [[9, 2]],
    }
    assert dots == {
        SENTENCES[one].partition(":")[0]: (pictures.REASONS[one], places)
        for one, places in expected.items()
    }
    assert [text.get_text() for text in figure.legends[0].get_texts()] == list(dots)


def test_a_figure_is_written_in_the_format_of_each_name(tmp_path):
    with style():
        figure = new_figure(2, 1)
    paths = [tmp_path / name for name in ("one.png", "two.svg", "three.png")]
    save_figure(figure, *paths)
    one, two, three = (path.read_bytes() for path in paths)
    assert one == three and one.startswith(b"\x89PNG")
    assert b"<svg" in two
    alone = tmp_path / "alone.svg"
    save_figure(figure, alone)
    assert alone.read_bytes() == two


def test_each_picture_of_light_has_the_same_room(monkeypatch, tmp_path):
    widths_in, heights_in = [], []

    def measured(figure, _):
        widths_in.append(figure.get_figwidth())
        heights_in.append(figure.get_figheight())

    monkeypatch.setattr(pictures, "save_figure", measured)
    light = np.full((ROWS, COLS), 0.5)
    for number in range(4):
        light_row(tmp_path / "light.png", [("estimate", light)] * number, light)
    assert np.ptp(np.diff(widths_in)) < 1e-9
    assert np.diff(widths_in)[0] == pytest.approx(pictures.PANEL_IN)
    assert heights_in == pytest.approx([pictures.PANEL_IN * ROWS / COLS + 1.1] * 4)


@pytest.mark.parametrize(("suffix", "kind"), [("gif", "GIF"), ("png", "PNG"), ("PNG", "PNG")])
def test_all_frames_of_an_animation_have_one_scale(monkeypatch, tmp_path, suffix, kind):
    """That of all their truths, so that the same colour is the same distance. Each has its number,
    the marks of its own pixels, and the heading of all.
    """
    spans, titles, marked = [], [], []

    def draw(panels, truth_m, heading, *, span_m):
        spans.append(span_m)
        titles.append((heading, panels[0].title))
        marked.append(np.argwhere(panels[0].reason == Reason.BACKGROUND).tolist())
        return draw_row(panels, truth_m, heading, span_m=span_m)

    monkeypatch.setattr(animation, "draw_row", draw)
    frames = []
    for number, wall_m in {4: 5.0, 2: 3.0, 7: 12.0}.items():
        wall = np.full((4, 4), wall_m)
        first = SimpleNamespace(reason=np.zeros((4, 4), np.uint8))
        first.reason[1, number % 4] = Reason.BACKGROUND
        frames.append(SimpleNamespace(number=number, truth_m=wall, depth_m=wall, first=first))
    animation.write_animation(tmp_path / f"moves.{suffix}", frames, "a wall")
    assert spans == [(3.0, 12.0)] * 3
    assert titles == [("a wall", f"depth, frame {number}") for number in (4, 2, 7)]
    assert marked == [[[1, 0]], [[1, 2]], [[1, 3]]]
    with Image.open(tmp_path / f"moves.{suffix}") as written:
        assert (written.format, written.n_frames) == (kind, 3)
        for number in range(3):  # shown long enough, and again after the last one
            written.seek(number)
            assert (written.info["duration"], written.info["loop"]) == (250, 0)


def test_light_is_told_as_its_share_of_the_truth(monkeypatch, tmp_path):
    """The median over the pixels with light, of which an estimate need not know all."""
    drawn = []
    monkeypatch.setattr(pictures, "save_figure", lambda figure, path: drawn.append(figure))
    truth = np.geomspace(0.01, 1, ROWS * COLS).reshape(ROWS, COLS)
    truth[0] = 0.0
    third = truth / 3
    third[1, :7] = np.nan
    # the median of the shares, not the share of the medians
    uneven = truth * np.where(truth > 0.3, 0.1, 3.0)
    shares = {"third": (third, 1 / 3), "twice": (2 * truth, 2.0), "none": (truth * np.nan, None)}
    shares["uneven"] = uneven, 3.0
    panels = [(name, light) for name, (light, _) in shares.items()]
    light_row(tmp_path / "light.png", panels, truth)
    first, *others = drawn[0].axes[: 1 + len(panels)]
    assert first.get_title() == "truth"
    for axis, (name, (light, share)) in zip(others, shares.items(), strict=True):
        told = "" if share is None else f"\nmedian of estimate / truth {share:.2f}"
        assert axis.get_title() == name + told
        assert axis.images[0].norm is first.images[0].norm
        shown = np.ma.filled(axis.images[0].get_array(), np.nan)
        bright = truth > 0.1
        assert np.allclose(shown[bright], light[bright], equal_nan=True)


@pytest.mark.parametrize(
    ("panels", "blocks", "heading", "across", "down"),
    [(1, False, "", 2, 1), (4, False, "", 5, 1), (4, True, "light", 5, 2), (8, True, "", 5, 2)],
)
def test_pictures_stand_side_by_side_at_most_five_in_a_row(panels, blocks, heading, across, down):
    """Places that are left over are empty. Each row has the height of the array and its labels."""
    truth_m = np.full((ROWS, COLS), 5.0)
    given = [Panel(f"depth {number}", truth_m) for number in range(panels)]
    of_blocks = ("thresholds", np.ones((1, 3), int)) if blocks else None
    figure, _ = draw_row(given, truth_m, heading, blocks=of_blocks)
    axes = figure.axes[: across * down]
    assert [axis.get_subplotspec().rowspan.start for axis in axes] == [
        row for row in range(down) for _ in range(across)
    ]
    places = 1 + panels + blocks
    assert [axis.get_visible() for axis in axes] == [k < places for k in range(len(axes))]
    assert [bool(axis.get_ylabel()) for axis in axes] == [k % across == 0 for k in range(len(axes))]
    assert [axis.get_xlabel() for axis in axes[:places]] == ["column"] * places
    titles = [f"depth {number}\n0.0% of pixels wrong" for number in range(panels)]
    assert [axis.get_title() for axis in axes] == (
        ["truth", *titles] + ["thresholds"] * blocks + [""] * (len(axes) - places)
    )
    width_in, height_in = figure.get_size_inches()
    assert width_in == pytest.approx(pictures.PANEL_IN * across + 0.9)
    row_in = pictures.PANEL_IN * ROWS / COLS + 0.75
    assert height_in == pytest.approx(row_in * down + (0.6 if heading else 0.35))
    assert figure.get_suptitle() == heading


def test_all_depths_have_one_scale_that_is_a_little_wider_than_the_truth():
    """By a share of it, at least by the tolerance, so that a wrong depth has another colour."""
    truth_m = np.linspace(2.0, 12.0, ROWS * COLS).reshape(ROWS, COLS)
    panels = [Panel("near", truth_m - 1), Panel("far", truth_m + 100)]
    margin_m = pictures.SCALE_MARGIN * 10.0
    assert margin_m > 0.1
    for options, limits_m in (
        ({"tolerance_m": 0.1}, (2.0 - margin_m, 12.0 + margin_m)),
        ({"tolerance_m": 3.0}, (-1.0, 15.0)),
        ({"tolerance_m": 0.1, "span_m": (1.0, 1.0)}, (0.9, 1.1)),
    ):
        figure, _ = draw_row(panels, truth_m, **options)
        for axis in figure.axes[:3]:
            assert axis.images[0].get_clim() == pytest.approx(limits_m)
            assert axis.images[0].cmap.get_bad().tolist() == pytest.approx(
                pictures.matplotlib.colors.to_rgba(pictures.NO_VALUE)
            )


def test_what_is_near_is_bright_and_a_high_threshold_is_dark(monkeypatch, tmp_path):
    """So is bright light, in its own pictures."""
    drawn = []
    monkeypatch.setattr(pictures, "save_figure", lambda figure, path: drawn.append(figure))
    truth = np.linspace(2.0, 12.0, ROWS * COLS).reshape(ROWS, COLS)
    thresholds = np.array([[1, 5, 10]])
    figure, _ = draw_row([Panel("depth", truth)], truth, blocks=("thresholds", thresholds))
    light_row(tmp_path / "light.png", [("estimate", truth)], truth)
    falling = [*figure.axes[:3], *drawn[0].axes[:2]]
    for axis, sign in zip(falling, (-1, -1, -1, 1, 1), strict=True):
        (image,) = axis.images
        at = np.linspace(*image.get_clim(), 9)
        brightness = image.to_rgba(at)[:, :3].mean(axis=1)
        assert (sign * np.diff(brightness) > 0).all(), axis.get_title()


def test_the_notes_tell_the_marks_that_are_there():
    truth_m = np.full((ROWS, COLS), 5.0)
    unsure = np.zeros((ROWS, COLS), np.uint8)
    figure, _ = draw_row([Panel("depth", truth_m)], truth_m, tolerance_m=0.125)
    assert figure.get_supxlabel() == "red frames: wrong, |error| > 12.5 cm"
    assert not figure.legends
    truth_m[2, 3] = np.nan
    figure, _ = draw_row([Panel("depth", truth_m, unsure)], truth_m, tolerance_m=0.125)
    notes = "red frames: wrong, |error| > 12.5 cm; crosses: no truth, not counted"
    assert figure.get_supxlabel() == notes
    reason = next(iter(pictures.REASONS))
    unsure[1, 4] = reason
    figure, _ = draw_row([Panel("depth", truth_m, unsure)], truth_m, tolerance_m=0.125)
    (legend,) = figure.legends
    assert legend.get_title().get_text() == f"{notes}; dots: depth that is not to be believed"
    (dots,) = [line for line in figure.axes[1].lines if line.get_marker() == "o"]
    assert dots.get_xydata().tolist() == [[4.0, 1.0]]
    assert dots.get_label() == pictures.SENTENCES[reason].partition(":")[0]


def test_grey_levels_of_light_span_the_truth_but_no_more_than_can_be_told_apart(
    monkeypatch, tmp_path
):
    drawn = []
    monkeypatch.setattr(pictures, "save_figure", lambda figure, path: drawn.append(figure))
    of_truth = {
        "narrow": (np.geomspace(0.2, 0.8, 6), 0.2, 0.8),
        "wide": (np.geomspace(1e-12, 0.5, 6), 0.5 / pictures.LIGHT_SPAN, 0.5),
        "dark": (np.zeros(6), 1.0, 1.0),
    }
    for light, darkest, brightest in of_truth.values():
        truth = light.reshape(2, 3)
        light_row(tmp_path / "light.png", [("estimate", truth * 0)], truth)
        first, second = drawn.pop().axes[:2]
        limits = darkest / pictures.LIGHT_MARGIN, brightest * pictures.LIGHT_MARGIN
        assert first.images[0].get_clim() == pytest.approx(limits)
        # Light that an estimate has not seen is as dark as the scale goes.
        assert second.images[0].get_array().max() == pytest.approx(limits[0])
        assert (first.get_ylabel(), second.get_ylabel()) == ("row", "")
        assert first.get_xlabel() == second.get_xlabel() == "column"


def test_the_scale_beside_pictures_has_its_unit_and_above_them_stands_what_they_are(
    monkeypatch, tmp_path
):
    """The scale is that of the depths, not of the thresholds beside them."""
    drawn = []
    monkeypatch.setattr(pictures, "save_figure", lambda figure, path: drawn.append(figure))
    truth = np.linspace(2.0, 12.0, ROWS * COLS).reshape(ROWS, COLS)
    figure, _ = draw_row([Panel("a", truth)], truth, "depth", blocks=("b", np.ones((1, 3), int)))
    light_row(tmp_path / "light.png", [("a", truth)], truth, "light")
    for one, unit, heading in (
        (figure, "depth in m", "depth"),
        (drawn[0], "photons per pulse", "light"),
    ):
        (bar,) = [axis for axis in one.axes if axis.get_label() == "<colorbar>"]
        assert bar.get_ylabel() == unit
        assert bar.get_ylim() == pytest.approx(one.axes[0].images[0].get_clim())
        assert one.get_suptitle() == heading


def test_shares_are_drawn_linear_below_a_thousandth_and_in_decades_above():
    """So that no wrong pixel has a place, too."""
    axis = new_figure(3, 3).subplots()
    share_axis(axis, title="wrong")
    assert axis.get_ylim() == (0, 1) and axis.get_title() == "wrong"
    ticks = zip(axis.get_yticks().tolist(), axis.get_yticklabels(), strict=True)
    assert {at: label.get_text() for at, label in ticks} == {
        0.0: "0",
        0.001: "0.1 %",
        0.01: "1 %",
        0.1: "10 %",
        1.0: "100 %",
    }
    heights = axis.transData.transform([(0, share) for share in (0, 5e-4, 1e-3, 1e-2, 0.1, 1)])
    steps = np.diff(heights[:, 1])
    assert steps[0] == pytest.approx(steps[1])
    assert steps[2:] == pytest.approx(steps[2])


def test_a_legend_has_each_label_once_in_as_many_columns_as_there_are():
    figure = new_figure(4, 3)
    first, second = figure.subplots(1, 2)
    for axis, names in ((first, "ab"), (second, "bc")):
        for name in names:
            axis.plot([0, 1], [0, 1], label=name)
    legend_below(figure)
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["a", "b", "c"]
    assert legend._ncols == 3
    assert legend.legend_handles[1].get_color() == first.lines[1].get_color()
    legend_below(figure, columns=2)
    assert figure.legends[-1]._ncols == 2


@pytest.mark.parametrize("kind", ["svg", "png"])
def test_equal_figures_have_equal_bytes(kind):
    """Also where parts of a file have names, and outside of the style in which it was drawn."""
    files = []
    for _ in range(2):
        with style():
            figure = new_figure(2, 1)
            figure.subplots().plot([0, 1], [0, 1], "o-")
        files.append(figure_bytes(figure, kind))
    assert files[0] == files[1]


def test_a_picture_has_120_pixels_per_inch_and_its_values_have_sharp_edges(tmp_path):
    """No colour lies between those of two values, so none stands for a value that is not there."""
    with style(axes_grid=False):
        figure = new_figure(2, 1)
        figure.set_layout_engine("none")
        axis = figure.add_axes((0, 0, 1, 1))
        axis.imshow([[0.0, 1.0]], cmap="gray", aspect="auto")
        axis.set_axis_off()
    save_figure(figure, tmp_path / "two.png")
    with Image.open(tmp_path / "two.png") as picture:
        assert picture.size == (240, 120)
        assert {colour for _, colour in picture.convert("L").getcolors()} == {0, 255}


def test_figures_have_no_dates(tmp_path):
    """Equal data give equal bytes on another day, and in another release of the library."""
    with style():
        figure = new_figure(2, 1)
    save_figure(figure, tmp_path / "one.svg", tmp_path / "one.png")
    text = (tmp_path / "one.svg").read_text(encoding="utf-8")
    assert "date" not in text and "creator" not in text
    with Image.open(tmp_path / "one.png") as picture:
        assert "Software" not in picture.info
