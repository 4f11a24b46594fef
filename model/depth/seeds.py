# SPDX-License-Identifier: Apache-2.0
"""Seeds: the approximate time of each pixel's surface, chosen by the pixel together with its neighbours.

All of this is our own choice. A pixel's candidates are the highest peaks of its own likelihood and the previous choices
of its neighbours. In the first round, a neighbour supports a candidate by its own likelihood, within limits. In later
rounds it supports its own choice, with a weight that grows with the similarity of the light of both. A pixel without a
hit supports the darkest of the surfaces beside it.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from ..shared.compiled import njit, part
from . import portable
from .vector_math import fast_exp, fast_log, top_of

Blocks = Callable[[Callable[[int, int], None]], object]  # calls a function for (begin, end) of rows, in any order

BLOCK = 64  # bins that are passed together if none of them is high enough
CANDIDATES = 6  # from a pixel's own likelihood
NEAR = 2  # pixels to the farthest neighbour
WIDTH = 1.0  # pixels: sigma of the Gaussian weight of the neighbours
KEPT = 8  # candidates kept after a round,
PROBABLE = 1e-3  # if they are at least that probable
LEVEL_MIN = 0.5  # log likelihood ratio of a pixel's own candidate, at least
SLACK = 1  # bins by which a surface may shift from pixel to pixel
LEAST, MOST = -1.0, 4.0  # limits of a neighbour's support in the first round
AGREE = 30.0  # odds by which a neighbour's choice counts in later rounds,
# multiplied by this, by the difference of the lights' indices; the last is for all larger ones
ALIKE = np.array([1.5, 1.2, 0.7, 0.4, 0.3, 0.2], np.float32)
ROUNDS = 5
STILL = 0.01  # a pixel whose probabilities changed by less has not changed
_NEVER = np.float32(-1e9)
_REACH = np.arange(-NEAR, NEAR + 1)
_WEIGHT = portable.exp(-0.5 * (_REACH[:, None] ** 2 + _REACH**2) / WIDTH**2).astype(np.float32)
_SUPPORT_MAX = np.float32((_WEIGHT.sum() - 1) * max(MOST, math.log1p(AGREE * ALIKE.max())))  # from all neighbours
_HOPELESS = np.float32(math.log(PROBABLE))  # log likelihood ratio to the best candidate


class Seeds(NamedTuple):
    """Choices of the pixels.

    bin: int64[rows, cols], -1 without a candidate. others: (bins, probabilities) of all candidates, int64 and float32
    [rows, cols, KEPT], the likeliest first, -1 = none.
    """

    bin: np.ndarray
    others: tuple[np.ndarray, np.ndarray]

    def time(self, step: int) -> np.ndarray:
        """float64[rows, cols]: middle of the chosen bin of `step` ticks, NaN without a candidate."""
        return np.where(self.bin < 0, np.nan, (self.bin + 0.5) * step)

    def chance(self, reach: int) -> np.ndarray:
        """float32[rows, cols]: total probability of the candidates within `reach` bins of the choice."""
        bins, chances = self.others
        near = (np.abs(bins - self.bin[:, :, None]) <= reach) & (bins >= 0)
        return np.minimum(1, np.where(near, chances, 0).sum(axis=2))


def find_seeds(level: np.ndarray, light: np.ndarray, blocks: Blocks) -> Seeds:
    """Find the seeds from level, float32[rows, cols, bins], and each bin's likeliest light, uint8 of the same shape."""
    rows, cols, _ = level.shape
    bins, tried = (np.full((rows, cols, KEPT), -1, np.int64) for _ in range(2))
    chances, chance = (np.zeros((rows, cols, KEPT), np.float32) for _ in range(2))
    changed, changing = np.ones((rows, cols), bool), np.ones((rows, cols), bool)
    blocks(partial(_own, level, bins))
    for k in range(ROUNDS):
        blocks(partial(_round, level, light, bins, chances, not k, changed, tried, chance, changing))
        bins, chances, tried, chance = tried, chance, bins, chances
        if k:  # the first round asks other questions
            changed, changing = changing, changed
    return Seeds(bins[:, :, 0], (bins, chances))


def seed_scores(level: np.ndarray, light: np.ndarray, seeds: Seeds, blocks: Blocks) -> np.ndarray:
    """float32[rows, cols]: log likelihood ratio of the pixels' choices to seeing nothing, 0 without a candidate.

    It includes the neighbours' support within limits.
    """
    score = np.zeros(seeds.bin.shape, np.float32)
    blocks(partial(_score, level, light, *seeds.others, score))
    return score


@njit
def _own(level, bins, begin, end):
    """Find the highest peaks of each pixel, in descending order."""
    cols, times = level.shape[1:]
    height = np.empty(CANDIDATES, np.float32)
    for r in range(begin, end):
        for c in range(cols):
            line, at = level[r, c], bins[r, c]
            number = 0
            for block in range(0, times, BLOCK):
                until = min(times, block + BLOCK)
                least = height[CANDIDATES - 1] if number == CANDIDATES else np.float32(LEVEL_MIN)
                if top_of(line[block:until]) <= least:
                    continue
                for k in range(block, until):
                    v = line[k]
                    if v <= LEVEL_MIN or number == CANDIDATES and v <= height[number - 1]:
                        continue
                    if k and line[k - 1] > v or k + 1 < times and line[k + 1] >= v:
                        continue
                    j = min(number, CANDIDATES - 1)
                    while j > 0 and height[j - 1] < v:
                        height[j], at[j] = height[j - 1], at[j - 1]
                        j -= 1
                    height[j], at[j] = v, k
                    number = min(number + 1, CANDIDATES)


