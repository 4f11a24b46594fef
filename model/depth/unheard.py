# SPDX-License-Identifier: Apache-2.0
"""How often a pixel that fires leaves no trace, estimated from the events of its subgroup.

If there is no event nearby, there are three possibilities: the pixel did not fire; it fired, and the window missed the
threshold; or the tree was blind after such a window. Their frequencies follow from the share of pulses with an event at
that time. Drops come in bursts: the first windows of a pulse fill the FIFO, and the following ones are lost until there
is room again. So if the later of two events carries `overrun`, the silence between them is informative only from the
time at which there was room; this time follows from the rate of windows.
"""

import math
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from ..contract.config import Config
from ..shared.compiled import njit, part
from . import portable
from .clusters import armed_ticks, gate_moved
from .evidence import RARE, REACH_SIGMAS
from .histograms import Events
from .vector_math import fast_log

BLIND_MAX = 0.95
DROPPING_ROUNDS = 3  # rounds in which the rate of windows and the stored share of them converge
RATE_MIN = 1e-3  # photons per subgroup and window, at least
SHARES = 512  # shares of events for which the number of photons is tabulated

Spread = Callable[[Callable[[int], Any], Iterable[int]], Iterable[Any]]  # a `map` that may use any order


class Unheard(NamedTuple):
    """Probabilities that a firing pixel leaves no trace in a pulse without an event nearby, by its surface's time.

    Both are float32[2, subgroups, points], one point for every `every` ticks. missed: its window misses the threshold, finds
    the tree not armed, or is dropped. blind: it finds the tree not armed, at a time at which a window would have been
    noticed. Index 1 holds between two events of which the later one carries `overrun`; only there are windows dropped.
    """

    missed: np.ndarray
    blind: np.ndarray
    every: int


