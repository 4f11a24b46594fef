# SPDX-License-Identifier: Apache-2.0
"""Coder of a stream: takes the events from the output buffer, and turns them into the parts of
groups for the packer.

The paper leaves the readout open; the form of the groups is our choice (`docs/compact.md`). A
stream carries one beat per cycle, so it needs only one coder, and the subgroups do not change. The
coder packs an event while it takes the next one.
"""

from typing import Any

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import enum
from amaranth.lib.wiring import In, Out

from ..model.contract import groups
from ..model.contract.packet import (
    BEAT_BITS,
    EVENT_FORMATS,
    FRAME_END,
    KIND_LSB,
    OFFSETS,
    RECORD,
    layout,
    parts_of,
)
from ..model.contract.parameters import Sensor, bits_for
from .logic import any_of, counted, lowest, up_to
from .unit import Unit

GROUPED = tuple(packet for packet in EVENT_FORMATS.values() if packet.grouped)
# Holds the fields of the others, at the same places.
LONGEST = max(GROUPED, key=lambda packet: len(packet.fields))


class Phase(enum.Enum, shape=2):  # type: ignore[call-arg]  # Amaranth's enumeration, with a shape
    """What the event at work packs next."""

    FIRST = 0  # its numbers and the first pixels
    PIXELS = 1  # further pixels, or a part of the map
    OFFSETS = 2


class Ends:
    """The lowest and the highest one of some bits, one-hot; whether there are at least one, two and
    three; the bits in between.
    """

    def __init__(self, m: Module, bits: Value, name: str):
        self.bits = bits
        self.name = name
        size = len(bits)
        self.low = Signal(size, name=f"{name}_low")
        self.high = Signal(size, name=f"{name}_high")
        self.between = Signal(size, name=f"{name}_between")
        self.one, self.two, self.more = counted(m, bits, f"{name}_count")
        above = up_to(m, bits, f"{name}_up") << 1  # places above the lowest one
        below = up_to(m, bits[::-1], f"{name}_down")[::-1] >> 1
        m.d.comb += [
            self.low.eq(bits & ~above),
            self.high.eq(bits & ~below),
            self.between.eq(bits & above & below),
        ]

    def places(self, m: Module, width: int) -> Value:
        """Return the numbers of the lowest and of the highest one; they do not wait for the one-hot
        forms.
        """
        padded = Cat(self.bits, Const(0, (1 << width) - len(self.bits)))
        return Cat(
            lowest(m, padded, f"{self.name}_first"), ~lowest(m, padded[::-1], f"{self.name}_last")
        )

    def values(self, m: Module, items: list[Value], name: str) -> Value:
        """Return the items at the places of the lowest and of the highest one."""
        return Cat(
            any_of(
                m,
                [
                    item & here.replicate(len(item))
                    for item, here in zip(items, one_hot, strict=True)
                ],
                f"{name}_{end}",
            )
            for end, one_hot in enumerate((self.low, self.high))
        )


class Next:
    """Registers: up to two items of `width` bits that are packed next, and whether there are at
    least one, two and three.
    """

    def __init__(self, width: int, name: str):
        self.width = width
        self.items = Signal(groups.PER_PART * width, name=f"{name}_items")
        self.one = Signal(name=f"{name}_one")  # at least one item is left
        self.two = Signal(name=f"{name}_two")
        self.more = Signal(name=f"{name}_more")  # at least three

    def takes(self, ends: Ends, items: Value) -> list[Any]:
        """Return the statements that put the items at both ends of some bits here."""
        return [
            self.items.eq(items),
            self.one.eq(ends.one),
            self.two.eq(ends.two),
            self.more.eq(ends.more),
        ]

    def shown(self) -> Value:
        """Return the items, with 0 for a missing one."""
        low = self.items[: self.width]
        high = self.items[self.width :]
        return Cat(low & self.one.replicate(self.width), high & self.two.replicate(self.width))

    def bits(self) -> Value:
        """Return the width of the items that exist."""
        return Mux(self.two, 2 * self.width, Mux(self.one, self.width, 0))


