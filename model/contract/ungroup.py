# SPDX-License-Identifier: Apache-2.0
"""Decoder of the groups in a stream (`groups.py`): from their beats to the columns of events. It reports what is damaged."""

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
_OVERRUN, _SUBGROUP, _PULSE, _COUNT, _WINNER, _STAMP, _KIND = (
    _COLUMNS.index(name) for name in ("overrun", "subgroup", "pulse", "count", "winner", "stamp", "kind")
)
_NUMBERS = 1 << groups.HEAD.number


class _Widths(NamedTuple):
    """Sizes of a sensor, for kernels."""

    subgroup: int  # bits of its number
    winner: int  # bits of a pixel's number
    pixels: int  # of a subgroup
    offset: int  # bits of a minigroup's offset


_TABLE = np.arange(256)  # what the check of a group does with the next byte
for _ in range(8):
    _TABLE = _TABLE >> 1 ^ (_TABLE & 1) * groups.CHECK_POLYNOMIAL
CHECK_TABLE = _TABLE.astype(np.uint64)


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


def ungroup(beats: np.ndarray, at: np.ndarray, sensor: Sensor) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return events (columns in the order of `HEADER`), maps, offsets, and beats at which something is missing or wrong.

    at: int64[n], ascending: the beats of groups, and others that stand where no other packet can.

    A group is good if its beats follow each other, the first and the last one are marked, and the check fits. All others
    are left out. A reader may begin anywhere: what lies before the first mark is damaged.
    """
    widths = groups.group_widths(sensor)
    of_sensor = _Widths(widths.subgroup_bits, sensor.winner_bits, sensor.pixels, sensor.offset_bits)
    spans, damaged = _spans(beats, at)
    most = int((spans[:, 1] - spans[:, 0]).sum()) * groups.PAYLOAD_BITS // (widths.fixed_bits + sensor.winner_bits)
    events = np.zeros((most, len(HEADER)), np.int64)
    hits = np.zeros((most, -(-sensor.pixels // BEAT_BITS)), np.uint64)
    offsets = np.full((most, sensor.minigroups), OFFSET_NONE, np.uint8)
    n = 0
    for first, end in spans:
        n = _events(beats[first:end], of_sensor, pixel_table(sensor).minigroup, events, hits, offsets, n)
    return events[:n], hits[:n], offsets[:n], damaged


@njit
def _spans(beats: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return first beat and end of every good group, int64[n, 2], and the beats where something is missing or wrong.

    Of two equal groups in a row, the second one is a copy. A gap in the numbers means that groups are missing, unless a
    damaged one lies in between.
    """
    spans, damaged = np.empty((len(at), 2), np.int64), np.empty(2 * len(at), np.int64)
    n = n_damaged = 0
    first = end = np.int64(-1)  # of the group that has begun
    orphan = missed = False
    number = np.int64(-1)
    for i in at:
        beat = beats[i]
        of_group = np.int64(beat >> np.uint64(KIND_LSB)) == GROUP_KIND
        begins = of_group and np.bool_(beat >> np.uint64(groups.FIRST_LSB) & np.uint64(1))
        if first >= 0 and (begins or not of_group or i != end):
            damaged[n_damaged] = first
            n_damaged, first, missed = n_damaged + 1, np.int64(-1), True
        if begins:
            first, orphan = i, False
        elif first < 0:
            if not orphan:
                damaged[n_damaged] = i
                n_damaged, missed = n_damaged + 1, True
            orphan = True
            continue
        end = np.int64(i + 1)
        if not beat >> np.uint64(groups.LAST_LSB) & np.uint64(1):
            continue
        check = beats[i] >> np.uint64(groups.CHECK_LSB) & _CHECK_MASK
        if check != check_of(beats[first:end]):
            damaged[n_damaged] = first
            n_damaged, missed = n_damaged + 1, True
        else:
            shown = np.int64(beats[first] >> np.uint64(groups.HEAD.pulse)) & (_NUMBERS - 1)
            if shown == number:
                damaged[n_damaged] = first
                n_damaged += 1
            else:
                if shown != (number + 1) % _NUMBERS and not missed:
                    damaged[n_damaged] = first
                    n_damaged += 1
                spans[n, 0], spans[n, 1] = first, end
                n, number, missed = n + 1, shown, False
        first = np.int64(-1)
    if first >= 0:
        damaged[n_damaged] = first
        n_damaged += 1
    return spans[:n].copy(), damaged[:n_damaged].copy()


