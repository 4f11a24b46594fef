# SPDX-License-Identifier: Apache-2.0
"""Subgroup: one coincID tree, one gate, one DPCU, one FIFO (paper, Fig. 3)."""

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

AWAKE_CYCLES = 31  # by then, everything in a subgroup has come to rest


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
        settings, gating, tree, dpcu = (
            SubgroupSettings(sensor),
            Gating(sensor),
            self.view.front_end(sensor),
            Dpcu(sensor),
        )
        events, packets = EventFifo(sensor), Packetizer(sensor)

        # Inputs go straight into registers, except the subgroup's number, which never changes. These need no reset, because
        # the registers that drive them have one. Most of them change only when something comes.
        taken = {
            name: Signal.like(getattr(self, name), reset_less=True)
            for name in ("command", "timing", "frame", "period", "grant", "send")
        }
        command, timing, frame, period, grant, send = taken.values()
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

        # A block's input is driven by the net of the same name: mostly another block's output, or an input of the subgroup.
        nets: dict[str, Any] = taken | {"subgroup": self.subgroup, "start": timing.start}
        nets |= {"operation": command.operation, "in_stream": self.subgroup >= command.subgroup}
        nets["frame_begin"] = command.operation == bus.Operation.BEGIN
        for unit in (settings, gating, tree, dpcu, events, packets):
            nets |= unit.outputs()
        nets |= {"words": self.words, "spad": self.words, "gate": gating.spad_gate, "mask": settings.settings.mask}

        def put(name, unit, domain=gated, **others):
            place(m, name, unit, platform, reset, domain, **unit.fed(nets | others))

        if sensor.records:
            records = RecordBuffer(sensor)
            put("record_buffer", records, due=tree.record_due, take=packets.take_record)
            nets |= {"record": records.record, "mg_stored": records.stored, "mg_dropped": records.dropped}
            m.d.comb += self.record_stored.eq(records.stored)
        put("settings", settings)
        put("gating", gating)
        put("tree", tree, gated if self.view.front_end_rests else "sync")
        put("dpcu", dpcu, data=command.data)
        put("fifo", events, take=packets.take_event)
        put("packetizer", packets)
        wiring.connect(m, wiring.flipped(self.line), tree.line)
        m.d.comb += [
            getattr(self, name).eq(nets[name])
            for name, member in own_ports(sensor).items()
            if member.flow is Out and name in nets
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
