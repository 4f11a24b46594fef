# SPDX-License-Identifier: Apache-2.0
"""Likelihood of counts in gates as a function of each pixel's surface time, as `likelihood.py` has
that of events.

All of this is our own choice. A pixel with a surface at time t and `light` photons per pulse is hit
in a bin, in a pulse in which it can be, with the chance

    1 - exp(-light * S) + background,

where S is the share of the pulse in the bin's ticks. It can be hit if it is not dead: a SPAD is dead
for some time after each photon. Hits do not depend on the tree, so nothing of it is here. All
likelihoods are relative to a pixel that sees no surface.
"""

from typing import NamedTuple

import numpy as np

from ..contract.config import Config
from ..shared.compiled import njit, part
from . import portable
from .evidence import WAYS, Pixels
from .histograms import by_subgroup
from .light_prior import LightPrior, learned_prior, mean_prior, own_priors
from .lights import add_light_chances, mean_over_lights
from .likelihood import Grid, Levels
from .pulse_ticks import PulseTicks
from .unheard import Spread
from .vector_math import fast_log

MISSED = np.float32(-6.0)  # log likelihood of a surface outside of all gates
# level, below which the likeliest light counts alone, because silent gates show no surface
ALONE_BELOW = -1.0
NO_TICK = -1  # in place of a gate's first tick


class Seen(NamedTuple):
    """What the likelihood reads of the pixels' bins, by subgroup. Frames stand behind each other as
    further gates.
    """

    first: np.ndarray  # int64[subgroups, pixels, gates], first tick of a gate; NO_TICK: none
    hits: np.ndarray  # int64[subgroups, pixels, gates, bins]
    # float64[subgroups, pixels, gates, bins]: pulses in which the pixel could be hit, but was not
    misses: np.ndarray
    background: np.ndarray  # float64[subgroups, pixels], photons per tick
    width: int  # ticks of a bin


class _Pixels(NamedTuple):
    """The same of the pixels of one subgroup."""

    first: np.ndarray
    hits: np.ndarray
    misses: np.ndarray
    background: np.ndarray  # of a bin


class _Law(NamedTuple):
    """What holds for bins that begin so many ticks after a pulse's time: `low` for the first row.

    Ticks are whole ones, less the fraction of a tick in the times of the grid.
    """

    low: int
    width: int  # ticks of a bin
    light: np.ndarray  # float64[ticks, lights], photons in the bin
    chance: np.ndarray  # float64[ticks, lights], of a hit by them


def count_likelihood(
    seen: Seen,
    config: Config,
    pulse: PulseTicks,
    grid: Grid,
    first: np.ndarray,
    bins: int,
    spread: Spread = map,
) -> Levels:
    """Return the log likelihood ratio of each pixel's times, as a mean over the lights, and the
    likeliest light at each.

    first: int64[subgroups, pixels], index of the pixel's first time in the grid. bins: number of a
    pixel's times. spread: a `map` over subgroups that may use any order.
    """
    sensor = config.sensor
    lights = grid.lights
    law = _law_of(pulse, seen.width, lights, grid.step)
    level = np.empty((sensor.array_pixels, bins), np.float32)
    light = np.empty((sensor.array_pixels, bins), np.uint8)
    place = by_subgroup(np.arange(sensor.array_pixels), sensor)
    where = portable.log(lights).astype(np.float32)
    fallen = grid.fallen(first, bins)

    def evidence(s: int) -> Pixels:
        total = np.empty((sensor.pixels, bins * len(lights)), np.float32)
        back = seen.background[s] * seen.width
        own = _Pixels(seen.first[s], seen.hits[s], seen.misses[s], back)
        _add_up(own, law, first[s], grid.step, total)
        return _pixels_of(total, config.mask[s], bins)

    def average(s: int, prior: LightPrior, pixels: Pixels) -> None:
        common = np.zeros(bins * len(lights), np.float32)
        own = own_priors(prior, lights, fallen[s])
        even = mean_prior(own, pixels.mask)
        mean_over_lights(common, pixels, even, own, where, 0, place[s], level, light, ALONE_BELOW)

    def chances(s: int) -> tuple[np.ndarray, np.ndarray]:
        pixels = found[s]
        known = pixels.mask & (np.max(pixels.total, axis=1) > MISSED)
        chance = np.zeros((len(known), len(lights)), np.float32)
        add_light_chances(np.zeros(bins * len(lights), np.float32), pixels, known, chance)
        return chance[known], fallen[s][known]

    subgroups = range(sensor.subgroups)
    if grid.prior is not None:
        prior = grid.prior
        list(spread(lambda s: average(s, prior, evidence(s)), subgroups))
    else:
        found = list(spread(evidence, subgroups))
        of_known, fallen_of_known = zip(*spread(chances, subgroups), strict=True)
        prior = learned_prior(np.concatenate(of_known), lights, np.concatenate(fallen_of_known))
        list(spread(lambda s: average(s, prior, found[s]), subgroups))
    shape = (sensor.rows, sensor.cols, bins)
    return Levels(level.reshape(shape), light.reshape(shape), prior)


