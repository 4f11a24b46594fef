# SPDX-License-Identifier: Apache-2.0
"""Laws of photons and SPADs that hold for any scene: places, mirrors, sums, limits.

Counts are compared at a level of 0.1 % with fixed seeds.
"""

import numpy as np
import pytest
from scipy import stats

from coincid.model.light.light import Light
from coincid.model.light.photons import generate_edges
from coincid.model.light.spad import Spad
from coincid.model.light.timing import Timing
from coincid.model.shared.constants import SPEED_OF_LIGHT_M_S

LEVEL = 1e-3
ROWS = 4
COLS = 5
TIMING = Timing(clock_hz=500e6, phases=32, period_cycles=100)
IDEAL = Spad(dead_time_s=0, jitter_fwhm_s=0)
REAL = Spad(dark_cps=1e6, afterpulse_probability=0.05, crosstalk_probability=0.02)
SURE = 40.0  # photons per pulse of a pixel that always fires


def light(signal=0.0, noise_cps=0.0, distance_m=15.0, **others):
    return Light(
        rows=ROWS,
        cols=COLS,
        distance_m=distance_m,
        signal_per_pulse=signal,
        background_cps=noise_cps,
        **others,
    )


def counts(scene, spad=IDEAL, pulses=400, seed=1):
    """Return the edges of each pixel, int64[rows, cols]."""
    edges = generate_edges(scene, spad, TIMING, pulses=pulses, seed=seed)
    return np.bincount(edges.pixel, minlength=ROWS * COLS).reshape(ROWS, COLS)


def alike(first, second):
    """Return whether counts of two runs have the same means, place by place."""
    total = np.maximum(first + second, 1)
    chi = np.sum((first - second) ** 2 / total)
    return stats.chi2.sf(chi, first.size) > LEVEL


def gradient():
    """Return a light that is different in every pixel."""
    return np.linspace(0.1, 2.0, ROWS * COLS)


@pytest.mark.parametrize("pixel", range(ROWS * COLS))
def test_crosstalk_of_every_place_reaches_its_neighbours_in_the_array(pixel):
    """Also at edges and corners, beyond which there is nothing, not the next row."""
    signal = np.zeros(ROWS * COLS)
    signal[pixel] = SURE
    spad = Spad(jitter_fwhm_s=0, crosstalk_probability=0.25)
    struck = counts(light(signal), spad) > 0
    row, col = divmod(pixel, COLS)
    there_row, there_col = np.indices((ROWS, COLS))
    away = np.abs(there_row - row) + np.abs(there_col - col)
    assert np.array_equal(struck, away <= 1)


@pytest.mark.parametrize("spad", [IDEAL, REAL], ids=["ideal", "real"])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_light_gives_a_mirrored_count(spad, axis):
    signal = gradient().reshape(ROWS, COLS)
    found = counts(light(signal.ravel()), spad, pulses=2000)
    mirrored = counts(light(np.flip(signal, axis).ravel()), spad, pulses=2000, seed=2)
    assert alike(np.flip(found, axis), mirrored)
    assert not alike(found, mirrored)


def test_lights_add_up():
    """Of signal, background and targets, without dead time: means of Poisson laws."""
    signal = gradient()
    noise_cps = np.flip(gradient()) / TIMING.period_s
    apart = counts(light(signal), seed=2) + counts(light(0.0, noise_cps), seed=3)
    assert alike(counts(light(signal, noise_cps)), apart)
    split = np.stack([signal / 4, signal * 3 / 4], axis=1)
    distance_m = np.broadcast_to([10.0, 20.0], split.shape)
    assert alike(counts(light(split, distance_m=distance_m)), counts(light(signal), seed=4))


def test_counts_grow_with_pulses_and_light():
    signal = gradient()
    once = counts(light(signal), pulses=4000)
    twice = counts(light(2 * signal), pulses=2000, seed=2)
    assert alike(once, twice)
    expected = 4000 * signal.reshape(ROWS, COLS)
    assert stats.chi2.sf(np.sum((once - expected) ** 2 / expected), once.size) > LEVEL


def test_no_light_leaves_no_edge_and_little_light_one_at_most():
    assert counts(light(), Spad()).sum() == 0
    dim = counts(light(1e-6), Spad(), pulses=1000)
    assert dim.max() <= 1


@pytest.mark.parametrize("paralyzable", [False, True])
def test_edges_of_a_pixel_are_a_dead_time_apart(paralyzable):
    """However strong the light; so their number has a limit, and a paralyzable SPAD goes blind."""
    dead_s = 10e-9
    spad = Spad(dead_time_s=dead_s, jitter_fwhm_s=0, paralyzable=paralyzable)
    pulses = 50
    edges = generate_edges(light(0.0, 2e9), spad, TIMING, pulses=pulses, seed=1)
    period_ticks = TIMING.period_cycles * TIMING.phases
    at = edges.pulse * period_ticks + edges.tick
    dead_ticks = dead_s / TIMING.tick_s
    for pixel in range(ROWS * COLS):
        gaps = np.diff(np.sort(at[edges.pixel == pixel]))
        assert np.all(gaps >= dead_ticks - 1)
    most = ROWS * COLS * pulses * (period_ticks / dead_ticks)
    if paralyzable:
        assert len(edges) < 0.001 * most + 2 * ROWS * COLS
    else:
        assert 0.9 * most < len(edges) <= most + ROWS * COLS


def test_light_of_a_pixel_comes_at_its_own_distance():
    """Farther pixels fire later, each by its flight time."""
    distance_m = np.linspace(2.0, 25.0, ROWS * COLS)
    edges = generate_edges(
        light(SURE, distance_m=distance_m, system_fwhm_s=10e-12),
        Spad(jitter_fwhm_s=0),
        TIMING,
        pulses=3,
        seed=1,
    )
    flight_ticks = 2 * distance_m / SPEED_OF_LIGHT_M_S / TIMING.tick_s
    assert np.all(np.abs(edges.tick - flight_ticks[edges.pixel]) <= 2)
