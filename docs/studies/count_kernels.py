# SPDX-License-Identifier: Apache-2.0
"""Kernels of counts in gates (`counting.py`)."""

from typing import NamedTuple

import numpy as np

from coincid.model.contract.parameters import QUARTERS
from coincid.model.shared.compiled import njit, part

NO_GATE = -1


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
