# SPDX-License-Identifier: Apache-2.0
"""Readout of the golden model: from one stream's FIFOs, through round robin and output buffer, to beats and their cycles.

It proceeds from grant to grant. Everything that has been committed by then enters its FIFO or is dropped
(`_admit_events`, `_admit_records`). The next requesting subgroup is chosen (`_arbitrate`). Its packet is formed
(`_form_packet`) and leaves as the receiver takes it (`_transfer`). In a format with groups, the packer (`packer.py`) is this
receiver.
"""

from collections import namedtuple

import numpy as np

from ..contract import latency
from ..contract.counters import COUNTER_BITS
from ..contract.packet import BEAT_BITS, FRAME_END, FRAME_START, KIND_LSB, OFFSETS, RECORD
from ..shared.compiled import njit
from .packer import close_group, new_packer, pack_event
from .shape import ARRAY, COUNTER, NUMBER, row_type

_RECORD, _FRAME_START, _FRAME_END = RECORD.code, FRAME_START.code, FRAME_END.code
_OFFSET_BITS = OFFSETS.width
_ALL = np.uint64(0xFFFF_FFFF_FFFF_FFFF)
_NONE = -1
_NEVER = np.int64(1) << 62

# Queue of a subgroup. Events: the next to be committed and their end, the next to be read, the oldest whose place may
# still be occupied, the number of occupied places, and whether one was dropped since the last stored one. Records: the
# next to be written and their end, the waiting one, and when its place is free. Then the counters.
_QUEUE = row_type(
    "next_event end_event read oldest level lost next_record end_record waiting place_free_at stored dropped mg_stored mg_dropped"
)

# Arrays of a stream: beats before the packer and the cycles of their transfer, and scratch for `_arbitrate` (wake) and a
# packet (values). out: of the packer. next_ready: when the receiver takes a beat.
_Room = namedtuple("_Room", "queues wake beats sent_at values out next_ready")


@njit
def readout(first, n, shape, end, frame, events, records, counters, next_ready):
    """Return the beats of the stream with subgroups `first`...`first + n - 1`, and the cycles of their transfer.

    end: end of the last period. The fill levels of the FIFOs decide which events and records are stored: this sets
    `events.row.stored` and adds to `counters`.
    """
    queues = _queues(first, n, events.bounds, records.bounds)
    most = _beats(queues, shape)
    packers, out = new_packer(most, shape, next_ready)
    beats, sent_at = np.empty(most, np.uint64), np.empty(most, np.int64)
    values = np.zeros(ARRAY + shape.longest_word, np.uint64)
    room = _Room(queues, np.zeros(n, np.int64), beats, sent_at, values, out, next_ready)
    done = _play(room, packers[0], first, shape, end, frame, events, records, counters)
    if shape.grouped:
        beats, sent_at, done = out.beats, out.sent_at, packers[0].beat
    return beats[:done].copy(), sent_at[:done].copy()


@njit(allocates=False)
def _play(room, packer, first, shape, end, frame, events, records, counters):
    """Proceed from grant to grant; write the beats to `room`, and return the number of those before the packer."""
    queues, beats, sent_at, values = room.queues, room.beats, room.sent_at, room.values
    n = len(queues)
    values[NUMBER.pulse], values[NUMBER.count] = frame, shape.grouped
    _encode(beats[:1], _FRAME_START, values, shape.frame_parts)
    done = _transfer(room, 0, 1, latency.FRAME_START)
    _pass(packer, room, 0, 1, shape)
    t, pointer = latency.FRAME_START + 1, 0
    while True:
        t = _when_room(shape.longest_word, t, done, sent_at, shape)
        chosen, upcoming = _arbitrate(t, pointer, queues, room.wake, events.row, records.row, shape.fifo_depth)
        if chosen != _NONE:
            for k in range(len(values)):
                values[k] = 0
            values[NUMBER.subgroup] = first + chosen
            queue, is_event = queues[chosen], queues[chosen].waiting == _NONE
            event = queue.read
            length = _form_packet(beats[done:], values, queue, t, shape, events, records)
            if shape.grouped and is_event:
                done = _take(sent_at, done, length, t, packer.taken)
                hits, offsets = events.hits[event], events.offsets[event]
                pack_event(packer, room.out, events.row[event], first + chosen, hits, offsets, sent_at[done - 1], shape)
            elif shape.grouped:
                done = _send(packer, room, done, length, t, shape)
            else:
                done = _transfer(room, done, length, t)
            t, pointer = t + length, (chosen + 1) % n
        elif upcoming < _NEVER:
            t = upcoming
        else:
            break
    t = max(t, end + latency.FINISH)
    for k in range(len(values)):
        values[k] = 0
    values[NUMBER.pulse] = frame
    _encode(beats[done : done + 1], _FRAME_END, values, shape.frame_parts)
    done = _send(packer, room, done, 1, t, shape)
    t += 1
    for s in range(n):  # a wait for room would not show: the buffer keeps the stream busy while it lasts
        _count(counters[first + s], queues[s], shape.counter_max)
        _pack(beats[done : done + shape.counter_beats], counters[first + s], COUNTER_BITS)
        done = _send(packer, room, done, shape.counter_beats, t, shape)
        t += shape.counter_beats
    return done


