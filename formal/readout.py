# SPDX-License-Identifier: Apache-2.0
"""Proofs of readout and packetizer.

An order can only be wrong among three or more subgroups. The arbiter treats its bits alike, so the bounds read n for 3.
"""

from amaranth.hdl import Cat, Const, Mux, Signal

from ..hdl import bus
from ..hdl.packetizer import Packetizer
from ..hdl.readout import Readout
from ..model.contract import latency
from ..model.contract.packet import (
    BEAT_BITS,
    FORMATS,
    FRAME_END,
    FRAME_START,
    KIND_LSB,
    RECORD,
    layout,
    parts_of,
)
from ..model.contract.parameters import bits_for
from .proof_bench import Bench, proof
from .sensors import SMALL

N = 3
PARTS = layout(SMALL)
HIGHEST_FORMAT = len(FORMATS) - 1
# From a grant's register to the beat at the readout's input.
SUBGROUP_TO_BEAT = latency.GRANT_TO_BEAT - 2


def _length(send, form):
    """Return the beats of a packet by the contract, independent of the RTL's multiplexer."""
    event = 0
    for number, packet in enumerate(FORMATS.values()):
        event = Mux(form == number, PARTS.length(packet), event)
    record = PARTS.length(RECORD)
    return Mux(
        send == bus.Send.EVENT, event, Mux(send == bus.Send.RECORD, record, PARTS.counter_beats)
    )


def _carries(b: Bench, beat, index, packet, fields, where):
    """Demand that beat `index` of a packet, formed in the last cycle, holds these fields where it should."""
    for part in parts_of(SMALL, packet):
        if part.field in fields:
            value = fields[part.field][part.shift : part.shift + part.width]
            shown = beat[part.lsb : part.lsb + part.width]
            b.always(shown == b.past(value), where=where & (index == part.beat))


