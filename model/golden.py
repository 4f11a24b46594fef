"""Golden model: every beat, commit cycle, drop, counter and edge's fate of the sensor, cycle-accurate, event by event.

A frame is two steps. `_front_end` walks through each subgroup's edges in time order and yields the windows that met their threshold, the
minigroup records, and the fates. `_readout` plays one stream's FIFOs, round robin and output buffer on them and yields the beats.
Latencies are those of `latency.py`; everything else is the contract of section III-A of the paper as the design documentation fixes it.
"""

import enum
from collections import namedtuple

import numba
import numpy as np
from attrs import frozen

from . import latency
from .config import Config
from .edges import Edges
from .packet import BEAT_BITS, FORMATS, HEADER, OFFSET_BITS, Kind, layout
from .parameters import OFFSET_NONE, Sensor
from .registers import COUNTER_NAMES


class Fate(enum.IntEnum):
    """What became of an edge."""

    OPENING = 0
    COUNTED = 1
    DUPLICATE = 2
    MASKED = 3
    GATED = 4
    BLIND = 5


@frozen(eq=False)
class Trace:
    """One frame as the ports show it.

    beats: per stream uint64[n]; beat_cycle: per stream int64[n], the cycle each beat is transferred in (the last one has `tlast`).
    commit_subgroup, commit_cycle: int64[k], stored events by subgroup, then time. fate: uint8 per edge. counters: int64[subgroups, 10].
    """

    beats: list[np.ndarray]
    beat_cycle: list[np.ndarray]
    commit_subgroup: np.ndarray
    commit_cycle: np.ndarray
    fate: np.ndarray
    counters: np.ndarray


class Golden:
    """The sensor from reset on: frames in turn, the threshold controller's memory between them."""

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        self.frames = 0
        self._photons = None
        self._pixel = pixel_table(sensor)

    def frame(self, config: Config, edges: Edges, ready: np.ndarray | None = None, pulses: int | None = None) -> Trace:
        """Runs one frame; `edges` counts pulses from the frame's start.

        ready: uint8[n] or None; `tready` of all streams in cycle c is ready[c], and 1 from cycle n on. pulses below the configuration's: an
        aborted frame.
        """
        next_ready = _next_ready(np.asarray(ready if ready is not None else [], np.uint8))
        pulses = config.pulses if pulses is None else pulses
        sensor = self.sensor
        threshold = config.threshold
        if self._photons is not None:
            controlled = 1 + np.searchsorted(config.auto_bounds, self._photons, side="right")
            threshold = np.where(config.auto, controlled, threshold)
        shape = _shape(config)
        starts = config.start_cycles()
        key, order, bounds = _time_order(edges, self._pixel, shape)
        counters = np.zeros((sensor.subgroups, len(COUNTER_NAMES)), np.int64)
        counters[:, _COUNTER.threshold_used] = threshold
        fate_in_order, events, records = _front_end(
            key, bounds, shape, np.where(config.coincidence, threshold, 1), np.where(config.coincidence, config.window, 1),
            config.mask, config.gating, config.gate_start, config.gate_len, self._pixel.minigroup, self._pixel.bit, starts, counters,
        )
        fate = np.empty(len(edges), np.uint8)
        fate[order] = fate_in_order
        beats, cycles = [], []
        stored = np.zeros(len(events.cycle), np.bool_)
        for stream in range(sensor.streams):
            span = sensor.stream_subgroups(stream)
            end = starts[pulses - 1] + config.period
            out = _readout(span.start, len(span), shape, end, self.frames & 0xFFFF, events, records, counters, stored, next_ready)
            beats.append(out[0])
            cycles.append(out[1])
        self.frames += 1
        self._photons = counters[:, _COUNTER.photons].copy()
        commit_subgroup = np.repeat(np.arange(sensor.subgroups), np.diff(events.bounds))
        return Trace(beats, cycles, commit_subgroup[stored], events.cycle[stored], fate, counters)


