# SPDX-License-Identifier: Apache-2.0
"""Kernels of counts in gates (`counting.py`) and of their likelihood (`count_depth.py`)."""

import math
from typing import NamedTuple

import numpy as np

from coincid.model.contract.latency import armed_cycle, close_cycle
from coincid.model.shared.compiled import njit, part

NO_GATE = -1
PART = 4  # ticks: step of the ends of windows, after which a pixel may fire unseen
MISSED = -6.0  # log likelihood of a surface outside of all gates
RARE = 1e-9  # least share of armed pulses
_close_cycle = njit(close_cycle)
_armed_cycle = njit(armed_cycle)


class Hits(NamedTuple):
    """Hits of open windows by subgroup, in the order of their pulses: the first one of each pixel in
    a window.
    """

    bounds: np.ndarray  # int64[subgroups + 1]: subgroup s has the rows bounds[s] to bounds[s + 1]
    pulse: np.ndarray  # int64[n]
    tick: np.ndarray  # int64[n], the pixel's own
    pixel: np.ndarray  # int64[n], of the subgroup


class Counts(NamedTuple):
    """What leaves the sensor, by subgroup."""

    start: np.ndarray  # int64[subgroups, minigroups, gates], first tick of a gate, or NO_GATE
    hits: np.ndarray  # int64[subgroups, pixels, gates, bins]
    pulses: np.ndarray  # int64[subgroups, pixels], in which the pixel counted
    second_pulses: int


@njit
def fill(
    hits: Hits,
    minigroup: np.ndarray,
    begin: int,
    end: int,
    width: int,
    most: int,
    watched: np.ndarray,
    histogram: np.ndarray,
) -> None:
    """A minigroup stops when one of its bins is full."""
    full = np.empty(histogram.shape[1], np.bool_)
    for s in range(len(histogram)):
        full[:] = False
        for e in range(hits.bounds[s], hits.bounds[s + 1]):
            if not begin <= hits.pulse[e] < end:
                continue
            here = hits.tick[e] // width
            group = minigroup[hits.pixel[e]]
            if full[group] or not watched[s, group, here]:
                continue
            histogram[s, group, here] += 1
            full[group] = histogram[s, group, here] == most


@part
def _gate_at(start: np.ndarray, tick: int, span: int) -> int:
    """Return the gate of a minigroup in which a tick is, or NO_GATE."""
    for gate in range(len(start)):
        if 0 <= start[gate] <= tick < start[gate] + span:
            return gate
    return NO_GATE


@njit
def count_hits(
    hits: Hits,
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
        for e in range(hits.bounds[s], hits.bounds[s + 1]):
            i = hits.pixel[e]
            if full[i] or not begin <= hits.pulse[e] < end:
                continue
            start = counts.start[s, minigroup[i]]
            gate = _gate_at(start, hits.tick[e], bins * width)
            if gate < 0:
                continue
            here = (hits.tick[e] - start[gate]) // width
            counts.hits[s, i, gate, here] += 1
            if counts.hits[s, i, gate, here] == most:
                full[i] = True
                counts.pulses[s, i] = hits.pulse[e] - begin + 1


class Seen(NamedTuple):
    """What the likelihood reads of a pixel's bins, [pixels, gates, bins, ...], pixels by subgroup."""

    first: np.ndarray  # int64[pixels, gates], first tick of a gate; negative: none
    hits: np.ndarray  # int64
    misses: np.ndarray  # float64, pulses in which the pixel could have been hit, but was not
    sighted: np.ndarray  # float64, by tick of the bin, over the bin's mean: the tree is not blind
    background: np.ndarray  # float64[pixels], photons per tick
    again: np.ndarray  # float64[subgroups, cycles, parts], of `armed_again`


class Law(NamedTuple):
    """Shares of a pulse by whole ticks after its time, float64[ticks]."""

    reach: int  # ticks: the first one is for -reach
    before: np.ndarray  # before the tick
    within: np.ndarray  # in the tick
    window: int  # ticks
    width: int  # ticks of a bin
    phases: int  # ticks of a cycle


class Watch(NamedTuple):
    """What a subgroup's tree does, float64[subgroups, ticks], per pulse."""

    armed: np.ndarray  # a window may open at the tick
    opened: np.ndarray  # one does
    blind: np.ndarray  # a window has closed, and the tree is not armed yet


@njit
def follow(photons: np.ndarray, window: int, phases: int, rearm: int, watch: Watch) -> None:
    """Follow the tree of each subgroup through the period.

    photons: float64[subgroups, ticks], expected per pulse.
    """
    ticks = photons.shape[1]
    for s in range(len(photons)):
        again = np.zeros(ticks + (3 + rearm) * phases + window)
        closed = np.zeros(ticks + window)
        armed = 1.0
        blind = 0.0
        for tick in range(ticks):
            armed = min(1.0, armed + again[tick])
            blind = max(0.0, blind + closed[tick] - again[tick])
            opened = armed * (1 - math.exp(-photons[s, tick]))
            watch.armed[s, tick] = armed
            watch.opened[s, tick] = opened
            watch.blind[s, tick] = blind
            armed -= opened
            close = _close_cycle(tick, window, phases)
            closed[tick + window] += opened
            again[_armed_cycle(close, rearm) * phases] += opened


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
    off = seen.first[i, g] + b * law.width - tick
    share = 0.0
    for j in range(law.width):
        share += seen.sighted[i, g, b, j] * law.within[off + law.reach + j]
    hits = seen.hits[i, g, b]
    misses = seen.misses[i, g, b]
    back = 1 - math.exp(-seen.background[i] * law.width)
    for x in range(len(lights)):
        light = lights[x]
        hit = 1 - math.exp(-light * share)
        if alive[x] < 1:
            hit *= alive[x]
            value = misses * math.log(max(RARE, 1 - hit))
        else:
            value = -misses * light * share
        if hits:
            value += hits * math.log((hit + back) / back)
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
            close = end - law.phases + 1 + j * PART + PART // 2
            unseen = _before(law, end) - _before(law, min(end, close))
            for x in range(len(lights)):
                alive[n, x] += again[cycle, j] * alive[n - 1, x] * math.exp(-lights[x] * unseen)