@proof(depth=4, cover=14)
def readout(b: Bench):
    """One grant at a time, after at most n - 1 others; no overflow, no leak of places; `tlast` ends the frame."""
    m, unit = b.m, Readout(SMALL, N)
    frame, form = Signal(bus.frame_layout(SMALL)), b.constant(bits_for(HIGHEST_FORMAT))
    stored, record_stored, ready = unit.stored, unit.record_stored, unit.m_axis.tready
    finish, begin = unit.finish, unit.frame_begin
    m.d.comb += frame.format.eq(form)
    b.assume(form <= HIGHEST_FORMAT)

    # The subgroups: the beats of a granted packet come without gaps, after a fixed time.
    rest = Signal(range(PARTS.longest + 1))
    sends = b.same("sends", unit.grant.any() | (rest != 0))
    m.d.sync += rest.eq(Mux(unit.grant.any(), _length(unit.send, form) - 1, rest - (rest != 0)))
    # Behind the buffer anything may happen that `groups.py` allows: a beat is taken if there is one.
    taken = b.free(unit.coder)["take"]
    b.free(unit.packer)
    grouped = b.same(
        "grouped",
        Cat(form == n for n, packet in enumerate(FORMATS.values()) if packet.grouped).any(),
    )
    b.assume(unit.buffer.r_rdy, where=taken)
    b.assume(taken == (unit.buffer.r_rdy & ready), where=~grouped)
    b.place(unit, frame=frame, valid=b.past(sends, SUBGROUP_TO_BEAT))
    idle = unit.machine.ongoing("idle")

    # A subgroup reports no more events than its FIFO holds. From `finish` until the next frame, nothing is stored.
    events = [Signal(range(SMALL.fifo_depth + 1), name=f"events_of_{s}") for s in range(N)]
    for s in range(N):
        m.d.sync += events[s].eq(events[s] + unit.stored_in[s] - unit.take_event[s])
        b.assume(events[s] + unit.stored_in[s] < SMALL.fifo_depth, where=stored[s])
        b.assume(~unit.records[s] & ~unit.record_stored_in[s], where=record_stored[s])
    b.assume(~stored.any() & ~record_stored.any(), where=finish | ~unit.in_frame)
    # `finish` stays until everything is delivered.
    b.assume(finish, where=b.past(finish) & unit.in_frame)
    b.assume(idle & unit.delivered & ~unit.frame_begin_in, where=begin)
    b.always(idle, where=unit.frame_begin_in)

    # At most one grant, to a subgroup that has the granted kind.
    b.always((unit.grant & (unit.grant - 1)) == 0)
    had_event = Cat(b.past(events[s] != 0) for s in range(N))
    b.always((unit.grant & ~had_event) == 0, where=unit.grant.any() & (unit.send == bus.Send.EVENT))
    b.always(
        (unit.grant & ~b.past(unit.records)) == 0,
        where=unit.grant.any() & (unit.send == bus.Send.RECORD),
    )
    for s in range(N):
        b.always(
            (Cat(plane[s] for plane in unit.planes) == events[s]) & (events[s] <= SMALL.fifo_depth)
        )
        b.always(unit.some_events[s] == (events[s] != 0))

    # A waiting subgroup sees at most n - 1 grants to others. Distance: others that come before it in the round.
    in_events = unit.machine.ongoing("events")
    takes = unit.take_event | unit.take_record
    grants = b.same("grants", takes.any())
    granted = b.same(
        "granted",
        grants | unit.own_kind.any() | (unit.machine.ongoing("counters") & unit.free_for_counters),
    )
    for s in range(N):
        others = Signal(range(N + 1), name=f"others_{s}")
        waits = unit.waiting[s]
        m.d.sync += others.eq(Mux(~waits | (grants & unit.chosen[s]), 0, others + grants))
        distance = Signal(range(N), name=f"distance_{s}")
        for pointer in range(N + 1):  # at_or_after: all subgroups from the pointer on
            with m.If(unit.at_or_after == (((1 << N) - 1) & ~((1 << pointer) - 1))):
                m.d.comb += distance.eq((s - pointer) % N)
        b.always(others <= N - 1)
        b.always(others + distance <= N - 1, where=waits)
        b.always(others == 0, where=~in_events)
        b.cover((others == N - 1) & grants & unit.chosen[s])
    b.always(
        sum(
            (
                unit.at_or_after == (((1 << N) - 1) & ~((1 << pointer) - 1))
                for pointer in range(N + 1)
            ),
            start=0,
        )
        == 1
    )
    # A grant comes as soon as all beats of the previous packet have been granted and the buffer has room.
    b.always(
        unit.grant.any(),
        where=b.past(
            in_events & unit.waiting.any() & (unit.left == 0) & (unit.space >= PARTS.longest_word)
        ),
    )
    b.always(
        ~unit.waiting.any() & ~unit.stored_in.any() & ~unit.record_stored_in.any(),
        where=~in_events & ~unit.machine.ongoing("head"),
    )
    b.always(
        sum(
            (
                unit.machine.ongoing(name)
                for name in ("idle", "head", "events", "counters", "flush")
            ),
            start=0,
        )
        == 1
    )
    b.always(~unit.stored_in.any() & ~unit.record_stored_in.any(), where=unit.finish_in | idle)
    b.always(
        ((unit.tail & (unit.tail - 1)) == 0) & unit.tail.any(),
        where=unit.machine.ongoing("counters"),
    )
    b.always(unit.finish_in, where=unit.machine.ongoing("counters") | unit.machine.ongoing("flush"))
    b.always(b.past(unit.finish) | ~b.past(1), where=unit.finish_in)

    # The buffer: a place is taken at the grant, and is free again when the beat has left.
    active = b.same("active", granted | (unit.left != 0))
    pipe = Signal(latency.GRANT_TO_BEAT)
    m.d.sync += pipe.eq(pipe << 1 | active)
    on_the_way = sum(pipe, start=0)
    # The library's FIFO holds one more in a register.
    stored_beats = b.same("stored_beats", unit.buffer.level - unit.buffer.r_rdy)
    for room, beats in zip(unit.room, unit.rooms):
        b.always(room == (unit.space >= beats))
    for beyond, beats in zip(unit.event_exceeds, unit.rooms):
        b.always(beyond == unit.event_length + beats - 1)
    b.always(unit.event_last == unit.event_length - 1, where=b.past(1))
    b.always(unit.taken == b.past(taken))
    b.always(unit.grouped == grouped, where=b.past(1))
    given_back_later = grouped & unit.taken
    b.always(
        unit.space + unit.left + on_the_way + unit.buffer.level + given_back_later == unit.depth
    )
    b.always(
        (stored_beats >= 0)
        & (stored_beats <= unit.depth)
        & (unit.left < PARTS.longest)
        & (unit.space <= unit.depth)
    )
    b.always(unit.buffer.w_rdy, where=unit.buffer.w_en)
    b.always(unit.buffer.w_en == pipe[-1])
    b.always(unit.space == unit.depth, where=idle)
    # Invariants: the beats of the readout and of the subgroups form one sequence.
    own = [b.same(f"own_{k}_any", kind.any()) for k, kind in enumerate(unit.own)]
    b.always(own[0] == b.past(unit.own_kind.any()))
    from_subgroup = [sends, b.past(sends), b.past(sends, 2) & ~own[2], unit.valid_in]
    for k in range(latency.GRANT_TO_BEAT):
        b.always(pipe[k] == (own[k] | from_subgroup[k]))
        b.always(~(own[k] & from_subgroup[k]))
    b.always(
        rest == Mux(b.past(active) & ~own[0] & ~unit.grant.any(), unit.left + 1, 0),
        where=~unit.grant.any(),
    )
    b.always(unit.left == _length(unit.send, form) - 1, where=unit.grant.any())
    b.always(unit.event_length == _length(bus.Send.EVENT, form), where=b.past(1))

    # Beats that moved in the last cycles are on their way. If nothing has moved for a long time, everything is empty.
    for cycles in range(1, latency.GRANT_TO_BEAT + 1):
        b.always(pipe[:cycles] == 0, where=unit.calm >= cycles)
    b.always(unit.buffer.level == 0, where=unit.calm >= latency.GRANT_TO_BEAT + 3)

    # `tlast` marks the last beat of the last subgroup's counters after the frame end's header, and no other beat.
    expected = Signal(range(N * PARTS.counter_beats + 1))
    ends_here = unit.own[-1] == FRAME_END.code
    with m.If(ends_here):
        m.d.sync += expected.eq(N * PARTS.counter_beats)
    with m.Elif(unit.buffer.w_en & (expected != 0)):
        m.d.sync += expected.eq(expected - 1)
    b.always(
        unit.buffer.w_data[BEAT_BITS] == ((expected == 1) & unit.valid_in & ~ends_here),
        where=unit.buffer.w_en,
    )
    in_counters, in_flush = unit.machine.ongoing("counters"), unit.machine.ongoing("flush")
    ungranted = b.same(
        "ungranted",
        Mux(in_counters, sum((Mux(unit.tail[s], N - s, 0) for s in range(N)), start=0), 0),
    )
    to_come = b.same("to_come", ungranted * PARTS.counter_beats + unit.left)
    is_end = [b.same(f"own_{k}_ends", kind == FRAME_END.code) for k, kind in enumerate(unit.own)]
    end_coming = b.same("end_coming", Cat(is_end).any())
    for k, here in enumerate(is_end):
        b.always(to_come + sum(pipe[:k], start=0) == N * PARTS.counter_beats, where=here)
        b.always((in_counters | in_flush) & ~Cat(is_end[k + 1 :]).any(), where=here)
        b.always((expected == 0) & ~Cat(unit.own[:k]).any(), where=here)
        b.always(unit.own[k] == 0, where=expected != 0)
    b.always(expected == to_come + on_the_way, where=(in_counters | in_flush) & ~end_coming)
    b.always(expected == 0, where=~in_counters & ~in_flush)
    b.always(unit.to_end == expected)
    b.always(unit.owes == ~(idle | (in_flush & (expected == 0) & ~end_coming)))
    b.always(~unit.filling)

    # The threshold controller has received all counters before the end packet has left.
    b.always(~unit.counted.valid, where=unit.delivered)

    # An offered beat stays until it is taken.
    b.stable(
        Cat(unit.buffer.r_rdy, unit.buffer.r_data),
        where=unit.buffer.r_rdy & ~taken & ~unit.frame_begin_in,
    )
    b.cover(taken & (unit.buffer.r_data[KIND_LSB:BEAT_BITS] == FRAME_START.code))


