# SPDX-License-Identifier: Apache-2.0
"""Lowest possible errors of a distance: Cramer-Rao bounds of a pixel on a flat wall.

Ref: Scholes et al. 2022, arXiv 2210.05644 (the bound of single-photon lidar with background), and
arXiv 2507.11404. The recursion for the words of this sensor is our own.

Three observers of the same light are compared; each knows the light and the background:

- photons: one TDC per SPAD, which tells every avalanche (the first photon of a pulse, since the
  SPAD is dead afterwards);
- words: the events of the sensor, of which each has one stamp and the map of the pixels in its
  window. A window without enough pixels tells nothing, but the tree is blind after it;
- both for one pixel whose neighbours' times are known, and for all pixels of a subgroup that share
  one distance, as an estimator of planes may assume.

Not in the bounds: a pixel that is dead from an earlier window, and events that were dropped.
"""

import math
from types import NoneType
from typing import NamedTuple

import numpy as np
from attrs import frozen
from scipy import signal, special

from ..model.contract.coincidence import rises
from ..model.contract.config import Config, parse_config
from ..model.contract.latency import armed_cycle, close_cycle
from ..model.depth.arrivals import SYSTEM_FWHM_S
from ..model.depth.gates import open_share
from ..model.depth.likelihood import DEAD_S
from ..model.depth.pulse_ticks import PulseTicks, pulse_ticks
from ..model.depth.quality import OTHER_SURFACE_M
from ..model.depth.tree import kept_shares
from ..model.light.light import Light, background_cps, signal_per_pulse
from ..model.shared.arguments import check_kind
from ..model.shared.constants import SIGMA_PER_FWHM
from ..model.shared.errors import InputError, check_integer
from ..model.shared.pulse import TIME_MAX_S, Pulse, PulseSource, pulse_of
from ..model.shared.quantities import check_real

REACH_SIGMAS = 5.0  # from the centre of a pulse to its beginning and end
FINE = 8  # steps per tick of a photon's time
SHIFT_TICKS = 0.02  # by which derivatives are taken
PHASES = 8  # positions of the pulse in a cycle, over which the information is averaged
RARE = 1e-12
NARROWEST_TICKS = 0.3  # sigma of a pulse, below which it may lie within one tick at all `PHASES`
LIGHTS = 5  # between which the bounds of pixels are interpolated
TRIALS = 400  # frames from which the share of gross errors is estimated
SEED = 1


@frozen(kw_only=True)
class Bound:
    """Lowest possible errors of a distance in a frame.

    Attributes
    ----------
    signal_per_pulse, background_cps : float
        Detected light of the pixel.
    photons_mm, bound_mm : float
        RMS error of one pixel's distance, in millimetres: from all its photons, also while its gate
        is closed, and from the words of the sensor. It falls with the root of the pulses.
    wall_photons_mm, wall_bound_mm : float
        The same for all pixels of a subgroup together that are on, if they share one distance.
    gross_share : float
        Share of the frames in which an ideal estimator is off by more than 15 cm, if it sees all
        photons of one pixel and nothing of its neighbours; estimated from `TRIALS` frames. It takes
        any of several times that are equally likely, such as those of a frame without photons.
    """

    signal_per_pulse: float
    background_cps: float
    photons_mm: float
    bound_mm: float
    wall_photons_mm: float
    wall_bound_mm: float
    gross_share: float


