# SPDX-License-Identifier: Apache-2.0
"""Estimator for real geometry: the time of every pixel from the likelihood of all events, on planes
that neighbours share.

All of this is our own choice. The steps are:

1. the likelihood of every time in coarse steps (`likelihood.py`); from it and the neighbours'
   likelihoods, the pixel's seed (`seeds.py`);
2. the likelihood in single ticks around the seeds, and how bright the pixels are in general;
3. planes through this likelihood (`patchmatch.py`);
4. if many of them slant: likelihoods for the wider pulses that slanted surfaces send back, and
   planes through these. They are taken if they make the events likelier. So a scene that has one
   distance per pixel keeps its narrow pulses.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from attrs import evolve

from ..contract.config import Config
from ..shared.threads import Threads
from . import portable
from .histograms import Events, by_subgroup, hits_away
from .likelihood import Grid, Levels, log_likelihood
from .patchmatch import Field, fit_planes, level_on, posterior, widened
from .portable import geometric_steps
from .refine import refine
from .seeds import LEAST, Blocks, find_seeds, seed_scores
from .unheard import Guess, unheard, unheard_in_light, windows_of

COARSE_SIGMAS = 1.4  # step of the first grid
COARSE_LIGHTS = geometric_steps(0.02, 40, 7).astype(np.float32)  # photons per pulse
LIGHTS = geometric_steps(0.015, 60, 12).astype(np.float32)
COARSE_HITS = 2.0  # of the faintest light in all pulses, at most: of the first grid,
HITS = 1.5  # and of the second
BINS_SIGMAS = 16.0  # width of the bins around a seed
BINS_LEAST = 16  # where a pulse is shorter than a tick
WIDTHS = (
    4  # of pulses: the laser's, and those of slanted surfaces, each twice as wide as the one before
)
SLANTED = 0.25  # doublings of the pulse's width,
SLANTED_SHARE = (
    0.05  # and share of the pixels with more of them, that make these widths worth a try
)
SPREAD_GAIN = (
    0.1  # mean log likelihood of a pixel by which slopes that spread the pulse must be likelier
)
HOT = 2.0  # background relative to the mean from which on a pixel's own value is used
ACTIVITY_HITS = 10.0  # weight of the prior, in hits
NEAR_SIGMAS = 3.0  # from a seed to stamps that may be its light
BLOCK_ROWS = 4
BEND_MIN = 0.1  # of a log likelihood at a peak, per squared bin: less has no peak
RETURN_SCORE = (
    12.0  # score of a further return with its neighbours: reached by accident once in a hundred,
)
RETURN_LEVEL = 2.0  # and without them
APART_SIGMAS = 4.0  # distance between returns, in addition to the window


def find_surfaces(
    events: Events,
    config: Config,
    sigma_ticks: float,
    pulses: int,
    *,
    tolerance_ticks: float,
    threads: Threads,
    returns: int = 1,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Find the surfaces that the pixels see. pulses: number of pulses in which the events came.

    Returns (time, confidence, error), [rows, cols, returns], and slope, [rows, cols, 2], down and
    right; in ticks. confidence: probability that the first return is within `tolerance_ticks`, and
    that the others are not accidental. The number of threads does not change the result.
    """
    sensor = config.sensor

    def blocks(function: Callable[[int, int], None]) -> None:
        begins = range(0, sensor.rows, BLOCK_ROWS)
        threads.map(lambda begin: function(begin, min(sensor.rows, begin + BLOCK_ROWS)), begins)

    step = max(1, round(COARSE_SIGMAS * sigma_ticks))
    coarse_lights = down_to(COARSE_LIGHTS, COARSE_HITS / pulses)
    fine_lights = down_to(LIGHTS, HITS / pulses)
    even = np.full(len(coarse_lights), -math.log(len(coarse_lights)), np.float32)
    coarse = Grid(step, coarse_lights, even)
    windows = windows_of(events, config, pulses, sigma_ticks, threads.map)
    never = unheard(windows, config, sigma_ticks, threads.map)
    everywhere = np.zeros((sensor.subgroups, sensor.pixels), np.int64)
    level, lights, _ = log_likelihood(
        events,
        config,
        sigma_ticks,
        pulses,
        coarse,
        never,
        everywhere,
        -(-config.period_ticks // step),
        spread=threads.map,
    )
    found = find_seeds(level, lights, blocks)
    chosen = np.maximum(found.bin, 0)[:, :, None]
    light = np.take_along_axis(lights, chosen, 2)[:, :, 0]
    seed = found.time(step)
    guess = Guess(
        time=by_subgroup(seed + step * _peak_offset(level, found.bin), sensor),
        light=coarse_lights[by_subgroup(light, sensor)].astype(np.float64),
    )
    never = unheard_in_light(windows, never, guess, config, pulses, sigma_ticks, threads.map)
    activity = _activity(events, guess.time, sigma_ticks)
    bins = max(BINS_LEAST, round(BINS_SIGMAS * sigma_ticks))
    middle = np.nan_to_num(seed)
    first = _first(middle, 1, bins)

    told = evolve(events, offset=events.offset[:, :0])

    def around(width: int, first: np.ndarray, prior: np.ndarray | None = None) -> Levels:
        return log_likelihood(
            told,
            config,
            width * sigma_ticks,
            pulses,
            Grid(width, fine_lights, prior),
            never,
            by_subgroup(first, sensor),
            bins,
            activity=activity,
            guess=guess,
            spread=threads.map,
        )

    levels = around(1, first)
    again = partial(around, prior=levels.prior)
    field = Field.of([levels.level], [first], sigma_ticks, blocks)
    planes = fit_planes(field, blocks)
    if events.offset.shape[1]:  # what an offset says depends on the other pixels' surfaces
        sharper = refine(field, planes, blocks).planes.time
        inside = np.clip(np.floor(sharper) - first, 0, bins - 1).astype(np.int64)[:, :, None]
        own_light = fine_lights[np.take_along_axis(levels.light, inside, 2)[:, :, 0]]
        guess = Guess(
            time=np.where(np.isnan(guess.time), np.nan, by_subgroup(sharper, sensor)),
            light=by_subgroup(own_light, sensor).astype(np.float64),
        )
        told = events
        levels = around(1, first, levels.prior)
        field = Field.of([levels.level], [first], sigma_ticks, blocks)
        planes = fit_planes(field, blocks)
    slanted = widened(planes.down, planes.right, sigma_ticks) > 4**SLANTED
    if np.mean(slanted) > SLANTED_SHARE:
        wide = _in_perspective(levels.level, middle, again, sigma_ticks, blocks)
        in_space = fit_planes(wide, blocks)
        if np.mean(level_on(wide, in_space) - level_on(field, planes)) > SPREAD_GAIN:
            field, planes = wide, in_space
    planes, fine_error = refine(field, planes, blocks)
    confidence, error = posterior(field, planes, tolerance_ticks, blocks)
    error = np.where(np.isnan(fine_error), error, fine_error)
    seen = found.bin >= 0
    time = np.where(seen, np.clip(planes.time, 0, config.period_ticks), np.nan)
    confidence = np.where(seen, confidence * found.chance(bins // 2 // step), 0.0)
    error = np.where(seen, error, np.nan)
    slope = np.where(seen[:, :, None], np.stack([planes.down, planes.right], axis=2), np.nan)
    surfaces = _Surfaces(time[:, :, None], confidence[:, :, None], error[:, :, None])
    if returns > 1:
        search = _Search(
            level=level,
            lights=lights,
            step=step,
            apart=events.window.max() + APART_SIGMAS * sigma_ticks,
            around=partial(again, 1),
            sigma_ticks=sigma_ticks,
            bins=bins,
            blocks=blocks,
        )
        further = _further(search, planes.time, returns - 1)
        surfaces = _Surfaces(
            time=np.concatenate([surfaces.time, further.time], axis=2),
            confidence=np.concatenate([surfaces.confidence, further.confidence], axis=2),
            error=np.concatenate([surfaces.error, further.error], axis=2),
        )
    return surfaces.time, surfaces.confidence, surfaces.error, slope


class _Surfaces(NamedTuple):
    """What is found of some returns, float64[rows, cols, returns]."""

    time: np.ndarray  # ticks
    confidence: np.ndarray
    error: np.ndarray  # ticks


def down_to(lights: np.ndarray, faintest: float) -> np.ndarray:
    """Return geometric steps of lights, float32, continued downwards until one is at most
    `faintest`.
    """
    ratio = lights[1] / lights[0]
    more = max(0, math.ceil(math.log(lights[0] / faintest) / math.log(ratio)))
    fainter = [float(lights[0]) * float(ratio) ** k for k in range(-more, 0)]
    return np.concatenate([fainter, lights]).astype(np.float32)


def _first(middle: np.ndarray, width: int, bins: int) -> np.ndarray:
    """int64[rows, cols]: the first of `bins` around a time in ticks, as the number of bins of
    `width` ticks before it.
    """
    return np.floor(middle / width).astype(np.int64) - bins // 2


def _peak_offset(level: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """float64[rows, cols]: from the middle of the chosen bin to the peak of the parabola through it
    and the bins beside it, in bins; at most half a bin.

    level: float32[rows, cols, bins]. chosen: int64[rows, cols].
    """
    inner = np.clip(chosen, 1, level.shape[2] - 2)[:, :, None]
    before = np.take_along_axis(level, inner - 1, 2)[:, :, 0].astype(np.float64)
    here = np.take_along_axis(level, inner, 2)[:, :, 0].astype(np.float64)
    after = np.take_along_axis(level, inner + 1, 2)[:, :, 0].astype(np.float64)
    bend = np.maximum(2 * here - before - after, BEND_MIN)
    return np.clip((after - before) / 2 / bend, -0.5, 0.5)


def _in_perspective(
    level: np.ndarray,
    middle: np.ndarray,
    around: Callable[[int, np.ndarray], Levels],
    sigma_ticks: float,
    blocks: Blocks,
) -> Field:
    """Return the field of all widths of pulses.

    level: of the laser's; middle: float64[rows, cols], ticks.
    """
    bins = level.shape[2]
    levels = [level]
    first_ticks = [_first(middle, 1, bins)]
    for k in range(1, WIDTHS):
        width = 2**k
        first = _first(middle, width, bins)
        levels.append(around(width, first).level)
        first_ticks.append(width * first)
    return Field.of(levels, first_ticks, sigma_ticks, blocks)


def _activity(events: Events, seed: np.ndarray, sigma_ticks: float) -> np.ndarray:
    """float64[subgroups, pixels]: background of a pixel over the mean, from its hits away from its
    seed; 1 unless hot.
    """
    hits = hits_away(events.stamp, events.hits, events.bounds, seed, NEAR_SIGMAS * sigma_ticks)
    ratio = (hits + ACTIVITY_HITS) / (hits.mean(axis=1, keepdims=True) + ACTIVITY_HITS)
    return np.where(ratio > HOT, ratio, 1.0)


class _Search(NamedTuple):
    """What the search for further returns needs."""

    level: np.ndarray  # float32[rows, cols, times], log likelihood ratio on the coarse grid
    lights: np.ndarray  # uint8[rows, cols, times], likeliest light
    step: int  # ticks of that grid
    apart: float  # ticks between returns
    around: Callable[[np.ndarray], Levels]  # likelihoods in single ticks, from given first ones on
    sigma_ticks: float  # of the laser's pulse
    bins: int  # number of single ticks around a seed
    blocks: Blocks


def _further(search: _Search, time: np.ndarray, most: int) -> _Surfaces:
    """Return at most so many returns after the first, apart from each other. time: of the first."""
    step = search.step
    blocks = search.blocks
    rows, cols, times = search.level.shape
    found = _Surfaces(
        time=np.full((rows, cols, most), np.nan),
        confidence=np.zeros((rows, cols, most)),
        error=np.full((rows, cols, most), np.nan),
    )
    middle = (np.arange(times) + 0.5) * step
    left = search.level.copy()
    taken = time
    for k in range(most):
        left[np.abs(middle - taken[:, :, None]) <= search.apart] = LEAST
        seeds = find_seeds(left, search.lights, blocks)
        score = seed_scores(left, search.lights, seeds, blocks)
        own = np.take_along_axis(left, np.maximum(seeds.bin, 0)[:, :, None], 2)[:, :, 0]
        there = (seeds.bin >= 0) & (score > RETURN_SCORE) & (own > RETURN_LEVEL)
        if not there.any():
            break
        first = _first(np.where(there, seeds.time(step), 0.0), 1, search.bins)
        field = Field.of([search.around(first).level], [first], search.sigma_ticks, blocks)
        planes = fit_planes(field, blocks)
        _, error = posterior(field, planes, 0.0, blocks)
        accident = np.minimum(1, times * portable.exp(-score))
        taken = np.where(there, np.clip(planes.time, 0, times * step), np.nan)
        found.time[:, :, k] = taken
        found.error[:, :, k] = np.where(there, error, np.nan)
        found.confidence[:, :, k] = np.where(there, 1 - accident, 0.0)
    return found