@proof(depth=3, cover=12)
def packetizer(b: Bench):
    """A grant gives a packet of exact length without gaps; its last beat, and no other, frees the place."""
    m, unit = b.m, Packetizer(SMALL)
    grant, send, form = unit.grant, unit.send, b.constant(bits_for(HIGHEST_FORMAT))
    b.assume((form <= HIGHEST_FORMAT) & (send.as_value() <= 2))
    b.place(unit, frame=None)
    m.d.comb += unit.frame.format.eq(form)
    rest, kind = Signal(range(PARTS.longest + 1)), Signal(bus.Send)
    b.assume(~grant, where=rest != 0)  # as proven for the readout
    length = b.same("length", _length(send, form))
    active = b.same("active_now", grant | (rest != 0))
    last = b.same("last_now", Mux(grant, length == 1, rest == 1))
    m.d.sync += rest.eq(Mux(grant, length - 1, rest - (rest != 0)))
    with m.If(grant):
        m.d.sync += kind.eq(send)
    now = Mux(grant, send.as_value(), kind.as_value())
    b.always(unit.valid == b.past(active))
    b.always((unit.beat == 0) & ~unit.beat_controlled, where=~unit.valid)
    b.always(unit.take_event == (active & last & (now == bus.Send.EVENT)))
    b.always(unit.take_record == (active & last & (now == bus.Send.RECORD)))
    b.always(kind.as_value() <= 2)
    b.always(unit.sending == (rest != 0))
    b.always(unit.at_last == (rest == 1), where=rest != 0)
    b.always(
        (unit.send_before == kind) & (unit.index_before + rest == _length(kind, form)),
        where=rest != 0,
    )
    window, of_now = (
        unit.head.window,
        {send: b.past(active & (now == send)) for send in (bus.Send.EVENT, bus.Send.RECORD)},
    )
    of_event = {name: window[name] for name in ("stamp", "count", "winner")} | {"map": window.hits}
    of_event |= {name: unit.head[name] for name in ("overrun", "pulse")} | {
        "subgroup": unit.subgroup
    }
    of_record = {"pulse": unit.record.pulse, "subgroup": unit.subgroup}
    room = Const(0, SMALL.record_bits)  # of an entry in the packet
    of_record["entries"] = Cat(
        unit.record.entries[g].as_value() | room for g in range(SMALL.minigroups)
    )
    index = Signal(range(PARTS.longest))  # of the beat that was formed in the last cycle
    m.d.sync += index.eq(Mux(grant, 0, index + 1))
    b.always(index + 1 == unit.index_before, where=rest != 0)
    for number, packet in enumerate(FORMATS.values()):
        of_format = of_now[bus.Send.EVENT] & (form == number)
        b.always(unit.beat[KIND_LSB:] == packet.code, where=of_format & (index == 0))
        b.cover(b.past(unit.take_event) & (form == number))
        _carries(b, unit.beat, index, packet, of_event, of_format)
    _carries(b, unit.beat, index, RECORD, of_record, of_now[bus.Send.RECORD])
    b.cover(b.past(unit.take_record))
    b.cover(b.past(rest == 1) & (b.past(now) == bus.Send.COUNTERS))