def bound(
    config: Config | None = None,
    *,
    distance_m: float = 8.0,
    reflectivity: float = 0.4,
    klux: float = 50.0,
    system_fwhm_s: float = SYSTEM_FWHM_S,
    pulse: PulseSource | None = None,
    trials: int = TRIALS,
    **settings: float | bool,
) -> Bound:
    """Return the lowest possible errors of a pixel on a flat wall.

    Parameters
    ----------
    config : Config or None
        The sensor, its pulses, and the threshold, window, mask and gate of subgroup 0; None: the
        defaults. With the controller (`auto`), it is the configured threshold that counts, too.
    distance_m, reflectivity, klux : float
        Distance of the wall (from 0.05 m), its reflectivity from 0 to 1, and the ambient light.
    system_fwhm_s : float
        FWHM of laser pulse and jitter combined, in seconds, of a Gaussian.
    pulse : Pulse, numpy.ndarray, str, Path or None
        Measured shape of laser pulse and jitter combined, instead of that Gaussian (`pulse_of`).
    trials : int
        Frames from which `gross_share` is estimated; 0: it is NaN.
    settings
        `pulses`, and keys of `[subgroup]`, such as `threshold`, `window` and `coincidence`.

    Raises
    ------
    InputError
        If a value is out of range, the pulse is much shorter than a tick, or subgroup 0 has no events
        of the wall.
    """
    chosen = check_kind("config", config, Config, NoneType) or parse_config({})
    if "pulses" in settings:
        chosen = chosen.with_frame(pulses=settings.pop("pulses"))
    chosen = chosen.with_settings(**settings)
    distance_m = check_real("distance_m", distance_m, 0.05)
    reflectivity = check_real("reflectivity", reflectivity, 0, 1)
    trials = check_integer("trials", trials, 0, 1_000_000)
    system_fwhm_s = check_real("system_fwhm_s", system_fwhm_s, 1e-15, TIME_MAX_S)
    light = float(signal_per_pulse(distance_m, reflectivity))
    noise_cps = float(background_cps(check_real("klux", klux, 0), reflectivity))
    shape = pulse_ticks(chosen, system_fwhm_s, pulse_of(pulse))
    _check_length(chosen, shape, "system_fwhm_s" if pulse is None else "pulse")
    lit_share = _open_at(chosen, np.array([distance_m]))[0]
    words = word_bounds_mm(chosen, light, noise_cps, shape, lit_share)
    if light:
        _check_events(chosen, distance_m, words, lit_share)
    photons_mm = photon_bound_mm(chosen, light, noise_cps, shape)
    return Bound(
        signal_per_pulse=light,
        background_cps=noise_cps,
        photons_mm=photons_mm,
        bound_mm=words.pixel_mm,
        wall_photons_mm=photons_mm / math.sqrt(_live_pixels(chosen)),
        wall_bound_mm=words.wall_mm,
        gross_share=gross_share(chosen, light, noise_cps, shape, trials),
    )


def _check_length(config: Config, pulse: PulseTicks, name: str) -> None:
    """Raise `InputError`, which names an argument, if a pulse is too short."""
    if too_short(pulse):
        least_s = NARROWEST_TICKS * config.tick_s / SIGMA_PER_FWHM
        raise InputError(
            f"{name}: the pulse is much shorter than a tick, where no bound is known; its FWHM must be at least {least_s:.2g} s",
            field=name,
        )


def _check_events(config: Config, distance_m: float, words: "WordBounds", lit_share: float) -> None:
    """Raise `InputError` if subgroup 0 has no events of the light from a distance."""
    if config.counting:
        raise InputError(
            "frame.format = 'counts': has no events, and the bound is that of events",
            field="frame.format",
        )
    if not lit_share:
        raise InputError(
            f"subgroup.gate_start: the gate of subgroup 0 is never open for light from {distance_m:g} m",
            field="subgroup.gate_start",
        )
    if math.isinf(words.pixel_mm):
        raise InputError(
            "subgroup.mask: no window of subgroup 0 has as many pixels that are on as an event needs",
            field="subgroup.mask",
        )


def _live_pixels(config: Config) -> int:
    """Return the number of pixels of subgroup 0 that are on."""
    return int(np.count_nonzero(config.mask[0]))


