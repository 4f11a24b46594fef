# SPDX-License-Identifier: Apache-2.0
"""Gating: selects the cycles in which a subgroup's edges count and its SPADs are on.

The paper (III-A): every subgroup is "modelled to optionally operate under time-gating set
electrically around the desired target range". Progressive gating (the shift) is our choice.
"""

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
    spad_gate : out, the gate is open, or gating is off (stage 0: the cycle in which the edges are
        at the ports)
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
        self.start = Signal()  # the cycle is the first of a period
        self.running = Signal(2)  # a frame is running, one and two cycles ago
        self.until_now = Signal(sensor.coarse_bits + 2)  # cycles until the gate opens,
        self.left_now = Signal(GATE_BITS)  # and then until it closes

    def elaborate(self, platform):
        m = Module()
        coarse_bits = self.sensor.coarse_bits
        first = Signal(coarse_bits + 2)
        with m.If(self.timing.start):
            m.d.sync += first.eq(self.settings.gate_start[:coarse_bits] + self.timing.shift)
        m.d.sync += [
            self.start.eq(self.timing.start),
            self.running.eq((self.running << 1) | self.timing.running),
        ]
        until = Signal.like(first)  # cycles until the gate opens, then cycles until it closes
        left = Signal(GATE_BITS)
        inside = Signal()
        m.d.comb += [
            self.until_now.eq(Mux(self.start, first, until)),
            self.left_now.eq(Mux(self.start, self.settings.gate_len, left)),
            inside.eq(self.running[0] & (self.until_now == 0) & (self.left_now != 0)),
        ]
        with m.If(self.settings.gating & (self.start | (self.running[0] & (until != 0)))):
            m.d.sync += until.eq(self.until_now - (self.until_now != 0))
        with m.If(self.settings.gating & (self.start | inside)):
            m.d.sync += left.eq(self.left_now - inside)
        m.d.sync += [
            self.spad_gate.eq(inside | ~self.settings.gating),
            self.accept.eq(self.running[1] & self.spad_gate),
        ]
        return m
