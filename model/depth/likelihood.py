# SPDX-License-Identifier: Apache-2.0
"""Likelihood of the sensor's words as a function of each pixel's surface time, on which the estimator of planes rests.

All of this is our own choice; the paper (IV) takes the peak of every pixel's histogram. All likelihoods are relative to
a pixel that sees no surface, whose hits are background. The stages are:

1. cut the events of each subgroup into clusters (`clusters.py`);
2. compute how often a pixel that fires leaves no trace (`unheard.py`);
3. add up what the events say about each time and light of a pixel (`evidence.py`);
4. learn how bright the pixels of the frame are, and average over the lights (`lights.py`).
"""

import math
from functools import partial
from typing import NamedTuple

import numpy as np

from ..contract.config import Config
from ..contract.pixels import pixel_table
from .clusters import cluster_events
from .evidence import REACH_SIGMAS, Law, Pixels, add_events, chances_to_be_heard, fired_table, first_shares
from .histograms import Events, by_subgroup
from .lights import add_light_chances, learned_prior, lights_near, mean_over_lights, prior_of_met
from .unheard import BLIND_MAX, Spread, Unheard

DEAD_S = 8e-9  # dead time of a SPAD (paper II)
QUIET_RATE = 1e-7  # photons per tick and pixel, at least: some background is everywhere


class Grid(NamedTuple):
    """Times and lights at which the likelihood is computed.

    step: ticks between times, which are step * (k + 1/2). lights: float32[L], photons per pulse. prior: float32[L], log
    probability of each; None: learned from the pixels whose time the guess knows.
    """

    step: int
    lights: np.ndarray
    prior: np.ndarray | None


class Levels(NamedTuple):
    """Log likelihood ratio, float32, and index of the likeliest light, uint8, both [rows, cols, bins]; the lights' prior."""

    level: np.ndarray
    light: np.ndarray
    prior: np.ndarray


class Guess(NamedTuple):
    """Prior knowledge of the pixels, [subgroups, pixels]: time in ticks (float64, NaN = unknown) and light."""

    time: np.ndarray
    light: np.ndarray


def log_likelihood(
    events: Events,
    config: Config,
    sigma_ticks: float,
    pulses: int,
    grid: Grid,
    never: Unheard,
    first: np.ndarray,
    bins: int,
    *,
    activity: np.ndarray | None = None,
    guess: Guess | None = None,
    spread: Spread = map,
) -> Levels:
    """Return the log likelihood ratio of each pixel's times, as a mean over the lights, and the likeliest light at each.

    pulses: number of pulses in which the events came. never: from `unheard`, for the same events. first:
    int64[subgroups, pixels], index of the pixel's first time in the grid. activity: float64[subgroups, pixels],
    background of each pixel relative to the mean (None: all equal). guess: needed to use offsets, which are ignored
    without it, and to learn the prior. spread: a `map` over subgroups that may use any order.
    """
    sensor = config.sensor
    reach = math.ceil(REACH_SIGMAS * sigma_ticks)
    minigroup = pixel_table(sensor).minigroup
    level, light = (np.empty((sensor.array_pixels, bins), kind) for kind in (np.float32, np.uint8))
    place = by_subgroup(np.arange(sensor.array_pixels), sensor)
    if activity is None:
        activity = np.ones((sensor.subgroups, sensor.pixels))
    offsets = guess is not None and events.offset.shape[1] > 0
    of_subgroup = cluster_events(events, config, pulses, reach, offsets)
    times = -(-(config.period_ticks - grid.step // 2) // grid.step)
    origins = np.clip(first.min(axis=1), 0, times - 1)
    spans = np.clip(first.max(axis=1) + bins, origins + 1, times) - origins
    subgroups, known = range(sensor.subgroups), np.zeros(config.mask.shape, bool)
    chosen = [slice(0, len(grid.lights))] * sensor.subgroups
    if guess is not None:
        known = config.mask & ~np.isnan(guess.time)
        chosen = [lights_near(guess.light[s][known[s]], grid.lights) for s in subgroups]
    fired = partial(fired_table, sigma_ticks, reach, grid.step, 1 << int(spans.max() - 1).bit_length())

    def evidence(s: int) -> tuple[np.ndarray, Pixels]:
        lights, origin, span = grid.lights[chosen[s]], int(origins[s]), int(spans[s])
        noise = max(events.photon_rate[s] / sensor.pixels, QUIET_RATE)
        alive = np.float32(1 - min(BLIND_MAX, noise * DEAD_S / config.tick_s))
        window, own = int(events.window[s]), of_subgroup[s]
        kinds = 1 + int(own.overrun.any())
        heard, sharp = (
            chances_to_be_heard(chance[:kinds, s], never.every, origin, span, grid.step, len(lights), alive)
            for chance in (never.missed, never.blind)
        )
        margin, table = fired(tuple(lights.tolist()))
        law = Law(
            window=window,
            told=window if events.mapped else 1,
            phases=sensor.phases,
            offset=sensor.offset_ticks,
            reach=reach,
            step=grid.step,
            origin=origin,
            lights=len(lights),
            noise=noise,
            alive=alive,
            pulses=pulses,
            heard=heard,
            sharp=sharp,
            margin=margin,
            fired=table,
        )
        if guess is not None and offsets:
            own = own._replace(shares=first_shares(law, own, minigroup, guess.time[s], guess.light[s], sigma_ticks))
        pixels = Pixels(
            minigroup=minigroup,
            mask=config.mask[s],
            activity=activity[s],
            first=first[s] - origin,
            total=np.empty((sensor.pixels, bins * len(lights)), np.float32),
            touched=np.zeros((sensor.pixels, bins), np.bool_),
            counted=np.full(sensor.pixels, -1),
            number=np.empty((2, sensor.pixels), np.int64),
            hit=np.empty(sensor.pixels, np.int64),
        )
        return add_events(law, own, pixels), pixels

    def average(s: int, prior: np.ndarray, common: np.ndarray, pixels: Pixels) -> None:
        near = np.ascontiguousarray((prior_of_met(prior) if events.threshold[s] > 1 else prior)[chosen[s]])
        mean_over_lights(common, pixels, near, chosen[s].start, place[s], level, light)

    if grid.prior is not None:
        prior = grid.prior
        list(spread(lambda s: average(s, prior, *evidence(s)), subgroups))
    else:
        found: list[tuple[np.ndarray, Pixels]] = list(spread(evidence, subgroups))
        chance = np.zeros((sensor.subgroups, sensor.pixels, len(grid.lights)), np.float32)
        list(spread(lambda s: add_light_chances(*found[s], known[s], chance[s, :, chosen[s]]), subgroups))
        prior = learned_prior(chance[known])
        list(spread(lambda s: average(s, prior, *found[s]), subgroups))
    shape = (sensor.rows, sensor.cols, bins)
    return Levels(level.reshape(shape), light.reshape(shape), prior)
