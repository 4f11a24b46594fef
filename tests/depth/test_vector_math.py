# SPDX-License-Identifier: Apache-2.0
"""Logarithm and exponential of kernels, against those of NumPy."""

import numpy as np
import pytest

from coincid.model.depth.vector_math import EXP_MIN, fast_exp, fast_log, top_of
from coincid.model.shared.compiled import njit

ERROR_OF_LOG = 2e-6
RELATIVE_OF_EXP = 5e-6


@njit
def _logs(values, found):
    for k in range(len(values)):
        found[k] = fast_log(values[k])


@njit
def _exps(values, found):
    for k in range(len(values)):
        found[k] = fast_exp(values[k])


@njit
def _top(values):
    return top_of(values)


def test_logarithms_of_all_magnitudes():
    values = np.geomspace(1e-37, 1e38, 100_001).astype(np.float32)
    found = np.empty_like(values)
    _logs(values, found)
    expected = np.log(values.astype(np.float64))
    assert found == pytest.approx(expected, rel=1e-6, abs=ERROR_OF_LOG)


def test_exponentials_of_all_magnitudes():
    values = np.linspace(0.99 * EXP_MIN, 0, 100_001).astype(np.float32)
    found = np.empty_like(values)
    _exps(values, found)
    expected = np.exp(values.astype(np.float64))
    rounded = np.abs(values) * np.finfo(np.float32).eps  # of the power of two
    assert np.all(np.abs(found / expected - 1) < RELATIVE_OF_EXP + rounded)


def test_exponentials_below_the_least_are_its_own():
    found = np.empty(2, np.float32)
    _exps(np.array([EXP_MIN, 10 * EXP_MIN], np.float32), found)
    assert found[0] == found[1]
    assert 0 < found[0] < 1e-30


@pytest.mark.parametrize("length", (1, 2, 7, 64))
def test_the_top_is_found_anywhere(length):
    for at in range(length):
        values = np.full(length, -np.inf, np.float32)
        values[at] = -3.0
        assert _top(values) == -3.0
