# SPDX-License-Identifier: Apache-2.0
"""Beats of a frame that are written by hand, after docs/contract.md: what they hold, and what is
wrong with others.
"""

import numpy as np
import pytest
from attrs import evolve

from coincid.model.contract.config import parse_config
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.packet import HEADER
from coincid.model.contract.parameters import OFFSET_NONE
from coincid.model.contract.result import ResultBuilder, frame_rows
from coincid.model.contract.stream import StreamError, decode_frame

CONFIG = parse_config(
    {"sensor": {"rows": 8, "cols": 16}, "frame": {"pulses": 20, "minigroup_records": True}}
)
SENSOR = CONFIG.sensor
SHORT, ID, FULL, RECORD, START, END = 1, 2, 3, 4, 6, 7
# counter k of subgroup s is 100 s + k + 1; a beat has two
COUNTERS = [[100 * s + k + 1 for k in range(11)] for s in range(2)]


def header(kind, pulse=0, subgroup=0, stamp=0, winner=0, count=0, overrun=0):
    return (
        kind << 61
        | overrun << 60
        | subgroup << 48
        | pulse << 32
        | count << 23
        | winner << 15
        | stamp
    )


def tail(number=5):
    beats = [header(END, number)]
    for of_subgroup in COUNTERS:
        padded = [*of_subgroup, 0]
        beats += [padded[k] | padded[k + 1] << 32 for k in range(0, 12, 2)]
    return beats


def frame(*packets, number=5, end=None):
    beats = [header(START, number), *packets, *tail(number if end is None else end)]
    return np.array(beats, np.uint64)


def decoded(beats):
    return decode_frame(beats, SENSOR, 2)


def test_events_of_every_format_have_the_fields_of_their_header():
    """In the order of the stream; the map and the offsets of others are empty."""
    fields = {"pulse": 65535, "subgroup": 1, "stamp": 7999, "winner": 63, "count": 64, "overrun": 1}
    offsets = 0x0706050403020100, 0x0F0E0D0C0B0A0908  # one byte of each minigroup
    found = decoded(
        frame(
            header(FULL, 3, stamp=17, winner=5, count=2),
            1 << 63 | 1,
            *offsets,
            header(SHORT, **fields),
            header(ID, 4, 1, winner=2, count=1),
            0b100,
        )
    )
    assert found.number == 5
    column = {name: found.events[:, k].tolist() for k, name in enumerate(HEADER)}
    assert column["kind"] == [FULL, SHORT, ID]
    for name, value in fields.items():
        assert column[name][1] == value, name
    assert column["pulse"] == [3, 65535, 4]
    assert column["overrun"] == [0, 1, 0]
    assert found.hits.tolist() == [[1 << 63 | 1], [0], [4]]
    assert found.offsets.tolist() == [[*range(16)], [OFFSET_NONE] * 16, [OFFSET_NONE] * 16]
    assert found.counters.tolist() == COUNTERS
    assert found.counters.dtype == np.int64
    assert found.check() is found
    assert found.counts is None


def test_a_record_has_a_stamp_and_a_map_of_each_minigroup():
    """16 bits each: 12 of the stamp in quarters of a cycle, 4 of the map."""
    entries = [(g % 16) << 12 | 100 + g for g in range(16)]
    words = [
        sum(entry << 16 * k for k, entry in enumerate(entries[at : at + 4])) for at in (0, 4, 8, 12)
    ]
    found = decoded(
        frame(header(RECORD, 9, 1), *words, header(SHORT), header(RECORD, 10), *[0] * 4)
    )
    assert found.records.tolist() == [[1, 9], [0, 10]]
    assert found.entries[0].tolist() == [[100 + g, g % 16] for g in range(16)]
    assert not found.entries[1].any()
    assert len(found.events) == 1


def test_a_frame_may_hold_nothing():
    found = decoded(frame(number=65535))
    assert found.number == 65535
    assert len(found.events) == len(found.records) == 0
    assert found.hits.shape == (0, 1)
    assert found.offsets.shape == (0, 16)


