# SPDX-License-Identifier: Apache-2.0
"""Proofs of readout and packetizer.

An order can only be wrong among three or more subgroups. The arbiter treats its bits alike, so the bounds read n for 3.
"""

from amaranth.hdl import Cat, Mux, Signal

from ..hdl import bus
from ..hdl.packetizer import Packetizer
from ..hdl.readout import Readout
from ..model.contract import latency
from ..model.contract.packet import BEAT_BITS, FORMATS, FRAME_END, FRAME_START, KIND_LSB, RECORD, layout, parts_of
from ..model.contract.parameters import bits_for
from .proof_bench import Bench, proof
from .sensors import SMALL

N = 3
PARTS = layout(SMALL)
HIGHEST_FORMAT = len(FORMATS) - 1
SUBGROUP_TO_BEAT = latency.GRANT_TO_BEAT - 2  # from a grant's register to the beat at the readout's input


def _length(send, form):
    """Return the beats of a packet by the contract, independent of the RTL's multiplexer."""
    event = 0
    for number, packet in enumerate(FORMATS.values()):
        event = Mux(form == number, PARTS.length(packet), event)
    record = PARTS.length(RECORD)
    return Mux(send == bus.Send.EVENT, event, Mux(send == bus.Send.RECORD, record, PARTS.counter_beats))


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
    taken = b.free(unit.state.coder)["take"]
    b.free(unit.state.packer)
    grouped = b.same("grouped", Cat(form == n for n, packet in enumerate(FORMATS.values()) if packet.grouped).any())
    b.assume(unit.state.buffer.r_rdy, where=taken)
    b.assume(taken == (unit.state.buffer.r_rdy & ready), where=~grouped)
    body = b.place(unit, frame=frame, valid=b.past(sends, SUBGROUP_TO_BEAT))
    idle = body.machine.ongoing("idle")

    # A subgroup reports no more events than its FIFO holds. From `finish` until the next frame, nothing is stored.
    events = [Signal(range(SMALL.fifo_depth + 1), name=f"events_of_{s}") for s in range(N)]
    for s in range(N):
        m.d.sync += events[s].eq(events[s] + body.stored[s] - body.take_event[s])
        b.assume(events[s] + body.stored[s] < SMALL.fifo_depth, where=stored[s])
        b.assume(~body.records[s] & ~body.record_stored[s], where=record_stored[s])
    b.assume(~stored.any() & ~record_stored.any(), where=finish | ~body.in_frame)
    b.assume(finish, where=b.past(finish) & body.in_frame)  # `finish` stays until everything is delivered
    b.assume(idle & unit.delivered & ~body.frame_begin, where=begin)
    b.always(idle, where=body.frame_begin)

    # At most one grant, to a subgroup that has the granted kind.
    b.always((unit.grant & (unit.grant - 1)) == 0)
    had_event = Cat(b.past(events[s] != 0) for s in range(N))
    b.always((unit.grant & ~had_event) == 0, where=unit.grant.any() & (unit.send == bus.Send.EVENT))
    b.always((unit.grant & ~b.past(body.records)) == 0, where=unit.grant.any() & (unit.send == bus.Send.RECORD))
    for s in range(N):
        b.always((Cat(plane[s] for plane in body.planes) == events[s]) & (events[s] <= SMALL.fifo_depth))
        b.always(body.some_events[s] == (events[s] != 0))

    # A waiting subgroup sees at most n - 1 grants to others. Distance: others that come before it in the round.
    in_events = body.machine.ongoing("events")
    takes = body.take_event | body.take_record
    grants = b.same("grants", takes.any())
    granted = b.same(
        "granted", grants | body.own_kind.any() | (body.machine.ongoing("counters") & body.free_for_counters)
    )
    for s in range(N):
        others = Signal(range(N + 1), name=f"others_{s}")
        waits = body.waiting[s]
        m.d.sync += others.eq(Mux(~waits | (grants & body.chosen[s]), 0, others + grants))
        distance = Signal(range(N), name=f"distance_{s}")
        for pointer in range(N + 1):  # at_or_after: all subgroups from the pointer on
            with m.If(body.at_or_after == (((1 << N) - 1) & ~((1 << pointer) - 1))):
                m.d.comb += distance.eq((s - pointer) % N)
        b.always(others <= N - 1)
        b.always(others + distance <= N - 1, where=waits)
        b.always(others == 0, where=~in_events)
        b.cover((others == N - 1) & grants & body.chosen[s])
    b.always(
        sum((body.at_or_after == (((1 << N) - 1) & ~((1 << pointer) - 1)) for pointer in range(N + 1)), start=0) == 1
    )
    # A grant comes as soon as all beats of the previous packet have been granted and the buffer has room.
    b.always(
        unit.grant.any(),
        where=b.past(in_events & body.waiting.any() & (body.left == 0) & (body.space >= PARTS.longest_word)),
    )
    b.always(
        ~body.waiting.any() & ~body.stored.any() & ~body.record_stored.any(),
        where=~in_events & ~body.machine.ongoing("head"),
    )
    b.always(
        sum((body.machine.ongoing(name) for name in ("idle", "head", "events", "counters", "flush")), start=0) == 1
    )
    b.always(~body.stored.any() & ~body.record_stored.any(), where=body.finish | idle)
    b.always(((body.tail & (body.tail - 1)) == 0) & body.tail.any(), where=body.machine.ongoing("counters"))
    b.always(body.finish, where=body.machine.ongoing("counters") | body.machine.ongoing("flush"))
    b.always(b.past(unit.finish) | ~b.past(1), where=body.finish)

    # The buffer: a place is taken at the grant, and is free again when the beat has left.
    active = b.same("active", granted | (body.left != 0))
    pipe = Signal(latency.GRANT_TO_BEAT)
    m.d.sync += pipe.eq(pipe << 1 | active)
    on_the_way = sum(pipe, start=0)
    # The library's FIFO holds one more in a register.
    stored_beats = b.same("stored_beats", body.buffer.level - body.buffer.r_rdy)
    for room, beats in zip(body.room, unit.rooms):
        b.always(room == (body.space >= beats))
    for beyond, beats in zip(body.event_exceeds, unit.rooms):
        b.always(beyond == body.event_length + beats - 1)
    b.always(body.event_last == body.event_length - 1, where=b.past(1))
    b.always(body.taken == b.past(taken))
    b.always(body.grouped == grouped, where=b.past(1))
    given_back_later = grouped & body.taken
    b.always(body.space + body.left + on_the_way + body.buffer.level + given_back_later == unit.depth)
    b.always(
        (stored_beats >= 0) & (stored_beats <= unit.depth) & (body.left < PARTS.longest) & (body.space <= unit.depth)
    )
    b.always(body.buffer.w_rdy, where=body.buffer.w_en)
    b.always(body.buffer.w_en == pipe[-1])
    b.always(body.space == unit.depth, where=idle)
    # Invariants: the beats of the readout and of the subgroups form one sequence.
    own = [b.same(f"own_{k}_any", kind.any()) for k, kind in enumerate(body.own)]
    b.always(own[0] == b.past(body.own_kind.any()))
    from_subgroup = [sends, b.past(sends), b.past(sends, 2) & ~own[2], body.valid]
    for k in range(latency.GRANT_TO_BEAT):
        b.always(pipe[k] == (own[k] | from_subgroup[k]))
        b.always(~(own[k] & from_subgroup[k]))
    b.always(rest == Mux(b.past(active) & ~own[0] & ~unit.grant.any(), body.left + 1, 0), where=~unit.grant.any())
    b.always(body.left == _length(unit.send, form) - 1, where=unit.grant.any())
    b.always(body.event_length == _length(bus.Send.EVENT, form), where=b.past(1))

    # Beats that moved in the last cycles are on their way. If nothing has moved for a long time, everything is empty.
    for cycles in range(1, latency.GRANT_TO_BEAT + 1):
        b.always(pipe[:cycles] == 0, where=body.calm >= cycles)
    b.always(body.buffer.level == 0, where=body.calm >= latency.GRANT_TO_BEAT + 3)

    # `tlast` marks the last beat of the last subgroup's counters after the frame end's header, and no other beat.
    expected = Signal(range(N * PARTS.counter_beats + 1))
    ends_here = body.own[-1] == FRAME_END.code
    with m.If(ends_here):
        m.d.sync += expected.eq(N * PARTS.counter_beats)
    with m.Elif(body.buffer.w_en & (expected != 0)):
        m.d.sync += expected.eq(expected - 1)
    b.always(body.buffer.w_data[BEAT_BITS] == ((expected == 1) & body.valid & ~ends_here), where=body.buffer.w_en)
    in_counters, in_flush = body.machine.ongoing("counters"), body.machine.ongoing("flush")
    ungranted = b.same("ungranted", Mux(in_counters, sum((Mux(body.tail[s], N - s, 0) for s in range(N)), start=0), 0))
    to_come = b.same("to_come", ungranted * PARTS.counter_beats + body.left)
    is_end = [b.same(f"own_{k}_ends", kind == FRAME_END.code) for k, kind in enumerate(body.own)]
    end_coming = b.same("end_coming", Cat(is_end).any())
    for k, here in enumerate(is_end):
        b.always(to_come + sum(pipe[:k], start=0) == N * PARTS.counter_beats, where=here)
        b.always((in_counters | in_flush) & ~Cat(is_end[k + 1 :]).any(), where=here)
        b.always((expected == 0) & ~Cat(body.own[:k]).any(), where=here)
        b.always(body.own[k] == 0, where=expected != 0)
    b.always(expected == to_come + on_the_way, where=(in_counters | in_flush) & ~end_coming)
    b.always(expected == 0, where=~in_counters & ~in_flush)
    b.always(body.to_end == expected)
    b.always(body.owes == ~(idle | (in_flush & (expected == 0) & ~end_coming)))
    b.always(~body.filling)

    # The threshold controller has received all counters before the end packet has left.
    b.always(~unit.counted.valid, where=unit.delivered)

    # An offered beat stays until it is taken.
    b.stable(Cat(body.buffer.r_rdy, body.buffer.r_data), where=body.buffer.r_rdy & ~taken & ~body.frame_begin)
    b.cover(taken & (body.buffer.r_data[KIND_LSB:BEAT_BITS] == FRAME_START.code))


