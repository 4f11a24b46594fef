# SPDX-License-Identifier: Apache-2.0
"""Kernels of counts in gates (`counting.py`) and of their likelihood (`count_depth.py`)."""

import math
from typing import NamedTuple

import numpy as np

from coincid.model.contract.parameters import QUARTERS
from coincid.model.shared.compiled import njit, part

NO_GATE = -1
MISSED = -6.0  # log likelihood of a surface outside of all gates


class Hits(NamedTuple):
    """Hits by subgroup, in the order of their pulses and quarters: accepted edges, at most one of a
    pixel in a cycle.
    """

    bounds: np.ndarray  # int64[subgroups + 1]: subgroup s has the rows bounds[s] to bounds[s + 1]
    pulse: np.ndarray  # int64[n]
    quarter: np.ndarray  # int64[n], of the period
    pixel: np.ndarray  # int64[n], of the subgroup


class Counts(NamedTuple):
    """What leaves the sensor, by subgroup."""

    start: np.ndarray  # int64[subgroups, minigroups, gates], first quarter of a gate, or NO_GATE
    hits: np.ndarray  # int64[subgroups, pixels, gates, bins]
    pulses: np.ndarray  # int64[subgroups, pixels], in which the pixel counted
    second_pulses: int


class Stop(NamedTuple):
    """The cycle after which a minigroup counts no more, int64[minigroups]; none: beyond all."""

    pulse: np.ndarray
    cycle: np.ndarray


@part
def _has_stopped(stop: Stop, group: int, pulse: int, cycle: int) -> bool:
    if pulse == stop.pulse[group]:
        return cycle > stop.cycle[group]
    return pulse > stop.pulse[group]


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
    """Fill histograms of minigroups, in bins of `width` quarters. All hits of a cycle are added at
    once: what exceeds `most` is lost, and the minigroup stops after a cycle that filled a bin.
    """
    groups = histogram.shape[1]
    stop = Stop(np.empty(groups, np.int64), np.empty(groups, np.int64))
    for s in range(len(histogram)):
        stop.pulse[:] = end
        for e in range(hits.bounds[s], hits.bounds[s + 1]):
            pulse = hits.pulse[e]
            if not begin <= pulse < end:
                continue
            cycle = hits.quarter[e] // QUARTERS
            here = hits.quarter[e] // width
            group = minigroup[hits.pixel[e]]
            if not watched[s, group, here] or _has_stopped(stop, group, pulse, cycle):
                continue
            histogram[s, group, here] = min(most, histogram[s, group, here] + 1)
            if histogram[s, group, here] == most:
                stop.pulse[group] = pulse
                stop.cycle[group] = cycle


@part
def _gate_at(start: np.ndarray, quarter: int, bins: int) -> int:
    """Return the gate of a minigroup in which a quarter is, or NO_GATE."""
    for gate in range(len(start)):
        if 0 <= start[gate] <= quarter < start[gate] + bins:
            return gate
    return NO_GATE


@njit
def count_hits(
    hits: Hits, minigroup: np.ndarray, begin: int, end: int, most: int, counts: Counts
) -> None:
    """Count the hits of pixels, in bins of a quarter. A pixel stops at the hit that fills a bin."""
    subgroups, pixels, _, bins = counts.hits.shape
    for s in range(subgroups):
        full = np.zeros(pixels, np.bool_)
        for e in range(hits.bounds[s], hits.bounds[s + 1]):
            i = hits.pixel[e]
            if full[i] or not begin <= hits.pulse[e] < end:
                continue
            start = counts.start[s, minigroup[i]]
            gate = _gate_at(start, hits.quarter[e], bins)
            if gate < 0:
                continue
            here = hits.quarter[e] - start[gate]
            counts.hits[s, i, gate, here] += 1
            if counts.hits[s, i, gate, here] == most:
                full[i] = True
                counts.pulses[s, i] = hits.pulse[e] - begin + 1


class Seen(NamedTuple):
    """What the likelihood reads of a pixel's bins, [pixels, gates, bins], pixels by subgroup."""

    first: np.ndarray  # int64[pixels, gates], first tick of a gate; negative: none
    hits: np.ndarray  # int64
    misses: np.ndarray  # float64, pulses in which the pixel could have been hit, but was not
    background: np.ndarray  # float64[pixels], photons per tick


class Law(NamedTuple):
    """Shares of a pulse before whole ticks after its time, float64[ticks]."""

    reach: int  # ticks: the first one is for -reach
    before: np.ndarray
    width: int  # ticks of a bin


@part
def _before(law: Law, tick: int) -> float:
    """Return the share of the pulse before a tick after its time."""
    return law.before[min(max(tick + law.reach, 0), 2 * law.reach)]


@njit
def add_up(
    seen: Seen, law: Law, lights: np.ndarray, first: np.ndarray, step: int, total: np.ndarray
) -> None:
    """Compute log likelihoods, float32[pixels, times * lights].

    The times are step * (first + k + 1/2).
    """
    gates, bins = seen.hits.shape[1:]
    number = len(lights)
    for i in range(len(total)):
        for k in range(total.shape[1] // number):
            tick = (step * (2 * (first[i] + k) + 1)) // 2
            line = total[i, k * number : (k + 1) * number]
            known = False
            for g in range(gates):
                begin = seen.first[i, g]
                from_begin = tick - begin
                if begin < 0 or not -law.reach <= from_begin <= bins * law.width + law.reach:
                    continue
                known = True
                low = max(0, -((law.reach - from_begin) // law.width))
                high = min(bins, (from_begin + law.reach) // law.width + 1)
                for b in range(low, high):
                    _add_bin(seen, law, lights, i, g, b, tick, line)
            if not known:
                line[:] = MISSED


@part
def _add_bin(
    seen: Seen, law: Law, lights: np.ndarray, i: int, g: int, b: int, tick: int, line: np.ndarray
) -> None:
    """Add what bin b of gate g says about a surface of pixel i at a tick, to float32[lights]."""
    off = seen.first[i, g] + b * law.width - tick
    share = _before(law, off + law.width) - _before(law, off)
    hits = seen.hits[i, g, b]
    misses = seen.misses[i, g, b]
    back = 1 - math.exp(-seen.background[i] * law.width)
    for x in range(len(lights)):
        light = lights[x] * share
        value = -misses * light
        if hits:
            value += hits * math.log((1 - math.exp(-light) + back) / back)
        line[x] += value
