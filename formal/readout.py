# SPDX-License-Identifier: Apache-2.0
"""Proofs of readout and packetizer.

Each proof names its parts in order: what the inputs may be, what is proven, and the invariants that
only help the induction.

An order can only be wrong among three or more subgroups. The arbiter treats its bits alike, so the
bounds read n for 3.
"""

from amaranth.hdl import Cat, Const, Mux, Signal, Value
from attrs import frozen

from ..hdl import bus
from ..hdl.packetizer import Packetizer
from ..hdl.readout import Readout
from ..model.contract import latency
from ..model.contract.counts import ROW_BITS
from ..model.contract.packet import (
    BEAT_BITS,
    COUNTS,
    EVENT_FORMATS,
    FORMAT_NAMES,
    FORMATS,
    FRAME_END,
    FRAME_START,
    KIND_LSB,
    RECORD,
    WITH_COUNTS,
    WITH_GROUPS,
    Layout,
    Part,
    layout,
    parts_of,
)
from ..model.contract.parameters import Sensor, bits_for
from .proof_bench import Bench, proof
from .sensors import SMALL, SMALL_COUNTS

N = 3
COUNTS_FORMAT = FORMAT_NAMES.index(COUNTS.name)
# From a grant's register to the beat at the readout's input.
SUBGROUP_TO_BEAT = latency.GRANT_TO_BEAT - 2


def _highest_format(sensor: Sensor) -> int:
    """Return the highest number of a format."""
    return len(FORMATS if sensor.counts else EVENT_FORMATS) - 1


def _length(parts: Layout, send, form):
    """Return the beats of a packet by the contract, independent of the RTL's multiplexer.

    A frame of counts has no events; the RTL's length of one is that of the last format with events.
    """
    *others, last = EVENT_FORMATS.values()
    event = parts.length(last)
    for number, packet in enumerate(others):
        event = Mux(form == number, parts.length(packet), event)
    length = Mux(send == bus.Send.RECORD, parts.length(RECORD), parts.counter_beats)
    if parts.sensor.counts:
        length = Mux(send == bus.Send.COUNTS, parts.length(COUNTS), length)
    return Mux(send == bus.Send.EVENT, event, length)


def _carries(b: Bench, beat, index, packet, fields, where):
    """State that a beat holds these fields where it should.

    It is beat `index` of a packet, and was formed in the last cycle.
    """
    for part in parts_of(SMALL, packet):
        if part.field in fields:
            value = fields[part.field][part.shift : part.shift + part.width]
            b.always(_shown(beat, part) == b.past(value), where=where & (index == part.beat))


def _shown(beat: Value, part: Part) -> Value:
    """Return the part of a field that a beat holds."""
    return beat[part.lsb : part.lsb + part.width]


@frozen
class PlacedReadout:
    """A readout on the bench, with a format that stays.

    form: the number of the format; grouped: it is coded in groups; counting: it has counts; taken:
    the coder takes a beat; rest: beats of a granted packet that a subgroup still sends; sends: it
    sends one.
    """

    unit: Readout
    parts: Layout
    form: Value
    grouped: Signal
    counting: Value
    taken: Signal
    rest: Signal
    sends: Signal

    def in_state(self, name: str):
        """Return whether the readout's machine is in a state."""
        return self.unit.machine.ongoing(name)


@frozen
class Beats:
    """Places and beats. active: a beat is granted in this cycle; pipe: those that are on their way.

    granted: a packet is granted in this cycle, of a subgroup or of the readout itself.
    """

    granted: Signal
    active: Signal
    pipe: Signal

    @property
    def on_the_way(self):
        """Return their number."""
        return sum(self.pipe, start=0)


@proof(depth=4, cover=14)
def readout(b: Bench):
    """One grant at a time, after at most n - 1 others; no overflow, no leak of places; `tlast` ends
    the frame.
    """
    _readout(b, SMALL)


@proof(depth=4, cover=14)
def readout_with_counts(b: Bench):
    """The same of a sensor with counts; in a frame of counts, each minigroup of each subgroup is
    granted once, in order, after the last word and before the frame end.
    """
    _readout(b, SMALL_COUNTS)


