# SPDX-License-Identifier: Apache-2.0
"""Packer of the golden model: packs the events of a stream into groups behind its output buffer, cycle by cycle.

It takes one beat of an event per cycle, then forms its parts, one per cycle, while it already takes the next event. A part
is packed one cycle after it was formed, unless a beat of the group waits for the receiver.
"""

from collections import namedtuple

import numpy as np

from ..contract import groups
from ..contract.packet import BEAT_BITS, GROUP_KIND, KIND_LSB
from ..contract.parameters import OFFSET_NONE
from ..contract.ungroup import check_of
from ..shared.compiled import njit
from .shape import row_type

_KIND = np.uint64(GROUP_KIND << KIND_LSB)
_FIRST, _LAST = np.uint64(1 << groups.FIRST_LSB), np.uint64(1 << groups.LAST_LSB)
_HALF = BEAT_BITS // 2  # words are put down in halves, which a signed number holds
_HALF_MASK = np.uint64((1 << _HALF) - 1)

# begins: first beat of the open group, or -1. beat: the one that is being filled; filled: bits in it. pulse: of the open
# group; age: of its last event. number: of groups before it. taken: cycle in which the last event went to work. formed,
# packed: cycles in which the last part was formed, and in which it was packed or its group ended. form_from, pack_from,
# beat_from: earliest cycles in which the next part is formed and packed, and the next beat leaves.
_STATE = row_type("begins beat filled pulse age number taken formed packed form_from pack_from beat_from")

# What the packer writes to: its beats and the cycles of their transfer, and scratch of int64[pixels]. next_ready: when the
# receiver takes a beat.
_Out = namedtuple("_Out", "beats sent_at listed next_ready")


@njit
def new_packer(most, shape, next_ready):
    """Return the state of a packer at the beginning of a frame (one row), and room for the groups of `most` beats.

    A group of one event takes at most two beats more than the event: one for its head and check, one that they fill in part.
    """
    most = 3 * most if shape.grouped else 0
    state = np.zeros(1, _STATE)
    state[0].begins = state[0].formed = -1
    out = _Out(np.zeros(most, np.uint64), np.empty(most, np.int64), np.empty(shape.pixels, np.int64), next_ready)
    return state, out


