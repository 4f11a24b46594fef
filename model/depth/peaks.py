# SPDX-License-Identifier: Apache-2.0
"""Peaks of pixel histograms: the paper's estimator (IV), and filtered ones, which are our own choice."""

import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from ..contract.config import Config
from ..contract.latency import armed_cycle, close_cycle
from ..contract.parameters import Sensor
from ..shared.compiled import njit, part
from . import portable
from .histograms import Events

FILTER_SIGMAS = 4.0  # half width of the matched filter
NEAR_SIGMAS = 1.5  # half width of the bins that determine the centre of a peak
APART_SIGMAS = 4.0  # distance between the returns of a pixel
ACCIDENT_MAX = 0.01  # probability that a second or further return is background
LIVE_MIN = 0.05  # share of periods; below it, pile-up cannot be corrected


def pixel_peaks(
    histogram: np.ndarray,
    method: str,
    live: np.ndarray | None,
    sigma_ticks: float,
    returns: int,
    *,
    group: np.ndarray | None = None,
    step_ticks: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """Return (ticks, confidence), each float64[pixels, returns], from int32[pixels, bins].

    live: float64[bins], or [minigroups, bins] with `group`, int64[pixels], each pixel's minigroup; of `live_share` or
    `record_live`. step_ticks: between the stamps in the histogram.
    """
    bins = histogram.shape[1]
    single = method == "maximum"
    apart = round(APART_SIGMAS * sigma_ticks)
    sigma_ticks = math.hypot(sigma_ticks, math.sqrt((step_ticks**2 - 1) / 12))  # an even spread over a step, in bins
    half = 0 if single else int(FILTER_SIGMAS * sigma_ticks + 0.5)
    pulse = portable.exp(-0.5 * (np.arange(-half, half + 1) / sigma_ticks) ** 2)
    width = pulse.sum()
    if live is None:
        live = shape = np.ones((1, bins))
    else:
        live = np.atleast_2d(live)
        relative = live / live.mean(axis=1, keepdims=True)
        shape = ndimage.correlate1d(relative, pulse / width, mode="constant")  # NumPy's depends on the processor
    law = _Law(
        pulse=pulse,
        width=width,
        shapes=shape,
        lives=live,
        group=np.zeros(len(histogram), np.int64) if group is None else group,
        by_evidence=method == "background",
        near=0 if single else round(NEAR_SIGMAS * sigma_ticks),
        apart=apart,
    )
    work = _Workspace(np.zeros(bins), np.zeros(bins), np.zeros(bins), np.empty(bins, np.int64))
    ticks = np.full((len(histogram), returns), np.nan)
    confidence = np.zeros((len(histogram), returns))
    _peaks(histogram, law, work, ticks, confidence)
    return ticks, confidence


class _Law(NamedTuple):
    """How peaks are found."""

    pulse: np.ndarray  # float64[n]: a hit in its middle counts exactly 1; a little more would count as two
    width: float  # bins of even light that count as much as the pulse
    shapes: np.ndarray  # float64[groups, bins], background relative to its mean
    lives: np.ndarray  # float64[groups, bins], share of the periods in which hits could come
    group: np.ndarray  # int64[pixels], row of each pixel in these
    by_evidence: bool  # peaks are those of the evidence against background, not of the filtered hits
    near: int  # bins from a peak to those that determine its centre
    apart: int  # bins between the returns of a pixel


class _Workspace(NamedTuple):
    """Arrays for one pixel after the other, float64[bins], 0 between pixels."""

    seen: np.ndarray  # filtered hits
    score: np.ndarray
    evidence: np.ndarray  # log likelihood ratio to background alone
    reached: np.ndarray  # int64[bins], bins within a pulse of a hit


@njit(allocates=False)
def _peaks(histogram, law, work, ticks, confidence):
    """Find every pixel's peaks: float64[pixels, returns].

    Only bins within a pulse of a hit are searched; no other bin is above the background.
    """
    pixels, bins = histogram.shape
    pulse = law.pulse
    width = law.width
    near = law.near
    apart = law.apart
    returns = ticks.shape[1]
    half = len(pulse) // 2
    seen = work.seen
    score = work.score
    evidence = work.evidence
    reached = work.reached
    for i in range(pixels):
        total = 0
        number = 0
        until = 0
        shape = law.shapes[law.group[i]]
        live = law.lives[law.group[i]]
        for k in range(bins):
            hits = histogram[i, k]
            if hits:
                total += hits
                for j in range(max(until, k - half), min(bins, k + half + 1)):
                    reached[number] = j
                    number += 1
                until = min(bins, k + half + 1)
                for j in range(max(0, k - half), until):
                    seen[j] += hits * pulse[j - k + half]
        if not total:
            continue
        highest = 0.0
        for n in range(number):
            highest = max(highest, seen[reached[n]])
        per_bin = max(0.5, total - highest) / bins * width  # the peak is not background; assume at least half a hit
        top = 0.0
        for n in range(number):
            j = reached[n]
            expected = per_bin * shape[j]
            # Poisson log likelihood ratio to background alone
            evidence[j] = seen[j] * math.log(seen[j] / expected) - seen[j] + expected if seen[j] > expected else 0.0
            score[j] = evidence[j] if law.by_evidence else seen[j]
            top = max(top, evidence[j])
        anywhere = (bins - number) * math.exp(-top)
        for n in range(number):
            anywhere += math.exp(evidence[reached[n]] - top)
        for r in range(returns):
            at = reached[0]
            for n in range(number):
                if score[reached[n]] > score[at]:
                    at = reached[n]
            if score[at] <= 0:
                break
            below = _poisson_cdf(max(0.0, math.ceil(seen[at]) - 1), per_bin * shape[at])
            accident = 1 - below ** (bins / width)
            if r and accident > ACCIDENT_MAX:
                break
            weight = 0.0
            mean = 0.0
            for j in range(max(0, at - near), min(bins, at + near + 1)):
                weight += histogram[i, j] / live[j]
                mean += histogram[i, j] / live[j] * (j + 0.5)
            ticks[i, r] = mean / weight if weight else at + 0.5
            confidence[i, r] = 1 - accident if r else min(1.0, math.exp(evidence[at] - top) / anywhere * width)
            for j in range(max(0, at - apart), min(bins, at + apart + 1)):
                score[j] = 0
        for n in range(number):
            seen[reached[n]] = 0
            score[reached[n]] = 0
            evidence[reached[n]] = 0


@part
def _poisson_cdf(count, mean):
    """Return the probability of at most `count` (an integer as a float)."""
    term = total = math.exp(-mean)
    for k in range(1, int(count) + 1):
        term *= mean / k
        total += term
    return min(1.0, total)


def record_live(
    records: tuple[np.ndarray, np.ndarray], lost: float, sensor: Sensor, ticks: int, periods: int
) -> np.ndarray:
    """float64[minigroups, ticks]: share of the periods in which a minigroup of a subgroup could still latch at each tick.

    A minigroup latches once in a period. records: stamps and maps, [n, minigroups]; lost: records for each that is there.
    """
    stamp, maps = records
    live = np.empty((sensor.minigroups, ticks))
    for g in range(sensor.minigroups):
        latched = np.bincount(stamp[maps[:, g] > 0, g] + 1, minlength=ticks)  # no second stamp in the same quarter
        live[g] = 1 - np.repeat(np.cumsum(latched), sensor.quarter_ticks)[:ticks] * lost / periods
    return np.maximum(live, LIVE_MIN)


def live_share(arrays: dict[str, np.ndarray], events: Events, config: Config, frame: int | None) -> np.ndarray:
    """float64[subgroups, period_ticks]: share of the periods in which the tree could have opened a window at each tick.

    After a window opens, the tree cannot open another until it is armed again: this is pile-up, and the blind time of R.
    Committed windows are taken at their times: to the tick if coincidence is off (the stamps are single photons: Coates'
    correction), otherwise to the cycle before (the arrival is inside the event's own window). The times of rejected
    windows are unknown, so they are spread over the period.
    """
    sensor, ticks = config.sensor, config.period_ticks
    frames = slice(None) if frame is None else slice(frame, frame + 1)
    opened, committed, stored = (arrays[name][frames].sum(axis=0) for name in ("opened", "committed", "stored"))
    periods = config.pulses * len(arrays["opened"][frames])
    live = np.empty((sensor.subgroups, ticks))
    for s in range(sensor.subgroups):
        stamp = events.stamp[events.bounds[s] : events.bounds[s + 1]]
        close = close_cycle(stamp, events.window[s], sensor.phases)
        armed = armed_cycle(close, sensor.rearm) * sensor.phases
        start = stamp + 1 if not config.coincidence[s] else armed - sensor.phases
        change = (
            np.bincount(start, minlength=ticks + 1)
            - np.bincount(np.minimum(armed, ticks), minlength=ticks + 1)[: ticks + 1]
        )
        blocked = np.cumsum(change)[:ticks] * committed[s] / max(1, stored[s])
        rejected = (opened[s] - committed[s]) * (events.window[s] + sensor.phases / 2) / ticks
        live[s] = 1 - (blocked + rejected) / periods
    return np.maximum(live, LIVE_MIN)
