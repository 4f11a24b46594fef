# SPDX-License-Identifier: Apache-2.0
"""Packer of the golden model: packs the events of a stream into groups, cycle by cycle.

It stands behind the stream's output buffer.
It takes one beat of an event per cycle, then forms its parts, one per cycle, while it already takes
the next event. A part is packed one cycle after it was formed, unless a beat of the group waits for
the receiver.
"""

from typing import Any, NamedTuple

import numpy as np

from ..contract import groups
from ..contract.packet import BEAT_BITS, GROUP_KIND, KIND_LSB
from ..contract.parameters import OFFSET_NONE
from ..contract.ungroup import check_of
from ..shared.arrays import keep_only, longer
from ..shared.compiled import part
from .receiver import Receiver, taken_from
from .shape import Shape, row_type

_KIND = np.uint64(GROUP_KIND << KIND_LSB)
_FIRST = np.uint64(1 << groups.FIRST_LSB)
_LAST = np.uint64(1 << groups.LAST_LSB)
_HALF = BEAT_BITS // 2  # words are put down in halves, which a signed number holds
_HALF_MASK = np.uint64((1 << _HALF) - 1)
_NONE = -1

# State of the packer.
_STATE = row_type(
    "begins",  # first beat of the open group, or _NONE
    "beat",  # that is being filled
    "filled",  # bits in it
    "pulse",  # of the open group
    "age",  # of its last event
    "number",  # of groups before it
    "taken",  # cycle in which the last event went to work
    "formed",  # cycle in which the last part was formed
    "packed",  # cycle in which it was packed or its group ended
    "form_from",  # earliest cycle in which the next part is formed
    "pack_from",  # earliest cycle in which it is packed
    "beat_from",  # earliest cycle in which the next beat leaves
)


class Packed(NamedTuple):
    """What the packer writes to."""

    beats: np.ndarray  # uint64[n]
    sent_at: np.ndarray  # int64[n], cycles of their transfer
    listed: np.ndarray  # int64[pixels], scratch
    receiver: Receiver  # of the beats


def new_packer() -> np.ndarray:
    """_STATE[1]: the packer at the beginning of a frame."""
    # equivalent: a row that nobody reads
    state = np.zeros(1, _STATE)
    state["begins"] = _NONE
    # equivalent (1: one more): any negative number says that nothing was formed
    state["formed"] = -1
    return state


def room_for_groups(shape: Shape, receiver: Receiver) -> Packed:
    """Return room for no group yet (`more_room`)."""
    return Packed(
        beats=np.empty(0, np.uint64),
        sent_at=np.empty(0, np.int64),
        listed=np.empty(shape.pixels, np.int64),
        receiver=receiver,
    )


def more_room(packer: np.void, room: Packed, beats: int, shape: Shape) -> Packed:
    """Return room for the groups of so many more beats, with the content of `room`.

    A group of one event takes at most two beats more than the event: one for its head and check,
    one that they fill in part.
    """
    if not shape.grouped:
        return room
    # equivalent (one more): room for more beats
    most = int(packer["beat"]) + 1 + 3 * beats
    if most <= len(room.beats):
        return room
    most = max(most, 2 * len(room.beats))
    return room._replace(beats=longer(room.beats, most), sent_at=longer(room.sent_at, most))


def take_groups(packer: np.void, room: Packed) -> tuple[np.ndarray, np.ndarray]:
    """Take the beats of all groups that have ended out of `room`; return them, and the cycles of
    their transfer.
    """
    beat = int(packer["beat"])
    begins = int(packer["begins"])
    done = beat if begins == _NONE else begins
    beats = room.beats[:done].copy()
    sent_at = room.sent_at[:done].copy()
    filling = beat + 1 - done  # beats of the open group, with the one that is being filled
    keep_only(room.beats, done, filling)
    room.beats[filling : beat + 1] = 0
    keep_only(room.sent_at, done, filling)
    packer["beat"] = beat - done
    if begins != _NONE:
        packer["begins"] = 0
    return beats, sent_at


