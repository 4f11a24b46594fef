# SPDX-License-Identifier: Apache-2.0
"""Proofs of coder and packer, which put events into groups.

Tests, not proofs, show that the check is the CRC-32 of its polynomial: each of its bits is one long parity.
"""

from amaranth.hdl import Cat, Const, Mux, Signal, Value

from ..hdl.coder import GROUPED, LONGEST, Coder, Phase, is_event_head, map_parts
from ..hdl.packer import Packer
from ..model.contract import groups
from ..model.contract.packet import (
    BEAT_BITS,
    FRAME_END,
    GROUP_KIND,
    KIND_LSB,
    OFFSETS,
    RECORD,
    layout,
    parts_of,
)
from ..model.contract.parameters import bits_for
from .proof_bench import Bench, proof
from .sensors import SMALL

PART_BITS = groups.group_widths(SMALL).part_bits


@proof(depth=3, cover=12)
def packer(b: Bench):
    """Every bit of every part leaves at its place; marks and zeros stand where they should; other beats pass; AXI4-Stream."""
    m, unit = b.m, b.place(Packer(SMALL))
    offer, part, bits, close = unit.offer, unit.part, unit.bits, unit.close
    passes, beat, last, begin, ready = (
        unit.passes,
        unit.beat,
        unit.last,
        unit.frame_begin,
        unit.m_axis.tready,
    )
    axis = unit.m_axis
    closed = b.same("closed", unit.final & ready)
    b.assume((bits <= PART_BITS) & (bits != 0) & (part >> bits == 0), where=offer)
    b.assume(~offer, where=close)
    b.assume(~passes & ~offer & ~close, where=begin)

    # The string of the group: bits that have not left. A part is offered until it is packed, and an end until it has left.
    held = b.same("held", unit.offset + Mux(unit.ready, groups.PAYLOAD_BITS, 0))
    is_open = Signal()
    b.assume(~passes, where=is_open | offer | close)
    b.assume(is_open, where=close)
    m.d.sync += is_open.eq((is_open | unit.packs) & ~closed & ~begin)
    waits = axis.tvalid & ~ready & ~begin
    b.assume_stable(Cat(passes, beat, last), where=b.last(passes & waits))
    b.assume(close, where=b.past(close & ~closed & ~begin))
    b.always(held == 0, where=~is_open)
    b.always(unit.packed >> held == 0)
    b.always(held < groups.PAYLOAD_BITS + PART_BITS)
    b.always(unit.ready | (unit.offset < groups.PAYLOAD_BITS))
    b.always(unit.crowded == (unit.offset >= groups.PAYLOAD_BITS))
    b.always(unit.room == (unit.offset <= groups.CHECK_LSB))

    # An arbitrary bit of an arbitrary part: it has so many bits before it, and leaves with them.
    place_in_part = b.constant(bits_for(PART_BITS - 1))
    b.assume(place_in_part < PART_BITS)
    leaves = b.same("leaves", axis.tvalid & ready & ~passes)
    watch = b.same("watch", b.anything(1) & unit.packs & (place_in_part < bits))
    watched, value, before = Signal(), Signal(), Signal(range(groups.PAYLOAD_BITS + PART_BITS))
    with m.If(watch & ~watched):
        m.d.sync += [
            watched.eq(1),
            value.eq(part.bit_select(place_in_part, 1)),
            before.eq(Mux(leaves, held - groups.PAYLOAD_BITS, held) + place_in_part),
        ]
    with m.Elif(watched & leaves):
        m.d.sync += [
            watched.eq(before >= groups.PAYLOAD_BITS),
            before.eq(before - groups.PAYLOAD_BITS),
        ]
    with m.If(begin):
        m.d.sync += watched.eq(0)
    b.always((before < held) & (unit.packed.bit_select(before, 1) == value), where=watched)
    shown = axis.tdata[: groups.PAYLOAD_BITS].bit_select(before[: bits_for(groups.PAYLOAD_BITS)], 1)
    b.always(shown == value, where=watched & leaves & (before < groups.PAYLOAD_BITS))
    b.always(~watched, where=closed & (before >= groups.CHECK_LSB))

    # Beats of the group: their marks; the last one holds nothing but the check above `CHECK_LSB`.
    first = Signal(init=1)
    m.d.sync += first.eq(Mux(begin | closed, 1, Mux(leaves, 0, first)))
    b.always(unit.begins == first)
    b.always(
        (axis.tdata[KIND_LSB:] == GROUP_KIND) & (axis.tdata[KIND_LSB - 1] == first) & ~axis.tlast,
        where=leaves,
    )
    b.always(axis.tdata[KIND_LSB - 2] == closed, where=leaves)
    b.always(close & ~unit.ready & (held <= groups.CHECK_LSB), where=closed)
    b.always((axis.tdata == beat) & (axis.tlast == last) & axis.tvalid, where=passes)

    # Nothing waits except for the receiver, and a beat that is offered stays.
    b.always(unit.free == (unit.packs | closed | (~offer & ~close)))
    b.always(unit.packs, where=offer & ~unit.crowded & (ready | ~unit.ready))
    b.always(axis.tvalid, where=close)
    b.stable(Cat(axis.tvalid, axis.tdata, axis.tlast), where=waits)
    b.cover(closed & (b.past(unit.packs, 3)))
    b.cover(watched & leaves & (before < groups.PAYLOAD_BITS) & closed)


