# SPDX-License-Identifier: Apache-2.0
"""Subgroup: one coincID tree, one gate, one DPCU, one FIFO (paper, Fig. 3)."""

from functools import partial
from typing import Any

from amaranth.hdl import Cat, Module, Mux, ResetSignal, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ..model.contract.packet import BEAT_BITS
from ..model.contract.parameters import Sensor
from ..model.contract.registers import DATA_BITS
from . import bus
from .clock_gate import ClockGate, stopped
from .dpcu import Dpcu
from .fifo import EventFifo, RecordBuffer
from .front_end_views import POLYPHASE, View
from .gating import Gating
from .packetizer import Packetizer
from .settings import SubgroupSettings
from .unit import Unit, place
from .voted import agreed_reset

AWAKE_CYCLES = 31  # more than anything in a subgroup takes to come to rest


def shared_ports(sensor: Sensor) -> dict[str, Any]:
    """Inputs that all subgroups share: configuration bus, programmed period, frame settings, timing."""
    return {
        "command": In(bus.CONFIG_BUS),
        "period": In(sensor.coarse_bits + 1),
        "frame": In(bus.frame_layout(sensor)),
        "timing": In(bus.time_layout(sensor)),
    }


def own_ports(sensor: Sensor, view: View = POLYPHASE) -> dict[str, Any]:
    """Ports that each subgroup has for itself.

    words : in, the SPADs in the view's form (polyphase: edge words, pixels * phases); spad_gate : out, low: SPADs are off
    grant, send : in, from its stream's readout; valid, beat : out; beat_controlled : out, the beat is from a subgroup
        whose threshold the controller sets
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
    """Subgroup. Settings, strobes and grants are registered here, and every output comes from a register.

    Nothing changes here without a command, a strobe, a grant or a reset, except for `AWAKE_CYCLES` after them. So the clock
    stops in between, and the inputs that wake it also go to the clock gate.

    Ports: `shared_ports`, `own_ports`, `subgroup` (in, its number), `line` (its TDC sampling line).
    view: view of the front end, from `front_end_views.py`.
    Latency: `model/contract/latency.py`. Reset is registered here, so it acts one cycle later, as stated by each part.
    """

    def __init__(self, sensor: Sensor, view=POLYPHASE):
        self.sensor, self.view = sensor, view
        self.unit_name = f"{view.prefix}subgroup"
        super().__init__(
            **shared_ports(sensor),
            **own_ports(sensor, view),
            subgroup=In(bus.SUBGROUP_BITS),
            line=Out(view.line_signature(sensor)),
        )
        self.clock_gate = ClockGate()

    def elaborate(self, platform):
        m = Module()
        sensor, reset = self.sensor, agreed_reset(m)
        gated = self._clock(m, platform, reset)
        put = partial(place, m, platform=platform, reset=reset)
        settings = put("settings", SubgroupSettings(sensor), domain=gated)
        gating = put("gating", Gating(sensor), domain=gated)
        tree = put("tree", self.view.front_end(sensor), domain=gated if self.view.front_end_rests else "sync")
        dpcu = put("dpcu", Dpcu(sensor), domain=gated)
        events = put("fifo", EventFifo(sensor), domain=gated)
        records = put("record_buffer", RecordBuffer(sensor), domain=gated) if sensor.records else None
        packets = put("packetizer", Packetizer(sensor), domain=gated)

        # Inputs go straight into registers, except the subgroup's number, which never changes. These need no reset, because
        # the registers that drive them have one. Most of them move only when something comes.
        command, timing, frame, period, grant, send = (
            Signal.like(port, reset_less=True)
            for port in (self.command, self.timing, self.frame, self.period, self.grant, self.send)
        )
        idle = bus.Operation.IDLE
        with m.If((self.command.operation != idle) | (command.operation != idle)):
            m.d[gated] += [command.eq(self.command), frame.eq(self.frame), period.eq(self.period)]
        now, next_now = (Cat(port[name] for name in bus.STROBES) for port in (timing, self.timing))
        with m.If(Cat(now != next_now, grant, self.grant).any()):
            m.d[gated] += [now.eq(next_now), grant.eq(self.grant)]
        with m.If(self.timing.start):
            m.d[gated] += timing.shift.eq(self.timing.shift)
        with m.If(self.grant):
            m.d[gated] += send.eq(self.send)
        wiring.connect(m, wiring.flipped(self.line), tree.line)
        m.d.comb += [
            settings.command.eq(command),
            settings.subgroup.eq(self.subgroup),
            settings.period.eq(period),
            settings.counters.eq(dpcu.counters),
            self.data.eq(settings.data),
            self.gate_late.eq(settings.gate_late),
            self.upset.eq(settings.upset),
            gating.timing.eq(timing),
            gating.settings.eq(settings.settings),
            self.spad_gate.eq(gating.spad_gate),
            *self.view.hears(tree, self.words, settings.settings.mask, gating),
            tree.window_ticks.eq(dpcu.window_ticks),
            tree.frame.eq(frame),
            tree.timing.eq(timing),
            dpcu.settings.eq(settings.settings),
            dpcu.start.eq(timing.start),
            dpcu.operation.eq(command.operation),
            dpcu.data.eq(command.data),
            dpcu.in_stream.eq(self.subgroup >= command.subgroup),
            dpcu.closed.eq(tree.closed),
            dpcu.window.eq(tree.window),
            dpcu.blind.eq(tree.blind),
            dpcu.stored.eq(events.stored),
            dpcu.dropped.eq(events.dropped),
            events.commit.eq(dpcu.commit),
            events.event.eq(dpcu.event),
            events.offsets.eq(tree.offsets),
            events.pulse.eq(dpcu.pulse),
            events.frame_begin.eq(command.operation == bus.Operation.BEGIN),
            events.take.eq(packets.take_event),
            self.stored.eq(events.stored),
            packets.grant.eq(grant),
            packets.send.eq(send),
            packets.frame.eq(frame),
            packets.subgroup.eq(self.subgroup),
            packets.head.eq(events.head),
            packets.counters.eq(dpcu.counters),
            packets.controlled.eq(dpcu.controlled),
            self.valid.eq(packets.valid),
            self.beat.eq(packets.beat),
            self.beat_controlled.eq(packets.beat_controlled),
        ]
        if records:
            m.d.comb += [
                records.due.eq(tree.record_due),
                records.latched.eq(tree.latched),
                records.entries.eq(tree.entries),
                records.pulse.eq(dpcu.pulse),
                records.take.eq(packets.take_record),
                records.frame_begin.eq(command.operation == bus.Operation.BEGIN),
                self.record_stored.eq(records.stored),
                dpcu.mg_stored.eq(records.stored),
                dpcu.mg_dropped.eq(records.dropped),
                packets.record.eq(records.record),
            ]
        return m

    def _clock(self, m, platform, reset):
        """Return the domain whose clock stops `AWAKE_CYCLES` after the last command, strobe, grant or reset."""
        left = Signal(range(AWAKE_CYCLES + 1), reset_less=True)
        asked = Signal()
        m.d.comb += asked.eq(
            (self.command.operation != bus.Operation.IDLE)
            | Cat(self.timing[name] for name in bus.STROBES).any()
            | self.grant
            | reset
            | ResetSignal()
        )
        domain = stopped(m, platform, self.clock_gate, asked | (left != 0))
        with m.If(~asked | (left != AWAKE_CYCLES)):
            m.d[domain] += left.eq(Mux(asked, AWAKE_CYCLES, left - (left != 0)))
        return domain
