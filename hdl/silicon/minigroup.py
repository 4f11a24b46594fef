# SPDX-License-Identifier: Apache-2.0
"""Minigroup of the asynchronous view: its part of the ID map, and its record, from the samples of
its events.
"""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib.wiring import In

from ...model.contract.parameters import QUARTERS, Sensor
from ..minigroup import Recorder
from .circuit import johnson_number
from .event_tree import mark_bits


class AsyncMinigroup(Recorder):
    """Minigroup behind the hit flops. Its record circuit is that of the polyphase minigroup.

    Ports
    -----
    active : in, pixels with an edge in the cycle; mark : in, sampled by the first of them; parity :
        in, of the cycle (stage 3)
    hit : in, pixels whose edge is inside the window (stage 3)
    opening : in, a window opened in this cycle; winner : in, its winner, one-hot (stage 4)
    elapsed : in, cycles since the window opened (stage 7)
    hits : out, the window's map (stage 5); offset : out, the coarse offset of the first counted
        edge (stage 8)
    blind : out, an edge outside a window (stage 4)
    frame, may_open, wrap : in; latched, entry : out, as in `Minigroup` (stage 3); coarse : in
        (stage 4)
    test_enable : in, opens the latches for a test of the chip
    """

    unit_name = "coincid_async_minigroup"

    def __init__(self, sensor: Sensor):
        pixels = sensor.minigroup_pixels
        super().__init__(
            sensor,
            active=In(pixels),
            mark=In(mark_bits(sensor)),
            parity=In(1),
            hit=In(pixels),
            winner=In(pixels),
        )

    def elaborate(self, platform):
        m = Module()
        pixels = self.sensor.minigroup_pixels
        step = Signal(self.sensor.step_bits)
        m.d.comb += step.eq(self._sampled_step(m))

        hit_4 = Signal(pixels, reset_less=True)
        active_4 = Signal(pixels, reset_less=True)
        step_4 = Signal.like(step, reset_less=True)
        m.d.sync += [
            hit_4.eq(self.hit),
            active_4.eq(self.active),
            step_4.eq(step),
        ]
        m.d.comb += self.blind.eq((active_4 & ~hit_4).any())

        hits = Signal(pixels, reset_less=True)
        with m.If(self.opening):
            # The winner opened the window, so it is always in the map, even if its hit flop missed.
            m.d.sync += hits.eq(hit_4 | self.winner)
        with m.Else():
            m.d.sync += hits.eq(hits | hit_4)
        m.d.comb += self.hits.eq(hits)
        begins = hit_4.any() & (self.opening | ~hits.any())
        self._stamps(m, platform, self.active, begins, step_4)
        return m

    def _sampled_step(self, m):
        """Return the step of the cycle in which the first edge came, from its mark.

        The hit flops have already decided to which cycle the edge belongs. A quarter beyond that
        cycle's boundary is therefore set to the quarter at the boundary.
        """
        *taps, half = self.mark
        step = Signal(self.sensor.step_bits)
        m.d.comb += step.eq(johnson_number(m, Cat(taps), "taps"))
        quarter = step[-2:]
        before = (quarter == 0) & (half == self.parity)
        after = (quarter == QUARTERS - 1) & (half != self.parity)
        return Mux(before, self.sensor.offset_phases - 1, Mux(after, 0, step))
