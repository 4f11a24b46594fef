# SPDX-License-Identifier: Apache-2.0
"""Estimator for real geometry: the time of every pixel from the likelihood of all events, on planes that neighbours share.

All of this is our own choice. The steps are:

1. the likelihood of every time in coarse steps (`likelihood.py`); from it and the neighbours' likelihoods, the pixel's
   seed (`seeds.py`);
2. the likelihood in single ticks around the seeds, and how bright the pixels are in general;
3. planes through this likelihood (`patchmatch.py`);
4. if many of them slant: likelihoods for the wider pulses that slanted surfaces send back, and planes through these.
   They are taken if they make the events likelier. So a scene that has one distance per pixel keeps its narrow pulses.
"""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from ..contract.config import Config
from ..shared.threads import Threads
from . import portable
from .histograms import Events, by_subgroup, hits_away
from .likelihood import Grid, Guess, Levels, log_likelihood
from .patchmatch import Field, fit_planes, level_on, posterior, widened
from .portable import geometric_steps
from .seeds import LEAST, Blocks, find_seeds, seed_scores
from .unheard import unheard

COARSE_SIGMAS = 1.4  # step of the first grid
COARSE_LIGHTS = geometric_steps(0.02, 40, 7).astype(np.float32)  # photons per pulse
LIGHTS = geometric_steps(0.015, 60, 12).astype(np.float32)
COARSE_HITS, HITS = 2.0, 1.5  # of the faintest light in all pulses, at most
BINS_SIGMAS = 16.0  # width of the bins around a seed
WIDTHS = 4  # of pulses: the laser's, and those of slanted surfaces, each twice as wide as the one before
SLANTED = 0.25  # doublings of the pulse's width,
SLANTED_SHARE = 0.05  # and share of the pixels with more of them, that make these widths worth a try
SPREAD_GAIN = 0.1  # mean log likelihood of a pixel by which slopes that spread the pulse must be likelier
HOT = 2.0  # background relative to the mean from which on a pixel's own value is used
ACTIVITY_HITS = 10.0  # weight of the prior, in hits
NEAR_SIGMAS = 3.0  # from a seed to stamps that may be its light
BLOCK_ROWS = 4
RETURN_SCORE = 12.0  # score of a further return with its neighbours: reached by accident once in a hundred,
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

    Returns (time, confidence, error), [rows, cols, returns], and slope, [rows, cols, 2], down and right; in ticks.
    confidence: probability that the first return is within `tolerance_ticks`, and that the others are not accidental.
    The number of threads does not change the result.
    """
    sensor = config.sensor

    def blocks(function: Callable[[int, int], None]) -> None:
        begins = range(0, sensor.rows, BLOCK_ROWS)
        threads.map(lambda begin: function(begin, min(sensor.rows, begin + BLOCK_ROWS)), begins)

    step = max(1, round(COARSE_SIGMAS * sigma_ticks))
    coarse_lights, fine_lights = down_to(COARSE_LIGHTS, COARSE_HITS / pulses), down_to(LIGHTS, HITS / pulses)
    coarse = Grid(step, coarse_lights, np.full(len(coarse_lights), -math.log(len(coarse_lights)), np.float32))
    never = unheard(events, config, pulses, sigma_ticks, threads.map)
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
    guess = Guess(by_subgroup(seed, sensor), coarse_lights[by_subgroup(light, sensor)].astype(np.float64))
    activity = _activity(events, guess.time, sigma_ticks)
    bins = round(BINS_SIGMAS * sigma_ticks)
    middle = np.nan_to_num(seed)
    first = _first(middle, 1, bins)

    def around(width: int, first: np.ndarray, prior: np.ndarray | None = None) -> Levels:
        return log_likelihood(
            events, config, width * sigma_ticks, pulses, Grid(width, fine_lights, prior), never, by_subgroup(first, sensor), bins,
            activity=activity, guess=guess, spread=threads.map,
        )  # fmt: skip

    levels = around(1, first)
    again = partial(around, prior=levels.prior)
    field = Field.of([levels.level], [first], sigma_ticks, blocks)
    planes = fit_planes(field, blocks)
    slanted = widened(planes.down, planes.right, sigma_ticks) > 4**SLANTED
    if np.mean(slanted) > SLANTED_SHARE:
        wide = _in_perspective(levels.level, middle, again, sigma_ticks, blocks)
        in_space = fit_planes(wide, blocks)
        if np.mean(level_on(wide, in_space) - level_on(field, planes)) > SPREAD_GAIN:
            field, planes = wide, in_space
    confidence, error = posterior(field, planes, tolerance_ticks, blocks)
    time = np.clip(planes.time, 0, config.period_ticks)[:, :, None]
    seen = (found.bin >= 0)[:, :, None]
    parts = [
        np.where(seen, part, nothing)
        for part, nothing in (
            (time, np.nan),
            ((confidence * found.chance(bins // 2 // step))[:, :, None], 0.0),
            (error[:, :, None], np.nan),
        )
    ]
    if returns > 1:
        apart = events.window.max() + APART_SIGMAS * sigma_ticks
        narrow = partial(again, 1)
        further = _further(level, lights, step, planes.time, apart, narrow, sigma_ticks, bins, returns - 1, blocks)
        parts = [np.concatenate(pair, axis=2) for pair in zip(parts, further, strict=True)]
    slope = np.where(seen, np.stack([planes.down, planes.right], axis=2), np.nan)
    time_of, sure, error_of = parts
    return time_of, sure, error_of, slope


def down_to(lights: np.ndarray, faintest: float) -> np.ndarray:
    """Return geometric steps of lights, float32, continued downwards until one is at most `faintest`."""
    ratio = lights[1] / lights[0]
    more = max(0, math.ceil(math.log(lights[0] / faintest) / math.log(ratio)))
    return np.concatenate([[float(lights[0]) * float(ratio) ** k for k in range(-more, 0)], lights]).astype(np.float32)


def _first(middle: np.ndarray, width: int, bins: int) -> np.ndarray:
    """int64[rows, cols]: the first of `bins` around a time in ticks, as the number of bins of `width` ticks before it."""
    return np.floor(middle / width).astype(np.int64) - bins // 2


def _in_perspective(
    level: np.ndarray,
    middle: np.ndarray,
    around: Callable[[int, np.ndarray], Levels],
    sigma_ticks: float,
    blocks: Blocks,
) -> Field:
    """Return the field of all widths of pulses. level: of the laser's; middle: float64[rows, cols], ticks."""
    bins = level.shape[2]
    widths = [2**k for k in range(WIDTHS)]
    firsts = [_first(middle, width, bins) for width in widths]
    wider = [around(width, first).level for width, first in zip(widths[1:], firsts[1:], strict=True)]
    return Field.of(
        [level, *wider], [width * first for width, first in zip(widths, firsts, strict=True)], sigma_ticks, blocks
    )


