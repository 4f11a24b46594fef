# SPDX-License-Identifier: Apache-2.0
"""Interpolation in compiled code is NumPy's."""

import numpy as np
import pytest

from coincid.model.shared.compiled import njit
from coincid.model.shared.interpolation import interpolated


@njit
def _at(x, xs, ys):
    return interpolated(x, xs, ys)


@pytest.mark.parametrize("points", [1, 2, 3, 8, 9])
def test_values_between_beside_and_at_the_points_are_those_of_numpy(points):
    rng = np.random.default_rng(points)
    xs = np.sort(rng.uniform(-3, 3, points))
    ys = rng.uniform(-3, 3, points)
    between = (xs[1:] + xs[:-1]) / 2
    for x in (*xs, *between, xs[0] - 1, xs[-1] + 1, *rng.uniform(-4, 4, 50)):
        assert _at(x, xs, ys) == pytest.approx(np.interp(x, xs, ys), abs=1e-12)


def test_where_a_line_is_vertical_the_lower_point_counts():
    xs = np.array([0.0, 1.0, 1.0, 2.0])
    ys = np.array([0.0, 4.0, 6.0, 7.0])
    assert _at(1.0, xs, ys) == 4.0
    assert _at(np.nextafter(1.0, 0), xs, ys) == pytest.approx(4.0)
    assert _at(np.nextafter(1.0, 2), xs, ys) == pytest.approx(6.0)
