# SPDX-License-Identifier: Apache-2.0
"""Planes through the likelihoods of neighbouring pixels: one time and two slopes per pixel, by
PatchMatch with fixed steps.

Ref: PatchMatch stereo (Bleyer, Rhemann, Rother 2011), here applied to likelihoods of time. The
plane of a pixel is scored by the pixel's own likelihood and by its neighbours' probabilities on the
plane; a neighbour on another surface hardly matters. In every round, each pixel tries its
neighbours' planes and small steps of its own plane. All pixels of a round see the planes of the
previous round.

The light of a pixel whose surface slants comes back spread over the distances that the pixel sees.
So a field may have likelihoods for pulses 1, 2, 4, ... times as wide as the laser's. Then the
slopes of a plane choose between them, and planes are those of space, seen in perspective: from
pixel to pixel, 1 / time changes evenly instead of the time.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..shared.compiled import njit, part
from ..shared.quantities import Numbers
from . import portable
from .seeds import Blocks
from .vector_math import fast_exp, fast_log, top_of

REACHES = 1.3, 2.0, 3.0, 5.0  # pixels: sigma of the Gaussian weight of a pixel's neighbours
REACH_TICKS = 2.0, 4.0, 10.0  # borders between them: standard deviation of the pixel's own time
WEIGHT_MIN = 0.05  # lower weights are left out
HALF = 8  # pixels to the farthest neighbour
ON_PLANE = 60.0  # bins: odds that a neighbour is on the plane, per probability of its bin there
SLOPE = 3.0  # ticks per pixel: a steeper plane is rarer (Cauchy),
SLOPE_COST = 0.2  # and this is the weight of that law
SLOPE_MAX = 130.0  # ticks per pixel
ROUNDS = 3
STEP_TICKS = 4.0  # first step of the time
STEP_SLOPE = 2.0  # first step of a slope, ticks per pixel
SHRINK = 0.6  # factor of the steps from round to round
BOX = 12**-0.5  # standard deviation of an even distribution: of a pixel's light, per slope
AHEAD_MAX = 0.7  # of the time: the tangent of a plane in perspective is followed no farther
SAME = 0.05  # ticks: planes that differ by less are the same
FINER = 2  # steps per round, each half of the one before
TRUST = (
    0.5  # weight of a score: neighbours are not independent, and surfaces are not exactly planes
)
IMPROBABLE = -16.0  # relative to the pixel's best: no neighbours can make up for less
PART = 8  # taps: after each part of them a plane is given up that cannot win any more
SLACK = 1e-3  # of a score: more than its rounding errors
_NEVER = np.float32(-1e9)


class Field(NamedTuple):
    """Likelihoods of the pixels around their seeds, in bins of 1, 2, 4, ... ticks for pulses as
    many times as wide.

    Around the array, there is a margin of `HALF` places on which no pixel is, so that all
    neighbours have a place.
    """

    own: np.ndarray  # float32[widths, places, bins], log likelihood relative to `best`
    best: np.ndarray  # float32[rows, cols], highest log likelihood of the pixel
    other: np.ndarray  # float32[widths, places, bins], what a neighbour adds to a plane's score
    peak: np.ndarray  # float64[widths, rows, cols], likeliest tick
    first: np.ndarray  # float64[widths, places], tick of the first bin; infinite in the margin
    scale: np.ndarray  # float64[widths], bins per tick
    sigma_ticks: float  # of the laser's pulse
    taps: np.ndarray  # of `_taps`
    number: np.ndarray  # of `_taps`
    reach: np.ndarray  # int64[rows, cols], index of the taps that a pixel uses
    left: np.ndarray  # float32[rows, cols, parts], the most that the taps from a part on can add

    @classmethod
    def of(
        cls,
        levels: Sequence[np.ndarray],
        first: Sequence[np.ndarray],
        sigma_ticks: float,
        blocks: Blocks,
    ) -> "Field":
        """Return the field of levels, float32[rows, cols, bins], and first ticks, int64[rows,
        cols], by width.
        """
        widths = len(levels)
        rows, cols, bins = levels[0].shape
        taps, number = _taps(cols)
        places = (rows + 2 * HALF) * (cols + 2 * HALF)
        parts = -(-taps.shape[1] // PART)
        field = cls(
            own=np.zeros((widths, places, bins), np.float32),
            best=np.empty((rows, cols), np.float32),
            other=np.zeros((widths, places, bins), np.float32),
            peak=np.empty((widths, rows, cols)),
            first=np.full((widths, places), np.inf),
            scale=0.5 ** np.arange(widths),
            sigma_ticks=sigma_ticks,
            taps=taps,
            number=number,
            reach=np.empty((rows, cols), np.int64),
            left=np.zeros((rows, cols, parts), np.float32),
        )
        highest = np.empty((rows, cols), np.float32)
        blocks(partial(_fill, field, np.stack(levels), np.stack(first), highest))
        blocks(partial(_fill_left, field, highest))
        return field


# A neighbour of a pixel.
_TAP = np.dtype(
    [
        ("place", np.int64),  # from the pixel's place to the neighbour's (see `Field`)
        ("down", np.float64),  # pixels to the neighbour
        ("right", np.float64),
        ("weight", np.float32),
    ],
    align=True,
)


def _taps(cols: int) -> tuple[np.ndarray, np.ndarray]:
    """Return neighbours by reach, _TAP[reaches, n], those of the highest weight first.

    And the numbers that count.
    """
    steps = np.arange(-HALF, HALF + 1)
    down = np.repeat(steps, len(steps))
    right = np.tile(steps, len(steps))
    sigma = np.array(REACHES)[:, None]
    weight = portable.exp(-0.5 * (down**2 + right**2) / sigma**2).astype(np.float32)
    weight[:, (down == 0) & (right == 0)] = 0
    order = np.argsort(-weight, axis=1, kind="stable")
    taps = np.empty(weight.shape, _TAP)
    taps["weight"] = np.take_along_axis(weight, order, 1)
    taps["place"] = (down * (cols + 2 * HALF) + right)[order]
    taps["down"] = down[order]
    taps["right"] = right[order]
    return taps, (taps["weight"] >= WEIGHT_MIN).sum(axis=1)


@part
def _place(cols: int, r: int, c: int) -> int:
    """Return the place of pixel (r, c) in the arrays of a field, which have a margin around the
    array.
    """
    return (r + HALF) * (cols + 2 * HALF) + c + HALF


@njit(allocates=False)
def _fill(
    field: Field, levels: np.ndarray, first: np.ndarray, highest: np.ndarray, begin: int, end: int
) -> None:
    """Compute all of a field except `left`, for some rows.

    levels: float32[widths, rows, cols, bins]. first: int64[widths, rows, cols], ticks. highest:
    float32[rows, cols], the most that a pixel adds as a neighbour.
    """
    widths, _, cols, _ = levels.shape
    for r in range(begin, end):
        for c in range(cols):
            place = _place(cols, r, c)
            best = _NEVER
            for k in range(widths):
                best = max(best, top_of(levels[k, r, c]))
            field.best[r, c] = best
            highest[r, c] = 0
            for k in range(widths):
                line = levels[k, r, c]
                other = field.other[k, place]
                peak = (np.argmax(line) + 0.5) / field.scale[k]
                field.first[k, place] = first[k, r, c]
                field.peak[k, r, c] = first[k, r, c] + peak
                most = top_of(line)
                total, deviation = _chances(line, best, most, field.own[k, place], other)
                if k == 0:
                    field.reach[r, c] = 0
                    for border in REACH_TICKS:
                        field.reach[r, c] += deviation > border
                _add_one_log(other, np.float32(ON_PLANE) * fast_exp(most - best) / total)
                highest[r, c] = max(highest[r, c], top_of(other))


@part
def _chances(
    line: np.ndarray, best: np.float32, most: np.float32, own: np.ndarray, other: np.ndarray
) -> tuple[np.float32, float]:
    """Compute `own`, a line relative to its pixel's best, and `other`, its probabilities in a unit
    of their own.

    Return the sum and the standard deviation of the probabilities. most: the line's highest value.
    """
    for j in range(len(line)):
        own[j] = line[j] - best
        other[j] = fast_exp(line[j] - most)
    total = np.float32(0)
    mean = 0.0
    square = 0.0
    for j in range(len(line)):
        total += other[j]
        mean += other[j] * float(j)
        square += other[j] * float(j) ** 2
    variance = float(square / total - (mean / total) ** 2)
    return total, np.sqrt(max(0.0, variance))


@part
def _add_one_log(line: np.ndarray, factor: np.float32) -> None:
    """Replace each value x of a line by log(1 + factor * x)."""
    for j in range(len(line)):
        line[j] = fast_log(np.float32(1) + factor * line[j])


@njit(allocates=False)
def _fill_left(field: Field, highest: np.ndarray, begin: int, end: int) -> None:
    """Compute `left` of a field for some rows. highest: as in `_fill`."""
    rows, cols = highest.shape
    for r in range(begin, end):
        for c in range(cols):
            own = field.reach[r, c]
            total = np.float32(0)
            for j in range(field.number[own] - 1, -1, -1):
                tap = field.taps[own, j]
                rr = r + int(tap.down)
                cc = c + int(tap.right)
                if 0 <= rr < rows and 0 <= cc < cols:
                    total += tap.weight * highest[rr, cc]
                if j % PART == 0:
                    field.left[r, c, j // PART] = total


class Planes(NamedTuple):
    """Plane of each pixel, [rows, cols]."""

    time: np.ndarray  # float64, ticks
    down: np.ndarray  # float64, ticks per row
    right: np.ndarray  # float64, ticks per column
    score: np.ndarray  # float32
    new: np.ndarray  # bool, is it new in this round?


class _Plane(NamedTuple):
    """A plane at a pixel."""

    time: float  # ticks
    down: float  # ticks per row
    right: float  # ticks per column


def fit_planes(field: Field, blocks: Blocks) -> Planes:
    """Fit the planes of all pixels.

    blocks: calls a function for (begin, end) of blocks of rows, in any order.
    """
    old = _flat_planes(field.best.shape)
    new = _flat_planes(field.best.shape)
    blocks(partial(_start, field, old))
    step = STEP_TICKS
    slope = STEP_SLOPE
    for _ in range(ROUNDS):
        blocks(partial(_round, field, old, new, step, slope))
        old, new = new, old
        step = step * SHRINK
        slope = slope * SHRINK
    return old


def _flat_planes(shape: tuple[int, ...]) -> Planes:
    """Return planes for an array of this shape: slopes of 1, as the search begins."""
    return Planes(
        time=np.ones(shape),
        down=np.ones(shape),
        right=np.ones(shape),
        score=np.ones(shape, np.float32),
        new=np.ones(shape, np.bool_),
    )


def widened(down: Numbers, right: Numbers, sigma_ticks: float) -> Numbers:
    """Return the variance of the pulse from a plane over that of the laser's.

    Slopes may be arrays.
    """
    return 1 + (down**2 + right**2) * (BOX / sigma_ticks) ** 2


_widened = part(widened)


@njit
def level_on(field: Field, planes: Planes) -> np.ndarray:
    """float64[rows, cols]: log likelihood of each pixel on its plane."""
    rows, cols = planes.time.shape
    level = np.empty((rows, cols))
    for r in range(rows):
        for c in range(cols):
            place = _place(cols, r, c)
            width = _width(field, planes.down[r, c], planes.right[r, c])
            own = _level(field, field.own, width, place, planes.time[r, c])
            level[r, c] = field.best[r, c] + own
    return level


@part
def _between(lines: np.ndarray, k: int, place: int, at: float) -> np.float32:
    """Interpolate a pixel's line linearly at a fractional index.

    Return 0 outside, as of a pixel that adds nothing.
    """
    if not 0 <= at < lines.shape[2] - 1:
        return np.float32(0.0)
    j = np.int32(at)
    value = lines[k, place, np.uint64(j)]  # without a sign, because no index is from the end
    following = lines[k, place, np.uint64(j + 1)]
    return value + np.float32(at - j) * (following - value)


@part
def _along(field: Field, time: float, by: float) -> float:
    """Return the time on a plane at the pixel where its tangent has changed by `by` ticks."""
    if len(field.scale) == 1:
        return time + by
    return time / (1 - min(AHEAD_MAX, by / max(time, 1.0)))


@part
def _width(field: Field, down: float, right: float) -> Any:
    """Return the width of the pulse from a plane as a fractional index."""
    if len(field.scale) == 1:
        return 0.0
    doublings = 0.5 * np.log2(_widened(down, right, field.sigma_ticks))
    return min(len(field.scale) - 1.0, doublings)


@part
def _bin(field: Field, k: int, place: int, time: float) -> float:
    """Return where a time is among a pixel's bins of width k: 0 is the middle of the first."""
    return (time - field.first[k, place]) * field.scale[k] - 0.5


