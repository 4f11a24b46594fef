# SPDX-License-Identifier: Apache-2.0
"""Analytic model of detection in a subgroup: equations (3) to (18) of paper III-B.

Each equation has two forms, which take the same arguments. "literal" is the equation as printed.
"corrected" is our own derivation for the behaviour of the sensor. Each docstring says where the two
differ. Numbers and arrays broadcast. In the corrected form, "photons" are equivalent Poisson
means: a pixel that detects at most once, with probability p, has -log(1 - p) photons.

`histogram` combines them: it is the expected histogram of every pixel of a subgroup around the
time of flight, for scheme 1 (no coincidence) and scheme 2. Its corrected form holds for any
activity of a subgroup under two conditions:

* The window is shorter than the dead time (then it is exact that a pixel counts once per
  window), and the dead time is shorter than the period.
* noise_cps * dead_time_s stays below `VALID_DEAD_FRACTION`, because pixels that have just fired
  are assumed to be ready at the next window.
"""

from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import special, stats

from ..contract.coincidence import AT_LEAST, event_share, rises
from ..contract.latency import armed_cycle, close_cycle
from ..contract.parameters import Sensor
from ..contract.pixels import pixel_table
from ..shared.arguments import given_or_new
from ..shared.compiled import njit
from ..shared.constants import SIGMA_PER_FWHM, SPEED_OF_LIGHT_M_S, SUCCESS_TOLERANCE_S
from ..shared.errors import InputError, check_integer
from ..shared.quantities import Numbers, check_choice, check_real, real_array
from .link_budget import FORMS
from .spad import Spad
from .timing import Timing

VALID_DEAD_FRACTION = 0.05
PULSES_MAX = 1 << 24  # of a histogram whose bins are compared count by count
SCHEMES = (1, 2)  # 1: winner takes all, no coincidence; 2: coincidence
THRESHOLDS = range(1, 8)  # as in the paper's Fig. 7
# Of (18) as printed: with ps, the bins sum to 14.6 times the signal (sigma 212 ps), with s to
# 1.5e-5.
PRINTED_TIME_UNIT_S = 1e-12
FWHM_MIN_S = 1e-15  # of a pulse, whose bins would otherwise be no numbers

_close_cycle, _armed_cycle = njit(close_cycle), njit(armed_cycle)


class MeanPhotons(NamedTuple):
    """Mean number of photons in the interval of interest per pixel, in the pixel's minigroup and
    in its subgroup (floats or arrays).
    """

    pixel: Numbers
    minigroup: Numbers
    subgroup: Numbers


class Sizes(NamedTuple):
    """Number of pixels in a minigroup and in a subgroup."""

    minigroup: int = 4
    subgroup: int = 64


def effective_cps(
    noise_cps: Numbers, signal_cps: Numbers, dead_time_s: float, laser_hz: float, form: str
) -> tuple[Numbers, Numbers]:
    """(noise, signal) of a pixel after a non-paralyzable dead time, in counts per second. Text
    before (3).

    Literal: each by itself, n / (1 + n t_d). Corrected: noise and signal share one SPAD. It is
    alive at the pulse with probability 1 / (1 + n_b t_d) and then fires once, with probability 1
    - exp(-signal per pulse). The dead time after that is lost to the noise.
    """
    noise_cps, signal_cps = np.asarray(noise_cps, float), np.asarray(signal_cps, float)
    live = 1 / (1 + noise_cps * dead_time_s)
    if _literal(form):
        return noise_cps * live, signal_cps / (1 + signal_cps * dead_time_s)
    signal = laser_hz * live * -np.expm1(-signal_cps / laser_hz)
    return noise_cps * live * (1 - signal * dead_time_s), signal