_Shape = namedtuple("_Shape", (
    "subgroups pixels minigroups phase_bits period guard rearm fifo_depth quarter_bits mg_records mg_threshold mg_window "
    "gate_step gate_every gate_steps event_kind event_beats map_beats record_beats counter_beats longest "
    "record_bits record_stamp_bits output_depth"
))
_Events = namedtuple("_Events", "bounds cycle pulse stamp count winner hits offsets")
_Records = namedtuple("_Records", "bounds cycle pulse entries")
_Pixel = namedtuple("_Pixel", "subgroup inside minigroup bit")
_COUNTER = namedtuple("_COUNTER", COUNTER_NAMES)(*range(len(COUNTER_NAMES)))
_LSB = namedtuple("_LSB", tuple(HEADER))(*(lsb for lsb, _ in HEADER.values()))
_OPENING, _COUNTED, _DUPLICATE, _MASKED, _GATED, _BLIND = (int(fate) for fate in Fate)
_RECORD, _FRAME_START, _FRAME_END = int(Kind.RECORD), int(Kind.FRAME_START), int(Kind.FRAME_END)
_NEVER = np.int64(1) << 62
_WORD_BITS = (BEAT_BITS - 1).bit_length()  # of a pixel's number inside a word of the map
_KEY = namedtuple("_KEY", "pulse tick")(pulse=23, tick=8)  # lowest bits of the key's fields; the pixel inside is the lowest
_TICK_MASK, _PIXEL_MASK = (1 << _KEY.pulse - _KEY.tick) - 1, (1 << _KEY.tick) - 1


def _shape(config: Config) -> _Shape:
    sensor, frame = config.sensor, config.frame
    parts, kind = layout(sensor), FORMATS[config.format]
    return _Shape(
        sensor.subgroups, sensor.pixels, sensor.minigroups, sensor.phase_bits, config.period, sensor.guard, sensor.rearm, sensor.fifo_depth,
        sensor.phase_bits - 2, frame["minigroup_records"], frame["mg_threshold"], frame["mg_window"],
        frame["gate_step"], frame["gate_every"], frame["gate_steps"], int(kind), parts.length(kind), parts.map_beats, parts.record_beats,
        parts.counter_beats, parts.longest, sensor.record_bits, sensor.record_stamp_bits, latency.output_depth(parts.longest),
    )


