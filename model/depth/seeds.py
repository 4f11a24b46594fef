# SPDX-License-Identifier: Apache-2.0
"""Seeds: the approximate time of each pixel's surface, chosen by the pixel together with its
neighbours.

All of this is our own choice. A pixel's candidates are the highest peaks of its own likelihood and
the previous choices of its neighbours. In the first round, a neighbour supports a candidate by its
own likelihood, within limits. In later rounds it supports its own choice, with a weight that grows
with the similarity of the light of both. A pixel without a hit supports the darkest of the surfaces
beside it.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from ..shared.compiled import njit, part
from . import portable
from .vector_math import fast_exp, fast_log, top_of

# Calls a function for (begin, end) of blocks of rows, in any order.
Blocks = Callable[[Callable[[int, int], None]], object]

BLOCK = 64  # bins that are passed together if none of them is high enough
CANDIDATES = 6  # from a pixel's own likelihood
NEAR = 2  # pixels to the farthest neighbour
WIDTH = 1.0  # pixels: sigma of the Gaussian weight of the neighbours
KEPT = 8  # candidates kept after a round,
PROBABLE = 1e-3  # if they are at least that probable
LEVEL_MIN = 0.5  # log likelihood ratio of a pixel's own candidate, at least
SLACK = 1  # bins by which a surface may shift from pixel to pixel
LEAST = -1.0  # limits of a neighbour's support in the first round
MOST = 4.0
AGREE = 30.0  # odds by which a neighbour's choice counts in later rounds, times `ALIKE`
# By the difference of the lights' indices; the last one is for all larger differences.
ALIKE = np.array([1.5, 1.2, 0.7, 0.4, 0.3, 0.2], np.float32)
ROUNDS = 5
STILL = 0.01  # a pixel whose probabilities changed by less has not changed
_NEVER = np.float32(-1e9)
_REACH = np.arange(-NEAR, NEAR + 1)
_WEIGHT = portable.exp(-0.5 * (_REACH[:, None] ** 2 + _REACH**2) / WIDTH**2).astype(np.float32)
_MOST_LATER = math.log1p(AGREE * ALIKE.max())
_SUPPORT_MAX = np.float32((_WEIGHT.sum() - 1) * max(MOST, _MOST_LATER))  # from all neighbours
_HOPELESS = np.float32(math.log(PROBABLE))  # log likelihood ratio to the best candidate


class Seeds(NamedTuple):
    """Candidates of the pixels, [rows, cols, KEPT], the likeliest first."""

    bins: np.ndarray  # int64, -1 = none
    chances: np.ndarray  # float32, their probabilities

    @property
    def bin(self) -> np.ndarray:
        """int64[rows, cols]: the pixels' choices, -1 without a candidate."""
        return self.bins[:, :, 0]

    def time(self, step: int) -> np.ndarray:
        """float64[rows, cols]: middle of the chosen bin of `step` ticks; NaN: no candidate."""
        return np.where(self.bin < 0, np.nan, (self.bin + 0.5) * step)

    def chance(self, reach: int) -> np.ndarray:
        """float32[rows, cols]: total probability of the candidates within `reach` bins of the
        choice.
        """
        near = (np.abs(self.bins - self.bin[:, :, None]) <= reach) & (self.bins >= 0)
        return np.minimum(1, np.where(near, self.chances, 0).sum(axis=2))


class _Seen(NamedTuple):
    """Likelihoods of the pixels, [rows, cols, bins]."""

    level: np.ndarray  # float32
    light: np.ndarray  # uint8, index of each bin's likeliest light


class _Round(NamedTuple):
    """What a round reads and writes."""

    first: (
        bool  # the first round asks for the neighbours' likelihoods, later ones for their choices
    )
    old: Seeds
    new: Seeds
    changed: np.ndarray  # bool[rows, cols], pixels that changed in the round before
    changing: np.ndarray  # bool[rows, cols], pixels that change in this round


def find_seeds(level: np.ndarray, light: np.ndarray, blocks: Blocks) -> Seeds:
    """Find the seeds.

    level: float32[rows, cols, bins]. light: uint8 of the same shape, each bin's likeliest light.
    """
    rows, cols, _ = level.shape
    seen = _Seen(level, light)
    old = _no_seeds(rows, cols)
    new = _no_seeds(rows, cols)
    changed = np.ones((rows, cols), bool)
    changing = np.ones((rows, cols), bool)
    blocks(partial(_own, level, old.bins))
    for k in range(ROUNDS):
        first = k == 0
        blocks(partial(_round, seen, _Round(first, old, new, changed, changing)))
        old, new = new, old
        if not first:  # the second round asks other questions, of all pixels
            changed, changing = changing, changed
    return old


