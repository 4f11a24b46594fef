# SPDX-License-Identifier: Apache-2.0
"""Event FIFO: stores the committed events of a subgroup until the readout takes them.

The paper (III-A) names a FIFO register that valid data is written into. Our choices are its depth, the overrun flag,
and that a new event is dropped when the FIFO is full.
"""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract.parameters import Sensor
from . import bus
from .memory import Memory
from .unit import Unit, place


class EventFifo(Unit):
    """FIFO of a subgroup.

    Ports
    -----
    commit, event, offsets, pulse : in, an event to store (stage 8)
    stored, dropped : out, the fate of the event, one cycle later
    head : out, the oldest event, read from its row in the same cycle; take : in, frees its place
    frame_begin : in, clears the overrun memory

    The first event after a drop carries `overrun`. The FIFO is empty when a frame begins, because the previous frame was
    read out completely; `frame_begin` also clears anything that an upset left. Reset empties the FIFO.
    """

    unit_name = "coincid_fifo"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            commit=In(1),
            event=In(bus.window_layout(sensor)),
            offsets=In(bus.offsets_layout(sensor)),
            pulse=In(bus.PULSE_BITS),
            frame_begin=In(1),
            stored=Out(1),
            dropped=Out(1),
            head=Out(bus.event_layout(sensor)),
            take=In(1),
        )
        # to, row: places of the next event to write and to read; level: number of events; lost: events were dropped since
        # the last one that was stored.
        depth = sensor.fifo_depth
        self.rows = Memory(depth, bus.event_layout(sensor).size)
        self.inner("to row", range(depth))
        self.level = Signal(range(depth + 1))
        self.lost = Signal()

    def elaborate(self, platform):
        m = Module()
        depth = self.sensor.fifo_depth
        rows = place(m, "storage", self.rows, platform)
        room = Signal()
        event = Signal(bus.event_layout(self.sensor))
        m.d.comb += [
            room.eq(self.level != depth),
            event.window.eq(self.event),
            *([event.offsets.eq(self.offsets)] if self.sensor.offsets else []),
            event.pulse.eq(self.pulse),
            event.overrun.eq(self.lost),
            rows.write.eq(self.commit & room),
            rows.data.eq(event),
            self.head.eq(rows.value),
        ]
        if depth > 1:
            m.d.comb += [rows.to.eq(self.to), rows.row.eq(self.row)]
            with m.If(rows.write):
                m.d.sync += self.to.eq(Mux(self.to == depth - 1, 0, self.to + 1))
            with m.If(self.take):
                m.d.sync += self.row.eq(Mux(self.row == depth - 1, 0, self.row + 1))
        with m.If(rows.write | self.take):
            m.d.sync += self.level.eq(self.level + rows.write - self.take)
        m.d.sync += [self.stored.eq(self.commit & room), self.dropped.eq(self.commit & ~room)]
        with m.If(self.frame_begin):
            m.d.sync += [self.lost.eq(0), self.level.eq(0), self.to.eq(0), self.row.eq(0)]
        with m.Elif(self.commit):
            m.d.sync += self.lost.eq(~room)
        return m


class RecordBuffer(Unit):
    """Buffer for one minigroup record of a subgroup.

    Ports
    -----
    due : in, a period has ended; latched, entries : in, its minigroup records; pulse : in, its number
    stored, dropped : out, the fate of the record, one cycle later
    record : out, valid from one cycle after it was stored; take, frame_begin : in, free the buffer

    Reset frees the buffer.
    """

    unit_name = "coincid_record_buffer"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        entries = bus.record_layout(sensor)["entries"].shape
        super().__init__(
            due=In(1),
            latched=In(sensor.minigroups),
            entries=In(entries),
            pulse=In(bus.PULSE_BITS),
            stored=Out(1),
            dropped=Out(1),
            record=Out(bus.record_layout(sensor)),
            take=In(1),
            frame_begin=In(1),
        )
        self.waiting = Signal()  # whether a record waits to be read

    def elaborate(self, platform):
        m = Module()
        waiting = self.waiting
        comes = Signal()
        layout = bus.record_layout(self.sensor)
        place_of_one = place(m, "row", Memory(1, layout.size), platform)
        record = Signal(layout)
        m.d.comb += [
            comes.eq(self.due & self.latched.any()),
            record.pulse.eq(self.pulse),
            place_of_one.write.eq(comes & ~waiting),
            place_of_one.data.eq(record),
            self.record.eq(place_of_one.value),
        ]
        for g in range(self.sensor.minigroups):
            entry = self.entries[g].as_value()
            m.d.comb += record.entries[g].eq(entry & self.latched[g].replicate(len(entry)))
        m.d.sync += [self.stored.eq(comes & ~waiting), self.dropped.eq(comes & waiting)]
        with m.If(comes & ~waiting):
            m.d.sync += waiting.eq(1)
        with m.Elif(self.take | self.frame_begin):
            m.d.sync += waiting.eq(0)
        return m
