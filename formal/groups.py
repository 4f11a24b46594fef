# SPDX-License-Identifier: Apache-2.0
"""Proofs of coder and packer, which put events into groups.

Each proof names its parts in order: what the inputs may be, the specification, what is proven, and
the invariants that only help the induction.

Tests, not proofs, show that the check is the CRC-32 of its polynomial: each of its bits is one long
parity.
"""

from typing import Any

from amaranth.hdl import Cat, Const, Mux, Signal, Value
from attrs import frozen

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
from ..model.contract.parameters import Sensor, bits_for
from .proof_bench import Bench, proof
from .sensors import LONG_PARTS, SMALL

WIDTHS = groups.group_widths(SMALL)
LENGTHS = layout(SMALL)
EVENT_BEATS_MAX = LENGTHS.length(LONGEST)
RECORD_BEATS = LENGTHS.length(RECORD)
MAP_PARTS = map_parts(SMALL)


@frozen
class OpenString:
    """The string of the group that is open: its bits that have not left.

    held: their number; closed: the last ones leave in this cycle; leaves: a beat of them does;
    waits: a beat is offered, and not taken.
    """

    is_open: Signal
    held: Signal
    closed: Signal
    leaves: Signal
    waits: Value


@frozen
class WatchedBit:
    """An arbitrary bit of an arbitrary part. before: bits of the string before it."""

    watched: Signal
    value: Signal
    before: Signal


@proof(depth=3, cover=12)
def packer(b: Bench):
    """Every bit of every part leaves at its place; marks and zeros stand where they should; other
    beats pass; AXI4-Stream.
    """
    _packs(b, SMALL)


@proof(depth=3, cover=12)
def packer_of_long_parts(b: Bench):
    """The same where a part may fill two beats at once: a map of 64 pixels behind 54 bits or more."""
    unit = _packs(b, LONG_PARTS)
    b.cover(unit.crowded & unit.m_axis.tready)


def _packs(b: Bench, sensor: Sensor) -> Packer:
    """State the behaviour of the packer of a sensor, and return it."""
    unit = b.place(Packer(sensor))
    string = _open_string(b, unit)
    _coder_obeys(b, unit, string)

    bit = _watched_bit(b, unit, string)
    _bit_leaves_at_its_place(b, unit, string, bit)
    _beats_have_marks(b, unit, string)
    _only_the_receiver_waits(b, unit, string)

    _string_is_in_registers(b, unit, string, bit)

    b.cover(string.closed & (b.past(unit.packs, 3)))
    leaves_now = bit.watched & string.leaves & (bit.before < groups.PAYLOAD_BITS)
    b.cover(leaves_now & string.closed)
    return unit


def _open_string(b: Bench, unit: Packer) -> OpenString:
    """Specify when a group is open, and how many of its bits have not left."""
    axis = unit.m_axis
    closed = b.same("closed", unit.final & axis.tready)
    held = b.same("held", unit.offset + Mux(unit.ready, groups.PAYLOAD_BITS, 0))
    is_open = Signal()
    b.m.d.sync += is_open.eq((is_open | unit.packs) & ~closed & ~unit.frame_begin)
    return OpenString(
        is_open=is_open,
        held=held,
        closed=closed,
        leaves=b.same("leaves", axis.tvalid & axis.tready & ~unit.passes),
        waits=axis.tvalid & ~axis.tready & ~unit.frame_begin,
    )


def _coder_obeys(b: Bench, unit: Packer, string: OpenString) -> None:
    """Assume what is proven for the coder.

    A part is offered until it is packed, an end until it has left, and other beats only between
    groups.
    """
    offer = unit.offer
    close = unit.close
    passes = unit.passes
    begin = unit.frame_begin
    legal_bits = (unit.bits <= len(unit.part)) & (unit.bits != 0) & (unit.part >> unit.bits == 0)
    b.assume(legal_bits, where=offer)
    b.assume(~offer, where=close)
    b.assume(~passes & ~offer & ~close, where=begin)
    b.assume(~passes, where=string.is_open | offer | close)
    b.assume(string.is_open, where=close)
    b.assume_stable(Cat(passes, unit.beat, unit.last), where=b.last(passes & string.waits))
    b.assume(close, where=b.past(close & ~string.closed & ~begin))