def is_event_head(beat: Value) -> Value:
    """Return whether a beat, if it begins a packet, begins an event in a format with groups."""
    return Cat(beat[KIND_LSB:] == packet.code for packet in GROUPED).any()


def map_parts(sensor: Sensor) -> int:
    """Return the number of parts of a map."""
    return -(-sensor.pixels // groups.MAP_PART_BITS)


class Coder(Unit):
    """Coder.

    Ports
    -----
    grouped, with_offsets : in, of the frame's format; period : in, laser period in cycles
    valid, beat, last : in, the output buffer's next beat; head : in, `is_event_head` of it; take :
        out, it is taken or passes
    offer, part, bits, close : out, to the packer, from registers; free : in, from it
    passes : out, the beat belongs to no event, and no group is open; passed : in, the receiver
        takes it
    frame_begin : in, forget everything

    A group ends before an event whose pulse does not fit, and before any other packet. An event
    takes at least one cycle per beat, and one per part. A beat with `last` never counts as part of
    an event, so an upset cannot hold back the end of a frame. Inputs come from registers or through
    little logic. Reset forgets everything.
    """

    unit_name = "coincid_coder"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        self.widths = groups.group_widths(sensor)
        super().__init__(
            grouped=In(1),
            with_offsets=In(1),
            period=In(bits_for(sensor.period_max)),
            valid=In(1),
            beat=In(BEAT_BITS),
            last=In(1),
            head=In(1),
            take=Out(1),
            offer=Out(1),
            part=Out(groups.group_widths(sensor).part_bits),
            bits=Out(bits_for(groups.group_widths(sensor).part_bits)),
            close=Out(1),
            free=In(1),
            passes=Out(1),
            passed=In(1),
            frame_begin=In(1),
        )
        self._taken_event()
        self._event_at_work()
        self._open_group()

    def _taken_event(self):
        """Registers of the next beat, and of the event that is taken from the beats."""
        lengths = layout(self.sensor)
        beats = lengths.length(LONGEST)
        # The next beat.
        self.in_other = Signal()  # it belongs to a minigroup record or to a frame end
        self.record_left = Signal(range(lengths.length(RECORD)))  # beats left of the record
        self.in_event = Signal()  # it belongs to an event
        self.may_begin = Signal()  # it may be the first beat of an event
        self.is_event = Signal()  # it belongs to an event, or begins one
        self.read = Signal()  # it is taken into `words`
        # The event that is taken.
        self.words = [Signal(BEAT_BITS, name=f"words_{k}") for k in range(beats)]
        self.index = Signal(range(beats))  # number of its next beat
        self.full = Signal()  # all its beats are in `words`
        self.to_work = Signal()  # it becomes the event at work
        self.winner_mask = Signal(self.sensor.pixels)  # its winner, one-hot
        self.age_ahead = Signal(groups.AGE_BITS)  # the age of its pulse in the open group
        self.fits_ahead = Signal()  # the group can hold it

    def _event_at_work(self):
        """Registers of the event whose parts are packed."""
        sensor = self.sensor
        self.busy = Signal()  # there is one
        self.phase = Signal(Phase)  # its part that comes next
        self.ends = Signal()  # this is its last part
        self.numbers = Signal(self.widths.fixed_bits - 1)  # how many pixels, overrun, and subgroup
        self.same = Signal()  # its pulse is that of the event before
        self.fits = Signal()  # the group can hold it
        self.age = Signal(groups.AGE_BITS)  # the age of its pulse in the open group
        self.stamp = Signal(sensor.stamp_bits)
        self.low_bits = Signal(range(sensor.stamp_bits + groups.AGE_BITS + 1))  # width of both
        self.winner = Signal(sensor.winner_bits)
        self.mapped = Signal()  # a map follows the winner, instead of a list of pixels
        self.pixels = Next(sensor.winner_bits, "pixels")  # pixels that come next
        self.rest = Signal(sensor.pixels)  # the pixels that follow, or the map
        self.parts = Signal(range(map_parts(sensor) + 1))  # parts left of the map
        self.offset_pair = Next(sensor.offset_bits, "offset_pair")  # offsets that come next
        self.minigroups = Signal(sensor.minigroups)  # minigroups whose offsets follow
        self.offsets = Signal(sensor.minigroups * sensor.offset_bits)  # all its offsets

    def _open_group(self):
        """Registers of the group, and of the part that is formed."""
        part_bits = self.widths.part_bits
        self.open = Signal()  # there is one
        self.pulse = Signal(groups.HEAD.pulse)  # its pulse
        self.event_pulse = Signal(groups.HEAD.pulse)  # the pulse of the event at work
        self.stamp_bits = Signal(groups.HEAD.stamp_bits)  # width of its stamps
        self.number = Signal(groups.HEAD.number)
        self.opening = Signal()  # its head comes next
        self.closing = Signal()  # its end comes next,
        self.misfit = Signal()  # because the event at work does not fit
        self.forms = Signal()  # the next part is formed in this cycle
        self.next_part = Signal(part_bits)
        self.next_bits = Signal(range(part_bits + 1))

    def elaborate(self, platform):
        m = Module()
        self._take(m)
        self._group(m)
        self._work(m)
        self._pixels(m)
        self._offsets(m)
        self._form(m)
        with m.If(self.frame_begin):
            m.d.sync += [
                self.in_other.eq(0),
                self.record_left.eq(0),
                self.in_event.eq(0),
                self.index.eq(0),
                self.full.eq(0),
                self.busy.eq(0),
                self.open.eq(0),
                self.number.eq(0),
                self.offer.eq(0),
                self.close.eq(0),
            ]
        return m

    def _take(self, m):
        """Take the beats of events. All other beats pass when no event and no group is left."""
        lengths = layout(self.sensor)
        kind = self.beat[KIND_LSB:]
        last = (
            Mux(self.with_offsets, lengths.length(LONGEST), min(map(lengths.length, GROUPED))) - 1
        )
        idle = ~self.full & ~self.busy & ~self.open & ~self.offer & ~self.close
        m.d.comb += [
            self.is_event.eq((self.in_event | (self.head & self.may_begin)) & ~self.last),
            self.read.eq(self.valid & self.is_event & (~self.full | self.to_work)),
            self.passes.eq(self.valid & ~self.is_event & (idle | ~self.grouped)),
            self.take.eq(self.read | (self.passes & self.passed)),
        ]
        goes_on = Signal()  # the next beat belongs to the same other packet as the one that passes
        m.d.comb += goes_on.eq(self.in_other)
        with m.If(self.passes & self.passed):
            with m.If(~self.in_other):
                m.d.comb += goes_on.eq(
                    ((kind == FRAME_END.code) | (kind == RECORD.code)) & ~self.last
                )
                m.d.sync += self.record_left.eq(
                    Mux(kind == RECORD.code, lengths.length(RECORD) - 1, 0)
                )
            with m.Else():
                m.d.comb += goes_on.eq((self.record_left != 1) & ~self.last)
                m.d.sync += self.record_left.eq(self.record_left - (self.record_left != 0))
        m.d.sync += [self.in_other.eq(goes_on), self.may_begin.eq(self.grouped & ~goes_on)]
        with m.If(self.read):
            m.d.sync += [
                self.index.eq(Mux(self.index == last, 0, self.index + 1)),
                self.in_event.eq(self.index != last),
            ]
            with m.Switch(self.index):
                for k, word in enumerate(self.words):
                    with m.Case(k):
                        m.d.sync += word.eq(self.beat)
        m.d.sync += self.full.eq((self.read & (self.index == last)) | (self.full & ~self.to_work))

    def _taken(self, name: str) -> Value:
        """Return a field of the event that has been taken."""
        parts = [part for part in parts_of(self.sensor, LONGEST) if part.field == name]
        return Cat(self.words[part.beat][part.lsb : part.lsb + part.width] for part in parts)

    def _group(self, m):
        """Open a group for an event that has none; close it before an event that does not fit, and
        before another packet.

        Whether the next event fits is computed while it is taken, and so is the place of its
        winner.
        """
        first = Signal()  # the first part of the event at work comes next
        other = Signal()  # a beat of another packet comes next
        pulse = Signal(groups.HEAD.pulse)
        age = Signal(groups.HEAD.pulse + 1)
        m.d.comb += [
            first.eq(self.busy & (self.phase == Phase.FIRST)),
            other.eq(self.grouped & self.valid & ~self.is_event & ~self.full & ~self.busy),
            self.opening.eq(first & ~self.open),
            self.misfit.eq(first & self.open & ~self.fits),
            self.closing.eq(self.misfit | (self.open & other)),
            pulse.eq(Mux(self.opening, self.event_pulse, self.pulse)),
            age.eq(pulse - self._taken("pulse")),
        ]
        m.d.sync += [
            self.age_ahead.eq(age),
            self.fits_ahead.eq(age <= groups.AGE_MAX),
            self.winner_mask.eq(Const(1) << self._taken("winner")[: self.sensor.winner_bits]),
        ]
        with m.If(self.forms & self.closing):
            m.d.sync += [self.open.eq(0), self.number.eq(self.number + 1)]
        with m.If(self.forms & self.opening):
            m.d.sync += [self.open.eq(1), self.pulse.eq(self.event_pulse)]

    def _work(self, m):
        """Begin with the taken event as soon as the one at work has no further part."""
        widths = self.widths
        same = Signal()
        count = self._taken("count")
        to_pixels = (self.phase != Phase.OFFSETS) & self.pixels.more
        mapped = count > widths.listed_max
        m.d.comb += [
            same.eq(self.age_ahead == self.age),
            self.ends.eq(
                ~self.opening
                & ~self.misfit
                & ~to_pixels
                & Mux(self.phase == Phase.OFFSETS, ~self.offset_pair.more, ~self.with_offsets)
            ),
            self.to_work.eq(self.full & (~self.busy | (self.ends & self.free))),
        ]
        with m.If(self.to_work):
            m.d.sync += [
                self.busy.eq(1),
                self.phase.eq(Phase.FIRST),
                self.event_pulse.eq(self._taken("pulse")),
                self.numbers.eq(
                    Cat(
                        Mux(mapped, groups.MAPPED, count)[: groups.LISTED_BITS],
                        self._taken("overrun"),
                        self._taken("subgroup")[: widths.subgroup_bits],
                    )
                ),
                self.stamp.eq(self._taken("stamp")),
                self.winner.eq(self._taken("winner")),
                self.mapped.eq(mapped),
                self.age.eq(self.age_ahead),
                self.same.eq(same),
                self.fits.eq(self.fits_ahead),
                self.low_bits.eq(Mux(same, self.stamp_bits, self.stamp_bits + groups.AGE_BITS)),
            ]
        with m.Elif(self.forms & self.opening):
            m.d.sync += [
                self.age.eq(0),
                self.same.eq(1),
                self.fits.eq(1),
                self.low_bits.eq(self.stamp_bits),
            ]
        with m.Elif(self.forms & ~self.closing):
            m.d.sync += [
                self.busy.eq(~self.ends),
                self.phase.eq(Mux(to_pixels, Phase.PIXELS, Phase.OFFSETS)),
            ]

    def _pixels(self, m):
        """Choose the next two pixels or the next part of the map, for a new event and for the one
        at work side by side.
        """
        sensor = self.sensor
        hits = self._taken("map")
        own = self.pixels
        others = Signal(sensor.pixels)
        m.d.comb += others.eq(hits & ~self.winner_mask)
        of_taken = Ends(m, others, "others")
        of_rest = Ends(m, self.rest, "rest")
        mapped = self._taken("count") > self.widths.listed_max
        with m.If(self.to_work):
            m.d.sync += own.takes(of_taken, of_taken.places(m, own.width))
            m.d.sync += [self.rest.eq(of_taken.between), self.parts.eq(map_parts(sensor))]
            with m.If(mapped):
                m.d.sync += [own.one.eq(0), own.two.eq(0), own.more.eq(1), self.rest.eq(hits)]
        with m.Elif(self.forms & ~self.opening & ~self.closing):
            with m.If(~self.mapped):
                m.d.sync += own.takes(of_rest, of_rest.places(m, own.width))
                m.d.sync += self.rest.eq(of_rest.between)
            with m.Else():
                m.d.sync += [own.more.eq(self.parts != 1), self.parts.eq(self.parts - 1)]
                with m.If(self.phase == Phase.PIXELS):
                    m.d.sync += self.rest.eq(self.rest >> groups.MAP_PART_BITS)

    def _offsets(self, m):
        """Choose the offsets of the next two minigroups."""
        sensor = self.sensor
        hit = Signal(sensor.minigroups)
        hits = self._taken("map")
        count = range(sensor.minigroups)
        m.d.comb += hit.eq(Cat(Cat(hits[i] for i in sensor.members(g)).any() for g in count))
        of_taken = Ends(m, hit, "hit")
        of_rest = Ends(m, self.minigroups, "minigroups")
        taken = [
            self._taken("offsets").word_select(g, OFFSETS.width)[: sensor.offset_bits]
            for g in count
        ]
        kept = [self.offsets.word_select(g, sensor.offset_bits) for g in count]
        with m.If(self.to_work):
            m.d.sync += self.offset_pair.takes(of_taken, of_taken.values(m, taken, "taken_offset"))
            m.d.sync += [self.minigroups.eq(of_taken.between), self.offsets.eq(Cat(taken))]
        with m.Elif(self.forms & (self.phase == Phase.OFFSETS)):
            m.d.sync += self.offset_pair.takes(of_rest, of_rest.values(m, kept, "kept_offset"))
            m.d.sync += self.minigroups.eq(of_rest.between)

    def _form(self, m):
        """Form what comes next: the group's head or end, the event's numbers with the first pixels,
        pixels, or offsets.
        """
        sensor = self.sensor
        widths = self.widths
        cycles = Signal(sensor.coarse_bits)
        m.d.comb += cycles.eq(self.period - 1)
        for bit in range(sensor.coarse_bits):
            with m.If(cycles[bit]):
                m.d.sync += self.stamp_bits.eq(bit + 1 + sensor.phase_bits)
        low = Mux(self.same, self.stamp, Cat(self.age, self.stamp))
        pixels = Cat(self.winner, self.pixels.shown())
        last_part = sensor.pixels - groups.MAP_PART_BITS * (map_parts(sensor) - 1)
        m.d.comb += [
            self.forms.eq((self.busy | self.closing) & self.free),
            self.next_part.eq(Cat(self.numbers, self.same, low | (pixels << self.low_bits))),
            self.next_bits.eq(
                widths.fixed_bits + sensor.winner_bits + self.low_bits + self.pixels.bits()
            ),
        ]
        with m.If(self.opening):
            m.d.comb += [
                self.next_part.eq(
                    Cat(self.event_pulse, self.number, self.stamp_bits, self.with_offsets)
                ),
                self.next_bits.eq(groups.HEAD_BITS),
            ]
        with m.Elif((self.phase == Phase.PIXELS) & self.mapped):
            m.d.comb += [
                self.next_part.eq(self.rest[: groups.MAP_PART_BITS]),
                self.next_bits.eq(Mux(self.pixels.more, groups.MAP_PART_BITS, last_part)),
            ]
        for phase, pair in ((Phase.PIXELS, self.pixels), (Phase.OFFSETS, self.offset_pair)):
            with m.Elif(self.phase == phase):
                m.d.comb += [self.next_part.eq(pair.shown()), self.next_bits.eq(pair.bits())]
        with m.If(self.forms):
            m.d.sync += [
                self.offer.eq(~self.closing),
                self.close.eq(self.closing),
                self.part.eq(self.next_part),
                self.bits.eq(self.next_bits),
            ]
        with m.Elif(self.free):
            m.d.sync += [self.offer.eq(0), self.close.eq(0)]