def _readout(b: Bench, sensor: Sensor) -> None:
    """Prove the readout of a sensor."""
    dut = _place_readout(b, sensor)
    events = _events_in_subgroups(b, dut)
    _sequencer_obeys(b, dut)

    _one_grant_of_what_is_there(b, dut, events)
    grants = _everybody_gets_a_turn(b, dut)
    if sensor.counts:
        grants = grants | _minigroups_in_order(b, dut, events)
    beats = _beats(b, dut, grants)
    _places_are_never_lost(b, dut, beats)
    expected = _tlast_ends_the_frame(b, dut)
    _frame_start_tells_the_packets(b, dut)
    _frame_end_is_delivered_last(b, dut)

    _events_are_in_registers(b, dut, events)
    _machine_is_in_a_state(b, dut)
    _lengths_are_in_registers(b, dut)
    _beats_form_one_sequence(b, dut, beats)
    _calm_means_empty(b, dut, beats)
    _counters_to_come_are_known(b, dut, beats, expected)

    first_beat = dut.unit.buffer.r_data[KIND_LSB:BEAT_BITS] == FRAME_START.code
    b.cover(dut.taken & first_beat)


def _place_readout(b: Bench, sensor: Sensor) -> PlacedReadout:
    """Place a readout. Its subgroups send granted packets without gaps, after a fixed time.

    Behind the buffer anything may happen that `groups.py` allows: a beat is taken if there is one.
    """
    unit = Readout(sensor, N)
    parts = layout(sensor)
    frame = Signal(bus.frame_layout(sensor))
    form = b.constant(bits_for(_highest_format(sensor)))
    b.m.d.comb += frame.format.eq(form)
    b.assume(form <= _highest_format(sensor))

    rest = Signal(range(parts.longest + 1))
    granted = unit.grant.any()
    sends = b.same("sends", granted | (rest != 0))
    b.m.d.sync += rest.eq(Mux(granted, _length(parts, unit.send, form) - 1, rest - (rest != 0)))

    taken = b.free(unit.coder)["take"]
    b.free(unit.packer)
    grouped_forms = [form == n for n, packet in enumerate(FORMATS.values()) if packet.grouped]
    grouped = b.same("grouped", Cat(grouped_forms).any())
    b.assume(unit.buffer.r_rdy, where=taken)
    b.assume(taken == (unit.buffer.r_rdy & unit.m_axis.tready), where=~grouped)
    b.place(unit, frame=frame, valid=b.past(sends, SUBGROUP_TO_BEAT))
    counting = form == COUNTS_FORMAT if sensor.counts else Const(0)
    return PlacedReadout(
        unit=unit,
        parts=parts,
        form=form,
        grouped=grouped,
        counting=counting,
        taken=taken,
        rest=rest,
        sends=sends,
    )


def _events_in_subgroups(b: Bench, dut: PlacedReadout) -> list[Signal]:
    """Return how many events each subgroup has; it reports no more than its FIFO holds."""
    unit = dut.unit
    events = [Signal(range(SMALL.fifo_depth + 1), name=f"events_of_{s}") for s in range(N)]
    for s in range(N):
        b.m.d.sync += events[s].eq(events[s] + unit.stored_in[s] - unit.take_event[s])
        b.assume(events[s] + unit.stored_in[s] < SMALL.fifo_depth, where=unit.stored[s])
        b.assume(~unit.stored[s], where=dut.counting)  # no window opens
        b.assume(~unit.records[s] & ~unit.record_stored_in[s], where=unit.record_stored[s])
    return events


def _sequencer_obeys(b: Bench, dut: PlacedReadout) -> None:
    """Assume that nothing is stored from `finish` until the next frame.

    `finish` stays until everything is delivered.
    """
    unit = dut.unit
    begin = unit.frame_begin
    finish = unit.finish
    idle = dut.in_state("idle")
    nothing_stored = ~unit.stored.any() & ~unit.record_stored.any()
    b.assume(nothing_stored, where=finish | ~unit.in_frame)
    b.assume(finish, where=b.past(finish) & unit.in_frame)
    b.assume(idle & unit.delivered & ~unit.frame_begin_in, where=begin)


