# SPDX-License-Identifier: Apache-2.0
"""What the count of an event says, if the event names no pixel but the winner (format short).

A window counts only if enough pixels fire in it. So the winners of the windows that count are early
on average: an early photon leaves more time for the others. Surfaces from these stamps alone lean
towards the sensor. How many others fired says how early the winner was. If its surface is at another
time than the guess, the surfaces of the others in its subgroup are taken to be off by as much. The
pixel may be alone with that, though: this bounds how much less likely a time gets.

All of this is our own choice.
"""

from typing import NamedTuple

import numpy as np

from ..shared.compiled import njit, part
from . import portable
from .pulse_ticks import PulseTicks

ALONE = 0.1  # share of the pixels whose surface is off by another time than those of the others
MOST = 3.0  # log likelihood ratio of a time to that of the guess, at most
GUESS_ERROR = 0.3  # of the number of others that fire in a window, relative
VARIANCE_LEAST = 1e-6  # squared pixels


class OwnWindows(NamedTuple):
    """The windows of a subgroup that were committed."""

    stamp: np.ndarray  # int64[n], ticks
    winner: np.ndarray  # int64[n]
    others: np.ndarray  # int64[n], pixels that fired in the window, without the winner


class _Hits(NamedTuple):
    """Pixels that fire in a window from a tick on, as the guess has it."""

    origin: int  # first tick
    mean: np.ndarray  # float64[ticks], number of all pixels
    variance: np.ndarray  # float64[ticks]
    background: float  # chance of a pixel in the dark
    begin: np.ndarray  # int64[pixels], number of a pixel's first tick with light
    chance: np.ndarray  # float64[pixels, span], of a pixel, from there on


def moves_with_others(
    windows: OwnWindows,
    window: int,
    pulse: PulseTicks,
    noise: float,
    alive: float,
    mask: np.ndarray,
    time: np.ndarray,
    light: np.ndarray,
    times: np.ndarray,
) -> np.ndarray:
    """float32[pixels, bins]: log likelihood ratio of each pixel's times to that of the guess, from
    the counts of the windows that it won; 0 for a pixel without a guess.

    window: ticks. noise: background photons per tick and pixel. alive: share of the pulses in which
    background has not fired a pixel yet. mask: bool[pixels]. time, light: float64[pixels], guess:
    ticks, NaN = unknown, and photons per pulse. times: float64[pixels, bins], ticks.
    """
    known = mask & ~np.isnan(time)
    middle = np.where(known, time, 0.0)
    brightness = np.where(known, light, 0.0)
    begin = np.floor(middle).astype(np.int64) - pulse.reach - window
    ticks = begin[:, None] + np.arange(2 * (pulse.reach + window + 1))
    share = pulse.share_before(ticks - middle[:, None])
    fired = -alive * portable.expm1(-brightness[:, None] * share)
    by_light = (fired[:, window:] - fired[:, :-window]) / (1 - fired[:, :-window])
    background = min(1.0, noise * window)
    hits = _hits(mask, begin, by_light, background)
    later = times - middle[:, None]
    moves = np.zeros(times.shape)
    at_guess = np.maximum(0, np.count_nonzero(later <= 0, axis=1) - 1)
    _add_windows(_grouped(windows, known), hits, at_guess, later, moves)
    together = (1 - ALONE) * portable.exp(np.minimum(MOST, moves))
    return portable.log(ALONE + together).astype(np.float32)


def _hits(mask: np.ndarray, begin: np.ndarray, by_light: np.ndarray, background: float) -> _Hits:
    """Return the hits in windows.

    begin: int64[pixels], first tick of by_light, float64[pixels, span], the chances of hits by
    light.
    """
    span = by_light.shape[1]
    origin = int(begin.min())
    chance = np.minimum(1.0, background + by_light)
    at = (begin - origin)[mask, None] + np.arange(span)
    pixels = np.count_nonzero(mask)
    mean = np.full(int(begin.max()) - origin + span, pixels * background)
    variance = mean * (1 - background)
    np.add.at(mean, at, chance[mask] - background)
    np.add.at(variance, at, chance[mask] * (1 - chance[mask]) - background * (1 - background))
    return _Hits(origin, mean, variance, background, begin - origin, chance)


class _Alike(NamedTuple):
    """Windows of a subgroup, those with the same stamp, winner and number of others as one."""

    stamp: np.ndarray  # int64[k], ticks
    winner: np.ndarray  # int64[k]
    others: np.ndarray  # int64[k]
    number: np.ndarray  # int64[k], of windows


def _grouped(windows: OwnWindows, known: np.ndarray) -> _Alike:
    """Return the windows that a pixel with a guess has won.

    known: bool[pixels], has the pixel a guess?
    """
    mine = known[windows.winner]
    columns = np.stack([column[mine] for column in windows], axis=1)
    alike, number = np.unique(columns, axis=0, return_counts=True)
    stamp, winner, others = np.ascontiguousarray(alike.T)
    return _Alike(stamp, winner, others, number)


@njit
def _add_windows(
    windows: _Alike, hits: _Hits, at_guess: np.ndarray, later: np.ndarray, moves: np.ndarray
) -> None:
    """Add what the windows say about the times of their winners to `moves`.

    Later surfaces are like an earlier stamp. The ratio is the integral of the slope that the log
    likelihood of a number with this mean and variance has over its mean, from the guess on.

    at_guess: int64[pixels], bin of the guess. later: float64[pixels, bins], ticks from the guess to
    each time.
    """
    for e in range(len(windows.stamp)):
        i = windows.winner[e]
        stamp = windows.stamp[e] - hits.origin
        at_first, _ = _others(hits, i, stamp - later[i, at_guess[i]])
        for direction in (1, -1):
            ratio = 0.0
            before = at_first
            k = at_guess[i] + direction
            while 0 <= k < later.shape[1]:
                mean, variance = _others(hits, i, stamp - later[i, k])
                off = windows.others[e] - (before + mean) / 2
                ratio += off / variance * (mean - before)
                moves[i, k] += windows.number[e] * ratio
                before = mean
                k += direction


@part
def _others(hits: _Hits, i: int, tick: float) -> tuple[float, float]:
    """Return how many pixels except i fire in a window from a tick on: mean and variance, which
    includes the error of the guess.
    """
    whole = int(np.floor(tick))
    mean = 0.0
    variance = 0.0
    for k in range(2):
        at = min(max(whole + k, 0), len(hits.mean) - 1)
        share = tick - whole if k else whole + 1 - tick
        own = hits.background
        if 0 <= at - hits.begin[i] < hits.chance.shape[1]:
            own = hits.chance[i, at - hits.begin[i]]
        mean += share * (hits.mean[at] - own)
        variance += share * (hits.variance[at] - own * (1 - own))
    return mean, max(VARIANCE_LEAST, variance) + (GUESS_ERROR * mean) ** 2
