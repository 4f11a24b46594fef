# SPDX-License-Identifier: Apache-2.0
"""Kernels of counts in gates (`counting.py`) and of their likelihood (`count_depth.py`)."""

import math
from typing import NamedTuple

import numpy as np

from coincid.model.contract.latency import armed_cycle, close_cycle
from coincid.model.contract.packet import BEAT_BITS
from coincid.model.shared.compiled import njit, part

NO_GATE = -1
PART = 4  # ticks: step of the stamps after which a pixel may be dead
MISSED = -6.0  # log likelihood of a surface outside of all gates
RARE = 1e-9  # least share of armed pulses
SHARE_MAX = 0.9999  # of the armed pulses that have an event in a bin
_close_cycle = njit(close_cycle)
_armed_cycle = njit(armed_cycle)


class Stops(NamedTuple):
    """Events by subgroup, in the order of their pulses."""

    bounds: np.ndarray  # int64[subgroups + 1]: subgroup s has the rows bounds[s] to bounds[s + 1]
    pulse: np.ndarray  # int64[n]
    stamp: np.ndarray  # int64[n], ticks
    hits: np.ndarray  # uint64[n, words], maps


class Counts(NamedTuple):
    """What leaves the sensor, by subgroup."""

    start: np.ndarray  # int64[subgroups, minigroups, gates], first tick of a gate, or NO_GATE
    hits: np.ndarray  # int64[subgroups, pixels, gates, bins]
    pulses: np.ndarray  # int64[subgroups, pixels], in which the pixel counted
    events: np.ndarray  # int64[subgroups, minigroups, gates, event bins]
    event_pulses: np.ndarray  # int64[subgroups, minigroups], in which these were counted
    second_pulses: int


