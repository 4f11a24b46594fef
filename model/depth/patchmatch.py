# SPDX-License-Identifier: Apache-2.0
"""Planes through the likelihoods of neighbouring pixels: one time and two slopes per pixel, by PatchMatch with fixed steps.

Ref: PatchMatch stereo (Bleyer, Rhemann, Rother 2011), here applied to likelihoods of time. The plane of a pixel is scored
by the pixel's own likelihood and by its neighbours' probabilities on the plane; a neighbour on another surface hardly
matters. In every round, each pixel tries its neighbours' planes and small steps of its own plane. All pixels of a round
see the planes of the previous round.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from ..shared.compiled import njit
from .seeds import Blocks

WIDTHS = 1.3, 2.0, 3.0, 5.0  # pixels: sigma of the Gaussian weight of a pixel's neighbours,
WIDTH_TICKS = 2.0, 4.0, 10.0  # selected by the standard deviation of the pixel's own time: borders between the widths
WEIGHT_MIN = 0.05  # lower weights are left out
HALF = 8  # pixels to the farthest neighbour
ON_PLANE = 30.0  # ticks: odds that a neighbour is on the plane, per probability density of its time there
SLOPE, SLOPE_MAX, SLOPE_COST = 3.0, 80.0, 0.5  # ticks per pixel; a steeper plane is rarer (Cauchy)
ROUNDS = 6
STEP_TICKS, STEP_SLOPE, SHRINK = 4.0, 2.0, 0.6  # first steps, and their factor from round to round
SAME = 1e-6  # ticks: planes that differ by less are the same
FINER = 2  # steps per round, each half of the one before
TRUST = 0.5  # weight of a score: neighbours are not independent, and surfaces are not exactly planes
IMPROBABLE = -30.0  # log likelihood relative to the pixel's best: no neighbours can make up for less
_NEVER = np.float32(-1e9)


class Field(NamedTuple):
    """Likelihoods of the pixels around their seeds.

    own: float32[rows, cols, bins], log likelihood. other: the same shape, what a neighbour adds to a plane's score there.
    first: int64[rows, cols], tick of the first bin. taps: int64[widths, n, 2] and weights: float32[widths, n], the
    neighbours. width: int64[rows, cols], index of the taps that a pixel uses.
    """

    own: np.ndarray
    other: np.ndarray
    first: np.ndarray
    taps: np.ndarray
    weights: np.ndarray
    width: np.ndarray

    @classmethod
    def of(cls, level: np.ndarray, first: np.ndarray) -> "Field":
        own = level - level.max(axis=2, keepdims=True)
        chance = np.exp(own)
        chance /= chance.sum(axis=2, keepdims=True)
        bins = np.arange(level.shape[2], dtype=np.float32)
        mean = chance @ bins
        deviation = np.sqrt(np.maximum(chance @ bins**2 - mean**2, 0))
        reach = np.arange(-HALF, HALF + 1)
        dr, dc = (part.ravel() for part in np.meshgrid(reach, reach, indexing="ij"))
        weights = np.exp(-0.5 * (dr**2 + dc**2) / np.array(WIDTHS)[:, None] ** 2).astype(np.float32)
        weights[:, (dr == 0) & (dc == 0)] = 0
        order = np.argsort(-weights, axis=1, kind="stable")
        taps = np.stack([dr, dc], axis=1)[order]
        weights = np.take_along_axis(weights, order, 1)
        weights[weights < WEIGHT_MIN] = 0
        return cls(
            own, np.log1p(np.float32(ON_PLANE) * chance), first, taps, weights, np.searchsorted(WIDTH_TICKS, deviation)
        )


class Planes(NamedTuple):
    """Plane of each pixel, float64[rows, cols]: time in ticks, and slopes in ticks per pixel."""

    time: np.ndarray
    down: np.ndarray
    right: np.ndarray


def fit_planes(field: Field, blocks: Blocks) -> Planes:
    """Fit the planes of all pixels. blocks: calls a function for (begin, end) of blocks of rows, in any order."""
    rows, cols, _ = field.own.shape
    peak = field.first + field.own.argmax(axis=2) + 0.5
    planes, tried = (Planes(*(np.zeros((rows, cols)) for _ in range(3))) for _ in range(2))
    blocks(partial(_start, field, peak, planes))
    step, slope = STEP_TICKS, STEP_SLOPE
    for _ in range(ROUNDS):
        blocks(partial(_round, field, planes, tried, step, slope))
        planes, tried = tried, planes
        step, slope = step * SHRINK, slope * SHRINK
    return planes


@njit(inline="always")
def _between(line, at):
    """Interpolate linearly at a fractional index; return a never-winning value outside."""
    k = int(np.floor(at))
    if k < 0 or k >= len(line) - 1:
        return np.float32(0.0)
    share = np.float32(at - k)
    return (1 - share) * line[k] + share * line[k + 1]


@njit
def _score(field, r, c, time, down, right):
    """Return the score of a plane at pixel (r, c) and around it."""
    rows, cols, bins = field.own.shape
    at = time - field.first[r, c] - 0.5
    if not 0 <= at < bins - 1 or abs(down) > SLOPE_MAX or abs(right) > SLOPE_MAX:
        return _NEVER
    total = _between(field.own[r, c], at)
    total -= np.float32(SLOPE_COST * np.log((1 + (down / SLOPE) ** 2) * (1 + (right / SLOPE) ** 2)))
    width = field.width[r, c]
    for j in range(field.weights.shape[1]):
        weight = field.weights[width, j]
        if weight == 0:
            break
        rr, cc = r + field.taps[width, j, 0], c + field.taps[width, j, 1]
        if 0 <= rr < rows and 0 <= cc < cols:
            here = time + down * (rr - r) + right * (cc - c)
            total += weight * _between(field.other[rr, cc], here - field.first[rr, cc] - 0.5)
    return total


@njit
def _start(field, peak, planes, begin, end):
    """Start each pixel at its likeliest time, with the best of the slopes towards its neighbours."""
    rows, cols = peak.shape
    for r in range(begin, end):
        for c in range(cols):
            top = _NEVER
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
                    score = _score(field, r, c, peak[r, c], down, right)
                    if score > top or not i + j:
                        top = score
                        planes.time[r, c], planes.down[r, c], planes.right[r, c] = peak[r, c], down, right


@njit
def _round(field, old, new, step, slope, begin, end):
    rows, cols = old.time.shape
    for r in range(begin, end):
        for c in range(cols):
            time, down, right = old.time[r, c], old.down[r, c], old.right[r, c]
            top = _score(field, r, c, time, down, right)
            for rr in range(max(0, r - 1), min(rows, r + 2)):
                for cc in range(max(0, c - 1), min(cols, c + 2)):
                    if rr == r and cc == c:
                        continue
                    a, b = old.down[rr, cc], old.right[rr, cc]
                    t = old.time[rr, cc] - a * (rr - r) - b * (cc - c)
                    if abs(t - time) < SAME and abs(a - down) < SAME and abs(b - right) < SAME:
                        continue
                    score = _score(field, r, c, t, a, b)
                    if score > top:
                        top, time, down, right = score, t, a, b
            by, tilt = step, slope
            for _ in range(FINER):
                for j in range(6):
                    t = time + by * ((j == 0) - (j == 1))
                    a, b = down + tilt * ((j == 2) - (j == 3)), right + tilt * ((j == 4) - (j == 5))
                    score = _score(field, r, c, t, a, b)
                    if score > top:
                        top, time, down, right = score, t, a, b
                by, tilt = by / 2, tilt / 2
            new.time[r, c], new.down[r, c], new.right[r, c] = time, down, right


def posterior(field: Field, planes: Planes, tolerance_ticks: float, blocks: Blocks) -> tuple[np.ndarray, np.ndarray]:
    """Return (confidence, error), float64[rows, cols]: P(time is within `tolerance_ticks`), standard error of the time.

    Both assume that the slopes of the pixel's plane, or of one beside it, are right, and that its seed was right.
    """
    confidence, error = np.zeros(planes.time.shape), np.full(planes.time.shape, np.nan)
    blocks(partial(_posterior, field, planes, tolerance_ticks, confidence, error))
    return confidence, error


@njit
def _posterior(field, planes, tolerance, confidence, error, begin, end):
    bins = field.own.shape[2]
    score = np.empty(2 * bins + 1, np.float64)
    for r in range(begin, end):
        for c in range(planes.time.shape[1]):
            time = planes.time[r, c]
            top = -1e30
            for j in range(2 * bins + 1):
                at = time + j - bins - field.first[r, c] - 0.5
                score[j] = _NEVER
                if 0 <= at < bins - 1 and _between(field.own[r, c], at) > IMPROBABLE:
                    score[j] = _score(field, r, c, time + j - bins, planes.down[r, c], planes.right[r, c])
                top = max(top, score[j])
            others = _others(field, planes, r, c, tolerance, top)
            total, near, mean, square = 0.0, 0.0, 0.0, 0.0
            for j in range(2 * bins + 1):
                weight, off = np.exp(TRUST * (score[j] - top)), float(j - bins)
                total += weight
                mean += weight * off
                square += weight * off * off
                near += weight * min(1.0, max(0.0, tolerance + 0.5 - abs(off)))
            confidence[r, c] = near / total / (1 + others)
            error[r, c] = np.sqrt(max(0.0, square / total - (mean / total) ** 2) + 1 / 12)


@njit
def _others(field, planes, r, c, tolerance, top):
    """Return the probability, relative to the pixel's own plane, of neighbours' planes that pass outside `tolerance`."""
    rows, cols = planes.time.shape
    odds = 0.0
    for rr in range(max(0, r - 1), min(rows, r + 2)):
        for cc in range(max(0, c - 1), min(cols, c + 2)):
            down, right = planes.down[rr, cc], planes.right[rr, cc]
            time = planes.time[rr, cc] - down * (rr - r) - right * (cc - c)
            if abs(time - planes.time[r, c]) > tolerance:
                odds = max(odds, np.exp(TRUST * (_score(field, r, c, time, down, right) - top)))
    return odds
