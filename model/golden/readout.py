# SPDX-License-Identifier: Apache-2.0
"""Readout of the golden model: from one stream's FIFOs, through round robin and output buffer,
to beats and their cycles.

It proceeds from grant to grant. Everything that has been committed by then enters its FIFO or is
dropped (`_admit_events`, `_admit_records`). The next requesting subgroup is chosen
(`_arbitrate`). Its packet is formed (`_form_packet`) and leaves as the receiver takes it
(`_transfer`). In a format with groups, the packer (`packer.py`) is this receiver.
"""

from typing import Any, NamedTuple

import numpy as np

from ..contract import latency
from ..contract.counters import COUNTER_BITS
from ..contract.packet import BEAT_BITS, FRAME_END, FRAME_START, KIND_LSB, OFFSETS, RECORD
from ..shared.compiled import njit, part
from .front_end import Events, Records
from .packer import Packed, close_group, new_packer, pack_event, room_for_groups
from .receiver import Receiver, taken_from
from .shape import ARRAY, COUNTER, NUMBER, Shape, row_type

_RECORD = RECORD.code
_FRAME_START = FRAME_START.code
_FRAME_END = FRAME_END.code
_OFFSET_BITS = OFFSETS.width
_ALL = np.uint64(0xFFFF_FFFF_FFFF_FFFF)
_NONE = -1
_NEVER = np.int64(1) << 62

# Queue of a subgroup.
_QUEUE = row_type(
    "next_event",  # to be committed
    "end_event",
    "read",  # event that is read next
    "oldest",  # event whose place may still be occupied
    "level",  # occupied places
    "lost",  # an event was dropped since the last stored one
    "next_record",  # to be written
    "end_record",
    "waiting",  # record in the only place, or _NONE
    "place_free_at",  # cycle from which on that place is free
    "stored",  # counters
    "dropped",
    "mg_stored",
    "mg_dropped",
)


class Stream(NamedTuple):
    """A stream in a frame."""

    first: int  # of its subgroups
    subgroups: int
    end: int  # of the last period, in cycles
    frame: int  # number


class _Room(NamedTuple):
    """What the readout of a stream keeps and writes to."""

    queues: np.ndarray  # _QUEUE[subgroups]
    wake: np.ndarray  # int64[subgroups], first cycle in which a subgroup may request
    beats: np.ndarray  # uint64[n], before the packer
    sent_at: np.ndarray  # int64[n], cycles of their transfer
    values: np.ndarray  # uint64, of a packet: see `NUMBERS`
    packed: Packed  # beats behind the packer
    receiver: Receiver  # of the beats


