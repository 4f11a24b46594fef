# SPDX-License-Identifier: Apache-2.0
"""Counts instead of events, on paper: what a sensor would count in gates that it finds itself.

A frame has three steps, which share one memory. First, every minigroup fills a histogram of the whole
period with its own hits, in wide bins. In the highest of these, it then fills a histogram with narrow
bins, and takes its gates from it. At last, every pixel counts its hits in the bins of its minigroup's
gates. The windows are those of the golden model; no link and no FIFO stands between a window and a
counter.

A hit is a pixel's first edge in a window, and counts in the bin of this edge. A pixel stops when one
of its counters is full, and remembers after how many pulses, so that no bin saturates.
"""

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.edges import Fate
from coincid.model.contract.parameters import Sensor, bits_for
from coincid.model.contract.pixels import pixel_table

from .count_kernels import NO_GATE, Counts, Hits, count_hits, fill


class Rule(NamedTuple):
    """What a sensor counts."""

    window_ticks: int = 32
    wide_share: float = 0.2  # of the pulses; 0: the narrow bins cover the whole period
    wide_ticks: int = 128  # width of a wide bin
    wide_bits: int = 8
    wide_neighbours: float = 0.5  # weight of the four minigroups beside this one
    regions: int = 10  # wide bins that are divided into narrow ones
    narrow_share: float = 0.2  # of the pulses
    narrow_ticks: int = 16
    narrow_bits: int = 6
    peak_bins: int = 4  # narrow bins that are a peak together
    gates: int = 2
    bins: int = 16  # of a gate
    bin_ticks: int = 8
    count_bits: int = 4

    @property
    def gate_ticks(self) -> int:
        """Length of a gate."""
        return self.bins * self.bin_ticks

    def wide_pulses(self, pulses: int) -> int:
        """Return the number of pulses of the wide bins."""
        return round(self.wide_share * pulses)

    def first_pulses(self, pulses: int) -> int:
        """Return the number of pulses before those that pixels count."""
        return round((self.wide_share + self.narrow_share) * pulses)


def hits_of(run: Run, rule: Rule) -> Hits:
    """Return the hits in all pulses of a run, whatever its settings."""
    setup = unlimited(run.setup, rule.window_ticks)
    played = Run(setup, cache=run.cache, workers=run.workers)
    counted = np.isin(played.result["fate"], (Fate.OPENING, Fate.COUNTED))
    edges = played.edges.take(counted)
    sensor = setup.config.sensor
    table = pixel_table(sensor)
    subgroup = table.subgroup[edges.pixel]
    order = np.lexsort((edges.tick, edges.pulse, subgroup))
    return Hits(
        bounds=np.searchsorted(subgroup[order], np.arange(sensor.subgroups + 1)),
        pulse=edges.pulse[order].astype(np.int64),
        tick=edges.tick[order].astype(np.int64),
        pixel=table.inside[edges.pixel[order]].astype(np.int64),
    )


def unlimited(setup: Setup, window_ticks: int) -> Setup:
    """Return a setup in which every window becomes an event that leaves the sensor: each subgroup has
    its own stream.
    """
    config = setup.config.with_sensor(streams=setup.config.sensor.subgroups)
    return setup.but(
        config=config,
        frame={"format": "id", "link_gbps": 0},
        subgroup={"window": window_ticks, "threshold": 1},
    )


