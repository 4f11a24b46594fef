# SPDX-License-Identifier: Apache-2.0
"""The estimator of planes, for the format `counts`: the steps of `surfaces.py` on the likelihood of
counts in gates (`count_likelihood.py`).

All of this is our own choice. Nothing but the counts is known: also the background comes from them
(`count_light.py`).
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from ..contract.config import Config
from ..contract.counts import GATE_CYCLES, GATES, NO_GATE
from ..contract.parameters import QUARTERS
from ..contract.pixels import pixel_table
from ..shared.errors import InputError, check_integer
from ..shared.threads import Threads
from .clusters import open_share
from .count_light import Trials, better_background, first_background, fit_lights, pulse_shares
from .count_likelihood import NO_TICK, Seen, count_likelihood
from .histograms import by_subgroup, pixel_image
from .intensity import Intensity
from .likelihood import DEAD_S, Grid, Levels
from .pulse_ticks import PulseTicks
from .surfaces import Coarse, Fitter, peak_offset
from .unheard import Guess

ARRAYS = ("gate_cycle", "gate_hits", "count_pulses")  # of a result


class GateCounts(NamedTuple):
    """Counts of one frame or of several, which stand behind each other as further gates."""

    trials: Trials
    pulses: int  # in which pixels counted, of all frames


def gate_counts(
    arrays: dict[str, np.ndarray], config: Config, frame: int | None = None
) -> GateCounts:
    """Return the counts of a result (`result.py`) in one frame, or in all frames (None).

    Raises `InputError` if the result has no such frame, or no counts.
    """
    missing = [name for name in ARRAYS if name not in arrays]
    if missing:
        raise InputError(
            f"arrays: {missing[0]} is missing, which a result of the format counts has",
            field="arrays",
        )
    frames = len(arrays["gate_cycle"])
    chosen = range(frames)
    if frame is not None:
        check_integer("frame", frame, 0, frames - 1)
        chosen = range(frame, frame + 1)
    of_frames = [_trials_of(arrays, config, k) for k in chosen]
    first, hits, misses = (np.concatenate(part, axis=2) for part in zip(*of_frames, strict=True))
    counting = config.pulses - 2 * config.search_pulses
    trials = Trials(first, hits, misses, config.sensor.quarter_ticks)
    return GateCounts(trials, len(of_frames) * counting)


def _trials_of(
    arrays: dict[str, np.ndarray], config: Config, frame: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return first ticks, hits and misses of a frame, as in `Trials`."""
    sensor = config.sensor
    minigroup = pixel_table(sensor).minigroup
    cycle = arrays["gate_cycle"][frame].astype(np.int64)[:, minigroup]
    first = np.where(cycle == NO_GATE, NO_TICK, cycle * sensor.phases)
    hits = arrays["gate_hits"][frame].astype(np.int64)
    pulses = arrays["count_pulses"][frame].astype(np.float64)
    quarter_cycle = np.minimum(
        cycle[..., None] + np.arange(GATE_CYCLES * QUARTERS) // QUARTERS, config.period - 1
    )
    tried = np.empty(hits.shape)
    search = 2 * config.search_pulses
    for s in range(sensor.subgroups):
        is_open = open_share(config, s, range(search, config.pulses))
        tried[s] = pulses[s][:, None, None] * is_open[quarter_cycle[s]]
    tried = np.maximum(tried - _dead(hits, first, config), hits)
    tried[first == NO_TICK] = 0
    return first, hits, tried - hits


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


class CountSurfaces(NamedTuple):
    """Surfaces, as `planes.find_surfaces` returns them, and what they were found in."""

    time: np.ndarray
    confidence: np.ndarray
    error: np.ndarray
    slope: np.ndarray
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
    grid = Grid(fitter.step, fitter.coarse_lights, fitter.even_prior)
    looked = count_likelihood(seen, config, pulse, grid, zero, fitter.coarse_times, threads.map)
    coarse = fitter.coarse(looked.level, looked.light)
    if background is None:
        guess = _guess(coarse, fitter, config)
        rate = better_background(counts.trials, config, pulse, guess, rate)
        seen = seen._replace(background=rate)

    def around(prior: np.ndarray | None, width: int, first: np.ndarray) -> Levels:
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
    found = fitter.surfaces(
        fit,
        coarse,
        again,
        tolerance_ticks=tolerance_ticks,
        returns=returns,
        apart_ticks=float(seen.width),
    )
    return CountSurfaces(*found, seen)


def _guess(coarse: Coarse, fitter: Fitter, config: Config) -> Guess:
    """Return the surfaces as far as the coarse grid shows them."""
    found = coarse.found
    time = found.time(coarse.step) + coarse.step * peak_offset(coarse.level, found.bin)
    chosen = np.maximum(found.bin, 0)[:, :, None]
    light = fitter.coarse_lights[np.take_along_axis(coarse.light, chosen, 2)[:, :, 0]]
    sensor = config.sensor
    return Guess(by_subgroup(time, sensor), by_subgroup(light.astype(np.float64), sensor))


def count_intensity(seen: Seen, config: Config, pulse: PulseTicks, ticks: np.ndarray) -> Intensity:
    """Return the light of returns, as `intensity.find_intensity` does for events.

    ticks: float64[rows, cols, returns], NaN = none.
    """
    sensor = config.sensor
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
