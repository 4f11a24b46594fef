# SPDX-License-Identifier: Apache-2.0
"""Functions of arrays that are the same on every processor are the functions of their names."""

import numpy as np
import pytest

from coincid.model.depth import portable
from coincid.model.depth.surfaces import BRIGHT_LIGHTS, COARSE_LIGHTS, FAINT_LIGHTS

ABOVE_0 = np.concatenate([np.geomspace(1e-30, 1e30, 61), [1.0, np.e]])
ALL = np.concatenate([-ABOVE_0[30:], [0.0], np.geomspace(1e-12, 80, 40)])
FUNCTIONS = [
    (portable.exp, np.exp, ALL),
    (portable.expm1, np.expm1, ALL),
    (portable.log, np.log, ABOVE_0),
    (portable.log1p, np.log1p, np.concatenate([-np.geomspace(1e-12, 0.999, 30), [0.0], ABOVE_0])),
]


@pytest.mark.parametrize("kind", [np.float64, np.float32])
@pytest.mark.parametrize(("function", "of_numpy", "values"), FUNCTIONS)
def test_they_are_those_of_numpy_except_for_the_last_bits(function, of_numpy, values, kind):
    values = values.astype(kind)
    found = function(values)
    assert found.dtype == kind
    np.testing.assert_array_almost_equal_nulp(found, of_numpy(values), 8)


def test_the_logarithm_of_nothing_is_below_all_numbers():
    assert portable.log(np.zeros(2)).tolist() == [-np.inf] * 2
    assert portable.exp(np.array([-np.inf, 1e4])).tolist() == [0.0, np.inf]


@pytest.mark.parametrize(
    ("first", "last", "number"), [(1.0, 8.0, 4), (0.09, 3.3, 10), (40.0, 0.02, 7), (2.0, 2.0, 2)]
)
def test_steps_go_from_the_first_value_to_the_last_by_one_factor(first, last, number):
    steps = portable.geometric_steps(first, last, number)
    assert steps.shape == (number,)
    assert steps[0] == first and steps[-1] == pytest.approx(last)
    factors = steps[1:] / steps[:-1]
    assert factors == pytest.approx(np.full(number - 1, factors[0]))


def test_lights_that_are_tried_reach_from_the_faintest_to_the_brightest():
    """The bright ones go on where the faint ones end."""
    assert (COARSE_LIGHTS[0], COARSE_LIGHTS[-1]) == pytest.approx((0.02, 40))
    assert (FAINT_LIGHTS[0], BRIGHT_LIGHTS[-1]) == pytest.approx((0.015, 60))
    assert FAINT_LIGHTS[-1] == pytest.approx(BRIGHT_LIGHTS[0])
