"""Readout of a stream: round robin over its subgroups, a packet at a time, frame start and end packets, output buffer.

The paper leaves the readout open. Round robin, credits and the buffer are our choice: subgroups tell what they
stored, the readout counts it and grants packets of known length, so that their beats come back in order, without
gaps, after a fixed time.
"""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import fifo
from amaranth.lib.wiring import In, Out

from ..model.contract import latency
from ..model.contract.packet import BEAT_BITS, FORMAT_NAMES, FORMATS, Kind, layout
from ..model.contract.parameters import Sensor, bits_for
from . import bus
from .axi import STREAM
from .logic import any_of, up_to
from .packetizer import header
from .unit import Unit


class Readout(Unit):
    """Readout of the `subgroups` subgroups of a stream.

    Ports
    -----
    stored, record_stored : in, a bit a subgroup: an event, a record waits to be read
    grant : out, one-hot; send : out, what the granted subgroup sends
    valid, beat : in, OR of the subgroups' beats
    frame : in, settings; number : in, the frame's; frame_begin : in, strobe; finish : in, nothing more will be stored
    delivered : out, the end packet has left
    m_axis : AXI4-Stream master, `tlast` ends the frame

    Next is the first subgroup with something to read at or after the pointer; the pointer then stands behind it. A
    record goes before events, of which it would otherwise never find a gap. Latency: `model/contract/latency.py`. Reset
    empties everything.
    """

    def __init__(self, sensor: Sensor, subgroups: int):
        self.sensor = sensor
        self.subgroups = subgroups
        self.unit_name = f"coincid_readout_{subgroups}"
        super().__init__(
            {
                "stored": In(subgroups),
                "record_stored": In(subgroups),
                "grant": Out(subgroups),
                "send": Out(bus.Send),
                "valid": In(1),
                "beat": In(BEAT_BITS),
                "frame": In(bus.frame_layout(sensor)),
                "number": In(bus.PULSE_BITS),
                "frame_begin": In(1),
                "finish": In(1),
                "delivered": Out(1),
                "m_axis": Out(STREAM),
            }
        )

    def elaborate(self, platform):
        m = Module()
        n, parts = self.subgroups, layout(self.sensor)
        depth = latency.output_depth(parts.longest)
        stored = Signal(n)
        record_stored = Signal(n)
        frame_begin = Signal()
        finish = Signal()
        valid = Signal()
        beat = Signal(BEAT_BITS)
        # Outside a frame nothing counts: what the modules say when the sensor is reset is of the past.
        in_frame = Signal()
        m.d.sync += [
            stored.eq(self.stored & in_frame.replicate(n)),
            record_stored.eq(self.record_stored & in_frame.replicate(n)),
            frame_begin.eq(self.frame_begin),
            finish.eq(self.finish),
            valid.eq(self.valid & in_frame),
            beat.eq(self.beat),
        ]

        # What waits: events as a counter per subgroup, bit by bit side by side; a record as one bit.
        take_event = Signal(n)
        take_record = Signal(n)
        some_events = self._credits(m, stored, take_event)
        records = Signal(n)
        m.d.sync += records.eq((records & ~take_record) | record_stored)

        # Round robin: the lowest of those at or after the pointer, else the lowest of all.
        waiting = Signal(n)
        ahead = Signal(n)
        at_or_after = Signal(n, init=-1)
        from_chosen = Signal(n)  # the chosen one and all above
        chosen = Signal(n)
        chosen_record = Signal()
        m.d.comb += [waiting.eq(some_events | records), ahead.eq(waiting & at_or_after)]
        from_ahead, from_all = up_to(m, ahead, "from_ahead"), up_to(m, waiting, "from_all")
        m.d.comb += [
            from_chosen.eq(Mux(from_ahead[-1], from_ahead, from_all)),
            chosen.eq(from_chosen & ~(from_chosen << 1)),
            chosen_record.eq((chosen & records).any()),
        ]

        # A packet may begin when the one before has been granted all its beats, and the buffer has room for the longest.
        # What a grant leaves of the room is known for each length before it is known what is granted.
        left = Signal(range(parts.longest))
        space = Signal(range(depth + 1), init=depth)
        space_now = Signal.like(space)
        left_next = Signal.like(left)
        space_next = Signal.like(space)
        own_kind = Signal(3)
        free = Signal()
        m.d.comb += [
            free.eq((left == 0) & (space >= parts.longest)),
            space_now.eq(space + (self.m_axis.tvalid & self.m_axis.tready)),
            left_next.eq(left - (left != 0)),
            space_next.eq(space_now),
        ]

        def grant(length, name):
            after = Signal.like(space, name=f"space_after_{name}")
            m.d.comb += after.eq(space_now - length)
            with m.If(free):
                m.d.comb += [left_next.eq(length - 1), space_next.eq(after)]

        event_lengths = [parts.length(FORMATS[name]) for name in FORMAT_NAMES]
        event_length = Signal(range(parts.longest + 1))
        m.d.sync += event_length.eq(
            Mux(
                self.frame.format == 0,
                event_lengths[0],
                Mux(self.frame.format == 1, event_lengths[1], event_lengths[2]),
            )
        )
        tail = Signal(n)
        m.d.sync += [self.grant.eq(0), self.delivered.eq(0)]
        with m.FSM() as machine:
            with m.State("idle"):
                m.d.sync += self.delivered.eq(1)
                with m.If(frame_begin):
                    m.next = "head"
            with m.State("head"):
                grant(1, "start")
                m.d.comb += own_kind.eq(Mux(free, Kind.FRAME_START, 0))
                m.d.sync += at_or_after.eq(~0)
                with m.If(free):
                    m.next = "events"
            with m.State("events"):
                with m.If(waiting.any()):
                    with m.If(chosen_record):
                        grant(parts.length(Kind.RECORD), "record")
                    with m.Else():
                        grant(event_length, "event")
                    with m.If(free):
                        m.d.comb += [take_record.eq(chosen & records), take_event.eq(chosen & ~records)]
                        m.d.sync += [
                            self.grant.eq(chosen),
                            self.send.eq(Mux(chosen_record, bus.Send.RECORD, bus.Send.EVENT)),
                            at_or_after.eq(from_chosen << 1),
                        ]
                with m.Elif(finish):
                    grant(1, "end")
                    m.d.comb += own_kind.eq(Mux(free, Kind.FRAME_END, 0))
                    m.d.sync += tail.eq(1)
                    with m.If(free):
                        m.next = "counters"
            with m.State("counters"):
                grant(parts.counter_beats, "counters")
                with m.If(free):
                    m.d.sync += [self.grant.eq(tail), self.send.eq(bus.Send.COUNTERS), tail.eq(tail << 1)]
                    with m.If(tail[-1]):
                        m.next = "flush"
            with m.State("flush"):
                with m.If((left == 0) & (space == depth)):
                    m.next = "idle"

        m.d.comb += in_frame.eq(~machine.ongoing("idle"))

        # Beats come back in the order of the grants; the readout's own take the same time.
        own = [Signal(3, name=f"own_{k}") for k in range(latency.GRANT_TO_BEAT)]
        m.d.sync += [later.eq(now) for now, later in zip([own_kind, *own], own)]
        own_beat, fields = header(kind=own[-1], pulse=self.number)
        m.d.comb += fields
        m.submodules.buffer = buffer = fifo.SyncFIFOBuffered(width=BEAT_BITS + 1, depth=depth + 1)
        is_own = own[-1].any()
        to_end = Signal(range(parts.counter_beats * n + 1))  # beats after the frame end's header
        m.d.comb += [
            buffer.w_en.eq(valid | is_own),
            buffer.w_data.eq(Cat(Mux(is_own, own_beat, beat), ~is_own & (to_end == 1))),
            Cat(self.m_axis.tdata, self.m_axis.tlast).eq(buffer.r_data),
            self.m_axis.tvalid.eq(buffer.r_rdy),
            buffer.r_en.eq(self.m_axis.tready),
        ]
        with m.If(own[-1] == Kind.FRAME_END):
            m.d.sync += to_end.eq(parts.counter_beats * n)
        with m.Elif(valid & (to_end != 0)):
            m.d.sync += to_end.eq(to_end - 1)
        m.d.sync += [left.eq(left_next), space.eq(space_next)]
        return m

    def _credits(self, m, up, down):
        """Counters, one a subgroup, kept as bit planes; returns which are not 0."""
        planes = [Signal(self.subgroups, name=f"events_{b}") for b in range(bits_for(self.sensor.fifo_depth))]
        carry, borrow = up & ~down, down & ~up
        for b, plane in enumerate(planes):
            carry_in = Signal(self.subgroups, name=f"carry_{b}")
            borrow_in = Signal(self.subgroups, name=f"borrow_{b}")
            m.d.comb += [carry_in.eq(carry), borrow_in.eq(borrow)]
            m.d.sync += plane.eq(plane ^ carry_in ^ borrow_in)
            carry, borrow = carry_in & plane, borrow_in & ~plane
        some = Signal(self.subgroups, name="some_events")
        m.d.comb += some.eq(any_of(m, planes, "some_of"))
        return some
