# SPDX-License-Identifier: Apache-2.0
"""Gating: selects the cycles in which a subgroup's edges count and its SPADs are on.

The paper (III-A): every subgroup is "modelled to optionally operate under time-gating set electrically around the
desired target range". Progressive gating (the shift) is our choice.
"""

from types import SimpleNamespace

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract.parameters import Sensor
from ..model.contract.settings import GATE_BITS
from . import bus
from .unit import Unit


class Gating(Unit):
    """Gate of a subgroup.

    Ports
    -----
    timing : in, registered in the module: two cycles ahead of the ports
    settings : in
    spad_gate : out, the gate is open, or gating is off (stage 0: the cycle in which the edges are at the ports)
    accept : out, a frame is running and the gate lets edges through (stage 1)

    Reset closes the gate. If gating is off, `spad_gate` opens one cycle later.
    """

    unit_name = "coincid_gating"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            {
                "timing": In(bus.time_layout(sensor)),
                "settings": In(bus.settings_layout(sensor)),
                "spad_gate": Out(1),
                "accept": Out(1),
            }
        )

    def elaborate(self, platform):
        m = Module()
        coarse_bits = self.sensor.coarse_bits
        first = Signal(coarse_bits + 2)
        start = Signal()
        running = Signal(2)
        m.d.sync += [
            first.eq(self.settings.gate_start[:coarse_bits] + self.timing.shift),
            start.eq(self.timing.start),
            running.eq((running << 1) | self.timing.running),
        ]
        until = Signal.like(first)  # cycles until the gate opens, then cycles until it closes
        left = Signal(GATE_BITS)
        until_now = Signal.like(until)
        left_now = Signal.like(left)
        inside = Signal()
        m.d.comb += [
            until_now.eq(Mux(start, first, until)),
            left_now.eq(Mux(start, self.settings.gate_len, left)),
            inside.eq(running[0] & (until_now == 0) & (left_now != 0)),
        ]
        m.d.sync += [
            until.eq(until_now - (until_now != 0)),
            left.eq(left_now - inside),
            self.spad_gate.eq(inside | ~self.settings.gating),
            self.accept.eq(running[1] & self.spad_gate),
        ]
        self.state = SimpleNamespace(until_now=until_now, left_now=left_now, running=running, start=start)
        return m
