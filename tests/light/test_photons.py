# SPDX-License-Identifier: Apache-2.0
"""Photons against exact closed forms, at a level of 0.1 % with fixed seeds."""

import math
from itertools import pairwise

import numpy as np
import pytest
from attrs import evolve, fields_dict
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from coincid.model.contract.config import parse_config
from coincid.model.light.code_density import code_density
from coincid.model.light.light import Arrivals, Light, background_cps, signal_per_pulse
from coincid.model.light.photons import _photons_per_pulse, edge_chunks, generate_edges
from coincid.model.light.spad import Spad, SpadGate, dark_count_map
from coincid.model.light.timing import Timing
from coincid.model.shared.constants import SIGMA_PER_FWHM, SPEED_OF_LIGHT_M_S
from coincid.model.shared.errors import SEED_MAX, InputError

from ..random_cases import configured

LEVEL = 1e-3
BARE = Spad(dead_time_s=0, jitter_fwhm_s=0)
# 500 ns in ticks of 1.6 ps: practically continuous time
FINE = Timing(clock_hz=10e9, phases=64, period_cycles=5000)
LONG = Timing(phases=1024, period_cycles=1 << 20)  # of as many ticks as a period may have
EVERYTHING = Spad(
    paralyzable=True,
    jitter_tail_fraction=0.1,
    jitter_tail_s=300e-12,
    dark_cps=1e5,
    afterpulse_probability=0.05,
    afterpulse_s=1e-6,
    crosstalk_probability=0.02,
)


def light(rows=8, cols=8, distance_m=20.0, signal=0.0, noise_cps=0.0, **others):
    return Light(
        rows=rows,
        cols=cols,
        distance_m=distance_m,
        signal_per_pulse=signal,
        background_cps=noise_cps,
        **others,
    )


def edges_of(light, spad=BARE, timing=FINE, *, seed=1, **options):
    return generate_edges(light, spad, timing, seed=seed, **options)


def time_s(edges, timing=FINE):
    """Return times since the edges' laser triggers, spread evenly over each tick, because the tests
    need continuous times.
    """
    return (edges.tick + np.random.default_rng(0).random(len(edges))) * timing.tick_s


def counts(edges, pixels, pulses):
    """Return the number of edges of every pixel and pulse, int64[pixels * pulses]."""
    return np.bincount(edges.pixel * pulses + edges.pulse, minlength=pixels * pulses)


def assert_law(observed, law, level=LEVEL):
    """Chi-square test of integer samples against a discrete law; rare classes are joined at the
    ends.
    """
    values = np.arange(observed.max() + 1)
    expected = law.pmf(values) * len(observed)
    low, high = np.flatnonzero(expected >= 5)[[0, -1]]
    n = np.bincount(observed)
    joined = [np.r_[a[: low + 1].sum(), a[low + 1 : high], a[high:].sum()] for a in (n, expected)]
    joined[1][-1] += len(observed) - joined[1].sum()
    assert stats.chisquare(*joined).pvalue > level


def assert_mean(total, expected, deviation, level=LEVEL):
    assert abs(total - expected) < stats.norm.isf(level / 2) * deviation


def same(a, b):
    return all(
        getattr(a, name).tobytes() == getattr(b, name).tobytes()
        for name in ("pulse", "pixel", "tick")
    )


@pytest.mark.parametrize("mean", [0.05, 0.613, 9.8, 200.0])
@pytest.mark.parametrize("kind", ["signal", "noise", "both"])
def test_photons_are_poisson(mean, kind):
    share = {"signal": 1, "noise": 0, "both": 0.4}[kind]
    scene = light(signal=mean * share, noise_cps=mean * (1 - share) / FINE.period_s)
    assert_law(counts(edges_of(scene, pulses=1000), 64, 1000), stats.poisson(mean))


@pytest.mark.parametrize("dead_fraction", [0.05, 1.0, 8.0])
@pytest.mark.parametrize("paralyzable", [False, True])
def test_dead_time_leaves_the_known_rate(paralyzable, dead_fraction):
    """Asymptotic mean and variance of the counts of a renewal process with dead time (Mueller
    1973).
    """
    dead_s, pulses = 8e-9, 400
    rate_cps = dead_fraction / dead_s
    spad = Spad(dead_time_s=dead_s, jitter_fwhm_s=0, paralyzable=paralyzable)
    n, x = len(edges_of(light(noise_cps=rate_cps), spad, pulses=pulses)), dead_fraction
    photons = rate_cps * pulses * FINE.period_s * 64
    if paralyzable:
        expected, variance = (
            photons * math.exp(-x),
            photons * math.exp(-x) * (1 - 2 * x * math.exp(-x)),
        )
    else:
        expected, variance = photons / (1 + x), photons / (1 + x) ** 3
    at_the_start = 64  # at most one more count per pixel, because it starts ready
    assert_mean(n, expected + at_the_start / 2, math.sqrt(variance) + at_the_start / 2)