def _pixels_of(total: np.ndarray, mask: np.ndarray, bins: int) -> Pixels:
    """Return log likelihoods, float32[pixels, bins * lights], as means over lights read them."""
    number = len(total)
    return Pixels(
        minigroup=np.zeros(number, np.int64),
        mask=mask,
        activity=np.ones(number),
        first=np.zeros(number, np.int64),  # each pixel has times of its own
        total=total,
        touched=np.ones((number, bins), np.bool_),
        counted=np.full(number, -1),
        number=np.empty((WAYS, number), np.int64),
        hit=np.empty(number, np.int64),
    )


def _law_of(pulse: PulseTicks, width: int, lights: np.ndarray, step: int) -> _Law:
    """Return the law for bins of `width` ticks, and times step * (k + 1/2)."""
    fraction = 0.5 if step % 2 else 0.0
    low = -pulse.reach - width - 1
    begin = np.arange(low, pulse.reach + 2) - fraction
    share = pulse.share_before(begin + width) - pulse.share_before(begin)
    light = share[:, None] * lights.astype(np.float64)
    return _Law(low, width, light, -portable.expm1(-light))


@njit
def _add_up(pixels: _Pixels, law: _Law, first: np.ndarray, step: int, total: np.ndarray) -> None:
    """Compute log likelihoods, float32[pixels, times * lights].

    first: int64[pixels]. The times are step * (first + k + 1/2), without the fraction of a tick.
    """
    ticks, lights = law.light.shape
    times = total.shape[1] // lights
    gates, bins = pixels.hits.shape[1:]
    logs = np.empty((ticks, lights), np.float32)
    last = law.low + ticks - 1
    for i in range(len(total)):
        total[i] = MISSED
        _compute_logs(law, pixels.background[i], logs)
        known = np.zeros(times, np.bool_)
        for g in range(gates):
            begin = pixels.first[i, g]
            if begin < 0:
                continue
            end = begin + (bins - 1) * law.width
            for k in range(times):
                tick = (step * (2 * (first[i] + k) + 1)) // 2
                if not begin - last <= tick <= end - law.low:
                    continue
                line = total[i, k * lights : (k + 1) * lights]
                if not known[k]:
                    known[k] = True
                    line[:] = 0
                low = max(0, -((begin - tick - law.low) // law.width))
                high = min(bins - 1, (last - begin + tick) // law.width)
                for b in range(low, high + 1):
                    row = begin + b * law.width - tick - law.low
                    hits = np.float32(pixels.hits[i, g, b])
                    misses = np.float32(pixels.misses[i, g, b])
                    for x in range(lights):
                        line[x] += hits * logs[row, x] - misses * np.float32(law.light[row, x])


@part
def _compute_logs(law: _Law, background: float, logs: np.ndarray) -> None:
    """Compute the log likelihood ratio of a hit, float32[ticks, lights].

    background: chance of a hit by background in a bin.
    """
    for row in range(len(logs)):
        for x in range(logs.shape[1]):
            logs[row, x] = fast_log(np.float32(1 + law.chance[row, x] / background))
