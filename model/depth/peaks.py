# SPDX-License-Identifier: Apache-2.0
"""Peaks of pixel histograms: the paper's estimator (IV), and filtered ones, which are our own
choice.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from ..contract.config import Config
from ..contract.parameters import Sensor
from ..contract.result import known_counters
from ..shared.compiled import njit, part
from . import portable
from .clusters import armed_ticks
from .histograms import Events
from .pulse_ticks import NEAR_SIGMAS, PulseTicks

FILTER_SIGMAS = 4.0  # half width of the matched filter of a Gaussian
CENTRINGS = 5  # the bins that determine a centre are moved to it so many times at most
APART_SIGMAS = 4.0  # distance between the returns of a pixel
ACCIDENT_MAX = 0.01  # probability that a second or further return is background
CLOSED_SHARE = 1e-3  # of the background where a gate is closed: a lead may move a hit there
LIVE_MIN = 0.05  # share of periods; below it, pile-up cannot be corrected
MOST_SIGMAS = 2.5  # half of the time in which most of a pulse comes; another may follow at once
STILL_ARMED_MIN = 0.1  # share of the trees after a pulse; below it, it is too uncertain


def pixel_peaks(
    histogram: np.ndarray,
    method: str,
    live: np.ndarray | None,
    pulse: PulseTicks,
    returns: int,
    *,
    hit_share: np.ndarray | None = None,
    is_open: np.ndarray | None = None,
    group: np.ndarray | None = None,
    step_ticks: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """Return (ticks, confidence), each float64[pixels, returns], from int32[pixels, bins].

    live: float64[bins], or [minigroups, bins] with `group`, int64[pixels], each pixel's minigroup;
    of `live_share` or `record_live`. hit_share: the same, of `hit_shares`; None: 1. is_open:
    float64[bins], share of the pulses whose gate is open; None: 1. step_ticks: between the stamps in
    the histogram.
    """
    bins = histogram.shape[1]
    single = method == "maximum"
    apart = round(APART_SIGMAS * pulse.sigma)
    step_sigma = math.sqrt((step_ticks**2 - 1) / 12)  # of an even spread over a step, in bins
    sigma_ticks = math.hypot(pulse.sigma, step_sigma)
    hits = np.ones(1) if single else _hits_of_pulse(pulse, sigma_ticks)
    width = hits.sum()
    shape = np.ones((1, bins))
    open_share = np.ones(bins) if is_open is None else is_open
    gated = not np.all(open_share == 1.0)
    if live is not None or gated:
        of_group = np.atleast_2d(np.ones(bins) if live is None else live)
        if gated:
            of_group = of_group * np.maximum(open_share, CLOSED_SHARE)
        relative = of_group / of_group.mean(axis=1, keepdims=True)
        # NumPy's own correlation depends on the processor.
        shape = ndimage.correlate1d(relative, hits / width, mode="constant")
    law = _Law(
        hits=hits,
        width=width,
        shapes=shape,
        seen=np.ones_like(shape) if hit_share is None else np.atleast_2d(hit_share),
        group=np.zeros(len(histogram), np.int64) if group is None else group,
        by_evidence=method == "background",
        places=float(np.count_nonzero(open_share)),
        near=0 if single else round(NEAR_SIGMAS * sigma_ticks),
        apart=apart,
    )
    work = _Workspace(
        seen=np.zeros(bins),
        score=np.zeros(bins),
        evidence=np.zeros(bins),
        reached=np.empty(bins, np.int64),
    )
    ticks = np.full((len(histogram), returns), np.nan)
    confidence = np.zeros((len(histogram), returns))
    _peaks(histogram, law, work, ticks, confidence)
    return ticks, confidence


def _hits_of_pulse(pulse: PulseTicks, sigma_ticks: float) -> np.ndarray:
    """float64[n], n odd: the hits of a surface in the bins around its own, relative to the most.

    sigma_ticks: of a Gaussian and of the steps of its stamps; those of a table are ticks.
    """
    if not pulse.times:
        half = int(FILTER_SIGMAS * sigma_ticks + 0.5)
        return portable.exp(-0.5 * (np.arange(-half, half + 1) / sigma_ticks) ** 2)
    lead = float(pulse.lead(np.ones(1))[0])  # by which the histogram's hits are later
    half = pulse.reach + math.ceil(abs(lead) + 0.5)
    bins = np.arange(-half, half + 1) - lead
    share = pulse.share_before(bins + 0.5) - pulse.share_before(bins - 0.5)
    return share / share.max()


class _Law(NamedTuple):
    """How peaks are found."""

    hits: np.ndarray  # float64[n], of a pulse: one in its peak counts exactly 1, not a little more
    width: float  # bins of even light that count as much as the pulse
    shapes: np.ndarray  # float64[groups, bins], background relative to its mean
    seen: np.ndarray  # float64[groups, bins], of `hit_shares`
    group: np.ndarray  # int64[pixels], row of each pixel in these
    by_evidence: (
        bool  # peaks are those of the evidence against background, not of the filtered hits
    )
    places: float  # bins in which background may be
    near: int  # bins from a peak to those that determine its centre
    apart: int  # bins between the returns of a pixel


class _Workspace(NamedTuple):
    """Arrays for one pixel after the other, float64[bins], 0 between pixels."""

    seen: np.ndarray  # filtered hits
    score: np.ndarray
    evidence: np.ndarray  # log likelihood ratio to background alone
    reached: np.ndarray  # int64[bins], bins within a pulse of a hit


class _Pixel(NamedTuple):
    """A pixel, [bins]."""

    hits: np.ndarray  # int32
    shape: np.ndarray  # float64, row of `_Law.shapes`
    seen: np.ndarray  # float64, row of `_Law.seen`


class _Found(NamedTuple):
    """What the bins of a pixel say together."""

    per_bin: float  # hits of background that a pulse has, where the background is the mean
    top: float  # highest evidence
    anywhere: float  # sum of the likelihoods, relative to the highest


@njit(allocates=False)
def _peaks(
    histogram: np.ndarray, law: _Law, work: _Workspace, ticks: np.ndarray, confidence: np.ndarray
) -> None:
    """Find every pixel's peaks: float64[pixels, returns].

    Only bins within a pulse of a hit are searched; no other bin is above the background.
    """
    for i in range(len(histogram)):
        group = law.group[i]
        pixel = _Pixel(histogram[i], law.shapes[group], law.seen[group])
        total, number = _filter(pixel.hits, law.hits, work)
        if total:
            found = _weigh(pixel, law, total, number, work)
            _take(pixel, law, found, number, work, ticks[i], confidence[i])
            _clear(number, work)


@part
def _filter(hits: np.ndarray, pulse: np.ndarray, work: _Workspace) -> tuple[int, int]:
    """Compute `seen` and `reached` of a pixel; return its hits and how many bins are reached.

    pulse: `_Law.hits`. A late hit speaks for an early surface, hence the order.
    """
    bins = len(hits)
    half = len(pulse) // 2
    total = 0
    number = 0
    until = 0
    for k in range(bins):
        if hits[k]:
            total += hits[k]
            for j in range(max(until, k - half), min(bins, k + half + 1)):
                work.reached[number] = j
                number += 1
            until = min(bins, k + half + 1)
            for j in range(max(0, k - half), until):
                work.seen[j] += hits[k] * pulse[k - j + half]
    return total, number


@part
def _weigh(pixel: _Pixel, law: _Law, total: int, number: int, work: _Workspace) -> _Found:
    """Compute `evidence` and `score` of a pixel with `total` hits, in so many reached bins."""
    bins = len(pixel.hits)
    seen = work.seen
    evidence = work.evidence
    highest = 0.0
    for n in range(number):
        highest = max(highest, seen[work.reached[n]])
    # The peak is not background; assume at least half a hit.
    per_bin = max(0.5, total - highest) / bins * law.width
    top = 0.0
    for n in range(number):
        j = work.reached[n]
        expected = per_bin * pixel.shape[j]
        evidence[j] = 0.0
        if seen[j] > expected:  # Poisson log likelihood ratio to background alone
            evidence[j] = seen[j] * math.log(seen[j] / expected) - seen[j] + expected
        work.score[j] = evidence[j] if law.by_evidence else seen[j]
        top = max(top, evidence[j])
    anywhere = max(0.0, law.places - number) * math.exp(-top)
    for n in range(number):
        anywhere += math.exp(evidence[work.reached[n]] - top)
    return _Found(per_bin, top, anywhere)


@part
def _take(
    pixel: _Pixel,
    law: _Law,
    found: _Found,
    number: int,
    work: _Workspace,
    ticks: np.ndarray,
    confidence: np.ndarray,
) -> None:
    """Write the times and confidences of a pixel's returns, the highest peak first."""
    bins = len(pixel.hits)
    for r in range(len(ticks)):
        at = work.reached[0]
        for n in range(number):
            if work.score[work.reached[n]] > work.score[at]:
                at = work.reached[n]
        if work.score[at] <= 0:
            break
        fewer = max(0.0, math.ceil(work.seen[at]) - 1)
        below = _poisson_cdf(fewer, found.per_bin * pixel.shape[at])
        accident = 1 - below ** (law.places / law.width)
        if r and accident > ACCIDENT_MAX:
            break
        ticks[r] = _centre(pixel, at, law.near)
        if r:
            confidence[r] = 1 - accident
        else:
            own = math.exp(work.evidence[at] - found.top)
            confidence[r] = min(1.0, own / found.anywhere * law.width)
        for j in range(max(0, at - law.apart), min(bins, at + law.apart + 1)):
            work.score[j] = 0


