# SPDX-License-Identifier: Apache-2.0
"""Planes through the likelihoods of neighbouring pixels: one time and two slopes per pixel, by PatchMatch with fixed steps.

Ref: PatchMatch stereo (Bleyer, Rhemann, Rother 2011), here applied to likelihoods of time. The plane of a pixel is scored
by the pixel's own likelihood and by its neighbours' probabilities on the plane; a neighbour on another surface hardly
matters. In every round, each pixel tries its neighbours' planes and small steps of its own plane. All pixels of a round
see the planes of the previous round.

The light of a pixel whose surface slants comes back spread over the distances that the pixel sees. So a field may have
likelihoods for pulses 1, 2, 4, ... times as wide as the laser's. Then the slopes of a plane choose between them, and
planes are those of space, seen in perspective: from pixel to pixel, 1 / time changes evenly instead of the time.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from ..shared.compiled import njit, part
from ..shared.quantities import Numbers
from . import portable
from .seeds import Blocks
from .vector_math import fast_exp, fast_log, top_of

REACHES = 1.3, 2.0, 3.0, 5.0  # pixels: sigma of the Gaussian weight of a pixel's neighbours,
REACH_TICKS = 2.0, 4.0, 10.0  # selected by the standard deviation of the pixel's own time: borders between the reaches
WEIGHT_MIN = 0.05  # lower weights are left out
HALF = 8  # pixels to the farthest neighbour
ON_PLANE = 60.0  # bins: odds that a neighbour is on the plane, per probability of its bin there
SLOPE, SLOPE_MAX, SLOPE_COST = 3.0, 130.0, 0.2  # ticks per pixel; a steeper plane is rarer (Cauchy)
ROUNDS = 4
STEP_TICKS, STEP_SLOPE, SHRINK = 4.0, 2.0, 0.6  # first steps, and their factor from round to round
BOX = 12**-0.5  # standard deviation of an even distribution of width 1: of a pixel's light, over its slope
AHEAD_MAX = 0.7  # of the time: the tangent of a plane in perspective is followed no farther
SAME = 0.05  # ticks: planes that differ by less are the same
FINER = 2  # steps per round, each half of the one before
TRUST = 0.5  # weight of a score: neighbours are not independent, and surfaces are not exactly planes
IMPROBABLE = -16.0  # log likelihood relative to the pixel's best: no neighbours can make up for less
PART = 8  # taps: after each part of them a plane is given up that cannot win any more
SLACK = 1e-3  # of a score: more than its rounding errors
_NEVER = np.float32(-1e9)


# A neighbour of a pixel: from the pixel's place to the neighbour's (see `Field`), pixels to it, and its weight.
_TAP = np.dtype([("place", np.int64), ("down", np.float64), ("right", np.float64), ("weight", np.float32)], align=True)


def _taps(cols: int) -> tuple[np.ndarray, np.ndarray]:
    """Return neighbours by reach, _TAP[reaches, n], those of the highest weight first; and the numbers that count."""
    steps = np.arange(-HALF, HALF + 1)
    down, right = (part.ravel() for part in np.meshgrid(steps, steps, indexing="ij"))
    weight = portable.exp(-0.5 * (down**2 + right**2) / np.array(REACHES)[:, None] ** 2).astype(np.float32)
    weight[:, (down == 0) & (right == 0)] = 0
    order = np.argsort(-weight, axis=1, kind="stable")
    taps = np.empty(weight.shape, _TAP)
    taps["weight"] = np.take_along_axis(weight, order, 1)
    taps["place"], taps["down"], taps["right"] = (down * (cols + 2 * HALF) + right)[order], down[order], right[order]
    return taps, (taps["weight"] >= WEIGHT_MIN).sum(axis=1)


class Field(NamedTuple):
    """Likelihoods of the pixels around their seeds, in bins of 1, 2, 4, ... ticks for pulses as many times as wide.

    Around the array, there is a margin of `HALF` places on which no pixel is, so that all neighbours have a place.
    own: float32[widths, places, bins], log likelihood relative to `best`, float32[rows, cols]. other: the same shape, what
    a neighbour adds to a plane's score there. peak: float64[widths, rows, cols], likeliest tick. first: float64[widths,
    places], tick at which the first bin begins, infinite in the margin. scale: float64[widths], bins per tick. sigma_ticks:
    of the laser's pulse. taps, number: of `_taps`. reach: int64[rows, cols], index of the taps that a pixel uses. left: float32[rows, cols, parts],
    the most that a part of the taps and those after it can add to a score.
    """

    own: np.ndarray
    best: np.ndarray
    other: np.ndarray
    peak: np.ndarray
    first: np.ndarray
    scale: np.ndarray
    sigma_ticks: float
    taps: np.ndarray
    number: np.ndarray
    reach: np.ndarray
    left: np.ndarray

    @classmethod
    def of(
        cls, levels: Sequence[np.ndarray], first: Sequence[np.ndarray], sigma_ticks: float, blocks: Blocks
    ) -> "Field":
        """Return the field of levels, float32[rows, cols, bins], and first ticks, int64[rows, cols], by width."""
        widths, (rows, cols, bins) = len(levels), levels[0].shape
        taps, number = _taps(cols)
        places = (rows + 2 * HALF) * (cols + 2 * HALF)
        own, other = (np.zeros((widths, places, bins), np.float32) for _ in range(2))
        best, highest = (np.empty((rows, cols), np.float32) for _ in range(2))
        peak, begins = np.empty((widths, rows, cols)), np.full((widths, places), np.inf)
        reach = np.empty((rows, cols), np.int64)
        left = np.zeros((rows, cols, -(-taps.shape[1] // PART)), np.float32)
        field = cls(own, best, other, peak, begins, 0.5 ** np.arange(widths), sigma_ticks, taps, number, reach, left)
        blocks(partial(_fill, field, np.stack(levels), np.stack(first), highest))
        blocks(partial(_fill_left, field, highest))
        return field


@part
def _place(cols, r, c):
    """Return the place of pixel (r, c) in the arrays of a field, which have a margin around the array."""
    return (r + HALF) * (cols + 2 * HALF) + c + HALF


@njit(allocates=False)
def _fill(field, levels, first, highest, begin, end):
    """Compute all of a field except `left`. highest: float32[rows, cols], the most that a pixel adds as a neighbour."""
    widths, _, cols, _ = levels.shape
    for r in range(begin, end):
        for c in range(cols):
            place, best = _place(cols, r, c), _NEVER
            for k in range(widths):
                best = max(best, top_of(levels[k, r, c]))
            field.best[r, c], highest[r, c] = best, 0
            for k in range(widths):
                line, other = levels[k, r, c], field.other[k, place]
                field.first[k, place] = first[k, r, c]
                field.peak[k, r, c] = first[k, r, c] + (np.argmax(line) + 0.5) / field.scale[k]
                most = top_of(line)
                total, deviation = _chances(line, best, most, field.own[k, place], other)
                if k == 0:
                    field.reach[r, c] = 0
                    for border in REACH_TICKS:
                        field.reach[r, c] += deviation > border
                _add_one_log(other, np.float32(ON_PLANE) * fast_exp(most - best) / total)
                highest[r, c] = max(highest[r, c], top_of(other))


@part
def _chances(line, best, most, own, other):
    """Write a line relative to its pixel's best, and its probabilities in a unit of their own; return their sum and deviation."""
    for j in range(len(line)):
        own[j], other[j] = line[j] - best, fast_exp(line[j] - most)
    total, mean, square = np.float32(0), 0.0, 0.0
    for j in range(len(line)):
        total += other[j]
        mean += other[j] * float(j)
        square += other[j] * float(j) ** 2
    return total, np.sqrt(max(0.0, float(square / total - (mean / total) ** 2)))


