# SPDX-License-Identifier: Apache-2.0
"""Counts instead of events, on paper: what a sensor would count in gates that it finds itself.

A frame has two passes. In the first, every minigroup fills a coarse histogram with its own hits, and
takes its gates from it. In the second, every pixel counts its hits in the bins of its minigroup's
gates, by the stamps of the events. The events are those of the golden model; no link and no FIFO
stands between a window and its counter.

A hit counts in the bin of its event's stamp. A pixel stops when one of its counters is full, and
remembers after how many pulses, so that no bin saturates.
"""

from typing import NamedTuple

import numpy as np

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.parameters import Sensor, bits_for
from coincid.model.contract.pixels import pixel_table

from .count_kernels import NO_GATE, Counts, Stops, count_events, count_hits, fill_coarsely


class Pass(NamedTuple):
    """Which events a pass sees."""

    window_ticks: int
    threshold: int


class Rule(NamedTuple):
    """What a sensor counts."""

    first: Pass = Pass(window_ticks=16, threshold=1)
    second: Pass = Pass(window_ticks=4, threshold=1)
    first_share: float = 0.3  # of the pulses
    coarse_ticks: int = 64  # width of a coarse bin
    coarse_bits: int = 4
    gates: int = 2
    bins: int = 14  # of a gate
    bin_ticks: int = 8
    count_bits: int = 4
    event_ticks: int = 4  # width of a bin of events
    event_bits: int = 6
    event_minigroups: int = 4  # one of so many minigroups counts events, too: 1, 2 or 4

    @property
    def gate_ticks(self) -> int:
        """Length of a gate."""
        return self.bins * self.bin_ticks

    @property
    def event_bins(self) -> int:
        """Number of a gate's bins of events."""
        return self.gate_ticks // self.event_ticks

    def first_pulses(self, pulses: int) -> int:
        """Return the number of pulses of the first pass."""
        return round(self.first_share * pulses)


def stops_of(run: Run, seen: Pass) -> Stops:
    """Return the events of a pass in all pulses of a run, whatever its settings."""
    setup = unlimited(run.setup, seen)
    played = Run(setup, cache=run.cache, workers=run.workers).result
    order = np.argsort(played["subgroup"], kind="stable")
    return Stops(
        bounds=np.searchsorted(
            played["subgroup"][order], np.arange(setup.config.sensor.subgroups + 1)
        ),
        pulse=played["pulse"][order].astype(np.int64),
        stamp=played["stamp"][order].astype(np.int64),
        hits=played["hits"][order],
    )


def unlimited(setup: Setup, seen: Pass) -> Setup:
    """Return a setup in which every event of a pass leaves the sensor: each subgroup has its own
    stream.
    """
    config = setup.config.with_sensor(streams=setup.config.sensor.subgroups)
    return setup.but(
        config=config,
        frame={"format": "id", "link_gbps": 0},
        subgroup={"window": seen.window_ticks, "threshold": seen.threshold},
    )


def coarse_histograms(
    stops: Stops, sensor: Sensor, rule: Rule, pulses: int, period_ticks: int
) -> np.ndarray:
    """int64[subgroups, minigroups, bins]: hits of each minigroup in the first so many pulses."""
    minigroup = pixel_table(sensor).minigroup
    bins = -(-period_ticks // rule.coarse_ticks)
    histogram = np.zeros((sensor.subgroups, sensor.minigroups, bins), np.int64)
    most = (1 << rule.coarse_bits) - 1
    fill_coarsely(stops, minigroup, pulses, rule.coarse_ticks, most, histogram)
    return histogram


def gates_of(coarse: np.ndarray, rule: Rule) -> np.ndarray:
    """int64[subgroups, minigroups, gates]: first ticks, multiples of a fine bin.

    The middle of a gate is the centre of the highest pair of coarse bins. A further gate leaves out
    the coarse bins with their middle in a gate, and does not overlap the first.
    """
    left = coarse.copy()
    start = np.full((*coarse.shape[:2], rule.gates), NO_GATE)
    row, column = np.indices(coarse.shape[:2])
    middle = (np.arange(coarse.shape[2]) + 0.5) * rule.coarse_ticks
    for gate in range(rule.gates):
        pair = left[:, :, :-1] + left[:, :, 1:]
        at = pair.argmax(axis=2)
        height = pair[row, column, at]
        later = left[row, column, at + 1] / np.maximum(height, 1)
        centre = (at + 0.5 + later) * rule.coarse_ticks
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


def count(stops: Stops, start: np.ndarray, sensor: Sensor, rule: Rule, pulses: range) -> Counts:
    """Count the hits of some pulses in gates that begin at the ticks `start`."""
    gates = start.shape[2]
    counts = Counts(
        start=start,
        hits=np.zeros((sensor.subgroups, sensor.pixels, gates, rule.bins), np.int64),
        pulses=np.full((sensor.subgroups, sensor.pixels), len(pulses)),
        events=np.zeros((sensor.subgroups, sensor.minigroups, gates, rule.event_bins), np.int64),
        event_pulses=np.tile(len(pulses) * _counts_events(sensor, rule), (sensor.subgroups, 1)),
        second_pulses=len(pulses),
    )
    minigroup = pixel_table(sensor).minigroup
    most = (1 << rule.count_bits) - 1
    most_events = (1 << rule.event_bits) - 1
    count_hits(stops, minigroup, pulses.start, pulses.stop, rule.bin_ticks, most, counts)
    count_events(stops, pulses.start, pulses.stop, rule.event_ticks, most_events, counts)
    return counts


def _counts_events(sensor: Sensor, rule: Rule) -> np.ndarray:
    """int64[minigroups]: 1 if a minigroup counts events; these are spread evenly."""
    across = sensor.subgroup[1] // sensor.minigroup[1]
    row, column = np.divmod(np.arange(sensor.minigroups), across)
    if rule.event_minigroups == 4:
        return ((row % 2 == 0) & (column % 2 == 0)).astype(np.int64)
    return ((row + column) % rule.event_minigroups == 0).astype(np.int64)


def memory_bits(rule: Rule, sensor: Sensor, pulses: int, period_ticks: int) -> float:
    """Return the mean bits of memory per pixel: the larger one of both passes, which share it."""
    pixels = sensor.pixels // sensor.minigroups
    coarse = -(-period_ticks // rule.coarse_ticks) * rule.coarse_bits
    return max(coarse, sent_bits(rule, sensor, pulses, period_ticks)) / pixels


def sent_bits(rule: Rule, sensor: Sensor, pulses: int, period_ticks: int) -> float:
    """Return the bits that leave the sensor for each minigroup, as a mean."""
    pixels = sensor.pixels // sensor.minigroups
    of_pulses = bits_for(pulses - rule.first_pulses(pulses))
    of_start = bits_for(-(-period_ticks // rule.bin_ticks))
    bins = rule.gates * rule.bins
    of_pixel = bins * rule.count_bits + of_pulses
    event_bins = rule.gates * rule.event_bins
    of_events = (event_bins * rule.event_bits + of_pulses) / rule.event_minigroups
    return pixels * of_pixel + of_events + rule.gates * of_start
