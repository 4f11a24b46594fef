# SPDX-License-Identifier: Apache-2.0
"""Trapped carriers that outlive their pulse, in each of the places of a pixel."""

import numpy as np
import pytest

from coincid.model.light.walk import CARRIERS_MAX, _lose, _release
from coincid.model.shared.compiled import njit

PERIOD_TICKS = 100.0


@njit
def _released(carriers, photons, n):
    return _release(n, carriers, PERIOD_TICKS, photons)


@njit
def _lost(carriers, gap):
    _lose(carriers, gap)


def carriers_at(slot, ticks):
    """float64[CARRIERS_MAX]: one carrier at a place, the others free."""
    carriers = np.full(CARRIERS_MAX, np.inf)
    carriers[slot] = ticks
    return carriers


@pytest.mark.parametrize("slot", (0, 1, CARRIERS_MAX - 2, CARRIERS_MAX - 1))
def test_a_carrier_in_any_place_is_released_once_in_its_own_period(slot):
    carriers = carriers_at(slot, 230.0)
    photons = np.zeros(8)
    photons[0] = 50.0
    for expected in ([50], [50], [30, 50], [50]):
        n = _released(carriers, photons, 1)
        assert photons[:n].tolist() == expected
        photons[0] = 50.0
    assert np.all(carriers == np.inf)


@pytest.mark.parametrize("slot", (0, 1, CARRIERS_MAX - 2, CARRIERS_MAX - 1))
def test_a_carrier_in_any_place_is_lost_in_a_gap_that_holds_its_release(slot):
    for gap, left in ((20.0, 10.0), (30.0, 0.0), (40.0, np.inf)):
        carriers = carriers_at(slot, 30.0)
        _lost(carriers, gap)
        assert carriers[slot] == left
        assert np.all(np.delete(carriers, slot) == np.inf)


def test_all_places_are_released_together():
    carriers = np.arange(CARRIERS_MAX, dtype=np.float64)[::-1].copy()
    photons = np.zeros(2 * CARRIERS_MAX)
    assert _released(carriers, photons, 0) == CARRIERS_MAX
    assert photons[:CARRIERS_MAX].tolist() == list(range(CARRIERS_MAX))