@pytest.mark.parametrize("mean", [8.0, 32.0, 60.0, 300.0])
def test_light_in_bins_meets_the_dead_time_in_the_order_of_time(mean):
    """Photons of bins are drawn in any order; many of them are sorted in another way than few. Spread
    over the whole period, they are like noise.
    """
    pixels, bins, pulses = 8, 50, 500
    start_s = np.arange(bins) * FINE.period_s / bins
    arrivals = Arrivals(
        first=bins * np.arange(pixels + 1),
        start_s=np.tile(start_s, pixels),
        photons=np.full(pixels * bins, mean / bins),
        width_s=FINE.period_s / bins,
    )
    scene = light(1, pixels, distance_m=np.nan, arrivals=arrivals)
    spad = Spad(dead_time_s=8e-9, jitter_fwhm_s=0)
    dead_fraction = mean * spad.dead_time_s / FINE.period_s
    expected = pixels * pulses * mean / (1 + dead_fraction)
    deviation = math.sqrt(expected) / (1 + dead_fraction)
    assert_mean(len(edges_of(scene, spad, pulses=pulses)), expected, deviation + pixels)


def test_gaps_after_the_dead_time_are_exponential_across_pulses():
    dead_s, rate_cps = 8e-9, 5e6
    edges = edges_of(
        light(1, 1, noise_cps=rate_cps), Spad(dead_time_s=dead_s, jitter_fwhm_s=0), pulses=20_000
    )
    gaps_s = np.diff(edges.pulse * FINE.period_ticks + edges.tick) * FINE.tick_s
    assert stats.kstest(gaps_s - dead_s, stats.expon(scale=1 / rate_cps).cdf).pvalue > LEVEL


@pytest.mark.parametrize("signal", [0.02, 0.1, 0.613])
def test_distinct_pixels_of_a_subgroup_are_binomial(signal):
    """A SPAD fires at most once per laser period: of 64 pixels, each with probability 1 -
    exp(-signal).
    """
    pulses = 4000
    edges = edges_of(light(signal=signal), Spad(), pulses=pulses)
    assert_law(np.bincount(edges.pulse, minlength=pulses), stats.binom(64, -math.expm1(-signal)))


def test_first_photon_time():
    """Inhomogeneous Poisson process: F(t) = 1 - exp(-(noise t + signal Phi((t - tof) / sigma)))."""
    signal, rate_cps, distance_m, pulses = 1.2, 3e6, 40.0, 400
    scene = light(distance_m=distance_m, signal=signal, noise_cps=rate_cps, system_fwhm_s=5e-9)
    edges = edges_of(scene, pulses=pulses)
    # sorted in time within a pulse
    _, first = np.unique(edges.pixel * pulses + edges.pulse, return_index=True)
    sigma_s, flight_s = 5e-9 * SIGMA_PER_FWHM, 2 * distance_m / SPEED_OF_LIGHT_M_S

    def reached(t_s):
        return -np.expm1(-(rate_cps * t_s + signal * stats.norm.cdf(t_s, flight_s, sigma_s)))

    cdf = reached(time_s(edges)[first]) / reached(FINE.period_s)
    assert stats.kstest(cdf, "uniform").pvalue > LEVEL


@pytest.mark.parametrize("jitter_fwhm_s", [0.0, 100e-12, 500e-12])
def test_pulse_and_jitter_add_up_to_the_system_width(jitter_fwhm_s):
    spad = Spad(dead_time_s=0, jitter_fwhm_s=jitter_fwhm_s)
    edges = edges_of(light(distance_m=20.0, signal=1.0), spad, pulses=1000)
    late_s = time_s(edges) - 2 * 20.0 / SPEED_OF_LIGHT_M_S
    assert stats.kstest(late_s, stats.norm(scale=500e-12 * SIGMA_PER_FWHM).cdf).pvalue > LEVEL


def test_jitter_of_one_avalanche_is_the_spads_alone():
    """The laser pulse has no width here, so the spread is only jitter and tail."""
    fraction, tail_s, sigma_s = 0.2, 300e-12, 100e-12 * SIGMA_PER_FWHM
    spad = Spad(jitter_tail_fraction=fraction, jitter_tail_s=tail_s)
    edges = edges_of(light(distance_m=20.0, signal=5.0, system_fwhm_s=100e-12), spad, pulses=1000)
    late_s = time_s(edges) - 2 * 20.0 / SPEED_OF_LIGHT_M_S

    def cdf(t_s):
        tailed = stats.exponnorm(tail_s / sigma_s, scale=sigma_s).cdf(t_s)
        return (1 - fraction) * stats.norm(scale=sigma_s).cdf(t_s) + fraction * tailed

    assert stats.kstest(late_s, cdf).pvalue > LEVEL