@part(inlined=False)
def _read(beats: np.ndarray, bit: int, width: int) -> Any:
    """Return `width` bits, at most 32, of the string of a group's payloads; what lies behind it is 0."""
    value, taken = np.uint64(0), 0
    while taken < width:
        beat, lsb = (bit + taken) // groups.PAYLOAD_BITS, (bit + taken) % groups.PAYLOAD_BITS
        room = min(groups.PAYLOAD_BITS - lsb, width - taken)
        if beat < len(beats):
            part = beats[beat] >> np.uint64(lsb) & _ALL >> np.uint64(BEAT_BITS - room)
            value |= part << np.uint64(taken)
        taken += room
    return np.int64(value)


@njit
def _events(
    beats: np.ndarray,
    widths: _Widths,
    minigroup: np.ndarray,
    events: np.ndarray,
    hits: np.ndarray,
    offsets: np.ndarray,
    n: int,
) -> int:
    """Decode the events of a group into the rows from `n` on, and return the next row."""
    end = len(beats) * groups.PAYLOAD_BITS - groups.CHECK_BITS
    group_pulse = _read(beats, 0, groups.HEAD.pulse)
    stamp_bits = _read(beats, groups.HEAD.pulse + groups.HEAD.number, groups.HEAD.stamp_bits)
    with_offsets = _read(beats, groups.HEAD_BITS - groups.HEAD.with_offsets, groups.HEAD.with_offsets)
    pulse, bit = group_pulse, groups.HEAD_BITS
    hit, in_hit = np.zeros(len(minigroup), np.bool_), np.zeros(len(minigroup), np.bool_)  # by pixel, by minigroup
    while bit + groups.LISTED_BITS <= end:
        listed = _read(beats, bit, groups.LISTED_BITS)
        if listed == 0:
            break
        bit += groups.LISTED_BITS
        row = events[n]
        row[_KIND], row[_OVERRUN] = GROUP_KIND, _read(beats, bit, 1)
        row[_SUBGROUP] = _read(beats, bit + 1, widths.subgroup)
        bit += 1 + widths.subgroup
        if not _read(beats, bit, 1):
            pulse = group_pulse - _read(beats, bit + 1, groups.AGE_BITS)
            bit += groups.AGE_BITS
        row[_PULSE], row[_STAMP] = pulse, _read(beats, bit + 1, stamp_bits)
        bit += 1 + stamp_bits
        row[_WINNER] = _read(beats, bit, widths.winner)
        hit[:] = False
        if listed == groups.MAPPED:
            bit += widths.winner
            for pixel in range(widths.pixels):
                hit[pixel] = _read(beats, bit + pixel, 1) != 0
            bit += widths.pixels
        else:
            for _ in range(listed):
                hit[_read(beats, bit, widths.winner) % widths.pixels] = True
                bit += widths.winner
        in_hit[:] = False
        for i in np.flatnonzero(hit):
            in_hit[minigroup[i]] = True
            hits[n, i // BEAT_BITS] |= np.uint64(1) << np.uint64(i % BEAT_BITS)
        row[_COUNT] = len(np.flatnonzero(hit))
        if with_offsets:
            found = np.flatnonzero(in_hit)
            low, high = 0, len(found) - 1
            while low <= high:  # the lowest, the highest, and on to the middle
                offsets[n, found[low]] = _read(beats, bit, widths.offset)
                bit += widths.offset
                if low < high:
                    offsets[n, found[high]] = _read(beats, bit, widths.offset)
                    bit += widths.offset
                low, high = low + 1, high - 1
        n += 1
    return n
