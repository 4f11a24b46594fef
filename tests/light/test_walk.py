# SPDX-License-Identifier: Apache-2.0
"""Trapped carriers that outlive their pulse, in each of the places of a pixel, and the order of its
photons.
"""

import numpy as np
import pytest

from coincid.model.light.walk import CARRIERS_MAX, _free_slot, _insert, _lose, _release, _sort
from coincid.model.shared.compiled import njit

PERIOD_TICKS = 100.0


@njit
def _released(carriers, photons, n):
    return _release(n, carriers, PERIOD_TICKS, photons)


@njit
def _lost(carriers, gap):
    _lose(carriers, gap)


@njit
def _place(carriers):
    return _free_slot(carriers)


@njit
def _sorted(photons, n):
    _sort(photons, n)


@njit
def _inserted(photons, n, t):
    return _insert(photons, n, t)


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


@pytest.mark.parametrize("slot", (0, 1, CARRIERS_MAX - 2, CARRIERS_MAX - 1))
def test_a_new_carrier_gets_a_free_place_or_that_of_the_latest(slot):
    carriers = np.arange(CARRIERS_MAX, dtype=np.float64)
    for latest in (np.inf, 1e6):
        carriers[slot] = latest
        assert _place(carriers) == slot


@pytest.mark.parametrize("n", (0, 1, 2, 3, 4, 5, 33, 58, 133, 1500))
def test_photons_are_sorted_up_to_the_last_one(n):
    """Those behind them stay where they are."""
    times = np.random.default_rng(n).random(n + 3)
    for photons in (times, np.flip(times), np.sort(times)):
        found = photons.copy()
        _sorted(found, n)
        assert found.tolist() == [*np.sort(photons[:n]), *photons[n:]]


def test_a_photon_is_inserted_in_its_order_while_there_is_room():
    photons = np.zeros(4)
    n = 0
    for t in (5.0, 3.0, 9.0, 3.0, 1.0):
        n = _inserted(photons, n, t)
    assert n == 4
    assert photons.tolist() == [3, 3, 5, 9]