@part
def _centre(pixel: _Pixel, at: int, near: int) -> float:
    """Return the mean time of the hits near a peak, if the tree had been armed before the pulse.

    The bins that count are those around the mean itself. The peak of the filter is as broad as the
    pulse, while most stamps are closer together.
    """
    mean = at + 0.5
    for _ in range(CENTRINGS):
        mean = _mean_near(pixel, at, near)
        if int(mean) == at:
            break
        at = int(mean)
    return mean


@part
def _mean_near(pixel: _Pixel, at: int, near: int) -> float:
    """Return the mean time of the hits within `near` bins of a bin, or its middle without hits."""
    hits = pixel.hits
    seen = pixel.seen
    weight = 0.0
    mean = 0.0
    for j in range(max(0, at - near), min(len(hits), at + near + 1)):
        weight += hits[j] / seen[j]
        mean += hits[j] / seen[j] * (j + 0.5)
    return mean / weight if weight else at + 0.5


@part
def _clear(number: int, work: _Workspace) -> None:
    """Set the workspace to 0 again."""
    for n in range(number):
        j = work.reached[n]
        work.seen[j] = 0
        work.score[j] = 0
        work.evidence[j] = 0


@part
def _poisson_cdf(count: float, mean: float) -> float:
    """Return the probability of at most `count` (an integer as a float)."""
    term = total = math.exp(-mean)
    for k in range(1, int(count) + 1):
        term *= mean / k
        total += term
    return min(1.0, total)