@part
def pack_event(
    packer: Any,
    out: Packed,
    event: np.record,
    subgroup: int,
    hits: np.ndarray,
    offsets: np.ndarray,
    read_at: int,
    shape: Shape,
) -> None:
    """Pack an event whose last beat was read in the cycle `read_at`.

    The next one is read from cycle `taken` on.
    """
    packer.taken = max(read_at + 1, packer.formed)
    packer.form_from = packer.taken + 1
    if packer.begins >= 0 and not 0 <= packer.pulse - event.pulse <= groups.AGE_MAX:
        close_group(packer, out, packer.form_from)
    if packer.begins < 0:
        _open_group(packer, out, event.pulse, shape)
    begin = packer.beat * groups.PAYLOAD_BITS + packer.filled
    bit = _put_numbers(packer, out, begin, event, subgroup, shape)
    if event.count > shape.listed_max:
        bit = _pack_map(packer, out, begin, bit, hits, shape)
    else:
        bit = _pack_list(packer, out, begin, bit, event.winner, hits, shape)
    if shape.event_has_offsets:
        _pack_offsets(packer, out, bit, offsets, shape)


@part
def _put_numbers(
    packer: Any, out: Packed, bit: int, event: np.record, subgroup: int, shape: Shape
) -> int:
    """Write the numbers of an event, from `bit` on; return the bit behind them."""
    listed = event.count
    if event.count > shape.listed_max:
        listed = groups.MAPPED
    age = packer.pulse - event.pulse
    bit = _put(out.beats, bit, listed, groups.LISTED_BITS)
    bit = _put(out.beats, bit, event.overrun, 1)
    bit = _put(out.beats, bit, subgroup, shape.subgroup_bits)
    bit = _put(out.beats, bit, np.int64(age == packer.age), 1)
    if age != packer.age:
        bit = _put(out.beats, bit, age, groups.AGE_BITS)
        packer.age = age
    bit = _put(out.beats, bit, event.stamp, shape.stamp_bits)
    return _put(out.beats, bit, event.winner, shape.winner_bits)


