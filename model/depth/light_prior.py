# SPDX-License-Identifier: Apache-2.0
"""How frequent each light is among the pixels of a frame, learned from the frame.

The light of a surface falls with the square of its distance. So what is learned are the lights that
the pixels would have if all their surfaces were at a distance of one tick. Without that, the near
pixels of a tilted wall would be taken for darker than they are, and the far ones for brighter; and
where all pixels fire in nearly every pulse, brighter means farther away, so the wall would turn.

All of this is our own choice.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..shared.compiled import njit
from . import portable
from .vector_math import fast_exp, fast_log, top_of

STEP = 0.4  # between the logarithms of the lights whose frequency is learned
LIGHT_FLOOR = 0.01  # share of the pixels that is assumed for a light that no pixel has
# Of the share of a light, for the steps around it.
AROUND = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)
LEARNING_ROUNDS = 30  # in which the shares of the lights converge, from each pixel alone,
ROUNDS_ON_SURFACES = 60  # and from pixels that see one surface
OFF_SIGMAS = 0.9  # of a pulse: standard deviation of what surfaces are off with such a prior,
OFFSETS_SIGMAS = np.linspace(-1.5, 1.5, 11)  # and the offsets that are tried
RARE = 1e-30  # likelihood of a pixel that contradicts an offset


class LightPrior(NamedTuple):
    """How frequent lights are, for surfaces at a distance of one tick."""

    first: float  # logarithm of the first light
    share: np.ndarray  # float64[n], of the pixels with each light; empty: all are as frequent


EVEN = LightPrior(first=0.0, share=np.empty(0))


def fall(time_ticks: ArrayLike) -> np.ndarray:
    """Return the logarithm of how much more light surfaces would have at a distance of one tick."""
    return 2 * portable.log(np.maximum(1.0, time_ticks))


def own_priors(prior: LightPrior, lights: np.ndarray, fallen: np.ndarray) -> np.ndarray:
    """float32[n, lights]: log probability of each light, for each of n pixels.

    lights: float32[lights]. fallen: float64[n], of `fall`.
    """
    share = np.full((len(fallen), len(lights)), LIGHT_FLOOR)
    number = len(prior.share)
    if number:
        where = portable.log(lights.astype(np.float64))
        steps = np.gradient(where) / STEP  # that a light stands for
        at = (where + fallen[:, None] - prior.first) / STEP
        share += steps * np.interp(at, np.arange(number), prior.share, left=0.0, right=0.0)
    return portable.log(share / share.sum(axis=1, keepdims=True)).astype(np.float32)


def mean_prior(own: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """float32[lights]: log probability of each light for any of the live pixels of a subgroup.

    own: float32[pixels, lights], of each pixel. mask: bool[pixels], live pixels; if there are none,
    the result is that of all.
    """
    live = own[mask] if mask.any() else own
    return portable.log(portable.exp(live.astype(np.float64)).mean(axis=0)).astype(np.float32)


def prior_in_doubt(prior: np.ndarray, doubt: float) -> np.ndarray:
    """Return the priors, float32[n, lights], for windows that met a threshold above 1, if their law
    is in doubt: no light counts as rarer than a brighter one.

    If such windows are rejected less often than the law says, pixels look brighter than they are.
    doubt: from 0, where the priors stay as they are, to 1.
    """
    met = np.maximum.accumulate(prior[:, ::-1], axis=1)[:, ::-1]
    return prior + np.float32(doubt) * (met - prior)


def learned_prior(chance: np.ndarray, lights: np.ndarray, fallen: np.ndarray) -> LightPrior:
    """Return the shares that make the pixels likeliest.

    chance: float32[n, lights], likelihood of each light, in a unit of the pixel's own. lights:
    float32[lights]. fallen: float64[n], of `fall`.
    """
    bounds = np.arange(len(chance) + 1)
    return _likeliest_prior(chance[:, None], lights, fallen, bounds, np.zeros(1), LEARNING_ROUNDS)


def prior_on_surfaces(
    chance: np.ndarray, lights: np.ndarray, fallen: np.ndarray, group: np.ndarray
) -> LightPrior:
    """Return the same, where the pixels of a group see one surface.

    chance: float32[n, offsets, lights], likelihood of each light if the surface is off by one of
    `OFFSETS_SIGMAS`. group: int64[n], in ascending order.
    """
    bounds = np.flatnonzero(np.diff(group, prepend=-1, append=-1))
    weight = -0.5 * (OFFSETS_SIGMAS / OFF_SIGMAS) ** 2
    return _likeliest_prior(chance, lights, fallen, bounds, weight, ROUNDS_ON_SURFACES)


def measured_prior(
    signal: np.ndarray, error: np.ndarray, lights: np.ndarray, time_ticks: np.ndarray
) -> LightPrior:
    """Return the same, from lights that were measured, with these errors, at these times, each
    float64 of any shape.

    The log likelihood of a light is taken as that of a number of hits: a log(light) - b light, with
    the highest point and the width that were measured.
    """
    known = signal > 0
    own = signal[known, None]
    weight = own / error[known, None] ** 2
    highest = own * portable.log(own) - own
    levels = weight * (own * portable.log(lights) - lights - highest)
    chance = portable.exp(levels).astype(np.float32)
    return learned_prior(chance, lights, fall(time_ticks[known]))


def _likeliest_prior(
    chance: np.ndarray,
    lights: np.ndarray,
    fallen: np.ndarray,
    bounds: np.ndarray,
    weight: np.ndarray,
    rounds: int,
) -> LightPrior:
    """Return the shares of the lights, by expectation and maximisation.

    chance, bounds, weight: of `_gain`, but with the lights of the pixels.
    """
    if not chance.any():
        return EVEN
    first, chance = _at_one_tick(chance, portable.log(lights.astype(np.float64)), fallen)
    number, _, steps = chance.shape
    share = np.full(steps, 1 / steps)
    for _ in range(rounds):
        share *= _gain(chance, bounds, weight, share) / number
    return LightPrior(first - STEP * (len(AROUND) // 2), _between_steps(share))


def _at_one_tick(
    chance: np.ndarray, where: np.ndarray, fallen: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the logarithm of the first light at one tick, and the likelihoods of this light and the
    following ones, float32[n, offsets, steps].

    where: float64[lights], logarithms of the lights. Just beyond the first and the last of them, the
    likelihood is that of these.
    """
    number = len(where)
    possible: np.ndarray = chance.max(axis=1) > 0
    some: np.ndarray = possible.max(axis=1)
    low = where[possible.argmax(axis=1)] + fallen
    high = where[number - 1 - possible[:, ::-1].argmax(axis=1)] + fallen
    first = float(low[some].min())
    steps = 1 + int(np.ceil((high[some].max() - first) / STEP))
    light = first + STEP * np.arange(steps) - fallen[:, None]
    at = np.interp(light, where, np.arange(number))
    before = np.minimum(at.astype(np.int64), number - 2)
    later = (at - before).astype(np.float32)[:, None]
    inside = ((light > where[0] - STEP) & (light < where[-1] + STEP))[:, None]
    place = np.broadcast_to(before[:, None], (*chance.shape[:2], steps))
    below = np.take_along_axis(chance, place, 2)
    above = np.take_along_axis(chance, place + 1, 2)
    return first, np.where(inside, below + later * (above - below), np.float32(0))


