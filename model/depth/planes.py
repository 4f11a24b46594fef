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
from .histograms import Events, by_subgroup, hits_away, pixel_image
from .intensity import find_intensity
from .lights import measured_prior
from .likelihood import Grid, Levels, log_likelihood
from .patchmatch import Field, fit_planes, level_on, posterior, widened
from .portable import geometric_steps
from .pulse_ticks import PulseTicks
from .refine import refine
from .seeds import LEAST, Blocks, Seeds, find_seeds, seed_scores
from .unheard import Guess, Spread, Unheard, unheard, unheard_in_light, windows_of

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
    pulse: PulseTicks,
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
    sigma_ticks = pulse.sigma

    def blocks(function: Callable[[int, int], None]) -> None:
        begins = range(0, sensor.rows, BLOCK_ROWS)
        threads.map(lambda begin: function(begin, min(sensor.rows, begin + BLOCK_ROWS)), begins)

    frame = _Frame(events, config, pulse, pulses, blocks, threads.map)
    coarse = _look_coarsely(frame)
    found = coarse.found
    step = coarse.step
    bins = max(BINS_LEAST, round(BINS_SIGMAS * sigma_ticks))
    middle = np.nan_to_num(found.time(step))
    first = _first(middle, 1, bins)
    near = _Near(
        told=evolve(events, offset=events.offset[:, :0]),
        guess=coarse.guess,
        never=coarse.never,
        activity=_activity(events, coarse.guess.time, sigma_ticks),
        bins=bins,
    )
    prior = None
    if not events.mapped:
        guess, prior = _counted_light(frame, coarse.guess, threads)
        near = near._replace(guess=guess)
    levels = _around(frame, near, prior, 1, first)
    prior = levels.prior
    field = Field.of([levels.level], [first], sigma_ticks, blocks)
    planes = fit_planes(field, blocks)
    if events.offset.shape[1]:  # what an offset says depends on the other pixels' surfaces
        sharper = refine(field, planes, blocks).planes.time
        near = near._replace(
            told=events, guess=_sharper_guess(frame, near.guess, levels, first, sharper)
        )
        levels = _around(frame, near, prior, 1, first)
        field = Field.of([levels.level], [first], sigma_ticks, blocks)
        planes = fit_planes(field, blocks)
    again = partial(_around, frame, near, prior)
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
            level=coarse.level,
            lights=coarse.lights,
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


class _Frame(NamedTuple):
    """What is known of a frame before any surface is."""

    events: Events
    config: Config
    pulse: PulseTicks  # of the laser
    pulses: int  # in which the events came
    blocks: Blocks
    spread: Spread  # over subgroups


class _Coarse(NamedTuple):
    """What is known after the first grid, [rows, cols, ...]."""

    step: int  # ticks of that grid
    level: np.ndarray  # float32[rows, cols, times], log likelihood ratio
    lights: np.ndarray  # uint8[rows, cols, times], likeliest light
    found: Seeds
    guess: Guess  # of the surfaces
    never: Unheard  # in the light of the guess


class _Near(NamedTuple):
    """What the likelihoods in single ticks rest on."""

    told: Events  # without offsets, as long as the surfaces are not known well enough for them
    guess: Guess  # of the surfaces
    never: Unheard
    activity: np.ndarray  # float64[subgroups, pixels], of `_activity`
    bins: int  # number of ticks around a seed


def _look_coarsely(frame: _Frame) -> _Coarse:
    """Find the seeds of the pixels, on a grid over the whole period."""
    events = frame.events
    config = frame.config
    pulse = frame.pulse
    sensor = config.sensor
    step = max(1, round(COARSE_SIGMAS * pulse.sigma))
    possible = down_to(COARSE_LIGHTS, COARSE_HITS / frame.pulses)
    even = np.full(len(possible), -math.log(len(possible)), np.float32)
    windows = windows_of(events, config, frame.pulses, pulse, frame.spread)
    rough = unheard(windows, config, pulse, frame.spread)
    level, lights, _ = log_likelihood(
        events,
        config,
        pulse,
        frame.pulses,
        Grid(step, possible, even),
        rough,
        np.zeros((sensor.subgroups, sensor.pixels), np.int64),
        -(-config.period_ticks // step),
        spread=frame.spread,
    )
    found = find_seeds(level, lights, frame.blocks)
    chosen = np.maximum(found.bin, 0)[:, :, None]
    light = np.take_along_axis(lights, chosen, 2)[:, :, 0]
    time = found.time(step) + step * _peak_offset(level, found.bin)
    guess = Guess(
        time=by_subgroup(time, sensor),
        light=possible[by_subgroup(light, sensor)].astype(np.float64),
    )
    never = unheard_in_light(windows, rough, guess, config, frame.pulses, pulse, frame.spread)
    return _Coarse(step, level, lights, found, guess, never)


def _counted_light(frame: _Frame, guess: Guess, threads: Threads) -> tuple[Guess, np.ndarray]:
    """Return the guess with the lights that the events' numbers of hits ask for, and the prior of
    these lights on the grid in single ticks.

    It is for events without maps: a light that is too faint fits their winners as well as a time
    that is too early does.
    """
    config = frame.config
    time = pixel_image(guess.time, config.sensor)[:, :, None]
    counted = find_intensity(frame.events, config, frame.pulse, frame.pulses, time, threads)
    signal = counted.signal[:, :, 0]
    prior = measured_prior(signal, counted.error[:, :, 0], _fine_lights(frame))
    light = by_subgroup(np.nan_to_num(signal), config.sensor)
    return guess._replace(light=light), prior


def _around(
    frame: _Frame, near: _Near, prior: np.ndarray | None, width: int, first: np.ndarray
) -> Levels:
    """Return the likelihoods for pulses so many times as wide as the laser's, in steps of as many
    ticks.

    prior: of the lights; None: to be learned. first: int64[rows, cols], number of the first step.
    """
    return log_likelihood(
        near.told,
        frame.config,
        frame.pulse.widened(width),
        frame.pulses,
        Grid(width, _fine_lights(frame), prior),
        near.never,
        by_subgroup(first, frame.config.sensor),
        near.bins,
        activity=near.activity,
        guess=near.guess,
        spread=frame.spread,
    )


def _fine_lights(frame: _Frame) -> np.ndarray:
    """Return the lights of the grid in single ticks, float32."""
    return down_to(LIGHTS, HITS / frame.pulses)


def _sharper_guess(
    frame: _Frame, guess: Guess, levels: Levels, first: np.ndarray, time: np.ndarray
) -> Guess:
    """Return a guess with better times, and the likeliest lights there.

    first: int64[rows, cols], first tick of the levels. time: float64[rows, cols], ticks.
    """
    sensor = frame.config.sensor
    last = levels.level.shape[2] - 1
    inside = np.clip(np.floor(time) - first, 0, last).astype(np.int64)[:, :, None]
    light = _fine_lights(frame)[np.take_along_axis(levels.light, inside, 2)[:, :, 0]]
    return Guess(
        time=np.where(np.isnan(guess.time), np.nan, by_subgroup(time, sensor)),
        light=by_subgroup(light, sensor).astype(np.float64),
    )


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
        for of_row, taken_in_row in zip(left, taken, strict=True):  # little memory
            of_row[np.abs(middle - taken_in_row[:, None]) <= search.apart] = LEAST
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
