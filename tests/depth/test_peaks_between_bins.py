# SPDX-License-Identifier: Apache-2.0
"""Peaks between the bins of a coarse grid, in each of its bins, the first and the last one included."""

import numpy as np
import pytest

from coincid.model.depth.surfaces import peak_offset

BINS = 9
BEND = 0.8  # per squared bin


def parabolas(peak):
    """float32[rows, cols, BINS]: levels with their peaks at these places, in bins."""
    return (-BEND / 2 * (np.arange(BINS) - peak[:, :, None]) ** 2).astype(np.float32)


@pytest.mark.parametrize("smooth", [False, True])
def test_the_peak_of_a_parabola_is_where_it_is(smooth):
    reach = 2 if smooth else 1
    chosen = np.array([[reach, 4, BINS - 1 - reach], [3, reach, 5]])
    off = np.array([[0.3, -0.45, 0.0], [0.2, -0.1, 0.4]])
    found = peak_offset(parabolas(chosen + off), chosen, smooth=smooth)
    assert found == pytest.approx(off, abs=1e-5)


@pytest.mark.parametrize("smooth", [False, True])
def test_a_peak_is_at_most_half_a_bin_from_the_chosen_one(smooth):
    chosen = np.array([[3, 5]])
    found = peak_offset(parabolas(chosen + [[1.4, -1.4]]), chosen, smooth=smooth)
    assert found.tolist() == [[0.5, -0.5]]


@pytest.mark.parametrize("smooth", [False, True])
def test_levels_that_are_turned_round_have_the_opposite_peak_in_every_bin(smooth):
    level = np.random.default_rng(3).normal(0, 1, (2, BINS, BINS)).astype(np.float32)
    chosen = np.tile(np.arange(BINS), (2, 1))
    level[np.arange(2)[:, None], np.arange(BINS), chosen] += 2
    found = peak_offset(level, chosen, smooth=smooth)
    turned = peak_offset(level[:, :, ::-1], BINS - 1 - chosen, smooth=smooth)
    assert turned == pytest.approx(-found, abs=1e-9)
    assert len(np.unique(found)) > BINS