def _watched_bit(b: Bench, unit: Packer, string: OpenString) -> WatchedBit:
    """Specify how many bits there are before an arbitrary bit of an arbitrary part."""
    m = b.m
    part_bits = len(unit.part)
    place_in_part = b.constant(bits_for(part_bits - 1))
    b.assume(place_in_part < part_bits)
    watch = b.same("watch", b.anything(1) & unit.packs & (place_in_part < unit.bits))
    watched = Signal()
    value = Signal()
    before = Signal(range(groups.PAYLOAD_BITS + part_bits))
    held_after = Mux(string.leaves, string.held - groups.PAYLOAD_BITS, string.held)
    with m.If(watch & ~watched):
        m.d.sync += watched.eq(1)
        m.d.sync += value.eq(unit.part.bit_select(place_in_part, 1))
        m.d.sync += before.eq(held_after + place_in_part)
    with m.Elif(watched & string.leaves):
        m.d.sync += watched.eq(before >= groups.PAYLOAD_BITS)
        m.d.sync += before.eq(before - groups.PAYLOAD_BITS)
    with m.If(unit.frame_begin):
        m.d.sync += watched.eq(0)
    return WatchedBit(watched, value, before)


def _bit_leaves_at_its_place(b: Bench, unit: Packer, string: OpenString, bit: WatchedBit) -> None:
    """State that a bit leaves behind those before it, and before its group closes."""
    payload = unit.m_axis.tdata[: groups.PAYLOAD_BITS]
    shown = payload.bit_select(bit.before[: bits_for(groups.PAYLOAD_BITS)], 1)
    in_this_beat = bit.watched & string.leaves & (bit.before < groups.PAYLOAD_BITS)
    b.always(shown == bit.value, where=in_this_beat)
    b.always(~bit.watched, where=string.closed & (bit.before >= groups.CHECK_LSB))


def _beats_have_marks(b: Bench, unit: Packer, string: OpenString) -> None:
    """State the marks of a group's first and last beat, and that other beats pass unchanged.

    The last beat holds nothing but the check above `CHECK_LSB`.
    """
    axis = unit.m_axis
    first = Signal(init=1)
    starts_anew = unit.frame_begin | string.closed
    b.m.d.sync += first.eq(Mux(starts_anew, 1, Mux(string.leaves, 0, first)))
    b.always(unit.begins == first)
    of_group = axis.tdata[KIND_LSB:] == GROUP_KIND
    b.always(of_group & (axis.tdata[KIND_LSB - 1] == first) & ~axis.tlast, where=string.leaves)
    b.always(axis.tdata[KIND_LSB - 2] == string.closed, where=string.leaves)
    b.always(unit.close & ~unit.ready & (string.held <= groups.CHECK_LSB), where=string.closed)
    unchanged = (axis.tdata == unit.beat) & (axis.tlast == unit.last) & axis.tvalid
    b.always(unchanged, where=unit.passes)


def _only_the_receiver_waits(b: Bench, unit: Packer, string: OpenString) -> None:
    """State that nothing waits except for the receiver, and that a beat that is offered stays."""
    axis = unit.m_axis
    nothing_to_do = ~unit.offer & ~unit.close
    b.always(unit.free == (unit.packs | string.closed | nothing_to_do))
    b.always(unit.packs, where=unit.offer & ~unit.crowded & (axis.tready | ~unit.ready))
    b.always(axis.tvalid, where=unit.close)
    b.stable(Cat(axis.tvalid, axis.tdata, axis.tlast), where=string.waits)


def _string_is_in_registers(b: Bench, unit: Packer, string: OpenString, bit: WatchedBit) -> None:
    """Help the induction: the packer's registers hold the string, and the bit in it."""
    held = string.held
    b.always(held == 0, where=~string.is_open)
    b.always(unit.packed >> held == 0)
    b.always(held < groups.PAYLOAD_BITS + len(unit.part))
    b.always(unit.ready | (unit.offset < groups.PAYLOAD_BITS))
    b.always(unit.crowded == (unit.offset >= groups.PAYLOAD_BITS))
    b.always(unit.room == (unit.offset <= groups.CHECK_LSB))
    in_string = bit.before < held
    b.always(in_string & (unit.packed.bit_select(bit.before, 1) == bit.value), where=bit.watched)