def record_live(
    records: tuple[np.ndarray, np.ndarray], lost: float, sensor: Sensor, ticks: int, periods: int
) -> np.ndarray:
    """float64[minigroups, ticks]: share of the periods in which a minigroup could still latch at
    each tick.

    A minigroup latches once in a period. records: stamps and maps, [n, minigroups], of a subgroup;
    lost: records for each that is there.
    """
    stamp, maps = records
    live = np.empty((sensor.minigroups, ticks))
    for g in range(sensor.minigroups):
        quarter = stamp[maps[:, g] > 0, g] + 1  # no second stamp in the same quarter
        latched = np.cumsum(np.bincount(quarter, minlength=ticks))
        live[g] = 1 - np.repeat(latched, sensor.quarter_ticks)[:ticks] * lost / periods
    return np.maximum(live, LIVE_MIN)


def live_share(
    arrays: dict[str, np.ndarray], events: Events, config: Config, frame: int | None
) -> np.ndarray:
    """float64[subgroups, period_ticks]: share of the periods in which the tree could open a window
    at each tick.

    After a window opens, the tree cannot open another until it is armed again: this is pile-up, and
    the blind time of R. If coincidence is off, the stamps are single photons, and each blocks from
    its tick on (Coates' correction). Otherwise an event blocks the cycle before the tree is armed
    again. Its own arrival is often in there: so where a subgroup has many events, a hit is less
    likely to be taken for background. The times of rejected windows are unknown, so they are spread
    over the period.
    """
    sensor = config.sensor
    ticks = config.period_ticks
    windows = _count_windows(arrays, config, frame)
    live = np.empty((sensor.subgroups, ticks))
    for s in range(sensor.subgroups):
        stamp = events.stamp[events.bounds[s] : events.bounds[s + 1]]
        window = events.window[s]
        armed = armed_ticks(stamp, window, config)
        start = stamp + 1
        if config.coincidence[s]:
            start = armed - sensor.phases
        starts = np.bincount(start, minlength=ticks + 1)
        ends = np.bincount(np.minimum(armed, ticks), minlength=ticks + 1)[: ticks + 1]
        blocked = np.cumsum(starts - ends)[:ticks] * windows.per_stored[s]
        until_armed = window + sensor.phases / 2 + sensor.rearm * sensor.phases
        rejected = windows.rejected[s] * until_armed / ticks
        live[s] = 1 - (blocked + rejected) / windows.periods
    return np.maximum(live, LIVE_MIN)


