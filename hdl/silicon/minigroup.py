"""Minigroup of the asynchronous view: its part of the ID map, and its record, from what its events sampled."""

from types import SimpleNamespace

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ...model.contract.parameters import QUARTERS, Sensor
from .. import bus
from ..minigroup import Minigroup
from ..unit import Unit
from .event_tree import MARK_BITS


class AsyncMinigroup(Minigroup):
    """Minigroup behind the hit flops. The record circuit is the polyphase minigroup's.

    Ports
    -----
    active : in, pixels with an edge in the cycle; mark : in, what the first of them sampled; parity : in, of the cycle (stage 3)
    hit : in, pixels whose edge lies inside the window (stage 3)
    opening : in, a window opened in this cycle; elapsed : in, cycles since it did; winner : in, its winner, one-hot (stage 4)
    hits, offset : out, the window's map, and the coarse offset of the first counted edge (stage 5)
    blind : out, an edge outside a window (stage 4)
    frame, may_open, wrap, coarse : in; latched, entry : out, as of `Minigroup` (stage 3)
    """

    unit_name = "coincid_async_minigroup"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        pixels = sensor.minigroup_pixels
        Unit.__init__(  # type: ignore[call-arg]  # it is Amaranth's
            self,
            {
                "active": In(pixels),
                "mark": In(MARK_BITS),
                "parity": In(1),
                "hit": In(pixels),
                "opening": In(1),
                "elapsed": In(max(1, sensor.offset_bits - 2)),
                "winner": In(pixels),
                "hits": Out(pixels),
                "offset": Out(sensor.offset_bits),
                "blind": Out(1),
                "frame": In(bus.frame_layout(sensor)),
                "may_open": In(1),
                "wrap": In(1),
                "coarse": In(sensor.coarse_bits),
                "latched": Out(1),
                "entry": Out(bus.entry_layout(sensor)),
            },
        )

    def elaborate(self, platform):
        m = Module()
        pixels = self.sensor.minigroup_pixels
        quarter = Signal(2)
        m.d.comb += quarter.eq(self._sampled_quarter())

        hit, active = Signal(pixels, reset_less=True), Signal(pixels, reset_less=True)
        quarter_4 = Signal(2, reset_less=True)
        m.d.sync += [hit.eq(self.hit), active.eq(self.active), quarter_4.eq(quarter)]
        m.d.comb += self.blind.eq((active & ~hit).any())

        hits, offset = Signal(pixels, reset_less=True), Signal.like(self.offset, reset_less=True)
        with m.If(self.opening):
            m.d.sync += hits.eq(
                hit | self.winner
            )  # the winner has opened the window: it is in the map whatever its flop says
        with m.Else():
            m.d.sync += hits.eq(hits | hit)
        with m.If(hit.any() & (self.opening | ~hits.any())):
            m.d.sync += offset.eq(Cat(quarter_4, self.elapsed))
        m.d.comb += [self.hits.eq(hits), self.offset.eq(offset)]

        self.state = SimpleNamespace()
        self._record(m, self.active.any(), self.active, quarter)
        return m

    def _sampled_quarter(self):
        """Quarter of the cycle in which the first edge came, from its mark.

        The hit flops have decided which cycle the edge belongs to. A quarter that was read beyond that cycle's border is the border's.
        """
        first_half, second, half = self.mark
        quarter = Cat(first_half ^ ~second, ~first_half)  # phases (1, 0), (1, 1), (0, 1), (0, 0): quarters 0 to 3
        beyond = Mux(quarter == 0, half == self.parity, half != self.parity)
        return Mux((quarter == 0) & beyond, QUARTERS - 1, Mux((quarter == QUARTERS - 1) & beyond, 0, quarter))
