# SPDX-License-Identifier: Apache-2.0
"""Counts in gates, as in docs/contract.md, for a subgroup: a cycle at a time, with the memory of a
minigroup as 8 rows of 64 bits.

It is plain and slow, and has nothing in common with the golden model, nor with
`docs/studies/counting.py`, but the rule. Minigroups have 2 x 2 pixels.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from coincid.model.contract.config import Config
from coincid.model.contract.edges import Edges, Fate

from ..benches.plain_model import where

GROUP_SIDE = 2  # pixels
GROUP_PIXELS = GROUP_SIDE**2
ROWS = 8  # of the memory of a minigroup
GATE_CYCLES = 4
WIDE_CYCLES = 4
CYCLES_MAX = 256
NO_GATE = 255


class Limits(NamedTuple):
    """What a study of the rule varies."""

    regions: int = 10
    wide_bits: int = 8
    narrow_bits: int = 6
    count_bits: int = 4


RULE = Limits()


class Frame(NamedTuple):
    """A frame of a subgroup. pulses: that have begun."""

    sides: tuple[int, int]  # rows and columns of pixels
    period_cycles: int
    search_pulses: int
    pulses: int

    @property
    def groups(self) -> int:
        """Minigroups."""
        return self.sides[0] * self.sides[1] // GROUP_PIXELS

    @property
    def across(self) -> int:
        """Minigroups in a row."""
        return self.sides[1] // GROUP_SIDE

    def place(self, pixel: int) -> tuple[int, int]:
        """Return the minigroup of a pixel, and the pixel's number in it."""
        row, col = divmod(pixel, self.sides[1])
        group = self.across * (row // GROUP_SIDE) + col // GROUP_SIDE
        return group, GROUP_SIDE * (row % GROUP_SIDE) + col % GROUP_SIDE


# (pulse, cycle) -> pixel of the subgroup -> quarter of the cycle in which it was hit
Hits = dict[tuple[int, int], dict[int, int]]


class Minigroup:
    """A minigroup. The hits of a cycle are the quarters, by pixel, in which an edge came: 0 to 3,
    or None.
    """

    def __init__(self, limits: Limits):
        self.limits = limits
        self.rows = [0] * ROWS
        self.stopped = False
        self.marks: list[bool] = []  # by wide bin: it is a region
        self.gates = [NO_GATE, NO_GATE]  # first cycles
        self.stopped_at: list[int | None] = [
            None
        ] * GROUP_PIXELS  # pulse with which a pixel stopped
        self.pulses = [0] * GROUP_PIXELS  # at the end of the frame

    def clear(self) -> None:
        """Empty the memory between two steps."""
        self.rows = [0] * ROWS
        self.stopped = False

    def field(self, row: int, lsb: int, width: int) -> int:
        """Return a field of a row."""
        return self.rows[row] >> lsb & (1 << width) - 1

    def add(self, row: int, lsb: int, width: int, bits: int, number: int) -> bool:
        """Add hits to a field of a row, up to the highest number of some bits; return whether the
        field has become full.
        """
        highest = (1 << bits) - 1
        old = self.field(row, lsb, width)
        new = min(highest, old + number)
        self.rows[row] += new - old << lsb
        return new > old and new == highest

    def count_wide(self, _: int, cycle: int, hits: list[int | None]) -> None:
        """Step 1: a row has 8 wide bins."""
        if self.stopped:
            return
        row, lane = divmod(cycle // WIDE_CYCLES, 8)
        number = sum(quarter is not None for quarter in hits)
        self.stopped = self.add(row, 8 * lane, 8, self.limits.wide_bits, number)

    def count_narrow(self, _: int, cycle: int, hits: list[int | None]) -> None:
        """Step 2: a row has the two narrow bins of a cycle of 5 regions."""
        here = cycle // WIDE_CYCLES
        if self.stopped or not self.marks[here]:
            return
        row, lsb = self.narrow_place(here, cycle)
        for half in range(2):
            number = hits.count(2 * half) + hits.count(2 * half + 1)
            if self.add(row, lsb + 6 * half, 6, self.limits.narrow_bits, number):
                self.stopped = True

    def narrow_place(self, here: int, cycle: int) -> tuple[int, int]:
        """Return row and lowest bit of a cycle in a region."""
        upper, lane = divmod(sum(self.marks[:here]), 5)
        return 2 * (cycle % WIDE_CYCLES) + upper, 12 * lane

    def count_pixels(self, pulse: int, cycle: int, hits: list[int | None]) -> None:
        """Step 3: a row has a cycle of a gate."""
        for gate, first in enumerate(self.gates):
            if first == NO_GATE or not first <= cycle < first + GATE_CYCLES:
                continue
            row = GATE_CYCLES * gate + cycle % GATE_CYCLES
            for pixel, quarter in enumerate(hits):
                if quarter is None or self.stopped_at[pixel] is not None:
                    continue
                if self.add(row, 16 * quarter + 4 * pixel, 4, self.limits.count_bits, 1):
                    self.stopped_at[pixel] = pulse + 1

    def wide_bin(self, here: int) -> int:
        """Return the hits of a wide bin."""
        row, lane = divmod(here, 8)
        return self.field(row, 8 * lane, 8)

    def narrow_bins(self, cycles: int) -> list[int]:
        """Return the hits of all narrow bins, which are 0 outside of the regions."""
        bins = []
        for cycle in range(cycles):
            here = cycle // WIDE_CYCLES
            row, lsb = self.narrow_place(here, cycle)
            for half in range(2):
                bins.append(self.field(row, lsb + 6 * half, 6) if self.marks[here] else 0)
        return bins

    def words(self, subgroup: int, number: int) -> list[int]:
        """Return the beats of its packet."""
        head = subgroup << 48 | number << 16 | self.gates[1] << 8 | self.gates[0]
        pulses = sum(value << 16 * pixel for pixel, value in enumerate(self.pulses))
        return [head, pulses, *self.rows]


def _beside(group: int, frame: Frame) -> list[int]:
    """Return the minigroups beside one."""
    row, col = divmod(group, frame.across)
    beside = []
    if row > 0:
        beside.append(group - frame.across)
    if group + frame.across < frame.groups:
        beside.append(group + frame.across)
    if col > 0:
        beside.append(group - 1)
    if col < frame.across - 1:
        beside.append(group + 1)
    return beside


def _highest(values: list[int], number: int) -> list[int]:
    """Return the positions of the highest values: each value goes behind those that are as high."""
    list_of_best: list[int] = []
    for position, value in enumerate(values):
        place = sum(values[better] >= value for better in list_of_best)
        list_of_best.insert(place, position)
        del list_of_best[number:]
    return list_of_best


def _gate_of(narrow: list[int], last: int) -> int:
    """Return the first cycle of the gate around the highest peak, or NO_GATE."""
    height = 0
    best = 0
    for at in range(len(narrow) - 3):
        here = sum(narrow[at : at + 4])
        if here > height:
            height = here
            best = at
    if height == 0:
        return NO_GATE
    moment = narrow[best] + 3 * narrow[best + 1] + 5 * narrow[best + 2] + 7 * narrow[best + 3]
    first = best // 2 - 2
    if best % 2:
        first += 2 if moment >= 4 * height else 1
    else:
        first += (moment >= 2 * height) + (moment >= 6 * height)
    return min(max(first, 0), last)


def _gates(narrow: list[int], cycles: int) -> list[int]:
    """Return the first cycles of both gates."""
    last = cycles - GATE_CYCLES
    first = _gate_of(narrow, last)
    if first == NO_GATE:
        return [NO_GATE, NO_GATE]
    left = list(narrow)
    for cycle in range(first, first + GATE_CYCLES):
        left[2 * cycle] = 0
        left[2 * cycle + 1] = 0
    second = _gate_of(left, last)
    if second != NO_GATE and abs(second - first) < GATE_CYCLES:
        second = first + GATE_CYCLES if second >= first else first - GATE_CYCLES
        if not 0 <= second <= last:
            second = NO_GATE
    return [first, second]


def hits_of(edges: Iterable[tuple[int, int, int]], phases: int) -> Hits:
    """Return the hits among edges (pulse, pixel of the subgroup, tick): the first of a pixel in a
    cycle.
    """
    found: Hits = defaultdict(dict)
    for pulse, pixel, tick in sorted(edges, key=lambda edge: (edge[0], edge[2])):
        cycle, phase = divmod(tick, phases)
        found[pulse, cycle].setdefault(pixel, 4 * phase // phases)
    return found


def plain_counts(
    config: Config, edges: Edges, fate: Iterable[int], pulses: int | None = None
) -> list[list[list[Minigroup]]]:
    """Return the minigroups at the end of each frame, by frame and subgroup.

    fate: of each edge; in a frame of counts, accepted edges are blind. pulses: that each frame
    plays, and that the edges' pulses count; None: those of the configuration.
    """
    sensor = config.sensor
    pulses = config.pulses if pulses is None else pulses
    frame = Frame(sensor.subgroup, config.period, config.search_pulses, pulses)
    accepted: dict[tuple[int, int], list[tuple[int, int, int]]] = defaultdict(list)
    rows = zip(edges.pulse.tolist(), edges.pixel.tolist(), edges.tick.tolist(), fate, strict=True)
    for pulse, pixel, tick, its_fate in rows:
        if its_fate == Fate.BLIND:
            subgroup, inside, _, _ = where(config, pixel)
            number, in_frame = divmod(pulse, pulses)
            accepted[number, subgroup].append((in_frame, inside, tick))
    return [
        [
            counted_in_rows(hits_of(accepted[number, subgroup], sensor.phases), frame)
            for subgroup in range(sensor.subgroups)
        ]
        for number in range(config.frames)
    ]


def counted_in_rows(hits: Hits, frame: Frame, limits: Limits = RULE) -> list[Minigroup]:
    """Count the hits of a frame of one subgroup; return its minigroups at the end of the frame."""
    groups = [Minigroup(limits) for _ in range(frame.groups)]
    cycles = min(frame.period_cycles, CYCLES_MAX)
    in_time = {}
    for pulse, cycle in sorted(hits):
        if cycle < CYCLES_MAX:
            in_time[pulse, cycle] = _by_group(hits[pulse, cycle], frame)
    step = frame.search_pulses
    _fill(groups, in_time, range(step), Minigroup.count_wide)
    if frame.pulses <= 2 * step:
        for own in groups:
            own.clear()
        return groups
    _mark(groups, -(-cycles // WIDE_CYCLES), frame)
    _fill(groups, in_time, range(step, 2 * step), Minigroup.count_narrow)
    for own in groups:
        own.gates = _gates(own.narrow_bins(cycles), cycles)
        own.clear()
    _fill(groups, in_time, range(2 * step, frame.pulses), Minigroup.count_pixels)
    for own in groups:
        for pixel, stopped_at in enumerate(own.stopped_at):
            own.pulses[pixel] = frame.pulses - 2 * step if stopped_at is None else stopped_at
    return groups


def _by_group(hits: dict[int, int], frame: Frame) -> dict[int, list[int | None]]:
    """Return the hits of a cycle by minigroup: the quarters of its pixels."""
    found: dict[int, list[int | None]] = {}
    for pixel, quarter in hits.items():
        group, inside = frame.place(pixel)
        found.setdefault(group, [None] * GROUP_PIXELS)[inside] = quarter
    return found


def _fill(groups: list[Minigroup], in_time: dict, pulses: range, add: Callable) -> None:
    """Give the hits of some pulses to the minigroups, and the pulse since the first of them."""
    for (pulse, cycle), by_group in in_time.items():
        if pulse in pulses:
            for group, hits in by_group.items():
                add(groups[group], pulse - pulses.start, cycle, hits)


def _mark(groups: list[Minigroup], wide_bins: int, frame: Frame) -> None:
    """Choose the regions, and empty the memory."""
    for group, own in enumerate(groups):
        values = []
        for here in range(wide_bins):
            beside = sum(groups[other].wide_bin(here) for other in _beside(group, frame))
            values.append(2 * own.wide_bin(here) + beside)
        chosen = _highest(values, own.limits.regions)
        own.marks = [here in chosen for here in range(wide_bins)]
    for own in groups:
        own.clear()


class Counted(NamedTuple):
    """What a subgroup has counted, as arrays of a result, int64."""

    gate_cycle: np.ndarray  # [minigroups, gates], first cycles
    gate_hits: np.ndarray  # [pixels, gates, bins]
    count_pulses: np.ndarray  # [pixels]


def read_rows(groups: list[Minigroup], frame: Frame) -> Counted:
    """Return what the minigroups have in their rows."""
    pixels = len(groups) * GROUP_PIXELS
    hits = np.zeros((pixels, 2, 16), np.int64)
    pulses = np.zeros(pixels, np.int64)
    for pixel in range(pixels):
        group, inside = frame.place(pixel)
        own = groups[group]
        pulses[pixel] = own.pulses[inside]
        for gate, first in enumerate(own.gates):
            for place in range(16 if first != NO_GATE else 0):
                cycle, quarter = divmod(place, 4)
                row = GATE_CYCLES * gate + (first + cycle) % GATE_CYCLES
                hits[pixel, gate, place] = own.field(row, 16 * quarter + 4 * inside, 4)
    return Counted(np.array([own.gates for own in groups]), hits, pulses)
