# SPDX-License-Identifier: Apache-2.0
"""The rule of docs/counts.md for a subgroup of 8 x 8 pixels and minigroups of 2 x 2, a cycle at a
time, with the memory of a minigroup as 8 rows of 64 bits.

It is plain and slow, and has nothing in common with `docs/studies/counting.py` but the rule. Times
are cycles, and quarters of a cycle.
"""

from collections import defaultdict
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from docs.studies.counting import Rule

SIDE = 8  # pixels
GROUP_SIDE = 2
GROUPS_SIDE = SIDE // GROUP_SIDE
ROWS = 8  # of the memory of a minigroup
GATE_CYCLES = 4
WIDE_CYCLES = 4
NO_GATE = -1


class Counted(NamedTuple):
    """What leaves the subgroup, as int64."""

    start: np.ndarray  # [minigroups, gates], quarters
    hits: np.ndarray  # [pixels, gates, bins]
    pulses: np.ndarray  # [pixels]


class Minigroup:
    """A minigroup. The hits of a cycle are the quarters, by pixel, in which an edge came: 0 to 3,
    or None.
    """

    def __init__(self, rule: Rule):
        self.rule = rule
        self.rows = [0] * ROWS
        self.stopped = False
        self.marks: list[bool] = []  # by wide bin: it is divided
        self.gates: list[int] = []  # first cycles, or NO_GATE
        self.pulses: list[int | None] = [None] * GROUP_SIDE**2  # after which a pixel has stopped

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
        self.stopped = self.add(row, 8 * lane, 8, self.rule.wide_bits, number)

    def count_narrow(self, _: int, cycle: int, hits: list[int | None]) -> None:
        """Step 2: a row has the two narrow bins of a cycle of 5 regions."""
        here = cycle // WIDE_CYCLES
        if self.stopped or not self.marks[here]:
            return
        row, lsb = self.narrow_place(here, cycle)
        for half in range(2):
            number = hits.count(2 * half) + hits.count(2 * half + 1)
            if self.add(row, lsb + 6 * half, 6, self.rule.narrow_bits, number):
                self.stopped = True

    def narrow_place(self, here: int, cycle: int) -> tuple[int, int]:
        """Return row and lowest bit of a cycle in a divided wide bin."""
        upper, lane = divmod(sum(self.marks[:here]), 5)
        return 2 * (cycle % WIDE_CYCLES) + upper, 12 * lane

    def count_pixels(self, pulse: int, cycle: int, hits: list[int | None]) -> None:
        """Step 3: a row has a cycle of a gate."""
        for gate, first in enumerate(self.gates):
            if first == NO_GATE or not first <= cycle < first + GATE_CYCLES:
                continue
            row = GATE_CYCLES * gate + cycle % GATE_CYCLES
            for pixel, quarter in enumerate(hits):
                if quarter is None or self.pulses[pixel] is not None:
                    continue
                if self.add(row, 16 * quarter + 4 * pixel, 4, self.rule.count_bits, 1):
                    self.pulses[pixel] = pulse + 1

    def wide_bin(self, here: int) -> int:
        """Return the hits of a wide bin."""
        row, lane = divmod(here, 8)
        return self.field(row, 8 * lane, 8)

    def narrow_bins(self, period_cycles: int) -> list[int]:
        """Return the hits of all narrow bins, which are 0 where no wide bin is divided."""
        bins = []
        for cycle in range(period_cycles):
            here = cycle // WIDE_CYCLES
            row, lsb = self.narrow_place(here, cycle)
            for half in range(2):
                bins.append(self.field(row, lsb + 6 * half, 6) if self.marks[here] else 0)
        return bins


def _beside(group: int) -> list[int]:
    """Return the minigroups beside one."""
    row, col = divmod(group, GROUPS_SIDE)
    beside = []
    if row > 0:
        beside.append(group - GROUPS_SIDE)
    if row < GROUPS_SIDE - 1:
        beside.append(group + GROUPS_SIDE)
    if col > 0:
        beside.append(group - 1)
    if col < GROUPS_SIDE - 1:
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


