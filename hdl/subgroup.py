# SPDX-License-Identifier: Apache-2.0
"""Subgroup: one coincID tree, one gate, one DPCU, one FIFO (paper, Fig. 3)."""

from typing import Any

from amaranth.hdl import Cat, Const, Module, Mux, ResetSignal, Signal, ValueLike
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ..model.contract.packet import BEAT_BITS
from ..model.contract.parameters import Sensor
from ..model.contract.registers import DATA_BITS
from . import bus
from .clock_gate import ClockGate, stopped
from .counts import Counts
from .dpcu import Dpcu
from .fifo import EventFifo, RecordBuffer
from .front_end_views import POLYPHASE, View
from .gating import Gating
from .packetizer import Packetizer
from .settings import SubgroupRegisters
from .unit import Unit, place
from .voted import agreed_reset

AWAKE_CYCLES = 31  # by then, everything in a subgroup has come to rest


def shared_ports(sensor: Sensor) -> dict[str, Any]:
    """Inputs that all subgroups share: configuration bus, programmed period, frame settings,
    timing.
    """
    return {
        "command": In(bus.CONFIG_BUS),
        "period": In(sensor.coarse_bits + 1),
        "frame": In(bus.frame_layout(sensor)),
        "timing": In(bus.time_layout(sensor)),
    }


class OwnPorts:
    """`own_ports` of one subgroup of a unit with several, where their names have a suffix."""

    def __init__(self, unit: Unit, suffix: str = ""):
        self._unit = unit
        self._suffix = suffix

    def __getattr__(self, name: str) -> Any:
        return getattr(self._unit, name + self._suffix)


def own_ports(sensor: Sensor, view: View = POLYPHASE) -> dict[str, Any]:
    """Ports that each subgroup has for itself.

    words : in, the SPADs in the view's form (polyphase: edge words, pixels * phases); spad_gate :
        out, low: SPADs are off
    grant, send : in, from its stream's readout; valid, beat : out; beat_controlled : out, the beat
        is from a subgroup whose threshold the controller sets
    stored, record_stored : out, an event or record has been stored
    data : out, result of a register read; gate_late, upset : out, start checks
    """
    return {
        "words": In(view.spad_bits(sensor)),
        "spad_gate": Out(1),
        "grant": In(1),
        "send": In(bus.Send),
        "valid": Out(1),
        "beat": Out(BEAT_BITS),
        "beat_controlled": Out(1),
        "stored": Out(1),
        "record_stored": Out(1),
        "data": Out(DATA_BITS),
        "gate_late": Out(1),
        "upset": Out(1),
    }


