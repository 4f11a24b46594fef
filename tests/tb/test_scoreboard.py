# SPDX-License-Identifier: Apache-2.0
"""The scoreboard accepts the predicted frame, and names each kind of difference."""

from itertools import product

import numpy as np
import pytest
from attrs import evolve

from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.packet import COUNTS, PACKETS, layout, packet_fields
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


def test_events_of_different_subgroups_are_recorded_in_any_order(trace, record):
    """Each subgroup's own are in the order of time."""
    order = np.argsort(record.commit_cycle, kind="stable")
    record.commit_subgroup = record.commit_subgroup[order]
    record.commit_cycle = record.commit_cycle[order]
    assert np.any(np.diff(record.commit_subgroup) < 0)
    number = sum(map(len, trace.beats)) + len(trace.commit_cycle)
    assert check(CONFIG.sensor, trace, record) == number


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


def told_of(trace, stream, index, change):
    """Return what is said about a beat that is changed by some bits."""
    board = Scoreboard(CONFIG.sensor, trace, frame=3)
    beats, cycles = trace.beats[stream], trace.beat_cycle[stream]
    for k in range(index):
        board.beat(stream, int(cycles[k]), int(beats[k]), False)
    assert board.checked == board.beats[stream] == index
    with pytest.raises(Mismatch) as told:
        board.beat(stream, int(cycles[index]), int(beats[index]) ^ change, False)
    return str(told.value)


def test_a_wrong_field_is_told_with_its_packet_and_the_beat_of_it(trace):
    """The start of the frame has one beat; the first event behind it has its header and its map."""
    stream, cycles = 1, trace.beat_cycle[1]
    frame = f"frame 3, stream {stream}"
    start = f"{frame}, all subgroups, cycle {cycles[0]}, frame_start packet, beat 0 of it"
    assert told_of(trace, stream, 0, 1 << 32) == f"{start}: pulse is 1, golden model 0"
    fields = packet_fields(trace.beats[stream], np.array([1]), CONFIG.sensor, PACKETS[2])
    known = {name: int(values[0, 0]) for name, values in fields.items()}
    event = f"{frame}, subgroup {known['subgroup']}, pulse {known['pulse']}, cycle"
    winner = known["winner"]
    assert told_of(trace, stream, 1, 3 << 15) == (
        f"{event} {cycles[1]}, event_id packet, beat 0 of it:"
        f" winner is {winner ^ 3}, golden model {winner}"
    )
    stamp, count = known["stamp"], known["count"]
    both = told_of(trace, stream, 1, 1 | 1 << 23)
    assert f"count is {count ^ 1}, golden model {count}" in both
    assert f"stamp is {stamp ^ 1}, golden model {stamp}" in both
    second = told_of(trace, stream, 2, 1 << 40)
    bits = int(trace.beats[stream][2])
    assert second == (
        f"{event} {cycles[2]}, event_id packet, beat 1 of it:"
        f" map is {bits ^ 1 << 40:#018x}, golden model {bits:#018x}"
    )


def test_a_wrong_kind_is_told_as_such(trace):
    assert "kind is 7, golden model 6" in told_of(trace, 0, 0, 1 << 61)


def test_a_beat_after_the_end_is_told_with_its_word(trace):
    board = Scoreboard(CONFIG.sensor, trace, frame=2)
    beats, cycles = trace.beats[0], trace.beat_cycle[0]
    for k, (beat, cycle) in enumerate(zip(beats.tolist(), cycles.tolist(), strict=True)):
        board.beat(0, cycle, beat, k == len(beats) - 1)
    late = int(cycles[-1]) + 5
    words = f"frame 2, stream 0, cycle {late}: beat {len(beats)} after the frame's end: 0x{7:016x}"
    with pytest.raises(Mismatch, match=f"^{words}$"):
        board.beat(0, late, 7, False)


