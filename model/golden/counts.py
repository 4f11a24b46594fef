# SPDX-License-Identifier: Apache-2.0
"""Counts of the golden model: from each subgroup's hits, in the order of time, to gates and counts.

It takes a frame in pieces of whole pulses, and keeps histograms whose size does not depend on the
pulses. Steps 1 and 2 of docs/contract.md fill those of the minigroups (`_fill`), step 3 those of the
pixels (`_count_hits`). The first piece that reaches into the next step completes the one before, and
regions (`_find_regions`) or gates (`_find_gates`) are found.
"""

from typing import NamedTuple

import numpy as np

from ..contract.config import Config
from ..contract.counts import (
    COUNT_MOST,
    CYCLES_MAX,
    GATE_CYCLES,
    NARROW_BITS,
    NARROW_PER_CYCLE,
    NO_GATE,
    PEAK_BINS,
    REGIONS,
    WIDE_BINS,
    WIDE_BITS,
    WIDE_CYCLES,
)
from ..contract.edges import Fate
from ..contract.gate_counts import Counts, without_gates
from ..contract.parameters import QUARTERS
from ..contract.pixels import pixel_table
from ..shared.compiled import njit, part
from .front_end import cycle_of, fields_of

_BLIND = int(Fate.BLIND)
_NARROW_BINS = NARROW_PER_CYCLE * CYCLES_MAX
_GATE_NARROW_BINS = NARROW_PER_CYCLE * GATE_CYCLES
_NEVER = np.int64(1) << 62  # behind all cycles of a frame
_NONE = -1


class Hits(NamedTuple):
    """Edges of a piece, by subgroup and then by time; only those that are `BLIND` are accepted."""

    key: np.ndarray  # int64[n], sort keys
    bounds: np.ndarray  # int64[subgroups + 1], rows of each subgroup
    fate: np.ndarray  # uint8[n]


class _Given(NamedTuple):
    """What does not change in a frame."""

    minigroup: np.ndarray  # int64[pixels], of each pixel of a subgroup
    across: int  # minigroups in a row of a subgroup
    phase_bits: int
    cycles: int  # of a period, in which hits count


class _Pulses(NamedTuple):
    """Pulses of a step."""

    begin: int
    end: int  # the first one behind the step


class _Bins(NamedTuple):
    """Bins of the histograms of minigroups, in steps 1 and 2."""

    quarters: int  # width in quarters of a cycle
    most: int  # hits


class _Memory(NamedTuple):
    """What the minigroups have found and counted."""

    wide: np.ndarray  # int16[subgroups, minigroups, wide bins]
    narrow: np.ndarray  # int16[subgroups, minigroups, narrow bins]
    # int64[subgroups, minigroups], in steps 1 and 2: cycle of the frame that filled a bin, as of
    # `cycle_of`
    stop: np.ndarray
    region: np.ndarray  # bool[subgroups, minigroups, wide bins]
    full: np.ndarray  # bool[subgroups, pixels], in step 3: the pixel counts no more
    counts: Counts


