# SPDX-License-Identifier: Apache-2.0
"""Front end of the golden model: from each subgroup's edges, in the order of time, to events, minigroup records and fates.

The edges of a subgroup pass several stages, each of which is one loop. `_accept` sorts out duplicate, masked and gated
ones. The tree forms windows from the times of the accepted edges (`_open_windows`), and windows with enough pixels
become events (`_commit`). The minigroups are independent of windows and make their own collections (`_collect_records`).
"""

from collections import namedtuple

import numpy as np

from ..contract import latency
from ..contract.edges import Edges, Fate
from ..contract.latency import armed_cycle
from ..contract.packet import BEAT_BITS
from ..contract.parameters import OFFSET_NONE
from ..contract.pixels import Pixels
from ..shared.compiled import njit
from .shape import COUNTER, Shape, row_type

_OPENING, _COUNTED, _DUPLICATE, _MASKED, _GATED, _BLIND = (int(fate) for fate in Fate)
_Key = namedtuple("_Key", "pulse tick")
_KEY = _Key(pulse=23, tick=8)  # lowest bit of these fields of a sort key; the lowest field is the pixel
_TICK_MASK, _PIXEL_MASK = (1 << _KEY.pulse - _KEY.tick) - 1, (1 << _KEY.tick) - 1
_WORD_BITS = (BEAT_BITS - 1).bit_length()  # bits of a pixel's number inside a word of the ID map
_NEVER = -1  # before all cycles

# By subgroup, as the frame uses them. Threshold and window are 1 if coincidence is off. close: int64[subgroups, phases],
# cycles from that of a window's first edge, by its phase, to that of the window's last tick.
Settings = namedtuple("Settings", "threshold window close mask gating gate_start gate_len")
# By pulse: the first cycle of its period, and the cycles that progressive gating adds to a gate's start.
Timeline = namedtuple("Timeline", "start gate_shift")
# Rows by subgroup, then time; bounds: int64[subgroups + 1]. Rows from bounds[-1] on are unused.
Events = namedtuple("Events", "bounds row hits offsets")
Records = namedtuple("Records", "bounds row entries")
_EVENT = row_type("cycle pulse stamp count winner stored overrun free_at")  # the last three belong to the readout
_RECORD = row_type("cycle pulse")
# By minigroup: the map of its collection (0: none), its coarse stamp, and the first cycle after it.
_Collection = namedtuple("_Collection", "hits stamp end")

_armed_cycle = njit(armed_cycle)


