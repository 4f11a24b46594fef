# SPDX-License-Identifier: Apache-2.0
"""Equations (3) to (18): literal forms against hand-computed points, corrected ones against photons
through the sensor.
"""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from coincid.model.contract.edges import Fate
from coincid.model.contract.parameters import Sensor
from coincid.model.golden.frame import Golden
from coincid.model.light import analytic
from coincid.model.light.analytic import (
    THRESHOLDS,
    VALID_DEAD_FRACTION,
    MeanPhotons,
    Sizes,
    histogram,
)
from coincid.model.light.light import Light
from coincid.model.light.photons import generate_edges
from coincid.model.light.spad import Spad
from coincid.model.light.timing import Timing
from coincid.model.shared.constants import SIGMA_PER_FWHM, SPEED_OF_LIGHT_M_S
from coincid.model.shared.errors import InputError

from ..random_cases import configured

LITERAL, CORRECTED = analytic.FORMS
DISTANCE_M = 20.0
DEAD_S = Spad().dead_time_s


def photons(per_pixel):
    return MeanPhotons(per_pixel, 4 * per_pixel, 64 * per_pixel)


def test_effective_rates():
    noise, signal = analytic.effective_cps(6.37e9, 1.226e6, DEAD_S, 2e6, LITERAL)
    assert noise == pytest.approx(1.2259e8, rel=1e-4) and signal == pytest.approx(
        1.2141e6, rel=1e-4
    )
    noise, signal = analytic.effective_cps(6.37e9, 1.226e6, DEAD_S, 2e6, CORRECTED)
    # Reduced by the noise's dead time, and the noise by the signal's.
    live = 1 / (1 + 6.37e9 * DEAD_S)
    assert signal == pytest.approx(2e6 * (1 - math.exp(-0.613)) * live)
    assert noise == pytest.approx(6.37e9 * live * (1 - signal * DEAD_S), rel=1e-9)