@proof(depth=3, cover=12)
def coder(b: Bench):
    """The parts of an event are its fields and all its pixels and offsets; groups open and close as their pulse demands."""
    sensor = SMALL
    m, unit, widths, lengths = b.m, Coder(sensor), groups.group_widths(sensor), layout(sensor)
    winner_bits, offset_bits = sensor.winner_bits, sensor.offset_bits
    grouped, with_offsets = b.constant(1), b.constant(1)
    period = b.constant(bits_for(sensor.period_max))
    valid, beat, last, free = unit.valid, unit.beat, unit.last, unit.free
    passed, begin = unit.passed, unit.frame_begin
    b.place(
        unit, grouped=grouped, with_offsets=with_offsets, period=period, head=is_event_head(beat)
    )
    b.assume(free, where=~unit.offer & ~unit.close)
    b.assume(~valid, where=begin)
    forms = b.same("forms_part", unit.forms & ~unit.closing)
    ends_group = b.same("ends_group", unit.forms & unit.closing)
    b.assume_stable(Cat(valid, beat, last), where=b.last(valid & ~unit.take & ~begin))

    # The stream in the buffer: whole packets; a frame end lasts until `last`.
    of_event = Signal(range(lengths.length(LONGEST)))
    of_record = Signal(range(lengths.length(RECORD)))
    of_end = Signal()
    kind, inside = beat[KIND_LSB:], b.same("inside", (of_event != 0) | (of_record != 0) | of_end)
    code, beats = (
        Mux(with_offsets, *(of[packet] for packet in (LONGEST, min(GROUPED, key=lengths.length))))
        for of in (
            {packet: packet.code for packet in GROUPED},
            {packet: lengths.length(packet) for packet in GROUPED},
        )
    )
    head = b.same("head", grouped & ~inside & (kind == code))
    others = (kind != GROUPED[0].code) & (kind != GROUPED[1].code)
    b.assume(inside | head | others, where=valid & grouped)
    b.assume(~last, where=(of_event != 0) | (of_record != 0) | (~inside & (kind != FRAME_END.code)))
    with m.If(begin):
        m.d.sync += [of_event.eq(0), of_record.eq(0), of_end.eq(0)]
    with m.Elif(unit.take):
        m.d.sync += [
            of_event.eq(Mux(head, beats - 1, of_event - (of_event != 0))),
            of_record.eq(
                Mux(
                    ~inside & (kind == RECORD.code),
                    lengths.length(RECORD) - 1,
                    of_record - (of_record != 0),
                )
            ),
            of_end.eq((of_end | (~inside & (kind == FRAME_END.code))) & ~last),
        ]
    b.always((unit.in_other == ((of_record != 0) | of_end)) & (unit.record_left == of_record))
    b.always(unit.in_event == (of_event != 0))
    b.always(unit.may_begin == (grouped & ~unit.in_other), where=b.past(~begin))
    b.assume(~valid, where=~b.past(1) | b.past(begin))
    b.always(of_event < beats)
    b.always((of_event != 0) + (of_record != 0) + of_end <= 1)
    b.always(grouped, where=unit.full | unit.busy | unit.open | (of_event != 0))
    b.always(unit.index == Mux(of_event != 0, beats - of_event, 0))

    # An arbitrary event: its beats while it is taken, and then its fields.
    words = [Signal(BEAT_BITS, name=f"seen_{k}") for k in range(lengths.length(LONGEST))]
    taking, at_work = Signal(), Signal()
    watch = b.same("watch", b.anything(1) & unit.read & head & ~taking & ~at_work)
    for k, word in enumerate(words):
        with m.If(unit.take & Mux(watch, k == 0, taking & (of_event != 0) & (unit.index == k))):
            m.d.sync += word.eq(beat)
        b.always(
            unit.words[k] == word, where=taking & Mux(of_event != 0, k < unit.index, k < beats)
        )
    m.d.sync += [
        taking.eq((taking | watch) & ~(taking & unit.to_work) & ~begin),
        at_work.eq(((at_work & ~(unit.ends & forms)) | (taking & unit.to_work)) & ~begin),
    ]
    b.always(unit.full | (of_event != 0), where=taking)
    b.always(unit.busy & ~taking, where=at_work)
    b.always((of_event == 0) | ~unit.full | ~taking)

    def field(name: str):
        parts = [part for part in parts_of(sensor, LONGEST) if part.field == name]
        return Cat(words[part.beat][part.lsb : part.lsb + part.width] for part in parts)

    words_pulse = Cat(
        unit.words[part.beat][part.lsb : part.lsb + part.width]
        for part in parts_of(sensor, LONGEST)
        if part.field == "pulse"
    )
    hits, winner, stamp, pulse, count = (
        field(name) for name in ("map", "winner", "stamp", "pulse", "count")
    )
    whole = b.same("whole", at_work | (taking & unit.full))
    ones = b.same("ones", sum(hits, start=0))
    b.assume(
        (count == ones) & (winner < sensor.pixels) & hits.bit_select(winner[:winner_bits], 1),
        where=whole,
    )
    b.assume(stamp < period << sensor.phase_bits, where=whole)
    b.assume((period > 1) & (period <= sensor.period_max))
    stamp_bits = b.same("stamp_bits", sensor.phase_bits + _bits(period - 1, sensor.coarse_bits))
    b.always(unit.stamp_bits == stamp_bits, where=b.past(1))
    mapped = b.same("mapped", count > widths.listed_max)
    b.always(
        (unit.event_pulse == pulse)
        & (unit.stamp == stamp)
        & (unit.winner == winner)
        & (unit.mapped == mapped)
        & (
            unit.numbers
            == Cat(
                Mux(mapped, groups.MAPPED, count)[: groups.LISTED_BITS],
                field("overrun"),
                field("subgroup")[: widths.subgroup_bits],
            )
        ),
        where=at_work,
    )

    # Groups: an event is packed only into an open group that can hold its pulse, and tells its age unless that stays.
    is_open, group_pulse, last_age, number = (
        Signal(),
        Signal(groups.HEAD.pulse),
        Signal(groups.AGE_BITS),
        Signal(groups.HEAD.number),
    )
    opens = b.same("opens", forms & ~is_open)
    b.always((unit.open == is_open) & (unit.number == number))
    b.always(unit.pulse == group_pulse, where=is_open)
    first = b.same("first", unit.busy & (unit.phase == Phase.FIRST))
    forms_first = b.same("forms_first", forms & is_open & first)
    age = b.same("age", (group_pulse - unit.event_pulse)[: groups.HEAD.pulse + 1])
    m.d.sync += [
        is_open.eq((is_open | opens) & ~ends_group & ~begin),
        number.eq(Mux(begin, 0, number + ends_group)),
    ]
    with m.If(opens):
        m.d.sync += [group_pulse.eq(unit.event_pulse), last_age.eq(0)]
    with m.If(forms_first):
        m.d.sync += last_age.eq(age)
    b.always(first, where=unit.busy & ~is_open)
    b.always(unit.fits == (age <= groups.AGE_MAX), where=first & is_open)
    b.always(unit.age == age[: groups.AGE_BITS], where=first & is_open)
    ahead = b.same("ahead", (unit.pulse - words_pulse)[: groups.HEAD.pulse + 1])
    settled = unit.full & ~unit.opening
    b.always(
        (unit.age_ahead == ahead[: groups.AGE_BITS])
        & (unit.fits_ahead == (ahead <= groups.AGE_MAX)),
        where=settled,
    )
    same = b.same("same", age == last_age)
    b.always(unit.same == same, where=first & is_open & unit.fits)
    b.always(unit.age == last_age, where=is_open & ~first)
    b.always(age <= groups.AGE_MAX, where=forms_first)
    b.always(
        unit.next_part == Cat(unit.event_pulse, number, stamp_bits, with_offsets),
        where=opens & b.past(1),
    )
    b.always(unit.next_bits == groups.HEAD_BITS, where=opens)

    # The parts of the event: its numbers with the winner and two further pixels, the rest of them two at a time or the map,
    # and the offsets two at a time. What is left, bits by bits, is seen from both ends.
    left, hit_left, parts_left = (
        Signal(sensor.pixels),
        Signal(sensor.minigroups),
        Signal(range(map_parts(sensor) + 1)),
    )
    hit = Cat(Cat(hits[i] for i in sensor.members(g)).any() for g in range(sensor.minigroups))
    offsets = [
        field("offsets").word_select(g, OFFSETS.width)[:offset_bits]
        for g in range(sensor.minigroups)
    ]
    pixels, minigroups = _Pair(b, left, "pixels"), _Pair(b, hit_left, "minigroups")
    in_pixels = b.same("in_pixels", unit.phase == Phase.PIXELS)
    in_offsets = b.same("in_offsets", unit.phase == Phase.OFFSETS)
    with m.If(taking & unit.to_work):
        m.d.sync += [
            left.eq(hits & ~(1 << winner[:winner_bits])),
            hit_left.eq(hit),
            parts_left.eq(map_parts(sensor)),
        ]
    with m.Elif(at_work & forms & is_open):
        with m.If(~mapped & ~in_offsets):
            m.d.sync += left.eq(pixels.between)
        with m.If(mapped & in_pixels):
            m.d.sync += parts_left.eq(parts_left - 1)
        with m.If(in_offsets):
            m.d.sync += hit_left.eq(minigroups.between)
    low_bits = b.same("low_bits", stamp_bits + Mux(same, 0, groups.AGE_BITS))
    low = b.same("low", unit.next_part >> widths.fixed_bits)
    listed = b.same("listed", Mux(mapped, 0, pixels.count))
    pair = Cat(
        _place(pixels.low, winner_bits), Mux(pixels.count == 2, _place(pixels.high, winner_bits), 0)
    )
    where = b.same("forms_numbers", at_work & forms_first)
    b.always(unit.next_part[: widths.fixed_bits] == Cat(unit.numbers, same), where=where)
    b.always(
        (low & ((1 << low_bits) - 1)) == Mux(same, stamp, Cat(age[: groups.AGE_BITS], stamp)),
        where=where,
    )
    b.always((low >> low_bits) == Cat(winner[:winner_bits], Mux(mapped, 0, pair)), where=where)
    b.always(
        unit.next_bits == widths.fixed_bits + low_bits + winner_bits * (1 + listed), where=where
    )
    where = b.same("forms_pixels", at_work & forms & in_pixels)
    b.always(
        (unit.next_part == pair) & (unit.next_bits == winner_bits * pixels.count) & (left != 0),
        where=where & ~mapped,
    )
    begin_of_part = b.same(
        "begin_of_part", ((map_parts(sensor) - parts_left) * groups.MAP_PART_BITS).as_unsigned()
    )
    b.always(
        unit.next_part == (hits >> begin_of_part)[: groups.MAP_PART_BITS], where=where & mapped
    )
    rest_of_map = sensor.pixels - begin_of_part
    b.always(
        unit.next_bits == Mux(parts_left == 1, rest_of_map, groups.MAP_PART_BITS),
        where=where & mapped,
    )
    where = b.same("forms_offsets", at_work & forms & in_offsets)
    chosen = [
        _any(*(Mux(one_hot[g], offset, 0) for g, offset in enumerate(offsets)))
        for one_hot in (minigroups.low, Mux(minigroups.count == 2, minigroups.high, 0))
    ]
    b.always(
        (unit.next_part == Cat(*chosen))
        & (unit.next_bits == offset_bits * minigroups.count)
        & (hit_left != 0),
        where=where,
    )
    over = b.same("over", at_work & forms & unit.ends)
    pixels_over = Mux(mapped, (parts_left == 1) & in_pixels | in_offsets, (pixels.between == 0))
    b.always(pixels_over & (~with_offsets | (in_offsets & (minigroups.between == 0))), where=over)
    b.always(in_offsets | forms_first | opens | in_pixels, where=over)

    # Invariants.
    b.always(_holds(unit.pixels, pair, pixels), where=at_work & ~mapped & ~in_offsets)
    b.always(unit.rest == pixels.between, where=at_work & ~mapped & ~in_offsets)
    b.always(~unit.pixels.one & ~unit.pixels.two, where=at_work & mapped)
    b.always(unit.rest == hits >> begin_of_part, where=at_work & mapped & ~in_offsets)
    b.always(unit.pixels.more == (first | (parts_left > 1)), where=at_work & mapped & ~in_offsets)
    b.always(unit.parts == parts_left - in_pixels, where=at_work & mapped & ~in_offsets)
    b.always(parts_left != 0, where=at_work & mapped & ~in_offsets)
    b.always(parts_left == map_parts(sensor), where=at_work & first)
    b.always(left == hits & ~(1 << winner[:winner_bits]), where=at_work & first)
    b.always(unit.low_bits == low_bits, where=first & is_open & unit.fits)
    b.always(hit_left == hit, where=at_work & ~in_offsets)
    b.always(_holds(unit.offset_pair, Cat(*chosen), minigroups), where=at_work & with_offsets)
    b.always(unit.minigroups == minigroups.between, where=at_work)
    b.always(unit.offsets == Cat(*offsets), where=at_work & with_offsets)
    b.always((hit_left != 0) & with_offsets, where=at_work & in_offsets)
    b.always((left != 0) | mapped, where=at_work & in_pixels)
    b.always((left == 0) | mapped, where=at_work & in_offsets)
    b.always(first | in_pixels | in_offsets, where=at_work)

    # Other packets pass when no event is left, and something always moves.
    b.always(~is_open & ~unit.busy & ~unit.full & (of_event == 0), where=unit.passes & grouped)
    b.always(
        unit.offer | unit.close | unit.passes | unit.full | unit.busy | unit.closing | unit.take,
        where=valid,
    )
    b.always(unit.forms == ((unit.busy | unit.closing) & free))
    b.always(~(unit.offer & unit.close))
    b.always(
        (unit.part == b.past(unit.next_part)) & (unit.bits == b.past(unit.next_bits)),
        where=b.past(unit.forms),
    )
    b.always(
        (unit.offer == b.past(forms)) & (unit.close == b.past(ends_group)),
        where=b.past(unit.forms) & ~b.past(begin),
    )
    b.always(~b.past(unit.forms), where=b.past(~free))
    b.stable(Cat(unit.offer, unit.close, unit.part, unit.bits), where=~free & ~begin)
    b.always(~unit.offer & ~unit.close, where=unit.passes & grouped)
    b.always(valid, where=unit.take)
    b.always((unit.passes == valid) & (unit.take == (valid & passed)), where=~grouped)
    b.cover(over & mapped)
    b.cover(over & with_offsets)
    b.cover(ends_group & (number == 1))