def time_order(edges: Edges, pixel: Pixels, shape: Shape):
    """Return the sort keys (pulse, tick, pixel: see `_KEY`), the edges' order by subgroup and time, and its bounds.

    A stable counting sort by subgroup preserves the order of time, which edges mostly have already. Subgroups for which
    this is not so are sorted.
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


@njit
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


@njit(allocates=False)
def _fields(key):
    """Return pulse, tick and pixel inside the subgroup."""
    return key >> _KEY.pulse, key >> _KEY.tick & _TICK_MASK, key & _PIXEL_MASK


@njit(allocates=False)
def _cycle(key, shape):
    """Return pulse and cycle as one number, which no other cycle of the frame has."""
    return key >> _KEY.tick + shape.phase_bits


@njit
def front_end(key, bounds, shape, settings, timeline, pixel, counters):
    """Return fates in the order of time, events and minigroup records of all subgroups; add to `counters`."""
    n, most = len(key), 0  # edges: in total, and at most in a subgroup
    for s in range(shape.subgroups):
        most = max(most, bounds[s + 1] - bounds[s])
    events, records = _room_for_events(n, shape), _room_for_records(n if shape.minigroup_records else 0, shape)
    fate, accepted, windows = np.empty(n, np.uint8), np.empty(most, np.int64), np.empty((most, 2), np.int64)
    seen_at = np.empty(shape.pixels, np.int64)
    for s in range(shape.subgroups):
        of = slice(bounds[s], bounds[s + 1])
        passed = _accept(s, key[of], shape, settings, timeline, seen_at, fate[of], accepted)
        opened = _open_windows(s, key[of], passed, shape, settings, fate[of], windows, counters)
        _commit(s, key[of], passed, opened, shape, settings, timeline, pixel, fate[of], events, counters)
        if shape.minigroup_records:
            _collect_records(s, key[of], passed, shape, timeline, pixel, records)
    return fate, events, records


@njit
def _room_for_events(most, shape):
    return Events(
        np.zeros(shape.subgroups + 1, np.int64),
        np.empty(most, _EVENT),
        np.empty((most, shape.hits_words), np.uint64),
        np.empty((most, shape.minigroups), np.uint8),
    )


@njit
def _room_for_records(most, shape):
    return Records(
        np.zeros(shape.subgroups + 1, np.int64), np.empty(most, _RECORD), np.empty((most, shape.minigroups), np.uint64)
    )


@njit
def _accept(s, key, shape, settings, timeline, seen_at, fate, accepted):
    """Set the fates of subgroup `s`'s edges that go no further; write the indices of the others to `accepted`.

    Returns the written part. seen_at: scratch, the last edge of each pixel as `_cycle`.
    """
    seen_at[:] = _NEVER
    n = 0
    for e in range(len(key)):
        at, inside = _cycle(key[e], shape), key[e] & _PIXEL_MASK
        if seen_at[inside] == at:  # a second edge of a pixel in one cycle does not exist
            fate[e] = _DUPLICATE
        elif not settings.mask[s, inside]:
            fate[e] = _MASKED
        elif settings.gating[s] and not _in_gate(s, key[e], shape, settings, timeline):
            fate[e] = _GATED
        else:
            accepted[n] = e
            n += 1
        seen_at[inside] = at
    return accepted[:n]


@njit(allocates=False)
def _in_gate(s, key, shape, settings, timeline):
    """Return whether an edge is inside the gate of subgroup `s`."""
    pulse, tick, _ = _fields(key)
    cycle, gate_start = tick >> shape.phase_bits, settings.gate_start[s] + timeline.gate_shift[pulse]
    return gate_start <= cycle < gate_start + settings.gate_len[s]


@njit
def _open_windows(s, key, accepted, shape, settings, fate, windows, counters):
    """The tree of subgroup `s`: set the fates of `accepted` edges by their times, and write the windows to `windows`.

    Returns int64[n, 2]: the indices in `accepted` of each window's first edge and of the first edge after the window.
    """
    window = settings.window[s]
    last_pulse, blind_at, armed_from = _NEVER, _NEVER, 0
    n = k = 0
    while k < len(accepted):
        pulse, opening, _ = _fields(key[accepted[k]])
        if pulse != last_pulse:
            last_pulse, armed_from = pulse, 0
        cycle = opening >> shape.phase_bits
        if not armed_from <= cycle < shape.open_cycles:
            fate[accepted[k]] = _BLIND
            at = _cycle(key[accepted[k]], shape)
            counters[s, COUNTER.blind] += at != blind_at  # cycles, not edges
            blind_at = at
            k += 1
            continue
        armed_from = _armed_cycle(cycle + settings.close[s, opening & shape.phases - 1], shape.rearm)
        fate[accepted[k]], windows[n, 0] = _OPENING, k
        k += 1
        while k < len(accepted):
            edge_pulse, tick, _ = _fields(key[accepted[k]])
            if edge_pulse != pulse or tick >= opening + window:
                break
            fate[accepted[k]] = _COUNTED
            k += 1
        windows[n, 1] = k
        n += 1
    counters[s, COUNTER.opened] += n
    return windows[:n]


@njit(allocates=False)
def _commit(s, key, accepted, windows, shape, settings, timeline, pixel, fate, events, counters):
    """Count the distinct pixels of subgroup `s`'s windows; windows that meet the threshold become events."""
    threshold, minigroup, row = settings.threshold[s], pixel.minigroup, events.bounds[s]
    hits, offsets = events.hits, events.offsets  # of the next row
    photons = lower = rejected = 0
    for k in range(len(windows)):
        first, stop = windows[k, 0], windows[k, 1]
        if stop - first == 1 < threshold:  # a single photon, as most windows have in sunlight
            photons, lower, rejected = photons + 1, lower + (threshold == 2), rejected + 1
            continue
        hits[row] = 0
        offsets[row] = OFFSET_NONE
        pulse, opening, winner = _fields(key[accepted[first]])
        cycle = opening >> shape.phase_bits
        cycle_start = cycle << shape.phase_bits
        count = 0
        for e in accepted[first:stop]:
            _, tick, inside = _fields(key[e])
            word, bit = inside >> _WORD_BITS, np.uint64(1) << np.uint64(inside & BEAT_BITS - 1)
            if hits[row, word] & bit:
                fate[e] = _DUPLICATE
                continue
            hits[row, word] |= bit
            count += 1
            if offsets[row, minigroup[inside]] == OFFSET_NONE:
                offsets[row, minigroup[inside]] = (tick - cycle_start) >> shape.offset_tick_bits
        photons, lower = photons + count, lower + (count >= threshold - 1)
        if count < threshold:
            rejected += 1
            continue
        event = events.row[row]
        closes = cycle + settings.close[s, opening - cycle_start]
        event.cycle = timeline.start[pulse] + closes + latency.COMMIT
        event.pulse, event.stamp, event.count, event.winner = pulse, opening, count, winner
        row += 1
    counters[s, COUNTER.photons] += photons
    counters[s, COUNTER.lower] += lower
    counters[s, COUNTER.rejected] += rejected
    counters[s, COUNTER.committed] += row - events.bounds[s]
    events.bounds[s + 1] = row