def noise_photons(
    effective_noise_cps: Numbers,
    window_s: Numbers,
    threshold: Numbers,
    dead_time_s: float,
    pixels: int,
    form: str,
) -> Numbers:
    """(3): noise photons of a pixel in the coincidence window of `window_s`.

    Literal: the dead time of `threshold` pixels, spread over all pixels, shortens the window, but
    not below 0. Corrected: the dead time of one pixel does not shorten the window of another.
    """
    if _literal(form):
        return effective_noise_cps * np.maximum(window_s - threshold * dead_time_s / pixels, 0)
    return _equivalent_mean(effective_noise_cps * window_s)


def signal_photons(
    effective_signal_cps: Numbers,
    laser_hz: float,
    threshold: Numbers,
    dead_time_s: float,
    pixels: int,
    form: str,
) -> Numbers:
    """(4): signal photons of a pixel in a laser period. Literal: with dead time as in (3).
    Corrected: without.
    """
    if _literal(form):
        return effective_signal_cps * np.maximum(1 / laser_hz - threshold * dead_time_s / pixels, 0)
    return _equivalent_mean(effective_signal_cps / laser_hz)


def pixel_probability(photons_pixel: Numbers, form: str) -> Numbers:
    """(9): probability that a pixel detects. Literal: exactly one photon. Corrected: at least
    one.
    """
    photons_pixel = np.asarray(photons_pixel, float)
    return photons_pixel * np.exp(-photons_pixel) if _literal(form) else -np.expm1(-photons_pixel)


def minigroup_probability(
    photons_minigroup: Numbers, threshold: Numbers, pixels_minigroup: int, form: str
) -> Numbers:
    """(10): probability of threshold - 1 photons in a pixel's minigroup.

    Literal: from all its pixels, Poisson. Corrected: from the other pixels, which must be
    distinct, binomial.
    """
    if _literal(form):
        return stats.poisson.pmf(threshold - 1, photons_minigroup)
    return stats.binom.pmf(
        threshold - 1, pixels_minigroup - 1, _share(photons_minigroup, pixels_minigroup)
    )


def rest_probability(
    photons_rest: Numbers, threshold: Numbers, pixels_rest: int, form: str
) -> Numbers:
    """(12): probability of threshold - 1 photons outside the minigroup. Literal: Poisson.
    Corrected: binomial.
    """
    if _literal(form):
        return stats.poisson.pmf(threshold - 1, photons_rest)
    return stats.binom.pmf(threshold - 1, pixels_rest, _share(photons_rest, pixels_rest))


def others_probability(
    photons: MeanPhotons, threshold: Numbers, sizes: Sizes, form: str
) -> Numbers:
    """(13): probability that the other pixels of the subgroup contribute the missing threshold -
    1 detections.

    Literal: union of (10) and (12), assumed independent. Corrected: at least threshold - 1 of
    the others, in any split.
    """
    if _literal(form):
        rest = photons.subgroup - photons.minigroup  # (11)
        inside = minigroup_probability(photons.minigroup, threshold, sizes.minigroup, form)
        outside = rest_probability(rest, threshold, sizes.subgroup - sizes.minigroup, form)
        return inside + outside - inside * outside
    return stats.binom.sf(
        threshold - 2, sizes.subgroup - 1, _share(photons.subgroup, sizes.subgroup)
    )


def coincidence_probability(
    photons: MeanPhotons, threshold: Numbers, sizes: Sizes, form: str
) -> Numbers:
    """(8), (14): probability that a pixel detects and the threshold is met, of noise or of
    signal alone.
    """
    return pixel_probability(photons.pixel, form) * others_probability(
        photons, threshold, sizes, form
    )


def signal_probability(
    noise: MeanPhotons, signal: MeanPhotons, threshold: Numbers, sizes: Sizes, form: str
) -> Numbers:
    """(15): probability that a pixel detects a signal photon in an event, in the presence of noise.

    Literal: no noise in the pixel, no noise event, a signal event. Corrected: the other pixels
    count whether they detect signal or noise.
    """
    if _literal(form):
        quiet = (1 - pixel_probability(noise.pixel, form)) * (
            1 - coincidence_probability(noise, threshold, sizes, form)
        )
        return quiet * coincidence_probability(signal, threshold, sizes, form)
    both = MeanPhotons(*(n + s for n, s in zip(noise, signal, strict=True)))
    return pixel_probability(signal.pixel, form) * others_probability(both, threshold, sizes, form)