WITHOUT_ENDS = "^the frame does not begin with a frame start and end with a frame end$"


@pytest.mark.parametrize(
    ("beats", "told"),
    [
        (frame(header(SHORT))[1:], WITHOUT_ENDS),
        (frame()[1:], "^beat 0 of 13: not a packet header where one is due"),
        (np.zeros(0, np.uint64), "^beat 0 of 0: not a packet header where one is due"),
        (frame()[:1], "^beat 0 of 1: not a packet header"),
        (frame(end=6), "^frame start and frame end have different numbers$"),
        (frame(header(0)), "^beat 1 of 15: not a packet header where one is due"),
        (frame(header(SHORT), header(5)), "^beat 2 of 16: not a packet header"),
        (frame(header(SHORT), header(START)), "^beat 2 of 16: not a packet header"),
        (frame(header(SHORT), header(ID)), "^beat 4 of 16: not a packet header"),
        (frame(header(SHORT))[:-1], WITHOUT_ENDS),
    ],
)
def test_beats_that_are_no_frame_are_told_with_the_place(beats, told):
    with pytest.raises(StreamError, match=told):
        decoded(beats)


def test_missing_events_without_a_damaged_place_are_told_alone():
    found = evolve(decoded(frame()), missing=3)
    with pytest.raises(StreamError, match=r"^3 events of the frame were damaged on their way$"):
        found.check()
    found = evolve(decoded(frame()), damaged=np.array([4, 9]))
    with pytest.raises(StreamError, match=r"^0 events .* on their way, near beats 4, 9$"):
        found.check()


EVENTS = frame(
    *(
        beat
        for number, subgroup in enumerate((1, 0, 1, 0))
        for beat in (header(ID, number, subgroup, stamp=number, count=1, overrun=number == 3), 1)
    ),
    header(RECORD, 7, 1),
    *[0] * 4,
)


def test_commit_cycles_are_those_of_the_events_of_a_subgroup_in_turn():
    """Stored events come by subgroup and then by time, received ones in the order of the stream."""
    subgroup, cycle = np.array([0, 0, 1, 1]), np.array([12, 34, 11, 33])
    rows = frame_rows(CONFIG, [EVENTS], subgroup, cycle, first_pulse=40).columns
    assert rows["commit_cycle"].tolist() == [11, 12, 33, 34]
    assert rows["subgroup"].tolist() == [1, 0, 1, 0]
    assert rows["pulse"].tolist() == [40, 41, 42, 43]
    assert rows["overrun"].tolist() == [False, False, False, True]
    assert rows["overrun"].dtype == bool
    assert (rows["mg_pulse"].tolist(), rows["mg_subgroup"].tolist()) == ([47], [1])
    received = frame_rows(CONFIG, [EVENTS]).columns
    assert received["commit_cycle"].tolist() == [-1] * 4
    assert received["commit_cycle"].dtype == rows["commit_cycle"].dtype == np.int64


@pytest.mark.parametrize("subgroup", [[0, 0, 1], [0, 0, 0, 1], [0, 0, 1, 1, 1], []])
def test_events_that_left_are_those_that_were_stored(subgroup):
    cycle = np.arange(len(subgroup))
    told = "the events that left the sensor are not the ones that its FIFOs stored"
    with pytest.raises(ValueError, match=told):
        frame_rows(CONFIG, [EVENTS], np.array(subgroup, np.int64), cycle)


def test_pulses_of_several_frames_count_on_and_counters_stay_apart():
    built = ResultBuilder(CONFIG)
    for _ in range(3):
        built.add([EVENTS])
    arrays = built.arrays()
    assert arrays["pulse"].tolist() == [20 * f + k for f in range(3) for k in range(4)]
    assert arrays["mg_pulse"].tolist() == [7, 27, 47]
    for k, name in enumerate(COUNTER_NAMES):
        assert arrays[name].tolist() == [[COUNTERS[0][k], COUNTERS[1][k]]] * 3