@part
def _inside(field: Field, width: float, place: int, time: float) -> bool:
    """Return whether a time is between the middles of a pixel's bins."""
    return 0 <= _bin(field, int(width), place, time) < field.own.shape[2] - 1


@part
def _level(field: Field, lines: np.ndarray, width: float, place: Any, time: float) -> np.float32:
    """Interpolate a pixel's line at a time and between two widths."""
    k = int(width)
    value = _between(lines, k, place, _bin(field, k, place, time))
    if len(field.scale) > 1:
        following = min(k + 1, len(field.scale) - 1)
        more = _between(lines, following, place, _bin(field, following, place, time))
        value += np.float32(width - k) * (more - value)
    return value


@part
def _plane_of(field: Field, planes: Planes, rr: int, cc: int, r: int, c: int) -> _Plane:
    """Return the plane of pixel (rr, cc) at pixel (r, c)."""
    time = planes.time[rr, cc]
    down = planes.down[rr, cc]
    right = planes.right[rr, cc]
    there = _along(field, time, down * (r - rr) + right * (c - cc))
    steeper = 1.0
    if len(field.scale) > 1:
        steeper = (there / max(time, 1.0)) ** 2
    return _Plane(there, down * steeper, right * steeper)


@part
def plane_at(field: Field, planes: Planes, r: int, c: int, down: float, right: float) -> float:
    """Return the time of the plane of pixel (r, c) so many pixels down and right."""
    by = planes.down[r, c] * down + planes.right[r, c] * right
    return _along(field, planes.time[r, c], by)


