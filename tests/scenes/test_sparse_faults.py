# SPDX-License-Identifier: Apache-2.0
"""Few samples without depth in a large picture: they cost no pixel that has other samples."""

from itertools import product

import numpy as np
import pytest

from coincid.model.light.timing import RANGE_M
from coincid.model.scenes.depth_file import depth_scene
from coincid.model.scenes.meaning import Meaning
from coincid.model.shared.errors import InputError

ROWS = 4
COLS = 6
SIDE = 3  # samples of a pixel, down and across
WALL_M = 5.0
FAULTS = {  # what a sample without depth may hold, and the meaning that says so
    "NaN": (np.nan, Meaning()),
    "infinity": (np.inf, Meaning()),
    "0": (0.0, Meaning()),
    "negative": (-1.0, Meaning()),
    "beyond the range": (1000.0, Meaning()),
    "a mark": (7.0, Meaning(missing=7.0)),
    "the sky": (60.0, Meaning(sky_m=50.0)),
    "where the sky begins": (50.0, Meaning(sky_m=50.0)),
    "the largest half float": (65504.0, Meaning()),
    "where the range ends": (RANGE_M, Meaning()),
}


def wall():
    return np.full((SIDE * ROWS, SIDE * COLS), WALL_M)


def assert_wall(scene, holes=()):
    expected = np.full((ROWS, COLS), WALL_M)
    for place in holes:
        expected[place] = np.nan
    assert np.array_equal(scene.truth_m, expected, equal_nan=True)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("place", [(0, 0), (5, 7), (-1, -1)])
def test_a_single_sample_without_depth_costs_no_pixel(fault, place):
    value, meaning = FAULTS[fault]
    samples = wall()
    samples[place] = value
    assert_wall(depth_scene(samples, ROWS, COLS, meaning=meaning))


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("pixel", [(0, 0), (1, 3), (ROWS - 1, COLS - 1)])
def test_a_pixel_is_a_hole_if_most_of_its_samples_have_no_depth(fault, pixel):
    """The others keep their distance."""
    value, meaning = FAULTS[fault]
    row, col = pixel
    for missing in range(SIDE * SIDE + 1):
        samples = wall()
        own = np.full(SIDE * SIDE, WALL_M)
        own[:missing] = value
        cell = slice(SIDE * row, SIDE * (row + 1)), slice(SIDE * col, SIDE * (col + 1))
        samples[cell] = own.reshape(SIDE, SIDE)
        is_hole = 2 * missing > SIDE * SIDE
        assert_wall(depth_scene(samples, ROWS, COLS, meaning=meaning), [pixel] * is_hole)


OTHERS = [  # samples in front of the wall and behind it: fewer of each than of the wall
    (before, behind)
    for before, behind in product(range(SIDE * SIDE), repeat=2)
    if SIDE * SIDE - before - behind > max(before, behind)
]


@pytest.mark.parametrize(("before", "behind"), OTHERS)
def test_a_pixel_has_the_surface_that_most_of_its_samples_see(before, behind):
    """Whether the others are in front of it or behind it."""
    samples = np.full(SIDE * SIDE, WALL_M)
    samples[:before] = WALL_M - 2
    samples[SIDE * SIDE - behind :] = WALL_M + 2
    everywhere = np.tile(samples.reshape(SIDE, SIDE), (ROWS, COLS))
    assert_wall(depth_scene(everywhere, ROWS, COLS, meaning=Meaning()))


@pytest.mark.parametrize("fault", FAULTS)
def test_one_sample_of_each_pixel_without_depth_costs_no_pixel(fault):
    value, meaning = FAULTS[fault]
    samples = wall()
    samples[1::SIDE, 1::SIDE] = value
    assert_wall(depth_scene(samples, ROWS, COLS, meaning=meaning))


@pytest.mark.parametrize("bad_m", [-1.0, RANGE_M + 1.0, 0.01])
@pytest.mark.parametrize("holes", [0, 100])
def test_bad_samples_are_counted_among_those_that_have_a_depth(bad_m, holes):
    """Up to a tenth of them is left out, with a note; more of them mean another unit."""
    for bad, is_refused in ((0.1, False), (0.12, True)):
        samples = wall()
        flat = samples.reshape(-1)
        flat[:holes] = np.nan
        number = int(bad * (flat.size - holes))
        flat[flat.size - number :] = bad_m + 0.001 * np.arange(number)
        if is_refused:
            with pytest.raises(InputError, match=f"{number / (flat.size - holes):.0%} of the"):
                depth_scene(samples, ROWS, COLS)
        else:
            assert any(
                f"{number} samples" in note for note in depth_scene(samples, ROWS, COLS).notes
            )