def pixel_table(sensor: Sensor) -> _Pixel:
    """Where every pixel of the array and of a subgroup belongs (index rules of the contract)."""
    (sr, sc), (mr, mc) = sensor.subgroup, sensor.minigroup
    row, col = np.divmod(np.arange(sensor.array_pixels), sensor.cols)
    r, c = np.divmod(np.arange(sensor.pixels), sc)
    return _Pixel(
        subgroup=(row // sr) * (sensor.cols // sc) + col // sc,
        inside=(row % sr) * sc + col % sc,
        minigroup=(r // mr) * (sc // mc) + c // mc,
        bit=(r % mr) * mc + c % mc,
    )


def _time_order(edges: Edges, pixel: _Pixel, shape: _Shape):
    """Sort keys (pulse, tick, pixel inside: see `_KEY`), by subgroup, then time; the edges' order; and the subgroups' bounds in it.

    A stable counting sort by subgroup keeps the order in time that edges mostly come in; where they do not, each subgroup is sorted.
    """
    key, order, bounds, in_time = _by_subgroup(edges.pulse, edges.pixel, edges.tick, pixel.subgroup, pixel.inside, shape.subgroups)
    if not in_time:
        for s in range(shape.subgroups):
            part = slice(bounds[s], bounds[s + 1])
            by_time = np.argsort(key[part], kind="stable")
            key[part], order[part] = key[part][by_time], order[part][by_time]
    return key, order, bounds


@numba.njit(cache=True, nogil=True)
def _by_subgroup(pulse, pixel, tick, subgroup_of, inside_of, subgroups):
    bounds = np.zeros(subgroups + 1, np.int64)
    for e in range(len(pixel)):
        bounds[subgroup_of[pixel[e]] + 1] += 1
    bounds = np.cumsum(bounds)
    at = bounds[:-1].copy()
    last = np.full(subgroups, -1, np.int64)
    key, order = np.empty(len(pixel), np.int64), np.empty(len(pixel), np.int64)
    in_time = True
    for e in range(len(pixel)):
        s = subgroup_of[pixel[e]]
        k = pulse[e] << _KEY.pulse | tick[e] << _KEY.tick | inside_of[pixel[e]]
        key[at[s]], order[at[s]] = k, e
        at[s] += 1
        in_time &= k >= last[s]
        last[s] = k
    return key, order, bounds, in_time


def _next_ready(ready: np.ndarray) -> np.ndarray:
    """For each cycle the first one from it on with `tready` high (past the end: always)."""
    following = np.where(ready != 0, np.arange(len(ready)), len(ready))
    return np.minimum.accumulate(following[::-1])[::-1].astype(np.int64)


@numba.njit(cache=True, nogil=True)
def _front_end(key, bounds, shape, threshold, window, mask, gating, gate_start, gate_len, minigroup, mg_bit, starts, counters):
    """Fates in time order, committed events and minigroup records of all subgroups; adds to `counters`. starts: cycle of each period."""
    n = len(key)
    fate = np.empty(n, np.uint8)
    words = shape.map_beats
    event_bounds, record_bounds = np.zeros(shape.subgroups + 1, np.int64), np.zeros(shape.subgroups + 1, np.int64)
    cycle_of, pulse_of, stamp_of = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    count_of, winner_of = np.empty(n, np.int64), np.empty(n, np.int64)
    hits_of, offsets_of = np.zeros((n, words), np.uint64), np.empty((n, shape.minigroups), np.uint8)
    record_rows = n if shape.mg_records else 0
    record_pulse, entries_of = np.empty(record_rows, np.int64), np.zeros((record_rows, shape.minigroups), np.uint64)
    events = records = 0
    last_open = shape.period - shape.guard

    seen_at = np.empty(shape.pixels, np.int64)   # cycle of the frame in which each pixel's last edge came
    hits = np.zeros(words, np.uint64)            # the open window's map
    offsets = np.full(shape.minigroups, OFFSET_NONE, np.uint8)
    mg_map = np.zeros(shape.minigroups, np.uint64)   # each minigroup's collection
    mg_end, mg_stamp = np.zeros(shape.minigroups, np.int64), np.zeros(shape.minigroups, np.int64)
    mg_done = np.zeros(shape.minigroups, np.bool_)

    for s in range(shape.subgroups):
        seen_at[:] = -1
        blind_at = np.int64(-1)
        pulse = np.int64(-1)
        count = winner = np.int64(0)
        opened_at = window_end = armed_from = gate_first = np.int64(0)
        for e in range(bounds[s], bounds[s + 1] + 1):
            at_end = e == bounds[s + 1]
            k = np.int64(0) if at_end else key[e]
            i, tick, edge_pulse = k & _PIXEL_MASK, k >> _KEY.tick & _TICK_MASK, k >> _KEY.pulse
            cycle = tick >> shape.phase_bits
            if count and (at_end or edge_pulse != pulse or tick >= window_end):   # the window has closed
                counters[s, _COUNTER.photons] += count
                if count < threshold[s]:
                    counters[s, _COUNTER.rejected] += 1
                else:
                    counters[s, _COUNTER.committed] += 1
                    cycle_of[events] = starts[pulse] + (window_end - 1 >> shape.phase_bits) + latency.COMMIT
                    pulse_of[events], stamp_of[events], count_of[events], winner_of[events] = pulse, opened_at, count, winner
                    for w in range(words):
                        hits_of[events, w] = hits[w]
                    for m in range(shape.minigroups):
                        offsets_of[events, m] = offsets[m]
                    events += 1
                count = 0
            if at_end or edge_pulse != pulse:    # the period has ended, its records leave
                if shape.mg_records and pulse >= 0:
                    latched = False
                    for g in range(shape.minigroups):
                        if _enough(mg_map[g], shape.mg_threshold):
                            entries_of[records, g] = (mg_map[g] << np.uint64(shape.record_stamp_bits)) | np.uint64(mg_stamp[g])
                            latched = True
                        mg_map[g], mg_done[g] = 0, False
                    if latched:
                        record_pulse[records] = pulse
                        records += 1
                if at_end:
                    break
                pulse = edge_pulse
                window_end = armed_from = 0
                gate_first = gate_start[s]
                if shape.gate_every:
                    gate_first += shape.gate_step * ((pulse // shape.gate_every) % shape.gate_steps)

            at = starts[pulse] + cycle
            if seen_at[i] == at:                 # a second edge of a pixel in one cycle does not exist
                fate[e] = _DUPLICATE
                continue
            seen_at[i] = at
            if not mask[s, i]:
                fate[e] = _MASKED
                continue
            if gating[s] and not gate_first <= cycle < gate_first + gate_len[s]:
                fate[e] = _GATED
                continue

            g = minigroup[i]
            if shape.mg_records and not mg_done[g]:
                if mg_map[g] and cycle >= mg_end[g]:
                    mg_done[g] = _enough(mg_map[g], shape.mg_threshold)
                    if not mg_done[g]:
                        mg_map[g] = 0
                if not mg_done[g]:
                    if mg_map[g] or cycle < last_open:
                        if not mg_map[g]:
                            mg_stamp[g] = tick >> shape.quarter_bits
                            mg_end[g] = cycle + shape.mg_window
                        mg_map[g] |= np.uint64(1) << np.uint64(mg_bit[i])

            word, bit = i >> _WORD_BITS, np.uint64(1) << np.uint64(i & BEAT_BITS - 1)
            if tick < window_end:
                if hits[word] & bit:
                    fate[e] = _DUPLICATE
                    continue
                fate[e] = _COUNTED
            elif armed_from <= cycle < last_open:
                fate[e] = _OPENING
                counters[s, _COUNTER.opened] += 1
                count, winner, opened_at, window_end = 0, i, tick, tick + window[s]
                armed_from = (window_end - 1 >> shape.phase_bits) + 1 + shape.rearm
                for w in range(words):
                    hits[w] = 0
                for m in range(shape.minigroups):
                    offsets[m] = OFFSET_NONE
            else:
                fate[e] = _BLIND
                if blind_at != at:
                    blind_at = at
                    counters[s, _COUNTER.blind] += 1
                continue
            count += 1
            hits[word] |= bit
            if offsets[g] == OFFSET_NONE:
                offsets[g] = (tick - (opened_at >> shape.phase_bits << shape.phase_bits)) >> shape.quarter_bits
        event_bounds[s + 1], record_bounds[s + 1] = events, records
    event_table = _Events(
        event_bounds, cycle_of[:events].copy(), pulse_of[:events].copy(), stamp_of[:events].copy(), count_of[:events].copy(),
        winner_of[:events].copy(), hits_of[:events].copy(), offsets_of[:events].copy(),
    )
    record_cycle = starts[record_pulse[:records]] + shape.period + latency.RECORD
    return fate, event_table, _Records(record_bounds, record_cycle, record_pulse[:records].copy(), entries_of[:records].copy())


@numba.njit(cache=True, nogil=True)
def _enough(pixels, threshold):
    """Whether a map holds at least `threshold` pixels (an empty one never does)."""
    count = 0
    while pixels:
        pixels &= pixels - np.uint64(1)
        count += 1
    return count >= threshold


@numba.njit(cache=True, nogil=True)
def _readout(first, n, shape, end, frame, events, records, counters, stored, next_ready):
    """Beats of the stream that carries subgroups `first`...`first + n - 1`, and the cycles of their transfer. end: of the last period.

    Decides which events and records are stored, as the FIFOs' fill at their commit demands; adds to `counters`, sets `stored`.
    """
    last = first + n
    total = (
        2 + n * shape.counter_beats + (events.bounds[last] - events.bounds[first]) * shape.event_beats
        + (records.bounds[last] - records.bounds[first]) * (1 + shape.record_beats)
    )
    beats, sent_at = np.empty(total, np.uint64), np.empty(total, np.int64)
    freed_at = np.full(len(events.cycle), _NEVER, np.int64)   # when each stored event's place in its FIFO is free again
    overrun = np.zeros(len(events.cycle), np.bool_)
    committed = events.bounds[first:last].copy()              # per subgroup: next event to be committed,
    waiting = committed.copy()                                # next stored event to be read,
    oldest = committed.copy()                                 # oldest event that still has its place,
    level = np.zeros(n, np.int64)                             # events in the FIFO,
    lost = np.zeros(n, np.bool_)                              # a drop since the last stored event,
    emitted = records.bounds[first:last].copy()               # next record to be emitted,
    record = np.full(n, -1, np.int64)                         # the record that waits to be read (-1: none),
    record_free_at = np.zeros(n, np.int64)                    # and when its place is free
    finish = end + latency.FINISH

    granted = 0                      # beats
    pointer = 0
    t = np.int64(latency.FRAME_START)
    state = _FRAME_START
    tail = 0
    while True:
        short = granted + shape.longest - shape.output_depth   # beats that must have left before the next grant
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
                while committed[s] < events.bounds[first + s + 1] and events.cycle[committed[s]] + latency.STORE_TO_GRANT <= t:
                    e = committed[s]
                    committed[s] += 1
                    while oldest[s] < e and (freed_at[oldest[s]] <= events.cycle[e] or not stored[oldest[s]]):
                        level[s] -= stored[oldest[s]]
                        oldest[s] += 1
                    if level[s] < shape.fifo_depth:
                        level[s] += 1
                        stored[e], overrun[e], lost[s] = True, lost[s], False
                        counters[first + s, _COUNTER.stored] += 1
                    else:
                        lost[s] = True
                        counters[first + s, _COUNTER.dropped] += 1
                while emitted[s] < records.bounds[first + s + 1] and records.cycle[emitted[s]] + latency.STORE_TO_GRANT <= t:
                    if record[s] < 0 and record_free_at[s] <= records.cycle[emitted[s]]:
                        record[s] = emitted[s]
                        counters[first + s, _COUNTER.mg_stored] += 1
                    else:
                        counters[first + s, _COUNTER.mg_dropped] += 1
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
                kind, overrun[e], first + chosen, events.pulse[e], events.count[e], events.winner[e], events.stamp[e],
            )
            if length > 1:
                beats[granted + 1 : granted + 1 + shape.map_beats] = events.hits[e]
            if length > 1 + shape.map_beats:
                _pack(beats, granted + 1 + shape.map_beats, length - 1 - shape.map_beats, events.offsets[e], OFFSET_BITS)
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
        (np.uint64(kind) << np.uint64(_LSB.kind)) | (np.uint64(overrun) << np.uint64(_LSB.overrun))
        | (np.uint64(subgroup) << np.uint64(_LSB.subgroup)) | (np.uint64(pulse) << np.uint64(_LSB.pulse))
        | (np.uint64(count) << np.uint64(_LSB.count)) | (np.uint64(winner) << np.uint64(_LSB.winner)) | np.uint64(stamp)
    )


@numba.njit(cache=True, nogil=True)
def _pack(beats, at, length, items, bits):
    """Packs `items` of `bits` each into beats[at : at + length], lowest bits first."""
    beats[at : at + length] = 0
    per_beat = BEAT_BITS // bits
    for k in range(len(items)):
        beats[at + k // per_beat] |= np.uint64(items[k]) << np.uint64(k % per_beat * bits)
