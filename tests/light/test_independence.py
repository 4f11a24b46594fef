# SPDX-License-Identifier: Apache-2.0
"""Random draws are independent: of pixels, pulses, avalanches, sides and purposes. Shared numbers
show in rank correlations.
"""

import itertools

import numpy as np
import pytest
from scipy import stats

from coincid.model.light.light import Light
from coincid.model.light.photons import generate_edges
from coincid.model.light.spad import Spad
from coincid.model.light.timing import Timing
from coincid.model.shared.constants import SPEED_OF_LIGHT_M_S

LEVEL = 1e-3  # of a test, for all its pairs together
TIMING = Timing(clock_hz=10e9, phases=64, period_cycles=5000)  # 500 ns in ticks of 1.6 ps
ALWAYS = 40.0  # photons per pulse: such a pixel fires in every one
APART_M = 6.0  # between targets: 40 ns, five dead times
TARGETS_M = 10.0 + APART_M * np.arange(3)  # of a pixel that fires three times per pulse


def assert_independent(columns: dict[str, np.ndarray]) -> None:
    """Check that no pair of columns (one row per pulse) has correlated ranks, within a row or
    between successive rows.
    """
    ranks = {name: stats.rankdata(column) for name, column in columns.items()}
    ranks = {name: (rank - rank.mean()) / rank.std() for name, rank in ranks.items()}
    pairs = [(a, b, 0) for a, b in itertools.combinations(ranks, 2)] + [
        (a, b, 1) for a in ranks for b in ranks
    ]
    limit = stats.norm.isf(LEVEL / 2 / len(pairs))
    for a, b, lag in pairs:
        n = len(ranks[a]) - lag
        together = float(ranks[a][lag:] @ ranks[b][:n]) / np.sqrt(n)
        assert abs(together) < limit, (
            f"{a} goes with {b}{' of the pulse before' if lag else ''}: {together:.1f} sigma"
        )


def first_ticks(edges, pixel, pulses, low=0, high=1 << 62):
    """Return the first tick in [low, high) of a pixel in every pulse, or -1."""
    mine = (edges.pixel == pixel) & (edges.tick >= low) & (edges.tick < high)
    first = np.full(pulses, 1 << 62)
    np.minimum.at(first, edges.pulse[mine], edges.tick[mine])
    return np.where(first == 1 << 62, -1, first)


def first_ticks_by_target(edges, pixel, pulses):
    """Return the `first_ticks` of a pixel around the time of each of `TARGETS_M`."""
    half = APART_M / SPEED_OF_LIGHT_M_S / TIMING.tick_s
    at_ticks = 2 * TARGETS_M / SPEED_OF_LIGHT_M_S / TIMING.tick_s
    return [first_ticks(edges, pixel, pulses, at - half, at + half) for at in at_ticks]


def test_sides_and_successive_avalanches_of_crosstalk():
    """For a pixel that fires three times per pulse: which neighbours each of the three avalanches
    hits.
    """
    pulses = 6000
    signal, distance = np.zeros((35, 3)), np.broadcast_to(TARGETS_M, (35, 3))
    signal[17] = ALWAYS
    light = Light(
        rows=5,
        cols=7,
        distance_m=distance,
        signal_per_pulse=signal,
        background_cps=0.0,
        system_fwhm_s=10e-12,
    )
    spad = Spad(jitter_fwhm_s=0, crosstalk_probability=0.25)
    edges = generate_edges(light, spad, TIMING, pulses=pulses, seed=3)
    struck = {
        f"{side} of avalanche {avalanche}": ticks >= 0
        for side, pixel in (("above", 10), ("left", 16), ("right", 18), ("below", 24))
        for avalanche, ticks in enumerate(first_ticks_by_target(edges, pixel, pulses))
    }
    assert all(0.2 < column.mean() < 0.3 for column in struck.values())
    assert_independent(struck)


@pytest.mark.parametrize(
    "jitter",
    [
        {"jitter_fwhm_s": 300e-12},
        {"jitter_fwhm_s": 0, "jitter_tail_fraction": 1, "jitter_tail_s": 300e-12},
        {"jitter_fwhm_s": 50e-12, "jitter_tail_fraction": 0.5, "jitter_tail_s": 900e-12},
    ],
)
def test_jitter_of_successive_avalanches(jitter):
    """For a pixel that fires three times per pulse: when each of the three avalanches is seen; its
    Gaussian, the length of its tail, and whether it has one.
    """
    pulses = 6000
    light = Light(
        rows=1,
        cols=1,
        distance_m=TARGETS_M[None],
        signal_per_pulse=np.full((1, 3), ALWAYS),
        background_cps=0.0,
        system_fwhm_s=max(10e-12, jitter["jitter_fwhm_s"]),
    )
    edges = generate_edges(light, Spad(**jitter), TIMING, pulses=pulses, seed=6)
    by_target = first_ticks_by_target(edges, 0, pulses)
    seen = {f"avalanche {avalanche}": ticks for avalanche, ticks in enumerate(by_target)}
    assert all(np.all(column >= 0) for column in seen.values())
    assert_independent(seen)


def test_pixels_and_pulses():
    """For 12 equal pixels: first times and counts of neighbours and others, and the same one pulse
    later.
    """
    pulses = 5000
    light = Light(rows=3, cols=4, distance_m=20.0, signal_per_pulse=0.7, background_cps=2e6)
    edges = generate_edges(light, Spad(), TIMING, pulses=pulses, seed=4)
    columns = {
        f"pixel {pixel}, first edge": first_ticks(edges, pixel, pulses) for pixel in range(12)
    }
    n = np.bincount(edges.pixel * pulses + edges.pulse, minlength=12 * pulses).reshape(12, pulses)
    assert_independent(columns)
    assert_independent({f"pixel {pixel}, edges": n[pixel] for pixel in range(12)})


def test_purposes_of_one_avalanche():
    """For one avalanche: its jitter, whether it traps a carrier, the carrier's release, and the
    neighbours it hits.
    """
    pulses, distance_m = 12_000, 20.0
    signal = np.zeros(35)
    signal[17] = ALWAYS
    light = Light(
        rows=5,
        cols=7,
        distance_m=distance_m,
        signal_per_pulse=signal,
        background_cps=0.0,
        system_fwhm_s=300e-12,
    )
    spad = Spad(
        jitter_fwhm_s=300e-12,
        afterpulse_probability=0.3,
        afterpulse_s=30e-9,
        crosstalk_probability=0.25,
    )
    edges = generate_edges(light, spad, TIMING, pulses=pulses, seed=5)
    at = 2 * distance_m / SPEED_OF_LIGHT_M_S / TIMING.tick_s
    near = 1.5e-9 / TIMING.tick_s
    own = first_ticks(edges, 17, pulses, at - near, at + near)
    released = first_ticks(edges, 17, pulses, at + near)
    columns = {"jitter": own, "carrier": released >= 0}
    columns |= {
        f"side {side}": first_ticks(edges, pixel, pulses, at - near, at + near) >= 0
        for side, pixel in enumerate((10, 16, 18, 24))
    }
    assert np.all(own >= 0) and 0.1 < columns["carrier"].mean() < 0.3
    assert_independent(columns)
    some = released >= 0  # the pulses with a carrier, and its release
    assert_independent(
        {name: column[some] for name, column in columns.items() if name != "carrier"}
        | {"release": released[some]}
    )
