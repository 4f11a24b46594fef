# SPDX-License-Identifier: Apache-2.0
"""Front end of the golden model: from each subgroup's edges, in the order of time, to events,
minigroup records and fates.

The edges of a subgroup pass several stages, each of which is one loop. `_accept` sorts out
duplicate, masked and gated ones. The tree forms windows from the times of the accepted edges
(`_open_windows`), and windows with enough pixels become events (`_commit`). The minigroups are
independent of windows and make their own collections (`_collect_records`).
"""

from typing import NamedTuple

import numpy as np

from ..contract import latency
from ..contract.edges import Edges, Fate
from ..contract.latency import armed_cycle
from ..contract.packet import BEAT_BITS
from ..contract.parameters import OFFSET_NONE
from ..contract.pixels import Pixels
from ..shared.compiled import njit, part
from .shape import COUNTER, Shape, row_type

_OPENING = int(Fate.OPENING)
_COUNTED = int(Fate.COUNTED)
_DUPLICATE = int(Fate.DUPLICATE)
_MASKED = int(Fate.MASKED)
_GATED = int(Fate.GATED)
_BLIND = int(Fate.BLIND)
# A sort key has the fields pulse, tick and pixel. These are the lowest bits of the first two.
_PULSE_LSB = 23
_TICK_LSB = 8
_TICK_MASK = (1 << _PULSE_LSB - _TICK_LSB) - 1
_PIXEL_MASK = (1 << _TICK_LSB) - 1
_WORD_BITS = (BEAT_BITS - 1).bit_length()  # bits of a pixel's number inside a word of the ID map
_NEVER = -1  # before all cycles
_EVENT = row_type(
    "cycle",  # of the commit
    "pulse",
    "stamp",
    "count",
    "winner",
    "stored",  # set by the readout, as are the following
    "overrun",
    "free_at",
)
_RECORD = row_type("cycle", "pulse")

_armed_cycle = part(armed_cycle)


class Settings(NamedTuple):
    """Settings of the subgroups, as the frame uses them; by subgroup."""

    threshold: np.ndarray  # 1 if coincidence is off
    window: np.ndarray  # ticks, 1 if coincidence is off
    # [subgroups, phases]: cycles from a window's first edge, by its phase, to the window's last
    # tick
    close: np.ndarray
    mask: np.ndarray  # bool[subgroups, pixels]
    gating: np.ndarray  # bool
    gate_start: np.ndarray  # cycles
    gate_len: np.ndarray  # cycles


class Timeline(NamedTuple):
    """Times by pulse, in cycles."""

    start: np.ndarray  # first cycle of its period
    gate_shift: np.ndarray  # what progressive gating adds to a gate's start


class Rules(NamedTuple):
    """What the front end follows in a frame."""

    shape: Shape
    settings: Settings
    timeline: Timeline
    pixel: Pixels


class Events(NamedTuple):
    """Events by subgroup, then time. Rows from bounds[-1] on are unused."""

    bounds: np.ndarray  # int64[subgroups + 1], rows of each subgroup
    row: np.ndarray  # _EVENT[n]
    hits: np.ndarray  # uint64[n, words], ID maps
    offsets: np.ndarray  # uint8[n, minigroups]


class Records(NamedTuple):
    """Minigroup records by subgroup, then time. Rows from bounds[-1] on are unused."""

    bounds: np.ndarray  # int64[subgroups + 1], rows of each subgroup
    row: np.ndarray  # _RECORD[n]
    entries: np.ndarray  # uint64[n, minigroups]


class _Made(NamedTuple):
    """What the front end makes."""

    fate: np.ndarray  # uint8 per edge
    events: Events
    records: Records
    counters: np.ndarray  # int64[subgroups, counters]


class _Collection(NamedTuple):
    """What the minigroups of a subgroup have collected; by minigroup."""

    hits: np.ndarray  # uint64, the map; 0: none
    stamp: np.ndarray  # int64, coarse
    end: np.ndarray  # int64, first cycle after the collection


class _Workspace(NamedTuple):
    """Arrays for one subgroup after the other, int64."""

    seen_at: np.ndarray  # [pixels], cycle of each pixel's last edge, as of `cycle_of`
    accepted: np.ndarray  # [edges], indices of the edges that the tree sees
    # [edges, 2], indices in `accepted`: a window's first edge, and the first edge after it
    windows: np.ndarray
    collected: _Collection


