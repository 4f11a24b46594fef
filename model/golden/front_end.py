"""Front end of the golden model: each subgroup's edges in time order, to windows that met their threshold, minigroup records, and fates."""

from collections import namedtuple

import numba
import numpy as np

from ..contract import latency
from ..contract.edges import Edges, Fate
from ..contract.packet import BEAT_BITS
from ..contract.parameters import OFFSET_NONE
from ..contract.pixels import Pixels
from .shape import COUNTER, Shape

_OPENING, _COUNTED, _DUPLICATE, _MASKED, _GATED, _BLIND = (int(fate) for fate in Fate)
_KEY = namedtuple("_KEY", "pulse tick")(
    pulse=23, tick=8
)  # lowest bits of the key's fields; the pixel inside is the lowest
_TICK_MASK, _PIXEL_MASK = (1 << _KEY.pulse - _KEY.tick) - 1, (1 << _KEY.tick) - 1
_WORD_BITS = (BEAT_BITS - 1).bit_length()  # of a pixel's number inside a word of the map
Events = namedtuple("Events", "bounds cycle pulse stamp count winner hits offsets")
Records = namedtuple("Records", "bounds cycle pulse entries")


def time_order(edges: Edges, pixel: Pixels, shape: Shape):
    """Sort keys (pulse, tick, pixel inside: see `_KEY`), by subgroup, then time; the edges' order; and the subgroups' bounds in it.

    A stable counting sort by subgroup keeps the order in time that edges mostly come in; where they do not, each subgroup is sorted.
    """
    key, order, bounds, in_time = _by_subgroup(
        edges.pulse, edges.pixel, edges.tick, pixel.subgroup, pixel.inside, shape.subgroups
    )
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


@numba.njit(cache=True, nogil=True)
def front_end(
    key, bounds, shape, threshold, window, mask, gating, gate_start, gate_len, minigroup, mg_bit, starts, counters
):
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

    seen_at = np.empty(shape.pixels, np.int64)  # cycle of the frame in which each pixel's last edge came
    hits = np.zeros(words, np.uint64)  # the open window's map
    offsets = np.full(shape.minigroups, OFFSET_NONE, np.uint8)
    mg_map = np.zeros(shape.minigroups, np.uint64)  # each minigroup's collection
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
            if count and (at_end or edge_pulse != pulse or tick >= window_end):  # the window has closed
                counters[s, COUNTER.photons] += count
                if count < threshold[s]:
                    counters[s, COUNTER.rejected] += 1
                else:
                    counters[s, COUNTER.committed] += 1
                    cycle_of[events] = starts[pulse] + (window_end - 1 >> shape.phase_bits) + latency.COMMIT
                    pulse_of[events], stamp_of[events], count_of[events], winner_of[events] = (
                        pulse,
                        opened_at,
                        count,
                        winner,
                    )
                    for w in range(words):
                        hits_of[events, w] = hits[w]
                    for m in range(shape.minigroups):
                        offsets_of[events, m] = offsets[m]
                    events += 1
                count = 0
            if at_end or edge_pulse != pulse:  # the period has ended, its records leave
                if shape.mg_records and pulse >= 0:
                    latched = False
                    for g in range(shape.minigroups):
                        if _enough(mg_map[g], shape.mg_threshold):
                            entries_of[records, g] = (mg_map[g] << np.uint64(shape.record_stamp_bits)) | np.uint64(
                                mg_stamp[g]
                            )
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
            if seen_at[i] == at:  # a second edge of a pixel in one cycle does not exist
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
                counters[s, COUNTER.opened] += 1
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
                    counters[s, COUNTER.blind] += 1
                continue
            count += 1
            hits[word] |= bit
            if offsets[g] == OFFSET_NONE:
                offsets[g] = (tick - (opened_at >> shape.phase_bits << shape.phase_bits)) >> shape.quarter_bits
        event_bounds[s + 1], record_bounds[s + 1] = events, records
    event_table = Events(
        event_bounds,
        cycle_of[:events].copy(),
        pulse_of[:events].copy(),
        stamp_of[:events].copy(),
        count_of[:events].copy(),
        winner_of[:events].copy(),
        hits_of[:events].copy(),
        offsets_of[:events].copy(),
    )
    record_cycle = starts[record_pulse[:records]] + shape.period + latency.RECORD
    return (
        fate,
        event_table,
        Records(record_bounds, record_cycle, record_pulse[:records].copy(), entries_of[:records].copy()),
    )


@numba.njit(cache=True, nogil=True)
def _enough(pixels, threshold):
    """Whether a map holds at least `threshold` pixels (an empty one never does)."""
    count = 0
    while pixels:
        pixels &= pixels - np.uint64(1)
        count += 1
    return count >= threshold
