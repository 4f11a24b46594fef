# SPDX-License-Identifier: Apache-2.0
"""Readout of the golden model: from one stream's FIFOs, through round robin and output buffer,
to beats and their cycles.

It takes a frame in pieces of whole periods, and proceeds from grant to grant, up to the first cycle
in which the next piece could change a grant. Everything that has been committed by then enters its
FIFO or is dropped (`_admit_events`, `_admit_records`). The next requesting subgroup is chosen
(`_arbitrate`). Its packet is formed (`_form_packet`) and leaves as the receiver takes it
(`_transfer`). In a format with groups, the packer (`packer.py`) is this receiver.
"""

from typing import Any, NamedTuple

import numpy as np

from ..contract import latency
from ..contract.counters import COUNTER_BITS
from ..contract.packet import BEAT_BITS, FRAME_END, FRAME_START, KIND_LSB, OFFSETS, RECORD
from ..shared.arrays import keep_only, longer
from ..shared.compiled import njit, part
from .front_end import Events, Records, room_for_events, room_for_records
from .packer import (
    Packed,
    close_group,
    more_room,
    new_packer,
    pack_event,
    room_for_groups,
    take_groups,
)
from .queues import NONE, Commits, join, new_queues, split
from .receiver import Receiver, taken_from
from .shape import ARRAY, COUNTER, NUMBER, Shape, row_type

_RECORD = RECORD.code
_FRAME_START = FRAME_START.code
_FRAME_END = FRAME_END.code
_OFFSET_BITS = OFFSETS.width
_ALL = np.uint64(0xFFFF_FFFF_FFFF_FFFF)
_NEVER = np.int64(1) << 62
_HEAD_BEATS = 1
_END_BEATS = 1

# Where the readout is in the frame.
_PLACE = row_type(
    "t",  # cycle of the next grant, at the earliest
    "pointer",  # subgroup that the round robin asks first
    "done",  # beats before the packer
)


class Stream(NamedTuple):
    """A stream in a frame."""

    first: int  # of its subgroups
    subgroups: int
    frame: int  # number


class _Room(NamedTuple):
    """What the readout of a stream keeps and writes to."""

    queues: np.ndarray  # QUEUE[subgroups]
    wake: np.ndarray  # int64[subgroups], first cycle in which a subgroup may request
    beats: np.ndarray  # uint64[n], before the packer
    sent_at: np.ndarray  # int64[n], cycles of their transfer
    values: np.ndarray  # uint64, of a packet: see `NUMBERS`
    packed: Packed  # beats behind the packer
    receiver: Receiver  # of the beats


class Sent(NamedTuple):
    """What has left a stream, and what it has committed, since the last such piece."""

    beats: np.ndarray  # uint64[n]
    sent_at: np.ndarray  # int64[n], cycles of their transfer
    # int64[k], of stored events whose place is free again, by subgroup and then by time:
    subgroup: np.ndarray  # number in the sensor
    committed_at: np.ndarray  # cycle of the commit
    freed_at: np.ndarray  # from this cycle on, the event's place is free