@njit
def _queues(first, n, event_bounds, record_bounds):
    queues = np.zeros(n, _QUEUE)
    for s in range(n):
        queue = queues[s]
        queue.next_event = queue.read = queue.oldest = event_bounds[first + s]
        queue.end_event = event_bounds[first + s + 1]
        queue.next_record, queue.end_record = record_bounds[first + s], record_bounds[first + s + 1]
        queue.waiting = _NONE
    return queues


@njit
def _beats(queues, shape):
    """Return the number of beats in a frame without drops."""
    beats = 2 + len(queues) * shape.counter_beats
    for queue in queues:
        beats += (queue.end_event - queue.next_event) * shape.event_beats
        beats += (queue.end_record - queue.next_record) * shape.record_beats
    return beats


@njit(allocates=False)
def _when_room(length, t, done, sent_at, shape):
    """Return the first cycle from `t` on in which the output buffer has room for `length` more beats after `done`.

    What the packer takes leaves its place a cycle later.
    """
    left = done + length - shape.output_depth
    return max(t, sent_at[left - 1] + 1 + shape.grouped) if left > 0 else t


@njit(allocates=False)
def _arbitrate(t, pointer, queues, wake, events, records, fifo_depth):
    """Return the first subgroup, from `pointer` on and round, that requests in cycle `t`, or else the next possible cycle.

    wake: int64[subgroups], the first cycle in which a subgroup may request.
    """
    upcoming, n = _NEVER, len(queues)
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
                wake[chosen] = min(wake[chosen], records[queue.next_record].cycle + latency.STORE_TO_GRANT)
        upcoming = min(upcoming, wake[chosen])
    return _NONE, upcoming


@njit(allocates=False)
def _admit_events(queue, t, events, fifo_depth):
    """Move events that may be granted by cycle `t` into the FIFO, or drop them if it was full at their commit."""
    while queue.next_event < queue.end_event and events[queue.next_event].cycle + latency.STORE_TO_GRANT <= t:
        event = events[queue.next_event]
        while queue.oldest < queue.next_event and events[queue.oldest].free_at <= event.cycle:
            queue.level -= events[queue.oldest].stored
            queue.oldest += 1
        event.stored = queue.level < fifo_depth
        if event.stored:
            event.free_at, event.overrun = _NEVER, queue.lost
            queue.level += 1
            queue.stored += 1
        else:
            event.free_at = event.cycle  # a dropped event takes no place
            queue.dropped += 1
        queue.lost = not event.stored
        queue.next_event += 1
    while queue.read < queue.next_event and not events[queue.read].stored:
        queue.read += 1


@njit(allocates=False)
def _admit_records(queue, t, records):
    """Move records that may be granted by cycle `t` to the only place, or drop them if it was taken."""
    while queue.next_record < queue.end_record and records[queue.next_record].cycle + latency.STORE_TO_GRANT <= t:
        if queue.waiting == _NONE and queue.place_free_at <= records[queue.next_record].cycle:
            queue.waiting = queue.next_record
            queue.mg_stored += 1
        else:
            queue.mg_dropped += 1
        queue.next_record += 1


