# SPDX-License-Identifier: Apache-2.0
"""Readout of a stream: round robin over its subgroups, one packet at a time; frame start and end packets; output buffer.

The paper leaves the readout open. Round robin, credits and the buffer are our choice: the subgroups report what they
have stored, and the readout counts it and grants packets of known length. So their beats come back in order, without
gaps, after a fixed time.
"""

from typing import Any

from amaranth.hdl import Cat, Const, Module, Mux, ResetInserter, Signal
from amaranth.lib import fifo, wiring
from amaranth.lib.wiring import In, Out

from ..model.contract import latency
from ..model.contract.packet import BEAT_BITS, FRAME_END, FRAME_START, KIND_BITS, RECORD, layout
from ..model.contract.parameters import Sensor, bits_for
from . import bus
from .axi import STREAM
from .coder import Coder, is_event_head
from .logic import any_of, named, up_to
from .packer import Packer
from .packetizer import formed, numbers, of_format
from .unit import Unit, place

CALM_CYCLES = 15  # no grant, no beat on its way and none in the buffer for so long: more than any beat takes


class ReadoutState:
    """Inner registers and signals of a readout.

    in_frame: outside of it, inputs are ignored. grouped, with_offsets: of the format. event_length, event_last: beats of an
    event, and number of its last one. event_exceeds: with more space than this, an event leaves room for a word, or for
    counters.

    planes: bits of the number of events that wait in each subgroup; some_events: which numbers are not 0. at_or_after: the
    pointer, as all subgroups from it on; from_chosen: the chosen one and all above it.

    room: for a word and for counters. left: beats still to be granted. taken: a beat has left the buffer one cycle ago.
    own: kinds of the readout's own packets on their way to the output; own_kind: of the one that is granted. tail: one-hot,
    the subgroup whose counters are next. owes: the frame's last beat has not left; filling: it was lost and is sent again.
    to_end: beats after the end's header.
    """

    machine: Any

    def __init__(self, readout: "Readout"):
        n, longest, rooms, depth = readout.subgroups, readout.parts.longest, readout.rooms, readout.depth
        self.buffer = fifo.SyncFIFOBuffered(width=BEAT_BITS + 2, depth=depth + 1)
        self.buffer._MustUse__silence = True  # as in `Unit`
        self.coder, self.packer = Coder(readout.sensor), Packer(readout.sensor)
        self.in_frame = Signal()
        self.stored = Signal(n)
        self.record_stored = Signal(n)
        self.frame_begin = Signal()
        self.finish = Signal()
        self.valid = Signal()
        self.beat = Signal(BEAT_BITS)
        self.beat_controlled = Signal()
        self.grouped = Signal()
        self.with_offsets = Signal()
        self.event_length = Signal(range(longest + 1))
        self.event_last = Signal(range(longest))
        self.event_exceeds = [Signal(range(2 * longest), init=beats - 1, name=f"event_and_{beats}") for beats in rooms]
        self.take_event = Signal(n)
        self.take_record = Signal(n)
        self.records = Signal(n)
        self.waiting = Signal(n)
        self.at_or_after = Signal(n, init=-1)
        self.from_chosen = Signal(n)
        self.chosen = Signal(n)
        self.chosen_record = Signal()
        self.planes = [Signal(n, name=f"events_{b}") for b in range(bits_for(readout.sensor.fifo_depth))]
        self.some_events = Signal(n)
        self.room = [Signal(init=1, name=f"room_for_{beats}") for beats in rooms]
        self.room_next = [Signal(name=f"room_next_for_{beats}") for beats in rooms]
        self.left = Signal(range(longest))
        self.space = Signal(range(depth + 1), init=depth)
        self.taken = Signal()
        self.free = Signal()
        self.free_for_counters = Signal()
        self.gone = Signal()
        self.left_next = Signal.like(self.left)
        self.space_next = Signal.like(self.space)
        self.calm = Signal(range(CALM_CYCLES + 1))
        self.booked = Signal()
        self.own_kind = Signal(KIND_BITS)
        self.tail = Signal(n)
        self.owes = Signal()
        self.filling = Signal()
        self.own = [Signal(KIND_BITS, name=f"own_{k}") for k in range(latency.GRANT_TO_BEAT)]
        self.to_end = Signal(range(readout.parts.counter_beats * n + 1))