def windows_per_period(
    effective_noise_sg_cps: Numbers, period_s: float, busy_s: float, form: str
) -> Numbers:
    """Windows that noise opens in a laser period. Literal: one, as (16a) assumes. Corrected: each
    window occupies the tree for `busy_s`.
    """
    if _literal(form):
        return np.ones_like(np.asarray(effective_noise_sg_cps, float))
    return effective_noise_sg_cps * period_s / (1 + effective_noise_sg_cps * busy_s)


def noise_counts(
    noise: MeanPhotons, threshold: Numbers, pulses: int, windows: Numbers, sizes: Sizes, form: str
) -> Numbers:
    """(16a): noise counts of a pixel in a frame.

    Literal: (8) times `pulses`. Corrected: a photon, of this or of another pixel, opens each of the
    `windows` of a period.
    """
    if _literal(form):
        return coincidence_probability(noise, threshold, sizes, form) * pulses
    n, share = sizes.subgroup, _share(noise.subgroup, sizes.subgroup)
    opens = stats.binom.sf(threshold - 2, n - 1, share) / n
    follows = (n - 1) / n * share * stats.binom.sf(threshold - 3, n - 2, share)
    return (opens + follows) * windows * pulses


def signal_counts(
    noise: MeanPhotons,
    signal: MeanPhotons,
    threshold: Numbers,
    pulses: int,
    armed: Numbers,
    sizes: Sizes,
    form: str,
) -> Numbers:
    """(16b): signal counts of a pixel in a frame: (15) times `pulses`. Corrected: times `armed`,
    P(the tree is armed).
    """
    counts = signal_probability(noise, signal, threshold, sizes, form) * pulses
    return counts if _literal(form) else counts * armed


def noise_per_bin(
    noise_counts: Numbers, laser_hz: float, jitter_s: float, lsb_s: float, form: str
) -> Numbers:
    """(17): noise counts in a bin of the histogram. Literal: in a time `jitter_s`. Corrected: in
    one LSB, as in (18).
    """
    return noise_counts * laser_hz * (jitter_s if _literal(form) else lsb_s)


def signal_per_bin(
    signal_counts: Numbers,
    time_s: Numbers,
    flight_s: Numbers,
    jitter_s: float,
    lsb_s: float,
    form: str,
) -> Numbers:
    """(18): signal counts in the bin centred at `time_s`; `jitter_s` is the sigma.

    Literal: the root is over 2 pi jitter (see `PRINTED_TIME_UNIT_S`). Corrected: integral of the
    Gaussian over the bin.
    """
    z = (np.asarray(time_s) - flight_s) / jitter_s
    if _literal(form):
        unit = PRINTED_TIME_UNIT_S
        return (
            signal_counts
            / np.sqrt(2 * np.pi * jitter_s / unit)
            * (lsb_s / unit)
            * np.exp(-(z**2) / 2)
        )
    half = lsb_s / jitter_s / 2
    return signal_counts * (special.ndtr(z + half) - special.ndtr(z - half))


def busy_s(window_ticks: int, rearm_cycles: int, timing: Timing) -> float:
    """Mean time from the opening of a window to the cycle in which the tree is armed again.

    A window opens in any phase of a cycle with equal probability.
    """
    phase = np.arange(timing.phases)
    armed_ticks = (
        armed_cycle(close_cycle(phase, window_ticks, timing.phases), rearm_cycles) * timing.phases
    )
    return float(np.mean(armed_ticks - phase) * timing.tick_s)


