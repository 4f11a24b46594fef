# SPDX-License-Identifier: Apache-2.0
"""The estimator of planes, for the format `counts`: the steps of `surfaces.py` on the likelihood of
counts in gates (`count_likelihood.py`).

All of this is our own choice. Nothing but the counts is known: also the background comes from them
(`count_light.py`).
"""

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import special

from ..contract.config import Config
from ..contract.counts import COUNT_MOST, GATES, NO_GATE
from ..contract.gate_counts import Counts
from ..contract.pixels import pixel_table
from ..contract.result import check_arrays, check_frame
from ..shared.threads import Threads
from .belief import REACH_SIGMAS, ByChance, Hits, Lit, Signs, signs_of
from .count_light import Trials, better_background, first_background, fit_lights, pulse_shares
from .count_likelihood import NO_TICK, Seen, count_likelihood
from .gates import open_pulses
from .histograms import Events, by_subgroup, pixel_image, winner_map
from .intensity import Intensity
from .light_prior import EVEN, LightPrior
from .likelihood import DEAD_S, Grid, Levels
from .pulse_ticks import PulseTicks
from .seeds import seed_scores
from .surfaces import Coarse, Fitter, peak_offset

# Of a pixel with its neighbours: a score that accidents of background and dark surfaces reach alike,
EVEN_SCORE = -4.0
SCORE_WIDTH = 2.0  # and the change of it that makes odds e times as high


class GateCounts(NamedTuple):
    """Counts of one frame or of several, which stand behind each other as further gates."""

    trials: Trials
    own_pulses: np.ndarray  # int64[subgroups, pixels], in which each pixel counted
    pulses: int  # in which pixels could count


def gate_counts(
    arrays: dict[str, np.ndarray], config: Config, frame: int | None = None
) -> GateCounts:
    """Return the counts of a result (`result.py`) in one frame, or in all frames (None).

    Raises `InputError` if the result has no such frame, or no counts.
    """
    check_arrays(arrays, *Counts._fields)
    frames = len(arrays["gate_cycle"])
    frame = check_frame(frame, frames)
    chosen = range(frames) if frame is None else range(frame, frame + 1)
    of_frames = [_trials_of(arrays, config, k) for k in chosen]
    trials = Trials(
        first=np.concatenate([one.first for one in of_frames], axis=2),
        hits=np.concatenate([one.hits for one in of_frames], axis=2),
        misses=np.concatenate([one.misses for one in of_frames], axis=2),
        width=config.sensor.quarter_ticks,
    )
    counting = config.pulses - 2 * config.search_pulses
    own_pulses = arrays["count_pulses"][chosen.start : chosen.stop].sum(axis=0, dtype=np.int64)
    return GateCounts(trials, own_pulses, len(of_frames) * counting)


def _trials_of(arrays: dict[str, np.ndarray], config: Config, frame: int) -> Trials:
    """Return the counts of a frame."""
    sensor = config.sensor
    cycle = arrays["gate_cycle"][frame].astype(np.int64)[:, pixel_table(sensor).minigroup]
    return trials_of(
        np.where(cycle == NO_GATE, NO_TICK, cycle * sensor.phases),
        arrays["gate_hits"][frame].astype(np.int64),
        arrays["count_pulses"][frame],
        config,
        range(2 * config.search_pulses, config.pulses),
    )