def readout(
    stream: Stream,
    shape: Shape,
    events: Events,
    records: Records,
    counters: np.ndarray,
    receiver: Receiver,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the beats of a stream, and the cycles of their transfer.

    The fill levels of the FIFOs decide which events and records are stored: this sets
    `events.row.stored` and adds to `counters`.
    """
    queues = _queues(stream, events.bounds, records.bounds)
    most = _beats(queues, shape)
    room = _Room(
        queues=queues,
        wake=np.zeros(stream.subgroups, np.int64),
        beats=np.empty(most, np.uint64),
        sent_at=np.empty(most, np.int64),
        values=np.zeros(ARRAY + shape.longest_word, np.uint64),
        packed=room_for_groups(most, shape, receiver),
        receiver=receiver,
    )
    packers = new_packer()
    done = _play(stream, shape, room, packers, events, records, counters)
    if shape.grouped:
        done = packers["beat"][0]
        return room.packed.beats[:done].copy(), room.packed.sent_at[:done].copy()
    return room.beats[:done].copy(), room.sent_at[:done].copy()


def _queues(stream: Stream, event_bounds: np.ndarray, record_bounds: np.ndarray) -> np.ndarray:
    """_QUEUE[subgroups]: the queues of a stream at the beginning of a frame."""
    begins = slice(stream.first, stream.first + stream.subgroups)
    ends = slice(begins.start + 1, begins.stop + 1)
    queues = np.zeros(stream.subgroups, _QUEUE)
    for name in ("next_event", "read", "oldest"):
        queues[name] = event_bounds[begins]
    queues["end_event"] = event_bounds[ends]
    queues["next_record"] = record_bounds[begins]
    queues["end_record"] = record_bounds[ends]
    queues["waiting"] = _NONE
    return queues


def _beats(queues: np.ndarray, shape: Shape) -> int:
    """Return the number of beats in a frame without drops."""
    # equivalent: room for more beats, which is cut off
    events = int((queues["end_event"] - queues["next_event"]).sum())
    # equivalent: room for more beats, which is cut off
    records = int((queues["end_record"] - queues["next_record"]).sum())
    # equivalent (2: one more): room for more beats, which is cut off
    head_and_end = 2
    return (
        head_and_end
        + len(queues) * shape.counter_beats
        + events * shape.event_beats
        + records * shape.record_beats
    )


@njit(allocates=False)
def _play(
    stream: Stream,
    shape: Shape,
    room: _Room,
    packers: np.ndarray,
    events: Events,
    records: Records,
    counters: np.ndarray,
) -> int:
    """Proceed from grant to grant; write the beats to `room`, and return the number of those
    before the packer.
    """
    packer = packers[0]
    queues = room.queues
    beats = room.beats
    sent_at = room.sent_at
    values = room.values
    n = len(queues)
    values[NUMBER.pulse] = stream.frame
    values[NUMBER.count] = shape.grouped
    _encode(beats[:1], _FRAME_START, values, shape.frame_parts)
    done = _transfer(room, 0, 1, latency.FRAME_START)
    _pass(packer, room, 0, 1, shape)
    # equivalent: nothing is committed so early that it could be granted then
    t = latency.FRAME_START + 1
    pointer = 0
    while True:
        t = _when_room(shape.longest_word, t, done, sent_at, shape)
        chosen, upcoming = _arbitrate(
            t, pointer, queues, room.wake, events.row, records.row, shape.fifo_depth
        )
        if chosen != _NONE:
            done, length = _grant(chosen, t, done, stream, shape, room, packer, events, records)
            t += length
            pointer = (chosen + 1) % n
        elif upcoming < _NEVER:
            t = upcoming
        else:
            break
    t = max(t, stream.end + latency.FINISH)
    for k in range(len(values)):
        values[k] = 0
    values[NUMBER.pulse] = stream.frame
    # equivalent (1: one more): the next beat is written later
    _encode(beats[done : done + 1], _FRAME_END, values, shape.frame_parts)
    done = _send(packer, room, done, 1, t, shape)
    t += 1
    for s in range(
        n
    ):  # a wait for room would not show: the buffer keeps the stream busy while it lasts
        _count(counters[stream.first + s], queues[s], shape.counter_max)
        _pack(beats[done : done + shape.counter_beats], counters[stream.first + s], COUNTER_BITS)
        done = _send(packer, room, done, shape.counter_beats, t, shape)
        t += shape.counter_beats
    return done


@part
def _grant(
    chosen: int,
    t: int,
    done: int,
    stream: Stream,
    shape: Shape,
    room: _Room,
    packer: Any,
    events: Events,
    records: Records,
) -> tuple[int, int]:
    """Form and send the packet of the subgroup that is granted in cycle `t`; return the new
    `done`, and its length.
    """
    beats = room.beats
    sent_at = room.sent_at
    values = room.values
    subgroup = stream.first + chosen
    for k in range(len(values)):
        values[k] = 0
    values[NUMBER.subgroup] = subgroup
    queue = room.queues[chosen]
    is_event = queue.waiting == _NONE
    event = queue.read
    length = _form_packet(beats[done:], values, queue, t, shape, events, records)
    if not shape.grouped:
        return _transfer(room, done, length, t), length
    if not is_event:
        return _send(packer, room, done, length, t, shape), length
    done = _take(sent_at, done, length, t, packer.taken)
    hits = events.hits[event]
    offsets = events.offsets[event]
    pack_event(
        packer, room.packed, events.row[event], subgroup, hits, offsets, sent_at[done - 1], shape
    )
    return done, length


@part
def _when_room(length: int, t: int, done: int, sent_at: np.ndarray, shape: Shape) -> int:
    """Return the first cycle from `t` on in which the output buffer has room for `length` more
    beats after `done`.

    What the packer takes leaves its place a cycle later.
    """
    left = done + length - shape.output_depth
    return max(t, sent_at[left - 1] + 1 + shape.grouped) if left > 0 else t


@part
def _arbitrate(
    t: int,
    pointer: int,
    queues: np.ndarray,
    wake: np.ndarray,
    events: np.ndarray,
    records: np.ndarray,
    fifo_depth: int,
) -> tuple[int, Any]:
    """Return the first subgroup, from `pointer` on and round, that requests in cycle `t`, or
    else the next possible cycle.

    wake: int64[subgroups], the first cycle in which a subgroup may request.
    """
    upcoming = _NEVER
    n = len(queues)
    for k in range(pointer, pointer + n):
        chosen = k if k < n else k - n
        if wake[chosen] <= t:
            queue = queues[chosen]
            _admit_events(queue, t, events, fifo_depth)
            _admit_records(queue, t, records)
            if queue.waiting != _NONE or queue.read < queue.next_event:
                return chosen, t
            wake[chosen] = _NEVER
            if queue.next_event < queue.end_event:
                wake[chosen] = events[queue.next_event].cycle + latency.STORE_TO_GRANT
            if queue.next_record < queue.end_record:
                wake[chosen] = min(
                    wake[chosen], records[queue.next_record].cycle + latency.STORE_TO_GRANT
                )
        upcoming = min(upcoming, wake[chosen])
    return _NONE, upcoming


@part
def _admit_events(queue: Any, t: int, events: np.ndarray, fifo_depth: int) -> None:
    """Move events that may be granted by cycle `t` into the FIFO, or drop them if it was full at
    their commit.
    """
    while (
        queue.next_event < queue.end_event
        and events[queue.next_event].cycle + latency.STORE_TO_GRANT <= t
    ):
        event = events[queue.next_event]
        while queue.oldest < queue.next_event and events[queue.oldest].free_at <= event.cycle:
            queue.level -= events[queue.oldest].stored
            queue.oldest += 1
        event.stored = queue.level < fifo_depth
        if event.stored:
            event.free_at = _NEVER
            event.overrun = queue.lost
            queue.level += 1
            queue.stored += 1
        else:
            event.free_at = event.cycle  # a dropped event takes no place
            queue.dropped += 1
        queue.lost = not event.stored
        queue.next_event += 1
    while queue.read < queue.next_event and not events[queue.read].stored:
        queue.read += 1


@part
def _admit_records(queue: Any, t: int, records: np.ndarray) -> None:
    """Move records that may be granted by cycle `t` to the only place, or drop them if it was
    taken.
    """
    while (
        queue.next_record < queue.end_record
        and records[queue.next_record].cycle + latency.STORE_TO_GRANT <= t
    ):
        if queue.waiting == _NONE and queue.place_free_at <= records[queue.next_record].cycle:
            queue.waiting = queue.next_record
            queue.mg_stored += 1
        else:
            queue.mg_dropped += 1
        queue.next_record += 1


@part
def _form_packet(
    beats: np.ndarray,
    values: np.ndarray,
    queue: Any,
    t: int,
    shape: Shape,
    events: Events,
    records: Records,
) -> int:
    """Write the packet that is granted in cycle `t` to `beats`, a record before events; free its
    place; return its length.
    """
    if queue.waiting != _NONE:
        length = shape.record_beats
        values[NUMBER.pulse] = records.row[queue.waiting].pulse
        _pack(values[ARRAY:], records.entries[queue.waiting], shape.record_bits)
        _encode(beats[:length], _RECORD, values, shape.record_parts)
        queue.waiting = _NONE
        queue.place_free_at = t + latency.GRANT_TO_READ + length
        return length
    event = events.row[queue.read]
    length = shape.event_beats
    values[NUMBER.overrun] = event.overrun
    values[NUMBER.pulse] = event.pulse
    values[NUMBER.stamp] = event.stamp
    values[NUMBER.count] = event.count
    values[NUMBER.winner] = event.winner
    for k in range(shape.hits_words):
        values[ARRAY + k] = events.hits[queue.read, k]
    if shape.event_has_offsets:
        _pack(values[ARRAY + shape.hits_words :], events.offsets[queue.read], _OFFSET_BITS)
    _encode(beats[:length], shape.event_code, values, shape.event_parts)
    event.free_at = t + latency.GRANT_TO_READ + length
    queue.read += 1
    return length


@part
def _encode(beats: np.ndarray, code: int, values: np.ndarray, parts: np.ndarray) -> None:
    """Write a packet of this kind to `beats`. parts: which bits of `values` stand where."""
    for k in range(len(beats)):
        beats[k] = 0
    beats[0] = np.uint64(code) << np.uint64(KIND_LSB)
    for field in parts:
        bits = values[field.word] >> np.uint64(field.shift) & _ALL >> np.uint64(
            BEAT_BITS - field.width
        )
        beats[field.beat] |= bits << np.uint64(field.lsb)


@part
def _pack(beats: np.ndarray, items: np.ndarray, bits: Any) -> None:
    """Pack `items` of `bits` each into words, lowest bits first."""
    for k in range(len(beats)):
        beats[k] = 0
    per_beat = BEAT_BITS // bits
    for k in range(len(items)):
        beats[k // per_beat] |= np.uint64(items[k]) << np.uint64(k % per_beat * bits)


@part
def _count(counters: np.ndarray, queue: Any, most: int) -> None:
    counters[COUNTER.stored] = min(queue.stored, most)
    counters[COUNTER.dropped] = min(queue.dropped, most)
    counters[COUNTER.mg_stored] = min(queue.mg_stored, most)
    counters[COUNTER.mg_dropped] = min(queue.mg_dropped, most)


@part
def _send(packer: Any, room: _Room, done: int, length: int, t: int, shape: Shape) -> int:
    """Let the `length` beats after `done`, which are of no event, leave behind the open group;
    return the new `done`.
    """
    sent_at = room.sent_at
    before = sent_at[done - 1]
    if shape.grouped:
        arrives = t + latency.GRANT_TO_BEAT + latency.BEAT_TO_PORT
        close_group(packer, room.packed, max(arrives, packer.formed + 1))
        sent_at[done - 1] = max(before, packer.beat_from - 1)
    end = _transfer(room, done, length, t)
    sent_at[done - 1] = before
    _pass(packer, room, done, end, shape)
    return end


@part
def _pass(packer: Any, room: _Room, done: int, end: int, shape: Shape) -> None:
    """Let beats from `done` to `end` through the packer."""
    if shape.grouped:
        begin = packer.beat
        packer.beat += end - done
        for k in range(end - done):
            room.packed.beats[begin + k] = room.beats[done + k]
            room.packed.sent_at[begin + k] = room.sent_at[done + k]


@part
def _take(sent_at: np.ndarray, done: int, length: int, t: int, taken: int) -> int:
    """Write to `sent_at` when the packer takes an event's beats, the first one from cycle
    `taken` on; return the new `done`.
    """
    sent_at[done] = max(
        t + latency.GRANT_TO_BEAT + latency.BEAT_TO_PORT, sent_at[done - 1] + 1, taken
    )
    for k in range(done + 1, done + length):
        sent_at[k] = sent_at[k - 1] + 1
    return done + length


@part
def _transfer(room: _Room, done: int, length: int, t: int) -> int:
    """Write down when the `length` beats after `done`, granted in cycle `t`, leave; return the
    new `done`.
    """
    sent_at = room.sent_at
    for k in range(done, done + length):
        earliest = t + latency.GRANT_TO_BEAT + k - done + latency.BEAT_TO_PORT
        if k:
            earliest = max(earliest, sent_at[k - 1] + 1)
        sent_at[k] = taken_from(room.receiver, earliest)
    return done + length