@frozen
class PlacedCoder:
    """A coder on the bench, with settings of any value that stay.

    forms: it forms a part of an event; ends_group: it forms the end of a group.
    """

    unit: Coder
    grouped: Value
    with_offsets: Value
    period: Value
    forms: Signal
    ends_group: Signal


@frozen
class Packets:
    """Where the stream is in a packet, before the beat that is offered.

    of_event, of_record: beats of such a packet that are still to come; of_end: in a frame end;
    head: the beat is an event's first one; beats: of an event.
    """

    of_event: Signal
    of_record: Signal
    of_end: Signal
    head: Signal
    beats: Value


@frozen
class WatchedEvent:
    """An arbitrary event: its fields, from the beats as they were taken.

    taking: its beats are in the coder's first buffer, or come into it; at_work: the coder forms its
    parts; mapped: it has too many pixels for a list; hit: its minigroups; offsets: one for each of
    them; stamp_bits: of a stamp in this frame.
    """

    words: list[Signal]
    taking: Signal
    at_work: Signal
    hits: Value
    winner: Value
    stamp: Value
    pulse: Value
    count: Value
    mapped: Signal
    hit: Value
    offsets: list[Value]
    stamp_bits: Signal

    @property
    def winner_number(self) -> Value:
        """Return the winner in as many bits as a part has for it."""
        return self.winner[: SMALL.winner_bits]

    @property
    def others_hit(self) -> Value:
        """Return the pixels without the winner."""
        return self.hits & ~(1 << self.winner_number)


@frozen
class Group:
    """The group that is open, and the event at work in it.

    opens: the group's head is formed; pulse: of the group; first: the event's first part is next;
    forms_first: it is formed; age: of the event, in pulses; last_age: of the previous event;
    same: both are equal, and the part does not tell it.
    """

    is_open: Signal
    opens: Signal
    pulse: Signal
    number: Signal
    last_age: Signal
    first: Signal
    forms_first: Signal
    age: Signal
    same: Signal


@frozen
class Rest:
    """What is left of the event at work.

    Pixels and minigroups leave from both ends, one or two at a time. The map leaves part by part.

    left, hit_left: pixels and minigroups that have not left; parts_left: of the map; pixels,
    minigroups: their ends; pair: the two pixels at the ends; chosen: the offsets of the two
    minigroups at the ends; begin_of_part: the first pixel of the map's next part.
    """

    in_pixels: Signal
    in_offsets: Signal
    left: Signal
    hit_left: Signal
    parts_left: Signal
    pixels: "_Pair"
    minigroups: "_Pair"
    pair: Value
    chosen: list[Value]
    begin_of_part: Signal


@proof(depth=3, cover=12)
def coder(b: Bench):
    """The parts of an event are its fields and all its pixels and offsets; groups open and close as
    their pulse demands.
    """
    dut = _place_coder(b)
    packets = _packets(b, dut)
    event = _watched_event(b, dut, packets)

    group = _group(b, dut)
    rest = _rest(b, dut, event, group)

    _groups_open_and_close(b, dut, event, group)
    _numbers_are_right(b, dut, event, group, rest)
    _pixels_are_right(b, dut, event, rest)
    _offsets_are_right(b, dut, event, rest)
    over = _event_ends_when_nothing_is_left(b, dut, event, group, rest)
    _other_packets_pass(b, dut, packets, group)
    _parts_are_offered(b, dut)

    _stream_is_in_registers(b, dut, packets)
    _event_is_in_registers(b, dut, packets, event)
    _group_is_in_registers(b, dut, group)
    _rest_is_in_registers(b, dut, event, group, rest)

    b.cover(over & event.mapped)
    b.cover(over & dut.with_offsets)
    b.cover(dut.ends_group & (group.number == 1))