def _between_steps(share: np.ndarray) -> np.ndarray:
    """Return the shares of the lights, float64[n + len(AROUND) - 1], for pixels whose light is
    between two steps. share: float64[n].

    Most shares go to the step that is nearest to the lights of the pixels. Without their neighbours,
    a pixel between two steps would be taken for darker or brighter than it is, and so for nearer or
    farther away.
    """
    around = np.zeros(len(share) + len(AROUND) - 1)
    for k, part in enumerate(AROUND):
        around[k : k + len(share)] += part * share
    return around


@njit
def _gain(
    chance: np.ndarray, bounds: np.ndarray, weight: np.ndarray, share: np.ndarray
) -> np.ndarray:
    """float64[lights]: sum over the pixels of each light's likelihood, relative to the mean over
    the lights, where the offset of a group is as likely as all its pixels make it.

    chance: float32[n, offsets, lights]. bounds: int64[groups + 1], first pixels of the groups.
    weight: float64[offsets], log probability of an offset. share: float64[lights].
    """
    offsets, lights = chance.shape[1:]
    gain = np.zeros(lights)
    mean = np.zeros((len(chance), offsets))
    level = np.empty(offsets, np.float32)
    for g in range(len(bounds) - 1):
        level[:] = weight
        for i in range(bounds[g], bounds[g + 1]):
            for k in range(offsets):
                for x in range(lights):
                    mean[i, k] += chance[i, k, x] * share[x]
                level[k] += fast_log(np.float32(max(RARE, mean[i, k])))
        top = top_of(level)
        total = 0.0
        for k in range(offsets):
            level[k] = fast_exp(level[k] - top)
            total += level[k]
        for i in range(bounds[g], bounds[g + 1]):
            for k in range(offsets):
                if mean[i, k] == 0:  # the likelihoods are too small for a number: they tell nothing
                    continue
                for x in range(lights):
                    gain[x] += level[k] / total * (chance[i, k, x] / mean[i, k])
    return gain
