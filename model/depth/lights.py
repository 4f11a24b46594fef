# SPDX-License-Identifier: Apache-2.0
"""The lights that a pixel may have, how likely each is, and the mean over them."""

from typing import NamedTuple

import numpy as np

from ..shared.compiled import njit, part
from .evidence import Pixels
from .vector_math import fast_exp, fast_log, top_of

LIGHT_SPAN = 4.0  # lights more than so many times from those of a subgroup's seeds are left out
NARROW = np.float32(4.0)  # second difference from which on the steps of the lights are too coarse
CLIMBS = 2  # steps to the highest point between the lights
SHARP_MIN = np.float32(0.2)  # of the sharpness of a number of hits: less is no peak
TURN = np.float32(2 * np.pi)
BLOCK = 32  # times that are averaged together


def lights_near(known: np.ndarray, lights: np.ndarray) -> slice:
    """Return the lights that the pixels of a subgroup may have.

    known: lights of its seeds; if there are none, all are possible.
    """
    if not len(known):
        return slice(0, len(lights))
    low = int(np.searchsorted(lights, known.min() / LIGHT_SPAN))
    high = int(np.searchsorted(lights, known.max() * LIGHT_SPAN))
    return slice(max(0, low - 1), min(len(lights), high + 1))


class _Work(NamedTuple):
    """Workspace of a mean over the lights, for `BLOCK` times."""

    values: np.ndarray  # float32[lights, BLOCK], log likelihoods
    top: np.ndarray  # float32[BLOCK], highest of them
    ratio: np.ndarray  # float32[BLOCK], logarithm of the mean over the highest
    best: np.ndarray  # int32[BLOCK], number of the likeliest light
    line: np.ndarray  # float32[BLOCK * lights], log likelihoods of a pixel
    prior: np.ndarray  # float32[lights], that the log likelihoods have
    more: np.ndarray  # float32[BLOCK * lights], by which it exceeds that of all pixels
    where: np.ndarray  # float32[lights], logarithms of the lights
    alone_below: np.float32  # level, below which the likeliest light counts alone


class _Levels(NamedTuple):
    """What is known of consecutive times."""

    level: np.ndarray  # float32[n], logarithm of the mean over the lights
    light: np.ndarray  # uint8[n], index of the likeliest light in the grid


@njit
def add_light_chances(
    common: np.ndarray, pixels: Pixels, known: np.ndarray, chance: np.ndarray
) -> None:
    """Compute chance, float32[pixels, lights]: sum of a known pixel's likelihoods over its times.

    Its unit is the pixel's own. common, pixels: from `add_events`. known: bool[pixels].
    """
    lights = chance.shape[1]
    bins = pixels.touched.shape[1]
    times = len(common) // lights
    line = np.empty(bins * lights, np.float32)
    for i in range(len(pixels.total)):
        first = pixels.first[i]
        low = max(0, -first)
        high = min(bins, times - first)
        if known[i] and low < high:
            here = common[(first + low) * lights : (first + high) * lights]
            _touch(pixels.total[i], pixels.touched[i], low, high, lights)
            own = pixels.total[i][low * lights : high * lights]
            _add_chances(here, own, line[: len(own)], chance[i])


@njit
def add_chances_on_surfaces(
    common: np.ndarray,
    pixels: Pixels,
    at: np.ndarray,
    offset: np.ndarray,
    known: np.ndarray,
    chance: np.ndarray,
) -> None:
    """Compute chance, float32[pixels, offsets, lights]: likelihoods of a known pixel at its surface.

    Its unit is the pixel's own. common, pixels: from `add_events`. at: float64[pixels], number of
    the surface's time, between two of the pixel's. offset: float64[offsets], times by which the
    surface may be off. known: bool[pixels]; false afterwards where such times are not all there.
    """
    offsets, lights = chance.shape[1:]
    bins = pixels.touched.shape[1]
    times = len(common) // lights
    for i in range(len(pixels.total)):
        first = pixels.first[i]
        low = max(0, -first)
        high = min(bins, times - first)
        if not known[i] or at[i] + offset[0] < low or at[i] + offset[-1] + 1 >= high:
            known[i] = False
            continue
        total = pixels.total[i]
        _touch(total, pixels.touched[i], low, high, lights)
        top = np.float32(-np.inf)
        for k in range(offsets):
            time = at[i] + offset[k]
            before = int(time)
            share = np.float32(time - before)
            for x in range(lights):
                here = before * lights + x
                there = first * lights + here
                value = (1 - share) * (common[there] + total[here])
                value += share * (common[there + lights] + total[here + lights])
                chance[i, k, x] = value
                top = max(top, value)
        for k in range(offsets):
            for x in range(lights):
                chance[i, k, x] = fast_exp(chance[i, k, x] - top)


@part
def _touch(total: np.ndarray, touched: np.ndarray, low: int, high: int, lights: int) -> None:
    """Make a total valid from bin `low` to `high`; nothing was added where it is not yet."""
    for k in range(low, high):
        if not touched[k]:
            touched[k] = True
            total[k * lights : (k + 1) * lights] = 0


