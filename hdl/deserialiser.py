# SPDX-License-Identifier: Apache-2.0
"""Deserialiser: SPAD levels to edge words, for FPGAs.

The paper has no FPGA; this block is our choice. Each line is sampled at `phases` equidistant
moments of the cycle by plain flip-flops, on both edges of `phases` / 2 clocks. Every FPGA can do
this: 1 Gsample/s is beyond the input gearing of the smaller ones, but shifted clocks of 125 MHz are
not. One PLL makes the clocks. The PLLs of the smaller families make four, so this front end
supports up to 8 phases.
"""

from itertools import pairwise

from amaranth.hdl import Cat, ClockDomain, ClockSignal, Module, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract.parameters import Sensor
from .unit import Unit

PHASES_MAX = 8  # four PLL outputs, both edges
CYCLES = 2  # from a rise at the pins to its edge word at the sensor's ports


class Deserialiser(Unit):
    """Deserialiser of a subgroup.

    Ports
    -----
    lines : in, pixels, levels of the SPADs, asynchronous: high for more than a tick from the
        avalanche on, and low for more than a tick before it
    clocks : in, phases / 2 - 1; clock j (from 1) rises j ticks after the system clock, which is
        clock 0
    words : out, pixels * phases, edge words: bit k of a pixel = its line rose in tick k of the
        cycle `CYCLES` before

    Sample j of a cycle (1 to `phases`) is taken j ticks after the cycle begins. It reaches the
    system clock in hops of at least half a cycle and passes two flip-flops before any logic sees
    it. There is no reset, because the state of the lines is valid at any time.
    """

    unit_name = "coincid_deserialiser"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            lines=In(sensor.pixels),
            clocks=In(sensor.phases // 2 - 1),
            words=Out(sensor.pixels * sensor.phases),
        )

    def elaborate(self, platform):
        m = Module()
        pixels, phases = self.sensor.pixels, self.sensor.phases
        half = phases // 2
        clocks = [ClockSignal("sync"), *self.clocks]
        for edge in ("pos", "neg"):
            for j, clock in enumerate(clocks):
                if (edge, j) != ("pos", 0):
                    domain = ClockDomain(f"{edge}_{j}", clk_edge=edge, reset_less=True, local=True)
                    m.domains += domain
                    m.d.comb += domain.clk.eq(clock)

        def flop(value, domain, name):
            register = Signal(pixels, name=name, reset_less=True)
            m.d[domain] += register.eq(value)
            return register

        def rising(j):
            return f"pos_{j}" if j else "sync"

        # A cycle's samples 1 to `phases`, all registered by the system clock two cycles after the
        # cycle begins.
        levels = []
        for j in range(1, phases + 1):
            if j < half:
                held = flop(flop(self.lines, rising(j), f"sample_{j}"), "sync", f"held_{j}")
            elif j < phases:
                held = flop(
                    flop(self.lines, f"neg_{j - half}", f"sample_{j}"),
                    rising(j - half),
                    f"held_{j}",
                )
            else:
                held = flop(self.lines, "sync", f"sample_{j}")
            levels.append(flop(held, "sync", f"level_{j}"))
        rises = [Signal(pixels, name=f"rises_{j}") for j in range(phases)]
        before = [flop(levels[-1], "sync", "level_before"), *levels]
        for rise, (last, now) in zip(rises, pairwise(before), strict=True):
            m.d.comb += rise.eq(now & ~last)
        m.d.comb += self.words.eq(Cat(rise[i] for i in range(pixels) for rise in rises))
        return m