def find_gates(
    hits: Hits, sensor: Sensor, rule: Rule, pulses: int, period_ticks: int
) -> np.ndarray:
    """int64[subgroups, minigroups, gates]: first ticks, from the first pulses of a frame."""
    wide_end = rule.wide_pulses(pulses)
    end = rule.first_pulses(pulses)
    bins = -(-period_ticks // rule.wide_ticks)
    region = np.ones((sensor.subgroups, sensor.minigroups, bins), np.bool_)
    if wide_end:
        wide = histograms(hits, sensor, range(wide_end), rule.wide_ticks, rule.wide_bits, region)
        region = regions_of(wide + rule.wide_neighbours * of_neighbours(wide, sensor), rule)
    inside = np.repeat(region, rule.wide_ticks // rule.narrow_ticks, axis=2)
    seen = range(wide_end, end)
    narrow = histograms(hits, sensor, seen, rule.narrow_ticks, rule.narrow_bits, inside)
    return gates_of(narrow, rule)


def histograms(
    hits: Hits, sensor: Sensor, pulses: range, width: int, bits: int, watched: np.ndarray
) -> np.ndarray:
    """int64[subgroups, minigroups, bins]: hits of each minigroup in some pulses, in the bins that it
    watches.
    """
    minigroup = pixel_table(sensor).minigroup
    histogram = np.zeros(watched.shape, np.int64)
    most = (1 << bits) - 1
    fill(hits, minigroup, pulses.start, pulses.stop, width, most, watched, histogram)
    return histogram


def of_neighbours(histogram: np.ndarray, sensor: Sensor) -> np.ndarray:
    """int64[subgroups, minigroups, bins]: sum of the up to four minigroups beside each, also of other
    subgroups.
    """
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


def gates_of(narrow: np.ndarray, rule: Rule) -> np.ndarray:
    """int64[subgroups, minigroups, gates]: first ticks, multiples of a fine bin.

    The middle of a gate is the centre of the highest peak. A further gate leaves out the narrow bins
    with their middle in a gate, and does not overlap the first.
    """
    left = narrow.copy()
    start = np.full((*narrow.shape[:2], rule.gates), NO_GATE)
    middle = (np.arange(narrow.shape[2]) + 0.5) * rule.narrow_ticks
    for gate in range(rule.gates):
        peaks = sliding_window_view(left, rule.peak_bins, axis=2)
        at = peaks.sum(axis=3).argmax(axis=2)
        peak = np.take_along_axis(peaks, at[..., None, None], axis=2)[:, :, 0]
        height = peak.sum(axis=2)
        moment = (peak * (np.arange(rule.peak_bins) + 0.5)).sum(axis=2)
        centre = (at + moment / np.maximum(height, 1)) * rule.narrow_ticks
        steps = np.rint((centre - rule.gate_ticks / 2) / rule.bin_ticks).astype(np.int64)
        first = np.maximum(0, rule.bin_ticks * steps)
        for other in range(gate):
            first = _beside(first, start[:, :, other], rule.gate_ticks)
        found = (height > 0) & (first >= 0)
        start[:, :, gate] = np.where(found, first, NO_GATE)
        inside = (middle >= first[..., None]) & (middle < first[..., None] + rule.gate_ticks)
        left[inside] = 0
    return start


def _beside(first: np.ndarray, other: np.ndarray, gate_ticks: int) -> np.ndarray:
    """Move gates that overlap others to their side; int64, ticks."""
    overlaps = np.abs(first - other) < gate_ticks
    moved = np.where(first >= other, other + gate_ticks, other - gate_ticks)
    return np.where(overlaps & (other >= 0), moved, first)


def count(hits: Hits, start: np.ndarray, sensor: Sensor, rule: Rule, pulses: range) -> Counts:
    """Count the hits of some pulses in gates that begin at the ticks `start`."""
    gates = start.shape[2]
    counts = Counts(
        start=start,
        hits=np.zeros((sensor.subgroups, sensor.pixels, gates, rule.bins), np.int64),
        pulses=np.full((sensor.subgroups, sensor.pixels), len(pulses)),
        second_pulses=len(pulses),
    )
    minigroup = pixel_table(sensor).minigroup
    most = (1 << rule.count_bits) - 1
    count_hits(hits, minigroup, pulses.start, pulses.stop, rule.bin_ticks, most, counts)
    return counts


def memory_bits(rule: Rule, sensor: Sensor, pulses: int, period_ticks: int) -> float:
    """Return the bits of memory per pixel: those of the largest step, since steps share it.

    A step keeps what it finds beside its histogram: a bit for each wide bin says whether this is
    divided; then the begins of the gates.
    """
    pixels = sensor.pixels // sensor.minigroups
    starts = rule.gates * _start_bits(rule, period_ticks)
    wide_bins = -(-period_ticks // rule.wide_ticks)
    if rule.wide_share:
        narrow_bins = rule.regions * (rule.wide_ticks // rule.narrow_ticks)
        wide = wide_bins * (rule.wide_bits + 1)
        narrow = wide_bins + narrow_bins * rule.narrow_bits + starts
    else:
        wide = 0
        narrow = -(-period_ticks // rule.narrow_ticks) * rule.narrow_bits + starts
    return max(wide, narrow, sent_bits(rule, sensor, pulses, period_ticks)) / pixels


def _start_bits(rule: Rule, period_ticks: int) -> int:
    return bits_for(-(-period_ticks // rule.bin_ticks))


def sent_bits(rule: Rule, sensor: Sensor, pulses: int, period_ticks: int) -> int:
    """Return the bits that leave the sensor for each minigroup."""
    pixels = sensor.pixels // sensor.minigroups
    of_pulses = bits_for(pulses - rule.first_pulses(pulses))
    bins = rule.gates * rule.bins
    of_pixel = bins * rule.count_bits + of_pulses
    return pixels * of_pixel + rule.gates * _start_bits(rule, period_ticks)