def _one_grant_of_what_is_there(b: Bench, dut: PlacedReadout, events: list[Signal]) -> None:
    """State that there is at most one grant, to a subgroup that has the granted kind.

    It comes as soon as all beats of the previous packet have been granted and the buffer has room.
    """
    unit = dut.unit
    grant = unit.grant
    granted = grant.any()
    b.always((grant & (grant - 1)) == 0)
    had_event = Cat(b.past(events[s] != 0) for s in range(N))
    b.always((grant & ~had_event) == 0, where=granted & (unit.send == bus.Send.EVENT))
    had_record = b.past(unit.records)
    b.always((grant & ~had_record) == 0, where=granted & (unit.send == bus.Send.RECORD))
    somebody_waits = dut.in_state("events") & unit.waiting.any()
    may_grant = somebody_waits & (unit.left == 0) & (unit.space >= dut.parts.longest_word)
    b.always(granted, where=b.past(may_grant))


def _everybody_gets_a_turn(b: Bench, dut: PlacedReadout) -> Signal:
    """State that a waiting subgroup sees at most n - 1 grants to others; return when there is one.

    distance: how many others come before it in the round.
    """
    m = b.m
    unit = dut.unit
    takes = unit.take_event | unit.take_record
    grants = b.same("grants", takes.any())
    for s in range(N):
        waits = unit.waiting[s]
        others = Signal(range(N + 1), name=f"others_{s}")
        its_turn = grants & unit.chosen[s]
        m.d.sync += others.eq(Mux(~waits | its_turn, 0, others + grants))
        distance = Signal(range(N), name=f"distance_{s}")
        for pointer in range(N + 1):
            with m.If(_round_begins_at(unit, pointer)):
                m.d.comb += distance.eq((s - pointer) % N)
        b.always(others <= N - 1)
        b.always(others + distance <= N - 1, where=waits)
        b.always(others == 0, where=~dut.in_state("events"))
        b.cover((others == N - 1) & grants & unit.chosen[s])
    pointers = (_round_begins_at(unit, pointer) for pointer in range(N + 1))
    b.always(sum(pointers, start=0) == 1)
    return grants


def _minigroups_in_order(b: Bench, dut: PlacedReadout, events: list[Signal]) -> Signal:
    """State the grants of counts; return when there is one.

    The end of the frame waits until there have been all. Help the induction: registers hold which
    minigroup is next.
    """
    unit = dut.unit
    minigroups = unit.sensor.minigroups
    every = N * minigroups
    granted = Signal(range(every + 1))  # of this frame
    in_events = dut.in_state("events")
    in_order = dut.counting & (granted != every) & unit.finish_in & ~unit.waiting.any()
    grants = b.same("grants_counts", in_events & in_order & unit.free)
    with b.m.If(dut.in_state("head")):
        b.m.d.sync += granted.eq(0)
    with b.m.Elif(grants):
        b.m.d.sync += granted.eq(granted + 1)
    sends = unit.grant.any() & (unit.send == bus.Send.COUNTS)
    b.always(sends == b.past(grants))
    subgroup = granted // minigroups
    b.always(unit.grant == b.past(1 << subgroup), where=sends)
    left = sum((event != 0 for event in events), start=Const(0))
    b.always((left == 0) & (unit.records == 0), where=sends)
    ends = unit.own_kind == FRAME_END.code
    b.always((granted == every) | ~dut.counting, where=ends)
    b.always(unit.counting == dut.counting, where=b.past(1))
    here = dut.counting & in_events
    next_one = (unit.minigroup == granted % minigroups) & (granted <= every)
    b.always(next_one & (unit.counted_all == (granted == every)), where=here)
    b.always(unit.tail == (1 << subgroup)[:N], where=here & (granted != every))
    b.always(unit.counted_all, where=in_events & ~dut.counting)
    b.cover(sends)
    return grants


