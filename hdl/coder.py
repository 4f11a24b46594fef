# SPDX-License-Identifier: Apache-2.0
"""Coder of a stream: takes the events from the output buffer, and turns them into the parts of groups for the packer.

The paper leaves the readout open; the form of the groups is our choice (`docs/compact.md`). One coder per stream is enough,
because one beat per cycle comes by, so the subgroups do not change. It packs an event while it takes the next one.
"""

from typing import Any

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import enum
from amaranth.lib.wiring import In, Out

from ..model.contract import groups
from ..model.contract.packet import BEAT_BITS, FORMATS, FRAME_END, KIND_LSB, OFFSETS, RECORD, layout, parts_of
from ..model.contract.parameters import Sensor, bits_for
from .logic import any_of, counted, lowest, named, up_to
from .unit import Unit

GROUPED = tuple(packet for packet in FORMATS.values() if packet.grouped)
LONGEST = max(GROUPED, key=lambda packet: len(packet.fields))  # holds the fields of the others, at the same places


class Phase(enum.Enum, shape=2):  # type: ignore[call-arg]  # Amaranth's enumeration, with a shape
    """What the event at work packs next."""

    FIRST = 0  # its numbers and the first pixels
    PIXELS = 1  # further pixels, or a part of the map
    OFFSETS = 2


class Ends:
    """The lowest and the highest one of some bits, one-hot; whether there are one, two and more; and the bits between them."""

    def __init__(self, m: Module, bits: Value, name: str):
        self.bits, self.name = bits, name
        size = len(bits)
        self.low, self.high = Signal(size, name=f"{name}_low"), Signal(size, name=f"{name}_high")
        self.between = Signal(size, name=f"{name}_between")
        self.one, self.two, self.more = counted(m, bits, f"{name}_count")
        above = up_to(m, bits, f"{name}_up") << 1  # places above the lowest one
        below = up_to(m, bits[::-1], f"{name}_down")[::-1] >> 1
        m.d.comb += [self.low.eq(bits & ~above), self.high.eq(bits & ~below), self.between.eq(bits & above & below)]

    def places(self, m: Module, width: int) -> Value:
        """Return the numbers of the lowest and of the highest one; they do not wait for the one-hot forms."""
        padded = Cat(self.bits, Const(0, (1 << width) - len(self.bits)))
        return Cat(lowest(m, padded, f"{self.name}_first"), ~lowest(m, padded[::-1], f"{self.name}_last"))

    def values(self, m: Module, items: list[Value], name: str) -> Value:
        """Return those of the items that stand at the lowest and at the highest one."""
        return Cat(
            any_of(m, [item & here.replicate(len(item)) for item, here in zip(items, one_hot)], f"{name}_{end}")
            for end, one_hot in enumerate((self.low, self.high))
        )


class Next:
    """Registers: up to two items of `width` bits that are packed next, whether there are one and two, and more after them."""

    def __init__(self, width: int, name: str):
        self.width = width
        self.items = Signal(groups.PER_PART * width, name=f"{name}_items")
        self.one, self.two, self.more = (Signal(name=f"{name}_{flag}") for flag in ("one", "two", "more"))

    def takes(self, ends: Ends, items: Value) -> list[Any]:
        """Return the statements that put the items at both ends of some bits here."""
        flags = self.one.eq(ends.one), self.two.eq(ends.two), self.more.eq(ends.more)
        return [self.items.eq(items), *flags]

    def shown(self) -> Value:
        """Return the items; 0 for one that there is not."""
        low, high = self.items[: self.width], self.items[self.width :]
        return Cat(low & self.one.replicate(self.width), high & self.two.replicate(self.width))

    def bits(self) -> Value:
        """Return the bits of the items."""
        return Mux(self.two, 2 * self.width, Mux(self.one, self.width, 0))