@njit(allocates=False)
def pack_event(packer, out, event, subgroup, hits, offsets, read_at, shape):
    """Pack an event whose last beat was read in the cycle `read_at`; the next one is read from cycle `taken` on."""
    listed = out.listed
    packer.taken = max(read_at + 1, packer.formed)
    packer.form_from = packer.taken + 1
    if packer.begins >= 0 and not 0 <= packer.pulse - event.pulse <= groups.AGE_MAX:
        close_group(packer, out, packer.form_from)
    if packer.begins < 0:
        _open_group(packer, out, event.pulse, shape)
    bit = begin = packer.beat * groups.PAYLOAD_BITS + packer.filled
    mapped, age = event.count > shape.listed_max, packer.pulse - event.pulse
    bit = _put(out.beats, bit, groups.MAPPED if mapped else event.count, groups.LISTED_BITS)
    bit = _put(out.beats, bit, event.overrun, 1)
    bit = _put(out.beats, bit, subgroup, shape.subgroup_bits)
    bit = _put(out.beats, bit, age == packer.age, 1)
    if age != packer.age:
        bit = _put(out.beats, bit, age, groups.AGE_BITS)
        packer.age = age
    bit = _put(out.beats, bit, event.stamp, shape.stamp_bits)
    bit = _put(out.beats, bit, event.winner, shape.winner_bits)
    if mapped:
        _part(packer, out, bit - begin)
        for part in range(0, shape.pixels, groups.MAP_PART_BITS):
            width = min(groups.MAP_PART_BITS, shape.pixels - part)
            for half in range(part, part + width, _HALF):
                word = hits[half // BEAT_BITS] >> np.uint64(half % BEAT_BITS) & _HALF_MASK
                bit = _put(out.beats, bit, np.int64(word), min(_HALF, part + width - half))
            _part(packer, out, width)
    else:
        others = 0
        for pixel in range(shape.pixels):
            if pixel != event.winner and hits[pixel // BEAT_BITS] >> np.uint64(pixel % BEAT_BITS) & np.uint64(1):
                listed[others] = pixel
                others += 1
        for k in range(others):
            if k >= groups.FIRST_PIXELS - 1 and (k - groups.FIRST_PIXELS + 1) % groups.PER_PART == 0:
                _part(packer, out, bit - begin)
                begin = bit
            bit = _put(out.beats, bit, _from_both_ends(listed, others, k), shape.winner_bits)
        _part(packer, out, bit - begin)
    if shape.event_has_offsets:
        hit = 0
        for minigroup in range(shape.minigroups):
            if offsets[minigroup] != OFFSET_NONE:
                listed[hit] = minigroup
                hit += 1
        for k in range(hit):
            if k % groups.PER_PART == 0:
                begin = bit
            bit = _put(out.beats, bit, offsets[_from_both_ends(listed, hit, k)], shape.offset_bits)
            if k + 1 == hit or (k + 1) % groups.PER_PART == 0:
                _part(packer, out, bit - begin)


@njit(allocates=False)
def _from_both_ends(items, number, k):
    """Return the k-th of ascending items in the order lowest, highest, second lowest, and so on."""
    return items[k // 2 if k % 2 == 0 else number - 1 - k // 2]


@njit(allocates=False)
def _open_group(packer, out, pulse, shape):
    packer.begins, packer.pulse, packer.age = packer.beat, pulse, 0
    bit = packer.beat * groups.PAYLOAD_BITS
    bit = _put(out.beats, bit, pulse, groups.HEAD.pulse)
    bit = _put(out.beats, bit, packer.number % (1 << groups.HEAD.number), groups.HEAD.number)
    bit = _put(out.beats, bit, shape.stamp_bits, groups.HEAD.stamp_bits)
    _put(out.beats, bit, shape.event_has_offsets, groups.HEAD.with_offsets)
    _part(packer, out, groups.HEAD_BITS)


@njit(allocates=False)
def close_group(packer, out, cycle):
    """End the open group, if there is one; its end is formed in `cycle` or, if a part waits there, later."""
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
            group = out.beats[packer.begins : packer.beat]
            group[-1] |= check_of(group) << np.uint64(groups.CHECK_LSB)
            packer.begins, packer.packed = -1, packer.beat_from - 1
            packer.number += 1


@njit(allocates=False)
def _part(packer, out, bits):
    """Form and pack a part of so many bits in the next possible cycles, and send the beats that are full then."""
    packer.formed = max(packer.form_from, packer.packed)
    packer.packed = max(packer.formed + 1, packer.pack_from)
    packer.beat_from = max(packer.beat_from, packer.packed + 1)
    packer.filled += bits
    while packer.filled >= groups.PAYLOAD_BITS:
        packer.pack_from = _send(packer, out)


@njit(allocates=False)
def _send(packer, out):
    """Send a beat as soon as the receiver takes it, and return that cycle, in which the next part can be packed."""
    cycle = packer.beat_from
    if cycle < len(out.next_ready):
        cycle = out.next_ready[cycle]
    out.beats[packer.beat] |= _KIND | (_FIRST if packer.beat == packer.begins else np.uint64(0))
    out.sent_at[packer.beat] = cycle
    packer.beat += 1
    packer.filled -= groups.PAYLOAD_BITS
    packer.beat_from = cycle + 1
    return cycle


@njit(allocates=False)
def _put(beats, bit, value, width):
    """Write `value`, of `width` bits, into the payloads of the beats, from `bit` on; return the bit behind it."""
    while width > 0:
        beat, lsb = bit // groups.PAYLOAD_BITS, bit % groups.PAYLOAD_BITS
        room = min(groups.PAYLOAD_BITS - lsb, width)
        beats[beat] |= np.uint64(value & ((1 << room) - 1)) << np.uint64(lsb)
        value >>= room
        bit, width = bit + room, width - room
    return bit
