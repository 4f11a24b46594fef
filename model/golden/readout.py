"""Readout of the golden model: one stream's FIFOs, round robin and output buffer, to beats and the cycles of their transfer."""

from collections import namedtuple

import numba
import numpy as np

from ..contract import latency
from ..contract.packet import BEAT_BITS, HEADER, OFFSET_BITS, Kind
from .shape import COUNTER

_LSB = namedtuple("_LSB", tuple(HEADER))(*(lsb for lsb, _ in HEADER.values()))
_RECORD, _FRAME_START, _FRAME_END = int(Kind.RECORD), int(Kind.FRAME_START), int(Kind.FRAME_END)
_NEVER = np.int64(1) << 62


@numba.njit(cache=True, nogil=True)
def readout(first, n, shape, end, frame, events, records, counters, stored, next_ready):
    """Beats of the stream that carries subgroups `first`...`first + n - 1`, and the cycles of their transfer. end: of the last period.

    Decides which events and records are stored, as the FIFOs' fill at their commit demands; adds to `counters`, sets `stored`.
    """
    last = first + n
    total = (
        2
        + n * shape.counter_beats
        + (events.bounds[last] - events.bounds[first]) * shape.event_beats
        + (records.bounds[last] - records.bounds[first]) * (1 + shape.record_beats)
    )
    beats, sent_at = np.empty(total, np.uint64), np.empty(total, np.int64)
    freed_at = np.full(len(events.cycle), _NEVER, np.int64)  # when each stored event's place in its FIFO is free again
    overrun = np.zeros(len(events.cycle), np.bool_)
    committed = events.bounds[first:last].copy()  # per subgroup: next event to be committed,
    waiting = committed.copy()  # next stored event to be read,
    oldest = committed.copy()  # oldest event that still has its place,
    level = np.zeros(n, np.int64)  # events in the FIFO,
    lost = np.zeros(n, np.bool_)  # a drop since the last stored event,
    emitted = records.bounds[first:last].copy()  # next record to be emitted,
    record = np.full(n, -1, np.int64)  # the record that waits to be read (-1: none),
    record_free_at = np.zeros(n, np.int64)  # and when its place is free
    finish = end + latency.FINISH

    granted = 0  # beats
    pointer = 0
    t = np.int64(latency.FRAME_START)
    state = _FRAME_START
    tail = 0
    while True:
        short = granted + shape.longest - shape.output_depth  # beats that must have left before the next grant
        if short > 0:
            t = max(t, sent_at[short - 1] + 1)
        chosen, kind = -1, np.int64(0)
        if state == _FRAME_START:
            kind, length = state, 1
            state = _RECORD
        elif state == _RECORD:
            upcoming = _NEVER
            for k in range(n):
                s = (pointer + k) % n
                while (
                    committed[s] < events.bounds[first + s + 1]
                    and events.cycle[committed[s]] + latency.STORE_TO_GRANT <= t
                ):
                    e = committed[s]
                    committed[s] += 1
                    while oldest[s] < e and (freed_at[oldest[s]] <= events.cycle[e] or not stored[oldest[s]]):
                        level[s] -= stored[oldest[s]]
                        oldest[s] += 1
                    if level[s] < shape.fifo_depth:
                        level[s] += 1
                        stored[e], overrun[e], lost[s] = True, lost[s], False
                        counters[first + s, COUNTER.stored] += 1
                    else:
                        lost[s] = True
                        counters[first + s, COUNTER.dropped] += 1
                while (
                    emitted[s] < records.bounds[first + s + 1]
                    and records.cycle[emitted[s]] + latency.STORE_TO_GRANT <= t
                ):
                    if record[s] < 0 and record_free_at[s] <= records.cycle[emitted[s]]:
                        record[s] = emitted[s]
                        counters[first + s, COUNTER.mg_stored] += 1
                    else:
                        counters[first + s, COUNTER.mg_dropped] += 1
                    emitted[s] += 1
                while waiting[s] < committed[s] and not stored[waiting[s]]:
                    waiting[s] += 1
                if record[s] >= 0 or waiting[s] < committed[s]:
                    if chosen < 0:
                        chosen = s
                    continue
                if committed[s] < events.bounds[first + s + 1]:
                    upcoming = min(upcoming, events.cycle[committed[s]] + latency.STORE_TO_GRANT)
                if emitted[s] < records.bounds[first + s + 1]:
                    upcoming = min(upcoming, records.cycle[emitted[s]] + latency.STORE_TO_GRANT)
            if chosen < 0:
                if upcoming < _NEVER:
                    t = upcoming
                    continue
                t = max(t, finish)
                kind, length = _FRAME_END, 1
                state = _FRAME_END
            else:
                pointer = (chosen + 1) % n
                if record[chosen] >= 0:
                    kind, length = _RECORD, 1 + shape.record_beats
                else:
                    kind, length = shape.event_kind, shape.event_beats
        else:
            if tail == n:
                break
            length = shape.counter_beats

        freed = t + latency.GRANT_TO_READ + length
        if kind == _FRAME_START or kind == _FRAME_END:
            beats[granted] = (np.uint64(kind) << np.uint64(_LSB.kind)) | (np.uint64(frame) << np.uint64(_LSB.pulse))
        elif kind == _RECORD:
            r = record[chosen]
            record[chosen], record_free_at[chosen] = -1, freed
            beats[granted] = _header(kind, 0, first + chosen, records.pulse[r], 0, 0, 0)
            _pack(beats, granted + 1, shape.record_beats, records.entries[r], shape.record_bits)
        elif kind:
            e = waiting[chosen]
            waiting[chosen] += 1
            freed_at[e] = freed
            beats[granted] = _header(
                kind, overrun[e], first + chosen, events.pulse[e], events.count[e], events.winner[e], events.stamp[e]
            )
            if length > 1:
                beats[granted + 1 : granted + 1 + shape.map_beats] = events.hits[e]
            if length > 1 + shape.map_beats:
                _pack(
                    beats, granted + 1 + shape.map_beats, length - 1 - shape.map_beats, events.offsets[e], OFFSET_BITS
                )
        else:
            _pack(beats, granted, length, counters[first + tail], 32)
            tail += 1
        for k in range(length):
            earliest = t + latency.GRANT_TO_BEAT + k + latency.BEAT_TO_PORT
            if granted:
                earliest = max(earliest, sent_at[granted - 1] + 1)
            sent_at[granted] = next_ready[earliest] if earliest < len(next_ready) else earliest
            granted += 1
        t += length
    return beats[:granted].copy(), sent_at[:granted].copy()