def _place_coder(b: Bench) -> PlacedCoder:
    """Place a coder, and assume what is proven for the packer: it is free if nothing is offered."""
    unit = Coder(SMALL)
    grouped = b.constant(1)
    with_offsets = b.constant(1)
    period = b.constant(bits_for(SMALL.period_max))
    b.place(
        unit,
        grouped=grouped,
        with_offsets=with_offsets,
        period=period,
        head=is_event_head(unit.beat),
    )
    b.assume(unit.free, where=~unit.offer & ~unit.close)
    b.assume((period > 1) & (period <= SMALL.period_max))
    return PlacedCoder(
        unit=unit,
        grouped=grouped,
        with_offsets=with_offsets,
        period=period,
        forms=b.same("forms_part", unit.forms & ~unit.closing),
        ends_group=b.same("ends_group", unit.forms & unit.closing),
    )


def _packets(b: Bench, dut: PlacedCoder) -> Packets:
    """Let the buffer offer any whole packets; a frame end lasts until `last`."""
    m = b.m
    unit = dut.unit
    valid = unit.valid
    last = unit.last
    begin = unit.frame_begin
    of_event = Signal(range(EVENT_BEATS_MAX))
    of_record = Signal(range(RECORD_BEATS))
    of_end = Signal()
    kind = unit.beat[KIND_LSB:]
    inside = b.same("inside", (of_event != 0) | (of_record != 0) | of_end)

    shorter = min(GROUPED, key=LENGTHS.length)
    code = Mux(dut.with_offsets, LONGEST.code, shorter.code)
    beats = Mux(dut.with_offsets, EVENT_BEATS_MAX, LENGTHS.length(shorter))
    head = b.same("head", dut.grouped & ~inside & (kind == code))
    of_others = (kind != GROUPED[0].code) & (kind != GROUPED[1].code)
    b.assume(inside | head | of_others, where=valid & dut.grouped)
    no_end = ~inside & (kind != FRAME_END.code)
    b.assume(~last, where=(of_event != 0) | (of_record != 0) | no_end)
    b.assume(~valid, where=begin)
    b.assume(~valid, where=~b.past(1) | b.past(begin))
    b.assume_stable(Cat(valid, unit.beat, last), where=b.last(valid & ~unit.take & ~begin))

    record_begins = ~inside & (kind == RECORD.code)
    end_begins = ~inside & (kind == FRAME_END.code)
    with m.If(begin):
        m.d.sync += of_event.eq(0)
        m.d.sync += of_record.eq(0)
        m.d.sync += of_end.eq(0)
    with m.Elif(unit.take):
        m.d.sync += of_event.eq(Mux(head, beats - 1, of_event - (of_event != 0)))
        m.d.sync += of_record.eq(Mux(record_begins, RECORD_BEATS - 1, of_record - (of_record != 0)))
        m.d.sync += of_end.eq((of_end | end_begins) & ~last)
    return Packets(of_event, of_record, of_end, head, beats)


def _watched_event(b: Bench, dut: PlacedCoder, packets: Packets) -> WatchedEvent:
    """Remember the beats of an arbitrary event, and assume that it is one that a tree forms."""
    m = b.m
    unit = dut.unit
    begin = unit.frame_begin
    words = [Signal(BEAT_BITS, name=f"seen_{k}") for k in range(EVENT_BEATS_MAX)]
    taking = Signal()
    at_work = Signal()
    watch = b.same("watch", b.anything(1) & unit.read & packets.head & ~taking & ~at_work)
    for k, word in enumerate(words):
        comes_later = taking & (packets.of_event != 0) & (unit.index == k)
        with m.If(unit.take & Mux(watch, k == 0, comes_later)):
            m.d.sync += word.eq(unit.beat)
    to_work = taking & unit.to_work
    done = unit.ends & dut.forms
    m.d.sync += taking.eq((taking | watch) & ~to_work & ~begin)
    m.d.sync += at_work.eq(((at_work & ~done) | to_work) & ~begin)

    hits = _field(words, "map")
    winner = _field(words, "winner")
    stamp = _field(words, "stamp")
    count = _field(words, "count")
    all_offsets = _field(words, "offsets")
    offsets = []
    hit = []
    for g in range(SMALL.minigroups):
        offsets.append(all_offsets.word_select(g, OFFSETS.width)[: SMALL.offset_bits])
        hit.append(Cat(hits[i] for i in SMALL.members(g)).any())
    coarse_bits = _bits(dut.period - 1, SMALL.coarse_bits)
    event = WatchedEvent(
        words=words,
        taking=taking,
        at_work=at_work,
        hits=hits,
        winner=winner,
        stamp=stamp,
        pulse=_field(words, "pulse"),
        count=count,
        mapped=b.same("mapped", count > WIDTHS.listed_max),
        hit=Cat(hit),
        offsets=offsets,
        stamp_bits=b.same("stamp_bits", SMALL.phase_bits + coarse_bits),
    )

    whole = b.same("whole", at_work | (taking & unit.full))
    ones = b.same("ones", sum(hits, start=0))
    winner_hit = hits.bit_select(event.winner_number, 1)
    b.assume((count == ones) & (winner < SMALL.pixels) & winner_hit, where=whole)
    b.assume(stamp < dut.period << SMALL.phase_bits, where=whole)
    return event


