"""Minigroup: the leaf of the coincID tree, and the minigroup's own stamping circuit.

The paper (III-A): the subgroup is clustered into minigroups; every minigroup "provides a coarse timestamp along with generating the spatial
address/ID of the contributing events". The collection that latches a record, and quarters of a cycle as its unit, are our choice.
"""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.parameters import QUARTERS, Sensor
from . import bus
from .logic import any_of, encode, lowest, popcount
from .unit import Unit


class Minigroup(Unit):
    """Leaf of `pixels` SPADs.

    Stages count from the port: words at 1, root at 2, phase at 3, hits at 4, map at 5.

    Ports
    -----
    words : in, pixels * phases bits, the SPADs' edge words (stage 0)
    mask : in, pixels; accept : in, gate open in a running frame (stage 1)
    root : out, phases, OR of the accepted words (stage 1)
    inside : in, phases, the part of the cycle that the window covers (stage 3)
    first : in, phases, one-hot phase of the cycle's first edge (stage 3)
    blind : out, an accepted pixel outside the window (stage 4)
    opening : in, the window opened in this cycle; elapsed : in, cycles since it did (stage 4)
    hits, firsts : out, pixels, the window's map and its pixels at the first phase (stage 5)
    offset : out, coarse offset of the first counted edge, valid where hits is not 0 (stage 5)
    frame : in, settings; may_open, wrap : in (stage 3); coarse : in, TDC coarse count (stage 3)
    latched, entry : out, the period's record, to be taken while `wrap` (stage 3)

    Reset clears the record circuit; the words need none, as nothing is accepted outside a frame.
    """

    unit_name = "coincid_minigroup"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        pixels, phases = sensor.minigroup_pixels, sensor.phases
        super().__init__({
            "words": In(pixels * phases), "mask": In(pixels), "accept": In(1), "root": Out(phases),
            "inside": In(phases), "first": In(phases), "blind": Out(1),
            "opening": In(1), "elapsed": In(max(1, sensor.offset_bits - 2)),
            "hits": Out(pixels), "firsts": Out(pixels), "offset": Out(sensor.offset_bits),
            "frame": In(bus.frame_layout(sensor)), "may_open": In(1), "wrap": In(1), "coarse": In(sensor.coarse_bits),
            "latched": Out(1), "entry": Out(bus.entry_layout(sensor)),
        })

    def elaborate(self, platform):
        m = Module()
        pixels, phases = self.sensor.minigroup_pixels, self.sensor.phases

        def word(words, i):
            return words.word_select(i, phases)

        at_port = Signal(pixels * phases, reset_less=True)
        accepted = Signal(pixels * phases)
        words_2 = Signal(pixels * phases, reset_less=True)
        words = Signal(pixels * phases, reset_less=True)
        active_2, active = Signal(pixels), Signal(pixels)
        m.d.sync += at_port.eq(self.words)
        m.d.comb += [
            word(accepted, i).eq(word(at_port, i) & (self.accept & self.mask[i]).replicate(phases)) for i in range(pixels)
        ]
        m.d.comb += self.root.eq(any_of(m, [word(accepted, i) for i in range(pixels)], "root_or"))
        m.d.comb += active_2.eq(Cat(word(words_2, i).any() for i in range(pixels)))
        m.d.sync += [words_2.eq(accepted), words.eq(words_2), active.eq(active_2)]

        together = any_of(m, [word(words, i) for i in range(pixels)], "together")
        hit, at_first, quarter = Signal(pixels), Signal(pixels), Signal(2)
        outside = Signal(pixels)
        m.d.sync += [
            hit.eq(Cat((word(words, i) & self.inside).any() for i in range(pixels))),
            at_first.eq(Cat((word(words, i) & self.first).any() for i in range(pixels))),
            quarter.eq(self._first_quarter(m, together & self.inside, "window_quarter")),
            outside.eq(active),
        ]
        m.d.comb += self.blind.eq((outside & ~hit).any())

        with m.If(self.opening):
            m.d.sync += [self.hits.eq(hit), self.firsts.eq(at_first)]
        with m.Else():
            m.d.sync += self.hits.eq(self.hits | hit)
        with m.If(self.opening | ~self.hits.any()):
            m.d.sync += self.offset.eq(Cat(quarter, self.elapsed))

        self._record(m, active, together)
        return m

    def _first_quarter(self, m, word, name):
        size = self.sensor.quarter_ticks
        quarters = Signal(QUARTERS, name=f"{name}s")
        m.d.comb += quarters.eq(Cat(word[q * size : (q + 1) * size].any() for q in range(QUARTERS)))
        return encode(m, lowest(m, quarters, f"{name}_lowest"), name)

    def _record(self, m, active, together):
        left, seen = Signal(3), Signal.like(active)
        seen_next, left_next = Signal.like(seen), Signal(3)
        idle, starts = Signal(), Signal()
        stamp = Signal.like(self.entry.stamp)
        m.d.comb += [
            idle.eq(self.wrap | ((left == 0) & ~self.latched)),
            starts.eq(self.frame.mg_records & idle & self.may_open & active.any()),
            seen_next.eq(Mux(starts, 0, seen) | active),
            left_next.eq(Mux(starts, self.frame.mg_window, left) - 1),
            self.entry.map.eq(seen),
            self.entry.stamp.eq(stamp),
        ]
        with m.If(self.wrap):
            m.d.sync += self.latched.eq(0)
        with m.If(starts):
            m.d.sync += stamp.eq(Cat(self._first_quarter(m, together, "record_quarter"), self.coarse))
        with m.If(starts | (left != 0)):
            m.d.sync += [seen.eq(seen_next), left.eq(left_next)]
            with m.If(left_next == 0):
                m.d.sync += self.latched.eq(popcount(m, seen_next, "seen_count") >= self.frame.mg_threshold)