def test_stored_events_are_told_with_the_cycle_in_which_they_are_due(trace):
    """Or that there is none; and the number of those that are missing."""
    board = Scoreboard(CONFIG.sensor, trace, frame=1)
    due = trace.commit_cycle[trace.commit_subgroup == 1].tolist()
    board.commit(1, due[0])
    words = f"frame 1, subgroup 1, event 1: stored in cycle {due[1] + 2}, golden model in cycle"
    with pytest.raises(Mismatch, match=f"^{words} {due[1]}$"):
        board.commit(1, due[1] + 2)
    for cycle in due[1:]:
        board.commit(1, cycle)
    assert board.checked == len(due)
    number = len(due)
    with pytest.raises(Mismatch, match=f"event {number}: .* 9, golden model stores none$"):
        board.commit(1, 9)


def test_in_a_group_of_events_a_beat_is_told_by_its_number():
    config = CONFIG.with_frame(format="compact")
    grouped = Golden(config.sensor).frame(config, trouble(config, 1, 4.0))
    beat, cycle = int(grouped.beats[0][1]), int(grouped.beat_cycle[0][1])
    board = Scoreboard(config.sensor, grouped)
    board.beat(0, int(grouped.beat_cycle[0][0]), int(grouped.beats[0][0]), False)
    where = f"frame 0, stream 0, cycle {cycle}, beat 1 of the frame, in a group of events"
    told = f"^{where}: {beat ^ 1:#018x}, golden model {beat:#018x}$"
    with pytest.raises(Mismatch, match=told):
        board.beat(0, cycle, beat ^ 1, False)


def test_what_is_missing_is_counted_with_what_is_due(trace, record):
    """Of every stream, and of every subgroup, in the frame that was asked for."""
    due = np.bincount(trace.commit_subgroup, minlength=CONFIG.sensor.subgroups)
    for subgroup in np.flatnonzero(due > 1).tolist():
        board = Scoreboard(CONFIG.sensor, evolve(trace, beats=[[], []]), frame=4)
        for other in range(CONFIG.sensor.subgroups):
            cycles = trace.commit_cycle[trace.commit_subgroup == other].tolist()
            for cycle in cycles[: 1 if other == subgroup else None]:
                board.commit(other, cycle)
        number = due[subgroup]
        words = f"frame 4, subgroup {subgroup}: 1 events stored, golden model {number}"
        with pytest.raises(Mismatch, match=f"^{words}$"):
            board.finish()
    for stream in range(CONFIG.sensor.streams):
        board = Scoreboard(CONFIG.sensor, trace, frame=5)
        for other in range(stream + 1):
            beats, cycles = trace.beats[other].tolist(), trace.beat_cycle[other].tolist()
            left = 3 if other == stream else None
            for k, (beat, cycle) in enumerate(zip(beats[:left], cycles, strict=False)):
                board.beat(other, cycle, beat, k == len(beats) - 1)
        number = len(trace.beats[stream])
        with pytest.raises(
            Mismatch, match=f"^frame 5, stream {stream}: 3 beats, golden .* {number}$"
        ):
            board.finish()


def test_a_wrong_word_of_counts_is_told_with_its_minigroup():
    """Whose packets have no pulse; the second one of the second subgroup."""
    config = configured(
        {"rows": 8, "cols": 16, "counts": 1},
        {"period": 60, "pulses": 5, "format": "counts", "search_pulses": 2},
    )
    counted = Golden(config.sensor).frame(config, trouble(config, 1, 4.0))
    length = layout(config.sensor).length(COUNTS)
    first = 1 + (config.sensor.minigroups + 1) * length
    beats = [counted.beats[0].copy()]
    beats[0][first + 1] ^= np.uint64(1)
    record = Recorded(beats, counted.beat_cycle, counted.commit_subgroup, counted.commit_cycle, 0)
    told = ", subgroup 1, minigroup 1, cycle .*, counts packet, beat 1 of it: pulses is "
    with pytest.raises(Mismatch, match=told):
        check(config.sensor, counted, record)
