# SPDX-License-Identifier: Apache-2.0
"""Pictures of depth: what stands where, in an array that is no square."""

from types import SimpleNamespace

import numpy as np
import pytest

from coincid.study import animation, pictures
from coincid.study.pictures import Panel, draw_row, light_row

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


def test_each_picture_of_light_has_the_same_room(monkeypatch, tmp_path):
    widths_in = []
    monkeypatch.setattr(
        pictures, "save_figure", lambda figure, _: widths_in.append(figure.get_figwidth())
    )
    light = np.full((ROWS, COLS), 0.5)
    for number in range(4):
        light_row(tmp_path / "light.png", [("estimate", light)] * number, light)
    assert np.ptp(np.diff(widths_in)) < 1e-9
    assert np.diff(widths_in)[0] == pytest.approx(pictures.PANEL_IN)


def test_all_frames_of_an_animation_have_one_scale(monkeypatch, tmp_path):
    """That of all their truths, so that the same colour is the same distance."""
    spans = []

    def draw(*given, span_m):
        spans.append(span_m)
        return draw_row(*given, span_m=span_m)

    monkeypatch.setattr(animation, "draw_row", draw)
    frames = []
    for number, wall_m in enumerate((5.0, 3.0, 12.0)):
        wall = np.full((4, 4), wall_m)
        first = SimpleNamespace(reason=np.zeros((4, 4), np.uint8))
        frames.append(SimpleNamespace(number=number, truth_m=wall, depth_m=wall, first=first))
    animation.write_animation(tmp_path / "moves.gif", frames)
    assert spans == [(3.0, 12.0)] * 3


def test_light_is_told_as_its_share_of_the_truth(monkeypatch, tmp_path):
    """The median over the pixels with light, of which an estimate need not know all."""
    drawn = []
    monkeypatch.setattr(pictures, "save_figure", lambda figure, path: drawn.append(figure))
    truth = np.geomspace(0.01, 1, ROWS * COLS).reshape(ROWS, COLS)
    truth[0] = 0.0
    third = truth / 3
    third[1, :7] = np.nan
    shares = {"third": (third, 1 / 3), "twice": (2 * truth, 2.0), "none": (truth * np.nan, None)}
    panels = [(name, light) for name, (light, _) in shares.items()]
    light_row(tmp_path / "light.png", panels, truth)
    first, *others = drawn[0].axes[:4]
    assert first.get_title() == "truth"
    for axis, (name, (light, share)) in zip(others, shares.items(), strict=True):
        told = "" if share is None else f"\nmedian of estimate / truth {share:.2f}"
        assert axis.get_title() == name + told
        assert axis.images[0].norm is first.images[0].norm
        shown = np.ma.filled(axis.images[0].get_array(), np.nan)
        bright = truth > 0.1
        assert np.allclose(shown[bright], light[bright], equal_nan=True)