def trials_of(
    first: np.ndarray, hits: np.ndarray, own_pulses: np.ndarray, config: Config, counted: range
) -> Trials:
    """Return counts with the pulses in which pixels could be hit.

    first, hits: as in `Trials`, bins have a quarter of a cycle. own_pulses: int64[subgroups,
    pixels], in which each pixel counted, the first ones of `counted`: the pulses of the frame in
    which pixels count.
    """
    sensor = config.sensor
    bins = hits.shape[3]
    begin = first[..., None] + sensor.quarter_ticks * np.arange(bins)
    cycle = np.clip(begin // sensor.phases, 0, config.period - 1)
    tried = np.empty(hits.shape)
    for s in range(sensor.subgroups):
        # A pixel that stops early misses the later places of a gate that moves.
        tries = open_pulses(config, s, counted.start, counted.start + own_pulses[s])
        of_pixels = np.take_along_axis(tries, cycle[s].reshape(sensor.pixels, -1), axis=1)
        tried[s] = of_pixels.reshape(cycle[s].shape)
    tried = np.maximum(tried - _dead(hits, first, config), hits)
    tried[first == NO_TICK] = 0
    return Trials(first, hits, tried - hits, sensor.quarter_ticks)


def _dead(hits: np.ndarray, first: np.ndarray, config: Config) -> np.ndarray:
    """float64[subgroups, pixels, gates, bins]: pulses in which a pixel was dead in a bin, after a
    hit in an earlier one.
    """
    width = config.sensor.quarter_ticks
    dead_ticks = DEAD_S / config.tick_s
    bins = hits.shape[3]
    behind = width * (np.arange(bins)[:, None] - np.arange(bins))  # ticks from one bin to another
    dead = np.zeros(hits.shape)
    for later in range(GATES):
        for earlier in range(GATES):
            between = first[:, :, later] - first[:, :, earlier]
            gates = np.minimum(first[:, :, later], first[:, :, earlier])
            near = (gates > NO_TICK) & (np.abs(between) < dead_ticks + bins * width)
            ticks = between[near][:, None, None] + behind
            blocks = (ticks > 0) & (ticks < dead_ticks)
            dead[:, :, later][near] += (blocks @ hits[:, :, earlier][near][:, :, None])[:, :, 0]
    return dead


def hits_as_events(arrays: dict[str, np.ndarray], config: Config, frame: int) -> Events:
    """Return the counted hits of a frame as events of one pixel each, in the middle of their bins,
    for views of single hits; estimators do not read them.
    """
    sensor = config.sensor
    trials = gate_counts(arrays, config, frame).trials
    at = np.nonzero(trials.hits)
    repeats = trials.hits[at]
    subgroup, pixel, gate, here = (np.repeat(axis, repeats) for axis in at)
    tick = trials.first[subgroup, pixel, gate] + here * trials.width + trials.width // 2
    number = len(subgroup)
    zeros = np.zeros(sensor.subgroups)
    return Events(
        bounds=np.searchsorted(subgroup, np.arange(sensor.subgroups + 1)),
        pulse=np.zeros(number, np.int64),
        stamp=tick,
        count=np.ones(number, np.int64),
        winner=pixel,
        overrun=np.zeros(number, bool),
        arrival=tick.astype(np.float64),
        mapped=True,
        hits=winner_map(pixel, sensor),
        offset=np.empty((number, 0), np.uint8),
        threshold=np.ones(sensor.subgroups, np.int64),
        window=np.ones(sensor.subgroups, np.int64),
        photon_rate=zeros,
        opened=zeros,
        committed=zeros,
    )


class CountSurfaces(NamedTuple):
    """Surfaces, as `planes.find_surfaces` returns them, and what they were found in."""

    time: np.ndarray
    confidence: np.ndarray
    error: np.ndarray
    slope: np.ndarray
    light: np.ndarray  # float64[rows, cols], of `_chance_of_light`
    seen: Seen


def find_surfaces(
    counts: GateCounts,
    config: Config,
    pulse: PulseTicks,
    *,
    tolerance_ticks: float,
    threads: Threads,
    returns: int = 1,
    background: np.ndarray | None = None,
) -> CountSurfaces:
    """Find the surfaces that the pixels see; arguments as in `planes.find_surfaces`.

    background: float64[subgroups, pixels], photons per tick; None: to be estimated.
    """
    fitter = Fitter.of(pulse.sigma, config.period_ticks, counts.pulses, config.sensor.rows, threads)
    rate = first_background(counts.trials, config) if background is None else background
    seen = Seen(*counts.trials[:3], rate, counts.trials.width)
    zero = np.zeros(config.mask.shape, np.int64)
    grid = Grid(fitter.step, fitter.coarse_lights, EVEN)
    looked = count_likelihood(seen, config, pulse, grid, zero, fitter.coarse_times, threads.map)
    coarse = fitter.coarse(looked.level, looked.light)
    if background is None:
        rate = better_background(counts.trials, config, pulse, _time_of(coarse, config), rate)
        seen = seen._replace(background=rate)

    def around(prior: LightPrior | None, width: int, first: np.ndarray) -> Levels:
        return count_likelihood(
            seen,
            config,
            pulse.widened(width),
            Grid(width, fitter.lights, prior),
            by_subgroup(first, config.sensor),
            fitter.bins,
            threads.map,
        )

    middle = coarse.middle
    first = fitter.first(middle)
    levels = around(None, 1, first)
    again = partial(around, levels.prior)
    fit = fitter.with_slants(fitter.fit(levels, first), levels.level, middle, again)
    time, confidence, error, slope = fitter.surfaces(
        fit,
        coarse,
        again,
        tolerance_ticks=tolerance_ticks,
        returns=returns,
        apart_ticks=float(seen.width),
    )
    light = _chance_of_light(coarse, fitter)
    return CountSurfaces(time, confidence, error, slope, light, seen)


def _chance_of_light(coarse: Coarse, fitter: Fitter) -> np.ndarray:
    """float64[rows, cols]: probability that gates have the light of the pixel's surface at all.

    Where they have not, the likeliest time is among accidents of background. Minigroups whose gates
    miss a dark surface lower the score of those beside them, so its scale is wide.
    """
    score = seed_scores(coarse.level, coarse.light, coarse.found, fitter.blocks)
    return special.expit((score.astype(np.float64) - EVEN_SCORE) / SCORE_WIDTH)


def seen_behind(counts: GateCounts, config: Config, pulse: PulseTicks, ticks: np.ndarray) -> Seen:
    """Return the counts, and the background behind returns that are known.

    ticks: float64[rows, cols, returns], NaN = none.
    """
    time = by_subgroup(ticks[:, :, 0], config.sensor)
    rate = first_background(counts.trials, config)
    rate = better_background(counts.trials, config, pulse, time, rate)
    return Seen(*counts.trials[:3], rate, counts.trials.width)


def _time_of(coarse: Coarse, config: Config) -> np.ndarray:
    """float64[subgroups, pixels]: times of the surfaces in ticks, as the coarse grid shows them."""
    found = coarse.found
    offset = peak_offset(coarse.level, found.bin, smooth=True)
    time = found.time(coarse.step) + coarse.step * offset
    return by_subgroup(time, config.sensor)


def count_intensity(seen: Seen, config: Config, pulse: PulseTicks, ticks: np.ndarray) -> Intensity:
    """Return the light of returns, as `intensity.find_intensity` does for events.

    ticks: float64[rows, cols, returns], NaN = none.
    """
    sensor = config.sensor
    seen = _without_last_hits(seen)
    signal = np.full(ticks.shape, np.nan)
    error = np.full(ticks.shape, np.nan)
    for k in range(ticks.shape[2]):
        time = by_subgroup(ticks[:, :, k], sensor)
        share = pulse_shares(seen.first, seen.width, seen.hits.shape[3], pulse, time)
        light, doubt = fit_lights(seen, share)
        there = config.mask & ~np.isnan(time)
        signal[:, :, k] = pixel_image(np.where(there, light, np.nan), sensor)
        error[:, :, k] = pixel_image(np.where(there, doubt, np.nan), sensor)
    return Intensity(signal=signal, error=error)


def _without_last_hits(seen: Seen) -> Seen:
    """Return counts without the hits with which pixels stopped, and their pulses: a pulse in which a
    pixel stops has this hit for certain, which says nothing of its light.
    """
    subgroups, pixels, _, bins = seen.hits.shape
    of_frames = (subgroups, pixels, -1, GATES, bins)
    last = seen.hits.reshape(of_frames) == COUNT_MOST
    stopped = last.any(axis=(3, 4), keepdims=True)
    misses = seen.misses.reshape(of_frames) - (stopped & ~last)
    return seen._replace(
        hits=seen.hits - last.reshape(seen.hits.shape),
        misses=np.maximum(misses, 0.0).reshape(seen.misses.shape),
    )


def count_signs(
    counts: GateCounts,
    seen: Seen,
    config: Config,
    sigma_ticks: float,
    ticks: np.ndarray,
    sure: np.ndarray,
    light: np.ndarray,
) -> Signs:
    """Return the signs of first returns, as `belief.find_signs` does for events.

    light: as in `CountSurfaces`.
    """
    sensor = config.sensor
    time = by_subgroup(ticks, sensor)
    reach = REACH_SIGMAS * sigma_ticks
    bins = seen.hits.shape[3]
    begin = seen.first[..., None] + seen.width * np.arange(bins) - time[:, :, None, None]
    near = (begin < reach) & (begin + seen.width > -reach)  # of NaN: none
    noise = (seen.hits + seen.misses) * seen.background[:, :, None, None] * seen.width
    together = min(bins, math.ceil(2 * reach / seen.width) + 1)  # bins that may fit one depth
    others = _sliding_sums(np.where(near, 0, seen.hits), together)
    at = others.argmax(axis=2)[:, :, None]
    others_noise = _sliding_sums(np.where(near, 0.0, noise), together)
    hits = Hits(
        total=seen.hits.sum(axis=(2, 3)),
        near=np.where(near, seen.hits, 0).sum(axis=(2, 3)),
        other=np.take_along_axis(others, at, 2)[:, :, 0],
    )
    by_chance = ByChance(
        near=np.where(near, noise, 0.0).sum(axis=(2, 3)),
        other=np.take_along_axis(others_noise, at, 2)[:, :, 0],
    )
    full = hits.near * counts.pulses / np.maximum(counts.own_pulses, 1)
    lit = Lit(full, full / counts.pulses, counts.pulses)
    nothing_lost = np.zeros(sensor.subgroups)
    signs = signs_of(hits, by_chance, lit, nothing_lost, config, sigma_ticks, ticks, sure)
    has_gate = pixel_image(np.any(seen.first > NO_TICK, axis=2), sensor)
    return signs._replace(known=signs.known & has_gate, seen=light)


def _sliding_sums(values: np.ndarray, together: int) -> np.ndarray:
    """[subgroups, pixels, places]: sums of so many bins in turn of each gate."""
    sums = sliding_window_view(values, together, axis=3).sum(axis=4)
    return sums.reshape(*values.shape[:2], -1)