@njit
def _round(level, light, bins, chances, first, changed, new_bins, new_chances, changing, begin, end):
    """Compute each pixel's new candidates, the likeliest first, from the old ones and the neighbours' likeliest.

    A pixel stays as it is if no pixel near it has changed in the round before.
    """
    rows, cols, _ = level.shape
    at = np.empty(KEPT + (2 * NEAR + 1) ** 2, np.int64)
    total = np.empty(len(at), np.float32)
    for r in range(begin, end):
        for c in range(cols):
            changing[r, c] = False
            for j in range(KEPT):
                new_bins[r, c, j], new_chances[r, c, j] = bins[r, c, j], chances[r, c, j]
            if not _any_near(changed, r, c):
                continue
            number = _gather(bins, r, c, at)
            top = _NEVER
            for n in range(number):
                total[n] = _support(level, light, bins, chances, first, r, c, at[n], top + _HOPELESS)
                top = max(top, total[n])
            whole = np.float32(0)
            for n in range(number):
                whole += fast_exp(total[n] - top)
            for j in range(KEPT):
                new_bins[r, c, j], new_chances[r, c, j] = -1, 0
                best = 0
                for n in range(number):
                    if total[n] > total[best]:
                        best = n
                if not number or total[best] == _NEVER:
                    continue
                chance = fast_exp(total[best] - top) / whole
                if chance > PROBABLE:
                    new_bins[r, c, j], new_chances[r, c, j] = at[best], chance
                total[best] = _NEVER
            for j in range(KEPT):
                moved = abs(new_chances[r, c, j] - chances[r, c, j]) > STILL
                changing[r, c] |= moved or new_bins[r, c, j] != bins[r, c, j]


@part
def _any_near(flags, r, c):
    """Return whether a flag is set at most `NEAR` pixels from (r, c)."""
    for rr in range(max(0, r - NEAR), min(flags.shape[0], r + NEAR + 1)):
        for cc in range(max(0, c - NEAR), min(flags.shape[1], c + NEAR + 1)):
            if flags[rr, cc]:
                return True
    return False


@njit(allocates=False)
def _score(level, light, bins, chances, score, begin, end):
    """Compute `seed_scores` of some rows."""
    for r in range(begin, end):
        for c in range(level.shape[1]):
            if bins[r, c, 0] >= 0:
                score[r, c] = _support(level, light, bins, chances, True, r, c, bins[r, c, 0], _NEVER)


@part
def _gather(bins, r, c, at):
    """Return the number of a pixel's candidates and write them to `at`: the old ones, and the neighbours' likeliest."""
    rows, cols, _ = bins.shape
    number = 0
    while number < KEPT and bins[r, c, number] >= 0:
        at[number] = bins[r, c, number]
        number += 1
    for rr in range(max(0, r - NEAR), min(rows, r + NEAR + 1)):
        for cc in range(max(0, c - NEAR), min(cols, c + NEAR + 1)):
            k = bins[rr, cc, 0]
            new = k >= 0
            for i in range(number):
                new &= abs(at[i] - k) > SLACK
            if new:
                at[number] = k
                number += 1
    return number


@part
def _support(level, light, bins, chances, first, r, c, k, least):
    """Return the support for candidate k of pixel (r, c), from its own likelihood and from its neighbours.

    It may return less than it is if it is below `least`.
    """
    rows, cols, times = level.shape
    total = _highest(level[r, c], k, 1)
    if total + _SUPPORT_MAX < least:
        return _NEVER
    own = np.int64(light[r, c, k])
    for rr in range(max(0, r - NEAR), min(rows, r + NEAR + 1)):
        for cc in range(max(0, c - NEAR), min(cols, c + NEAR + 1)):
            if rr == r and cc == c:
                continue
            slack = SLACK * max(abs(rr - r), abs(cc - c))
            if first:
                says = min(np.float32(MOST), max(np.float32(LEAST), _highest(level[rr, cc], k, slack)))
            else:
                odds = np.float32(0)
                j = 0
                while j < KEPT and bins[rr, cc, j] >= 0:
                    there = bins[rr, cc, j]
                    if abs(there - k) <= slack:
                        apart = abs(np.int64(light[rr, cc, there]) - own)
                        apart = min(apart, np.int64(len(ALIKE) - 1))
                        odds += chances[rr, cc, j] * ALIKE[apart]
                    j += 1
                says = fast_log(np.float32(1) + np.float32(AGREE) * odds)
            total += _WEIGHT[rr - r + NEAR, cc - c + NEAR] * says
    return total


@part
def _highest(line, k, reach):
    """Return the highest value of a line within `reach` bins of bin k."""
    best = _NEVER
    for j in range(max(0, k - reach), min(len(line), k + reach + 1)):
        best = max(best, line[j])
    return best