def histogram(
    distance_m: ArrayLike,
    signal_per_pulse: ArrayLike,
    noise_cps: ArrayLike,
    *,
    threshold: int,
    window_ticks: int,
    pulses: int,
    form: str,
    scheme: int = 2,
    sensor: Sensor | None = None,
    timing: Timing | None = None,
    spad: Spad | None = None,
    system_fwhm_s: float = 500e-12,
) -> np.ndarray:
    """Expected histogram of each pixel of a subgroup in a frame, float64[pixels, ticks]: stamps
    of the pixel's events.

    distance_m (NaN: no target), signal_per_pulse, noise_cps: detected, before dead time;
    float64[pixels] or numbers. Scheme 1 uses neither threshold nor window. Literal: (3) to (18),
    signal and noise on the grid of ticks; in scheme 1, where the paper estimates "a single
    photon", (9) for signal in a period and noise in a period (our reading).
    Corrected: photons in each tick, the states of the tree from armed to armed again, and the
    count of distinct pixels in the window, so that stamps are those of first photons. It is
    exact except for the terms named in the module's docstring, and for pixels of unequal light,
    whose count is assumed to be binomial with their mean.
    """
    sensor = given_or_new("sensor", sensor, Sensor)
    timing = given_or_new("timing", timing, Timing)
    spad = given_or_new("spad", spad, Spad)
    check_choice("scheme", scheme, SCHEMES)
    threshold = check_integer("threshold", threshold, 1, sensor.pixels)
    if _literal(form) and sensor.rule != AT_LEAST:
        raise InputError(
            f"form = {form!r}: knows only the paper's rule, not sensor.rule = {sensor.rule.name!r}"
        )
    window_ticks = check_integer("window_ticks", window_ticks, 1, sensor.window_max)
    pulses = check_integer("pulses", pulses, 1, PULSES_MAX)
    system_fwhm_s = check_real("system_fwhm_s", system_fwhm_s, FWHM_MIN_S, 1)
    pixels = (sensor.pixels,)
    distance_m = real_array("distance_m", distance_m, pixels, 0, nan=True)
    noise_cps = real_array("noise_cps", noise_cps, pixels, 0)
    signal = np.where(
        np.isnan(distance_m), 0, real_array("signal_per_pulse", signal_per_pulse, pixels, 0)
    )
    flight_s = np.nan_to_num(2 * distance_m / SPEED_OF_LIGHT_M_S) % timing.period_s
    fill = _literal_histogram if _literal(form) else _corrected_histogram
    if scheme == 1:
        threshold, window_ticks = 1, 1
    sigma_s = system_fwhm_s * SIGMA_PER_FWHM
    return fill(
        _Case(
            flight_s,
            signal,
            noise_cps,
            threshold,
            window_ticks,
            pulses,
            scheme,
            sensor,
            timing,
            spad,
            sigma_s,
        )
    )


def success_probability(expected: np.ndarray, flight_s: float, timing: Timing) -> float:
    """Probability that the largest bin of a pixel's histogram lies within `SUCCESS_TOLERANCE_S`
    of the target.

    expected: float64[ticks], mean counts, assumed to be independent and Poisson. flight_s: time of
    flight, also beyond the laser period. The target is at the maximum of the mean within a
    nanosecond of it, or within a tick if that is longer. So the lead of the first photons is assumed
    to be calibrated. A tie counts half.
    """
    time_s = (np.arange(len(expected)) + 0.5) * timing.tick_s
    near = np.abs(time_s - flight_s % timing.period_s) < max(1e-9, timing.tick_s)
    peak_s = time_s[near][np.argmax(expected[near])]
    inside = np.abs(time_s - peak_s) <= SUCCESS_TOLERANCE_S
    k = np.arange(int(expected.max() + 10 * np.sqrt(expected.max())) + 20)
    below_in, below_out = (_maximum_law(k, expected[part]) for part in (inside, ~inside))
    chance_in, chance_out = (np.diff(law, prepend=0) for law in (below_in, below_out))
    tied = chance_in * chance_out
    tied[0] = 0  # an empty histogram has no peak
    return float(np.sum(chance_in[1:] * below_out[:-1]) + np.sum(tied) / 2)