def _field(words: Any, name: str) -> Value:
    """Return a field of the event that has these beats."""
    parts = [part for part in parts_of(SMALL, LONGEST) if part.field == name]
    return Cat(words[part.beat][part.lsb : part.lsb + part.width] for part in parts)


def _group(b: Bench, dut: PlacedCoder) -> Group:
    """Specify groups: the first part opens one, and its end closes it; each has the next number."""
    m = b.m
    unit = dut.unit
    is_open = Signal()
    pulse = Signal(groups.HEAD.pulse)
    last_age = Signal(groups.AGE_BITS)
    number = Signal(groups.HEAD.number)
    opens = b.same("opens", dut.forms & ~is_open)
    first = b.same("first", unit.busy & (unit.phase == Phase.FIRST))
    forms_first = b.same("forms_first", dut.forms & is_open & first)
    age = b.same("age", (pulse - unit.event_pulse)[: groups.HEAD.pulse + 1])
    m.d.sync += is_open.eq((is_open | opens) & ~dut.ends_group & ~unit.frame_begin)
    m.d.sync += number.eq(Mux(unit.frame_begin, 0, number + dut.ends_group))
    with m.If(opens):
        m.d.sync += pulse.eq(unit.event_pulse)
        m.d.sync += last_age.eq(0)
    with m.If(forms_first):
        m.d.sync += last_age.eq(age)
    return Group(
        is_open=is_open,
        opens=opens,
        pulse=pulse,
        number=number,
        last_age=last_age,
        first=first,
        forms_first=forms_first,
        age=age,
        same=b.same("same", age == last_age),
    )


def _rest(b: Bench, dut: PlacedCoder, event: WatchedEvent, group: Group) -> Rest:
    """Specify what is left of the event at work, and what its next part has to be."""
    m = b.m
    unit = dut.unit
    left = Signal(SMALL.pixels)
    hit_left = Signal(SMALL.minigroups)
    parts_left = Signal(range(MAP_PARTS + 1))
    pixels = _Pair(b, left, "pixels")
    minigroups = _Pair(b, hit_left, "minigroups")
    in_pixels = b.same("in_pixels", unit.phase == Phase.PIXELS)
    in_offsets = b.same("in_offsets", unit.phase == Phase.OFFSETS)
    with m.If(event.taking & unit.to_work):
        m.d.sync += left.eq(event.others_hit)
        m.d.sync += hit_left.eq(event.hit)
        m.d.sync += parts_left.eq(MAP_PARTS)
    with m.Elif(event.at_work & dut.forms & group.is_open):
        with m.If(~event.mapped & ~in_offsets):
            m.d.sync += left.eq(pixels.between)
        with m.If(event.mapped & in_pixels):
            m.d.sync += parts_left.eq(parts_left - 1)
        with m.If(in_offsets):
            m.d.sync += hit_left.eq(minigroups.between)

    low_pixel = _place(pixels.low, SMALL.winner_bits)
    high_pixel = _place(pixels.high, SMALL.winner_bits)
    chosen = []
    for one_hot in (minigroups.low, Mux(minigroups.count == 2, minigroups.high, 0)):
        offsets_of_one = [Mux(one_hot[g], offset, 0) for g, offset in enumerate(event.offsets)]
        chosen.append(_any(*offsets_of_one))
    parts_gone = MAP_PARTS - parts_left
    begin_of_part = b.same("begin_of_part", (parts_gone * groups.MAP_PART_BITS).as_unsigned())
    return Rest(
        in_pixels=in_pixels,
        in_offsets=in_offsets,
        left=left,
        hit_left=hit_left,
        parts_left=parts_left,
        pixels=pixels,
        minigroups=minigroups,
        pair=Cat(low_pixel, Mux(pixels.count == 2, high_pixel, 0)),
        chosen=chosen,
        begin_of_part=begin_of_part,
    )