@part
def is_hit(hits: np.ndarray, e: int, i: int) -> bool:
    """Return whether pixel i of the subgroup is in the map of event e. hits: uint64[n, words]."""
    return hits[e, i // BEAT_BITS] >> np.uint64(i % BEAT_BITS) & np.uint64(1) != 0


@njit
def fill_coarsely(
    stops: Stops, minigroup: np.ndarray, pulses: int, width: int, most: int, histogram: np.ndarray
) -> None:
    """A minigroup stops when one of its bins is full."""
    full = np.empty(histogram.shape[1], np.bool_)
    for s in range(len(histogram)):
        full[:] = False
        for e in range(stops.bounds[s], stops.bounds[s + 1]):
            if stops.pulse[e] >= pulses:
                break
            here = stops.stamp[e] // width
            for i in range(len(minigroup)):
                group = minigroup[i]
                if full[group] or not is_hit(stops.hits, e, i):
                    continue
                histogram[s, group, here] += 1
                full[group] = histogram[s, group, here] == most


@part
def _gate_at(start: np.ndarray, stamp: int, span: int) -> int:
    """Return the gate of a minigroup in which a stamp is, or NO_GATE."""
    for gate in range(len(start)):
        if 0 <= start[gate] <= stamp < start[gate] + span:
            return gate
    return NO_GATE


@njit
def count_hits(
    stops: Stops,
    minigroup: np.ndarray,
    begin: int,
    end: int,
    width: int,
    most: int,
    counts: Counts,
) -> None:
    subgroups, pixels, _, bins = counts.hits.shape
    for s in range(subgroups):
        full = np.zeros(pixels, np.bool_)
        for e in range(stops.bounds[s], stops.bounds[s + 1]):
            if not begin <= stops.pulse[e] < end:
                continue
            for i in range(pixels):
                if full[i] or not is_hit(stops.hits, e, i):
                    continue
                start = counts.start[s, minigroup[i]]
                gate = _gate_at(start, stops.stamp[e], bins * width)
                if gate < 0:
                    continue
                here = (stops.stamp[e] - start[gate]) // width
                counts.hits[s, i, gate, here] += 1
                if counts.hits[s, i, gate, here] == most:
                    full[i] = True
                    counts.pulses[s, i] = stops.pulse[e] - begin + 1


@njit
def count_events(stops: Stops, begin: int, end: int, width: int, most: int, counts: Counts) -> None:
    subgroups, minigroups, _, bins = counts.events.shape
    for s in range(subgroups):
        full = counts.event_pulses[s] == 0
        for e in range(stops.bounds[s], stops.bounds[s + 1]):
            if not begin <= stops.pulse[e] < end:
                continue
            for group in range(minigroups):
                start = counts.start[s, group]
                gate = _gate_at(start, stops.stamp[e], bins * width)
                if full[group] or gate < 0:
                    continue
                here = (stops.stamp[e] - start[gate]) // width
                counts.events[s, group, gate, here] += 1
                if counts.events[s, group, gate, here] == most:
                    full[group] = True
                    counts.event_pulses[s, group] = stops.pulse[e] - begin + 1


class Seen(NamedTuple):
    """What the likelihood reads of a pixel's bins, [pixels, gates, bins, ...], pixels by subgroup."""

    first: np.ndarray  # int64[pixels, gates], first tick of a gate; negative: none
    hits: np.ndarray  # int64
    events: np.ndarray  # float64, while the pixel counted
    quiet: np.ndarray  # float64, armed pulses by ticks without an event there
    others: np.ndarray  # float64, events per armed pulse and tick
    watched: np.ndarray  # float64, by tick of the bin, share of its armed pulses,
    stamped: np.ndarray  # and of its events
    background: np.ndarray  # float64[pixels], photons per tick
    again: np.ndarray  # float64[subgroups, cycles, parts], of `armed_again`


class Law(NamedTuple):
    """Shares of a pulse by whole ticks after its time, float64[ticks]."""

    reach: int  # ticks: the first one is for -reach
    before: np.ndarray  # before the tick
    opens: np.ndarray  # in the tick
    joins: np.ndarray  # in the rest of a window that opens in it
    window: int  # ticks
    width: int  # ticks of a bin
    phases: int  # ticks of a cycle


class Watch(NamedTuple):
    """When a subgroup's tree is armed, float64[subgroups, ticks], per pulse."""

    armed: np.ndarray  # a window may open at the tick
    events: np.ndarray  # one does


@njit
def follow(
    rate: np.ndarray,
    photons: np.ndarray,
    width: int,
    window: int,
    phases: int,
    rearm: int,
    watch: Watch,
) -> None:
    """Follow the tree of each subgroup through the period.

    rate: float64[subgroups, bins], events per pulse in each bin, or UNKNOWN.
    """
    ticks = watch.armed.shape[1]
    for s in range(len(rate)):
        again = np.zeros(ticks + (3 + rearm) * phases + window)
        armed = 1.0
        scale = 1.0
        for tick in range(ticks):
            armed = min(1.0, armed + again[tick])
            number = rate[s, tick // width]
            if tick % width == 0:
                scale = 1.0
                if number >= 0:
                    share = min(SHARE_MAX, number / max(armed, RARE))
                    scale = -math.log(1 - share) / photons[s, tick : tick + width].sum()
            event = armed * (1 - math.exp(-scale * photons[s, tick]))
            watch.armed[s, tick] = armed
            watch.events[s, tick] = event
            armed -= event
            close = _close_cycle(tick, window, phases)
            again[_armed_cycle(close, rearm) * phases] += event


@part
def _before(law: Law, tick: int) -> float:
    """Return the share of the pulse before a tick after its time."""
    return law.before[min(max(tick + law.reach, 0), 2 * law.reach)]


@njit
def add_up(
    seen: Seen, law: Law, lights: np.ndarray, first: np.ndarray, step: int, total: np.ndarray
) -> None:
    """Compute log likelihoods, float32[pixels, times * lights], of times step * (first + k + 1/2)."""
    gates, bins = seen.hits.shape[1:]
    number = len(lights)
    subgroups = len(seen.again)
    alive = np.ones((4 + 4 * law.reach // law.phases, number))
    for i in range(len(total)):
        again = seen.again[i // (len(total) // subgroups)]
        for k in range(total.shape[1] // number):
            tick = (step * (2 * (first[i] + k) + 1)) // 2
            line = total[i, k * number : (k + 1) * number]
            first_cycle = max(0, (tick - law.reach) // law.phases)
            known = False
            for g in range(gates):
                begin = seen.first[i, g]
                from_begin = tick - begin
                if begin < 0 or not -law.reach <= from_begin <= bins * law.width + law.reach:
                    continue
                if not known:
                    _find_alive(law, again, lights, tick, first_cycle, alive)
                known = True
                low = max(0, -((law.reach - from_begin) // law.width))
                high = min(bins, (from_begin + law.reach) // law.width + 1)
                for b in range(low, high):
                    cycle = (begin + b * law.width) // law.phases
                    _add_bin(seen, law, lights, i, g, b, tick, alive[cycle - first_cycle], line)
            if not known:
                line[:] = MISSED


@part
def _add_bin(
    seen: Seen,
    law: Law,
    lights: np.ndarray,
    i: int,
    g: int,
    b: int,
    tick: int,
    alive: np.ndarray,
    line: np.ndarray,
) -> None:
    """Add what bin b of gate g says about a surface of pixel i at a tick, to float32[lights].

    alive: float64[lights], chance that the pixel lives when the bin's cycle begins.
    """
    begin = seen.first[i, g] + b * law.width
    off = begin - tick
    opens = 0.0
    joins = 0.0
    for j in range(law.width):
        opens += seen.watched[i, g, b, j] * law.opens[off + law.reach + j]
        joins += seen.stamped[i, g, b, j] * law.joins[off + law.reach + j]
    back = seen.background[i]
    alone = 1 - math.exp(-back * (law.window - 1))
    cycle_begin = begin // law.phases * law.phases
    watched = _before(law, off) - _before(law, cycle_begin - tick)
    hits = seen.hits[i, g, b]
    others = seen.others[i, g, b]
    missed = max(0.0, seen.events[i, g, b] - hits)
    quiet = seen.quiet[i, g, b] * opens + missed * joins
    none = back + others * alone
    for x in range(len(lights)):
        light = lights[x]
        lives = 1.0
        if alive[x] < 1:
            left = alive[x] * math.exp(-light * watched)
            lives = left / (1 - alive[x] + left)
        value = -light * quiet * lives
        if hits:
            join = lives * (1 - math.exp(-light * joins)) + alone
            some = lives * light * opens + back + others * join
            value += hits * math.log(some / none)
        line[x] += value


@part
def _find_alive(
    law: Law, again: np.ndarray, lights: np.ndarray, tick: int, first_cycle: int, alive: np.ndarray
) -> None:
    """Compute alive[cycle - first_cycle, light]: the chance that the pixel has not fired unseen when
    the cycle begins, in a pulse in which the tree is armed then.
    """
    cycles, parts = again.shape
    for x in range(len(lights)):
        alive[0, x] = 1
    for n in range(1, len(alive)):
        cycle = first_cycle + n
        end = cycle * law.phases - tick
        if cycle >= cycles or end - law.phases > law.reach:
            for x in range(len(lights)):
                alive[n, x] = alive[n - 1, x]
            continue
        through = 1.0
        for j in range(parts):
            through -= again[cycle, j]
        through = max(0.0, through)
        for x in range(len(lights)):
            alive[n, x] = through * alive[n - 1, x]
        for j in range(parts):
            if again[cycle, j] == 0:
                continue
            stamp = end - law.phases - law.window + 1 + j * PART + PART // 2
            unseen = _before(law, end) - _before(law, stamp)
            for x in range(len(lights)):
                alive[n, x] += again[cycle, j] * alive[n - 1, x] * math.exp(-lights[x] * unseen)