@part
def own_level(
    field: Field, planes: Planes, r: int, c: int, steps: int
) -> tuple[float, float, np.float32]:
    """Return what a pixel itself says about the time some steps from the one nearest to its plane.

    That is, the length of a step in ticks, the nearest time, and the log likelihood; steps are those
    of the wider one of the pulses of this plane.
    """
    width = _width(field, planes.down[r, c], planes.right[r, c])
    place = _place(field.best.shape[1], r, c)
    k = int(np.ceil(width))
    step = 1 / field.scale[k]
    middle = field.first[k, place] + step * (
        np.rint(_bin(field, k, place, planes.time[r, c])) + 0.5
    )
    return step, middle, _level(field, field.own, width, place, middle + steps * step)


@part
def _slope_cost(down: float, right: float) -> np.float32:
    """Return by how much a plane's slopes, in ticks per pixel, lower its score (a logarithm)."""
    rarity = (1 + (down / SLOPE) ** 2) * (1 + (right / SLOPE) ** 2)
    return np.float32(SLOPE_COST * np.log(rarity))


@part
def _score(field: Field, r: int, c: int, plane: _Plane, least: np.float32) -> np.float32:
    """Return the score of a plane at pixel (r, c) and around it, or less than `least` if it is
    less.
    """
    time = plane.time
    down = plane.down
    right = plane.right
    width = _width(field, down, right)
    place = _place(field.best.shape[1], r, c)
    if not _inside(field, width, place, time) or abs(down) > SLOPE_MAX or abs(right) > SLOPE_MAX:
        return _NEVER
    total = _level(field, field.own, width, place, time)
    left = field.left[r, c]
    if total + left[0] < least - SLACK:  # whatever the slopes cost
        return _NEVER
    total -= _slope_cost(down, right)
    reach = field.reach[r, c]
    number = field.number[reach]
    for first in range(0, number, PART):
        if total + left[first // PART] < least - SLACK:
            return _NEVER
        for j in range(first, min(first + PART, number)):
            tap = field.taps[reach, j]
            there = np.uint64(place + tap.place)
            here = _along(field, time, down * tap.down + right * tap.right)
            total += tap.weight * _level(field, field.other, width, there, here)
    return total


@njit(allocates=False)
def _start(field: Field, planes: Planes, begin: int, end: int) -> None:
    """Start the pixels of some rows at their likeliest time for one of the widths.

    The slopes are the best of those towards the pixel's neighbours.
    """
    widths, _, cols = field.peak.shape
    for r in range(begin, end):
        for c in range(cols):
            best = _Plane(field.peak[0, r, c], planes.down[r, c], planes.right[r, c])
            top = _NEVER
            for k in range(widths):
                for side in range(16):  # 4 of rows, 4 of columns
                    there, plane = _towards(field.peak[k], r, c, side // 4, side % 4)
                    if not there:
                        continue
                    score = _score(field, r, c, plane, top)
                    if score > top:
                        top = score
                        best = plane
            _set(planes, r, c, best, top)


@part
def _towards(peak: np.ndarray, r: int, c: int, of_rows: int, of_cols: int) -> tuple[bool, _Plane]:
    """Return whether a pixel has neighbours on two sides, and the plane through its peak with
    slopes to them.

    Sides are 0: none, the slope is 0; 1: up or left; 2: down or right; 3: from one to the other.
    """
    up = r - (of_rows % 2)
    low = r + (of_rows // 2)
    left = c - (of_cols % 2)
    far = c + (of_cols // 2)
    if up < 0 or low >= peak.shape[0] or left < 0 or far >= peak.shape[1]:
        return False, _Plane(0.0, 0.0, 0.0)
    down = (peak[low, c] - peak[up, c]) / max(1, low - up)
    right = (peak[r, far] - peak[r, left]) / max(1, far - left)
    return True, _Plane(peak[r, c], down, right)


@part
def _set(planes: Planes, r: int, c: int, plane: _Plane, score: np.float32) -> None:
    """Store the plane of a pixel and its score."""
    planes.time[r, c] = plane.time
    planes.down[r, c] = plane.down
    planes.right[r, c] = plane.right
    planes.score[r, c] = score


@njit(allocates=False)
def _round(
    field: Field, old: Planes, new: Planes, step: float, slope: float, begin: int, end: int
) -> None:
    """Compute the new planes of some rows: the best of the pixel's old one, its neighbours', and
    small steps of it.

    step: ticks. slope: ticks per pixel.
    """
    cols = old.time.shape[1]
    for r in range(begin, end):
        for c in range(cols):
            own = _Plane(old.time[r, c], old.down[r, c], old.right[r, c])
            top = old.score[r, c]
            best, score = _best_of_neighbours(field, old, r, c, own, top)
            best, score = _best_step(field, r, c, best, score, step, slope)
            new.new[r, c] = score > top
            _set(new, r, c, best, score)


@part
def _best_of_neighbours(
    field: Field, planes: Planes, r: int, c: int, best: _Plane, top: np.float32
) -> tuple[_Plane, np.float32]:
    """Return the best of a plane with the score `top` and the neighbours' planes, and its score."""
    rows, cols = planes.time.shape
    for rr in range(max(0, r - 1), min(rows, r + 2)):
        for cc in range(max(0, c - 1), min(cols, c + 2)):
            if (rr == r and cc == c) or not planes.new[rr, cc]:  # tried in the round before
                continue
            plane = _plane_of(field, planes, rr, cc, r, c)
            if _same(plane, best):
                continue
            score = _score(field, r, c, plane, top)
            if score > top:
                top = score
                best = plane
    return best, top


@part
def _same(one: _Plane, other: _Plane) -> bool:
    """Return whether two planes hardly differ at a pixel."""
    return (
        abs(one.time - other.time) < SAME
        and abs(one.down - other.down) < SAME
        and abs(one.right - other.right) < SAME
    )


@part
def _best_step(
    field: Field, r: int, c: int, best: _Plane, top: np.float32, step: float, slope: float
) -> tuple[_Plane, np.float32]:
    """Return the best of a plane with the score `top` and small steps of it, and its score."""
    for _ in range(FINER):
        for j in range(6):  # later and earlier, then the two slopes up and down
            plane = _Plane(
                best.time + step * ((j == 0) - (j == 1)),
                best.down + slope * ((j == 2) - (j == 3)),
                best.right + slope * ((j == 4) - (j == 5)),
            )
            score = _score(field, r, c, plane, top)
            if score > top:
                top = score
                best = plane
        step = step / 2
        slope = slope / 2
    return best, top


def posterior(
    field: Field, planes: Planes, tolerance_ticks: float, blocks: Blocks
) -> tuple[np.ndarray, np.ndarray]:
    """Return (confidence, error), float64[rows, cols]: P(time is within `tolerance_ticks`),
    standard error of the time.

    Both assume that the slopes of the pixel's plane, or of one beside it, are right, and that its
    seed was right. Where the pixel's own light rules out all times near its plane, the confidence
    is 0 and the error NaN.
    """
    confidence = np.zeros(planes.time.shape)
    error = np.full(planes.time.shape, np.nan)
    score = np.empty((len(error), 2 * field.own.shape[2] + 1), np.float32)
    blocks(partial(_posterior, field, planes, tolerance_ticks, confidence, error, score))
    return confidence, error


@njit(allocates=False)
def _posterior(
    field: Field,
    planes: Planes,
    tolerance: float,
    confidence: np.ndarray,
    error: np.ndarray,
    scores: np.ndarray,
    begin: int,
    end: int,
) -> None:
    """Compute confidence and error of some rows.

    tolerance: ticks. scores: workspace, float32[rows, ticks], scores of a pixel's plane at times
    around its own.
    """
    bins = field.own.shape[2]
    cols = planes.time.shape[1]
    for r in range(begin, end):
        for c in range(cols):
            plane = _Plane(planes.time[r, c], planes.down[r, c], planes.right[r, c])
            width = _width(field, plane.down, plane.right)
            place = _place(cols, r, c)
            low, high = _own_scores(field, width, place, plane.time, scores[r])
            if low >= high:
                continue
            score = scores[r, low:high]
            earliest = _Plane(plane.time + low - bins, plane.down, plane.right)
            _add_neighbours(field, field.reach[r, c], place, earliest, width, score)
            cost = _slope_cost(plane.down, plane.right)
            top = _NEVER
            for j in range(len(score)):
                score[j] -= cost
                top = max(top, score[j])
            others = _others(field, planes, r, c, tolerance, top)
            near, variance = _chance_and_variance(score, top, low - bins, tolerance)
            confidence[r, c] = near / (1 + others)
            error[r, c] = np.sqrt(max(0.0, variance) + 1 / 12)


@part
def _own_scores(
    field: Field, width: float, place: int, time: float, scores: np.ndarray
) -> tuple[int, int]:
    """Compute what a pixel itself says about times around `time`, `_NEVER` where it is improbable.

    scores: float32[ticks], the middle one is for `time`. Return the first index that is not
    improbable, and the one after the last.
    """
    bins = field.own.shape[2]
    low = len(scores)
    high = 0
    for j in range(len(scores)):
        there = time + j - bins
        scores[j] = _NEVER
        if _inside(field, width, place, there):
            own = _level(field, field.own, width, place, there)
            if own > IMPROBABLE:
                scores[j] = own
                low = min(low, j)
                high = j + 1
    return low, high


@part
def _chance_and_variance(
    score: np.ndarray, top: np.float32, first: int, tolerance: float
) -> tuple[float, float]:
    """Return the probability that the time is within `tolerance` ticks of 0, and the time's
    variance.

    score: logarithms for times from `first` on, in ticks; top: the highest of them.
    """
    total = 0.0
    near = 0.0
    mean = 0.0
    square = 0.0
    for j in range(len(score)):
        weight = float(fast_exp(np.float32(TRUST) * (score[j] - top)))
        off = float(first + j)
        total += weight
        mean += weight * off
        square += weight * off * off
        near += weight * min(1.0, max(0.0, tolerance + 0.5 - abs(off)))
    return near / total, square / total - (mean / total) ** 2


@part
def _add_neighbours(
    field: Field, reach: int, place: int, plane: _Plane, width: float, score: np.ndarray
) -> None:
    """Add what the neighbours say about planes that begin with one and follow each other by one
    tick.
    """
    k = int(width)
    for j in range(field.number[reach]):
        tap = field.taps[reach, j]
        there = place + tap.place
        if field.first[0, there] == np.inf:
            continue
        by = plane.down * tap.down + plane.right * tap.right
        here = _along(field, plane.time, by)
        last = _along(field, plane.time + len(score), by)
        rate = (last - here) / len(score)  # in perspective it hardly changes
        if rate <= 0:  # beyond the plane's horizon
            continue
        for following in range(2 if width > k else 1):
            share = np.float32(width - k if following else 1 - (width - k))
            _add_width(field, k + following, there, here, rate, tap.weight * share, score)


@part
def _add_width(
    field: Field,
    k: int,
    place: int,
    time: float,
    rate: float,
    weight: np.float32,
    score: np.ndarray,
) -> None:
    """Add what a neighbour says with its bins of width k, from a time on, every `rate` ticks."""
    bins = field.own.shape[2]
    at = _bin(field, k, place, time)
    step = rate * field.scale[k]
    begin = max(0, int(np.ceil(-at / step)))
    end = min(len(score), int(np.ceil((bins - 1 - at) / step)))
    if begin < end:
        first = np.float32(at + begin * step)
        _add_line(field.other[k, place], first, np.float32(step), weight, score[begin:end])


@part
def _add_line(
    line: np.ndarray, at: np.float32, step: np.float32, weight: np.float32, score: np.ndarray
) -> None:
    """Add a line, interpolated from a fractional index on in steps."""
    last = np.int32(len(line) - 2)
    for j in range(len(score)):
        place = at + np.float32(j) * step
        i = min(np.int32(place), last)
        score[j] += weight * (line[i] + (place - np.float32(i)) * (line[i + 1] - line[i]))


@part
def _others(
    field: Field, planes: Planes, r: int, c: int, tolerance: float, top: np.float32
) -> float:
    """Return the odds of the neighbours' planes that pass outside `tolerance`, relative to the
    pixel's own plane.
    """
    rows, cols = planes.time.shape
    odds = 0.0
    for rr in range(max(0, r - 1), min(rows, r + 2)):
        for cc in range(max(0, c - 1), min(cols, c + 2)):
            plane = _plane_of(field, planes, rr, cc, r, c)
            if abs(plane.time - planes.time[r, c]) > tolerance:
                score = _score(field, r, c, plane, _NEVER)
                odds = max(odds, np.exp(TRUST * (score - top)))
    return odds