@numba.njit(cache=True, nogil=True)
def _header(kind, overrun, subgroup, pulse, count, winner, stamp):
    return (
        (np.uint64(kind) << np.uint64(_LSB.kind))
        | (np.uint64(overrun) << np.uint64(_LSB.overrun))
        | (np.uint64(subgroup) << np.uint64(_LSB.subgroup))
        | (np.uint64(pulse) << np.uint64(_LSB.pulse))
        | (np.uint64(count) << np.uint64(_LSB.count))
        | (np.uint64(winner) << np.uint64(_LSB.winner))
        | np.uint64(stamp)
    )


@numba.njit(cache=True, nogil=True)
def _pack(beats, at, length, items, bits):
    """Packs `items` of `bits` each into beats[at : at + length], lowest bits first."""
    beats[at : at + length] = 0
    per_beat = BEAT_BITS // bits
    for k in range(len(items)):
        beats[at + k // per_beat] |= np.uint64(items[k]) << np.uint64(k % per_beat * bits)


def ready_times(ready: np.ndarray) -> np.ndarray:
    """For each cycle the first one from it on with `tready` high (past the end: always)."""
    following = np.where(ready != 0, np.arange(len(ready)), len(ready))
    return np.minimum.accumulate(following[::-1])[::-1].astype(np.int64)
