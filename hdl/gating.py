# SPDX-License-Identifier: Apache-2.0
"""Gating: selects the cycles in which a subgroup's edges count and its SPADs are on.

The paper (III-A): every subgroup is "modelled to optionally operate under time-gating set electrically around the
desired target range". Progressive gating (the shift) is our choice.
"""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract.parameters import Sensor
from ..model.contract.settings import GATE_BITS
from . import bus
from .unit import Unit


class GatingState:
    """Strobes of the frame and its period, and the cycles until the gate opens and closes."""

    def __init__(self, sensor: Sensor):
        self.start = Signal()
        self.running = Signal(2)
        self.until_now = Signal(sensor.coarse_bits + 2)
        self.left_now = Signal(GATE_BITS)


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
            timing=In(bus.time_layout(sensor)),
            settings=In(bus.settings_layout(sensor)),
            spad_gate=Out(1),
            accept=Out(1),
        )
        self.state = GatingState(sensor)

    def elaborate(self, platform):
        m = Module()
        coarse_bits, state = self.sensor.coarse_bits, self.state
        first = Signal(coarse_bits + 2)
        with m.If(self.timing.start):
            m.d.sync += first.eq(self.settings.gate_start[:coarse_bits] + self.timing.shift)
        m.d.sync += [state.start.eq(self.timing.start), state.running.eq((state.running << 1) | self.timing.running)]
        until = Signal.like(first)  # cycles until the gate opens, then cycles until it closes
        left = Signal(GATE_BITS)
        inside = Signal()
        m.d.comb += [
            state.until_now.eq(Mux(state.start, first, until)),
            state.left_now.eq(Mux(state.start, self.settings.gate_len, left)),
            inside.eq(state.running[0] & (state.until_now == 0) & (state.left_now != 0)),
        ]
        with m.If(self.settings.gating & (state.start | (state.running[0] & (until != 0)))):
            m.d.sync += until.eq(state.until_now - (state.until_now != 0))
        with m.If(self.settings.gating & (state.start | inside)):
            m.d.sync += left.eq(state.left_now - inside)
        m.d.sync += [
            self.spad_gate.eq(inside | ~self.settings.gating),
            self.accept.eq(state.running[1] & self.spad_gate),
        ]
        return m
