# SPDX-License-Identifier: Apache-2.0
"""Readout of a stream: round robin over its subgroups, one packet at a time; frame start and end
packets; output buffer.

The paper leaves the readout open. Round robin, credits and the buffer are our choice: the subgroups
report what they have stored, and the readout counts it and grants packets of known length. So their
beats come back in order, without gaps, after a fixed time.
"""

from itertools import pairwise

from amaranth.hdl import Cat, Const, Module, Mux, ResetInserter, Signal
from amaranth.lib import fifo, wiring
from amaranth.lib.wiring import In, Out

from ..model.contract import latency
from ..model.contract.packet import (
    BEAT_BITS,
    COUNTS,
    FRAME_END,
    FRAME_START,
    KIND_BITS,
    RECORD,
    layout,
)
from ..model.contract.parameters import Sensor, bits_for
from . import bus
from .axi import STREAM
from .coder import Coder, is_event_head
from .logic import any_of, up_to
from .packer import Packer
from .packetizer import formed, numbers, of_format
from .unit import Unit, place

CALM_CYCLES = 15  # without grants and beats, after which no beat can be on its way


class Readout(Unit):
    """Readout of a stream with `subgroups` subgroups.

    Ports
    -----
    stored, record_stored : in, one bit per subgroup: an event or record has been stored
    grant : out, one-hot; send : out, what the granted subgroup sends
    valid, beat, beat_controlled : in, OR of the subgroups' beats
    frame, plan : in, settings; number : in, frame number; frame_begin : in, strobe; finish : in,
        nothing more will be stored
    delivered : out, the end packet has left
    counted : out, the counters of the end packet as they pass, for the threshold controller
    m_axis : AXI4-Stream master, `tlast` ends the frame

    The next grant goes to the first subgroup at or after the pointer that has something to send.
    The pointer then moves behind it. A record goes before events, because among events it would
    never find a gap. Latency: `model/contract/latency.py`. Reset empties everything. The beginning
    of a frame does the same, although nothing can be left by then except after an upset.

    No upset makes the readout wait for ever. Places that it wrongly took for occupied are free
    again when nothing has moved for `CALM_CYCLES`; a frame whose last beat was lost ends with a
    frame end packet without counters.
    """

    def __init__(self, sensor: Sensor, subgroups: int):
        self.sensor = sensor
        self.subgroups = subgroups
        self.parts = layout(sensor)
        # Beats of the longest word, and of counters.
        self.rooms = (self.parts.longest_word, self.parts.counter_beats)
        # Depth of the output buffer, in beats.
        self.depth = latency.output_depth(self.parts.longest)
        self.unit_name = f"coincid_readout_{subgroups}"
        super().__init__(
            stored=In(subgroups),
            record_stored=In(subgroups),
            grant=Out(subgroups),
            send=Out(bus.Send),
            valid=In(1),
            beat=In(BEAT_BITS),
            beat_controlled=In(1),
            frame=In(bus.frame_layout(sensor)),
            plan=In(bus.plan_layout(sensor)),
            number=In(bus.PULSE_BITS),
            frame_begin=In(1),
            finish=In(1),
            delivered=Out(1),
            counted=Out(bus.COUNTED),
            m_axis=Out(STREAM),
        )
        self._input_registers()
        self._waiting_events()
        self._free_space()
        self._own_packets()
        self.buffer = fifo.SyncFIFOBuffered(width=BEAT_BITS + 2, depth=self.depth + 1)
        self.buffer._MustUse__silence = True  # as in `Unit`
        self.coder = Coder(sensor)
        self.packer = Packer(sensor)

    def _input_registers(self):
        """Registers of the inputs, which are ignored outside a frame, and of the frame's format."""
        longest = self.parts.longest
        self.in_frame = Signal()
        self.stored_in = Signal(self.subgroups)
        self.record_stored_in = Signal(self.subgroups)
        self.frame_begin_in = Signal()
        self.finish_in = Signal()
        self.valid_in = Signal()
        self.beat_in = Signal(BEAT_BITS)
        self.beat_controlled_in = Signal()
        self.grouped = Signal()  # the format packs events into groups
        self.with_offsets = Signal()  # the format has offsets
        self.event_length = Signal(range(longest + 1))  # beats of an event
        self.event_last = Signal(range(longest))  # the same - 1
        # If there is more space than this, an event leaves room for a word, or for counters.
        self.event_exceeds = [
            Signal(range(2 * longest), init=beats - 1, name=f"event_exceeds_{beats}")
            for beats in self.rooms
        ]

    def _waiting_events(self):
        """Signals of the arbiter; each has one bit per subgroup."""
        n = self.subgroups
        # Bits of the number of events that wait in each subgroup, the lowest bit first.
        self.planes = [
            Signal(n, name=f"planes_{b}") for b in range(bits_for(self.sensor.fifo_depth))
        ]
        self.some_events = Signal(n)  # this number is not 0
        self.records = Signal(n)  # a record waits
        self.waiting = Signal(n)  # an event or a record waits
        self.at_or_after = Signal(n, init=-1)  # all subgroups from the pointer on
        self.from_chosen = Signal(n)  # the chosen subgroup and all above it
        self.chosen = Signal(n)  # the subgroup that is granted next, one-hot
        self.chosen_record = Signal()  # it has a record, which goes first
        self.take_event = Signal(n)  # an event is granted
        self.take_record = Signal(n)  # a record is granted

    def _free_space(self):
        """Signals that say whether a packet may begin."""
        # There is room for a word, and for counters.
        self.room = [Signal(init=1, name=f"room_{beats}") for beats in self.rooms]
        self.room_next = [Signal(name=f"room_next_{beats}") for beats in self.rooms]
        self.left = Signal(range(self.parts.longest))  # beats still to be granted
        self.left_next = Signal(range(self.parts.longest))
        self.space = Signal(range(self.depth + 1), init=self.depth)  # free places in the buffer
        self.space_next = Signal(range(self.depth + 1), init=self.depth)
        self.taken = Signal()  # a beat has left the buffer one cycle ago
        self.gone = Signal()  # its place is free
        self.free = Signal()  # a word may begin
        self.free_for_counters = Signal()  # counters may begin
        self.booked = Signal()  # a packet begins
        self.calm = Signal(range(CALM_CYCLES + 1))  # cycles without grants and beats

    def _own_packets(self):
        """Signals of the readout's own packets, and of the frame's end."""
        self.own_kind = Signal(KIND_BITS)  # kind of the packet of its own that is granted; 0: none
        # The same for those on their way to the output.
        self.own = [Signal(KIND_BITS, name=f"own_{k}") for k in range(latency.GRANT_TO_BEAT)]
        self.tail = Signal(self.subgroups)  # the subgroup whose counters are next, one-hot
        # Counts of minigroups.
        self.counting = Signal()  # the frame has counts
        self.counted_all = Signal()  # all of them have been granted
        self.minigroup = Signal(range(self.sensor.minigroups))  # the next one
        self.owes = Signal()  # the frame's last beat has not left
        self.filling = Signal()  # it was lost and is sent again
        # Beats after the header of the frame end.
        self.to_end = Signal(range(self.parts.counter_beats * self.subgroups + 1))

    def elaborate(self, platform):
        m = Module()
        self._inputs(m)
        self._arbiter(m)
        self._room(m)
        self._packets(m)
        self._output(m)
        self._port(m, platform)
        return m

    def _inputs(self, m):
        """Register the inputs.

        Outside a frame they are ignored: after a reset, the modules may still report old data.
        """
        n = self.subgroups
        m.d.sync += [
            self.stored_in.eq(self.stored & self.in_frame.replicate(n)),
            self.record_stored_in.eq(self.record_stored & self.in_frame.replicate(n)),
            self.frame_begin_in.eq(self.frame_begin),
            self.finish_in.eq(self.finish),
            self.valid_in.eq(self.valid & self.in_frame),
            self.beat_in.eq(self.beat),
            self.beat_controlled_in.eq(self.beat_controlled),
            self.grouped.eq(of_format(self.frame.format, lambda packet: int(packet.grouped))),
            self.with_offsets.eq(
                of_format(self.frame.format, lambda packet: int(packet.has("offsets")))
            ),
            self.event_length.eq(of_format(self.frame.format, self.parts.length)),
            self.event_last.eq(self._event_and(-1)),
            *(
                beyond.eq(self._event_and(beats - 1))
                for beats, beyond in zip(self.rooms, self.event_exceeds, strict=True)
            ),
        ]

        if self.sensor.counts:
            is_counts = bus.is_counts(self.frame.format)
            m.d.sync += self.counting.eq(is_counts)
            with m.If(is_counts):
                m.d.sync += self.grouped.eq(0)

    def _event_and(self, beats):
        """Return the number of beats of an event in the frame's format, plus `beats`."""
        return of_format(self.frame.format, lambda packet: self.parts.length(packet) + beats)

    def _arbiter(self, m):
        """Choose the next subgroup: the lowest waiting one at or after the pointer, otherwise the
        lowest of all.

        Each subgroup has a counter of waiting events, and a bit for a waiting record.
        """
        ahead = Signal(self.subgroups)
        self._credits(m, self.stored_in, self.take_event)
        m.d.sync += self.records.eq((self.records & ~self.take_record) | self.record_stored_in)
        with m.If(self.frame_begin_in):
            m.d.sync += [plane.eq(0) for plane in (*self.planes, self.records)]
        m.d.comb += [
            self.waiting.eq(self.some_events | self.records),
            ahead.eq(self.waiting & self.at_or_after),
        ]
        from_ahead = up_to(m, ahead, "from_ahead")
        from_all = up_to(m, self.waiting, "from_all")
        m.d.comb += [
            self.from_chosen.eq(Mux(from_ahead[-1], from_ahead, from_all)),
            self.chosen.eq(self.from_chosen & ~(self.from_chosen << 1)),
            self.chosen_record.eq((self.chosen & self.records).any()),
        ]

    def _credits(self, m, up, down):
        """Count the events of each subgroup, in bit planes.

        Further registers know which counters are not 0.
        """
        planes = self.planes
        some = self.some_events
        carries = Signal(self.subgroups)
        borrows = Signal(self.subgroups)
        m.d.comb += [carries.eq(up & ~down), borrows.eq(down & ~up)]
        # Whether all lower planes are ones, or zeros; known before the grant.
        ones = ~Const(0, self.subgroups)
        zeros = ~Const(0, self.subgroups)
        for plane in planes:
            m.d.sync += plane.eq(plane ^ (carries & ones) ^ (borrows & zeros))
            ones = ones & plane
            zeros = zeros & ~plane
        several = any_of(m, planes[1:], "several_of") if len(planes) > 1 else 0
        m.d.sync += some.eq(up | (some & (~down | several)))

    def _room(self, m):
        """Decide when a packet may begin.

        All beats of the previous one must be granted, and the buffer must have room for any word,
        or for the counters. Two registers know whether it has, so no grant waits for a comparison.
        """
        m.d.comb += [
            self.free.eq((self.left == 0) & self.room[0]),
            self.free_for_counters.eq((self.left == 0) & self.room[1]),
            *(
                after.eq(self._space_exceeds(beats - 1))
                for after, beats in zip(self.room_next, self.rooms, strict=True)
            ),
            self.gone.eq(Mux(self.grouped, self.taken, self.buffer.r_rdy & self.m_axis.tready)),
            self.left_next.eq(self.left - (self.left != 0)),
            self.space_next.eq(Mux(self.gone, self.space + 1, self.space)),
        ]
        m.d.sync += self.taken.eq(self.buffer.r_rdy & self.buffer.r_en)
        m.d.sync += [self.left.eq(self.left_next), self.space.eq(self.space_next)]
        for room, after in zip(self.room, self.room_next, strict=True):
            m.d.sync += room.eq(after)
        with m.If(self.buffer.r_rdy | self.valid_in | (self.left != 0) | self.booked):
            m.d.sync += self.calm.eq(0)
        with m.Elif(self.calm != CALM_CYCLES):
            m.d.sync += self.calm.eq(self.calm + 1)
        with m.Else():
            m.d.sync += [self.space.eq(self.depth), *(room.eq(1) for room in self.room)]
        with m.If(self.frame_begin_in):
            m.d.sync += [self.space.eq(self.depth), self.left.eq(0), self.taken.eq(0)]
            m.d.sync += [room.eq(1) for room in self.room]

    def _space_exceeds(self, beats):
        """Return whether there is space for more than `beats`, including the place of a beat that
        leaves now.

        No carry waits for the stream's `tready`; it only selects.
        """
        return Mux(self.gone, self.space >= beats, self.space > beats)

    def _book(self, m, length, name, free):
        """Book room for a packet that may begin.

        The remaining space is computed for each length before the grant is known.

        length: None for an event.
        """
        if length is None:
            length, last, exceeds = self.event_length, self.event_last, self.event_exceeds
        else:
            last, exceeds = length - 1, [length + beats - 1 for beats in self.rooms]
        after = Signal.like(self.space, name=f"space_after_{name}")
        m.d.comb += after.eq(Mux(self.gone, self.space - last, self.space - length))
        leaves = [Signal(name=f"{name}_leaves_{beats}") for beats in self.rooms]
        for beats, left in zip(exceeds, leaves, strict=True):
            m.d.comb += left.eq(self._space_exceeds(beats))
        with m.If(free):
            m.d.comb += [self.left_next.eq(last), self.space_next.eq(after), self.booked.eq(1)]
            for room, left in zip(self.room_next, leaves, strict=True):
                m.d.comb += room.eq(left)

    def _packets(self, m):
        """Send a frame's packets in order: start, events and records, end, counters of every
        subgroup.
        """
        m.d.sync += [self.grant.eq(0), self.delivered.eq(0)]
        with m.FSM() as self.machine:
            with m.State("idle"):
                m.d.sync += self.delivered.eq(~self.owes)
                with m.If(self.frame_begin_in):
                    m.next = "head"
                with m.Elif(self.owes & self.finish_in):  # only after an upset
                    m.next = "events"
            with m.State("head"):
                self._book(m, 1, "start", self.free)
                m.d.sync += self.at_or_after.eq(~0)
                if self.sensor.counts:
                    m.d.sync += [
                        self.tail.eq(1),
                        self.minigroup.eq(0),
                        self.counted_all.eq(~self.counting),
                    ]
                with m.If(self.free):
                    m.d.comb += self.own_kind.eq(FRAME_START.code)
                    m.next = "events"
                self._begin_again(m)
            with m.State("events"):
                with m.If(self.waiting.any()):
                    self._grant_chosen(m)
                if self.sensor.counts:
                    with m.Elif(self.finish_in & ~self.counted_all):
                        self._grant_counts(m)
                with m.Elif(self.finish_in):
                    self._book(m, 1, "end", self.free)
                    m.d.sync += self.tail.eq(1)
                    with m.If(self.free):
                        m.d.comb += self.own_kind.eq(FRAME_END.code)
                        m.next = "counters"
                self._begin_again(m)
            with m.State("counters"):
                self._book(m, self.parts.counter_beats, "counters", self.free_for_counters)
                with m.If(self.free_for_counters):
                    m.d.sync += [self.grant.eq(self.tail), self.send.eq(bus.Send.COUNTERS)]
                    m.d.sync += self.tail.eq(self.tail << 1)
                    with m.If(self.tail[-1] | (self.tail == 0)):
                        m.next = "flush"
                self._begin_again(m)
            with m.State("flush"):
                with m.If((self.left == 0) & (self.space == self.depth)):
                    with m.If(self.owes):
                        self._book(m, 1, "fill", self.free)
                        m.d.comb += self.own_kind.eq(FRAME_END.code)
                        m.d.sync += self.filling.eq(1)
                    with m.Else():
                        m.next = "idle"
                self._begin_again(m)
            for code in range(3):  # the codes that are not a state
                with m.State(f"lost_{code}"):
                    m.next = "flush"
        m.d.comb += self.in_frame.eq(~self.machine.ongoing("idle"))

    def _begin_again(self, m):
        """Begin a frame although the previous one has not ended; only after an upset."""
        with m.If(self.frame_begin_in):
            m.next = "head"

    def _grant_chosen(self, m):
        """Grant the chosen subgroup's record or event, and move the pointer behind it."""
        with m.If(self.chosen_record):
            self._book(m, self.parts.length(RECORD), "record", self.free)
        with m.Else():
            self._book(m, None, "event", self.free)
        with m.If(self.free):
            m.d.comb += [
                self.take_record.eq(self.chosen & self.records),
                self.take_event.eq(self.chosen & ~self.records),
            ]
            m.d.sync += [
                self.grant.eq(self.chosen),
                self.send.eq(Mux(self.chosen_record, bus.Send.RECORD, bus.Send.EVENT)),
                self.at_or_after.eq(self.from_chosen << 1),
            ]

    def _grant_counts(self, m):
        """Grant the counts of the next minigroup: all of a subgroup, and then the next subgroup."""
        last = self.minigroup == self.sensor.minigroups - 1
        self._book(m, self.parts.length(COUNTS), "counts", self.free)
        with m.If(self.free):
            m.d.sync += [
                self.grant.eq(self.tail),
                self.send.eq(bus.Send.COUNTS),
                self.minigroup.eq(Mux(last, 0, self.minigroup + 1)),
            ]
            with m.If(last):
                m.d.sync += [
                    self.tail.eq(self.tail << 1),
                    self.counted_all.eq(self.tail[-1] | (self.tail == 0)),
                ]

    def _output(self, m):
        """Buffer the stream.

        Beats come back in the order of the grants; the readout's own beats take the same time.
        """
        counter_beats = self.parts.counter_beats
        own = self.own
        to_end = self.to_end
        for now, later in pairwise([self.own_kind, *own]):
            m.d.sync += later.eq(now)
        starts = own[-1] == FRAME_START.code
        of_start = starts & self.grouped
        if self.sensor.counts:
            of_start = Cat(of_start, starts & self.counting)
        fields = numbers(m, self.sensor, [FRAME_START], own[-1], pulse=self.number, count=of_start)
        (own_beat,) = formed(self.sensor, [FRAME_START], fields)[FRAME_START]
        is_own = own[-1].any()
        with m.If((own[-1] == FRAME_END.code) & ~self.filling):
            m.d.sync += to_end.eq(counter_beats * self.subgroups)
        with m.Elif(self.valid_in & (to_end != 0)):
            m.d.sync += to_end.eq(to_end - 1)
        m.d.comb += [
            self.counted.valid.eq(self.valid_in & (to_end != 0)),
            self.counted.beat.eq(self.beat_in),
            self.counted.controlled.eq(self.beat_controlled_in),
        ]
        m.submodules.buffer = ResetInserter(self.frame_begin_in)(self.buffer)
        last = Signal()
        m.d.comb += last.eq(Mux(is_own, self.filling, to_end == 1))
        with m.If(self.frame_begin_in):
            m.d.sync += [self.owes.eq(1), self.filling.eq(0), to_end.eq(0)]
        with m.Elif(self.buffer.w_en & last):
            m.d.sync += [self.owes.eq(0), self.filling.eq(0)]
        m.d.comb += [
            self.buffer.w_en.eq(self.valid_in | is_own),
            self.buffer.w_data.eq(
                Cat(Mux(is_own, own_beat, self.beat_in), last, is_event_head(self.beat_in))
            ),
        ]

    def _port(self, m, platform):
        """Let the buffer's beats leave as they are, or the events among them in groups."""
        coder = self.coder
        packer = self.packer
        beat = self.buffer.r_data[:BEAT_BITS]
        last = self.buffer.r_data[BEAT_BITS]
        place(
            m,
            "coder",
            coder,
            platform,
            grouped=self.grouped,
            with_offsets=self.with_offsets,
            period=self.plan.period,
            valid=self.buffer.r_rdy,
            beat=beat,
            last=last,
            head=self.buffer.r_data[BEAT_BITS + 1],
            free=packer.free,
            passed=self.m_axis.tready,
            frame_begin=self.frame_begin_in,
        )
        place(
            m,
            "packer",
            packer,
            platform,
            offer=coder.offer,
            part=coder.part,
            bits=coder.bits,
            close=coder.close,
            passes=coder.passes,
            beat=beat,
            last=last,
            frame_begin=self.frame_begin_in,
        )
        wiring.connect(m, wiring.flipped(self.m_axis), packer.m_axis)
        m.d.comb += self.buffer.r_en.eq(coder.take)