def hit_shares(
    arrays: dict[str, np.ndarray],
    events: Events,
    config: Config,
    pulse: PulseTicks,
    frame: int | None,
) -> np.ndarray:
    """float64[subgroups, period_ticks]: hits by arrival, over those that there would be if the tree
    were armed long before each of them.

    The tree is armed again at the beginning of a cycle. If this is within a pulse, the first photon
    comes from the rest of the pulse only: too late.
    """
    ticks = config.period_ticks
    windows = _count_windows(arrays, config, frame)
    shares = np.empty((config.sensor.subgroups, ticks))
    for s in range(len(shares)):
        span = slice(events.bounds[s], events.bounds[s + 1])
        stamp = events.stamp[span]
        hits = events.count[span]
        opened = np.bincount(stamp, minlength=ticks) * windows.per_stored[s]
        opened += windows.rejected[s] / ticks
        window = int(events.window[s])
        by_stamp = _first_photon_share(opened / windows.periods, window, pulse.sigma, config)
        shares[s] = by_stamp
        if config.coincidence[s]:  # without, a window is too short to tell how many photons came
            arrival = np.clip(np.floor(events.arrival[span]), 0, ticks - 1).astype(np.int64)
            seen = np.bincount(arrival, weights=hits, minlength=ticks)
            full = np.bincount(arrival, weights=hits / by_stamp[stamp], minlength=ticks)
            np.divide(seen, full, out=shares[s], where=full > 0)
    return shares


def _first_photon_share(
    opened: np.ndarray, window: int, sigma: float, config: Config
) -> np.ndarray:
    """float64[ticks]: windows that open at a tick, over those of a tree that is armed long before.

    opened: float64[ticks], windows that open at a tick in a period. sigma: of a pulse, ticks. After a
    pulse in which hardly a tree is still armed, those that are armed again open most of the windows,
    until the pulse ends.
    """
    span = max(window, round(2 * MOST_SIGMAS * sigma))
    ticks = len(opened)
    tick = np.arange(ticks)
    armed = np.minimum(armed_ticks(tick, window, config), ticks)
    rearmed = np.bincount(armed, weights=opened, minlength=ticks + 1)[:ticks]
    over = np.concatenate([np.zeros(window), opened])[:ticks]
    free = 1 - np.cumsum(over - rearmed)  # no earlier window has ended or blocks
    free_before = np.concatenate([[1.0], free[:-1]])
    still_armed = 1 - _sum_before(opened, span) / np.maximum(free_before, LIVE_MIN)
    more = rearmed * (1 / np.maximum(still_armed, STILL_ARMED_MIN) - 1)
    return np.maximum(free + _sum_before(more, span - 1) + more, LIVE_MIN)


def _sum_before(values: np.ndarray, number: int) -> np.ndarray:
    """float64[ticks]: sum of so many values before each tick, without the tick's own."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    tick = np.arange(len(values))
    return total[tick] - total[np.maximum(0, tick - number)]


class _Windows(NamedTuple):
    """Windows of a frame, or of all frames."""

    periods: int  # in which they opened
    per_stored: np.ndarray  # float64[subgroups], windows that met the threshold, per stored event
    rejected: np.ndarray  # int64[subgroups], those that did not


def _count_windows(arrays: dict[str, np.ndarray], config: Config, frame: int | None) -> _Windows:
    """Count the windows of a frame, or of all frames (None)."""
    frames = slice(None) if frame is None else slice(frame, frame + 1)
    counters = known_counters(arrays, config).least
    opened = counters["opened"][frames].sum(axis=0)
    committed = counters["committed"][frames].sum(axis=0)
    stored = counters["stored"][frames].sum(axis=0)
    return _Windows(
        periods=config.pulses * len(arrays["opened"][frames]),
        per_stored=committed / np.maximum(1, stored),
        rejected=opened - committed,
    )