@njit(allocates=False)
def _form_packet(beats, values, queue, t, shape, events, records):
    """Write the packet that is granted in cycle `t` to `beats`, a record before events; free its place; return its length."""
    if queue.waiting != _NONE:
        length = shape.record_beats
        values[NUMBER.pulse] = records.row[queue.waiting].pulse
        _pack(values[ARRAY:], records.entries[queue.waiting], shape.record_bits)
        _encode(beats[:length], _RECORD, values, shape.record_parts)
        queue.waiting, queue.place_free_at = _NONE, t + latency.GRANT_TO_READ + length
        return length
    event, length, behind_map = events.row[queue.read], shape.event_beats, ARRAY + shape.hits_words
    values[NUMBER.overrun], values[NUMBER.pulse], values[NUMBER.stamp] = event.overrun, event.pulse, event.stamp
    values[NUMBER.count], values[NUMBER.winner] = event.count, event.winner
    for k in range(shape.hits_words):
        values[ARRAY + k] = events.hits[queue.read, k]
    if shape.event_has_offsets:
        _pack(values[behind_map:], events.offsets[queue.read], _OFFSET_BITS)
    _encode(beats[:length], shape.event_code, values, shape.event_parts)
    event.free_at = t + latency.GRANT_TO_READ + length
    queue.read += 1
    return length


@njit(allocates=False)
def _encode(beats, code, values, parts):
    """Write a packet of this kind to `beats`. parts: which bits of `values` stand where."""
    for k in range(len(beats)):
        beats[k] = 0
    beats[0] = np.uint64(code) << np.uint64(KIND_LSB)
    for part in parts:
        bits = values[part.word] >> np.uint64(part.shift) & _ALL >> np.uint64(BEAT_BITS - part.width)
        beats[part.beat] |= bits << np.uint64(part.lsb)


@njit(allocates=False)
def _pack(beats, items, bits):
    """Pack `items` of `bits` each into words, lowest bits first."""
    for k in range(len(beats)):
        beats[k] = 0
    per_beat = BEAT_BITS // bits
    for k in range(len(items)):
        beats[k // per_beat] |= np.uint64(items[k]) << np.uint64(k % per_beat * bits)


@njit(allocates=False)
def _count(counters, queue, most):
    counters[COUNTER.stored], counters[COUNTER.dropped] = min(queue.stored, most), min(queue.dropped, most)
    counters[COUNTER.mg_stored], counters[COUNTER.mg_dropped] = min(queue.mg_stored, most), min(queue.mg_dropped, most)


@njit(allocates=False)
def _send(packer, room, done, length, t, shape):
    """Let the `length` beats after `done`, which are of no event, leave behind the open group; return the new `done`."""
    sent_at = room.sent_at
    before = sent_at[done - 1]
    if shape.grouped:
        arrives = t + latency.GRANT_TO_BEAT + latency.BEAT_TO_PORT
        close_group(packer, room.out, max(arrives, packer.formed + 1))
        sent_at[done - 1] = max(before, packer.beat_from - 1)
    end = _transfer(room, done, length, t)
    sent_at[done - 1] = before
    _pass(packer, room, done, end, shape)
    return end


@njit(allocates=False)
def _pass(packer, room, done, end, shape):
    """Let beats from `done` to `end` through the packer."""
    if shape.grouped:
        begin, packer.beat = packer.beat, packer.beat + end - done
        for k in range(end - done):
            room.out.beats[begin + k], room.out.sent_at[begin + k] = room.beats[done + k], room.sent_at[done + k]


@njit(allocates=False)
def _take(sent_at, done, length, t, taken):
    """Write to `sent_at` when the packer takes an event's beats, the first one from cycle `taken` on; return the new `done`."""
    sent_at[done] = max(t + latency.GRANT_TO_BEAT + latency.BEAT_TO_PORT, sent_at[done - 1] + 1, taken)
    for k in range(done + 1, done + length):
        sent_at[k] = sent_at[k - 1] + 1
    return done + length


@njit(allocates=False)
def _transfer(room, done, length, t):
    """Write down when the `length` beats after `done`, granted in cycle `t`, leave; return the new `done`."""
    sent_at, next_ready = room.sent_at, room.next_ready
    for k in range(done, done + length):
        earliest = t + latency.GRANT_TO_BEAT + k - done + latency.BEAT_TO_PORT
        if k:
            earliest = max(earliest, sent_at[k - 1] + 1)
        sent_at[k] = next_ready[earliest] if earliest < len(next_ready) else earliest
    return done + length


def ready_times(ready: np.ndarray) -> np.ndarray:
    """Return, for each cycle, the first cycle from there on in which `tready` is high (always high after the end)."""
    following = np.where(ready != 0, np.arange(len(ready)), len(ready))
    return np.minimum.accumulate(following[::-1])[::-1].astype(np.int64)