def _open_at(config: Config, distance_m: np.ndarray) -> np.ndarray:
    """float64[n]: share of the pulses in which the gate of subgroup 0 is open when the light from
    distances, float64[n], comes. Without a distance it is 1.
    """
    known = np.isfinite(distance_m)
    tick = np.where(known, distance_m, 0.0) / config.tick_m
    cycle = (tick % config.period_ticks // config.sensor.phases).astype(np.int64)
    share = open_share(config, 0, range(config.pulses))[cycle]
    return np.where(known, share, 1.0)


def _open_of(config: Config, light: Light) -> np.ndarray:
    """float64[pixels]: the same for the strongest target of each pixel."""
    strongest = light.signal_per_pulse.argmax(axis=1)
    return _open_at(config, light.distance_m[np.arange(light.pixels), strongest])


def mm_per_tick(config: Config) -> float:
    """Return the distance in millimetres that a tick stands for."""
    return 1e3 * config.tick_m


def _error_mm(config: Config, information: float) -> float:
    """Return the lowest RMS error with some information per squared tick; inf if there is none."""
    return mm_per_tick(config) / math.sqrt(information) if information > 0 else math.inf


def _noise_per_tick(config: Config, noise_cps: float) -> float:
    return noise_cps * config.tick_s


def _reach(pulse: PulseTicks) -> int:
    """Return the ticks from a surface's time to the beginning and the end of its light."""
    if not pulse.times:
        return math.ceil(REACH_SIGMAS * pulse.sigma)
    return math.ceil(max(-pulse.times[0], pulse.times[-1]))


def _alive(noise_cps: float) -> float:
    """Return the chance that a SPAD is not dead from its background."""
    return 1 / (1 + noise_cps * DEAD_S)


def photon_bound_mm(
    config: Config,
    signal_per_pulse: float,
    noise_cps: float,
    pulse: PulseTicks | None = None,
) -> float:
    """Return the lowest RMS error of a pixel's distance from all its avalanches, in millimetres.

    signal_per_pulse: detected photons. noise_cps: detected background, counts per second.
    """
    shape = pulse or pulse_ticks(config)
    noise = _noise_per_tick(config, noise_cps)
    if shape.times:
        places = np.arange(PHASES) / PHASES
        told = [_tick_information(shape, place, signal_per_pulse, noise) for place in places]
        information = config.pulses * _alive(noise_cps) * float(np.mean(told))
        return _error_mm(config, information)
    sigma = shape.sigma
    step = sigma / (FINE * 4)
    at = np.arange(-REACH_SIGMAS * sigma, REACH_SIGMAS * sigma, step)
    density = np.exp(-0.5 * (at / sigma) ** 2) / (math.sqrt(2 * math.pi) * sigma)
    rate = signal_per_pulse * density + noise
    rise = signal_per_pulse * density * at / sigma**2
    before = np.concatenate([[0.0], np.cumsum(rate[:-1])]) * step
    alive = _alive(noise_cps) * np.exp(-before)
    information = config.pulses * np.sum(rise**2 / np.maximum(rate, 1e-300) * alive) * step
    return _error_mm(config, information)


def _tick_information(
    shape: PulseTicks, place: float, signal_per_pulse: float, noise_per_tick: float
) -> float:
    """Return what the first photon of a pulse tells about its time to a SPAD that is ready, per
    squared tick.

    place: of the pulse in a tick. The TDC's ticks count, as a table's density has no slope between
    its samples.
    """
    reach = _reach(shape) + 1
    border = np.arange(-reach, reach + 1) - place
    rate = signal_per_pulse * np.diff(shape.share_before(border)) + noise_per_tick
    later = np.diff(shape.share_before(border - SHIFT_TICKS))
    earlier = np.diff(shape.share_before(border + SHIFT_TICKS))
    rise = signal_per_pulse * (later - earlier) / (2 * SHIFT_TICKS)
    before = np.concatenate([[0.0], np.cumsum(rate[:-1])])
    return float(np.sum(rise**2 / np.maximum(rate, 1e-300) * np.exp(-before)))


class WordBounds(NamedTuple):
    """Lowest RMS errors from the words, in millimetres."""

    pixel_mm: float  # of one pixel, whose neighbours' times are known
    wall_mm: float  # of all pixels of a subgroup together


class Windows(NamedTuple):
    """What happens in a window that opens in each tick of some cycles, if the tree is armed.

    told: float64[ticks, kinds], chances of the events that can be told apart, which contain that no
    photon came in the cycle before. rejected: float64[ticks], chance of a window that tells
    nothing.
    """

    told: np.ndarray
    rejected: np.ndarray


class Wall(NamedTuple):
    """A subgroup before a wall; times in ticks."""

    signal: float  # photons per pulse
    noise: float  # photons per tick
    alive: float
    pulse: PulseTicks
    pixels: int  # that are on
    window: int
    phases: int
    rearm: int
    rejected: np.ndarray  # float64[pixels + 1], share of the windows of so many pixels
    start: int  # first tick of the cycles that matter
    cycles: int  # their number


def too_short(pulse: PulseTicks) -> bool:
    """Return whether a pulse is so much shorter than a tick that its time only shows near the
    borders of ticks. The mean information then says nothing of the error.
    """
    return pulse.sigma < NARROWEST_TICKS


def word_bounds_mm(
    config: Config,
    signal_per_pulse: float,
    noise_cps: float,
    pulse: PulseTicks | None = None,
    lit_share: float = 1.0,
) -> WordBounds:
    """Return the lowest RMS errors from the sensor's words, with the settings of subgroup 0; inf if
    it has no events, NaN if the pulse is too short (`too_short`).

    signal_per_pulse: detected photons of each pixel. noise_cps: detected background of each.
    lit_share: of the pulses, in which the gate is open for the light.
    """
    wall = subgroup_wall(config, signal_per_pulse, noise_cps, pulse)
    pulses = config.pulses * lit_share
    return WordBounds(
        pixel_mm=_lowest_mm(config, wall, pulses, of_all=False),
        wall_mm=_lowest_mm(config, wall, pulses, of_all=True),
    )


def _lowest_mm(config: Config, wall: Wall, pulses: float, *, of_all: bool) -> float:
    """Return the lowest RMS error of one pixel's time, or of that of all; inf without events, NaN if
    the pulse is too short.

    pulses: in which the gate is open for the light.
    """
    if not pulses or np.all(wall.rejected[1:] >= 1):
        return math.inf
    if too_short(wall.pulse):
        return math.nan
    places = (np.arange(PHASES) + 0.3) * wall.phases / PHASES
    found = [_information(wall, place, of_all=of_all) for place in places]
    information = pulses * _armed_share(wall) * float(np.mean(found))
    return _error_mm(config, information)


class MedianLight(NamedTuple):
    """Light of a usual pixel."""

    signal_per_pulse: float  # detected photons
    noise_cps: float  # detected background


def median_light(light: Light) -> MedianLight | None:
    """Return the medians over the pixels that have some light; None: no pixel has."""
    lit = light.total_signal > 0
    if not lit.any():
        return None
    return MedianLight(
        signal_per_pulse=float(np.median(light.total_signal[lit])),
        noise_cps=float(np.median(light.total_background_cps[lit])),
    )


def usual_open_share(config: Config, light: Light) -> float:
    """Return the median share of the pulses in which the gate of subgroup 0 is open for the light of
    a pixel, over the pixels that have some.
    """
    return float(np.median(_open_of(config, light)[light.total_signal > 0]))


def with_usual_threshold(config: Config, threshold: np.ndarray) -> Config:
    """Return a configuration in which every subgroup has the median of their thresholds in a frame."""
    return config.with_settings(threshold=int(np.median(threshold)))


def pixel_bounds_mm(config: Config, light: Light, pulse: Pulse | None = None) -> np.ndarray:
    """float64[pixels]: lowest RMS error of each pixel's distance from the words, in millimetres, as
    if its neighbours had the same light; NaN without light or events, or if the pulse is too short.

    It is interpolated between `LIGHTS` lights, at the median background of the pixels that have
    some light. The settings are those of subgroup 0. pulse: measured shape of laser pulse and jitter
    together, instead of a Gaussian.
    """
    total = light.total_signal
    found = np.full(len(total), np.nan)
    usual = median_light(light)
    if usual is None:
        return found
    lit_share = _open_of(config, light)
    lit = (total > 0) & (lit_share > 0)
    if not lit.any():
        return found
    lights = np.geomspace(total[lit].min(), total[lit].max(), LIGHTS)
    if lights[0] == lights[-1]:
        lights = lights[:1]
    shape = pulse_ticks(config, pulse=pulse)
    lowest = []
    for one in lights:
        wall = subgroup_wall(config, float(one), usual.noise_cps, shape)
        lowest.append(_lowest_mm(config, wall, config.pulses, of_all=False))
    if math.isinf(lowest[0]):
        return found
    found[lit] = np.exp(np.interp(np.log(total[lit]), np.log(lights), np.log(lowest)))
    found[lit] /= np.sqrt(lit_share[lit])
    return found


def subgroup_wall(
    config: Config,
    signal_per_pulse: float,
    noise_cps: float,
    pulse: PulseTicks | None = None,
) -> Wall:
    """Return subgroup 0 before a wall; the others are as in `word_bounds_mm`."""
    sensor = config.sensor
    coincidence = bool(config.coincidence[0])
    threshold = int(config.threshold[0]) if coincidence else 1
    kept = kept_shares(rises(sensor.rule, sensor.subgroup, threshold), sensor.pixels)
    shape = pulse or pulse_ticks(config)
    window = int(config.window[0]) if coincidence else 1
    pixels = _live_pixels(config)
    reach = _reach(shape)
    before = -(-(reach + window) // sensor.phases)
    return Wall(
        signal=signal_per_pulse,
        noise=_noise_per_tick(config, noise_cps),
        alive=_alive(noise_cps),
        pulse=shape,
        pixels=pixels,
        window=window,
        phases=sensor.phases,
        rearm=sensor.rearm,
        rejected=1 - kept[: pixels + 1],
        start=-before * sensor.phases,
        cycles=before + -(-(sensor.phases + reach) // sensor.phases) + 1,
    )


def _armed_share(wall: Wall) -> float:
    """Return the chance that the tree is armed at the beginning of a cycle before the pulse."""
    opens = 1 - math.exp(-wall.pixels * wall.noise * wall.alive * wall.phases)
    blocked = (wall.window - 1) / wall.phases + wall.rearm  # further cycles, on average
    return 1 / (1 + opens * blocked)


def _information(wall: Wall, place: float, *, of_all: bool) -> float:
    """Return what a pulse tells about the time of one pixel, or of all: Fisher's information, per
    squared tick.

    place: ticks from the beginning of a cycle to the centre of the pulse.
    """
    shifts = (0.0, SHIFT_TICKS, -SHIFT_TICKS)
    of_shifts = [windows(wall, place, shift, of_all=of_all) for shift in shifts]
    later = np.zeros(wall.cycles + 2 + wall.rearm + wall.window // wall.phases + 1)
    for first in range(wall.cycles - 1, -1, -1):
        later[first] = _from_cycle(wall, of_shifts, first, later)
    return float(later[0])


def _from_cycle(wall: Wall, of_shifts: list[Windows], first: int, later: np.ndarray) -> float:
    """Return the information from a cycle on, in which the tree is known to be armed.

    later: the same for the cycles after it. Rejected windows are hidden, so the chance that the
    tree is armed is carried along, given that no event came.
    """
    armed = np.zeros((len(of_shifts), len(later)))
    armed[:, first] = 1.0
    blind = np.zeros((len(of_shifts), len(later)))  # until a cycle
    silent = 1.0  # chance that no event came so far
    total = 0.0
    for c in range(first, wall.cycles):
        ticks = slice(c * wall.phases, (c + 1) * wall.phases)
        again = _armed_again(wall, c)
        told = []
        for k, one in enumerate(of_shifts):
            here = armed[k, c] + blind[k, c + 1 :].sum()
            told.append(armed[k, c] / max(RARE, here) * one.told[ticks])
        none = [1 - one.sum() for one in told]
        chance = np.append(told[0].ravel(), none[0])
        rise = np.append((told[1] - told[2]).ravel(), none[1] - none[2]) / (2 * SHIFT_TICKS)
        seen = chance > RARE
        total += silent * np.sum(rise[seen] ** 2 / chance[seen])
        total += silent * np.sum(told[0].sum(axis=1) * later[np.minimum(again, len(later) - 1)])
        silent *= none[0]
        for k, one in enumerate(of_shifts):
            rejected = armed[k, c] * one.rejected[ticks]
            stays = armed[k, c] * (1 - one.told[ticks].sum()) - rejected.sum()
            armed[k, c + 1] += max(0.0, stays)
            np.add.at(armed[k], again, rejected)
            np.add.at(blind[k], again, rejected * (again > c + 1))
        if silent < RARE:
            break
    return total


def _armed_again(wall: Wall, c: int) -> np.ndarray:
    """int64[phases]: cycle in which the tree is armed after a window that opened in cycle c."""
    tick = c * wall.phases + np.arange(wall.phases)
    return armed_cycle(close_cycle(tick, wall.window, wall.phases), wall.rearm)


def windows(wall: Wall, place: float, shift: float, *, of_all: bool) -> Windows:
    """Return what happens in windows. shift: ticks by which the time of one pixel, or of all, is
    later.
    """
    ticks = wall.cycles * wall.phases
    own = _photons(wall, place + shift, ticks)
    other = own if of_all else _photons(wall, place, ticks)
    others = wall.pixels - 1
    opening = np.arange(ticks)
    cycle = opening // wall.phases * wall.phases
    own_until = np.concatenate([[0.0], np.cumsum(own)])
    other_until = np.concatenate([[0.0], np.cumsum(other)])
    photons_before = own_until[opening] - own_until[cycle]
    photons_before += others * (other_until[opening] - other_until[cycle])
    waits = np.exp(-photons_before)
    end = opening + wall.window
    own_in = 1 - np.exp(-(own_until[end] - own_until[opening]))
    own_later = 1 - np.exp(-(own_until[end] - own_until[opening + 1]))
    other_in = 1 - np.exp(-(other_until[end] - other_until[opening]))
    other_later = 1 - np.exp(-(other_until[end] - other_until[opening + 1]))
    silent = np.exp(-own[:ticks] - others * other[:ticks])
    opens = waits * (1 - silent)
    if of_all:
        counts = np.arange(wall.pixels + 1)
        number = _binomial(counts, wall.pixels, own_in)
        number -= silent[:, None] * _binomial(counts, wall.pixels, own_later)
        told = waits[:, None] * np.maximum(0.0, number[:, 1:]) * (1 - wall.rejected[1:])
        return Windows(told, np.maximum(0.0, opens - told.sum(axis=1)))
    kept_in = _kept(wall, other_in, 1)
    kept_later = _kept(wall, other_later, 1)
    inside = own_in * kept_in - silent * own_later * kept_later
    wins = (1 - np.exp(-own[:ticks])) * np.exp(-others * other[:ticks] / 2)
    wins *= (kept_in + kept_later) / 2
    outside = (1 - own_in) * _kept(wall, other_in, 0)
    outside -= silent * (1 - own_later) * _kept(wall, other_later, 0)
    kinds = np.stack([wins, inside - wins, outside], axis=1)
    told = waits[:, None] * np.maximum(0.0, kinds)
    return Windows(told, np.maximum(0.0, opens - told.sum(axis=1)))


def _photons(wall: Wall, place: float, ticks: int) -> np.ndarray:
    """float64[more than ticks]: mean photons of a pixel in each tick."""
    edge = wall.start + np.arange(ticks + wall.window + wall.phases + 1)
    share = np.diff(wall.pulse.share_before(edge - place))
    return wall.alive * (wall.signal * share + wall.noise)


def _binomial(counts: np.ndarray, trials: int, chance: np.ndarray) -> np.ndarray:
    """float64[n, counts]: probabilities of so many successes, for each chance.

    SciPy's distribution gives the same, in ten times the time for arrays this small.
    """
    chance = chance[:, None]
    return special.binom(trials, counts) * chance**counts * (1 - chance) ** (trials - counts)


def _kept(wall: Wall, fires: np.ndarray, own: int) -> np.ndarray:
    """float64[n]: chance that a window with the pixel (own 1) or without it (0) becomes an event.

    fires: of each other pixel.
    """
    others = wall.pixels - 1
    most = int(np.count_nonzero(wall.rejected[own:] > 0))
    counts = np.arange(most)
    lost = _binomial(counts, others, fires) * wall.rejected[own : own + most]
    return 1 - lost.sum(axis=1)


def gross_share(
    config: Config,
    signal_per_pulse: float,
    noise_cps: float,
    pulse: PulseTicks | None = None,
    trials: int = TRIALS,
) -> float:
    """Return the share of frames in which the likeliest time is off by more than 15 cm, for all
    photons of one pixel whose light and background are known; NaN with 0 trials. Of times that are
    equally likely, a frame counts with the share of those that are off.
    """
    if not trials:
        return math.nan
    shape = pulse or pulse_ticks(config)
    reach = min(_reach(shape), config.period_ticks // 2 - 1)
    noise = max(_noise_per_tick(config, noise_cps), RARE)
    edge = np.arange(-reach, reach + 2) - 0.5
    rate = signal_per_pulse * np.diff(shape.share_before(edge)) + noise
    before = np.concatenate([[0.0], np.cumsum(rate[:-1])])
    rate = _alive(noise_cps) * rate * np.exp(-before)
    floor = _alive(noise_cps) * noise
    ratio = np.log(np.maximum(rate / floor, 1e-300))  # after many photons, none is left
    ticks = config.period_ticks
    far = round(OTHER_SURFACE_M / (mm_per_tick(config) / 1e3))
    middle = ticks // 2
    random = np.random.default_rng(SEED)
    wrong = 0.0
    for _ in range(trials):
        hits = random.poisson(config.pulses * floor, ticks).astype(np.float64)
        hits[middle - reach : middle + reach + 1] = random.poisson(config.pulses * rate)
        level = signal.fftconvolve(hits, ratio[::-1], mode="same")
        chance = np.exp(level - level.max())
        near = np.convolve(chance, np.ones(2 * far + 1), "same")
        best = np.flatnonzero(near > near.max() * (1 - 1e-9))
        if best[-1] - best[0] <= 2 * far:  # all of them have the same peak
            best = best[len(best) // 2 :][:1]
        wrong += float(np.mean(np.abs(best - middle) > far))
    return float(wrong / trials)
