# SPDX-License-Identifier: Apache-2.0
"""Counts instead of events, on paper: what a sensor would count in gates that it finds itself.

A frame has three steps, which share one memory. First, every minigroup fills a histogram of the
whole period with its own hits, in wide bins. In the highest of these, it then fills a histogram
with narrow bins, and takes its gates from it. At last, every pixel counts its hits in the bins of
its minigroup's gates. docs/counts.md has the exact rule, which this file makes variable. All
numbers are integers, and times are quarters of a cycle.

A hit is an accepted edge, whatever the tree does. A pixel stops when one of its counters is full,
and remembers after how many pulses, so that no bin saturates.
"""

import enum
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from coincid.model.contract.edges import Edges
from coincid.model.contract.parameters import QUARTERS, Sensor, bits_for
from coincid.model.contract.pixels import pixel_table

from .count_kernels import NO_GATE, Counts, Hits, count_hits, fill

STEPS = 5  # parts of a frame's pulses


class Beside(enum.Enum):
    """Which neighbours of a minigroup help it to choose its regions."""

    NONE = 0
    SUBGROUP = 1  # of its own subgroup
    ALL = 2  # also of other subgroups


class Rule(NamedTuple):
    """What a sensor counts. Times are quarters of a cycle."""

    wide_steps: int = 1  # fifths of the pulses; 0: the narrow bins cover the whole period
    wide_quarters: int = 16  # width of a wide bin
    wide_bits: int = 8
    beside: Beside = Beside.SUBGROUP
    regions: int = 10  # wide bins that are divided into narrow ones
    narrow_steps: int = 1  # fifths of the pulses
    narrow_quarters: int = 2
    narrow_bits: int = 6
    peak_bins: int = 4  # narrow bins that are a peak together
    gates: int = 2
    gate_step: int = QUARTERS  # a gate begins at a multiple
    bins: int = 16  # of a gate, a quarter each
    count_bits: int = 4

    def wide_pulses(self, pulses: int) -> int:
        """Return the number of pulses of the wide bins."""
        return self.wide_steps * (pulses // STEPS)

    def first_pulses(self, pulses: int) -> int:
        """Return the number of pulses before those that pixels count."""
        return (self.wide_steps + self.narrow_steps) * (pulses // STEPS)


def hits_of(edges: Edges, sensor: Sensor) -> Hits:
    """Return the hits among edges: the first one of each pixel in a cycle. No pixel is masked, and
    gating is off.
    """
    table = pixel_table(sensor)
    subgroup = table.subgroup[edges.pixel]
    order = np.lexsort((edges.tick, edges.pulse, subgroup))
    pulse = edges.pulse[order].astype(np.int64)
    quarter = edges.tick[order].astype(np.int64) // sensor.quarter_ticks
    pixel = edges.pixel[order].astype(np.int64)
    cycle = quarter // QUARTERS
    in_cycle = (pulse * (cycle.max(initial=0) + 1) + cycle) * sensor.array_pixels + pixel
    _, first = np.unique(in_cycle, return_index=True)
    kept = np.sort(first)
    return Hits(
        bounds=np.searchsorted(subgroup[order][kept], np.arange(sensor.subgroups + 1)),
        pulse=pulse[kept],
        quarter=quarter[kept],
        pixel=table.inside[pixel[kept]].astype(np.int64),
    )


def find_gates(
    hits: Hits, sensor: Sensor, rule: Rule, pulses: int, period_cycles: int
) -> np.ndarray:
    """int64[subgroups, minigroups, gates]: first quarters, from the first pulses of a frame."""
    wide_end = rule.wide_pulses(pulses)
    end = rule.first_pulses(pulses)
    bins = wide_bins(rule, period_cycles)
    region = np.ones((sensor.subgroups, sensor.minigroups, bins), np.bool_)
    if wide_end:
        wide = histograms(hits, sensor, range(wide_end), rule.wide_quarters, rule.wide_bits, region)
        region = regions_of(2 * wide + of_neighbours(wide, sensor, rule.beside), rule)
    inside = np.repeat(region, rule.wide_quarters // rule.narrow_quarters, axis=2)
    seen = range(wide_end, end)
    narrow = histograms(hits, sensor, seen, rule.narrow_quarters, rule.narrow_bits, inside)
    return gates_of(narrow, rule, QUARTERS * period_cycles)


def wide_bins(rule: Rule, period_cycles: int) -> int:
    """Return the number of wide bins of a period; the last one may be longer than its rest."""
    return -(-QUARTERS * period_cycles // rule.wide_quarters)


def histograms(
    hits: Hits, sensor: Sensor, pulses: range, width: int, bits: int, watched: np.ndarray
) -> np.ndarray:
    """int64[subgroups, minigroups, bins]: hits of each minigroup in some pulses, in the bins of
    `width` quarters that it watches.
    """
    minigroup = pixel_table(sensor).minigroup
    histogram = np.zeros(watched.shape, np.int64)
    most = (1 << bits) - 1
    fill(hits, minigroup, pulses.start, pulses.stop, width, most, watched, histogram)
    return histogram


def of_neighbours(histogram: np.ndarray, sensor: Sensor, beside: Beside) -> np.ndarray:
    """int64[subgroups, minigroups, bins]: sum of the up to four minigroups beside each."""
    if beside is Beside.NONE:
        return np.zeros_like(histogram)
    if beside is Beside.ALL:
        return _of_all_neighbours(histogram, sensor)
    rows = sensor.subgroup[0] // sensor.minigroup[0]
    cols = sensor.subgroup[1] // sensor.minigroup[1]
    grid = histogram.reshape(sensor.subgroups, rows, cols, histogram.shape[2])
    around = np.pad(grid, ((0, 0), (1, 1), (1, 1), (0, 0)))
    vertical = around[:, :-2, 1:-1] + around[:, 2:, 1:-1]
    horizontal = around[:, 1:-1, :-2] + around[:, 1:-1, 2:]
    return (vertical + horizontal).reshape(histogram.shape)


def _of_all_neighbours(histogram: np.ndarray, sensor: Sensor) -> np.ndarray:
    """The same, also of other subgroups."""
    table = pixel_table(sensor)
    row, col = np.divmod(np.arange(sensor.array_pixels), sensor.cols)
    height, width = sensor.minigroup
    number = table.subgroup * sensor.minigroups + table.minigroup[table.inside]
    grid = np.empty((sensor.rows // height, sensor.cols // width), np.int64)
    grid[row // height, col // width] = number
    flat = histogram.reshape(-1, histogram.shape[2])
    image = np.pad(flat[grid], ((1, 1), (1, 1), (0, 0)))
    total = np.empty_like(flat)
    total[grid] = image[:-2, 1:-1] + image[2:, 1:-1] + image[1:-1, :-2] + image[1:-1, 2:]
    return total.reshape(histogram.shape)


def regions_of(wide: np.ndarray, rule: Rule) -> np.ndarray:
    """bool[subgroups, minigroups, bins]: the highest wide bins; of equal ones, the first."""
    order = np.argsort(-wide, axis=2, kind="stable")
    region = np.zeros(wide.shape, np.bool_)
    np.put_along_axis(region, order[:, :, : rule.regions], values=True, axis=2)
    return region


def gates_of(narrow: np.ndarray, rule: Rule, period_quarters: int) -> np.ndarray:
    """int64[subgroups, minigroups, gates]: first quarters, multiples of the rule's step.

    The middle of a gate is the centre of the highest peak; of equal ones, the first. A further gate
    leaves out the narrow bins with their middle in a gate, and does not overlap the first.
    """
    left = narrow.copy()
    start = np.full((*narrow.shape[:2], rule.gates), NO_GATE)
    last = (period_quarters - rule.bins) // rule.gate_step * rule.gate_step
    doubled_middle = rule.narrow_quarters * (2 * np.arange(narrow.shape[2]) + 1)
    for gate in range(rule.gates):
        height, first = _highest(left, rule)
        first = np.clip(first, 0, last)
        for other in range(gate):
            first = _beside(first, start[:, :, other], rule.bins)
        found = (height > 0) & (first >= 0) & (first <= last)
        start[:, :, gate] = np.where(found, first, NO_GATE)
        doubled_first = 2 * first[..., None]
        after = doubled_middle >= doubled_first
        before = doubled_middle < doubled_first + 2 * rule.bins
        left[after & before] = 0
    return start


def _highest(narrow: np.ndarray, rule: Rule) -> tuple[np.ndarray, np.ndarray]:
    """int64[subgroups, minigroups] twice: hits of the highest peaks, and first quarters of gates
    around their centres, halves rounded up.
    """
    peaks = sliding_window_view(narrow, rule.peak_bins, axis=2)
    at = peaks.sum(axis=3).argmax(axis=2)
    peak = np.take_along_axis(peaks, at[..., None, None], axis=2)[:, :, 0]
    height = peak.sum(axis=2)
    moment = (peak * (2 * np.arange(rule.peak_bins) + 1)).sum(axis=2)
    some = np.maximum(height, 1)
    doubled_centre = rule.narrow_quarters * (2 * at * some + moment)  # times the height
    doubled_begin = doubled_centre - (rule.bins - rule.gate_step) * some
    return height, rule.gate_step * (doubled_begin // (2 * rule.gate_step * some))


def _beside(first: np.ndarray, other: np.ndarray, bins: int) -> np.ndarray:
    """Move gates that overlap others to their side; int64, quarters."""
    overlaps = np.abs(first - other) < bins
    moved = np.where(first >= other, other + bins, other - bins)
    return np.where(overlaps & (other >= 0), moved, first)


def count(hits: Hits, start: np.ndarray, sensor: Sensor, rule: Rule, pulses: range) -> Counts:
    """Count the hits of some pulses in gates that begin at the quarters `start`."""
    gates = start.shape[2]
    counts = Counts(
        start=start,
        hits=np.zeros((sensor.subgroups, sensor.pixels, gates, rule.bins), np.int64),
        pulses=np.full((sensor.subgroups, sensor.pixels), len(pulses)),
        second_pulses=len(pulses),
    )
    minigroup = pixel_table(sensor).minigroup
    most = (1 << rule.count_bits) - 1
    count_hits(hits, minigroup, pulses.start, pulses.stop, most, counts)
    return counts


def memory_bits(rule: Rule, sensor: Sensor, pulses: int, period_cycles: int) -> float:
    """Return the bits of memory per pixel: those of the largest step, since steps share it.

    A step keeps what it finds beside its histogram: a bit for each wide bin says whether this is
    divided; then the begins of the gates.
    """
    pixels = sensor.pixels // sensor.minigroups
    starts = rule.gates * _start_bits(rule, period_cycles)
    bins = wide_bins(rule, period_cycles)
    if rule.wide_steps:
        narrow_bins = rule.regions * (rule.wide_quarters // rule.narrow_quarters)
        wide = bins * (rule.wide_bits + 1)
        narrow = bins + narrow_bins * rule.narrow_bits + starts
    else:
        wide = 0
        narrow = -(-QUARTERS * period_cycles // rule.narrow_quarters) * rule.narrow_bits + starts
    return max(wide, narrow, sent_bits(rule, sensor, pulses, period_cycles)) / pixels


def _start_bits(rule: Rule, period_cycles: int) -> int:
    return bits_for(QUARTERS * period_cycles // rule.gate_step)


def sent_bits(rule: Rule, sensor: Sensor, pulses: int, period_cycles: int) -> int:
    """Return the bits that leave the sensor for each minigroup."""
    pixels = sensor.pixels // sensor.minigroups
    of_pulses = bits_for(pulses - rule.first_pulses(pulses))
    bins = rule.gates * rule.bins
    of_pixel = bins * rule.count_bits + of_pulses
    return pixels * of_pixel + rule.gates * _start_bits(rule, period_cycles)