def _groups_open_and_close(b: Bench, dut: PlacedCoder, event: WatchedEvent, group: Group) -> None:
    """State that an event goes only into a group that can hold its pulse; and a group's head."""
    unit = dut.unit
    b.always((unit.open == group.is_open) & (unit.number == group.number))
    b.always(group.age <= groups.AGE_MAX, where=group.forms_first)
    head = Cat(unit.event_pulse, group.number, event.stamp_bits, dut.with_offsets)
    b.always(unit.next_part == head, where=group.opens & b.past(1))
    b.always(unit.next_bits == groups.HEAD_BITS, where=group.opens)


def _numbers_are_right(
    b: Bench, dut: PlacedCoder, event: WatchedEvent, group: Group, rest: Rest
) -> None:
    """State an event's first part: its numbers, stamp and winner, and two more pixels of a list.

    It tells the event's age, unless that is the previous event's.
    """
    unit = dut.unit
    same = group.same
    low_bits = b.same("low_bits", event.stamp_bits + Mux(same, 0, groups.AGE_BITS))
    low = b.same("low", unit.next_part >> WIDTHS.fixed_bits)
    listed = b.same("listed", Mux(event.mapped, 0, rest.pixels.count))
    where = b.same("forms_numbers", event.at_work & group.forms_first)
    age_and_stamp = Cat(group.age[: groups.AGE_BITS], event.stamp)
    pixels = Cat(event.winner_number, Mux(event.mapped, 0, rest.pair))
    bits = WIDTHS.fixed_bits + low_bits + SMALL.winner_bits * (1 + listed)
    b.always(unit.next_part[: WIDTHS.fixed_bits] == Cat(unit.numbers, same), where=where)
    b.always((low & ((1 << low_bits) - 1)) == Mux(same, event.stamp, age_and_stamp), where=where)
    b.always((low >> low_bits) == pixels, where=where)
    b.always(unit.next_bits == bits, where=where)
    b.always(unit.low_bits == low_bits, where=group.first & group.is_open & unit.fits)


def _pixels_are_right(b: Bench, dut: PlacedCoder, event: WatchedEvent, rest: Rest) -> None:
    """State the parts with pixels: two at a time, or the next piece of the map."""
    unit = dut.unit
    where = b.same("forms_pixels", event.at_work & dut.forms & rest.in_pixels)
    bits_of_list = SMALL.winner_bits * rest.pixels.count
    b.always(
        (unit.next_part == rest.pair) & (unit.next_bits == bits_of_list) & (rest.left != 0),
        where=where & ~event.mapped,
    )
    piece = (event.hits >> rest.begin_of_part)[: groups.MAP_PART_BITS]
    b.always(unit.next_part == piece, where=where & event.mapped)
    rest_of_map = SMALL.pixels - rest.begin_of_part
    bits_of_piece = Mux(rest.parts_left == 1, rest_of_map, groups.MAP_PART_BITS)
    b.always(unit.next_bits == bits_of_piece, where=where & event.mapped)


def _offsets_are_right(b: Bench, dut: PlacedCoder, event: WatchedEvent, rest: Rest) -> None:
    """State the parts with offsets, two at a time."""
    unit = dut.unit
    where = b.same("forms_offsets", event.at_work & dut.forms & rest.in_offsets)
    bits = SMALL.offset_bits * rest.minigroups.count
    b.always(
        (unit.next_part == Cat(*rest.chosen)) & (unit.next_bits == bits) & (rest.hit_left != 0),
        where=where,
    )


