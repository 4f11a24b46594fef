# SPDX-License-Identifier: Apache-2.0
"""The lens that is found from a frame: of arrays that are not square, and of pixels that are not."""

import math
from itertools import product

import numpy as np
import pytest

from coincid.model.depth.lens import APART, LOWEST, OFF_MAX, Lens, _misses, find_lens, seen_at
from coincid.model.shared.compiled import njit

NEAREST_TICKS = 400.0
TANGENT_OF_HALF = math.tan(math.radians(22.5))
WEIGHT = 100.0  # errors of a tenth of a tick


def wall(rows, cols, down, right):
    """float64[rows, cols]: ticks of a wall that faces the sensor. down, right: tangents of a
    pixel's angles.
    """
    y = (np.arange(rows) - (rows - 1) / 2)[:, None] * down
    x = (np.arange(cols) - (cols - 1) / 2) * right
    return NEAREST_TICKS * np.sqrt(1 + x**2 + y**2)


@pytest.mark.parametrize("rows, cols", [(16, 16), (8, 24), (24, 8)])
@pytest.mark.parametrize("square_pixels", [True, False])
def test_the_lens_of_a_wall_has_the_angles_of_its_pixels(rows, cols, square_pixels):
    high, wide = (max(rows, cols),) * 2 if square_pixels else (rows, cols)
    down, right = (TANGENT_OF_HALF / (side / 2) for side in (high, wide))
    time = wall(rows, cols, down, right)
    lens = find_lens(time, np.full(time.shape, WEIGHT))
    assert lens.there and (lens.row, lens.col) == ((rows - 1) / 2, (cols - 1) / 2)
    assert math.sqrt(lens.down) == pytest.approx(down, rel=0.05)
    assert math.sqrt(lens.right) == pytest.approx(right, rel=0.05)


@pytest.mark.parametrize("weight", [WEIGHT, 1e-4])
def test_distances_that_change_evenly_or_are_hardly_known_tell_no_lens(weight):
    rows, cols = 8, 24
    time = wall(rows, cols, *(0.0, 0.0) if weight > 1 else (0.05, 0.05))
    time += np.arange(cols)
    lens = find_lens(time, np.full(time.shape, weight))
    assert not lens.there and lens.down == lens.right == 0


def misses_by_hand(time, weight, stretch):
    """Return the sum over three peaks in a line of the squared errors of the middle one. stretch:
    float64[rows, cols], or None where distances change evenly.
    """
    total = 0.0
    for (r, c), apart, step in product(np.ndindex(time.shape), APART, ((1, 0), (0, 1))):
        down, right = apart * step[0], apart * step[1]
        places = (r - down, c - right), (r, c), (r + down, c + right)
        if min(min(place) for place in places) < 0:
            continue
        if places[2][0] >= len(time) or places[2][1] >= len(time[0]):
            continue
        before, here, after = (time[place] for place in places)
        if min(weight[place] for place in places) <= 0:
            continue
        middle = (before + after) / 2
        if stretch is not None:
            wide = [stretch[place] for place in places]
            middle = wide[1] / ((wide[0] / before + wide[2] / after) / 2)
        variances = [1 / weight[place] for place in places]
        variance = variances[1] + (variances[0] + variances[2]) / 4
        total += min(OFF_MAX, (here - middle) ** 2 / variance)
    return total


@pytest.mark.parametrize("there", [False, True])
def test_misses_are_in_the_variances_of_the_three_peaks(there):
    """Peaks that are known unequally well, some not at all, on an array that is no square."""
    rng = np.random.default_rng(8)
    time = wall(7, 11, 0.01, 0.02) + rng.normal(0, 0.3, (7, 11))
    weight = rng.choice([0.0, 4.0, 30.0], time.shape, p=[0.1, 0.5, 0.4])
    lens = Lens(there, 0.01**2, 0.02**2, 3.0, 5.0)
    stretch = wall(7, 11, 0.01, 0.02) / NEAREST_TICKS if there else None
    expected = misses_by_hand(time, weight, stretch)
    assert _misses(time, weight, lens) == pytest.approx(expected, rel=1e-9)


@njit
def _seen_at(lens, time, slopes, r, c, down, right):
    return seen_at(lens, time, slopes[0], slopes[1], r, c, down, right)


LENS = Lens(there=True, down=0.03**2, right=0.05**2, row=3.0, col=5.5)
TURNED = 0.002, 2e-5, -7e-5  # of a plane in space: what changes evenly, and by how much per pixel


def plane_in_space(r, c):
    """Return the time of a plane at a place of the picture, and its slopes there."""
    y, x = r - LENS.row, c - LENS.col
    stretch = math.sqrt(1 + LENS.down * y**2 + LENS.right * x**2)
    even = TURNED[0] + TURNED[1] * r + TURNED[2] * c
    time = stretch / even
    return time, (
        LENS.down * y / stretch / even - time * TURNED[1] / even,
        LENS.right * x / stretch / even - time * TURNED[2] / even,
    )


@pytest.mark.parametrize("r, c", [(0, 0), (3, 5), (6, 11), (2, 9)])
def test_a_plane_in_space_is_followed_from_any_pixel_to_any_other(r, c):
    """Of pixels that are no squares, in a view that is no square."""
    time, slopes = plane_in_space(r, c)
    for there in np.ndindex(7, 12):
        found = _seen_at(LENS, time, slopes, r, c, there[0] - r, there[1] - c)
        assert found == pytest.approx(plane_in_space(*there)[0], rel=1e-9)


def test_a_plane_is_followed_no_farther_than_to_a_multiple_of_its_distance():
    """Behind its horizon, there would be no time."""
    lens = Lens(there=True, down=1e-12, right=1e-12, row=3.0, col=5.0)
    assert _seen_at(lens, 400.0, (0.0, 50.0), 3, 5, 0, 100) == pytest.approx(400 / LOWEST)
    assert _seen_at(lens, 400.0, (0.0, 50.0), 3, 5, 0, -8) == pytest.approx(200)
