# SPDX-License-Identifier: Apache-2.0
"""Counts in their packets: a plain writer of docs/contract.md's words, and frames that are not
right.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coincid.model.contract.gate_counts import Counts, fields_of_counts, without_gates
from coincid.model.contract.packet import (
    COUNTS,
    FRAME_END,
    RECORD,
    layout,
    packet_beats,
    packet_fields,
)
from coincid.model.contract.pixels import pixel_table
from coincid.model.contract.stream import StreamError, decode_frame

from ..random_cases import built_sensor

SENSORS = {
    "default": built_sensor(dict(rows=8, cols=16, counts=1)),
    "flat": built_sensor(dict(rows=8, cols=36, subgroup=[2, 12], streams=5, counts=1)),
}
NO_GATE = 255
HEAD = 6 << 61 | 2 << 23
END = 7 << 61
BEATS = 10  # of a packet
seeds = st.integers(0, 2**32 - 1)


def random_counts(sensor, subgroups, seed):
    """Return counts with all values; some gates are missing."""
    rng = np.random.default_rng(seed)
    gate_cycle = rng.integers(0, 253, (subgroups, sensor.minigroups, 2)).astype(np.uint8)
    gate_cycle[rng.random(gate_cycle.shape) < 0.2] = NO_GATE
    hits = rng.integers(0, 16, (subgroups, sensor.pixels, 2, 16)).astype(np.uint8)
    hits[gate_cycle[:, pixel_table(sensor).minigroup] == NO_GATE] = 0
    pulses = rng.integers(0, 1 << 16, (subgroups, sensor.pixels)).astype(np.int32)
    return Counts(gate_cycle, hits, pulses)


def plain_words(counts, sensor, first):
    """Return the packets of some subgroups as Python's integers, field by field."""
    sr, sc = sensor.subgroup
    beats = []
    for s in range(len(counts.gate_cycle)):
        for m in range(sensor.minigroups):
            row = m // (sc // 2) * 2
            col = m % (sc // 2) * 2
            pixels = [row * sc + col, row * sc + col + 1]
            pixels += [pixel + sc for pixel in pixels]
            gates = [int(gate) for gate in counts.gate_cycle[s, m]]
            beats.append((first + s) << 48 | m << 16 | gates[1] << 8 | gates[0])
            beats.append(
                sum(int(counts.count_pulses[s, i]) << 16 * j for j, i in enumerate(pixels))
            )
            rows = [0] * 8
            for g, gate in enumerate(gates):
                for place in range(16):
                    cycle = gate + place // 4
                    for j, i in enumerate(pixels):
                        count = int(counts.gate_hits[s, i, g, place])
                        rows[4 * g + cycle % 4] |= count << 16 * (place % 4) + 4 * j
            beats += rows
    return beats


def frame_of(words, sensor, subgroups, head=HEAD):
    tail = [0] * (layout(sensor).length(FRAME_END, subgroups) - 1)
    return np.array([head, *words, END, *tail], np.uint64)


@pytest.mark.parametrize("name", SENSORS)
@given(seed=seeds)
def test_counts_are_those_of_the_words(name, seed):
    sensor = SENSORS[name]
    for stream in range(sensor.streams):
        span = sensor.stream_subgroups(stream)
        counts = random_counts(sensor, len(span), seed)
        words = plain_words(counts, sensor, span.start)
        frame = decode_frame(frame_of(words, sensor, len(span)), sensor, len(span))
        for one, other in zip(frame.counts, counts, strict=True):
            np.testing.assert_array_equal(one, other)
            assert one.dtype == other.dtype
        assert len(frame.events) == len(frame.records) == 0
        written = fields_of_counts(counts, sensor, span.start)
        at = np.arange(0, len(words), BEATS)
        read = packet_fields(np.array(words, np.uint64), at, sensor, COUNTS)
        assert written.keys() == read.keys()
        for field, values in read.items():
            np.testing.assert_array_equal(written[field], values, err_msg=field)
        assert packet_beats(written, sensor, COUNTS).ravel().tolist() == words


def test_a_frame_without_gates():
    sensor = SENSORS["default"]
    counts = without_gates(sensor, 2)
    frame = decode_frame(frame_of(plain_words(counts, sensor, 0), sensor, 2), sensor, 2)
    for one, other in zip(frame.counts, counts, strict=True):
        np.testing.assert_array_equal(one, other)
        assert one.dtype == other.dtype


def test_frames_that_are_not_right():
    sensor = SENSORS["default"]
    counts = random_counts(sensor, 2, 1)
    counts.gate_cycle[1, 2] = 7, NO_GATE
    counts.gate_hits[:, :, 1][counts.gate_cycle[:, pixel_table(sensor).minigroup, 1] == NO_GATE] = 0
    words = plain_words(counts, sensor, 0)
    record = [RECORD.code << 61] + [0] * (layout(sensor).length(RECORD) - 1)
    event = [1 << 61]

    def error_of(words, head=HEAD):
        with pytest.raises(StreamError) as error:
            decode_frame(frame_of(words, sensor, 2, head), sensor, 2)
        return str(error.value)

    assert error_of(words[BEATS:]) == "the frame has counts of 31 minigroups, not of 32"
    assert error_of(words + words[-BEATS:]) == "the frame has counts of 33 minigroups, not of 32"
    swapped = words[:20] + words[30:40] + words[20:30] + words[40:]
    assert error_of(swapped) == (
        f"beat 21 of {len(words) + 14}: counts of minigroup 3 of subgroup 0 where those of minigroup 2 of"
        " subgroup 0 are due"
    )
    other_subgroup = words[: 10 * 16] + [words[10 * 16] ^ 2 << 48] + words[10 * 16 + 1 :]
    assert "minigroup 0 of subgroup 3 where those of minigroup 0 of subgroup 1" in error_of(
        other_subgroup
    )
    for foreign in (record, event, [5 << 61]):
        assert "not a packet header" in error_of(words[:10] + foreign + words[10:])
    assert "not a packet header" in error_of(words, head=6 << 61)
    assert "not a packet header" in error_of(words[:-1])
    row = 10 * (16 + 2) + 2 + 4
    in_missing_gate = words[:row] + [1] + words[row + 1 :]
    assert error_of(in_missing_gate) == "the frame has hits in a gate that it does not have"


def test_a_sensor_without_counts_does_not_read_any():
    sensor = built_sensor(dict(rows=8, cols=16))
    words = plain_words(without_gates(sensor, 2), sensor, 0)
    with pytest.raises(StreamError, match="not a packet header"):
        decode_frame(frame_of(words, sensor, 2), sensor, 2)