@njit
def _collect_records(s, key, accepted, shape, timeline, pixel, records):
    """The minigroups of subgroup `s`: make a record for each period in which any of them latched."""
    row = records.bounds[s]
    collected = _Collection(
        np.zeros(shape.minigroups, np.uint64),
        np.zeros(shape.minigroups, np.int64),
        np.zeros(shape.minigroups, np.int64),
    )
    for k in range(len(accepted)):
        pulse, tick, inside = _fields(key[accepted[k]])
        _add(collected, pixel.minigroup[inside], np.uint64(1) << np.uint64(pixel.bit[inside]), tick, shape)
        period_ends = k + 1 == len(accepted) or key[accepted[k + 1]] >> _KEY.pulse != pulse
        if period_ends and _latch(collected, records.entries[row], shape):
            record = records.row[row]
            record.cycle, record.pulse = timeline.start[pulse] + shape.period + latency.RECORD, pulse
            row += 1
    records.bounds[s + 1] = row


@njit(allocates=False)
def _add(collected, g, bit, tick, shape):
    """Add an edge to the collection of minigroup `g`, or begin a collection with it."""
    cycle = tick >> shape.phase_bits
    if collected.hits[g] and cycle >= collected.end[g]:
        if _enough(collected.hits[g], shape.mg_threshold):
            return  # the record of the period is complete
        collected.hits[g] = 0
    if not collected.hits[g]:
        if cycle >= shape.open_cycles:
            return
        collected.stamp[g], collected.end[g] = tick >> shape.quarter_bits, cycle + shape.mg_window
    collected.hits[g] |= bit


@njit(allocates=False)
def _latch(collected, entries, shape):
    """Empty the collections into a record's entries; return whether any met the threshold."""
    latched = False
    for g in range(shape.minigroups):
        entries[g] = 0
        if _enough(collected.hits[g], shape.mg_threshold):
            entries[g] = collected.hits[g] << np.uint64(shape.record_stamp_bits) | np.uint64(collected.stamp[g])
            latched = True
        collected.hits[g] = 0
    return latched


@njit(allocates=False)
def _enough(hits, threshold):
    """Return whether a map holds at least `threshold` pixels (an empty one never does)."""
    count = 0
    while hits:
        hits &= hits - np.uint64(1)
        count += 1
    return count >= threshold