def _round_begins_at(unit: Readout, pointer: int):
    """Return whether the round robin begins at a subgroup, so that all from it on come first."""
    from_pointer_on = ((1 << N) - 1) & ~((1 << pointer) - 1)
    return unit.at_or_after == from_pointer_on


def _beats(b: Bench, dut: PlacedReadout, grants: Signal) -> Beats:
    """Specify the beats that have been granted and are not in the buffer yet."""
    unit = dut.unit
    of_counters = dut.in_state("counters") & unit.free_for_counters
    granted = b.same("granted", grants | unit.own_kind.any() | of_counters)
    active = b.same("active", granted | (unit.left != 0))
    pipe = Signal(latency.GRANT_TO_BEAT)
    b.m.d.sync += pipe.eq(pipe << 1 | active)
    return Beats(granted, active, pipe)


def _places_are_never_lost(b: Bench, dut: PlacedReadout, beats: Beats) -> None:
    """State that a beat takes a place at its grant, and frees it when it has left; no overflow.

    An offered beat stays until it is taken.
    """
    unit = dut.unit
    buffer = unit.buffer
    # The library's FIFO holds one more in a register.
    stored_beats = b.same("stored_beats", buffer.level - buffer.r_rdy)
    given_back_later = dut.grouped & unit.taken
    places = unit.space + unit.left + beats.on_the_way + buffer.level + given_back_later
    b.always(places == unit.depth)
    b.always(
        (stored_beats >= 0)
        & (stored_beats <= unit.depth)
        & (unit.left < dut.parts.longest)
        & (unit.space <= unit.depth)
    )
    b.always(buffer.w_rdy, where=buffer.w_en)
    b.always(unit.space == unit.depth, where=dut.in_state("idle"))
    offered = buffer.r_rdy & ~dut.taken & ~unit.frame_begin_in
    b.stable(Cat(buffer.r_rdy, buffer.r_data), where=offered)


def _tlast_ends_the_frame(b: Bench, dut: PlacedReadout) -> Signal:
    """State that `tlast` marks the last beat of the last subgroup's counters, and no other beat.

    Return how many beats of counters are expected after the frame end's header.
    """
    m = b.m
    unit = dut.unit
    buffer = unit.buffer
    all_beats = N * dut.parts.counter_beats
    expected = Signal(range(all_beats + 1))
    ends_here = unit.own[-1] == FRAME_END.code
    with m.If(ends_here):
        m.d.sync += expected.eq(all_beats)
    with m.Elif(buffer.w_en & (expected != 0)):
        m.d.sync += expected.eq(expected - 1)
    is_last = (expected == 1) & unit.valid_in & ~ends_here
    b.always(buffer.w_data[BEAT_BITS] == is_last, where=buffer.w_en)
    return expected


def _frame_start_tells_the_packets(b: Bench, dut: PlacedReadout) -> None:
    """State that the frame start tells whether events come in groups, or whether it has counts."""
    unit = dut.unit
    starts = unit.own[-1] == FRAME_START.code
    told = Mux(dut.counting, WITH_COUNTS, Mux(dut.grouped, WITH_GROUPS, 0))
    for part in parts_of(unit.sensor, FRAME_START):
        if part.field == "count":
            b.always(_shown(unit.buffer.w_data, part) == told, where=starts)


def _frame_end_is_delivered_last(b: Bench, dut: PlacedReadout) -> None:
    """State that a frame is delivered after the controller has received all its counters."""
    b.always(dut.in_state("idle"), where=dut.unit.frame_begin_in)
    b.always(~dut.unit.counted.valid, where=dut.unit.delivered)


def _events_are_in_registers(b: Bench, dut: PlacedReadout, events: list[Signal]) -> None:
    """Help the induction: the planes hold the number of events of each subgroup, bit by bit."""
    unit = dut.unit
    for s in range(N):
        number = Cat(plane[s] for plane in unit.planes)
        b.always((number == events[s]) & (events[s] <= SMALL.fifo_depth))
        b.always(unit.some_events[s] == (events[s] != 0))


