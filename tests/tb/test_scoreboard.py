# SPDX-License-Identifier: Apache-2.0
"""The scoreboard accepts the predicted frame, and names each kind of difference."""

from itertools import product

import numpy as np
import pytest
from attrs import evolve

from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.packet import layout
from coincid.model.golden.frame import Golden
from coincid.tb.frame_record import Recorded, cycle_limit
from coincid.tb.rtl_errors import Mismatch
from coincid.tb.scoreboard import Scoreboard, check

from ..random_cases import configured, trouble

CONFIG = configured(
    {"rows": 8, "cols": 16, "streams": 2},
    {"period": 60, "pulses": 5},
    {"threshold": 1, "coincidence": False},
)
AT = 5  # of the beats and commits: the one that differs


@pytest.fixture(scope="module")
def trace():
    return Golden(CONFIG.sensor).frame(CONFIG, trouble(CONFIG, 1, 4.0))


@pytest.fixture
def record(trace):
    """Return the record of the predicted frame, which a test may change."""
    arrays = [
        array.copy()
        for array in (*trace.beats, *trace.beat_cycle, trace.commit_subgroup, trace.commit_cycle)
    ]
    return Recorded(arrays[:2], arrays[2:4], *arrays[4:], cycles=0)


def beat_differs(record):
    record.beats[1][AT] ^= np.uint64(1)


def beat_is_late(record):
    record.beat_cycle[1][AT:] += 1


def beat_is_lost(record):
    record.beats[1], record.beat_cycle[1] = record.beats[1][:-1], record.beat_cycle[1][:-1]


def beat_comes_after_the_end(record):
    record.beats[1] = np.append(record.beats[1], record.beats[1][-1])
    record.beat_cycle[1] = np.append(record.beat_cycle[1], record.beat_cycle[1][-1] + 1)


def commit_is_late(record):
    record.commit_cycle[AT] += 1


def commit_is_of_another_subgroup(record):
    record.commit_subgroup[AT] ^= 1


def commit_is_lost(record):
    record.commit_subgroup, record.commit_cycle = (
        record.commit_subgroup[:-1],
        record.commit_cycle[:-1],
    )


def test_the_predicted_frame(trace, record):
    assert check(CONFIG.sensor, trace, record) == sum(map(len, trace.beats)) + len(
        trace.commit_cycle
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (beat_differs, "stream 1"),
        (beat_is_late, "stream 1.*transferred in cycle"),
        (beat_is_lost, "stream 1.*tlast is 1, golden model 0"),
        (beat_comes_after_the_end, "stream 1.*tlast is 0, golden model 1"),
        (commit_is_late, "stored in cycle"),
        (commit_is_of_another_subgroup, "stored in cycle"),
        (commit_is_lost, "events stored, golden model"),
    ],
)
def test_every_difference(change, words, trace, record):
    change(record)
    with pytest.raises(Mismatch, match=words):
        check(CONFIG.sensor, trace, record)


@pytest.mark.parametrize("early", range(CONFIG.sensor.streams))
def test_of_several_differences_the_first_in_time_is_told(early, trace, record):
    """A beat of one stream, and of the other one the first beat that comes later."""
    late = 1 - early
    after = record.beat_cycle[early][AT]
    later = int(np.searchsorted(record.beat_cycle[late], after, side="right"))
    record.beats[early][AT] ^= np.uint64(1)
    record.beats[late][later] ^= np.uint64(1)
    record.commit_cycle[-1] += 1
    with pytest.raises(Mismatch, match=f"stream {early}, .*cycle {after}, event_id"):
        check(CONFIG.sensor, trace, record)


@pytest.mark.parametrize("stream", range(CONFIG.sensor.streams))
def test_a_wrong_counter_is_named_with_its_subgroup(stream, trace, record):
    """Every counter of every subgroup of the stream; two are in a beat."""
    counter_beats = layout(CONFIG.sensor).counter_beats
    subgroups = CONFIG.sensor.stream_subgroups(stream)
    first = len(record.beats[stream]) - counter_beats * len(subgroups)
    for (place, subgroup), number in product(enumerate(subgroups), range(len(COUNTER_NAMES))):
        beat, half = divmod(number, 2)
        beats = [*record.beats]
        beats[stream] = beats[stream].copy()
        beats[stream][first + counter_beats * place + beat] ^= np.uint64(1 << 32 * half + number)
        named = f"counter {COUNTER_NAMES[number]} of subgroup {subgroup} is "
        with pytest.raises(Mismatch, match=named):
            check(CONFIG.sensor, trace, evolve(record, beats=beats))


def test_bits_behind_the_last_counter_are_told(trace, record):
    """They fill the last beat, and are 0."""
    assert len(COUNTER_NAMES) % 2
    last = CONFIG.sensor.stream_subgroups(1)[-1]
    record.beats[1][-1] ^= np.uint64(1 << 33)
    with pytest.raises(Mismatch, match=f"follows the last counter of subgroup {last} is 2, golden"):
        check(CONFIG.sensor, trace, record)


def test_a_frame_that_stops(trace):
    board = Scoreboard(CONFIG.sensor, trace)
    with pytest.raises(Mismatch, match="0 beats, golden model"):
        board.finish()


@pytest.mark.parametrize("stalled", (0, 1000, 100_000))
def test_a_frame_that_a_receiver_stalls_is_no_frame_that_hangs(stalled):
    """The receiver takes no beat for so many cycles; the last beat leaves before the limit."""
    ready = np.zeros(stalled, np.uint8)
    stalled_trace = Golden(CONFIG.sensor).frame(CONFIG, trouble(CONFIG, 1, 4.0), ready)
    last = max(int(cycles[-1]) for cycles in stalled_trace.beat_cycle)
    assert stalled <= last < cycle_limit(CONFIG, stalled)


@pytest.mark.parametrize("link_gbps", (0.1, 1.0, 8.0))
def test_a_frame_on_a_slow_link_is_no_frame_that_hangs(link_gbps):
    """FIFOs are full at the end of the frame; the last beat leaves before the limit."""
    config = configured(
        {"rows": 8, "cols": 16, "streams": 2, "fifo_depth": 256},
        {"period": 60, "pulses": 20, "link_gbps": link_gbps},
        {"threshold": 1, "coincidence": False},
    )
    trace = Golden(config.sensor).frame(config, trouble(config, 1, 4.0))
    last = max(int(cycles[-1]) for cycles in trace.beat_cycle)
    assert last < cycle_limit(config, 0)
    if link_gbps < 1:
        assert last > config.frame_cycles + 1000
