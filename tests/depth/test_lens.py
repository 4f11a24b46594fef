# SPDX-License-Identifier: Apache-2.0
"""The lens that is found from a frame: of arrays that are not square, and of pixels that are not."""

import math

import numpy as np
import pytest

from coincid.model.depth.lens import find_lens

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