def test_crosstalk_reaches_four_neighbours_with_its_probability():
    probability, pulses = 0.05, 10_000
    signal = np.zeros(35)
    signal[17] = 40.0  # fires in every pulse
    spad = Spad(jitter_fwhm_s=0, crosstalk_probability=probability)
    edges = edges_of(light(5, 7, signal=signal), spad, pulses=pulses)
    n = np.bincount(edges.pixel, minlength=35)
    assert n[17] == pulses
    assert set(np.flatnonzero(n)) == {10, 16, 17, 18, 24}
    for neighbour in (10, 16, 18, 24):
        assert stats.binomtest(int(n[neighbour]), pulses, probability).pvalue > LEVEL
    struck = np.bincount(edges.pulse[edges.pixel != 17], minlength=pulses)
    assert_law(struck, stats.binom(4, probability))


def test_crosstalk_meets_the_neighbours_dead_time():
    """Two pixels always fire within a dead time of each other: crosstalk fires the later one only
    while it is ready.
    """
    spad = Spad(jitter_fwhm_s=0, crosstalk_probability=0.25)
    early, late = 20.0, 20.3  # 2 ns apart
    scene = light(1, 2, distance_m=np.array([early, late]), signal=40.0, system_fwhm_s=50e-12)
    pulses = 4000
    edges = edges_of(scene, spad, pulses=pulses)
    assert np.all(counts(edges, 2, pulses) == 1)
    flight_ticks = 2 * early / SPEED_OF_LIGHT_M_S / FINE.tick_s
    struck = (edges.pixel == 1) & (edges.tick < flight_ticks + 500)
    assert stats.binomtest(int(struck.sum()), pulses, 0.25).pvalue > LEVEL


@pytest.mark.parametrize("timing", [FINE, Timing(dither_bits=3, gap_cycles=5)])
def test_no_fault_of_a_spad_makes_edges_in_the_dark(timing):
    """All of them but dark counts follow an avalanche, also in the first pulse."""
    assert len(edges_of(light(), evolve(EVERYTHING, dark_cps=0.0), timing, pulses=3)) == 0


def test_a_spad_begins_ready():
    """Bright light fires it in the first pulse as in every other one."""
    spad = evolve(EVERYTHING, dead_time_s=100e-9, dark_cps=0.0, crosstalk_probability=0.0)
    edges = edges_of(light(1, 4, distance_m=0.5, signal=100.0), spad, pulses=3)
    fired = edges.tick * FINE.tick_s < 20e-9
    assert np.all(counts(edges.take(fired), 4, 3) > 0)


# with the second, carriers outlive their pulse
@pytest.mark.parametrize("distance_m", [20.0, 74.0])
def test_afterpulses(distance_m):
    probability, trap_s, pulses = 0.1, 30e-9, 5000
    spad = Spad(jitter_fwhm_s=0, afterpulse_probability=probability, afterpulse_s=trap_s)
    edges = edges_of(
        light(1, 4, distance_m=distance_m, signal=40.0, system_fwhm_s=10e-12), spad, pulses=pulses
    )
    seen = probability * math.exp(-spad.dead_time_s / trap_s)
    since_s = edges.pulse * FINE.period_s + time_s(edges)
    order = np.lexsort((since_s, edges.pixel))
    since_s, pixel = since_s[order], edges.pixel[order]
    primary = np.abs(since_s % FINE.period_s - 2 * distance_m / SPEED_OF_LIGHT_M_S) < 1e-9
    followed = primary[:-1] & ~primary[1:] & (pixel[:-1] == pixel[1:])
    assert stats.binomtest(int(followed.sum()), int(primary.sum()), seen).pvalue > LEVEL
    gaps_s = np.diff(since_s)[followed] - spad.dead_time_s
    assert stats.kstest(gaps_s, stats.expon(scale=trap_s).cdf).pvalue > LEVEL


@given(st.integers(0, SEED_MAX), st.integers(1, 3), st.integers(1, 50), st.integers(0, 10**9))
@settings(max_examples=20, deadline=None)
def test_same_bytes_for_any_workers_and_chunks(seed, workers, chunk_pulses, start):
    scene = light(4, 5, signal=0.5, noise_cps=3e6)
    options = dict(timing=Timing(), seed=seed, pulses=40, pulse_start=start)
    whole = edges_of(scene, EVERYTHING, **options)
    assert same(
        whole, edges_of(scene, EVERYTHING, workers=workers, chunk_pulses=chunk_pulses, **options)
    )
    assert whole.pulse.min() >= start and whole.pulse.max() < start + 40