def _machine_is_in_a_state(b: Bench, dut: PlacedReadout) -> None:
    """Help the induction: what may be in each state."""
    unit = dut.unit
    idle = dut.in_state("idle")
    in_counters = dut.in_state("counters")
    nothing_comes = ~unit.stored_in.any() & ~unit.record_stored_in.any()
    nobody_waits = ~unit.waiting.any() & ~unit.stored_in.any() & ~unit.record_stored_in.any()
    b.always(nobody_waits, where=~dut.in_state("events") & ~dut.in_state("head"))
    states = (dut.in_state(name) for name in ("idle", "head", "events", "counters", "flush"))
    b.always(sum(states, start=0) == 1)
    b.always(nothing_comes, where=unit.finish_in | idle)
    one_subgroup = ((unit.tail & (unit.tail - 1)) == 0) & unit.tail.any()
    b.always(one_subgroup, where=in_counters)
    b.always(unit.finish_in, where=in_counters | dut.in_state("flush"))
    b.always(b.past(unit.finish) | ~b.past(1), where=unit.finish_in)
    b.always(~unit.filling)


def _lengths_are_in_registers(b: Bench, dut: PlacedReadout) -> None:
    """Help the induction: registers hold what follows from the format and from the free places."""
    unit = dut.unit
    for room, beats in zip(unit.room, unit.rooms, strict=True):
        b.always(room == (unit.space >= beats))
    for beyond, beats in zip(unit.event_exceeds, unit.rooms, strict=True):
        b.always(beyond == unit.event_length + beats - 1)
    b.always(unit.event_last == unit.event_length - 1, where=b.past(1))
    b.always(unit.taken == b.past(dut.taken))
    b.always(unit.grouped == dut.grouped, where=b.past(1))
    b.always(unit.event_length == _length(dut.parts, bus.Send.EVENT, dut.form), where=b.past(1))


def _beats_form_one_sequence(b: Bench, dut: PlacedReadout, beats: Beats) -> None:
    """Help the induction: a beat on its way is the readout's own or a subgroup's, never both."""
    unit = dut.unit
    pipe = beats.pipe
    sends = dut.sends
    own = [b.same(f"own_{k}_any", kind.any()) for k, kind in enumerate(unit.own)]
    b.always(unit.buffer.w_en == pipe[-1])
    b.always(own[0] == b.past(unit.own_kind.any()))
    from_subgroup = [sends, b.past(sends), b.past(sends, 2) & ~own[2], unit.valid_in]
    for k in range(latency.GRANT_TO_BEAT):
        b.always(pipe[k] == (own[k] | from_subgroup[k]))
        b.always(~(own[k] & from_subgroup[k]))
    subgroup_goes_on = b.past(beats.active) & ~own[0] & ~unit.grant.any()
    b.always(dut.rest == Mux(subgroup_goes_on, unit.left + 1, 0), where=~unit.grant.any())
    b.always(unit.left == _length(dut.parts, unit.send, dut.form) - 1, where=unit.grant.any())


def _calm_means_empty(b: Bench, dut: PlacedReadout, beats: Beats) -> None:
    """Help the induction: if nothing has moved for a long time, nothing is on its way."""
    unit = dut.unit
    for cycles in range(1, latency.GRANT_TO_BEAT + 1):
        b.always(beats.pipe[:cycles] == 0, where=unit.calm >= cycles)
    b.always(unit.buffer.level == 0, where=unit.calm >= latency.GRANT_TO_BEAT + 3)


