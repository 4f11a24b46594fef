# SPDX-License-Identifier: Apache-2.0
"""Which share of a pulse falls into the bins of gates, by the law of the pulse."""

import numpy as np
import pytest
from scipy.stats import norm

from coincid.model.depth.count_light import pulse_shares
from coincid.model.depth.count_likelihood import NO_TICK
from coincid.model.depth.pulse_ticks import PulseTicks

SIGMA_TICKS = 6.0
BINS, WIDTH = 16, 4
# Two subgroups of two pixels with two gates.
FIRST = np.array([[[100, 180], [96, NO_TICK]], [[32, 400], [0, 64]]])
TIME = np.array([[131.3, 140.0], [30.0, np.nan]])


def shares():
    return pulse_shares(FIRST, WIDTH, BINS, PulseTicks(SIGMA_TICKS), TIME)


def test_each_bin_has_the_share_between_its_edges():
    """Whether the pulse is in a gate, at its begin, or in none."""
    found = shares()
    assert found.shape == (2, 2, 2, BINS)
    for s, pixel, gate in np.ndindex(FIRST.shape):
        if FIRST[s, pixel, gate] == NO_TICK or np.isnan(TIME[s, pixel]):
            continue
        edges = FIRST[s, pixel, gate] + WIDTH * np.arange(BINS + 1) - TIME[s, pixel]
        expected = np.diff(norm.cdf(edges / SIGMA_TICKS))
        assert found[s, pixel, gate] == pytest.approx(expected, abs=2e-3)
    assert found[0, 0, 0].sum() == pytest.approx(1, abs=2e-3)
    assert found[1, 0, 0].sum() == pytest.approx(norm.sf(2 / SIGMA_TICKS), abs=2e-3)
    assert found[1, 0, 1].sum() == pytest.approx(0)


def test_gates_that_are_not_there_and_pixels_without_a_pulse_have_no_share():
    """Even if the pulse comes at the first ticks of the period."""
    found = pulse_shares(FIRST, WIDTH, BINS, PulseTicks(SIGMA_TICKS), np.full((2, 2), 1.0))
    assert not found[0, 1, 1].any()
    assert found[1, 1, 0].sum() > 0.5
    assert not shares()[1, 1].any()