def success_by_threshold(
    signal_per_pulse: float,
    noise_cps: float,
    distance_m: float,
    *,
    timing: Timing | None = None,
    **setting: Any,
) -> np.ndarray:
    """`success_probability` of a pixel in an evenly lit subgroup, for each of `THRESHOLDS`:
    float64[7]. See `histogram`.
    """
    timing = given_or_new("timing", timing, Timing)
    flight_s = 2 * check_real("distance_m", distance_m, 0) / SPEED_OF_LIGHT_M_S

    def success(threshold: int) -> float:
        light = distance_m, signal_per_pulse, noise_cps
        expected = histogram(*light, threshold=threshold, timing=timing, **setting)[0]
        return success_probability(expected, flight_s, timing)

    return np.array([success(threshold) for threshold in THRESHOLDS])


def expected_threshold(success: np.ndarray, slack: float = 0.01) -> int:
    """The highest threshold whose success is within `slack` of the best.

    Of equally good thresholds, the highest one sends the fewest events. Fig. 7 shows it against the
    activity. The paper does not give its rule; this one is our choice.

    success: float64[7], that of each of `THRESHOLDS`. Raises `InputError`.
    """
    return int(_tolerated(success, slack).max())


def lowest_threshold(success: np.ndarray, slack: float = 0.01) -> int:
    """The lowest threshold whose success is within `slack` of the best."""
    return int(_tolerated(success, slack).min())


def _tolerated(success: np.ndarray, slack: float) -> np.ndarray:
    """Thresholds whose success is within `slack` of the best, ascending. Raises `InputError`."""
    success = real_array("success", success, (len(THRESHOLDS),), 0, 1)
    slack = check_real("slack", slack, 0, 1)
    return np.array(THRESHOLDS)[success >= success.max() - slack]


def _literal(form: str) -> bool:
    return check_choice("form", form, FORMS) == FORMS[0]


def _equivalent_mean(probability: Numbers) -> Numbers:
    """Poisson mean at which at least one photon is detected with `probability`."""
    return -np.log1p(-np.minimum(probability, 1 - np.finfo(float).eps))


def _share(photons: Numbers, pixels: int) -> Numbers:
    """Probability that one of `pixels` equal pixels detects; `photons` is the mean of all
    together.
    """
    return -np.expm1(-np.asarray(photons, float) / pixels)


# Arguments of `histogram`, checked. flight_s, signal (photons per pulse), noise_cps:
# float64[pixels].
_Case = namedtuple(
    "_Case",
    "flight_s signal noise_cps threshold window_ticks pulses scheme sensor timing spad sigma_s",
)


def _literal_histogram(of: _Case) -> np.ndarray:
    """Equations (3) to (18) as printed, on the grid of ticks."""
    form, laser_hz, sizes = (
        FORMS[0],
        1 / of.timing.period_s,
        Sizes(of.sensor.minigroup_pixels, of.sensor.pixels),
    )
    window_s = of.timing.period_s if of.scheme == 1 else of.window_ticks * of.timing.tick_s
    dead = (of.threshold, of.spad.dead_time_s, of.sensor.pixels, form)
    effective_noise_cps, effective_signal_cps = effective_cps(
        of.noise_cps, of.signal * laser_hz, of.spad.dead_time_s, laser_hz, form
    )
    of_noise = _grouped(noise_photons(effective_noise_cps, window_s, *dead), of.sensor)
    of_signal = _grouped(signal_photons(effective_signal_cps, laser_hz, *dead), of.sensor)
    if of.scheme == 1:
        detects_noise = pixel_probability(of_noise.pixel, form)
        counts = (
            of.pulses * detects_noise,
            of.pulses * (1 - detects_noise) * pixel_probability(of_signal.pixel, form),
        )
    else:
        windows = windows_per_period(of_noise.subgroup, 0, 0, form)
        counts = (
            noise_counts(of_noise, of.threshold, of.pulses, windows, sizes, form),
            signal_counts(of_noise, of_signal, of.threshold, of.pulses, 1, sizes, form),
        )
    per_pixel_noise, per_pixel_signal = (np.asarray(part)[:, None] for part in counts)
    time_s = (np.arange(of.timing.period_ticks) + 0.5) * of.timing.tick_s
    floor = noise_per_bin(per_pixel_noise, laser_hz, of.sigma_s, of.timing.tick_s, form)
    peak = signal_per_bin(
        per_pixel_signal, time_s, of.flight_s[:, None], of.sigma_s, of.timing.tick_s, form
    )
    return np.asarray(floor + peak)