def _activity(events: Events, seed: np.ndarray, sigma_ticks: float) -> np.ndarray:
    """float64[subgroups, pixels]: background of a pixel divided by the mean of all, from its hits
    away from its seed. It is 1 except for hot pixels.
    """
    hits = hits_away(events.stamp, events.hits, events.bounds, seed, NEAR_SIGMAS * sigma_ticks)
    ratio = (hits + ACTIVITY_HITS) / (hits.mean(axis=1, keepdims=True) + ACTIVITY_HITS)
    return np.where(ratio > HOT, ratio, 1.0)


def _further(
    level: np.ndarray,
    lights: np.ndarray,
    step: int,
    time: np.ndarray,
    apart: float,
    around: Callable[[np.ndarray], Levels],
    sigma_ticks: float,
    bins: int,
    most: int,
    blocks: Blocks,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (time, confidence, error) [rows, cols, most] of the returns after the first, apart from each other."""
    rows, cols, times = level.shape
    found = np.full((rows, cols, most), np.nan)
    confidence, error = np.zeros(found.shape), np.full(found.shape, np.nan)
    middle = (np.arange(times) + 0.5) * step
    left, taken = level.copy(), time
    for k in range(most):
        left[np.abs(middle - taken[:, :, None]) <= apart] = LEAST
        seeds = find_seeds(left, lights, blocks)
        score = seed_scores(left, lights, seeds, blocks)
        own = np.take_along_axis(left, np.maximum(seeds.bin, 0)[:, :, None], 2)[:, :, 0]
        there = (seeds.bin >= 0) & (score > RETURN_SCORE) & (own > RETURN_LEVEL)
        if not there.any():
            break
        first = _first(np.where(there, seeds.time(step), 0.0), 1, bins)
        field = Field.of([around(first).level], [first], sigma_ticks, blocks)
        planes = fit_planes(field, blocks)
        found[:, :, k] = taken = np.where(there, np.clip(planes.time, 0, times * step), np.nan)
        error[:, :, k] = np.where(there, posterior(field, planes, 0.0, blocks)[1], np.nan)
        confidence[:, :, k] = np.where(there, 1 - np.minimum(1, times * portable.exp(-score)), 0.0)
    return found, confidence, error