def test_more_photons_and_edges_than_were_estimated_are_all_there(monkeypatch):
    """Crosstalk and afterpulses follow each other, which the sizes of the buffers do not foresee."""
    spad = Spad(
        jitter_fwhm_s=0,
        dead_time_s=1e-9,
        afterpulse_probability=0.5,
        afterpulse_s=200e-9,
        crosstalk_probability=0.25,
    )
    scene = light(5, 7, noise_cps=2e8)
    found = edges_of(scene, spad, pulses=12)
    assert len(found) > 1.2 * 12 * 35 * 2e8 * FINE.period_s
    monkeypatch.setattr(
        "coincid.model.light.photons._photons_per_pulse",
        lambda *light: 20 * _photons_per_pulse(*light),
    )
    assert same(found, edges_of(scene, spad, pulses=12))
    monkeypatch.setattr(
        "coincid.model.light.photons._edges_per_pulse", lambda *light: np.zeros(scene.pixels)
    )
    assert len(found) > 2000  # more than a buffer for no edges has room for
    assert same(found, edges_of(scene, spad, pulses=12))


def test_chunks_are_sorted_and_follow_each_other():
    chunks = list(
        edge_chunks(
            light(signal=0.3, noise_cps=5e6), Spad(), Timing(), pulses=30, seed=1, chunk_pulses=7
        )
    )
    spans = [(chunk.pulse.min(), chunk.pulse.max()) for chunk in chunks]
    assert spans == [(0, 6), (7, 13), (14, 20), (21, 27), (28, 29)]
    for chunk in chunks:
        order = np.lexsort((chunk.pixel, chunk.tick, chunk.pulse))
        assert np.array_equal(order, np.arange(len(chunk)))
        assert all(getattr(chunk, name).dtype == np.int64 for name in ("pulse", "pixel", "tick"))


def test_closed_spads_see_nothing_and_are_ready_when_they_open():
    rate_cps, pulses, timing = 2e7, 4000, Timing()
    gate = SpadGate(start_cycles=100, len_cycles=50)
    edges = edges_of(
        light(noise_cps=rate_cps), Spad(jitter_fwhm_s=0), timing, pulses=pulses, gate=gate
    )
    cycle = edges.tick // timing.phases
    assert cycle.min() == 100 and cycle.max() == 149
    _, first = np.unique(edges.pixel * pulses + edges.pulse, return_index=True)
    waited_s = time_s(edges, timing)[first] - 100 / timing.clock_hz
    reached = -np.expm1(-rate_cps * waited_s) / -math.expm1(-rate_cps * 50 / timing.clock_hz)
    assert stats.kstest(reached, "uniform").pvalue > LEVEL