def unheard(events: Events, config: Config, pulses: int, sigma_ticks: float, spread: Spread = map) -> Unheard:
    """Estimate from the subgroups' events how often photons leave no trace.

    pulses: number of pulses in which the events came; spread: as in `log_likelihood`.
    """
    sensor, ticks, every = config.sensor, config.period_ticks, max(1, int(sigma_ticks))
    missed, blind = (np.empty((2, sensor.subgroups, -(-ticks // every)), np.float32) for _ in range(2))
    phase = np.arange(sensor.phases)
    after_rejected = (phase + sensor.rearm * sensor.phases).astype(np.float64)  # mean blind ticks, by phase
    none, all_seen = np.zeros(ticks, np.float32), np.ones(ticks, np.float32)
    reach = math.ceil(REACH_SIGMAS * sigma_ticks)
    taps = np.arange(-(reach // every), reach // every + 1) * every
    pulse = portable.exp(
        -0.5 * taps**2 / (sigma_ticks**2 - (every**2 - 1) / 12)
    )  # a point is a mean over its ticks already
    shape = (pulse / pulse.sum()).astype(np.float32)

    def of_subgroup(s: int) -> None:
        window, committed = int(events.window[s]), events.committed[s]
        span = slice(events.bounds[s], events.bounds[s + 1])
        stamp, overrun = events.stamp[span], events.overrun[span]
        armed, dropping = armed_ticks(stamp, window, config), bool(overrun.any())
        stored_share = np.ones(ticks)
        if dropping:
            stored_share, found = _while_dropping(
                events.pulse[span] % pulses, stamp, armed, overrun, committed, pulses, config
            )
        dropped = 1 / stored_share
        dropped *= committed / max(1.0, dropped[stamp].sum())  # windows per stored window
        rejected = (events.opened[s] - committed) / pulses / ticks  # windows per tick
        threshold = int(events.threshold[s])
        deaf = np.minimum(BLIND_MAX, rejected * after_rejected).astype(np.float32)
        nearby = busy = room = none
        if dropping:
            nearby = np.minimum(1, _share_between(np.maximum(0, stamp - reach), armed, dropped, pulses))
            busy = _share_between(stamp, armed, dropped, pulses)
            room = found.astype(np.float32)
        seen = all_seen
        if config.gating[s]:
            seen = np.repeat(_gate_share(config, s), sensor.phases).astype(np.float32)
        of_ticks = _Ticks(
            covered=_share_between(stamp, stamp + window, dropped, pulses),
            nearby=nearby,
            busy=busy,
            room=room,
            deaf=np.tile(deaf, config.period),
            seen=seen,
        )
        least = np.float32(_event_share(threshold, events.photon_rate[s] * window))
        _leave_no_trace(of_ticks, least, _shares(threshold), shape, every, 1 + dropping, missed[:, s], blind[:, s])
        if not dropping:
            missed[1, s], blind[1, s] = missed[0, s], blind[0, s]

    list(spread(of_subgroup, range(sensor.subgroups)))
    return Unheard(missed, blind, every)


def _gate_share(config: Config, s: int) -> np.ndarray:
    """float64[cycles]: share of the pulses whose gate is open in each cycle of the period."""
    starts = config.gate_start[s] + gate_moved(config, np.arange(config.pulses))
    start, pulses = np.unique(starts, return_counts=True)
    cycle = np.arange(config.period)[:, None]
    is_open = (cycle >= start) & (cycle < start + config.gate_len[s])
    return is_open @ pulses / pulses.sum()


def _while_dropping(
    pulse: np.ndarray,
    stamp: np.ndarray,
    armed: np.ndarray,
    overrun: np.ndarray,
    committed: int,
    pulses: int,
    config: Config,
) -> tuple[np.ndarray, np.ndarray]:
    """Return (share of windows that are stored, the same between two events of which the later has `overrun`), float64[ticks].

    After an event was stored, the FIFO was full, and windows were dropped until there was room. From then on, no window
    came until the next event. The time at which there was room follows from the rate of windows, and this rate follows
    from the share that is stored.
    """
    phases, cells = config.sensor.phases, config.period
    later = np.flatnonzero(overrun[1:]) + 1
    begin, end = pulse * cells + armed // phases, pulse * cells + stamp // phases
    full = np.zeros(cells + 1)
    np.add.at(full, np.minimum(armed // phases, cells)[later - 1], 1)
    np.add.at(full, (stamp // phases)[later], -1)
    clear = 1 - (np.cumsum(full)[:cells] + (pulse[later] - pulse[later - 1]).sum()) / pulses
    stored_share, found = np.clip(clear, 1 / pulses, 1), np.zeros(cells)
    for _ in range(DROPPING_ROUNDS if len(later) else 0):
        rate = np.bincount(stamp // phases, minlength=cells) / stored_share
        rate *= committed / pulses / rate.sum()
        found = _room_found(begin[later - 1], end[later], rate)
        stored_share = np.clip(clear + (1 - clear) * found, 1 / pulses, 1)
    return np.repeat(stored_share, phases), np.repeat(found, phases)


@njit
def _room_found(begin, end, rate):
    """float64[cycles]: share of the intervals from `begin` to `end` in which there was room before a cycle of the period.

    begin, end: cycles of the frame. rate: windows per cycle of the period. In each interval, windows came before there
    was room, and none came after.
    """
    cells = len(rate)
    total = np.zeros(cells + 1)
    total[1:] = np.cumsum(rate)
    of_period, total = total[cells], total[:cells]
    grown, shrunk = np.exp(total), np.exp(-total)  # windows since the period began
    found, number = np.zeros(cells), np.zeros(cells)
    sums = np.empty(cells * max(1, (np.max(end) if len(end) else 0) // cells + 1))
    for i in range(len(begin)):
        first = begin[i] // cells * of_period + total[begin[i] % cells]
        last = end[i] // cells * of_period + total[end[i] % cells]
        so_far, at = 0.0, begin[i]
        while at < end[i]:
            period = at // cells
            until, none_after, none_before = (
                min(end[i], (period + 1) * cells),
                math.exp(period * of_period - last),
                math.exp(first - period * of_period),
            )
            for j in range(at, until):
                k = j - period * cells
                so_far += none_after * grown[k] * (1 + RARE - none_before * shrunk[k])
                sums[j - begin[i]] = so_far
            at = until
        for j in range(begin[i], end[i]):
            found[j % cells] += sums[j - begin[i]] / so_far
            number[j % cells] += 1
    for k in range(cells):
        found[k] /= max(1.0, number[k])
    return found


def _share_between(begin: np.ndarray, end: np.ndarray, weight: np.ndarray, pulses: int) -> np.ndarray:
    """float32[ticks]: number of the events that have a tick in [begin, end), per pulse, times the tick's weight."""
    ticks = len(weight)
    begun, ended = (np.bincount(np.minimum(part, ticks), minlength=ticks + 1)[:ticks] for part in (begin, end))
    return (np.cumsum(begun - ended) / pulses * weight).astype(np.float32)


class _Ticks(NamedTuple):
    """What is known of the ticks of a subgroup's period, float32[ticks], each per pulse."""

    covered: np.ndarray  # windows over a tick
    nearby: np.ndarray  # the same for windows with their surroundings; this and the two following only while dropping
    busy: np.ndarray  # windows from their stamp until the tree is armed
    room: np.ndarray  # share with room in the FIFO
    deaf: np.ndarray  # chance that the tree is blind after a rejected window
    seen: np.ndarray  # share of the pulses whose gate is open


class _Shares(NamedTuple):
    """What follows from the share of the windows that become events, at even steps of the share's logarithm."""

    met: np.ndarray  # float32[SHARES], share of those that would become events with one more pixel
    dark: np.ndarray  # float32[SHARES], probability that no photon came
    low: np.float32  # lowest logarithm
    per: np.float32  # steps per unit of it


@cache
def _shares(threshold: int) -> _Shares:
    """Tabulate the shares for a threshold in pixels."""
    low = math.log(_event_share(threshold, 0))
    photons = special.gammaincinv(threshold, portable.exp(np.linspace(low, 0, SHARES)))
    met = special.gammainc(threshold - 1, photons) if threshold > 1 else np.ones(SHARES)
    per = np.float32((SHARES - 1) / -low)
    return _Shares(met.astype(np.float32), portable.exp(-photons).astype(np.float32), np.float32(low), per)


def _event_share(threshold: int, photons: float) -> float:
    """Return the share of the windows with at least `threshold` photons; it is never 0."""
    return max(float(np.finfo(np.float32).tiny), special.gammainc(threshold, max(photons, RATE_MIN)))


@njit(error_model="numpy")
def _leave_no_trace(of_ticks, least, shares, pulse, every, kinds, missed, blind):
    """Compute missed and blind, float32[2, points], of `Unheard` for one subgroup.

    It is the mean over the arrival times of a surface's photons. least: share of the windows that become events by
    background alone. pulse: float32[n], shape of the pulse in steps of `every` ticks. kinds: 2 if windows are dropped,
    else 1.
    """
    covered = of_ticks.covered
    deaf = of_ticks.deaf
    ticks = len(covered)
    points = missed.shape[1]
    reach = len(pulse) // 2
    one = np.float32(1)
    share = np.empty(ticks, np.float32)
    place = np.empty(ticks, np.float32)
    met = np.empty(ticks, np.float32)
    dark = np.empty(ticks, np.float32)
    lost = np.empty(ticks, np.float32)
    unarmed = np.empty(ticks, np.float32)
    line = np.empty(points + 2 * reach, np.float32)
    for kind in range(kinds):
        for t in range(ticks):
            share[t] = max(covered[t] / (one - deaf[t]), least)
            place[t] = min((fast_log(share[t]) - shares.low) * shares.per, np.float32(SHARES - 1.001))
        for t in range(ticks):
            k = np.uint32(place[t])
            part = place[t] - np.float32(k)
            met[t] = shares.met[k] + part * (shares.met[k + 1] - shares.met[k])
            dark[t] = shares.dark[k] + part * (shares.dark[k + 1] - shares.dark[k])
        for t in range(ticks):
            awake = (one - deaf[t]) * (of_ticks.room[t] if kind else one)
            noticed = min(one, max(share[t], of_ticks.nearby[t]) if kind else share[t])
            silent = max(one - awake * noticed, np.float32(RARE))
            lost[t] = one - of_ticks.seen[t] * (one - min(one, (one - awake * met[t]) / silent))
            off = min(np.float32(BLIND_MAX), deaf[t] + of_ticks.busy[t]) if kind else deaf[t]
            unarmed[t] = off / (off + (one - off) * dark[t])
        _mean_over_pulse(lost, pulse, every, line, missed[kind])
        _mean_over_pulse(unarmed, pulse, every, line, blind[kind])


@part(error_model="numpy")
def _mean_over_pulse(values, pulse, every, line, means):
    """Compute the mean of values by tick, over each point's ticks and the pulse. line: workspace."""
    points = len(means)
    reach = len(pulse) // 2
    for j in range(points):
        begin = j * every
        end = min(len(values), (j + 1) * every)
        total = np.float32(0)
        for t in range(begin, end):
            total += values[t]
        line[reach + j] = total / np.float32(end - begin)
    for i in range(reach):
        line[i] = line[reach]
        line[reach + points + i] = line[reach + points - 1]
    for j in range(points):
        means[j] = 0
    for i in range(len(pulse)):
        for j in range(points):
            means[j] += pulse[i] * line[i + j]