class CoderState:
    """Inner registers and signals of a coder.

    The next beat: in_other: it belongs to a minigroup record, which has `record_left` beats left, or to a frame end;
    in_event: it belongs to an event; may_begin: it may be the first one of an event.

    The event that is taken: its beats are `words`, `index` is the number of the next one, and `full` says that all are
    there. winner_mask: its winner; age_ahead: the age of its pulse in the open group; fits_ahead: the group can hold it.

    The event at work: phase: its part that comes next; ends: this is its last part. pixels, offset_pair: the items that come
    next; rest, minigroups: those that follow. If the event is `mapped`, rest is its map, which has `parts` parts left.
    low_bits: width of stamp and age.

    The group: open, pulse, number. opening: its head comes next; closing: its end comes next, for example because the event
    at work is a misfit. forms: the next part is formed in this cycle, as `next_part` with `next_bits` bits.
    """

    def __init__(self, sensor: Sensor):
        widths, beats = groups.group_widths(sensor), layout(sensor).length(LONGEST)
        self.in_other = Signal()
        self.record_left = Signal(range(layout(sensor).length(RECORD)))
        self.in_event = Signal()
        self.may_begin = Signal()
        self.is_event = Signal()
        self.read = Signal()
        self.words = [Signal(BEAT_BITS, name=f"word_{k}") for k in range(beats)]
        self.index = Signal(range(beats))
        self.full = Signal()
        self.to_work = Signal()
        self.winner_mask = Signal(sensor.pixels)
        self.age_ahead = Signal(groups.AGE_BITS)
        self.fits_ahead = Signal()

        self.busy = Signal()
        self.phase = Signal(Phase)
        self.ends = Signal()
        self.event_pulse = Signal(groups.HEAD.pulse)
        self.numbers = Signal(widths.fixed_bits - 1)
        self.stamp = Signal(sensor.stamp_bits)
        self.winner = Signal(sensor.winner_bits)
        self.mapped = Signal()
        self.age = Signal(groups.AGE_BITS)
        self.same = Signal()
        self.fits = Signal()
        self.low_bits = Signal(range(sensor.stamp_bits + groups.AGE_BITS + 1))
        self.pixels = Next(sensor.winner_bits, "pixels")
        self.rest = Signal(sensor.pixels)
        self.parts = Signal(range(map_parts(sensor) + 1))
        self.offsets = Signal(sensor.minigroups * sensor.offset_bits)
        self.offset_pair = Next(sensor.offset_bits, "offset_pair")
        self.minigroups = Signal(sensor.minigroups)

        self.stamp_bits = Signal(groups.HEAD.stamp_bits)
        self.open = Signal()
        self.pulse = Signal(groups.HEAD.pulse)
        self.number = Signal(groups.HEAD.number)
        self.opening = Signal()
        self.misfit = Signal()
        self.closing = Signal()
        self.forms = Signal()
        self.next_part = Signal(groups.group_widths(sensor).part_bits)
        self.next_bits = Signal(range(groups.group_widths(sensor).part_bits + 1))


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
    valid, beat, last : in, the output buffer's next beat; head : in, `is_event_head` of it; take : out, it is taken or passes
    offer, part, bits, close : out, to the packer, from registers; free : in, from it
    passes : out, the beat is of another packet than an event, and no group is open; passed : in, the receiver takes it
    frame_begin : in, forget everything

    A group ends before an event whose pulse does not fit, and before any other packet. An event takes at least one cycle
    per beat, and one per part. A beat with `last` is of no event, whatever comes before it, so an upset never holds the
    end of a frame back. Inputs come from registers or through little logic. Reset forgets everything.
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
        self.state = CoderState(sensor)

    def elaborate(self, platform):
        m = Module()
        self._take(m)
        self._group(m)
        self._work(m)
        self._pixels(m)
        self._offsets(m)
        self._form(m)
        state = self.state
        with m.If(self.frame_begin):
            places = state.in_other, state.record_left, state.in_event, state.index
            cleared = state.full, state.busy, state.open, state.number, self.offer, self.close
            m.d.sync += [signal.eq(0) for signal in (*places, *cleared)]
        return m

    def _take(self, m):
        """Take the beats of events. All other beats pass when no event and no group is left."""
        state, lengths = self.state, layout(self.sensor)
        kind = self.beat[KIND_LSB:]
        last = Mux(self.with_offsets, lengths.length(LONGEST), min(map(lengths.length, GROUPED))) - 1
        idle = ~state.full & ~state.busy & ~state.open & ~self.offer & ~self.close
        m.d.comb += [
            state.is_event.eq((state.in_event | (self.head & state.may_begin)) & ~self.last),
            state.read.eq(self.valid & state.is_event & (~state.full | state.to_work)),
            self.passes.eq(self.valid & ~state.is_event & (idle | ~self.grouped)),
            self.take.eq(state.read | (self.passes & self.passed)),
        ]
        goes_on = Signal()  # the next beat belongs to the same other packet as the one that passes
        m.d.comb += goes_on.eq(state.in_other)
        with m.If(self.passes & self.passed):
            with m.If(~state.in_other):
                m.d.comb += goes_on.eq(((kind == FRAME_END.code) | (kind == RECORD.code)) & ~self.last)
                m.d.sync += state.record_left.eq(Mux(kind == RECORD.code, lengths.length(RECORD) - 1, 0))
            with m.Else():
                m.d.comb += goes_on.eq((state.record_left != 1) & ~self.last)
                m.d.sync += state.record_left.eq(state.record_left - (state.record_left != 0))
        m.d.sync += [state.in_other.eq(goes_on), state.may_begin.eq(self.grouped & ~goes_on)]
        with m.If(state.read):
            m.d.sync += [
                state.index.eq(Mux(state.index == last, 0, state.index + 1)),
                state.in_event.eq(state.index != last),
            ]
            with m.Switch(state.index):
                for k, word in enumerate(state.words):
                    with m.Case(k):
                        m.d.sync += word.eq(self.beat)
        m.d.sync += state.full.eq((state.read & (state.index == last)) | (state.full & ~state.to_work))

    def _taken(self, name: str) -> Value:
        """Return a field of the event that has been taken."""
        parts = [part for part in parts_of(self.sensor, LONGEST) if part.field == name]
        return Cat(self.state.words[part.beat][part.lsb : part.lsb + part.width] for part in parts)

    def _group(self, m):
        """Open a group for an event that has none; close it before an event that does not fit, and before another packet.

        Whether the next event fits is computed while it is taken, and so is the place of its winner.
        """
        state = self.state
        first, other = named("first other")
        pulse = Signal(groups.HEAD.pulse)
        age = Signal(groups.HEAD.pulse + 1)
        m.d.comb += [
            first.eq(state.busy & (state.phase == Phase.FIRST)),
            other.eq(self.grouped & self.valid & ~state.is_event & ~state.full & ~state.busy),
            state.opening.eq(first & ~state.open),
            state.misfit.eq(first & state.open & ~state.fits),
            state.closing.eq(state.misfit | (state.open & other)),
            pulse.eq(Mux(state.opening, state.event_pulse, state.pulse)),
            age.eq(pulse - self._taken("pulse")),
        ]
        m.d.sync += [
            state.age_ahead.eq(age),
            state.fits_ahead.eq(age <= groups.AGE_MAX),
            state.winner_mask.eq(Const(1) << self._taken("winner")[: self.sensor.winner_bits]),
        ]
        with m.If(state.forms & state.closing):
            m.d.sync += [state.open.eq(0), state.number.eq(state.number + 1)]
        with m.If(state.forms & state.opening):
            m.d.sync += [state.open.eq(1), state.pulse.eq(state.event_pulse)]

    def _work(self, m):
        """Begin with the taken event as soon as nothing more comes of the one at work."""
        state, widths = self.state, self.widths
        same = Signal()
        count = self._taken("count")
        to_pixels = (state.phase != Phase.OFFSETS) & state.pixels.more
        mapped = count > widths.listed_max
        m.d.comb += [
            same.eq(state.age_ahead == state.age),
            state.ends.eq(
                ~state.opening
                & ~state.misfit
                & ~to_pixels
                & Mux(state.phase == Phase.OFFSETS, ~state.offset_pair.more, ~self.with_offsets)
            ),
            state.to_work.eq(state.full & (~state.busy | (state.ends & self.free))),
        ]
        with m.If(state.to_work):
            m.d.sync += [
                state.busy.eq(1),
                state.phase.eq(Phase.FIRST),
                state.event_pulse.eq(self._taken("pulse")),
                state.numbers.eq(
                    Cat(
                        Mux(mapped, groups.MAPPED, count)[: groups.LISTED_BITS],
                        self._taken("overrun"),
                        self._taken("subgroup")[: widths.subgroup_bits],
                    )
                ),
                state.stamp.eq(self._taken("stamp")),
                state.winner.eq(self._taken("winner")),
                state.mapped.eq(mapped),
                state.age.eq(state.age_ahead),
                state.same.eq(same),
                state.fits.eq(state.fits_ahead),
                state.low_bits.eq(Mux(same, state.stamp_bits, state.stamp_bits + groups.AGE_BITS)),
            ]
        with m.Elif(state.forms & state.opening):
            m.d.sync += [state.age.eq(0), state.same.eq(1), state.fits.eq(1), state.low_bits.eq(state.stamp_bits)]
        with m.Elif(state.forms & ~state.closing):
            m.d.sync += [state.busy.eq(~state.ends), state.phase.eq(Mux(to_pixels, Phase.PIXELS, Phase.OFFSETS))]

    def _pixels(self, m):
        """Choose the next two pixels, or the next part of the map; of a new event and of the one at work side by side."""
        state, sensor = self.state, self.sensor
        hits, own = self._taken("map"), state.pixels
        others = Signal(sensor.pixels)
        m.d.comb += others.eq(hits & ~state.winner_mask)
        of_taken, of_rest = Ends(m, others, "others"), Ends(m, state.rest, "rest")
        mapped = self._taken("count") > self.widths.listed_max
        with m.If(state.to_work):
            m.d.sync += own.takes(of_taken, of_taken.places(m, own.width))
            m.d.sync += [state.rest.eq(of_taken.between), state.parts.eq(map_parts(sensor))]
            with m.If(mapped):
                m.d.sync += [own.one.eq(0), own.two.eq(0), own.more.eq(1), state.rest.eq(hits)]
        with m.Elif(state.forms & ~state.opening & ~state.closing):
            with m.If(~state.mapped):
                m.d.sync += own.takes(of_rest, of_rest.places(m, own.width))
                m.d.sync += state.rest.eq(of_rest.between)
            with m.Else():
                m.d.sync += [own.more.eq(state.parts != 1), state.parts.eq(state.parts - 1)]
                with m.If(state.phase == Phase.PIXELS):
                    m.d.sync += state.rest.eq(state.rest >> groups.MAP_PART_BITS)

    def _offsets(self, m):
        """Choose the offsets of the next two minigroups."""
        state, sensor = self.state, self.sensor
        hit = Signal(sensor.minigroups)
        hits, count = self._taken("map"), range(sensor.minigroups)
        m.d.comb += hit.eq(Cat(Cat(hits[i] for i in sensor.members(g)).any() for g in count))
        of_taken, of_rest = Ends(m, hit, "hit"), Ends(m, state.minigroups, "minigroups")
        taken = [self._taken("offsets").word_select(g, OFFSETS.width)[: sensor.offset_bits] for g in count]
        kept = [state.offsets.word_select(g, sensor.offset_bits) for g in count]
        with m.If(state.to_work):
            m.d.sync += state.offset_pair.takes(of_taken, of_taken.values(m, taken, "taken_offset"))
            m.d.sync += [state.minigroups.eq(of_taken.between), state.offsets.eq(Cat(taken))]
        with m.Elif(state.forms & (state.phase == Phase.OFFSETS)):
            m.d.sync += state.offset_pair.takes(of_rest, of_rest.values(m, kept, "kept_offset"))
            m.d.sync += state.minigroups.eq(of_rest.between)

    def _form(self, m):
        """Form what comes next: the group's head or end, the event's numbers with the first pixels, pixels, or offsets."""
        state, sensor, widths = self.state, self.sensor, self.widths
        cycles = Signal(sensor.coarse_bits)
        m.d.comb += cycles.eq(self.period - 1)
        for bit in range(sensor.coarse_bits):
            with m.If(cycles[bit]):
                m.d.sync += state.stamp_bits.eq(bit + 1 + sensor.phase_bits)
        low = Mux(state.same, state.stamp, Cat(state.age, state.stamp))
        pixels = Cat(state.winner, state.pixels.shown())
        last_part = sensor.pixels - groups.MAP_PART_BITS * (map_parts(sensor) - 1)
        m.d.comb += [
            state.forms.eq((state.busy | state.closing) & self.free),
            state.next_part.eq(Cat(state.numbers, state.same, low | (pixels << state.low_bits))),
            state.next_bits.eq(widths.fixed_bits + sensor.winner_bits + state.low_bits + state.pixels.bits()),
        ]
        with m.If(state.opening):
            m.d.comb += [
                state.next_part.eq(Cat(state.event_pulse, state.number, state.stamp_bits, self.with_offsets)),
                state.next_bits.eq(groups.HEAD_BITS),
            ]
        with m.Elif((state.phase == Phase.PIXELS) & state.mapped):
            m.d.comb += [
                state.next_part.eq(state.rest[: groups.MAP_PART_BITS]),
                state.next_bits.eq(Mux(state.pixels.more, groups.MAP_PART_BITS, last_part)),
            ]
        for phase, pair in ((Phase.PIXELS, state.pixels), (Phase.OFFSETS, state.offset_pair)):
            with m.Elif(state.phase == phase):
                m.d.comb += [state.next_part.eq(pair.shown()), state.next_bits.eq(pair.bits())]
        with m.If(state.forms):
            m.d.sync += [
                self.offer.eq(~state.closing),
                self.close.eq(state.closing),
                self.part.eq(state.next_part),
                self.bits.eq(state.next_bits),
            ]
        with m.Elif(self.free):
            m.d.sync += [self.offer.eq(0), self.close.eq(0)]
