"""Event FIFO: keeps the committed events of a subgroup until the readout takes them.

The paper (III-A) names a FIFO register that valid data is written into. Depth, dropping the new event when full, and
the overrun flag are our choice.
"""

from types import SimpleNamespace

from amaranth.hdl import Module, Signal
from amaranth.lib import fifo
from amaranth.lib.wiring import In, Out

from ..model.contract.parameters import Sensor
from . import bus
from .unit import Unit


class EventFifo(Unit):
    """FIFO of a subgroup.

    Ports
    -----
    commit, event, pulse : in, an event to store (stage 8)
    stored, dropped : out, what became of it, one cycle later
    head : out, the oldest event, valid from two cycles after it was stored; take : in, frees its place

    The event after a drop carries `overrun`. A frame begins with the FIFO empty, as the one before was read out
    whole; frame_begin : in, clears the overrun memory. Reset empties.
    """

    unit_name = "coincid_fifo"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            {
                "commit": In(1),
                "event": In(bus.window_layout(sensor)),
                "pulse": In(bus.PULSE_BITS),
                "frame_begin": In(1),
                "stored": Out(1),
                "dropped": Out(1),
                "head": Out(bus.event_layout(sensor)),
                "take": In(1),
            }
        )

    def elaborate(self, platform):
        m = Module()
        depth = self.sensor.fifo_depth
        # One place more than `depth`, so that the library's own limit (its output register apart) is never the one that counts.
        m.submodules.storage = storage = fifo.SyncFIFOBuffered(
            width=bus.event_layout(self.sensor).size, depth=depth + 1
        )
        level = Signal(range(depth + 1))
        lost = Signal()
        room = Signal()
        event = Signal(bus.event_layout(self.sensor))
        m.d.comb += [
            room.eq(level != depth),
            event.window.eq(self.event),
            event.pulse.eq(self.pulse),
            event.overrun.eq(lost),
            storage.w_en.eq(self.commit & room),
            storage.w_data.eq(event),
            storage.r_en.eq(self.take),
            self.head.eq(storage.r_data),
        ]
        m.d.sync += [
            level.eq(level + storage.w_en - self.take),
            self.stored.eq(self.commit & room),
            self.dropped.eq(self.commit & ~room),
        ]
        with m.If(self.frame_begin):
            m.d.sync += lost.eq(0)
        with m.Elif(self.commit):
            m.d.sync += lost.eq(~room)
        self.state = SimpleNamespace(storage=storage, level=level, lost=lost)
        return m


class RecordBuffer(Unit):
    """The place for one minigroup record of a subgroup.

    Ports
    -----
    due : in, a period has ended; latched, entries : in, what its minigroups latched; pulse : in, its number
    stored, dropped : out, what became of the record, one cycle later
    record : out, valid from one cycle after it was stored; take : in, frees its place

    Reset frees the place.
    """

    unit_name = "coincid_record_buffer"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        entries = bus.record_layout(sensor)["entries"].shape
        super().__init__(
            {
                "due": In(1),
                "latched": In(sensor.minigroups),
                "entries": In(entries),
                "pulse": In(bus.PULSE_BITS),
                "stored": Out(1),
                "dropped": Out(1),
                "record": Out(bus.record_layout(sensor)),
                "take": In(1),
            }
        )

    def elaborate(self, platform):
        m = Module()
        waiting = Signal()
        comes = Signal()
        m.d.comb += comes.eq(self.due & self.latched.any())
        m.d.sync += [self.stored.eq(comes & ~waiting), self.dropped.eq(comes & waiting)]
        with m.If(comes & ~waiting):
            m.d.sync += [waiting.eq(1), self.record.pulse.eq(self.pulse)]
            for g in range(self.sensor.minigroups):
                entry = self.entries[g].as_value()
                m.d.sync += self.record.entries[g].eq(entry & self.latched[g].replicate(len(entry)))
        with m.Elif(self.take):
            m.d.sync += waiting.eq(0)
        self.state = SimpleNamespace(waiting=waiting)
        return m