def _counters_to_come_are_known(
    b: Bench, dut: PlacedReadout, beats: Beats, expected: Signal
) -> None:
    """Help the induction: beats of counters are to be granted, on their way, or gone."""
    unit = dut.unit
    pipe = beats.pipe
    all_beats = N * dut.parts.counter_beats
    in_counters = dut.in_state("counters")
    in_flush = dut.in_state("flush")
    after_end = in_counters | in_flush
    left_of_tail = sum((Mux(unit.tail[s], N - s, 0) for s in range(N)), start=0)
    ungranted = b.same("ungranted", Mux(in_counters, left_of_tail, 0))
    to_come = b.same("to_come", ungranted * dut.parts.counter_beats + unit.left)
    is_end = [b.same(f"own_{k}_ends", kind == FRAME_END.code) for k, kind in enumerate(unit.own)]
    end_coming = b.same("end_coming", Cat(is_end).any())
    for k, here in enumerate(is_end):
        b.always(to_come + sum(pipe[:k], start=0) == all_beats, where=here)
        b.always(after_end & ~Cat(is_end[k + 1 :]).any(), where=here)
        b.always((expected == 0) & ~Cat(unit.own[:k]).any(), where=here)
        b.always(unit.own[k] == 0, where=expected != 0)
    b.always(expected == to_come + beats.on_the_way, where=after_end & ~end_coming)
    b.always(expected == 0, where=~in_counters & ~in_flush)
    b.always(unit.to_end == expected)
    nothing_owed = dut.in_state("idle") | (in_flush & (expected == 0) & ~end_coming)
    b.always(unit.owes == ~nothing_owed)


@frozen
class PlacedPacketizer:
    """A packetizer on the bench, with a format that stays, and the packet that it forms.

    form: number of the format; rest: beats of the packet after this cycle's; kind: of the packet;
    now: the same, at its grant, too; active: a beat is formed in this cycle; last: it is the last.
    """

    unit: Packetizer
    parts: Layout
    form: Value
    rest: Signal
    kind: Signal
    now: Value
    active: Signal
    last: Signal


@proof(depth=3, cover=12)
def packetizer(b: Bench):
    """A grant gives a packet of exact length without gaps; its last beat, and no other, frees the
    place.
    """
    _packetizer(b, SMALL)


@proof(depth=3, cover=12)
def packetizer_with_counts(b: Bench):
    """The same of a sensor with counts; a packet of counts has all rows of its minigroup, and its
    last beat, and no other, goes on to the next one.
    """
    _packetizer(b, SMALL_COUNTS)


def _packetizer(b: Bench, sensor: Sensor) -> None:
    """Prove the packetizer of a sensor."""
    dut = _place_packetizer(b, sensor)

    _packets_have_no_gaps(b, dut)
    _beats_carry_their_fields(b, dut)
    if sensor.counts:
        _beats_carry_counts(b, dut)

    _packet_is_in_registers(b, dut)

    b.cover(b.past(dut.unit.take_record))
    b.cover(b.past(dut.rest == 1) & (b.past(dut.now) == bus.Send.COUNTERS))


def _place_packetizer(b: Bench, sensor: Sensor) -> PlacedPacketizer:
    """Place a packetizer, and specify the packet that it forms: beats follow a grant at once."""
    m = b.m
    unit = Packetizer(sensor)
    parts = layout(sensor)
    grant = unit.grant
    send = unit.send
    form = b.constant(bits_for(_highest_format(sensor)))
    b.assume((form <= _highest_format(sensor)) & (send.as_value() <= _highest_kind(sensor)))
    b.place(unit, frame=None)
    m.d.comb += unit.frame.format.eq(form)
    rest = Signal(range(parts.longest + 1))
    kind = Signal(bus.Send)
    b.assume(~grant, where=rest != 0)  # as proven for the readout
    length = b.same("length", _length(parts, send, form))
    active = b.same("active_now", grant | (rest != 0))
    last = b.same("last_now", Mux(grant, length == 1, rest == 1))
    m.d.sync += rest.eq(Mux(grant, length - 1, rest - (rest != 0)))
    with m.If(grant):
        m.d.sync += kind.eq(send)
    return PlacedPacketizer(
        unit=unit,
        parts=parts,
        form=form,
        rest=rest,
        kind=kind,
        now=Mux(grant, send.as_value(), kind.as_value()),
        active=active,
        last=last,
    )


def _highest_kind(sensor: Sensor) -> Value:
    """Return the number of the last kind of packet that a subgroup sends."""
    return Value.cast(bus.Send.COUNTS if sensor.counts else bus.Send.COUNTERS)