def _grouped(photons: Numbers, sensor: Sensor) -> MeanPhotons:
    """(5), (6): the photons of each pixel of a subgroup, of its minigroup and of the subgroup."""
    minigroup = pixel_table(sensor).minigroup
    sums = np.bincount(minigroup, photons, sensor.minigroups)
    return MeanPhotons(photons, sums[minigroup], float(np.sum(sums)))


def _corrected_histogram(of: _Case) -> np.ndarray:
    """Corrected form of `histogram`, with ticks as independent trials.

    `fired` is the mean number of avalanches of each pixel until the start of each tick, at most
    one per window.
    """
    ticks = of.timing.period_ticks
    border_s = np.arange(ticks + of.window_ticks + 1) * of.timing.tick_s
    live = (1 / (1 + of.noise_cps * of.spad.dead_time_s))[:, None]
    pulse = special.ndtr((border_s - of.flight_s[:, None]) / of.sigma_s)
    fired = live * (of.noise_cps[:, None] * border_s - np.expm1(-of.signal[:, None] * pulse))
    start, after, end = (
        fired[:, :ticks],
        fired[:, 1 : ticks + 1],
        fired[:, of.window_ticks : ticks + of.window_ticks],
    )
    nobody = np.prod(1 - (after - start), axis=0)  # at this tick
    in_window, in_rest = end - start, end - after
    # A pixel is in the map of an event that this tick opens if it fires in the window, less the
    # cases in which no pixel fires in the window's first tick.
    law = rises(of.sensor.rule, of.sensor.subgroup, of.threshold)
    met = event_share(law, lambda pixels: _met_by_others(pixels, in_window))
    met_in_rest = event_share(law, lambda pixels: _met_by_others(pixels, in_rest))
    armed = _armed(
        nobody,
        of.window_ticks,
        of.timing.phases,
        of.sensor.rearm,
        ticks - of.sensor.guard * of.timing.phases,
    )
    return of.pulses * armed * (in_window * met - nobody * in_rest * met_in_rest)


def _met_by_others(pixels: int, share: np.ndarray) -> np.ndarray:
    """float64[ticks]: probability that of `pixels` pixels, all except one given pixel fire.
    share: float64[pixels, ticks].
    """
    met: np.ndarray = stats.binom.sf(pixels - 2, len(share) - 1, share.mean(axis=0))
    return met


@njit
def _armed(
    nobody: np.ndarray, window_ticks: int, phases: int, rearm_cycles: int, open_ticks: int
) -> np.ndarray:
    """Probability that the tree is armed at each tick: at the period's start, and some cycles
    after each opening.
    """
    armed, again, now = np.zeros(nobody.size), np.zeros(nobody.size), 1.0
    for t in range(open_ticks):
        now += again[t]
        armed[t] = now
        opening = now * (1 - nobody[t])
        now -= opening
        ready = _armed_cycle(_close_cycle(t, window_ticks, phases), rearm_cycles) * phases
        if ready < again.size:
            again[ready] += opening
    return armed


def _maximum_law(k: np.ndarray, means: np.ndarray) -> np.ndarray:
    """P(the largest of independent Poisson counts <= k); means are rounded to three digits, so
    that few differ.
    """
    digits = 10.0 ** (np.floor(np.log10(np.maximum(means, 1e-12))) - 2)
    means, times = np.unique(np.round(means / digits) * digits, return_counts=True)
    return np.exp(
        np.sum(times[:, None] * np.log(np.maximum(special.pdtr(k, means[:, None]), 1e-300)), axis=0)
    )
