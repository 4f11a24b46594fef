# SPDX-License-Identifier: Apache-2.0
"""Tables of the law of confidence: of which pixels a share is, and when there are too few."""

import numpy as np
import pytest

from docs.studies import confidence, count_confidence

METHODS = confidence.METHODS


@pytest.fixture
def plain_law(monkeypatch):
    """Let the only feature of a pixel be its confidence."""
    for module in (confidence, count_confidence):
        monkeypatch.setattr(module, "chance_of_right", lambda features, law: features[:, 0])


def seen_with(sure, right, on_surface=None, names=METHODS, **more):
    """Return a run whose pixels have these confidences in every method."""
    on_surface = right if on_surface is None else on_surface
    return confidence.Seen(
        features=dict.fromkeys(names, np.array(sure)[:, None]) | more,
        right=dict.fromkeys(names, np.array(right)),
        on_surface=dict.fromkeys(names, np.array(on_surface)),
    )


def test_the_share_that_is_right_is_that_of_the_sure_pixels_of_all_runs(plain_law):
    """From 85 %, and below 95 %."""
    sure = [0.84, 0.85, 0.9, 0.94, 0.95] * 20
    one = seen_with(sure, [True, True, True, False, False] * 20)
    other = seen_with(sure, [True, False, True, True, False] * 20)
    rows = [*confidence.rows({"two": [one, other], "one": [one]})]
    assert rows == [
        ("two", *["67% of 120"] * len(METHODS)),
        ("one", *["(60 pixels)"] * len(METHODS)),
    ]


def test_a_method_is_judged_by_its_own_pixels(plain_law):
    shares = {name: number for number, name in enumerate(METHODS, 1)}
    one = confidence.Seen(
        features=dict.fromkeys(METHODS, np.full((100, 1), 0.9)),
        right={name: np.arange(100) < 10 * number for name, number in shares.items()},
        on_surface={},
    )
    ((_, *cells),) = confidence.rows({"all": [one]})
    assert cells == [f"{10 * number}% of 100" for number in shares.values()]


def test_on_a_surface_is_more_than_right(plain_law):
    sure = [0.9] * 100 + [0.5] * 100
    right = [True] * 40 + [False] * 160
    on_surface = [True] * 70 + [False] * 30 + [True] * 100
    rows = [*confidence.ray_rows({"glass": [seen_with(sure, right, on_surface)]})]
    assert rows == [("glass", "40%", "70%")]


def test_confidence_in_counts_has_the_chance_that_gates_have_the_light(plain_law):
    """It multiplies the law's."""
    names = [count_confidence.METHOD]
    sure = [0.95] * 100 + [1.0] * 100 + [0.96] * 100
    there = np.array([0.9] * 100 + [1.0] * 100 + [0.5] * 100)
    right = [True] * 60 + [False] * 40 + [True] * 99 + [False] + [False] * 100
    one = seen_with(sure, right, names=names, **{count_confidence.SEEN: there})
    ((name, *cells),) = count_confidence.rows({"rooms": [one]})
    assert (name, cells) == ("rooms", ["53% of 300", "60% of 100", "99% of 100"])


def test_the_drawn_shares_are_means_over_bins_of_confidence(plain_law, monkeypatch, tmp_path):
    figures = []
    monkeypatch.setattr(confidence, "save_figure", lambda figure, path: figures.append(figure))
    sure = [0.6] * 100 + [0.62] * 100 + [0.9] * 99 + [0.99] * 200
    right = [True] * 50 + [False] * 150 + [True] * 99 + [True] * 190 + [False] * 10
    confidence.draw([seen_with(sure, right)], tmp_path / "one.png")
    (axis,) = figures[0].axes
    _, *lines = axis.get_lines()
    assert len(lines) == len(METHODS)
    for line in lines:
        assert line.get_xdata() == pytest.approx([61, 99])
        assert line.get_ydata() == pytest.approx([25, 95])