def _no_seeds(rows: int, cols: int) -> Seeds:
    """Return room for the candidates of the pixels."""
    shape = (rows, cols, KEPT)
    return Seeds(np.full(shape, -1, np.int64), np.zeros(shape, np.float32))


def seed_scores(level: np.ndarray, light: np.ndarray, seeds: Seeds, blocks: Blocks) -> np.ndarray:
    """float32[rows, cols]: log likelihood ratio of the pixels' choices to seeing nothing.

    It includes the neighbours' support within limits, and is 0 without a candidate. level, light:
    as in `find_seeds`.
    """
    score = np.zeros(seeds.bin.shape, np.float32)
    blocks(partial(_score, _Seen(level, light), seeds, score))
    return score


@njit
def _own(level: np.ndarray, bins: np.ndarray, begin: int, end: int) -> None:
    """Find the highest peaks of each pixel of some rows, in descending order."""
    height = np.empty(CANDIDATES, np.float32)
    for r in range(begin, end):
        for c in range(level.shape[1]):
            _find_peaks(level[r, c], height, bins[r, c])


@part
def _find_peaks(line: np.ndarray, height: np.ndarray, at: np.ndarray) -> None:
    """Write the bins of a line's highest peaks to `at`. height: workspace, the peaks' values."""
    times = len(line)
    number = 0
    for block in range(0, times, BLOCK):
        until = min(times, block + BLOCK)
        least = height[CANDIDATES - 1] if number == CANDIDATES else np.float32(LEVEL_MIN)
        if top_of(line[block:until]) <= least:
            continue
        for k in range(block, until):
            value = line[k]
            if value <= LEVEL_MIN or (number == CANDIDATES and value <= height[number - 1]):
                continue
            if _is_peak(line, k):
                number = _insert(height, at, number, value, k)


@part
def _is_peak(line: np.ndarray, k: int) -> bool:
    """Return whether no neighbour of bin k is higher; of two equal ones, the latter counts."""
    if k and line[k - 1] > line[k]:
        return False
    return not (k + 1 < len(line) and line[k + 1] >= line[k])


@part
def _insert(height: np.ndarray, at: np.ndarray, number: int, value: np.float32, k: int) -> int:
    """Insert a peak into the descending heights of so many; the lowest falls out.

    Return their number.
    """
    j = min(number, CANDIDATES - 1)
    while j > 0 and height[j - 1] < value:
        height[j] = height[j - 1]
        at[j] = at[j - 1]
        j -= 1
    height[j] = value
    at[j] = k
    return min(number + 1, CANDIDATES)


@njit
def _round(seen: _Seen, job: _Round, begin: int, end: int) -> None:
    """Compute the new candidates of the pixels of some rows.

    They come from the old ones and the neighbours' likeliest. A pixel stays as it is if no pixel
    near it has changed in the round before.
    """
    old = job.old
    new = job.new
    at = np.empty(KEPT + (2 * NEAR + 1) ** 2, np.int64)
    total = np.empty(len(at), np.float32)
    for r in range(begin, end):
        for c in range(seen.level.shape[1]):
            if not _any_near(job.changed, r, c):
                job.changing[r, c] = False
                _stay(old, new, r, c)
                continue
            number = _gather(old.bins, r, c, at)
            top = _weigh(seen, old, job.first, r, c, at, number, total)
            _choose(at, number, total, top, new.bins[r, c], new.chances[r, c])
            job.changing[r, c] = _has_changed(old, new, r, c)


@part
def _any_near(flags: np.ndarray, r: int, c: int) -> bool:
    """Return whether a flag is set at most `NEAR` pixels from (r, c)."""
    for rr in range(max(0, r - NEAR), min(flags.shape[0], r + NEAR + 1)):
        for cc in range(max(0, c - NEAR), min(flags.shape[1], c + NEAR + 1)):
            if flags[rr, cc]:
                return True
    return False


@part
def _stay(old: Seeds, new: Seeds, r: int, c: int) -> None:
    """Keep the candidates of a pixel."""
    for j in range(KEPT):
        new.bins[r, c, j] = old.bins[r, c, j]
        new.chances[r, c, j] = old.chances[r, c, j]