@proof(depth=3, cover=12)
def packetizer(b: Bench):
    """A grant gives a packet of exact length without gaps; its last beat, and no other, frees the place."""
    m, unit = b.m, Packetizer(SMALL)
    grant, send, form = unit.grant, unit.send, b.constant(bits_for(HIGHEST_FORMAT))
    b.assume((form <= HIGHEST_FORMAT) & (send.as_value() <= 2))
    body = b.place(unit, frame=None)
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
    b.always(unit.beat == 0, where=~unit.valid)
    b.always(unit.take_event == (active & last & (now == bus.Send.EVENT)))
    b.always(unit.take_record == (active & last & (now == bus.Send.RECORD)))
    b.always(kind.as_value() <= 2)
    b.always(body.sending == (rest != 0))
    b.always(body.at_last == (rest == 1), where=rest != 0)
    b.always((body.send_before == kind) & (body.index_before + rest == _length(kind, form)), where=rest != 0)
    window, of_now = (
        unit.head.window,
        {send: b.past(active & (now == send)) for send in (bus.Send.EVENT, bus.Send.RECORD)},
    )
    of_event = {name: window[name] for name in ("stamp", "count", "winner")} | {"map": window.hits}
    of_event |= {name: unit.head[name] for name in ("overrun", "pulse")} | {"subgroup": unit.subgroup}
    of_record = {"pulse": unit.record.pulse, "subgroup": unit.subgroup}
    index = Signal(range(PARTS.longest))  # of the beat that was formed in the last cycle
    m.d.sync += index.eq(Mux(grant, 0, index + 1))
    b.always(index + 1 == body.index_before, where=rest != 0)
    for number, packet in enumerate(FORMATS.values()):
        of_format = of_now[bus.Send.EVENT] & (form == number)
        b.always(unit.beat[KIND_LSB:] == packet.code, where=of_format & (index == 0))
        b.cover(b.past(unit.take_event) & (form == number))
        _carries(b, unit.beat, index, packet, of_event, of_format)
    _carries(b, unit.beat, index, RECORD, of_record, of_now[bus.Send.RECORD])
    b.cover(b.past(unit.take_record))
    b.cover(b.past(rest == 1) & (b.past(now) == bus.Send.COUNTERS))