class Subgroup(Unit):
    """Subgroup.

    Settings, strobes and grants are registered here, and every output comes from a register.

    Nothing changes here without a command, a strobe, a grant or a reset, except for `AWAKE_CYCLES`
    after them. So the clock stops in between, and the inputs that wake it also go to the clock
    gate.

    Ports: `shared_ports`, `own_ports`, `subgroup` (in, its number), `line` (its TDC sampling line),
    `test_enable` (in, opens clock gates and latches for a test of the chip; constant otherwise).
    view: view of the front end, from `front_end_views.py`. Latency: `model/contract/latency.py`.
    Reset is registered here, so it acts one cycle later, as stated by each part.
    """

    def __init__(self, sensor: Sensor, view=POLYPHASE):
        view.check(sensor)
        self.sensor, self.view = sensor, view
        self.unit_name = f"{view.prefix}subgroup"
        super().__init__(
            **shared_ports(sensor),
            **own_ports(sensor, view),
            subgroup=In(bus.SUBGROUP_BITS),
            test_enable=In(1),
            line=Out(view.line_signature(sensor)),
        )
        self.clock_gate = ClockGate()
        self.counts = Counts(sensor) if sensor.counts else None

    def elaborate(self, platform):
        m = Module()
        self._reset = agreed_reset(m)
        self._gated = self._clock(m, platform, self._reset)
        self._register_inputs(m)
        self._place_blocks(m, platform)
        return m

    def _register_inputs(self, m):
        """Put inputs straight into registers, except the subgroup's number, which never changes.

        These need no reset, because the registers that drive them have one. Most of them change
        only when something comes. Strobes and grants also load in a reset, because otherwise one
        that is undefined at power-on stays so in a simulator with four states.
        """
        self.command_taken = Signal.like(self.command, reset_less=True)
        self.timing_taken = Signal.like(self.timing, reset_less=True)
        self.frame_taken = Signal.like(self.frame, reset_less=True)
        self.period_taken = Signal.like(self.period, reset_less=True)
        self.grant_taken = Signal.like(self.grant, reset_less=True)
        self.send_taken = Signal.like(self.send, reset_less=True)
        idle = bus.Operation.IDLE
        with m.If((self.command.operation != idle) | (self.command_taken.operation != idle)):
            m.d[self._gated] += [
                self.command_taken.eq(self.command),
                self.frame_taken.eq(self.frame),
                self.period_taken.eq(self.period),
            ]
        strobes = Cat(self.timing[name] for name in bus.strobes(self.sensor))
        strobes_taken = Cat(self.timing_taken[name] for name in bus.strobes(self.sensor))
        comes = Cat(strobes_taken != strobes, self.grant_taken, self.grant).any()
        with m.If(self._reset | comes):
            m.d[self._gated] += [
                strobes_taken.eq(strobes),
                self.grant_taken.eq(self.grant),
            ]
        with m.If(self.timing.start):
            m.d[self._gated] += self.timing_taken.shift.eq(self.timing.shift)
        with m.If(self.grant):
            m.d[self._gated] += self.send_taken.eq(self.send)

    def _place_blocks(self, m, platform):
        """Place the blocks and connect them, as in Fig. 3 of the paper."""
        sensor = self.sensor
        operation = self.command_taken.operation
        settings = SubgroupRegisters(sensor)
        gating = Gating(sensor)
        tree = self.view.front_end(sensor)
        dpcu = Dpcu(sensor)
        fifo = EventFifo(sensor)
        packetizer = Packetizer(sensor)
        # Without minigroup records, nothing is stored or dropped, and no record is sent.
        record: ValueLike = Const({}, bus.record_layout(sensor))  # all fields 0
        record_stored: ValueLike = Const(0)
        record_dropped: ValueLike = Const(0)
        of_counts: dict[str, ValueLike] = {}
        frame_begin = operation == bus.Operation.BEGIN

        def put(name, unit, domain=self._gated, **inputs):
            place(m, name, unit, platform, self._reset, domain, **inputs)

        if sensor.records:
            records = RecordBuffer(sensor)
            put(
                "record_buffer",
                records,
                due=tree.record_due,
                latched=tree.latched,
                entries=tree.entries,
                pulse=dpcu.pulse,
                take=packetizer.take_record,
                frame_begin=frame_begin,
                test_enable=self.test_enable,
            )
            record = records.record
            record_stored = records.stored
            record_dropped = records.dropped
        put(
            "settings",
            settings,
            command=self.command_taken,
            subgroup=self.subgroup,
            period=self.period_taken,
            counters=dpcu.counters,
            test_enable=self.test_enable,
        )
        put(
            "gating",
            gating,
            timing=self.timing_taken,
            settings=settings.settings,
        )
        if self.counts is not None:
            put(
                "counts",
                self.counts,
                frame_begin=frame_begin,
                counting=bus.is_counts(self.frame_taken.format),
                start=self.timing_taken.start,
                search=self.timing_taken.search,
                wrap=self.timing_taken.wrap,
                accepted=tree.accepted,
                quarters=tree.quarters,
                reading=packetizer.reading,
                read_row=packetizer.read_row,
                next_minigroup=packetizer.take_counts,
                test_enable=self.test_enable,
            )
            of_counts = {
                "of_minigroup": self.counts.shown,
                "minigroup": self.counts.minigroup,
            }
        put(
            "tree",
            tree,
            domain=self._gated if self.view.front_end_rests else "sync",
            mask=settings.settings.mask,
            window_ticks=dpcu.window_ticks,
            frame=self.frame_taken,
            timing=self.timing_taken,
            test_enable=self.test_enable,
            **self.view.from_spads(self.words, gating),
        )
        put(
            "dpcu",
            dpcu,
            settings=settings.settings,
            operation=operation,
            data=self.command_taken.data,
            in_stream=self.subgroup >= self.command_taken.subgroup,
            start=self.timing_taken.start,
            closed=tree.closed,
            window=tree.window,
            blind=tree.blind,
            stored=fifo.stored,
            dropped=fifo.dropped,
            mg_stored=record_stored,
            mg_dropped=record_dropped,
            test_enable=self.test_enable,
        )
        put(
            "fifo",
            fifo,
            commit=dpcu.commit,
            event=dpcu.event,
            offsets=tree.offsets,
            pulse=dpcu.pulse,
            frame_begin=frame_begin,
            take=packetizer.take_event,
            test_enable=self.test_enable,
        )
        put(
            "packetizer",
            packetizer,
            grant=self.grant_taken,
            send=self.send_taken,
            frame=self.frame_taken,
            subgroup=self.subgroup,
            head=fifo.head,
            record=record,
            counters=dpcu.counters,
            controlled=dpcu.controlled,
            **of_counts,
        )
        wiring.connect(m, wiring.flipped(self.line), tree.line)
        m.d.comb += [
            self.spad_gate.eq(gating.spad_gate),
            self.valid.eq(packetizer.valid),
            self.beat.eq(packetizer.beat),
            self.beat_controlled.eq(packetizer.beat_controlled),
            self.stored.eq(fifo.stored),
            self.record_stored.eq(record_stored),
            self.data.eq(settings.data),
            self.gate_late.eq(settings.gate_late),
            self.upset.eq(settings.upset),
        ]

    def _clock(self, m, platform, reset):
        """Return the domain whose clock stops `AWAKE_CYCLES` after the last command, strobe, grant,
        search or reset.
        """
        left = Signal(range(AWAKE_CYCLES + 1), reset_less=True)
        asked = Signal()
        wakes = (
            (self.command.operation != bus.Operation.IDLE)
            | Cat(self.timing[name] for name in bus.strobes(self.sensor)).any()
            | self.grant
            | reset
            | ResetSignal()
        )
        if self.counts is not None:
            wakes = wakes | self.counts.busy
        m.d.comb += asked.eq(wakes)
        domain = stopped(m, platform, self.clock_gate, asked | (left != 0), self.test_enable)
        with m.If(ResetSignal() | ~asked | (left != AWAKE_CYCLES)):
            m.d[domain] += left.eq(Mux(asked, AWAKE_CYCLES, left - (left != 0)))
        return domain