@part
def _gather(bins: np.ndarray, r: int, c: int, at: np.ndarray) -> int:
    """Write a pixel's candidates to `at`: the old ones, and the neighbours' likeliest.

    Return their number.
    """
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
def _weigh(
    seen: _Seen,
    seeds: Seeds,
    first: bool,
    r: int,
    c: int,
    at: np.ndarray,
    number: int,
    total: np.ndarray,
) -> np.float32:
    """Compute the support for so many candidates of pixel (r, c), `_NEVER` if hopeless.

    Return the highest.
    """
    top = _NEVER
    for n in range(number):
        total[n] = _support(seen, seeds, first, r, c, at[n], top + _HOPELESS)
        top = max(top, total[n])
    return top


@part
def _choose(
    at: np.ndarray,
    number: int,
    total: np.ndarray,
    top: np.float32,
    bins: np.ndarray,
    chances: np.ndarray,
) -> None:
    """Write the most probable of so many candidates, the likeliest first. `total` is used up."""
    whole = np.float32(0)
    for n in range(number):
        whole += fast_exp(total[n] - top)
    for j in range(KEPT):
        bins[j] = -1
        chances[j] = 0
        best = 0
        for n in range(number):
            if total[n] > total[best]:
                best = n
        if not number or total[best] == _NEVER:
            continue
        chance = fast_exp(total[best] - top) / whole
        if chance > PROBABLE:
            bins[j] = at[best]
            chances[j] = chance
        total[best] = _NEVER


@part
def _has_changed(old: Seeds, new: Seeds, r: int, c: int) -> bool:
    """Return whether a pixel's candidates or their probabilities have changed."""
    changed = False
    for j in range(KEPT):
        changed |= abs(new.chances[r, c, j] - old.chances[r, c, j]) > STILL
        changed |= new.bins[r, c, j] != old.bins[r, c, j]
    return changed


@njit(allocates=False)
def _score(seen: _Seen, seeds: Seeds, score: np.ndarray, begin: int, end: int) -> None:
    """Compute `seed_scores` of some rows."""
    for r in range(begin, end):
        for c in range(score.shape[1]):
            chosen = seeds.bins[r, c, 0]
            if chosen >= 0:
                score[r, c] = _support(seen, seeds, True, r, c, chosen, _NEVER)


@part
def _support(
    seen: _Seen, seeds: Seeds, first: bool, r: int, c: int, k: int, least: np.float32
) -> np.float32:
    """Return the support for candidate k of pixel (r, c), from its own likelihood and its
    neighbours.

    It may return less than it is if it is below `least`. first: ask for the neighbours'
    likelihoods, not for their choices.
    """
    rows, cols, _ = seen.level.shape
    total = _highest(seen.level[r, c], k, 1)
    if total + _SUPPORT_MAX < least:
        return _NEVER
    light = np.int64(seen.light[r, c, k])
    for rr in range(max(0, r - NEAR), min(rows, r + NEAR + 1)):
        for cc in range(max(0, c - NEAR), min(cols, c + NEAR + 1)):
            if rr == r and cc == c:
                continue
            slack = SLACK * max(abs(rr - r), abs(cc - c))
            if first:
                highest = _highest(seen.level[rr, cc], k, slack)
                says = min(np.float32(MOST), max(np.float32(LEAST), highest))
            else:
                odds = _odds(seen, seeds, rr, cc, k, slack, light)
                says = fast_log(np.float32(1) + np.float32(AGREE) * odds)
            total += _WEIGHT[rr - r + NEAR, cc - c + NEAR] * says
    return total


@part
def _odds(
    seen: _Seen, seeds: Seeds, r: int, c: int, k: int, slack: int, light: np.int64
) -> np.float32:
    """Return the probability of pixel (r, c)'s candidates near bin k, weighted by how alike the
    lights are.
    """
    odds = np.float32(0)
    j = 0
    while j < KEPT and seeds.bins[r, c, j] >= 0:
        there = seeds.bins[r, c, j]
        if abs(there - k) <= slack:
            apart = abs(np.int64(seen.light[r, c, there]) - light)
            apart = min(apart, np.int64(len(ALIKE) - 1))
            odds += seeds.chances[r, c, j] * ALIKE[apart]
        j += 1
    return odds


@part
def _highest(line: np.ndarray, k: int, reach: int) -> np.float32:
    """Return the highest value of a line within `reach` bins of bin k."""
    best = _NEVER
    for j in range(max(0, k - reach), min(len(line), k + reach + 1)):
        best = max(best, line[j])
    return best