class Readout:
    """Readout of a stream in a frame. It takes the frame in pieces.

    `sent` hands out what is finished, so that the memory of a readout does not depend on the length
    of the frame.
    """

    def __init__(self, stream: Stream, shape: Shape, receiver: Receiver) -> None:
        self._stream = stream
        self._shape = shape
        self._place = np.zeros(1, _PLACE)
        self._packers = new_packer()
        self._room = _Room(
            queues=new_queues(stream.subgroups),
            wake=np.full(stream.subgroups, _NEVER),
            beats=np.empty(0, np.uint64),
            sent_at=np.empty(0, np.int64),
            values=np.zeros(ARRAY + shape.longest_word, np.uint64),
            packed=room_for_groups(shape, receiver),
            receiver=receiver,
        )
        self._nothing = (
            room_for_events(0, shape, stream.subgroups),
            room_for_records(0, shape, stream.subgroups),
        )
        self._kept = self._nothing
        self._handed = 0  # beats of the room that `sent` has handed out
        self._commits: list[Commits] = []
        self._make_room(_HEAD_BEATS)
        _begin(stream, shape, self._room, self._place, self._packers)

    def take(self, events: Events, records: Records, known_until: int) -> None:
        """Play the events and records of a piece of the frame, all of this stream's subgroups.

        known_until: there is no other event or record that is committed before this cycle.
        """
        queues = self._room.queues
        events, records = join(queues, self._kept, (events, records))
        self._make_room(
            int(events.bounds[-1]) * self._shape.event_beats
            + int(records.bounds[-1]) * self._shape.record_beats
        )
        _play(
            self._stream,
            self._shape,
            self._room,
            self._place,
            self._packers,
            events,
            records,
            known_until,
        )
        self._kept, commits = split(queues, events, records)
        self._commits.append(commits)

    def sent(self) -> Sent:
        """Take out the beats that nothing changes any more, and the commits of the events whose
        place is free again.
        """
        place = self._place[0]
        room = self._room
        done = int(place["done"])
        beats = room.beats[self._handed : done].copy()
        sent_at = room.sent_at[self._handed : done].copy()
        kept = min(done, self._shape.output_depth)
        keep_only(room.beats, done - kept, kept)
        keep_only(room.sent_at, done - kept, kept)
        place["done"] = kept
        self._handed = kept
        if self._shape.grouped:
            beats, sent_at = take_groups(self._packers[0], room.packed)
        return Sent(beats, sent_at, *self._take_commits())

    def end(self, end: int, counters: np.ndarray, counts: np.ndarray) -> None:
        """End the frame, whose last period ends in cycle `end`, and set the counters of FIFOs in
        `counters`. `sent` hands out the rest.

        counts: uint64[n], beats of the packets with counts.
        """
        self.take(*self._nothing, int(_NEVER))
        counter_beats = self._stream.subgroups * self._shape.counter_beats
        self._make_room(len(counts) + _END_BEATS + counter_beats)
        _end(
            self._stream,
            self._shape,
            self._room,
            self._place,
            self._packers,
            end,
            counters,
            counts,
        )
        kept = self._kept[0]
        occupying = Commits(
            np.repeat(np.arange(self._stream.subgroups), np.diff(kept.bounds)),
            kept.row["cycle"],
            kept.row["free_at"],
        )
        self._commits.append(occupying)

    def _take_commits(self) -> Commits:
        """Take out the commits, by subgroup; subgroups have their numbers in the sensor."""
        columns = zip(_no_commits(), *self._commits, strict=True)
        subgroup, cycle, freed_at = (np.concatenate(column) for column in columns)
        self._commits = []
        order = np.argsort(subgroup, kind="stable")
        return Commits(subgroup[order] + self._stream.first, cycle[order], freed_at[order])

    def _make_room(self, beats: int) -> None:
        """Make room for so many more beats."""
        room = self._room
        most = int(self._place["done"][0]) + beats
        if most > len(room.beats):
            most = max(most, 2 * len(room.beats))
            room = room._replace(beats=longer(room.beats, most), sent_at=longer(room.sent_at, most))
        self._room = room._replace(
            packed=more_room(self._packers[0], room.packed, beats, self._shape)
        )


def _no_commits() -> Commits:
    return Commits(*(np.empty(0, np.int64) for _ in Commits._fields))


@njit(allocates=False)
def _begin(
    stream: Stream, shape: Shape, room: _Room, places: np.ndarray, packers: np.ndarray
) -> None:
    """Send the head of the frame."""
    packer = packers[0]
    place = places[0]
    room.values[NUMBER.pulse] = stream.frame
    room.values[NUMBER.count] = shape.start_count
    _encode(room.beats[:_HEAD_BEATS], _FRAME_START, room.values, shape.frame_parts)
    place.done = _transfer(room, 0, _HEAD_BEATS, latency.FRAME_START)
    _pass(packer, room, 0, _HEAD_BEATS, shape)
    # equivalent: nothing is committed so early that it could be granted then
    place.t = latency.FRAME_START + 1