@part
def _add_chances(common: np.ndarray, own: np.ndarray, line: np.ndarray, chance: np.ndarray) -> None:
    """Add the likelihoods of a pixel, common + own, to `chance`.

    line: workspace of the same length.
    """
    lights = len(chance)
    for j in range(len(own)):
        line[j] = common[j] + own[j]
    top = top_of(line)
    for j in range(len(own)):
        line[j] = fast_exp(line[j] - top)
    for k in range(len(line) // lights):
        for x in range(lights):
            chance[x] += line[k * lights + x]


@njit
def mean_over_lights(
    common: np.ndarray,
    pixels: Pixels,
    prior: np.ndarray,
    own_prior: np.ndarray,
    where: np.ndarray,
    lightest: int,
    place: np.ndarray,
    level: np.ndarray,
    light: np.ndarray,
    alone_below: float,
) -> None:
    """Compute the logarithm of the mean over the lights, and the likeliest light.

    A masked pixel favours no time. common, pixels: from `add_events`; `common` is used up. prior:
    float32[lights], where no event hit a pixel; own_prior: float32[pixels, lights], where one did.
    where: float32[lights], logarithms of the lights. lightest: index of the first of them in the
    grid. place: int64[pixels], row of each pixel in the results, level and light.
    alone_below: level, below which the likeliest light counts alone instead of the mean.
    """
    lights = len(prior)
    times = len(common) // lights
    work = _Work(
        values=np.zeros((lights, BLOCK), np.float32),
        top=np.zeros(BLOCK, np.float32),
        ratio=np.zeros(BLOCK, np.float32),
        best=np.zeros(BLOCK, np.int32),
        line=np.empty(BLOCK * lights, np.float32),
        prior=prior.copy(),
        more=np.zeros(BLOCK * lights, np.float32),
        where=where,
        alone_below=np.float32(alone_below),
    )
    of_all = _Levels(np.empty(times, np.float32), np.empty(times, np.uint8))
    _mean_of_all(common, prior, lightest, work, of_all)
    for i in range(len(pixels.total)):
        own = _Levels(level[place[i]], light[place[i]])
        if pixels.mask[i]:
            for x in range(lights):
                work.prior[x] = own_prior[i, x]
            for k in range(BLOCK):
                for x in range(lights):
                    work.more[k * lights + x] = own_prior[i, x] - prior[x]
            _mean_of_pixel(common, pixels, i, lightest, work, of_all, own)
        else:
            own.level[:] = 0
            own.light[:] = 0


@part
def _mean_of_all(
    common: np.ndarray, prior: np.ndarray, lightest: int, work: _Work, of_all: _Levels
) -> None:
    """Add the prior to `common`, and compute the levels and lights of a pixel that no event hit."""
    lights = len(prior)
    times = len(of_all.level)
    for k in range(times):
        for x in range(lights):
            common[k * lights + x] += prior[x]
    for k in range(0, times, BLOCK):
        end = min(times, k + BLOCK)
        here = _Levels(of_all.level[k:end], of_all.light[k:end])
        _mean(common[k * lights : end * lights], lightest, work, here)


@part
def _mean_of_pixel(
    common: np.ndarray,
    pixels: Pixels,
    i: int,
    lightest: int,
    work: _Work,
    of_all: _Levels,
    own: _Levels,
) -> None:
    """Compute the levels and lights of pixel i.

    Where no event hit it, they are those of all pixels.
    """
    lights = len(work.values)
    first = pixels.first[i]
    total = pixels.total[i]
    touched = pixels.touched[i]
    low = max(0, -first)
    high = max(low, min(len(touched), len(of_all.level) - first))
    own.level[:low] = 0
    own.light[:low] = 0
    own.level[high:] = 0
    own.light[high:] = 0
    _copy(of_all.level[first + low : first + high], own.level[low:high])
    _copy(of_all.light[first + low : first + high], own.light[low:high])
    k = low
    while k < high:
        end = k
        most = min(high, k + BLOCK)
        while end < most and touched[end]:
            end += 1
        if end == k:
            k += 1
            continue
        everywhere = common[(first + k) * lights : (first + end) * lights]
        here = total[k * lights : end * lights]
        line = work.line[: len(here)]
        more = work.more[: len(here)]
        for j in range(len(here)):
            line[j] = everywhere[j] + here[j] + more[j]
        _mean(line, lightest, work, _Levels(own.level[k:end], own.light[k:end]))
        k = end


@part
def _copy(source: np.ndarray, target: np.ndarray) -> None:
    """Copy the values of a line to another one of the same length."""
    for k in range(len(target)):
        target[k] = source[k]


@part
def _mean(line: np.ndarray, lightest: int, work: _Work, out: _Levels) -> None:
    """Compute the mean over the lights and the likeliest light of at most `BLOCK` times.

    line: float32[times * lights]. All loops over times have the same length, so that they compile
    to vector code without a remainder.
    """
    values = work.values
    top = work.top
    ratio = work.ratio
    best = work.best
    n = len(out.level)
    lights = len(values)
    for k in range(n):
        for x in range(lights):
            values[x, k] = line[k * lights + x]
    for k in range(BLOCK):
        top[k] = values[0, k]
        best[k] = 0
        ratio[k] = 0
    for x in range(1, lights):
        for k in range(BLOCK):
            best[k] = x if values[x, k] > top[k] else best[k]
            top[k] = max(values[x, k], top[k])
    if top_of(top[:n]) > work.alone_below:
        for x in range(lights):
            for k in range(BLOCK):
                ratio[k] += fast_exp(values[x, k] - top[k])
        for k in range(BLOCK):
            ratio[k] = fast_log(ratio[k])
        _look_between(work, n)
    for k in range(n):
        out.level[k] = top[k] + (ratio[k] if top[k] > work.alone_below else np.float32(0))
        out.light[k] = best[k] + lightest


@part(error_model="numpy")
def _look_between(work: _Work, n: int) -> None:
    """Where the lights are too coarse for the likelihood, replace the mean over them, relative to
    the likeliest, by that over the lights between them, for n times.

    Between three lights, the log likelihood is about a log(light) - b light + c, as that of a number
    of hits. A bright pixel, which fires in most pulses, differs from that (`_difference`). The mean
    is that of a Gaussian in log(light) around the highest point.
    """
    values = work.values
    prior = work.prior
    where = work.where
    lights = len(values)
    one = np.float32(1)
    for k in range(n):
        x = work.best[k]
        if x == 0 or x == lights - 1:
            continue
        low = where[x - 1] - where[x]
        high = where[x + 1] - where[x]
        below = values[x - 1, k] - values[x, k] - prior[x - 1] + prior[x]
        above = values[x + 1, k] - values[x, k] - prior[x + 1] + prior[x]
        if -(below + above) < NARROW:
            continue
        less = np.exp(low) - one
        more = np.exp(high) - one
        b = (high * below - low * above) / (low * more - high * less)  # times the middle light
        a = (above + b * more) / high
        if a <= 0 or b <= 0:
            continue
        off = min(high, max(low, fast_log(a / b)))  # to the highest, logarithm
        cubic, quartic = _difference(work, k, x, a, b)
        sharp = a
        for _ in range(CLIMBS):
            slope, curve = _slopes(cubic, quartic, low, high, off)
            light = b * np.exp(off)
            sharper = light - curve
            if sharper < SHARP_MIN * a:
                break
            sharp = sharper
            off = min(high, max(low, off + (a - light + slope) / sharp))
        differs = off * (off - low) * (off - high) * (cubic + quartic * off)
        top = a * off - b * (np.exp(off) - one) + differs
        side = x + 1 if off > 0 else x - 1
        between = off / (high if off > 0 else low) * (prior[side] - prior[x])
        step = (high - low) / np.float32(2)
        spread = fast_log(TURN / (sharp * step * step))
        work.ratio[k] = top + between + np.float32(0.5) * spread


@part
def _difference(
    work: _Work, k: int, x: int, a: np.float32, b: np.float32
) -> tuple[np.float32, np.float32]:
    """Return how the log likelihood at time k differs from a log(light) - b light + c around light x:
    the factors of the polynomials that `_slopes` has.

    They follow from the lights two steps away, as far as these are in the grid.
    """
    lights = len(work.values)
    none = np.float32(0)
    low = none
    high = none
    if x >= 2:
        low = _beyond(work, k, x, x - 2, a, b)
    if x <= lights - 3:
        high = _beyond(work, k, x, x + 2, a, b)
    if x < 2:
        return high, none
    if x > lights - 3:
        return low, none
    apart = work.where[x + 2] - work.where[x - 2]
    quartic = (high - low) / apart
    return high - quartic * (work.where[x + 2] - work.where[x]), quartic


@part
def _beyond(work: _Work, k: int, x: int, there: int, a: np.float32, b: np.float32) -> np.float32:
    """Return by how much the log likelihood of light `there` exceeds a log(light) - b light + c, per
    the product of its distances to light x and to those beside it.
    """
    where = work.where
    off = where[there] - where[x]
    product = off * (where[there] - where[x - 1]) * (where[there] - where[x + 1])
    more = work.values[there, k] - work.values[x, k] - work.prior[there] + work.prior[x]
    return (more - a * off + b * (np.exp(off) - np.float32(1))) / product


@part
def _slopes(
    cubic: np.float32, quartic: np.float32, low: np.float32, high: np.float32, off: np.float32
) -> tuple[np.float32, np.float32]:
    """Return the first and the second derivative of u (u - low) (u - high) (cubic + quartic u) at
    `off`.
    """
    two = np.float32(2)
    total = low + high
    product = low * high
    value = off * (off - low) * (off - high)
    first = (np.float32(3) * off - two * total) * off + product
    second = np.float32(6) * off - two * total
    factor = cubic + quartic * off
    return first * factor + value * quartic, second * factor + two * first * quartic