_WIDE = _Bins(QUARTERS * WIDE_CYCLES, (1 << WIDE_BITS) - 1)
_NARROW = _Bins(QUARTERS // NARROW_PER_CYCLE, (1 << NARROW_BITS) - 1)


class GateCounts:
    """Counts of a frame, which it takes in pieces.

    pulses: that begin in this frame; fewer than the configuration has if the frame is aborted.
    """

    def __init__(self, config: Config, pulses: int) -> None:
        sensor = config.sensor
        subgroups = sensor.subgroups
        minigroups = sensor.minigroups
        self._given = _Given(
            minigroup=pixel_table(sensor).minigroup,
            across=sensor.subgroup[1] // sensor.minigroup[1],
            phase_bits=sensor.phase_bits,
            cycles=min(config.period, CYCLES_MAX),
        )
        search = config.search_pulses
        self._steps = (
            _Pulses(0, search),
            _Pulses(search, 2 * search),
            _Pulses(2 * search, pulses),
        )
        self._step = 0
        self._memory = _Memory(
            wide=np.zeros((subgroups, minigroups, WIDE_BINS), np.int16),
            narrow=np.zeros((subgroups, minigroups, _NARROW_BINS), np.int16),
            stop=np.full((subgroups, minigroups), _NEVER),
            region=np.ones((subgroups, minigroups, WIDE_BINS), np.bool_),
            full=np.zeros((subgroups, sensor.pixels), np.bool_),
            counts=without_gates(sensor, subgroups),
        )

    def take(self, hits: Hits, end: int) -> None:
        """Take the edges of some pulses, all below `end`."""
        self._count(hits)
        while self._step < len(self._steps) - 1 and end > self._steps[self._step].end:
            self._next_step()
            self._count(hits)

    def end(self) -> Counts:
        """End the frame, and return its counts."""
        counts = self._memory.counts
        last = self._steps[-1]
        if last.end <= last.begin:
            return counts
        while self._step < len(self._steps) - 1:
            self._next_step()
        counts.count_pulses[~self._memory.full] = last.end - last.begin
        return counts

    def _count(self, hits: Hits) -> None:
        """Count the hits of this step's pulses."""
        memory = self._memory
        pulses = self._steps[self._step]
        if self._step == 0:
            _fill(hits, self._given, pulses, _WIDE, memory.wide, memory)
        elif self._step == 1:
            _fill(hits, self._given, pulses, _NARROW, memory.narrow, memory)
        else:
            _count_hits(hits, self._given, pulses, memory)

    def _next_step(self) -> None:
        """Find what the next step needs."""
        if self._step == 0:
            _find_regions(self._given, np.empty(WIDE_BINS, np.int64), self._memory)
        else:
            _find_gates(self._given, self._memory)
        self._memory.stop[:] = _NEVER
        self._step += 1


@njit(allocates=False)
def _fill(
    hits: Hits,
    given: _Given,
    pulses: _Pulses,
    bins: _Bins,
    histogram: np.ndarray,
    memory: _Memory,
) -> None:
    """Add hits of minigroups in their regions to `histogram`, which is one of the memory's.

    All hits of a cycle are added at once: what a bin does not take is lost, and the minigroup stops
    after the cycle.
    """
    quarter_bits = given.phase_bits - 2
    for s in range(len(histogram)):
        for e in range(hits.bounds[s], hits.bounds[s + 1]):
            if not _is_hit(hits, e, given, pulses):
                continue
            _, tick, inside = fields_of(hits.key[e])
            group = given.minigroup[inside]
            cycle = tick >> given.phase_bits
            if not memory.region[s, group, cycle // WIDE_CYCLES]:
                continue
            now = cycle_of(hits.key[e], given.phase_bits)
            if now > memory.stop[s, group]:
                continue
            here = (tick >> quarter_bits) // bins.quarters
            if histogram[s, group, here] < bins.most:
                histogram[s, group, here] += 1
            if histogram[s, group, here] == bins.most:
                memory.stop[s, group] = now


@njit(allocates=False)
def _count_hits(hits: Hits, given: _Given, pulses: _Pulses, memory: _Memory) -> None:
    """Count the hits of pixels in the gates; a pixel stops with the hit that fills a bin."""
    counts = memory.counts
    for s in range(len(memory.full)):
        for e in range(hits.bounds[s], hits.bounds[s + 1]):
            pulse, tick, inside = fields_of(hits.key[e])
            if memory.full[s, inside] or not _is_hit(hits, e, given, pulses):
                continue
            begins = counts.gate_cycle[s, given.minigroup[inside]]
            gate = _gate_of(begins, tick >> given.phase_bits)
            if gate == _NONE:
                continue
            here = (tick >> given.phase_bits - 2) - QUARTERS * begins[gate]
            counts.gate_hits[s, inside, gate, here] += 1
            if counts.gate_hits[s, inside, gate, here] == COUNT_MOST:
                memory.full[s, inside] = True
                counts.count_pulses[s, inside] = pulse - pulses.begin + 1


@part
def _is_hit(hits: Hits, e: int, given: _Given, pulses: _Pulses) -> bool:
    """Return whether an edge is a hit in some pulses."""
    pulse, tick, _ = fields_of(hits.key[e])
    if hits.fate[e] != _BLIND or not pulses.begin <= pulse < pulses.end:
        return False
    return tick >> given.phase_bits < given.cycles


@part
def _gate_of(begins: np.ndarray, cycle: int) -> int:
    """Return the gate of a minigroup in which a cycle is, or `_NONE`."""
    for gate in range(len(begins)):
        if begins[gate] != NO_GATE and begins[gate] <= cycle < begins[gate] + GATE_CYCLES:
            return gate
    return _NONE


@njit(allocates=False)
def _find_regions(given: _Given, value: np.ndarray, memory: _Memory) -> None:
    """Choose the regions of every minigroup. value: int64[wide bins], room for its own."""
    wide = memory.wide
    bins = -(-given.cycles // WIDE_CYCLES)
    for s in range(wide.shape[0]):
        for group in range(wide.shape[1]):
            for w in range(bins):
                value[w] = 2 * wide[s, group, w] + _beside(wide[s], group, w, given.across)
            _mark_highest(value[:bins], memory.region[s, group])


@part
def _beside(wide: np.ndarray, group: int, w: int, across: int) -> int:
    """Return the hits in a wide bin of the minigroups beside one. wide: of the subgroup."""
    total = 0
    if group >= across:
        total += wide[group - across, w]
    if group + across < len(wide):
        total += wide[group + across, w]
    if group % across > 0:
        total += wide[group - 1, w]
    if group % across < across - 1:
        total += wide[group + 1, w]
    return total


@part
def _mark_highest(value: np.ndarray, region: np.ndarray) -> None:
    """Mark the wide bins with the highest values; of equal ones, the first."""
    for w in range(len(region)):
        region[w] = False
    for _ in range(min(REGIONS, len(value))):
        best = _NONE
        for w in range(len(value)):
            if not region[w] and (best == _NONE or value[w] > value[best]):
                best = w
        region[best] = True


@njit(allocates=False)
def _find_gates(given: _Given, memory: _Memory) -> None:
    """Find the gates of every minigroup, and empty the narrow bins in its first one."""
    last = given.cycles - GATE_CYCLES
    for s in range(len(memory.narrow)):
        for group in range(memory.narrow.shape[1]):
            narrow = memory.narrow[s, group]
            begins = memory.counts.gate_cycle[s, group]
            first = _gate_around_peak(narrow, given.cycles)
            if first == NO_GATE:
                continue
            begins[0] = first
            for k in range(_GATE_NARROW_BINS):
                narrow[NARROW_PER_CYCLE * first + k] = 0
            second = _gate_around_peak(narrow, given.cycles)
            if second == NO_GATE:
                continue
            if abs(second - first) < GATE_CYCLES:
                # equivalent (second >= first: GtE): they never begin in the same cycle
                second = first + GATE_CYCLES if second >= first else first - GATE_CYCLES
            if 0 <= second <= last:
                begins[1] = second


@part
def _gate_around_peak(narrow: np.ndarray, cycles: int) -> int:
    """Return the first cycle of the gate around the highest peak, or `NO_GATE`."""
    most = 0
    peak = 0
    for a in range(NARROW_PER_CYCLE * cycles - PEAK_BINS + 1):
        hits = 0
        for k in range(PEAK_BINS):
            hits += narrow[a + k]
        if hits > most:
            most = hits
            peak = a
    if most == 0:
        return NO_GATE
    moment = 0
    for k in range(PEAK_BINS):
        moment += (2 * k + 1) * narrow[peak + k]
    if peak % 2:
        first = peak // 2 - 1 + (moment >= 4 * most)
    else:
        first = peak // 2 - 2 + (moment >= 2 * most) + (moment >= 6 * most)
    return min(max(first, 0), cycles - GATE_CYCLES)
