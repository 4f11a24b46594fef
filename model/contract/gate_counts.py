# SPDX-License-Identifier: Apache-2.0
"""Counts of a frame as arrays, and as fields of the packets that carry them (`packet.COUNTS`).

Arrays have a pixel's hits in the order of time. A packet has the rows of a minigroup's memory, in
which the cycles of a gate stand in the order of their numbers modulo 4.
"""

from typing import NamedTuple

import numpy as np

from .counts import COUNT_BITS, COUNT_MOST, GATE_CYCLES, GATES, NO_GATE, ROW_BITS, ROWS
from .parameters import QUARTERS, Sensor
from .pixels import pixel_table

GATE_BINS = GATE_CYCLES * QUARTERS  # of a pixel in a gate
_COUNTS_PER_ROW = ROW_BITS // COUNT_BITS
_COUNT_LSB = np.arange(_COUNTS_PER_ROW, dtype=np.uint64) * np.uint64(COUNT_BITS)
_COUNT_MASK = np.uint64(COUNT_MOST)


class Counts(NamedTuple):
    """Counts of some subgroups in a frame."""

    gate_cycle: np.ndarray  # uint8[subgroups, minigroups, gates], first cycle; NO_GATE: no gate
    # uint8[subgroups, pixels, gates, bins]: hits of a pixel in the quarters of each gate, in the
    # order of time; pixels have their numbers in the subgroup
    gate_hits: np.ndarray
    count_pulses: np.ndarray  # int32[subgroups, pixels], number of pulses in which a pixel counted


def without_gates(sensor: Sensor, subgroups: int) -> Counts:
    """Return the counts of a frame that ended before any hit could be counted."""
    return Counts(
        gate_cycle=np.full((subgroups, sensor.minigroups, GATES), NO_GATE, np.uint8),
        gate_hits=np.zeros((subgroups, sensor.pixels, GATES, GATE_BINS), np.uint8),
        count_pulses=np.zeros((subgroups, sensor.pixels), np.int32),
    )


def counts_of_fields(fields: dict[str, np.ndarray], sensor: Sensor) -> Counts:
    """Return the counts that packets hold, whose subgroups and minigroups are in order.

    fields: uint64[packets, words], lowest bits first.
    """
    table = pixel_table(sensor)
    minigroup = table.minigroup
    bit = table.bit
    subgroups = len(fields["rows"]) // sensor.minigroups
    of_minigroups = (subgroups, sensor.minigroups)
    gate_cycle = _items(fields["gates"], np.uint8)[:, :GATES]
    pulses = _items(fields["pulses"], np.uint16)[:, : sensor.minigroup_pixels]
    counts = fields["rows"][..., None] >> _COUNT_LSB & _COUNT_MASK
    memory = counts.astype(np.uint8).reshape(*of_minigroups, GATES, GATE_CYCLES, QUARTERS, -1)
    gate_cycle = gate_cycle.reshape(*of_minigroups, GATES)
    in_time = np.take_along_axis(memory, _places(gate_cycle), axis=3)
    of_pixels = in_time.transpose(0, 1, 5, 2, 3, 4)[:, minigroup, bit]
    return Counts(
        gate_cycle=gate_cycle,
        gate_hits=np.ascontiguousarray(of_pixels).reshape(subgroups, -1, GATES, GATE_BINS),
        count_pulses=pulses.reshape(*of_minigroups, -1)[:, minigroup, bit].astype(np.int32),
    )


def fields_of_counts(counts: Counts, sensor: Sensor, first: int) -> dict[str, np.ndarray]:
    """Return the fields of the packets that hold counts, uint64[packets, words].

    first: number of the first subgroup.
    """
    table = pixel_table(sensor)
    pixel = np.lexsort((table.bit, table.minigroup)).reshape(sensor.minigroups, -1)
    subgroups = len(counts.gate_cycle)
    packets = subgroups * sensor.minigroups
    subgroup = np.repeat(np.arange(first, first + subgroups), sensor.minigroups)
    minigroup = np.tile(np.arange(sensor.minigroups), subgroups)
    of_minigroups = counts.gate_hits[:, pixel].reshape(
        *counts.gate_cycle.shape[:2], -1, GATES, GATE_CYCLES, QUARTERS
    )
    in_time = of_minigroups.transpose(0, 1, 3, 4, 5, 2)
    memory = np.empty_like(in_time)
    np.put_along_axis(memory, _places(counts.gate_cycle), in_time, axis=3)
    nibbles = memory.reshape(packets, ROWS, _COUNTS_PER_ROW).astype(np.uint64)
    return {
        "gates": _words(counts.gate_cycle.reshape(packets, -1)),
        "minigroup": minigroup[:, None].astype(np.uint64),
        "subgroup": subgroup[:, None].astype(np.uint64),
        "pulses": _words(counts.count_pulses[:, pixel].reshape(packets, -1).astype(np.uint16)),
        "rows": np.bitwise_or.reduce(nibbles << _COUNT_LSB, axis=2),
    }


def _places(gate_cycle: np.ndarray) -> np.ndarray:
    """int64[subgroups, minigroups, gates, cycles, 1, 1]: where the cycles of each gate stand in the
    memory, in the order of time.
    """
    cycle = gate_cycle[..., None] + np.arange(GATE_CYCLES)
    return (cycle % GATE_CYCLES)[..., None, None]


def _items(words: np.ndarray, dtype: type[np.unsignedinteger]) -> np.ndarray:
    """Return words of 64 bits as items, lowest bits first."""
    return np.ascontiguousarray(words, "<u8").view(np.dtype(dtype).newbyteorder("<")).astype(dtype)


def _words(items: np.ndarray) -> np.ndarray:
    """Return the items of each row as uint64[rows, words], lowest bits first."""
    rows, number = items.shape
    per_word = ROW_BITS // (8 * items.itemsize)
    padded = np.zeros((rows, -(-number // per_word) * per_word), items.dtype.newbyteorder("<"))
    padded[:, :number] = items
    return padded.view("<u8").astype(np.uint64)