class _Pair:
    """The lowest and the highest one of some bits, how many of the two there are, and the bits between them."""

    def __init__(self, b: Bench, bits, name: str):
        size = len(bits)
        self.low = b.same(f"{name}_lowest", bits & -bits)
        self.high = b.same(f"{name}_highest", (bits[::-1] & -bits[::-1])[:size][::-1])
        self.between = b.same(f"{name}_inner", (bits & ~self.low & ~self.high)[:size])
        self.count = b.same(f"{name}_ends", Mux(bits == 0, 0, Mux(self.low == self.high, 1, 2)))


def _holds(following, items, pair: _Pair):
    """Return whether the registers `following` hold the items at the ends of some bits."""
    return (
        (following.shown() == items)
        & (following.one == (pair.count != 0))
        & (following.two == (pair.count == 2))
        & (following.more == (pair.between != 0))
    )


def _place(one_hot, width: int):
    """Return the number of the only one of some bits."""
    return _any(*(Mux(bit, Const(i, width), 0) for i, bit in enumerate(one_hot)))


def _any(*values):
    """Return the OR of values."""
    found = Value.cast(0)
    for value in values:
        found |= value
    return found


def _bits(value, width: int):
    """Return the number of bits that hold `value`, which has at most `width` of them."""
    count = 1
    for bit in range(1, width):
        count = Mux(value >> bit != 0, bit + 1, count)
    return count