class Readout(Unit):
    """Readout of a stream with `subgroups` subgroups.

    Ports
    -----
    stored, record_stored : in, one bit per subgroup: an event or record has been stored
    grant : out, one-hot; send : out, what the granted subgroup sends
    valid, beat, beat_controlled : in, OR of the subgroups' beats
    frame, plan : in, settings; number : in, frame number; frame_begin : in, strobe; finish : in, nothing more will be stored
    delivered : out, the end packet has left
    counted : out, the counters of the end packet as they pass, for the threshold controller
    m_axis : AXI4-Stream master, `tlast` ends the frame

    The next to be granted is the first subgroup at or after the pointer that has something to read; the pointer then
    moves behind it. A record goes before events, because among events it would never find a gap. Latency:
    `model/contract/latency.py`. Reset empties everything. The beginning of a frame does the same, although nothing can
    be left by then except after an upset.

    No upset makes the readout wait for ever. Places that it wrongly took for occupied are free again when nothing has
    moved for `CALM_CYCLES`, and a frame whose last beat was lost ends with a frame end packet without counters.
    """

    def __init__(self, sensor: Sensor, subgroups: int):
        self.sensor = sensor
        self.subgroups = subgroups
        self.parts = layout(sensor)
        self.rooms = self.parts.longest_word, self.parts.counter_beats  # beats of the longest word, and of counters
        self.depth = latency.output_depth(self.parts.longest)  # depth of the output buffer, in beats
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
        self.state = ReadoutState(self)

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
        """Register the inputs. Outside a frame they are ignored: after a reset, the modules may still report old data."""
        state, n = self.state, self.subgroups
        m.d.sync += [
            state.stored.eq(self.stored & state.in_frame.replicate(n)),
            state.record_stored.eq(self.record_stored & state.in_frame.replicate(n)),
            state.frame_begin.eq(self.frame_begin),
            state.finish.eq(self.finish),
            state.valid.eq(self.valid & state.in_frame),
            state.beat.eq(self.beat),
            state.beat_controlled.eq(self.beat_controlled),
            state.grouped.eq(of_format(self.frame.format, lambda packet: int(packet.grouped))),
            state.with_offsets.eq(of_format(self.frame.format, lambda packet: int(packet.has("offsets")))),
            state.event_length.eq(of_format(self.frame.format, self.parts.length)),
            state.event_last.eq(self._event_and(-1)),
            *(beyond.eq(self._event_and(beats - 1)) for beats, beyond in zip(self.rooms, state.event_exceeds)),
        ]

    def _event_and(self, beats):
        """Beats of an event in the frame's format, and some more."""
        return of_format(self.frame.format, lambda packet: self.parts.length(packet) + beats)

    def _arbiter(self, m):
        """Choose the next subgroup: the lowest waiting one at or after the pointer, otherwise the lowest of all.

        Waiting events are a counter per subgroup, waiting records a bit.
        """
        state = self.state
        ahead = Signal(self.subgroups)
        self._credits(m, state.stored, state.take_event)
        m.d.sync += state.records.eq((state.records & ~state.take_record) | state.record_stored)
        with m.If(state.frame_begin):
            m.d.sync += [plane.eq(0) for plane in (*state.planes, state.records)]
        m.d.comb += [state.waiting.eq(state.some_events | state.records), ahead.eq(state.waiting & state.at_or_after)]
        from_ahead, from_all = up_to(m, ahead, "from_ahead"), up_to(m, state.waiting, "from_all")
        m.d.comb += [
            state.from_chosen.eq(Mux(from_ahead[-1], from_ahead, from_all)),
            state.chosen.eq(state.from_chosen & ~(state.from_chosen << 1)),
            state.chosen_record.eq((state.chosen & state.records).any()),
        ]

    def _credits(self, m, up, down):
        """Count per subgroup, in bit planes; registers beside the planes know which counters are not 0."""
        planes, some = self.state.planes, self.state.some_events
        carries, borrows = named("carries borrows", self.subgroups)
        m.d.comb += [carries.eq(up & ~down), borrows.eq(down & ~up)]
        ones = zeros = ~Const(0, self.subgroups)  # whether all planes below are; known before the grant is
        for plane in planes:
            m.d.sync += plane.eq(plane ^ (carries & ones) ^ (borrows & zeros))
            ones, zeros = ones & plane, zeros & ~plane
        several = any_of(m, planes[1:], "several_of") if len(planes) > 1 else 0
        m.d.sync += some.eq(up | (some & (~down | several)))

    def _room(self, m):
        """Decide when a packet may begin.

        All beats of the previous one must be granted, and the buffer must have room for any word, or for the counters. Registers beside
        the space know of either room, so no grant waits for a comparison.
        """
        state = self.state
        m.d.comb += [
            state.free.eq((state.left == 0) & state.room[0]),
            state.free_for_counters.eq((state.left == 0) & state.room[1]),
            *(after.eq(self._space_exceeds(beats - 1)) for after, beats in zip(state.room_next, self.rooms)),
            state.gone.eq(Mux(state.grouped, state.taken, state.buffer.r_rdy & self.m_axis.tready)),
            state.left_next.eq(state.left - (state.left != 0)),
            state.space_next.eq(Mux(state.gone, state.space + 1, state.space)),
        ]
        m.d.sync += state.taken.eq(state.buffer.r_rdy & state.buffer.r_en)
        m.d.sync += [state.left.eq(state.left_next), state.space.eq(state.space_next)]
        m.d.sync += [room.eq(after) for room, after in zip(state.room, state.room_next)]
        with m.If(state.buffer.r_rdy | state.valid | (state.left != 0) | state.booked):
            m.d.sync += state.calm.eq(0)
        with m.Elif(state.calm != CALM_CYCLES):
            m.d.sync += state.calm.eq(state.calm + 1)
        with m.Else():
            m.d.sync += [state.space.eq(self.depth), *(room.eq(1) for room in state.room)]
        with m.If(state.frame_begin):
            m.d.sync += [state.space.eq(self.depth), state.left.eq(0), state.taken.eq(0)]
            m.d.sync += [room.eq(1) for room in state.room]

    def _space_exceeds(self, beats):
        """Return whether there is space for more than `beats`, with the place of a beat that leaves now.

        No carry waits for the stream's `tready`; it only selects.
        """
        state = self.state
        return Mux(state.gone, state.space >= beats, state.space > beats)

    def _book(self, m, length, name, free):
        """Book room for a packet that may begin. What remains is computed for each length before the grant is known.

        length: None for an event.
        """
        state = self.state
        if length is None:
            length, last, exceeds = state.event_length, state.event_last, state.event_exceeds
        else:
            last, exceeds = length - 1, [length + beats - 1 for beats in self.rooms]
        after = Signal.like(state.space, name=f"space_after_{name}")
        m.d.comb += after.eq(Mux(state.gone, state.space - last, state.space - length))
        leaves = [Signal(name=f"{name}_leaves_{beats}") for beats in self.rooms]
        m.d.comb += [left.eq(self._space_exceeds(beats)) for beats, left in zip(exceeds, leaves)]
        with m.If(free):
            m.d.comb += [state.left_next.eq(last), state.space_next.eq(after), state.booked.eq(1)]
            m.d.comb += [room.eq(left) for room, left in zip(state.room_next, leaves)]

    def _packets(self, m):
        """Send a frame's packets in order: start, events and records, end, counters of every subgroup."""
        state = self.state
        m.d.sync += [self.grant.eq(0), self.delivered.eq(0)]
        with m.FSM() as state.machine:
            with m.State("idle"):
                m.d.sync += self.delivered.eq(~state.owes)
                with m.If(state.frame_begin):
                    m.next = "head"
                with m.Elif(state.owes & state.finish):  # only after an upset
                    m.next = "events"
            with m.State("head"):
                self._book(m, 1, "start", state.free)
                m.d.sync += state.at_or_after.eq(~0)
                with m.If(state.free):
                    m.d.comb += state.own_kind.eq(FRAME_START.code)
                    m.next = "events"
                self._begin_again(m)
            with m.State("events"):
                with m.If(state.waiting.any()):
                    self._grant_chosen(m)
                with m.Elif(state.finish):
                    self._book(m, 1, "end", state.free)
                    m.d.sync += state.tail.eq(1)
                    with m.If(state.free):
                        m.d.comb += state.own_kind.eq(FRAME_END.code)
                        m.next = "counters"
                self._begin_again(m)
            with m.State("counters"):
                self._book(m, self.parts.counter_beats, "counters", state.free_for_counters)
                with m.If(state.free_for_counters):
                    m.d.sync += [self.grant.eq(state.tail), self.send.eq(bus.Send.COUNTERS)]
                    m.d.sync += state.tail.eq(state.tail << 1)
                    with m.If(state.tail[-1] | (state.tail == 0)):
                        m.next = "flush"
                self._begin_again(m)
            with m.State("flush"):
                with m.If((state.left == 0) & (state.space == self.depth)):
                    with m.If(state.owes):
                        self._book(m, 1, "fill", state.free)
                        m.d.comb += state.own_kind.eq(FRAME_END.code)
                        m.d.sync += state.filling.eq(1)
                    with m.Else():
                        m.next = "idle"
                self._begin_again(m)
            for code in range(3):  # the codes that are no state
                with m.State(f"lost_{code}"):
                    m.next = "flush"
        m.d.comb += state.in_frame.eq(~state.machine.ongoing("idle"))

    def _begin_again(self, m):
        """Begin a frame although the previous one has not ended, which happens only after an upset."""
        with m.If(self.state.frame_begin):
            m.next = "head"

    def _grant_chosen(self, m):
        """Grant the chosen subgroup's record or event, and move the pointer behind it."""
        state = self.state
        with m.If(state.chosen_record):
            self._book(m, self.parts.length(RECORD), "record", state.free)
        with m.Else():
            self._book(m, None, "event", state.free)
        with m.If(state.free):
            m.d.comb += [
                state.take_record.eq(state.chosen & state.records),
                state.take_event.eq(state.chosen & ~state.records),
            ]
            m.d.sync += [
                self.grant.eq(state.chosen),
                self.send.eq(Mux(state.chosen_record, bus.Send.RECORD, bus.Send.EVENT)),
                state.at_or_after.eq(state.from_chosen << 1),
            ]

    def _output(self, m):
        """Buffer the stream. Beats come back in the order of the grants; the readout's own beats take the same time."""
        state, counter_beats = self.state, self.parts.counter_beats
        own, to_end = state.own, state.to_end
        m.d.sync += [later.eq(now) for now, later in zip([state.own_kind, *own], own)]
        starts = own[-1] == FRAME_START.code
        fields = numbers(m, self.sensor, [FRAME_START], own[-1], pulse=self.number, count=starts & state.grouped)
        (own_beat,) = formed(self.sensor, [FRAME_START], fields)[FRAME_START]
        is_own = own[-1].any()
        with m.If((own[-1] == FRAME_END.code) & ~state.filling):
            m.d.sync += to_end.eq(counter_beats * self.subgroups)
        with m.Elif(state.valid & (to_end != 0)):
            m.d.sync += to_end.eq(to_end - 1)
        m.d.comb += [
            self.counted.valid.eq(state.valid & (to_end != 0)),
            self.counted.beat.eq(state.beat),
            self.counted.controlled.eq(state.beat_controlled),
        ]
        m.submodules.buffer = ResetInserter(state.frame_begin)(state.buffer)
        last = Signal()
        m.d.comb += last.eq(Mux(is_own, state.filling, to_end == 1))
        with m.If(state.frame_begin):
            m.d.sync += [state.owes.eq(1), state.filling.eq(0), to_end.eq(0)]
        with m.Elif(state.buffer.w_en & last):
            m.d.sync += [state.owes.eq(0), state.filling.eq(0)]
        m.d.comb += [
            state.buffer.w_en.eq(state.valid | is_own),
            state.buffer.w_data.eq(Cat(Mux(is_own, own_beat, state.beat), last, is_event_head(state.beat))),
        ]

    def _port(self, m, platform):
        """Let the buffer's beats leave as they are, or the events among them in groups."""
        state = self.state
        coder, packer = state.coder, state.packer
        beat, last, head = (state.buffer.r_data[part] for part in (slice(BEAT_BITS), BEAT_BITS, BEAT_BITS + 1))
        nets = {
            "grouped": state.grouped,
            "with_offsets": state.with_offsets,
            "period": self.plan.period,
            "valid": state.buffer.r_rdy,
            "beat": beat,
            "last": last,
            "head": head,
            "passed": self.m_axis.tready,
            "frame_begin": state.frame_begin,
        }
        nets |= coder.outputs() | packer.outputs()
        place(m, "coder", coder, platform, **coder.fed(nets))
        place(m, "packer", packer, platform, **packer.fed(nets))
        wiring.connect(m, wiring.flipped(self.m_axis), packer.m_axis)
        m.d.comb += state.buffer.r_en.eq(coder.take)
