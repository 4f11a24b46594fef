# SPDX-License-Identifier: Apache-2.0
"""How bright the pixels are: the lights that a pixel may have, their prior from the frame, and the mean over them."""

import numpy as np

from ..shared.compiled import njit, part
from . import portable
from .vector_math import fast_exp, fast_log, top_of

LIGHT_FLOOR = 0.01  # share of the pixels that is assumed for a light that no pixel has
LEARNING_ROUNDS = 30  # in which the shares of the lights converge
LIGHT_SPAN = 4.0  # lights more than so many times from those of a subgroup's seeds are left out
NEGLIGIBLE = -1.0  # log likelihood ratio below which averaging over the lights is not worth its exponentials
BLOCK = 32  # times that are averaged together


def lights_near(known: np.ndarray, lights: np.ndarray) -> slice:
    """Return the lights that the pixels of a subgroup may have. known: those of its seeds; all lights if there are none."""
    if not len(known):
        return slice(0, len(lights))
    low, high = np.searchsorted(lights, (known.min() / LIGHT_SPAN, known.max() * LIGHT_SPAN)).tolist()
    return slice(max(0, low - 1), min(len(lights), high + 1))


def prior_of_met(prior: np.ndarray) -> np.ndarray:
    """Return the prior for windows that met a threshold above 1: no light counts as rarer than a brighter one.

    Among these windows, dark pixels are hit more often than the law says, and look brighter than they are.
    """
    return np.maximum.accumulate(prior[::-1])[::-1]


def learned_prior(chance: np.ndarray) -> np.ndarray:
    """float32[lights]: log share of the pixels with each light; the shares make the pixels likeliest.

    chance: float32[n, lights], likelihood of each light, in a unit of the pixel's own.
    """
    share = np.full(chance.shape[1], 1 / chance.shape[1])
    for _ in range(LEARNING_ROUNDS if len(chance) else 0):
        share = share * _gain(chance, share) / len(chance)
    share += LIGHT_FLOOR
    return portable.log(share / share.sum()).astype(np.float32)


@njit
def _gain(chance, share):
    """float64[lights]: sum over the pixels of each light's likelihood, relative to the mean over the lights."""
    gain = np.zeros(len(share))
    for i in range(len(chance)):
        mean = 0.0
        for x in range(len(share)):
            mean += chance[i, x] * share[x]
        for x in range(len(share)):
            gain[x] += chance[i, x] / mean
    return gain


@njit
def add_light_chances(common, pixels, known, chance):
    """Compute chance, float32[pixels, lights]: sum of a known pixel's likelihoods over its times, in a unit of its own."""
    total, touched, first = pixels.total, pixels.touched, pixels.first
    lights = chance.shape[1]
    bins, times = touched.shape[1], len(common) // lights
    line = np.empty(bins * lights, np.float32)
    for i in range(len(total)):
        low, high = max(0, -first[i]), min(bins, times - first[i])
        if not known[i] or high <= low:
            continue
        for k in range(low, high):
            if not touched[i, k]:
                touched[i, k] = True
                total[i, k * lights : (k + 1) * lights] = 0
        here = common[(first[i] + low) * lights : (first[i] + high) * lights]
        own, of_pixel = total[i, low * lights : high * lights], line[low * lights : high * lights]
        for j in range(len(own)):
            of_pixel[j] = here[j] + own[j]
        top = top_of(of_pixel)
        for j in range(len(own)):
            of_pixel[j] = fast_exp(of_pixel[j] - top)
        for k in range(low, high):
            for x in range(lights):
                chance[i, x] += line[k * lights + x]


@njit
def mean_over_lights(common, pixels, prior, lightest, place, level, light):
    """Compute the logarithm of the mean over the lights, and the likeliest light; a masked pixel favours no time.

    lightest: index of the first light in the grid. `common` is used up.
    """
    total, touched, mask, first = pixels.total, pixels.touched, pixels.mask, pixels.first
    lights = len(prior)
    times = len(common) // lights
    work = np.zeros((lights, BLOCK), np.float32), np.zeros(BLOCK, np.float32), np.zeros(BLOCK, np.float32)
    best = np.zeros(BLOCK, np.int32)
    level_of_all, light_of_all = np.empty(times, np.float32), np.empty(times, np.uint8)
    line = np.empty(BLOCK * lights, np.float32)
    for k in range(times):
        for x in range(lights):
            common[k * lights + x] += prior[x]
    for k in range(0, times, BLOCK):
        end = min(times, k + BLOCK)
        _mean(common[k * lights : end * lights], lightest, work, best, level_of_all[k:end], light_of_all[k:end])
    for i in range(len(total)):
        if mask[i]:
            own = total[i], touched[i], first[i], level[place[i]], light[place[i]]
            _over_lights_of(*own, common, lightest, work, best, level_of_all, light_of_all, line)
        else:
            level[place[i]], light[place[i]] = 0, 0


@part
def _over_lights_of(
    total, touched, first, level, light, common, lightest, work, best, level_of_all, light_of_all, line
):
    """Compute the levels and lights of a pixel, which are those of all pixels where no event hit it."""
    lights, bins = len(work[0]), len(touched)
    low, high = max(0, -first), min(bins, len(level_of_all) - first)
    high = max(low, high)
    level[:low], light[:low], level[high:], light[high:] = 0, 0, 0, 0
    _copy(level_of_all[first + low : first + high], level[low:high])
    _copy(light_of_all[first + low : first + high], light[low:high])
    k = low
    while k < high:
        end, most = k, min(high, k + BLOCK)
        while end < most and touched[end]:
            end += 1
        if end == k:
            k += 1
            continue
        here, own = common[(first + k) * lights : (first + end) * lights], total[k * lights : end * lights]
        for j in range(len(own)):
            line[j] = here[j] + own[j]
        _mean(line[: len(own)], lightest, work, best, level[k:end], light[k:end])
        k = end


@part
def _copy(source, target):
    """Copy the values of a line to another one of the same length."""
    for k in range(len(target)):
        target[k] = source[k]


@part
def _mean(line, lightest, work, best, level, light):
    """Compute the mean over the lights and the likeliest light of at most `BLOCK` times.

    work: values, float32[lights, BLOCK], and two float32[BLOCK]; best: int32[BLOCK]. All loops over times have the same
    length, so that they compile to vector code without a remainder.
    """
    values, top, ratio = work
    n, lights = len(level), len(values)
    for k in range(n):
        for x in range(lights):
            values[x, k] = line[k * lights + x]
    for k in range(BLOCK):
        top[k], best[k], ratio[k] = values[0, k], 0, 0
    for x in range(1, lights):
        for k in range(BLOCK):
            best[k] = x if values[x, k] > top[k] else best[k]
            top[k] = max(values[x, k], top[k])
    highest = np.float32(NEGLIGIBLE)
    for k in range(n):
        level[k], light[k] = top[k], best[k] + lightest
        highest = max(highest, top[k])
    if highest > NEGLIGIBLE:
        for x in range(lights):
            for k in range(BLOCK):
                ratio[k] += fast_exp(values[x, k] - top[k])
        for k in range(BLOCK):
            ratio[k] = fast_log(ratio[k])
        for k in range(n):
            level[k] = top[k] + (ratio[k] if top[k] > NEGLIGIBLE else np.float32(0))