@pytest.mark.parametrize("form", [LITERAL, CORRECTED])
@pytest.mark.parametrize(
    "formula, numbers, others",
    [
        (analytic.effective_cps, ([1e7, 1e8, 6e9], [1e5, 1e6, 2e6]), (DEAD_S, 2e6)),
        (analytic.noise_photons, ([1e8] * 3, [0.2e-9, 1e-9, 2e-9], [2, 2, 3]), (DEAD_S, 64)),
        (analytic.pixel_probability, ([0.01, 0.5, 2.0],), ()),
        (analytic.windows_per_period, ([1e6, 1e8, 1e9],), (5e-7, 3e-9)),
        (analytic.noise_per_bin, ([1.0, 10.0, 1e3],), (2e6, 2e-10, 6e-11)),
        (
            analytic.signal_per_bin,
            ([1.0, 9.0, 1e3], [0.0, 1e-9, 1e-9], [0.0, 1e-9, 2e-9]),
            (2e-10, 6e-11),
        ),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_arrays_give_what_their_numbers_give(formula, numbers, others, form):
    together = formula(*map(np.array, numbers), *others, form)
    alone = [formula(*each, *others, form) for each in zip(*numbers, strict=True)]
    np.testing.assert_allclose(np.transpose(together), alone, rtol=1e-12)


def test_photons_in_window_and_period():
    assert analytic.noise_photons(1e8, 1e-9, 2, DEAD_S, 64, LITERAL) == pytest.approx(0.075)
    assert analytic.noise_photons(1e8, 0.2e-9, 2, DEAD_S, 64, LITERAL) == 0  # as printed: negative
    assert analytic.noise_photons(1e8, 1e-9, 2, DEAD_S, 64, CORRECTED) == pytest.approx(
        -math.log(0.9)
    )
    assert analytic.signal_photons(1.2e6, 2e6, 4, DEAD_S, 64, LITERAL) == pytest.approx(0.5994)
    signal = analytic.signal_photons(1.2e6, 2e6, 4, DEAD_S, 64, CORRECTED)
    assert analytic.pixel_probability(signal, CORRECTED) == pytest.approx(0.6)


@pytest.mark.parametrize(
    "per_pixel, threshold, union, tail",
    [
        (0.002, 2, 0.1135, 0.1184),
        (0.002, 5, 7.7e-6, 8.6e-6),
        (0.01, 3, 0.0995, 0.1302),
        (0.05, 2, 0.289, 0.957),
        (0.05, 5, 0.168, 0.369),
        (0.2, 2, 0.360, 1.00),
        (0.2, 5, 0.013, 0.998),
    ],
)
def test_others_bring_the_threshold(per_pixel, threshold, union, tail):
    for form, expected in ((LITERAL, union), (CORRECTED, tail)):
        found = analytic.others_probability(photons(per_pixel), threshold, Sizes(), form)
        assert found == pytest.approx(expected, rel=6e-3)


def test_group_probabilities():
    assert analytic.pixel_probability(0.5, LITERAL) == pytest.approx(0.5 * math.exp(-0.5))
    assert analytic.minigroup_probability(0.4, 3, 4, LITERAL) == pytest.approx(
        0.08 * math.exp(-0.4)
    )
    # four others detect in a minigroup with three
    assert analytic.minigroup_probability(0.4, 5, 4, LITERAL) > 0
    assert analytic.minigroup_probability(0.4, 5, 4, CORRECTED) == 0
    assert analytic.rest_probability(6.0, 2, 60, LITERAL) == pytest.approx(6 * math.exp(-6))
    assert analytic.rest_probability(6.0, 2, 60, CORRECTED) == pytest.approx(
        stats.binom.pmf(1, 60, 1 - math.exp(-0.1))
    )


def test_events_of_a_frame_as_printed():
    noise, signal = photons(0.001), photons(0.05)
    of_noise = analytic.coincidence_probability(noise, 2, Sizes(), LITERAL)
    of_signal = analytic.coincidence_probability(signal, 2, Sizes(), LITERAL)
    assert of_noise == pytest.approx(0.001 * math.exp(-0.001) * 0.060265, rel=1e-4)
    joint = (1 - 0.001 * math.exp(-0.001)) * (1 - of_noise) * of_signal
    assert analytic.signal_probability(noise, signal, 2, Sizes(), LITERAL) == pytest.approx(joint)
    assert analytic.noise_counts(noise, 2, 100, 1, Sizes(), LITERAL) == pytest.approx(
        100 * of_noise
    )
    assert analytic.signal_counts(noise, signal, 2, 100, 0.5, Sizes(), LITERAL) == pytest.approx(
        100 * joint
    )


def test_noise_of_other_pixels_brings_the_threshold_of_the_signal():
    """In the corrected form, and in as many pulses as the tree is armed in."""
    noise, signal = photons(0.02), photons(0.05)
    others = analytic.others_probability(photons(0.07), 3, Sizes(), CORRECTED)
    joint = -math.expm1(-0.05) * others
    found = analytic.signal_probability(noise, signal, 3, Sizes(), CORRECTED)
    assert found == pytest.approx(joint)
    counts = analytic.signal_counts(noise, signal, 3, 100, 0.5, Sizes(), CORRECTED)
    assert counts == pytest.approx(100 * 0.5 * joint)


def test_bins_of_the_histogram():
    sigma_s, lsb_s, flight_s = 212e-12, 50e-12, 30e-9
    time_s = np.arange(0, 60e-9, lsb_s)
    per_bin = [
        analytic.signal_per_bin(1.0, time_s, flight_s, sigma_s, lsb_s, form)
        for form in (LITERAL, CORRECTED)
    ]
    # the root spans the sigma, with time in ps
    assert per_bin[0].sum() == pytest.approx(14.6, rel=5e-3)
    assert per_bin[1].sum() == pytest.approx(1.0)
    noise = [
        analytic.noise_per_bin(10.0, 2e6, sigma_s, lsb_s, form) for form in (LITERAL, CORRECTED)
    ]
    assert noise == [pytest.approx(4.24e-3), pytest.approx(1e-3)]


@given(st.floats(1e-6, 3), st.integers(1, 63))
def test_laws_of_the_corrected_threshold(per_pixel, threshold):
    now, more = (
        analytic.others_probability(photons(per_pixel), th, Sizes(), CORRECTED)
        for th in (threshold, threshold + 1)
    )
    assert 0 <= more <= now <= 1
    assert analytic.others_probability(photons(per_pixel), 1, Sizes(), CORRECTED) == 1


@pytest.mark.parametrize(
    "window_ticks, rearm, ticks", [(1, 0, 16.5), (16, 0, 31.5), (32, 0, 47.5), (16, 3, 127.5)]
)
def test_busy_time(window_ticks, rearm, ticks):
    assert analytic.busy_s(window_ticks, rearm, Timing()) / Timing().tick_s == pytest.approx(ticks)


def simulated(signal, noise_cps, threshold, window_ticks, rearm, scheme, pulses):
    """Return counts of a pixel's histogram at each tick, the mean over an evenly lit array, by the
    golden model.
    """
    config = configured(
        {"rearm": rearm},
        {"pulses": pulses},
        {"threshold": threshold, "window": window_ticks, "coincidence": scheme == 2},
    )
    light = Light(
        rows=32, cols=32, distance_m=DISTANCE_M, signal_per_pulse=signal, background_cps=noise_cps
    )
    edges = generate_edges(light, Spad(), Timing(), pulses=pulses, seed=1)
    fate = Golden(config.sensor).frame(config, edges).fate
    subgroup = edges.pixel // 32 // 8 * 4 + edges.pixel % 32 // 8
    taken = np.flatnonzero(fate <= Fate.COUNTED)
    taken = taken[np.lexsort((fate[taken], edges.tick[taken], edges.pulse[taken], subgroup[taken]))]
    opening = fate[taken] == Fate.OPENING
    stamp, count = edges.tick[taken][opening], np.bincount(np.cumsum(opening) - 1)
    event = count >= (threshold if scheme == 2 else 1)
    return (
        np.bincount(stamp[event], count[event], Timing().period_ticks) / config.sensor.array_pixels
    )


VALID = [  # signal per pulse, noise, threshold, window, re-arm gap, scheme
    (0.05, 1.226e6, 1, 16, 0, 2),
    (0.05, 1.226e6, 2, 16, 0, 2),
    (0.2, 1.226e6, 5, 16, 2, 2),
    (3.0, 1.226e6, 7, 16, 0, 2),
    (0.02, VALID_DEAD_FRACTION / DEAD_S, 3, 32, 0, 2),
    (0.1, VALID_DEAD_FRACTION / DEAD_S, 4, 64, 2, 2),
    (0.05, 1.226e6, 1, 1, 0, 1),
    (0.613, 1.226e5, 1, 1, 0, 1),
]


@pytest.mark.parametrize("case", VALID)
def test_corrected_histogram_is_that_of_photons_through_the_sensor(case):
    """Peak and floor within 3 % and four standard errors, and the lead of first photons within a
    fifth of a tick.
    """
    signal, noise_cps, threshold, window_ticks, rearm, scheme = case
    pulses, model_error = 1500, 0.03
    found = simulated(*case, pulses)
    setting = dict(threshold=threshold, window_ticks=window_ticks, pulses=pulses, scheme=scheme)
    expected = histogram(
        DISTANCE_M, signal, noise_cps, form=CORRECTED, sensor=Sensor(rearm=rearm), **setting
    )[0]
    flight = int(2 * DISTANCE_M / SPEED_OF_LIGHT_M_S / Timing().tick_s)
    peak = slice(flight - 20, flight + 12)
    quiet = np.r_[200 : flight - 100, flight + 400 : 7800]
    for part in (peak, quiet):
        # Each event contributes counts of several pixels.
        error = 4 * math.sqrt(expected[part].sum() * (threshold + 1) / 1024)
        assert found[part].sum() == pytest.approx(expected[part].sum(), rel=model_error, abs=error)
    ticks = np.arange(peak.start, peak.stop)
    spread = 20 / math.sqrt(found[peak].sum() * 16)
    lead = np.average(ticks, weights=found[peak]) - np.average(ticks, weights=expected[peak])
    assert abs(lead) <= 0.2 + spread


def test_closed_forms_agree_with_the_histogram_where_few_windows_open():
    noise_cps, threshold, window_ticks, pulses, timing, n = 1e5, 2, 16, 1000, Timing(), Sizes()
    effective, _ = analytic.effective_cps(noise_cps, 0, DEAD_S, 2e6, CORRECTED)
    # the opening photon is anywhere in the window's first tick
    window_s = (window_ticks - 0.5) * timing.tick_s
    noise = photons(analytic.noise_photons(effective, window_s, threshold, DEAD_S, 64, CORRECTED))
    open_s = (timing.period_cycles - Sensor().guard) / timing.clock_hz
    windows = analytic.windows_per_period(
        64 * effective, open_s, analytic.busy_s(window_ticks, 0, timing), CORRECTED
    )
    counts = analytic.noise_counts(noise, threshold, pulses, windows, n, CORRECTED)
    setting = dict(threshold=threshold, window_ticks=window_ticks, pulses=pulses, form=CORRECTED)
    assert histogram(DISTANCE_M, 0.0, noise_cps, **setting)[0].sum() == pytest.approx(
        counts, rel=5e-3
    )
    signal, none = photons(0.05), photons(0.0)
    counts = analytic.signal_counts(none, signal, threshold, pulses, 1.0, n, CORRECTED)
    # A window as long as the pulse contains all of it.
    setting |= dict(window_ticks=64)
    assert histogram(DISTANCE_M, 0.05, 0.0, **setting)[0].sum() == pytest.approx(counts, rel=5e-3)


def test_literal_histogram_is_the_printed_chain():
    setting = dict(threshold=2, window_ticks=16, pulses=100, form=LITERAL)
    found = histogram(DISTANCE_M, 0.05, 1.226e6, **setting)
    noise, signal = analytic.effective_cps(1.226e6, 1e5, DEAD_S, 2e6, LITERAL)
    dead = (2, DEAD_S, 64, LITERAL)
    noise = photons(analytic.noise_photons(noise, 1e-9, *dead))
    signal = photons(analytic.signal_photons(signal, 2e6, *dead))
    floor = (
        analytic.noise_counts(noise, 2, 100, 1, Sizes(), LITERAL) * 2e6 * 500e-12 * SIGMA_PER_FWHM
    )
    assert found[:, 0] == pytest.approx(float(floor))
    of_signal = analytic.signal_counts(noise, signal, 2, 100, 1, Sizes(), LITERAL)
    assert (found - floor).sum(axis=1) == pytest.approx(
        of_signal * math.sqrt(500 * SIGMA_PER_FWHM), rel=1e-4
    )
    single = histogram(DISTANCE_M, 0.05, 1.226e6, **setting, scheme=1)
    assert single.shape == found.shape and not np.allclose(single, found)


def test_literal_histogram_of_single_photons_is_that_of_each_pixel_alone():
    """Of scheme 1: (9) for the noise of a period, and for signal where there is no noise."""
    signal = np.random.default_rng(2).uniform(0.02, 0.9, 64)
    setting = dict(threshold=5, window_ticks=16, pulses=100, form=LITERAL, scheme=1)
    found = histogram(DISTANCE_M, signal, 1.226e6, **setting)
    of_noise, of_signal = analytic.effective_cps(1.226e6, signal * 2e6, DEAD_S, 2e6, LITERAL)
    in_period_s = 500e-9 - DEAD_S / 64
    noise, light = of_noise * in_period_s, of_signal * in_period_s
    floor = 100 * noise * np.exp(-noise)
    peak = 100 * (1 - noise * np.exp(-noise)) * light * np.exp(-light)
    assert found[:, 0] == pytest.approx(np.full(64, floor * 2e6 * 500e-12 * SIGMA_PER_FWHM))
    of_peak = (found - found[:, :1]).sum(axis=1)
    assert of_peak == pytest.approx(peak * math.sqrt(500 * SIGMA_PER_FWHM), rel=1e-4)


def test_literal_histogram_has_the_photons_of_each_pixels_own_minigroup():
    """In a sensor whose minigroups are no squares, and whose pixels do not follow each other."""
    sensor = Sensor(subgroup=(4, 8), minigroup=(2, 4))
    signal = np.random.default_rng(1).uniform(0.02, 0.2, 32)
    setting = dict(threshold=2, window_ticks=16, pulses=100, form=LITERAL, sensor=sensor)
    found = histogram(DISTANCE_M, signal, 1e6, **setting)
    of_noise, of_signal = analytic.effective_cps(1e6, signal * 2e6, DEAD_S, 2e6, LITERAL)
    dead = (2, DEAD_S, 32, LITERAL)
    of_noise = float(analytic.noise_photons(of_noise, 1e-9, *dead))
    of_signal = analytic.signal_photons(of_signal, 2e6, *dead)
    noise = MeanPhotons(of_noise, 8 * of_noise, 32 * of_noise)
    for minigroup in range(sensor.minigroups):
        own = sensor.members(minigroup)
        for pixel in own:
            mean = MeanPhotons(of_signal[pixel], of_signal[own].sum(), of_signal.sum())
            counts = analytic.signal_counts(noise, mean, 2, 100, 1, Sizes(8, 32), LITERAL)
            peak = (found[pixel] - found[pixel, 0]).sum()
            assert peak == pytest.approx(counts * math.sqrt(500 * SIGMA_PER_FWHM), rel=1e-4)


def test_pixels_of_a_subgroup_keep_their_own_targets():
    """Half of the subgroup sees a near target; one pixel sees no target."""
    distance_m = np.where(np.arange(64) % 8 < 4, 10.0, 20.0)
    distance_m[0] = np.nan
    found = histogram(
        distance_m, 0.2, 0.0, threshold=3, window_ticks=16, pulses=100, form=CORRECTED
    )
    peak_m = (np.argmax(found, axis=1) + 0.5) * Timing().tick_m
    assert peak_m[1:] == pytest.approx(distance_m[1:], abs=0.1)
    assert found[0].sum() == 0


@pytest.mark.parametrize("form", analytic.FORMS)
@pytest.mark.parametrize("scheme", analytic.SCHEMES)
def test_a_target_beyond_the_period_is_seen_as_many_periods_nearer(form, scheme):
    timing = Timing(period_cycles=40)
    setting = {"threshold": 2, "window_ticks": 16, "pulses": 100, "scheme": scheme}
    near, *farther = (
        histogram(5.0 + k * timing.range_m, 0.3, 1e6, form=form, timing=timing, **setting)
        for k in range(3)
    )
    assert np.argmax(near[0]) > 0
    for found in farther:
        assert found == pytest.approx(near, rel=1e-6)


def test_success_beyond_the_period_is_that_of_as_many_periods_nearer():
    timing = Timing(period_cycles=40)
    setting = dict(timing=timing, window_ticks=16, pulses=100, form=CORRECTED)
    near, far = (
        analytic.success_by_threshold(0.1, 1e6, 5.0 + k * timing.range_m, **setting) for k in (0, 2)
    )
    assert far == pytest.approx(near, rel=1e-6) and near.max() > 0.9
    with pytest.raises(InputError, match="distance_m = nan: must be a number of at least 0"):
        analytic.success_by_threshold(0.1, 1e6, math.nan, **setting)


@pytest.mark.parametrize("clock_hz", [250e6, 125e6, 50e6, 10e6])
def test_success_is_known_however_long_a_tick_is(clock_hz):
    """Ticks of 2 to 50 ns: a bright target is found, also at the border of two ticks, where either
    may have the largest bin.
    """
    timing = Timing(clock_hz=clock_hz, phases=2, period_cycles=40)
    setting = dict(timing=timing, window_ticks=2, pulses=100, form=CORRECTED)
    for place, least in ((3.0, 0.4), (3.25, 0.7), (3.5, 0.9), (3.75, 0.7), (39.99, 0.0)):
        distance_m = place * timing.tick_m
        found = analytic.success_by_threshold(1.0, 1e5, distance_m, **setting)
        assert least <= found.min() and found.max() <= 1


def test_success_probability_counts_largest_bins():
    rng, timing = np.random.default_rng(1), Timing(period_cycles=10)
    ticks, flight_s = np.arange(timing.period_ticks), 8e-9
    target = (np.abs((ticks + 0.5) * timing.tick_s - flight_s) < 100e-12) * 1.5
    expected = 0.2 + target
    drawn = rng.poisson(expected, (20_000, len(expected)))
    inside = (
        np.abs((ticks + 0.5) * timing.tick_s - (ticks[np.argmax(target)] + 0.5) * timing.tick_s)
        <= 230e-12
    )
    best_in, best_out = drawn[:, inside].max(axis=1), drawn[:, ~inside].max(axis=1)
    share = np.mean(best_in > best_out) + np.mean((best_in == best_out) & (best_in > 0)) / 2
    error = 4 * 0.5 / math.sqrt(20_000)
    assert analytic.success_probability(expected, flight_s, timing) == pytest.approx(
        share, abs=error
    )


def test_threshold_rises_with_the_activity():
    """Fig. 7: at 50 klux, the highest threshold that still succeeds rises from the lowest to the
    highest value.
    """
    setting, found = dict(window_ticks=16, pulses=100, form=CORRECTED), []
    for signal in (0.01, 0.02, 0.05, 0.1, 0.2):
        success = analytic.success_by_threshold(signal, 1.226e6, DISTANCE_M, **setting)
        found.append(analytic.expected_threshold(success))
    assert found == sorted(found)
    assert found[0] == min(THRESHOLDS) and found[-1] == max(THRESHOLDS)


@pytest.mark.parametrize(
    "change, message",
    [
        (dict(form="printed"), r"form = 'printed': must be one of literal, corrected"),
        (dict(scheme=3), r"scheme = 3: must be one of 1, 2"),
        (dict(threshold=0), r"threshold = 0: must be an integer from 1 to 64"),
        (dict(window_ticks=200), r"window_ticks = 200: must be an integer from 1 to 128"),
        (dict(noise_cps=-1.0), r"noise_cps\[0\] = -1.0: must be at least 0"),
        (dict(pulses=0), r"pulses = 0: must be an integer from 1 to"),
        (dict(pulses="many"), r"pulses = 'many': must be an integer from 1 to"),
        (dict(system_fwhm_s=0.0), r"system_fwhm_s = 0.0: must be a number from 1e-15 to 1$"),
        (dict(system_fwhm_s=-1e-9), r"system_fwhm_s = -1e-09: must be a number from 1e-15 to 1$"),
    ],
)
def test_bad_input_names_field_and_range(change, message):
    setting = dict(
        distance_m=4.0,
        signal_per_pulse=0.1,
        noise_cps=1e6,
        threshold=2,
        window_ticks=16,
        pulses=100,
        form=CORRECTED,
    )
    with pytest.raises(InputError, match=message):
        histogram(**(setting | change))


def test_thresholds_are_the_ends_of_those_that_are_nearly_the_best():
    """With the usual slack of a hundredth, or another one; its end belongs to it."""
    success = np.array([0.98, 0.991, 1.0, 0.9901, 0.989, 0.5, 0.1])
    assert analytic.lowest_threshold(success) == 2
    assert analytic.expected_threshold(success) == 4
    success = np.array([0.5, 0.875, 1.0, 0.25, 0.875, 0.874, 0.0])
    assert analytic.lowest_threshold(success, 0.125) == 2
    assert analytic.expected_threshold(success, 0.125) == 5
    assert analytic.lowest_threshold(success, 0) == analytic.expected_threshold(success, 0) == 3
