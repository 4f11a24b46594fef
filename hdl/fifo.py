# SPDX-License-Identifier: Apache-2.0
"""Event FIFO: stores the committed events of a subgroup until the readout takes them.

The paper (III-A) names a FIFO register that valid data is written into. Our choices are its depth,
the overrun flag, and that a new event is dropped when the FIFO is full.
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
    test_enable : in, opens the latches for a test of the chip

    The first event after a drop carries `overrun`. The FIFO is empty when a frame begins, because
    the previous frame was read out completely; `frame_begin` also clears anything that an upset
    left. Reset empties the FIFO.
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
            test_enable=In(1),
        )
        depth = sensor.fifo_depth
        self.rows = Memory(depth, bus.event_layout(sensor).size)
        self.to = Signal(range(depth))  # place of the next event to write
        self.row = Signal(range(depth))  # place of the next event to read
        self.level = Signal(range(depth + 1))  # number of events
        self.lost = Signal()  # events were dropped since the last one that was stored

    def elaborate(self, platform):
        m = Module()
        depth = self.sensor.fifo_depth
        rows = self.rows
        room = Signal()
        write = Signal()
        event = Signal(bus.event_layout(self.sensor))
        place(
            m,
            "storage",
            rows,
            platform,
            write=write,
            data=event,
            test_enable=self.test_enable,
            **rows.at(to=self.to, row=self.row),
        )
        m.d.comb += [
            room.eq(self.level != depth),
            event.window.eq(self.event),
            event.pulse.eq(self.pulse),
            event.overrun.eq(self.lost),
            write.eq(self.commit & room),
            self.head.eq(rows.value),
        ]
        if self.sensor.offsets:
            m.d.comb += event.offsets.eq(self.offsets)
        if depth > 1:
            with m.If(write):
                m.d.sync += self.to.eq(Mux(self.to == depth - 1, 0, self.to + 1))
            with m.If(self.take):
                m.d.sync += self.row.eq(Mux(self.row == depth - 1, 0, self.row + 1))
        with m.If(write | self.take):
            m.d.sync += self.level.eq(self.level + write - self.take)
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
    due : in, a period has ended; latched, entries : in, its minigroup records; pulse : in, its
        number
    stored, dropped : out, the fate of the record, one cycle later
    record : out, valid from one cycle after it was stored; take, frame_begin : in, free the buffer
    test_enable : in, opens the latches for a test of the chip

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
            test_enable=In(1),
        )
        self.waiting = Signal()  # whether a record waits to be read

    def elaborate(self, platform):
        m = Module()
        waiting = self.waiting
        comes = Signal()
        layout = bus.record_layout(self.sensor)
        row = Memory(1, layout.size)
        write = Signal()
        record = Signal(layout)
        place(
            m,
            "row",
            row,
            platform,
            write=write,
            data=record,
            test_enable=self.test_enable,
        )
        m.d.comb += [
            comes.eq(self.due & self.latched.any()),
            record.pulse.eq(self.pulse),
            write.eq(comes & ~waiting),
            self.record.eq(row.value),
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