@part
def _pack_map(
    packer: Any, out: Packed, begin: int, bit: int, hits: np.ndarray, shape: Shape
) -> int:
    """Pack the numbers of an event, bits `begin` to `bit`, and its map.

    Return the bit behind it.
    """
    _part(packer, out, bit - begin)
    for first in range(0, shape.pixels, groups.MAP_PART_BITS):
        width = min(groups.MAP_PART_BITS, shape.pixels - first)
        for half in range(first, first + width, _HALF):
            word = hits[half // BEAT_BITS] >> np.uint64(half % BEAT_BITS) & _HALF_MASK
            bit = _put(out.beats, bit, np.int64(word), min(_HALF, first + width - half))
        _part(packer, out, width)
    return bit


@part
def _pack_list(
    packer: Any,
    out: Packed,
    begin: int,
    bit: int,
    winner: int,
    hits: np.ndarray,
    shape: Shape,
) -> int:
    """Pack the numbers of an event, bits `begin` to `bit`, and a list of its other pixels.

    Return the bit behind it.
    """
    others = _list_others(out.listed, winner, hits, shape.pixels)
    for k in range(others):
        # equivalent (k - groups.FIRST_PIXELS: Sub): the remainder of 2
        # equivalent (k - groups.FIRST_PIXELS + 1: Add): the remainder of 2
        if k >= groups.FIRST_PIXELS - 1 and (k - groups.FIRST_PIXELS + 1) % groups.PER_PART == 0:
            _part(packer, out, bit - begin)
            begin = bit
        pixel = out.listed[_from_both_ends(others, k)]
        bit = _put(out.beats, bit, pixel, shape.winner_bits)
    _part(packer, out, bit - begin)
    return bit


@part
def _list_others(listed: np.ndarray, winner: int, hits: np.ndarray, pixels: int) -> int:
    """Write the pixels of a map to `listed`, without the winner; return their number."""
    number = 0
    for pixel in range(pixels):
        bit = hits[pixel // BEAT_BITS] >> np.uint64(pixel % BEAT_BITS) & np.uint64(1)
        if bit and pixel != winner:
            listed[number] = pixel
            number += 1
    return number


@part
def _pack_offsets(packer: Any, out: Packed, bit: int, offsets: np.ndarray, shape: Shape) -> None:
    """Pack the offsets of the minigroups that were hit, from `bit` on."""
    hit = 0
    for minigroup in range(shape.minigroups):
        if offsets[minigroup] != OFFSET_NONE:
            out.listed[hit] = minigroup
            hit += 1
    begin = bit
    for k in range(hit):
        if k % groups.PER_PART == 0:
            begin = bit
        offset = np.int64(offsets[out.listed[_from_both_ends(hit, k)]])
        bit = _put(out.beats, bit, offset, shape.offset_bits)
        # equivalent (k + 1: Add): the remainder of 2
        if k + 1 == hit or (k + 1) % groups.PER_PART == 0:
            _part(packer, out, bit - begin)


@part
def _from_both_ends(number: int, k: int) -> int:
    """Return the k-th index of `number` in the order lowest, highest, second lowest, and so on."""
    return k // 2 if k % 2 == 0 else number - 1 - k // 2


@part
def _open_group(packer: Any, out: Packed, pulse: int, shape: Shape) -> None:
    """Begin a group in the next beat, and pack its head."""
    packer.begins = packer.beat
    packer.pulse = pulse
    packer.age = 0
    bit = packer.beat * groups.PAYLOAD_BITS
    bit = _put(out.beats, bit, pulse, groups.HEAD.pulse)
    bit = _put(out.beats, bit, packer.number % (1 << groups.HEAD.number), groups.HEAD.number)
    bit = _put(out.beats, bit, shape.stamp_bits, groups.HEAD.stamp_bits)
    _put(out.beats, bit, np.int64(shape.event_has_offsets), groups.HEAD.with_offsets)
    _part(packer, out, groups.HEAD_BITS)


@part
def close_group(packer: Any, out: Packed, cycle: int) -> None:
    """End the open group, if there is one.

    Its end is formed in `cycle` or, if a part waits there, later.
    """
    if packer.begins >= 0:
        packer.formed = max(cycle, packer.packed)
        packer.beat_from = max(packer.beat_from, packer.formed + 1)
    while packer.begins >= 0:
        last = packer.filled <= groups.CHECK_LSB
        if last:
            out.beats[packer.beat] |= _LAST
        packer.filled = groups.PAYLOAD_BITS
        _send(packer, out)
        if last:
            check = check_of(out.beats[packer.begins : packer.beat])
            out.beats[packer.beat - 1] |= check << np.uint64(groups.CHECK_LSB)
            packer.begins = _NONE
            packer.packed = packer.beat_from - 1
            packer.number += 1


@part
def _part(packer: Any, out: Packed, bits: int) -> None:
    """Form and pack a part of so many bits in the next possible cycles, and send the full beats."""
    packer.formed = max(packer.form_from, packer.packed)
    packer.packed = max(packer.formed + 1, packer.pack_from)
    packer.beat_from = max(packer.beat_from, packer.packed + 1)
    packer.filled += bits
    while packer.filled >= groups.PAYLOAD_BITS:
        packer.pack_from = _send(packer, out)


@part
def _send(packer: Any, out: Packed) -> int:
    """Send a beat as soon as the receiver takes it, and return that cycle.

    In that cycle, the next part can be packed.
    """
    cycle = taken_from(out.receiver, packer.beat_from)
    out.beats[packer.beat] |= _KIND
    if packer.beat == packer.begins:
        out.beats[packer.beat] |= _FIRST
    out.sent_at[packer.beat] = cycle
    packer.beat += 1
    packer.filled -= groups.PAYLOAD_BITS
    packer.beat_from = cycle + 1
    return cycle


@part
def _put(beats: np.ndarray, bit: int, value: Any, width: int) -> int:
    """Write `value`, of `width` bits, into the payloads of the beats, from `bit` on.

    Return the bit behind it.
    """
    while width > 0:
        beat = bit // groups.PAYLOAD_BITS
        lsb = bit % groups.PAYLOAD_BITS
        room = min(groups.PAYLOAD_BITS - lsb, width)
        beats[beat] |= np.uint64(value & ((1 << room) - 1)) << np.uint64(lsb)
        value >>= room
        bit += room
        width -= room
    return bit