def _event_ends_when_nothing_is_left(
    b: Bench, dut: PlacedCoder, event: WatchedEvent, group: Group, rest: Rest
) -> Signal:
    """State that all pixels and offsets have left with an event's last part; return when."""
    over = b.same("over", event.at_work & dut.forms & dut.unit.ends)
    map_over = (rest.parts_left == 1) & rest.in_pixels | rest.in_offsets
    pixels_over = Mux(event.mapped, map_over, (rest.pixels.between == 0))
    offsets_over = rest.in_offsets & (rest.minigroups.between == 0)
    b.always(pixels_over & (~dut.with_offsets | offsets_over), where=over)
    in_event = rest.in_offsets | group.forms_first | group.opens | rest.in_pixels
    b.always(in_event, where=over)
    return over


def _other_packets_pass(b: Bench, dut: PlacedCoder, packets: Packets, group: Group) -> None:
    """State that other packets pass when no event is left, and that something always moves."""
    unit = dut.unit
    no_event = ~group.is_open & ~unit.busy & ~unit.full & (packets.of_event == 0)
    b.always(no_event, where=unit.passes & dut.grouped)
    b.always(~unit.offer & ~unit.close, where=unit.passes & dut.grouped)
    b.always(
        unit.offer | unit.close | unit.passes | unit.full | unit.busy | unit.closing | unit.take,
        where=unit.valid,
    )
    b.always(unit.valid, where=unit.take)
    passes_all = (unit.passes == unit.valid) & (unit.take == (unit.valid & unit.passed))
    b.always(passes_all, where=~dut.grouped)


def _parts_are_offered(b: Bench, dut: PlacedCoder) -> None:
    """State that a part or an end is offered in the cycle after it is formed, and until taken."""
    unit = dut.unit
    begin = unit.frame_begin
    formed = b.past(unit.forms)
    b.always(unit.forms == ((unit.busy | unit.closing) & unit.free))
    b.always(~(unit.offer & unit.close))
    as_formed = (unit.part == b.past(unit.next_part)) & (unit.bits == b.past(unit.next_bits))
    b.always(as_formed, where=formed)
    offered = (unit.offer == b.past(dut.forms)) & (unit.close == b.past(dut.ends_group))
    b.always(offered, where=formed & ~b.past(begin))
    b.always(~formed, where=b.past(~unit.free))
    b.stable(Cat(unit.offer, unit.close, unit.part, unit.bits), where=~unit.free & ~begin)


def _stream_is_in_registers(b: Bench, dut: PlacedCoder, packets: Packets) -> None:
    """Help the induction: the coder knows where the stream is in a packet."""
    unit = dut.unit
    of_event = packets.of_event
    of_record = packets.of_record
    of_end = packets.of_end
    in_other = (of_record != 0) | of_end
    b.always((unit.in_other == in_other) & (unit.record_left == of_record))
    b.always(unit.in_event == (of_event != 0))
    b.always(unit.may_begin == (dut.grouped & ~unit.in_other), where=b.past(~unit.frame_begin))
    b.always(of_event < packets.beats)
    b.always((of_event != 0) + (of_record != 0) + of_end <= 1)
    b.always(dut.grouped, where=unit.full | unit.busy | unit.open | (of_event != 0))
    b.always(unit.index == Mux(of_event != 0, packets.beats - of_event, 0))


def _event_is_in_registers(
    b: Bench, dut: PlacedCoder, packets: Packets, event: WatchedEvent
) -> None:
    """Help the induction: the coder's buffers hold the event, beat by beat and then by fields."""
    unit = dut.unit
    taking = event.taking
    at_work = event.at_work
    incomplete = packets.of_event != 0
    for k, word in enumerate(event.words):
        here = Mux(incomplete, k < unit.index, k < packets.beats)
        b.always(unit.words[k] == word, where=taking & here)
    b.always(unit.full | incomplete, where=taking)
    b.always(unit.busy & ~taking, where=at_work)
    b.always((packets.of_event == 0) | ~unit.full | ~taking)
    b.always(unit.stamp_bits == event.stamp_bits, where=b.past(1))
    count_or_map = Mux(event.mapped, groups.MAPPED, event.count)[: groups.LISTED_BITS]
    subgroup = _field(event.words, "subgroup")[: WIDTHS.subgroup_bits]
    b.always(
        (unit.event_pulse == event.pulse)
        & (unit.stamp == event.stamp)
        & (unit.winner == event.winner)
        & (unit.mapped == event.mapped)
        & (unit.numbers == Cat(count_or_map, _field(event.words, "overrun"), subgroup)),
        where=at_work,
    )


