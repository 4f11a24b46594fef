# SPDX-License-Identifier: Apache-2.0
"""Decoder of the groups in a stream (`groups.py`): from their beats to the columns of events.

It reports what is damaged.
"""

from typing import Any, NamedTuple

import numpy as np

from ..shared.compiled import njit, part
from . import groups
from .packet import BEAT_BITS, GROUP_KIND, HEADER, KIND_LSB
from .parameters import OFFSET_NONE, Sensor
from .pixels import pixel_table

_ALL = np.uint64(0xFFFF_FFFF_FFFF_FFFF)
_CHECK_MASK = np.uint64((1 << groups.CHECK_BITS) - 1)
_COLUMNS = tuple(HEADER)
_OVERRUN = _COLUMNS.index("overrun")
_SUBGROUP = _COLUMNS.index("subgroup")
_PULSE = _COLUMNS.index("pulse")
_COUNT = _COLUMNS.index("count")
_WINNER = _COLUMNS.index("winner")
_STAMP = _COLUMNS.index("stamp")
_KIND = _COLUMNS.index("kind")
_NUMBERS = 1 << groups.HEAD.number


class _Widths(NamedTuple):
    """Widths in bits of the fields of a sensor's events."""

    subgroup: int
    winner: int
    pixels: int  # of a map
    offset: int


class Ungrouped(NamedTuple):
    """What the groups of a frame hold."""

    events: np.ndarray  # int64[n, columns], in the order of `HEADER`
    hits: np.ndarray  # uint64[n, words], maps
    offsets: np.ndarray  # uint8[n, minigroups]
    damaged: np.ndarray  # int64[m], beats at which something is missing or wrong


class _Head(NamedTuple):
    """What the head of a group says."""

    pulse: int
    stamp_bits: int
    with_offsets: int


def _check_table() -> np.ndarray:
    """uint64[256]: what the check of a group does with the next byte."""
    table = np.arange(256)
    for _ in range(8):
        table = table >> 1 ^ (table & 1) * groups.CHECK_POLYNOMIAL
    return table.astype(np.uint64)


CHECK_TABLE = _check_table()


@part(inlined=False)
def check_of(beats: np.ndarray) -> np.uint64:
    """Return the check of a group, from all its beats; the check in its last beat counts as 0."""
    check = _CHECK_MASK
    for k in range(len(beats)):
        beat = beats[k]
        if k == len(beats) - 1:
            beat &= ~(_CHECK_MASK << np.uint64(groups.CHECK_LSB))
        for byte in range(8):
            index = (check ^ beat >> np.uint64(8 * byte)) & np.uint64(255)
            check = CHECK_TABLE[index] ^ (check >> np.uint64(8))
    return check ^ _CHECK_MASK


