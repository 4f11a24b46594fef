# SPDX-License-Identifier: Apache-2.0
"""Proofs of the event FIFO and of the record buffer.

Depth is only a parameter of counters. So a proof for a FIFO of two places, and one for three, which
is no power of two, holds for any depth. An event is an opaque word to the FIFO, so the smallest
subgroup is sufficient.
"""

from amaranth.hdl import Mux, Signal
from attrs import evolve

from ..hdl import bus
from ..hdl.fifo import EventFifo, RecordBuffer
from .proof_bench import Bench, elaborated, proof
from .sensors import SMALL


def _event_fifo(b: Bench, depth: int) -> None:
    sensor = evolve(SMALL, fifo_depth=depth)
    m, unit = b.m, b.place(EventFifo(sensor))
    commit, take, begin = unit.commit, unit.take, unit.frame_begin
    elaborated(unit.rows)
    memory = unit.rows.rows

    # The readout only takes an event that is at the head, and a frame begins with an empty FIFO.
    level = Signal(range(depth + 1))
    b.assume(level != 0, where=take)
    b.assume(level == 0, where=begin)
    b.assume(~commit, where=begin)

    stored = b.same("stored_now", commit & (level != depth))
    dropped = b.same("dropped_now", commit & (level == depth))
    m.d.sync += level.eq(level + stored - take)
    b.always((level == unit.level) & (level <= depth))
    b.always(unit.stored == b.past(stored))  # each committed event is stored
    # Or, if the FIFO is full, counted as dropped, but never both.
    b.always(unit.dropped == b.past(dropped))
    b.always(~(unit.stored & unit.dropped))

    # Overrun: events were dropped since the last one that was stored in this frame.
    lost = Signal()
    m.d.sync += lost.eq(Mux(begin, 0, Mux(commit, dropped, lost)))
    b.always(lost == unit.lost)

    # An arbitrary event leaves after all those that were there before it, before all later ones,
    # and intact.
    watch = b.same("watch", b.anything(1) & stored)
    watched = Signal()
    ahead = Signal(range(depth + 1))
    event = Signal(bus.event_layout(sensor))
    with m.If(watch & ~watched):
        m.d.sync += [
            watched.eq(1),
            ahead.eq(level - take),
            event.window.eq(unit.event),
            event.offsets.eq(unit.offsets),
            event.pulse.eq(unit.pulse),
            event.overrun.eq(lost),
        ]
    with m.Elif(watched & take):
        m.d.sync += [ahead.eq(ahead - 1), watched.eq(ahead != 0)]
    b.always(unit.head.as_value() == event.as_value(), where=watched & (ahead == 0))

    # Invariants: the rows in use are those from `row` to `to`, and the event is in its own row.
    after_last = b.same("after_last", unit.row + level)
    b.always((unit.to < depth) & (unit.row < depth))
    b.always(unit.to == Mux(after_last >= depth, after_last - depth, after_last))
    b.always(ahead < level, where=watched)
    behind = b.same("behind", unit.row + ahead)
    look = memory.read_port(domain="comb")
    b.m.d.comb += look.addr.eq(Mux(behind >= depth, behind - depth, behind))
    b.always(look.data == event.as_value(), where=watched)

    b.cover(dropped & lost)
    b.cover(watched & take & (ahead == 0) & event.overrun)
    b.cover((level == depth) & take)


@proof(depth=3, cover=14)
def event_fifo(b):
    """Events leave whole and in order; each is stored, or counted as dropped if full; overrun
    exactly after drops.
    """
    _event_fifo(b, 2)


@proof(depth=3, cover=14)
def event_fifo_of_three(b):
    """Events leave whole and in order, for a depth that is no power of two."""
    _event_fifo(b, 3)


@proof(depth=2, cover=8)
def record_buffer(b):
    """A record is stored if the place is free, else counted as dropped; it stays until taken;
    unlatched entries are 0.
    """
    m, unit = b.m, b.place(RecordBuffer(SMALL))
    due, take, begin = unit.due, unit.take, unit.frame_begin
    waiting = Signal()
    b.assume(waiting, where=take)
    comes = b.same("comes", due & (unit.latched != 0))
    stored = b.same("stored_now", comes & ~waiting)
    m.d.sync += waiting.eq(Mux(stored, 1, waiting & ~take & ~begin))
    b.always(waiting == unit.waiting)
    b.always(unit.stored == b.past(stored))
    b.always(unit.dropped == b.past(comes & waiting))
    kept = Signal(bus.record_layout(SMALL))
    with m.If(stored):
        m.d.sync += kept.pulse.eq(unit.pulse)
        for g in range(SMALL.minigroups):
            m.d.sync += kept.entries[g].eq(Mux(unit.latched[g], unit.entries[g].as_value(), 0))
    b.always(unit.record.as_value() == kept.as_value(), where=waiting)
    b.cover(comes & waiting)
    b.cover(take & due)