def _group_is_in_registers(b: Bench, dut: PlacedCoder, group: Group) -> None:
    """Help the induction: the coder knows pulse and ages, also of the event in its first buffer."""
    unit = dut.unit
    first_of_open = group.first & group.is_open
    b.always(unit.pulse == group.pulse, where=group.is_open)
    b.always(group.first, where=unit.busy & ~group.is_open)
    b.always(unit.fits == (group.age <= groups.AGE_MAX), where=first_of_open)
    b.always(unit.age == group.age[: groups.AGE_BITS], where=first_of_open)
    b.always(unit.same == group.same, where=first_of_open & unit.fits)
    b.always(unit.age == group.last_age, where=group.is_open & ~group.first)

    words_pulse = _field(unit.words, "pulse")
    ahead = b.same("ahead", (unit.pulse - words_pulse)[: groups.HEAD.pulse + 1])
    age_ahead = unit.age_ahead == ahead[: groups.AGE_BITS]
    fits_ahead = unit.fits_ahead == (ahead <= groups.AGE_MAX)
    b.always(age_ahead & fits_ahead, where=unit.full & ~unit.opening)


def _rest_is_in_registers(
    b: Bench, dut: PlacedCoder, event: WatchedEvent, group: Group, rest: Rest
) -> None:
    """Help the induction: the coder's registers hold what is left of the event at work."""
    unit = dut.unit
    at_work = event.at_work
    first = group.first
    in_list = at_work & ~event.mapped & ~rest.in_offsets
    in_map = at_work & event.mapped & ~rest.in_offsets
    b.always(_holds(unit.pixels, rest.pair, rest.pixels), where=in_list)
    b.always(unit.rest == rest.pixels.between, where=in_list)
    b.always(~unit.pixels.one & ~unit.pixels.two, where=at_work & event.mapped)
    b.always(unit.rest == event.hits >> rest.begin_of_part, where=in_map)
    b.always(unit.pixels.more == (first | (rest.parts_left > 1)), where=in_map)
    b.always(unit.parts == rest.parts_left - rest.in_pixels, where=in_map)
    b.always(rest.parts_left != 0, where=in_map)
    b.always(rest.parts_left == MAP_PARTS, where=at_work & first)
    b.always(rest.left == event.others_hit, where=at_work & first)
    b.always(rest.hit_left == event.hit, where=at_work & ~rest.in_offsets)

    with_offsets = at_work & dut.with_offsets
    offset_pair = _holds(unit.offset_pair, Cat(*rest.chosen), rest.minigroups)
    b.always(offset_pair, where=with_offsets)
    b.always(unit.minigroups == rest.minigroups.between, where=at_work)
    b.always(unit.offsets == Cat(*event.offsets), where=with_offsets)
    b.always((rest.hit_left != 0) & dut.with_offsets, where=at_work & rest.in_offsets)
    b.always((rest.left != 0) | event.mapped, where=at_work & rest.in_pixels)
    b.always((rest.left == 0) | event.mapped, where=at_work & rest.in_offsets)
    b.always(first | rest.in_pixels | rest.in_offsets, where=at_work)


class _Pair:
    """The lowest and the highest one of some bits, and how many of the two there are.

    between: the bits between them.
    """

    def __init__(self, b: Bench, bits, name: str):
        size = len(bits)
        reversed_bits = bits[::-1]
        highest = (reversed_bits & -reversed_bits)[:size][::-1]
        self.low = b.same(f"{name}_lowest", bits & -bits)
        self.high = b.same(f"{name}_highest", highest)
        self.between = b.same(f"{name}_inner", (bits & ~self.low & ~self.high)[:size])
        count = Mux(bits == 0, 0, Mux(self.low == self.high, 1, 2))
        self.count = b.same(f"{name}_ends", count)


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