class _Own(NamedTuple):
    """A subgroup and its edges in the order of time."""

    s: int
    key: np.ndarray  # int64, sort keys
    fate: np.ndarray  # uint8


def time_order(
    edges: Edges, pixel: Pixels, shape: Shape
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the sort keys (pulse, tick, pixel), the edges' order by subgroup and time, and its
    bounds.

    A stable counting sort by subgroup preserves the order of time, which edges mostly have
    already. Subgroups for which this is not so are sorted.
    """
    key = np.empty(len(edges), np.int64)
    order = np.empty(len(edges), np.int64)
    # equivalent (1: one more): a bound that nobody reads
    bounds = np.zeros(shape.subgroups + 1, np.int64)
    _count(edges.pixel, pixel, bounds)
    following = bounds[:-1].copy()
    last = np.full(shape.subgroups, _NEVER, np.int64)
    if not _sort(edges.pulse, edges.pixel, edges.tick, pixel, following, last, key, order):
        for s in range(shape.subgroups):
            own = slice(bounds[s], bounds[s + 1])
            by_time = np.argsort(key[own], kind="stable")
            key[own] = key[own][by_time]
            order[own] = order[own][by_time]
    return key, order, bounds


@njit(allocates=False)
def _count(pixel: np.ndarray, table: Pixels, bounds: np.ndarray) -> None:
    """Set `bounds` to where the edges of each subgroup begin and end, if they stand by subgroup.
    bounds: all 0.
    """
    for e in range(len(pixel)):
        bounds[table.subgroup[pixel[e]] + 1] += 1
    for s in range(1, len(bounds)):
        bounds[s] += bounds[s - 1]


@njit(allocates=False)
def _sort(
    pulse: np.ndarray,
    pixel: np.ndarray,
    tick: np.ndarray,
    table: Pixels,
    following: np.ndarray,
    last: np.ndarray,
    key: np.ndarray,
    order: np.ndarray,
) -> bool:
    """Write keys and order of the edges, by subgroup; return whether the edges of each subgroup
    ascend in time.

    following: int64[subgroups], row of the next edge; last: the same, key of the last one.
    """
    in_time = True
    for e in range(len(pixel)):
        s = table.subgroup[pixel[e]]
        own = pulse[e] << _PULSE_LSB | tick[e] << _TICK_LSB | table.inside[pixel[e]]
        key[following[s]] = own
        order[following[s]] = e
        following[s] += 1
        in_time &= own >= last[s]
        last[s] = own
    return in_time


def front_end(
    key: np.ndarray, bounds: np.ndarray, rules: Rules, counters: np.ndarray
) -> tuple[np.ndarray, Events, Records]:
    """Return fates in the order of time, events and minigroup records of all subgroups; add to
    `counters`.
    """
    shape = rules.shape
    made = _Made(
        fate=np.empty(len(key), np.uint8),
        events=room_for_events(len(key), shape, shape.subgroups),
        records=room_for_records(
            len(key) if shape.minigroup_records else 0, shape, shape.subgroups
        ),
        counters=counters,
    )
    most = int(np.diff(bounds).max())  # edges of a subgroup
    work = _Workspace(
        seen_at=np.empty(shape.pixels, np.int64),
        accepted=np.empty(most, np.int64),
        windows=np.empty((most, 2), np.int64),
        collected=_Collection(
            hits=np.zeros(shape.minigroups, np.uint64),
            stamp=np.zeros(shape.minigroups, np.int64),
            end=np.zeros(shape.minigroups, np.int64),
        ),
    )
    _every_subgroup(key, bounds, rules, work, made)
    return made.fate, made.events, made.records


def room_for_events(most: int, shape: Shape, subgroups: int) -> Events:
    """Return room for so many events of so many subgroups, and none in it yet."""
    return Events(
        bounds=np.zeros(subgroups + 1, np.int64),
        row=np.empty(most, _EVENT),
        hits=np.empty((most, shape.hits_words), np.uint64),
        offsets=np.empty((most, shape.minigroups), np.uint8),
    )


def room_for_records(most: int, shape: Shape, subgroups: int) -> Records:
    """Return room for so many records of so many subgroups, and none in it yet."""
    return Records(
        bounds=np.zeros(subgroups + 1, np.int64),
        row=np.empty(most, _RECORD),
        entries=np.empty((most, shape.minigroups), np.uint64),
    )


@njit(allocates=False)
def _every_subgroup(
    key: np.ndarray, bounds: np.ndarray, rules: Rules, work: _Workspace, made: _Made
) -> None:
    """Take the edges of each subgroup through all stages."""
    for s in range(rules.shape.subgroups):
        rows = slice(bounds[s], bounds[s + 1])
        own = _Own(s, key[rows], made.fate[rows])
        passed = work.accepted[: _accept(own, rules, work)]
        opened = work.windows[: _open_windows(own, passed, rules, work.windows, made.counters)]
        _commit(own, passed, opened, rules, made.events, made.counters)
        if rules.shape.minigroup_records:
            _collect_records(own, passed, rules, work.collected, made.records)


@part
def fields_of(key: int) -> tuple[int, int, int]:
    """Return pulse, tick and pixel inside the subgroup."""
    return key >> _PULSE_LSB, key >> _TICK_LSB & _TICK_MASK, key & _PIXEL_MASK


@part
def cycle_of(key: int, phase_bits: int) -> int:
    """Return pulse and cycle as one number, which no other cycle of the frame has."""
    return key >> _TICK_LSB + phase_bits


@part
def _accept(own: _Own, rules: Rules, work: _Workspace) -> int:
    """Set the fates of edges that go no further; write the indices of the others to
    `work.accepted`, return their number.
    """
    shape = rules.shape
    settings = rules.settings
    seen_at = work.seen_at
    for i in range(len(seen_at)):
        seen_at[i] = _NEVER
    n = 0
    for e in range(len(own.key)):
        at = cycle_of(own.key[e], shape.phase_bits)
        inside = own.key[e] & _PIXEL_MASK
        if seen_at[inside] == at:  # a second edge of a pixel in one cycle does not exist
            own.fate[e] = _DUPLICATE
        elif not settings.mask[own.s, inside]:
            own.fate[e] = _MASKED
        elif settings.gating[own.s] and not _in_gate(
            own.s, own.key[e], shape, settings, rules.timeline
        ):
            own.fate[e] = _GATED
        else:
            work.accepted[n] = e
            n += 1
        seen_at[inside] = at
    return n


@part
def _in_gate(s: int, key: int, shape: Shape, settings: Settings, timeline: Timeline) -> bool:
    """Return whether an edge is inside the gate of subgroup `s`."""
    pulse, tick, _ = fields_of(key)
    cycle = tick >> shape.phase_bits
    gate_start = settings.gate_start[s] + timeline.gate_shift[pulse]
    return gate_start <= cycle < gate_start + settings.gate_len[s]


@part
def _open_windows(
    own: _Own, accepted: np.ndarray, rules: Rules, windows: np.ndarray, counters: np.ndarray
) -> int:
    """The tree: set the fates of `accepted` edges by their times, write the windows to
    `windows`, return their number.
    """
    shape = rules.shape
    window = rules.settings.window[own.s]
    close = rules.settings.close[own.s]
    last_pulse = _NEVER
    blind_at = _NEVER
    # equivalent (0: one more): the first edge of the first pulse sets it
    armed_from = 0
    n = 0
    k = 0
    while k < len(accepted):
        pulse, opening, _ = fields_of(own.key[accepted[k]])
        if pulse != last_pulse:
            last_pulse = pulse
            armed_from = 0
        cycle = opening >> shape.phase_bits
        if not armed_from <= cycle < shape.open_cycles:
            own.fate[accepted[k]] = _BLIND
            at = cycle_of(own.key[accepted[k]], shape.phase_bits)
            counters[own.s, COUNTER.blind] += at != blind_at  # cycles, not edges
            blind_at = at
            k += 1
            continue
        armed_from = _armed_cycle(cycle + close[opening & shape.phases - 1], shape.rearm)
        own.fate[accepted[k]] = _OPENING
        windows[n, 0] = k
        k += 1
        while k < len(accepted):
            edge_pulse, tick, _ = fields_of(own.key[accepted[k]])
            if edge_pulse != pulse or tick >= opening + window:
                break
            own.fate[accepted[k]] = _COUNTED
            k += 1
        windows[n, 1] = k
        n += 1
    counters[own.s, COUNTER.opened] += n
    return n


@part
def _commit(
    own: _Own,
    accepted: np.ndarray,
    windows: np.ndarray,
    rules: Rules,
    events: Events,
    counters: np.ndarray,
) -> None:
    """Count the distinct pixels of the windows; windows that meet the threshold become events."""
    shape = rules.shape
    threshold = rules.settings.threshold[own.s]
    close = rules.settings.close[own.s]
    minigroup = rules.pixel.minigroup
    row = events.bounds[own.s]  # the next one
    hits = events.hits
    offsets = events.offsets
    photons = 0
    lower = 0
    rejected = 0
    for k in range(len(windows)):
        first = windows[k, 0]
        stop = windows[k, 1]
        if stop - first == 1 < threshold:  # a single photon, as most windows have in sunlight
            photons += 1
            lower += threshold == 2
            rejected += 1
            continue
        _clear(hits[row], offsets[row])
        pulse, opening, winner = fields_of(own.key[accepted[first]])
        cycle = opening >> shape.phase_bits
        cycle_start = cycle << shape.phase_bits
        count = 0
        for n in range(first, stop):
            e = accepted[n]
            _, tick, inside = fields_of(own.key[e])
            word = inside >> _WORD_BITS
            bit = np.uint64(1) << np.uint64(inside & BEAT_BITS - 1)
            if hits[row, word] & bit:
                own.fate[e] = _DUPLICATE
                continue
            hits[row, word] |= bit
            count += 1
            if offsets[row, minigroup[inside]] == OFFSET_NONE:
                offsets[row, minigroup[inside]] = (tick - cycle_start) >> shape.offset_tick_bits
        photons += count
        lower += count >= threshold - 1
        if count < threshold:
            rejected += 1
            continue
        event = events.row[row]
        event.cycle = (
            rules.timeline.start[pulse] + cycle + close[opening - cycle_start] + latency.COMMIT
        )
        event.pulse = pulse
        event.stamp = opening
        event.count = count
        event.winner = winner
        row += 1
    counters[own.s, COUNTER.photons] += photons
    counters[own.s, COUNTER.lower] += lower
    counters[own.s, COUNTER.rejected] += rejected
    counters[own.s, COUNTER.committed] += row - events.bounds[own.s]
    events.bounds[own.s + 1] = row


@part
def _clear(hits: np.ndarray, offsets: np.ndarray) -> None:
    """Empty the map and the offsets of an event."""
    for k in range(len(hits)):
        hits[k] = 0
    for k in range(len(offsets)):
        offsets[k] = OFFSET_NONE


@part
def _collect_records(
    own: _Own, accepted: np.ndarray, rules: Rules, collected: _Collection, records: Records
) -> None:
    """The minigroups: make a record for each period in which any of them latched."""
    shape = rules.shape
    pixel = rules.pixel
    row = records.bounds[own.s]
    for k in range(len(accepted)):
        pulse, tick, inside = fields_of(own.key[accepted[k]])
        _add(
            collected,
            pixel.minigroup[inside],
            np.uint64(1) << np.uint64(pixel.bit[inside]),
            tick,
            shape,
        )
        period_ends = k + 1 == len(accepted) or own.key[accepted[k + 1]] >> _PULSE_LSB != pulse
        if period_ends and _latch(collected, records.entries[row], shape):
            record = records.row[row]
            record.cycle = rules.timeline.start[pulse] + shape.period + latency.RECORD
            record.pulse = pulse
            row += 1
    records.bounds[own.s + 1] = row


@part
def _add(collected: _Collection, g: int, bit: np.uint64, tick: int, shape: Shape) -> None:
    """Add an edge to the collection of minigroup `g`, or begin a collection with it."""
    cycle = tick >> shape.phase_bits
    if collected.hits[g] and cycle >= collected.end[g]:
        if _enough(collected.hits[g], shape.mg_threshold):
            return  # the record of the period is complete
        collected.hits[g] = 0
    if not collected.hits[g]:
        if cycle >= shape.open_cycles:
            return
        collected.stamp[g] = tick >> shape.quarter_bits
        collected.end[g] = cycle + shape.mg_window
    collected.hits[g] |= bit


@part
def _latch(collected: _Collection, entries: np.ndarray, shape: Shape) -> bool:
    """Empty the collections into a record's entries; return whether any met the threshold."""
    latched = False
    for g in range(shape.minigroups):
        entries[g] = 0
        if _enough(collected.hits[g], shape.mg_threshold):
            stamp = np.uint64(collected.stamp[g])
            entries[g] = collected.hits[g] << np.uint64(shape.record_stamp_bits) | stamp
            latched = True
        collected.hits[g] = 0
    return latched


@part
def _enough(hits: np.uint64, threshold: int) -> bool:
    """Return whether a map holds at least `threshold` pixels (an empty one never does)."""
    count = 0
    while hits:
        hits &= hits - np.uint64(1)
        count += 1
    return count >= threshold
