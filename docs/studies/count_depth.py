# SPDX-License-Identifier: Apache-2.0
"""Depth from counts: the estimator of planes, with the likelihood of counts in place of that of
events.

A pixel with a surface at time t and `light` photons per pulse is hit in a bin, in a pulse in which
it can be, with the chance

    1 - exp(-light * S) + background,

where S is the share of the pulse in the bin's ticks. It can be hit if it has not been hit before in
the gate: a SPAD is dead for about as long as a gate.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from coincid.model.contract.config import Config
from coincid.model.contract.pixels import pixel_table
from coincid.model.depth.evidence import WAYS, Pixels
from coincid.model.depth.histograms import by_subgroup
from coincid.model.depth.lights import add_light_chances, learned_prior, mean_over_lights
from coincid.model.depth.likelihood import Levels
from coincid.model.depth.patchmatch import Field, fit_planes, level_on, widened
from coincid.model.depth.planes import (
    BINS_LEAST,
    BINS_SIGMAS,
    BLOCK_ROWS,
    COARSE_LIGHTS,
    COARSE_SIGMAS,
    LIGHTS,
    SLANTED,
    SLANTED_SHARE,
    SPREAD_GAIN,
    _first,
    _in_perspective,
    down_to,
)
from coincid.model.depth.pulse_ticks import PulseTicks, pulse_ticks
from coincid.model.depth.refine import refine
from coincid.model.depth.seeds import find_seeds

from .count_kernels import MISSED, Counts, Law, Seen, add_up

COARSE_HITS = 2.0  # of the faintest light in all pulses, at most: of the first grid,
HITS = 1.5  # and of the second
LEAST_RATE = 1e-7  # photons per tick and pixel: some background is everywhere


def seen_of(counts: Counts, config: Config, background: np.ndarray) -> Seen:
    """Return what the likelihood reads. background: float64[subgroups, pixels], per tick."""
    sensor = config.sensor
    start = counts.start[:, pixel_table(sensor).minigroup]
    n = sensor.array_pixels
    gates, bins = counts.hits.shape[2:]
    hits = counts.hits.reshape(n, gates, bins)
    left = counts.pulses.reshape(n, 1, 1) - np.cumsum(hits, axis=2)
    return Seen(
        first=(start * sensor.quarter_ticks).reshape(n, gates),
        hits=hits,
        misses=np.maximum(left, 0).astype(np.float64),
        background=np.maximum(background, LEAST_RATE).reshape(n),
    )


def law_of(pulse: PulseTicks, width: int, fraction: float) -> Law:
    """Return the law for times with this fraction of a tick, and bins of `width` ticks."""
    reach = pulse.reach + width + 1
    begin = np.arange(-reach, reach + 1) - fraction
    return Law(reach, pulse.share_before(begin), width)


class Counted(NamedTuple):
    """A frame of counts, and how the pulse looks."""

    seen: Seen
    config: Config
    pulse: PulseTicks
    pulses: int


def levels_of(
    counted: Counted,
    lights: np.ndarray,
    prior: np.ndarray | None,
    first: np.ndarray,
    bins: int,
    step: int,
    width: int,
) -> Levels:
    """Return the likelihood of each pixel's times, as `likelihood.log_likelihood` does for events.

    first: int64[rows, cols]. step: ticks. width: of the pulse, over the laser's. prior: None: to be
    learned.
    """
    sensor = counted.config.sensor
    number = len(lights)
    n = sensor.array_pixels
    fraction = 0.5 if step % 2 else 0.0
    law = law_of(counted.pulse.widened(width), sensor.quarter_ticks, fraction)
    total = np.zeros((n, bins * number), np.float32)
    own_first = by_subgroup(first, sensor).reshape(n)
    add_up(counted.seen, law, lights.astype(np.float64), own_first, step, total)
    pixels = Pixels(  # of one group, each with the same times
        minigroup=np.zeros(n, np.int64),
        mask=np.ones(n, bool),
        activity=np.ones(n),
        first=np.zeros(n, np.int64),
        total=total,
        touched=np.ones((n, bins), np.bool_),
        counted=np.full(n, -1),
        number=np.empty((WAYS, n), np.int64),
        hit=np.empty(n, np.int64),
    )
    common = np.zeros(bins * number, np.float32)
    if prior is None:
        chance = np.zeros((n, number), np.float32)
        known = np.max(total, axis=1) > MISSED
        add_light_chances(common, pixels, known, chance)
        prior = learned_prior(chance[known])
    ratio = np.float32(math.log(lights[-1] / lights[0]) / max(1, number - 1))
    level = np.empty((n, bins), np.float32)
    light = np.empty((n, bins), np.uint8)
    place = by_subgroup(np.arange(n).reshape(sensor.rows, sensor.cols), sensor).reshape(n)
    mean_over_lights(common, pixels, prior, ratio, 0, place, level, light)
    shape = (sensor.rows, sensor.cols, bins)
    return Levels(level.reshape(shape), light.reshape(shape), prior)


class Surfaces(NamedTuple):
    """What the pixels see, float64[rows, cols]."""

    time: np.ndarray  # ticks; NaN: nothing
    light: np.ndarray  # photons per pulse


def surfaces_of(counted: Counted) -> Surfaces:
    """Return the surfaces, as `planes.find_surfaces` finds them."""
    config = counted.config
    sensor = config.sensor
    sigma_ticks = counted.pulse.sigma

    def blocks(function: Callable[[int, int], None]) -> None:
        for begin in range(0, sensor.rows, BLOCK_ROWS):
            function(begin, min(sensor.rows, begin + BLOCK_ROWS))

    step = max(1, round(COARSE_SIGMAS * sigma_ticks))
    coarse_lights = down_to(COARSE_LIGHTS, COARSE_HITS / counted.pulses)
    even = np.full(len(coarse_lights), -math.log(len(coarse_lights)), np.float32)
    zero = np.zeros((sensor.rows, sensor.cols), np.int64)
    coarse = levels_of(counted, coarse_lights, even, zero, -(-config.period_ticks // step), step, 1)
    found = find_seeds(coarse.level, coarse.light, blocks)
    middle = np.nan_to_num(found.time(step))
    bins = max(BINS_LEAST, round(BINS_SIGMAS * sigma_ticks))
    lights = down_to(LIGHTS, HITS / counted.pulses)
    first = _first(middle, 1, bins)
    levels = levels_of(counted, lights, None, first, bins, 1, 1)

    def around(width: int, first: np.ndarray) -> Levels:
        return levels_of(counted, lights, levels.prior, first, bins, width, width)

    field = Field.of([levels.level], [first], sigma_ticks, blocks)
    planes = fit_planes(field, blocks)
    slanted = widened(planes.down, planes.right, sigma_ticks) > 4**SLANTED
    if np.mean(slanted) > SLANTED_SHARE:
        wide = _in_perspective(levels.level, middle, around, sigma_ticks, blocks)
        in_space = fit_planes(wide, blocks)
        if np.mean(level_on(wide, in_space) - level_on(field, planes)) > SPREAD_GAIN:
            field, planes = wide, in_space
    planes = refine(field, planes, blocks).planes
    inside = np.clip(np.floor(planes.time) - first, 0, bins - 1).astype(np.int64)[:, :, None]
    light = lights[np.take_along_axis(levels.light, inside, 2)[:, :, 0]]
    return Surfaces(np.where(found.bin >= 0, planes.time, np.nan), light.astype(np.float64))


def depth_of(counts: Counts, config: Config, background: np.ndarray) -> Surfaces:
    """Return the surfaces that counts show. background: float64[subgroups, pixels], per tick."""
    seen = seen_of(counts, config, background)
    return surfaces_of(Counted(seen, config, pulse_ticks(config), counts.second_pulses))