def _gates(narrow: list[int], period_cycles: int) -> list[int]:
    """Return the first cycles of both gates."""
    last = period_cycles - GATE_CYCLES
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


def _by_cycle(edges, phases: int) -> dict:
    """{(pulse, cycle): {minigroup: quarters by pixel}} of the first edge of a pixel in a cycle."""
    found: dict = defaultdict(dict)
    for e in np.lexsort((edges.tick, edges.pulse)):
        row, col = divmod(int(edges.pixel[e]), SIDE)
        group = GROUPS_SIDE * (row // GROUP_SIDE) + col // GROUP_SIDE
        pixel = GROUP_SIDE * (row % GROUP_SIDE) + col % GROUP_SIDE
        cycle, tick = divmod(int(edges.tick[e]), phases)
        hits = found[int(edges.pulse[e]), cycle].setdefault(group, [None] * GROUP_SIDE**2)
        if hits[pixel] is None:
            hits[pixel] = 4 * tick // phases
    return found


def counted_in_rows(edges, phases: int, rule: Rule, pulses: int, period_cycles: int) -> Counted:
    """Count the edges of a frame of one subgroup. Of the rule, this takes the number of regions and
    the highest numbers in the bins.
    """
    groups = [Minigroup(rule) for _ in range(GROUPS_SIDE**2)]
    by_cycle = _by_cycle(edges, phases)
    step = pulses // 5
    _fill(groups, by_cycle, range(step), Minigroup.count_wide)
    _mark(groups, -(-period_cycles // WIDE_CYCLES))
    _fill(groups, by_cycle, range(step, 2 * step), Minigroup.count_narrow)
    for own in groups:
        own.gates = _gates(own.narrow_bins(period_cycles), period_cycles)
        own.clear()
    _fill(groups, by_cycle, range(2 * step, pulses), Minigroup.count_pixels)
    return _read(groups, pulses - 2 * step)


def _fill(groups: list[Minigroup], by_cycle: dict, pulses: range, add: Callable) -> None:
    """Give the hits of some pulses to the minigroups, and the pulse since the first of them."""
    for pulse, cycle in sorted(by_cycle):
        if pulse in pulses:
            for group, hits in by_cycle[pulse, cycle].items():
                add(groups[group], pulse - pulses.start, cycle, hits)


def _mark(groups: list[Minigroup], wide_bins: int) -> None:
    """Choose the wide bins that are divided, and empty the memory."""
    for group, own in enumerate(groups):
        values = []
        for here in range(wide_bins):
            beside = sum(groups[other].wide_bin(here) for other in _beside(group))
            values.append(2 * own.wide_bin(here) + beside)
        divided = _highest(values, own.rule.regions)
        own.marks = [here in divided for here in range(wide_bins)]
    for own in groups:
        own.clear()


def _read(groups: list[Minigroup], pulses: int) -> Counted:
    """Read the rows of all minigroups."""
    start = np.full((len(groups), 2), NO_GATE)
    hits = np.zeros((SIDE**2, 2, 16), np.int64)
    of_pixels = np.full(SIDE**2, pulses)
    for group, own in enumerate(groups):
        for pixel in range(GROUP_SIDE**2):
            row = GROUP_SIDE * (group // GROUPS_SIDE) + pixel // GROUP_SIDE
            col = GROUP_SIDE * (group % GROUPS_SIDE) + pixel % GROUP_SIDE
            inside = SIDE * row + col
            stopped = own.pulses[pixel]
            if stopped is not None:
                of_pixels[inside] = stopped
            for gate, first in enumerate(own.gates):
                if first == NO_GATE:
                    continue
                start[group, gate] = 4 * first
                for place in range(16):
                    cycle, quarter = divmod(place, 4)
                    memory_row = GATE_CYCLES * gate + (first + cycle) % GATE_CYCLES
                    hits[inside, gate, place] = own.field(memory_row, 16 * quarter + 4 * pixel, 4)
    return Counted(start, hits, of_pixels)