def _packets_have_no_gaps(b: Bench, dut: PlacedPacketizer) -> None:
    """State when there are beats, and that only the last one frees a place."""
    unit = dut.unit
    last = dut.active & dut.last
    b.always(unit.valid == b.past(dut.active))
    b.always((unit.beat == 0) & ~unit.beat_controlled, where=~unit.valid)
    b.always(unit.take_event == (last & (dut.now == bus.Send.EVENT)))
    b.always(unit.take_record == (last & (dut.now == bus.Send.RECORD)))


def _beats_carry_their_fields(b: Bench, dut: PlacedPacketizer) -> None:
    """State that every beat of an event or a record has its fields in their places."""
    unit = dut.unit
    window = unit.head.window
    of_event = {
        "stamp": window.stamp,
        "count": window.count,
        "winner": window.winner,
        "map": window.hits,
        "overrun": unit.head.overrun,
        "pulse": unit.head.pulse,
        "subgroup": unit.subgroup,
    }
    room = Const(0, SMALL.record_bits)  # of an entry in the packet
    entries = []
    for g in range(SMALL.minigroups):
        entries.append(unit.record.entries[g].as_value() | room)
    of_record = {
        "pulse": unit.record.pulse,
        "subgroup": unit.subgroup,
        "entries": Cat(entries),
    }
    was_event = b.past(dut.active & (dut.now == bus.Send.EVENT))
    was_record = b.past(dut.active & (dut.now == bus.Send.RECORD))

    index = Signal(range(dut.parts.longest))  # of the beat that was formed in the last cycle
    b.m.d.sync += index.eq(Mux(unit.grant, 0, index + 1))
    b.always(index + 1 == unit.index_before, where=dut.rest != 0)
    for number, packet in enumerate(EVENT_FORMATS.values()):
        of_format = was_event & (dut.form == number)
        b.always(unit.beat[KIND_LSB:] == packet.code, where=of_format & (index == 0))
        b.cover(b.past(unit.take_event) & (dut.form == number))
        _carries(b, unit.beat, index, packet, of_event, of_format)
    _carries(b, unit.beat, index, RECORD, of_record, was_record)


def _beats_carry_counts(b: Bench, dut: PlacedPacketizer) -> None:
    """State that every beat of a packet of counts has its fields, and the row that it asks for."""
    unit = dut.unit
    of_counts = dut.active & (dut.now == bus.Send.COUNTS)
    b.always(unit.reading == of_counts)
    b.always(unit.take_counts == (of_counts & dut.last))
    fields = {
        "gates": unit.of_minigroup.gates,
        "minigroup": unit.minigroup,
        "subgroup": unit.subgroup,
        "pulses": unit.of_minigroup.pulses,
    }
    was_counts = b.past(of_counts)
    index = b.same("index_of_counts", b.past(unit.index))
    b.always(unit.beat[KIND_LSB:] == COUNTS.code, where=was_counts & (index == 0))
    for part in parts_of(unit.sensor, COUNTS):
        here = was_counts & (index == part.beat)
        shown = _shown(unit.beat, part)
        if part.field == "rows":
            b.always(shown == b.past(unit.of_minigroup.row), where=here)
            asked = b.past(unit.read_row, 2) == part.shift // ROW_BITS
            b.always(asked & b.past(unit.reading, 2), where=here)
            continue
        field = fields[part.field]
        value = field[part.shift : part.shift + part.width]
        b.always(shown == b.past(value), where=here)
    b.cover(b.past(unit.take_counts))


def _packet_is_in_registers(b: Bench, dut: PlacedPacketizer) -> None:
    """Help the induction: the packetizer knows the packet's kind and how much of it is left."""
    unit = dut.unit
    rest = dut.rest
    b.always(dut.kind.as_value() <= _highest_kind(unit.sensor))
    b.always(unit.sending == (rest != 0))
    b.always(unit.at_last == (rest == 1), where=rest != 0)
    same_packet = unit.send_before == dut.kind
    sum_is_length = unit.index_before + rest == _length(dut.parts, dut.kind, dut.form)
    b.always(same_packet & sum_is_length, where=rest != 0)