@njit(allocates=False)
def _play(
    stream: Stream,
    shape: Shape,
    room: _Room,
    places: np.ndarray,
    packers: np.ndarray,
    events: Events,
    records: Records,
    known_until: int,
) -> None:
    """Proceed from grant to grant, as long as all requests are known; write the beats to `room`."""
    packer = packers[0]
    place = places[0]
    queues = room.queues
    for s in range(len(queues)):
        room.wake[s] = min(room.wake[s], _next_request(queues[s], events.row, records.row))
    while True:
        place.t = _when_room(shape.longest_word, place.t, place.done, room.sent_at, shape)
        if place.t >= known_until:
            break
        chosen, upcoming = _arbitrate(
            place.t, place.pointer, queues, room.wake, events.row, records.row, shape.fifo_depth
        )
        if chosen != NONE:
            place.done, length = _grant(
                chosen, place.t, place.done, stream, shape, room, packer, events, records
            )
            place.t += length
            place.pointer = (chosen + 1) % len(queues)
        elif upcoming < _NEVER:
            place.t = upcoming
        else:
            break


@njit(allocates=False)
def _end(
    stream: Stream,
    shape: Shape,
    room: _Room,
    places: np.ndarray,
    packers: np.ndarray,
    end: int,
    counters: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Send the counts, the end of the frame, and the counters.

    A wait for room would not show: the buffer keeps the stream busy while it lasts.
    """
    packer = packers[0]
    place = places[0]
    beats = room.beats
    t = max(place.t, end + latency.FINISH)
    done = place.done
    for k in range(len(counts)):
        beats[done + k] = counts[k]
    if len(counts):
        done = _send(packer, room, done, len(counts), t, shape)
        t += len(counts)
    for k in range(len(room.values)):
        room.values[k] = 0
    room.values[NUMBER.pulse] = stream.frame
    _encode(beats[done : done + _END_BEATS], _FRAME_END, room.values, shape.frame_parts)
    done = _send(packer, room, done, _END_BEATS, t, shape)
    t += _END_BEATS
    for s in range(stream.subgroups):
        _count(counters[stream.first + s], room.queues[s], shape.counter_max)
        _pack(beats[done : done + shape.counter_beats], counters[stream.first + s], COUNTER_BITS)
        done = _send(packer, room, done, shape.counter_beats, t, shape)
        t += shape.counter_beats
    place.done = done


@part
def _next_request(queue: Any, events: np.ndarray, records: np.ndarray) -> Any:
    """Return the first cycle in which an event or a record that is still to be committed may be
    granted.
    """
    cycle = _NEVER
    if queue.next_event < queue.end_event:
        cycle = events[queue.next_event].cycle + latency.STORE_TO_GRANT
    if queue.next_record < queue.end_record:
        cycle = min(cycle, records[queue.next_record].cycle + latency.STORE_TO_GRANT)
    return cycle


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
    is_event = queue.waiting == NONE
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
            if queue.waiting != NONE or queue.read < queue.next_event:
                return chosen, t
            wake[chosen] = _next_request(queue, events, records)
        upcoming = min(upcoming, wake[chosen])
    return NONE, upcoming


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
        if queue.waiting == NONE and queue.place_free_at <= records[queue.next_record].cycle:
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
    if queue.waiting != NONE:
        length = shape.record_beats
        values[NUMBER.pulse] = records.row[queue.waiting].pulse
        _pack(values[ARRAY:], records.entries[queue.waiting], shape.record_bits)
        _encode(beats[:length], _RECORD, values, shape.record_parts)
        queue.waiting = NONE
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