@part
def _add_one_log(line, factor):
    """Replace each value x of a line by log(1 + factor * x)."""
    for j in range(len(line)):
        line[j] = fast_log(np.float32(1) + factor * line[j])


@njit(allocates=False)
def _fill_left(field, highest, begin, end):
    """Compute `left` of a field for the rows from `begin` to `end`."""
    rows, cols = highest.shape
    for r in range(begin, end):
        for c in range(cols):
            own, total = field.reach[r, c], np.float32(0)
            for j in range(field.number[own] - 1, -1, -1):
                tap = field.taps[own, j]
                rr, cc = r + int(tap.down), c + int(tap.right)
                if 0 <= rr < rows and 0 <= cc < cols:
                    total += tap.weight * highest[rr, cc]
                if j % PART == 0:
                    field.left[r, c, j // PART] = total


class Planes(NamedTuple):
    """Plane of each pixel, [rows, cols]: time in ticks, slopes in ticks per pixel, score; is it new in this round?"""

    time: np.ndarray
    down: np.ndarray
    right: np.ndarray
    score: np.ndarray
    new: np.ndarray


def fit_planes(field: Field, blocks: Blocks) -> Planes:
    """Fit the planes of all pixels. blocks: calls a function for (begin, end) of blocks of rows, in any order."""
    kinds, shape = (np.float64, np.float64, np.float64, np.float32, np.bool_), field.best.shape
    planes, tried = (Planes(*(np.ones(shape, kind) for kind in kinds)) for _ in range(2))
    blocks(partial(_start, field, planes))
    step, slope = STEP_TICKS, STEP_SLOPE
    for _ in range(ROUNDS):
        blocks(partial(_round, field, planes, tried, step, slope))
        planes, tried = tried, planes
        step, slope = step * SHRINK, slope * SHRINK
    return planes


def widened(down: Numbers, right: Numbers, sigma_ticks: float) -> Numbers:
    """Return the variance of the pulse from a plane over that of the laser's; slopes may be arrays."""
    return 1 + (down**2 + right**2) * (BOX / sigma_ticks) ** 2


_widened = part(widened)


@njit
def level_on(field, planes):
    """float64[rows, cols]: log likelihood of each pixel on its plane."""
    rows, cols = planes.time.shape
    level = np.empty((rows, cols))
    for r in range(rows):
        for c in range(cols):
            width = _width(field, planes.down[r, c], planes.right[r, c])
            level[r, c] = field.best[r, c] + _level(field, field.own, width, _place(cols, r, c), planes.time[r, c])
    return level


@part
def _between(lines, k, place, at):
    """Interpolate a pixel's line linearly at a fractional index; return a never-winning value outside."""
    if not 0 <= at < lines.shape[2] - 1:
        return np.float32(0.0)
    j = np.int32(at)
    value, following = lines[k, place, np.uint64(j)], lines[k, place, np.uint64(j + 1)]  # no indices from the end
    return value + np.float32(at - j) * (following - value)


@part
def _along(field, time, by):
    """Return the time on a plane at the pixel where its tangent has changed by `by` ticks."""
    if len(field.scale) == 1:
        return time + by
    return time / (1 - min(AHEAD_MAX, by / max(time, 1.0)))


@part
def _width(field, down, right):
    """Return the width of the pulse from a plane as a fractional index."""
    if len(field.scale) == 1:
        return 0.0
    return min(len(field.scale) - 1.0, 0.5 * np.log2(_widened(down, right, field.sigma_ticks)))


@part
def _bin(field, k, place, time):
    """Return where a time is among a pixel's bins of width k: 0 is the middle of the first."""
    return (time - field.first[k, place]) * field.scale[k] - 0.5


@part
def _inside(field, width, place, time):
    """Return whether a time is between the middles of a pixel's bins."""
    return 0 <= _bin(field, int(width), place, time) < field.own.shape[2] - 1


@part
def _level(field, lines, width, place, time):
    """Interpolate a pixel's line at a time and between two widths."""
    k = int(width)
    value = _between(lines, k, place, _bin(field, k, place, time))
    if len(field.scale) > 1:
        following = min(k + 1, len(field.scale) - 1)
        more = _between(lines, following, place, _bin(field, following, place, time))
        value += np.float32(width - k) * (more - value)
    return value


@part
def _plane_of(field, planes, rr, cc, r, c):
    """Return time and slopes at pixel (r, c) of the plane of pixel (rr, cc)."""
    time, down, right = planes.time[rr, cc], planes.down[rr, cc], planes.right[rr, cc]
    there = _along(field, time, down * (r - rr) + right * (c - cc))
    steeper = 1.0 if len(field.scale) == 1 else (there / max(time, 1.0)) ** 2
    return there, down * steeper, right * steeper


@part
def _slope_cost(down, right):
    """Return by how much a plane's slopes, in ticks per pixel, lower its score (a logarithm)."""
    return np.float32(SLOPE_COST * np.log((1 + (down / SLOPE) ** 2) * (1 + (right / SLOPE) ** 2)))


@part
def _score(field, r, c, time, down, right, least):
    """Return the score of a plane at pixel (r, c) and around it, or less than `least` if it is less."""
    width, place = _width(field, down, right), _place(field.best.shape[1], r, c)
    if not _inside(field, width, place, time) or abs(down) > SLOPE_MAX or abs(right) > SLOPE_MAX:
        return _NEVER
    total, left, reach = _level(field, field.own, width, place, time), field.left[r, c], field.reach[r, c]
    if total + left[0] < least - SLACK:  # whatever the slopes cost
        return _NEVER
    total -= _slope_cost(down, right)
    number = field.number[reach]
    for first in range(0, number, PART):
        if total + left[first // PART] < least - SLACK:
            return _NEVER
        for j in range(first, min(first + PART, number)):
            tap = field.taps[reach, j]
            here = _along(field, time, down * tap.down + right * tap.right)
            total += tap.weight * _level(field, field.other, width, np.uint64(place + tap.place), here)
    return total


@njit(allocates=False)
def _start(field, planes, begin, end):
    """Start each pixel at its likeliest time for one of the widths, with the best of the slopes towards its neighbours."""
    peaks = field.peak
    widths, rows, cols = peaks.shape
    for r in range(begin, end):
        for c in range(cols):
            top = _NEVER
            planes.time[r, c] = peaks[0, r, c]
            for k in range(widths):
                peak = peaks[k]
                for i in range(4):  # none, up, down, both
                    up, low = r - (i % 2), r + (i // 2)
                    if up < 0 or low >= rows:
                        continue
                    down = (peak[low, c] - peak[up, c]) / max(1, low - up)
                    for j in range(4):
                        left, far = c - (j % 2), c + (j // 2)
                        if left < 0 or far >= cols:
                            continue
                        right = (peak[r, far] - peak[r, left]) / max(1, far - left)
                        score = _score(field, r, c, peak[r, c], down, right, top)
                        if score > top:
                            top = score
                            planes.time[r, c], planes.down[r, c], planes.right[r, c] = peak[r, c], down, right
            planes.score[r, c] = top


@njit(allocates=False)
def _round(field, old, new, step, slope, begin, end):
    """Compute the new planes of some rows: the best of the pixel's old one, its neighbours', and small steps of it.

    step: ticks. slope: ticks per pixel.
    """
    rows, cols = old.time.shape
    for r in range(begin, end):
        for c in range(cols):
            time, down, right, top = old.time[r, c], old.down[r, c], old.right[r, c], old.score[r, c]
            for rr in range(max(0, r - 1), min(rows, r + 2)):
                for cc in range(max(0, c - 1), min(cols, c + 2)):
                    if (rr == r and cc == c) or not old.new[rr, cc]:  # tried in the round before
                        continue
                    t, a, b = _plane_of(field, old, rr, cc, r, c)
                    if abs(t - time) < SAME and abs(a - down) < SAME and abs(b - right) < SAME:
                        continue
                    score = _score(field, r, c, t, a, b, top)
                    if score > top:
                        top, time, down, right = score, t, a, b
            by, tilt = step, slope
            for _ in range(FINER):
                for j in range(6):
                    t = time + by * ((j == 0) - (j == 1))
                    a, b = down + tilt * ((j == 2) - (j == 3)), right + tilt * ((j == 4) - (j == 5))
                    score = _score(field, r, c, t, a, b, top)
                    if score > top:
                        top, time, down, right = score, t, a, b
                by, tilt = by / 2, tilt / 2
            new.new[r, c] = top > old.score[r, c]
            new.time[r, c], new.down[r, c], new.right[r, c], new.score[r, c] = time, down, right, top


def posterior(field: Field, planes: Planes, tolerance_ticks: float, blocks: Blocks) -> tuple[np.ndarray, np.ndarray]:
    """Return (confidence, error), float64[rows, cols]: P(time is within `tolerance_ticks`), standard error of the time.

    Both assume that the slopes of the pixel's plane, or of one beside it, are right, and that its seed was right. Where
    the pixel's own light rules out all times near its plane, the confidence is 0 and the error NaN.
    """
    confidence, error = np.zeros(planes.time.shape), np.full(planes.time.shape, np.nan)
    score = np.empty((len(error), 2 * field.own.shape[2] + 1), np.float32)
    blocks(partial(_posterior, field, planes, tolerance_ticks, confidence, error, score))
    return confidence, error


@njit(allocates=False)
def _posterior(field, planes, tolerance, confidence, error, scores, begin, end):
    """Compute confidence and error of some rows. scores: workspace, one line per row; tolerance: ticks."""
    bins, cols = field.own.shape[2], planes.time.shape[1]
    for r in range(begin, end):
        for c in range(cols):
            time, down, right = planes.time[r, c], planes.down[r, c], planes.right[r, c]
            width, place = _width(field, down, right), _place(cols, r, c)
            low, high = len(scores[r]), 0
            for j in range(len(scores[r])):
                there = time + j - bins
                scores[r, j] = _NEVER
                if _inside(field, width, place, there):
                    own = _level(field, field.own, width, place, there)
                    if own > IMPROBABLE:
                        scores[r, j], low, high = own, min(low, j), j + 1
            if low >= high:
                continue
            score = scores[r, low:high]
            _add_neighbours(field, field.reach[r, c], place, time + low - bins, down, right, width, score)
            cost, top = _slope_cost(down, right), _NEVER
            for j in range(len(score)):
                score[j] -= cost
                top = max(top, score[j])
            others = _others(field, planes, r, c, tolerance, top)
            total, near, mean, square = 0.0, 0.0, 0.0, 0.0
            for j in range(len(score)):
                weight, off = float(fast_exp(np.float32(TRUST) * (score[j] - top))), float(low + j - bins)
                total += weight
                mean += weight * off
                square += weight * off * off
                near += weight * min(1.0, max(0.0, tolerance + 0.5 - abs(off)))
            confidence[r, c] = near / total / (1 + others)
            error[r, c] = np.sqrt(max(0.0, square / total - (mean / total) ** 2) + 1 / 12)


@part
def _add_neighbours(field, reach, place, time, down, right, width, score):
    """Add what the neighbours say about planes that begin at a time and follow each other by one tick."""
    bins, k = field.own.shape[2], int(width)
    for j in range(field.number[reach]):
        tap = field.taps[reach, j]
        there = place + tap.place
        if field.first[0, there] == np.inf:
            continue
        by = down * tap.down + right * tap.right
        here = _along(field, time, by)
        rate = (_along(field, time + len(score), by) - here) / len(score)  # in perspective it hardly changes
        if rate <= 0:  # beyond the plane's horizon
            continue
        for following in range(2 if width > k else 1):
            x = k + following
            at, step = _bin(field, x, there, here), rate * field.scale[x]
            part = tap.weight * np.float32(width - k if following else 1 - (width - k))
            begin = max(0, int(np.ceil(-at / step)))
            end = min(len(score), int(np.ceil((bins - 1 - at) / step)))
            if begin < end:
                line = field.other[x, there]
                _add_line(line, np.float32(at + begin * step), np.float32(step), part, score[begin:end])


@part
def _add_line(line, at, step, weight, score):
    """Add a line, interpolated from a fractional index on in steps."""
    last = np.int32(len(line) - 2)
    for j in range(len(score)):
        place = at + np.float32(j) * step
        i = min(np.int32(place), last)
        score[j] += weight * (line[i] + (place - np.float32(i)) * (line[i + 1] - line[i]))


@part
def _others(field, planes, r, c, tolerance, top):
    """Return the probability, relative to the pixel's own plane, of neighbours' planes that pass outside `tolerance`."""
    rows, cols = planes.time.shape
    odds = 0.0
    for rr in range(max(0, r - 1), min(rows, r + 2)):
        for cc in range(max(0, c - 1), min(cols, c + 2)):
            time, down, right = _plane_of(field, planes, rr, cc, r, c)
            if abs(time - planes.time[r, c]) > tolerance:
                odds = max(odds, np.exp(TRUST * (_score(field, r, c, time, down, right, _NEVER) - top)))
    return odds