def test_gates_of_a_configuration():
    """A gated subgroup steps through its period, in every frame anew; one without gating is always
    open.
    """
    config = configured(
        {"rows": 8, "cols": 16},
        {"gate_step": 20, "gate_every": 2, "gate_steps": 3, "pulses": 9, "frames": 2},
        {},
        {"subgroups": [1], "gating": True, "gate_start": 10, "gate_len": 20},
    )
    timing = Timing.from_config(config)
    assert (timing.period_ticks, timing.tick_s) == (8000, 62.5e-12)
    gate = SpadGate.from_config(config)
    edges = edges_of(
        light(8, 16, noise_cps=1e8), Spad(jitter_fwhm_s=0), timing, pulses=18, gate=gate
    )
    cycle, gated = edges.tick // timing.phases, edges.pixel % 16 >= 8
    start = 10 + 20 * (edges.pulse[gated] % 9 // 2 % 3)
    assert set(start) == {10, 30, 50} and set(cycle[gated] - start) == set(range(20))
    step = edges.pulse % 9 // 2 % 3
    for each in range(3):
        assert set(cycle[~gated & (step == each)]) == set(range(250))


@pytest.mark.parametrize("moves", [3, 1 << 17, 3 << 30])
def test_a_gate_without_frames_moves_on_for_ever(moves):
    """And one that is not told to move never does."""
    timing = Timing(period_cycles=50)
    options = {"pulses": 3, "pulse_start": moves * 7, "timing": timing}
    moving = SpadGate(start_cycles=5, len_cycles=4, step_cycles=1, every_pulses=7, steps=40)
    still = SpadGate(start_cycles=5, len_cycles=4, step_cycles=1)
    for gate, start in ((moving, 5 + moves % 40), (still, 5)):
        edges = edges_of(light(noise_cps=1e8), gate=gate, **options)
        assert set(edges.tick // timing.phases) == set(range(start, start + 4))


def test_a_gate_that_moves_beyond_the_period_is_closed_there():
    """A step of more than a period is legal, as in the sensor."""
    config = configured(
        {"rows": 8, "cols": 8},
        {"gate_step": 300, "gate_every": 1, "gate_steps": 2, "pulses": 6},
        {"gating": True, "gate_start": 10, "gate_len": 20},
    )
    edges = edges_of(
        light(noise_cps=1e8),
        timing=Timing.from_config(config),
        pulses=6,
        gate=SpadGate.from_config(config),
    )
    assert set(edges.pulse) == {0, 2, 4}
    assert set(edges.tick // 32) == set(range(10, 30))


def test_a_gate_that_is_longer_than_the_period_is_open_until_its_end():
    config = configured(
        {"rows": 8, "cols": 8}, {"pulses": 6}, {"gating": True, "gate_start": 10, "gate_len": 300}
    )
    edges = edges_of(
        light(noise_cps=1e8),
        timing=Timing.from_config(config),
        pulses=6,
        gate=SpadGate.from_config(config),
    )
    assert set(edges.tick // 32) == set(range(10, 250))


def test_light_from_beyond_the_period_falls_into_a_later_one():
    period_m = SPEED_OF_LIGHT_M_S * Timing().period_s / 2
    near, far = (
        edges_of(light(distance_m=d, signal=0.5), timing=Timing(), pulses=50)
        for d in (10.0, 10.0 + period_m)
    )
    assert same(near, far)
    assert (
        len(
            edges_of(
                light(distance_m=10.0 + period_m, signal=0.5, range_ambiguity=False), pulses=50
            )
        )
        == 0
    )


@pytest.mark.parametrize("lost", (False, True))
def test_light_in_bins_beyond_the_period_comes_later_or_is_lost(lost):
    timing = Timing()
    arrivals = Arrivals(
        first=[0, 1, 2],
        start_s=np.array([0.25, 1.25]) * timing.period_s,
        photons=[0.5, 0.5],
        width_s=timing.tick_s,
    )
    bins = Light(
        rows=1,
        cols=2,
        distance_m=np.nan,
        signal_per_pulse=0.0,
        arrivals=arrivals,
        range_ambiguity=not lost,
    )
    edges = edges_of(bins, timing=timing, pulses=200)
    number = np.bincount(edges.pixel, minlength=2)
    assert number[0] > 50 and (number[1] > 50) == (not lost) and (number[1] == 0) == lost
    assert np.all(np.abs(edges.tick / timing.period_ticks - 0.25) < 0.01)


@pytest.mark.parametrize("first", ([0, 0, 2, 3], [0, 2, 2, 3], [0, 2, 3, 3], [0, 0, 0, 3]))
def test_the_signal_of_a_pixel_is_that_of_its_bins_and_targets(first):
    """Also if it has no bins."""
    photons = np.array([0.5, 1.0, 2.0])
    bins = Light(
        rows=1,
        cols=3,
        distance_m=5.0,
        signal_per_pulse=0.25,
        arrivals=Arrivals(first=first, start_s=np.arange(3) * 1e-9, photons=photons),
    )
    expected = [0.25 + photons[a:b].sum() for a, b in pairwise(first)]
    assert bins.total_signal.tolist() == expected


@pytest.mark.parametrize(
    "first", ([0, 4], [0, 0, 4], [0, 1, 4], [0, 0, 2, 4], [0, 2, 2, 4], [0, 4, 4])
)
def test_bins_ascend_in_every_pixel_but_not_from_one_to_the_next(first):
    """Also beside pixels without bins."""
    for late in range(3):
        start_s = np.arange(4.0)
        start_s[[late, late + 1]] = start_s[[late + 1, late]]
        if late + 1 in first:
            Arrivals(first=first, start_s=start_s, photons=np.ones(4))
            continue
        with pytest.raises(InputError, match="start_s: must ascend in every pixel"):
            Arrivals(first=first, start_s=start_s, photons=np.ones(4))


def test_light_in_bins_beyond_the_period_meets_the_gap():
    """A gap of half a period: light from 1.25 periods after its pulse comes in the gap, and from
    1.75 a quarter of a period after the next pulse.
    """
    timing = Timing(gap_cycles=125)
    arrivals = Arrivals(
        first=[0, 1, 2],
        start_s=np.array([1.25, 1.75]) * timing.period_s,
        photons=[0.5, 0.5],
        width_s=timing.tick_s,
    )
    bins = Light(rows=1, cols=2, distance_m=np.nan, signal_per_pulse=0.0, arrivals=arrivals)
    edges = edges_of(bins, timing=timing, pulses=200)
    assert set(edges.pixel) == {1}
    assert len(edges) > 50
    assert np.all(np.abs(edges.tick / timing.period_ticks - 0.25) < 0.01)


def test_light_in_bins_is_as_wide_as_that_of_the_first_target():
    """The second target, which sends nothing, is ten times as wide."""
    arrivals = Arrivals(first=[0, 1], start_s=np.array([100e-9]), photons=[0.5])
    bins = Light(
        rows=1,
        cols=1,
        distance_m=[[10.0, 20.0]],
        signal_per_pulse=[[0.0, 0.0]],
        system_fwhm_s=[[500e-12, 5e-9]],
        arrivals=arrivals,
    )
    assert bins.total_signal.tolist() == [0.5]
    edges = edges_of(bins, pulses=2000)
    expected_s = 500e-12 * SIGMA_PER_FWHM
    assert np.std(time_s(edges)) == pytest.approx(expected_s, rel=0.1)


def test_targets_and_light_in_bins_add_up():
    """In the edges, and in the signal that a light tells of each pixel."""
    both = Light(
        rows=1,
        cols=3,
        distance_m=np.array([[10.0, 20.0]] * 3),
        signal_per_pulse=np.array([[0.1, 0.05], [0.2, 0.0], [0.0, 0.0]]),
        background_cps=0.0,
        arrivals=Arrivals(first=[0, 2, 2, 3], start_s=np.ones(3) * 90e-9, photons=[0.1, 0.2, 0.4]),
    )
    assert both.total_signal == pytest.approx([0.45, 0.2, 0.4])
    pulses = 4000
    fired = np.bincount(edges_of(both, pulses=pulses).pixel, minlength=3)
    for edges_of_pixel, mean in zip(fired, both.total_signal * pulses, strict=True):
        assert_mean(edges_of_pixel, mean, math.sqrt(mean))


def test_targets_of_a_pixel_share_its_edges():
    distance_m, signal, pulses = np.array([[10.0, 30.0, np.nan]]), np.array([[0.3, 0.1, 5.0]]), 1000
    edges = edges_of(light(distance_m=distance_m, signal=signal), pulses=pulses)
    flight_ticks = 2 * 20.0 / SPEED_OF_LIGHT_M_S / FINE.tick_s
    for edges_at_target, mean in zip(
        np.bincount(edges.tick > flight_ticks), (0.3, 0.1), strict=True
    ):
        assert_mean(edges_at_target, mean * 64 * pulses, math.sqrt(mean * 64 * pulses))


def test_the_timing_of_a_configuration_has_every_field():
    tap_width_lsb = np.array([0.5, 1.5, 1.25, 0.75])
    config = parse_config(
        {
            "sensor": {"rows": 4, "cols": 4, "subgroup": [4, 4], "phases": 4},
            "frame": {
                "clock_mhz": 200.0,
                "period": 50,
                "pulses": 7,
                "dither_bits": 3,
                "dither_seed": 5,
                "gap": 11,
            },
        }
    )
    timing = Timing.from_config(config, tap_width_lsb)
    assert timing.tap_width_lsb is tap_width_lsb
    shown = {name: getattr(timing, name) for name in fields_dict(Timing) if "tap" not in name}
    assert shown == dict(
        clock_hz=200e6,
        phases=4,
        period_cycles=50,
        dither_bits=3,
        dither_seed=5,
        frame_pulses=7,
        gap_cycles=11,
        search_pulses=0,
        search_minigroups=0,
    )


def test_code_density_finds_the_taps():
    width_lsb = 1 + 0.3 * np.sin(np.arange(32) * 1.7)
    width_lsb *= 32 / width_lsb.sum()
    edges = edges_of(light(noise_cps=2e6), timing=Timing(tap_width_lsb=width_lsb), pulses=4000)
    found = code_density(edges.tick, 32)
    width_to_edges = found.edges / 32
    assert (
        stats.chisquare((found.dnl_lsb + 1) * width_to_edges, width_lsb * width_to_edges).pvalue
        > LEVEL
    )
    assert np.all(np.abs(found.dnl_lsb + 1 - width_lsb) < 4.5 * found.sigma_lsb)
    border_sigma_lsb = 32 * 0.5 / math.sqrt(found.edges)  # of the middle border, the least certain
    assert np.all(np.abs(found.inl_lsb - np.cumsum(width_lsb - 1)) < 4.5 * border_sigma_lsb)


def test_code_density_by_hand():
    """One edge per phase is enough, for any number of phases."""
    found = code_density(np.array([0, 5, 9, 2, 6, 10, 7, 3], np.uint16), 4)
    assert found.dnl_lsb.tolist() == [-0.5, 0.0, 0.5, 0.0]
    assert found.inl_lsb.tolist() == [-0.5, -0.5, 0.0, 0.0]
    share = np.array([1, 2, 3, 2]) / 8
    assert found.sigma_lsb == pytest.approx(4 * np.sqrt(share * (1 - share) / 8))
    assert found.edges == 8
    for phases in (2, 1024):
        even = code_density(np.arange(phases), phases)
        assert not even.dnl_lsb.any() and even.edges == phases
        with pytest.raises(InputError, match=rf"must hold at least one per phase \({phases}\)"):
            code_density(np.arange(phases - 1), phases)
    for phases in (1, 1025):
        with pytest.raises(InputError, match=f"phases = {phases}: must be an integer from 2 to 10"):
            code_density(np.arange(2000), phases)


def test_a_chunk_may_have_as_many_pulses_as_a_number_of_an_edge_holds():
    """Fewer with a long period, whose edges need more bits."""
    far = {"pulse_start": (1 << 40) - 2, "pulses": 2, "seed": 1}
    for timing, most in ((LONG, 1 << 27), (Timing(), 1 << 31)):
        (chunk,) = edge_chunks(light(), BARE, timing, chunk_pulses=most, **far)
        assert len(chunk) == 0
        with pytest.raises(InputError, match=f"chunk_pulses = {most + 1}: .* to {most} "):
            edge_chunks(light(), BARE, timing, chunk_pulses=most + 1, **far)


@pytest.mark.parametrize(
    ("signal", "is_told"),
    [
        ([2.5, 2.5, 2.5, 0.1, 0, 0, 0, 0], True),
        ([2.0] * 8, False),
        ([1.0, 1.0, 1.0, 90.0, 0, 0, 0, 0], False),
        ([0.0] * 8, False),
    ],
)
def test_too_much_light_is_that_of_half_the_pixels_that_have_any(signal, is_told):
    notes = light(1, 8, signal=np.array(signal)).notes()
    assert len(notes) == is_told
    assert "more than 2.5 photons per pulse" in "".join(notes) or not is_told


def test_presets():
    assert background_cps(50) == pytest.approx(1.226e6)
    assert background_cps(5) == pytest.approx(1.226e5)
    assert background_cps(np.array([50, 5, 0])) == pytest.approx([1.226e6, 1.226e5, 0])
    of_all = background_cps(np.array([[50], [5]]), np.array([0.4, 0.2, 0.1]))
    assert of_all == pytest.approx(np.outer([1.226e6, 1.226e5], [1, 0.5, 0.25]))
    assert signal_per_pulse(4.0, 0.4) == pytest.approx(0.613)
    assert signal_per_pulse(8.0, 0.2) == pytest.approx(0.613 / 8)
    scene = Light.from_scene([[4.0, np.nan], [8.0, 8.0]], [[0.4, 0.4], [0.2, 0.4]], 50)
    assert scene.signal_per_pulse[:, 0] == pytest.approx([0.613, 0, 0.613 / 8, 0.613 / 4])
    assert scene.background_cps == pytest.approx(
        [1.226e6, 1.226e6, 1.226e6 / 2, 1.226e6]
    )  # equation (2); no target: as at 0.4
    even = Light.from_scene([[4.0, 8.0]], [[0.4, 0.1]], np.array([[50, 100]]), background="even")
    assert even.background_cps == pytest.approx([1.226e6, 2 * 1.226e6])
    mesh = Light.from_scene([[[4.0, 8.0], [4.0, np.nan]]], 0.3, 50)
    # the light that both targets reflect
    assert mesh.background_cps == pytest.approx([1.5 * 1.226e6, 0.75 * 1.226e6])


def test_dark_counts_and_hot_pixels():
    dark_cps = dark_count_map(100, median_cps=100.0, hot_fraction=0.03, hot_cps=1e6, seed=3)
    assert sorted(set(dark_cps)) == [100.0, 1e6] and (dark_cps == 1e6).sum() == 3
    for hot_fraction, hot in ((0.0, 0), (0.249, 2), (0.251, 3), (1.0, 10)):
        few = dark_count_map(10, median_cps=1.0, hot_fraction=hot_fraction, hot_cps=2.0, seed=1)
        assert (few == 2.0).sum() == hot  # the nearest number
    again, other = (
        dark_count_map(100, median_cps=100.0, hot_fraction=0.03, hot_cps=1e6, seed=seed)
        for seed in (3, 4)
    )
    assert np.array_equal(again, dark_cps)
    assert not np.array_equal(other, dark_cps)
    edges = edges_of(light(10, 10), Spad(dead_time_s=0, dark_cps=dark_cps), pulses=20_000)
    n = np.bincount(edges.pixel, minlength=100)
    assert set(np.argsort(n)[-3:]) == set(np.flatnonzero(dark_cps == 1e6))
    assert_mean(n[dark_cps == 1e6].sum(), 3e4, math.sqrt(3e4))


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Spad(dead_time_s=-1e-9), r"dead_time_s = -1e-09: must be a number of at least 0"),
        (
            lambda: Spad(crosstalk_probability=0.5),
            r"crosstalk_probability = 0.5: must be a number from 0 to 0.25",
        ),
        (
            lambda: Timing(tap_width_lsb=np.full(32, 1.1)),
            r"tap_width_lsb: sums to 35.2, must sum to the 32 phases",
        ),
        (
            lambda: Timing(tap_width_lsb=np.r_[np.ones(31), 0.5]),
            r"tap_width_lsb: sums to 31.5, must sum to the 32 phases",
        ),
        (
            lambda: Timing(tap_width_lsb=np.r_[np.ones(31), 1.001]),
            r"tap_width_lsb: sums to 32.001, must sum to the 32 phases",
        ),
        (lambda: Timing(period_cycles=0), r"period_cycles = 0: must be an integer from 1"),
        (lambda: light(signal=-1.0), r"signal_per_pulse\[0, 0\] = -1.0: must be from 0 to 10000"),
        (lambda: light(noise_cps=np.nan), r"background_cps\[0\] = nan: must be from 0 to 1e\+12"),
        (
            lambda: light(distance_m=np.ones(3)),
            r"distance_m: has shape \(3, 1\), must be \(64, 1\) or broadcast to it",
        ),
        (
            lambda: Light.from_scene(np.zeros((2, 2)), 0.4, 50),
            r"distance_m\[0, 0\] = 0.0: must be at least 0.05",
        ),
        (
            lambda: Light.from_scene(np.ones((2, 2)), 4, 50),
            r"reflectivity\[0, 0\] = 4.0: must be from 0 to 1",
        ),
        (lambda: background_cps(-1), r"klux = -1.0: must be at least 0"),
        (
            lambda: Light.from_scene(np.ones((2, 2)), 0.4, 50, background="dark"),
            r"background = 'dark': must be one of reflected, even",
        ),
        (
            lambda: edge_chunks(light(), BARE, FINE, pulses=0, seed=1),
            r"pulses = 0: must be an integer from 1",
        ),
        (
            lambda: edge_chunks(light(), BARE, FINE, pulses=1, seed=-1),
            r"seed = -1: must be an integer from 0",
        ),
        (
            lambda: edges_of(light(system_fwhm_s=1e-11), Spad(), pulses=1),
            r"system_fwhm_s = 1e-11: must be at least",
        ),
        *(
            (
                lambda width_s=width_s: edges_of(
                    light(1, 2, system_fwhm_s=width_s), Spad(), pulses=1
                ),
                r"system_fwhm_s = 1e-11: must be at least the SPAD's 1e-10",
            )
            for width_s in (1e-11, np.array([5e-10, 1e-11]))
        ),
        *(
            (
                lambda pixels=pixels: light(
                    1, 2, arrivals=Arrivals(first=[0] * (pixels + 1), start_s=[], photons=[])
                ),
                f"arrivals: has {pixels} pixels, must have 2",
            )
            for pixels in (1, 3)
        ),
        (
            lambda: edges_of(light(), Spad(dark_cps=1.1e12), pulses=1),
            r"dark_cps\[0\] = 1100000000000.0: must be from 0 to 1e\+12",
        ),
        (
            lambda: Spad(jitter_fwhm_s=1e300),
            r"jitter_fwhm_s = 1e\+300: must be a number from 0 to 1",
        ),
        (lambda: Spad(paralyzable="false"), r"paralyzable = 'false': must be true or false"),
        (lambda: light(range_ambiguity="no"), r"range_ambiguity = 'no': must be true or false"),
        (
            lambda: SpadGate(start_cycles=0, len_cycles=1, steps=0),
            r"steps = 0: must be an integer from 1",
        ),
        (lambda: code_density(np.arange(3), 8), r"tick: holds 3 edges"),
        *(
            (
                lambda waits=waits: edge_chunks(
                    light(), BARE, Timing(**waits), pulses=1, pulse_start=1 << 24, seed=1
                ),
                r"pulses = 16777217: must be an integer from 0 to 16777216 \(with a gap, dither or",
            )
            for waits in ({"gap_cycles": 1}, {"dither_bits": 1}, {"search_pulses": 1})
        ),
    ],
)
def test_bad_input_names_field_and_range(make, message):
    with pytest.raises(InputError, match=message):
        make()