def ungroup(beats: np.ndarray, at: np.ndarray, sensor: Sensor) -> Ungrouped:
    """Decode the groups of a frame.

    at: int64[k], ascending: the beats of groups, and others that stand where no other packet can.

    A group is good if its beats follow each other, the first and the last one are marked, and the
    check fits. All others are left out. A reader may begin anywhere: what lies before the first
    mark is damaged.
    """
    group = groups.group_widths(sensor)
    widths = _Widths(group.subgroup_bits, sensor.winner_bits, sensor.pixels, sensor.offset_bits)
    spans, damaged = _spans(beats, at)
    payload_bits = int((spans[:, 1] - spans[:, 0]).sum()) * groups.PAYLOAD_BITS
    most = payload_bits // (group.fixed_bits + sensor.winner_bits)
    rows = Ungrouped(
        events=np.zeros((len(HEADER), most), np.int64).T,  # so that a column is one piece
        hits=np.zeros((most, -(-sensor.pixels // BEAT_BITS)), np.uint64),
        offsets=np.full((most, sensor.minigroups), OFFSET_NONE, np.uint8),
        damaged=damaged,
    )
    minigroup = pixel_table(sensor).minigroup
    n = 0
    for first, end in spans:
        n = _events(beats[first:end], widths, minigroup, rows, n)
    return Ungrouped(rows.events[:n], rows.hits[:n], rows.offsets[:n], damaged)


@njit
def _spans(beats: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return first beat and end of every good group, int64[n, 2], and the damaged beats.

    Of two equal groups in a row, the second one is a copy. A gap in the numbers means that groups
    are missing, unless a damaged one lies in between.
    """
    spans = np.empty((len(at), 2), np.int64)
    damaged = np.empty(2 * len(at), np.int64)
    n = 0
    n_damaged = 0
    first = np.int64(-1)  # of the group that has begun
    end = np.int64(-1)  # of its beats so far
    orphan = False  # was the last beat one outside a group?
    missed = False  # was something damaged since the last good group?
    number = np.int64(-1)  # of the last good group
    for i in at:
        beat = beats[i]
        of_group = np.int64(beat >> np.uint64(KIND_LSB)) == GROUP_KIND
        begins = of_group and np.bool_(beat >> np.uint64(groups.FIRST_LSB) & np.uint64(1))
        if first >= 0 and (begins or not of_group or i != end):  # it has no end
            damaged[n_damaged] = first
            n_damaged += 1
            first = np.int64(-1)
            missed = True
        if begins:
            first = i
            orphan = False
        elif first < 0:
            if not orphan:
                damaged[n_damaged] = i
                n_damaged += 1
                missed = True
            orphan = True
            continue
        end = np.int64(i + 1)
        if not beat >> np.uint64(groups.LAST_LSB) & np.uint64(1):
            continue
        check = beats[i] >> np.uint64(groups.CHECK_LSB) & _CHECK_MASK
        shown = np.int64(beats[first] >> np.uint64(groups.HEAD.pulse)) & (_NUMBERS - 1)
        good = check == check_of(beats[first:end])
        copy = good and shown == number
        gap = good and not copy and not missed and shown != (number + 1) % _NUMBERS
        if not good or copy or gap:
            damaged[n_damaged] = first
            n_damaged += 1
        if not good:
            missed = True
        elif not copy:
            spans[n, 0] = first
            spans[n, 1] = end
            n += 1
            number = shown
            missed = False
        first = np.int64(-1)
    if first >= 0:
        damaged[n_damaged] = first
        n_damaged += 1
    return spans[:n].copy(), damaged[:n_damaged].copy()


@part(inlined=False)
def _read(beats: np.ndarray, bit: int, width: int) -> Any:
    """Return `width` bits, at most 32, of the string of a group's payloads; behind it are zeros."""
    value = np.uint64(0)
    taken = 0
    while taken < width:
        beat = (bit + taken) // groups.PAYLOAD_BITS
        lsb = (bit + taken) % groups.PAYLOAD_BITS
        room = min(groups.PAYLOAD_BITS - lsb, width - taken)
        if beat < len(beats):
            part = beats[beat] >> np.uint64(lsb) & _ALL >> np.uint64(BEAT_BITS - room)
            value |= part << np.uint64(taken)
        taken += room
    return np.int64(value)


@njit
def _events(
    beats: np.ndarray, widths: _Widths, minigroup: np.ndarray, rows: Ungrouped, n: int
) -> int:
    """Decode the events of a group into the rows from `n` on, and return the next row."""
    end = len(beats) * groups.PAYLOAD_BITS - groups.CHECK_BITS
    number_bit = groups.HEAD.pulse + groups.HEAD.number
    offsets_bit = groups.HEAD_BITS - groups.HEAD.with_offsets
    head = _Head(
        pulse=_read(beats, 0, groups.HEAD.pulse),
        stamp_bits=_read(beats, number_bit, groups.HEAD.stamp_bits),
        with_offsets=_read(beats, offsets_bit, groups.HEAD.with_offsets),
    )
    hit = np.zeros(len(minigroup), np.bool_)  # by pixel
    in_hit = np.zeros(len(minigroup), np.bool_)  # by minigroup: has it a pixel that was hit?
    pulse = head.pulse
    bit = groups.HEAD_BITS
    while bit + groups.LISTED_BITS <= end:
        listed = _read(beats, bit, groups.LISTED_BITS)
        if listed == 0:
            break
        bit += groups.LISTED_BITS
        row = rows.events[n]
        row[_KIND] = GROUP_KIND
        bit, pulse = _numbers(beats, bit, head, widths, pulse, row)
        bit = _pixels(beats, bit, listed, widths, hit)
        row[_COUNT] = _note_hits(hit, minigroup, in_hit, rows.hits[n])
        if head.with_offsets:
            bit = _offsets(beats, bit, widths, in_hit, rows.offsets[n])
        n += 1
    return n


@part
def _numbers(
    beats: np.ndarray, bit: int, head: _Head, widths: _Widths, pulse: int, row: np.ndarray
) -> tuple[int, int]:
    """Read the numbers of an event from `bit` on; return the bit behind the stamp, and the pulse.

    pulse: of the event before, which is also that of this one if no age is told.
    """
    row[_OVERRUN] = _read(beats, bit, 1)
    bit += 1
    row[_SUBGROUP] = _read(beats, bit, widths.subgroup)
    bit += widths.subgroup
    same_pulse = _read(beats, bit, 1)
    bit += 1
    if not same_pulse:
        pulse = head.pulse - _read(beats, bit, groups.AGE_BITS)
        bit += groups.AGE_BITS
    row[_PULSE] = pulse
    row[_STAMP] = _read(beats, bit, head.stamp_bits)
    bit += head.stamp_bits
    row[_WINNER] = _read(beats, bit, widths.winner)
    return bit, pulse


@part
def _pixels(beats: np.ndarray, bit: int, listed: int, widths: _Widths, hit: np.ndarray) -> int:
    """Read the pixels of an event, from its winner on, into `hit`; return the bit behind them."""
    hit[:] = False
    if listed == groups.MAPPED:
        bit += widths.winner
        for pixel in range(widths.pixels):
            hit[pixel] = _read(beats, bit + pixel, 1) != 0
        return bit + widths.pixels
    for _ in range(listed):
        hit[_read(beats, bit, widths.winner) % widths.pixels] = True
        bit += widths.winner
    return bit


@part
def _note_hits(
    hit: np.ndarray, minigroup: np.ndarray, in_hit: np.ndarray, words: np.ndarray
) -> int:
    """Write the map of an event and the minigroups that were hit; return the number of pixels."""
    number = 0
    in_hit[:] = False
    for i in range(len(hit)):
        if hit[i]:
            in_hit[minigroup[i]] = True
            words[i // BEAT_BITS] |= np.uint64(1) << np.uint64(i % BEAT_BITS)
            number += 1
    return number


@part(allocates=True)
def _offsets(
    beats: np.ndarray, bit: int, widths: _Widths, in_hit: np.ndarray, offsets: np.ndarray
) -> int:
    """Read the offsets of the minigroups that were hit; return the bit behind them.

    Their order is the lowest, the highest, and on to the middle.
    """
    found = np.flatnonzero(in_hit)
    low = 0
    high = len(found) - 1
    while low <= high:
        offsets[found[low]] = _read(beats, bit, widths.offset)
        bit += widths.offset
        if low < high:
            offsets[found[high]] = _read(beats, bit, widths.offset)
            bit += widths.offset
        low += 1
        high -= 1
    return bit
