# SPDX-License-Identifier: Apache-2.0
"""Polynomials through levels, against polynomials whose derivatives are known."""

import numpy as np
import pytest

from coincid.model.depth.curves import bend_at, slope_at, through_five, through_three

PLACES = np.array([-1.5, -0.5, 0.0, 0.75, 2.0])


def levels_of(polynomial, steps):
    return [polynomial(step) for step in range(-steps, steps + 1)]


@pytest.mark.parametrize(
    "through, steps, factors",
    [(through_three, 1, [2.0, -3.0, 5.0]), (through_five, 2, [2.0, -3.0, 5.0, 0.7, -0.4])],
)
def test_slope_and_bend_are_those_of_the_polynomial_through_the_levels(through, steps, factors):
    polynomial = np.polynomial.Polynomial(factors)
    curve = through(*levels_of(polynomial, steps))
    np.testing.assert_allclose(slope_at(curve, PLACES), polynomial.deriv(1)(PLACES))
    np.testing.assert_allclose(bend_at(curve, PLACES), polynomial.deriv(2)(PLACES))
    derivatives = [polynomial.deriv(number)(0.0) for number in (1, 2, 3, 4)]
    assert [*curve] == pytest.approx(derivatives, abs=1e-9)
