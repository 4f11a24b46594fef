"""Minigroup: the leaf of the coincID tree, and the minigroup's own stamping circuit.

The paper (III-A): the subgroup is clustered into minigroups; every minigroup "provides a coarse timestamp along with generating the spatial
address/ID of the contributing events". The collection that latches a record, and quarters of a cycle as its unit, are our choice.
"""

from types import SimpleNamespace

from amaranth.hdl import C, Cat, Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract.parameters import QUARTERS, Sensor
from . import bus
from .logic import any_of, popcount
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

    Reset clears the record circuit; the rest needs none, as nothing is accepted outside a frame and every window begins afresh.
    """

    unit_name = "coincid_minigroup"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        pixels, phases = sensor.minigroup_pixels, sensor.phases
        super().__init__(
            {
                "words": In(pixels * phases),
                "mask": In(pixels),
                "accept": In(1),
                "root": Out(phases),
                "inside": In(phases),
                "first": In(phases),
                "blind": Out(1),
                "opening": In(1),
                "elapsed": In(max(1, sensor.offset_bits - 2)),
                "hits": Out(pixels),
                "firsts": Out(pixels),
                "offset": Out(sensor.offset_bits),
                "frame": In(bus.frame_layout(sensor)),
                "may_open": In(1),
                "wrap": In(1),
                "coarse": In(sensor.coarse_bits),
                "latched": Out(1),
                "entry": Out(bus.entry_layout(sensor)),
            }
        )

    def elaborate(self, platform):
        m = Module()
        self.state = SimpleNamespace()
        self._edges(m)
        self._window(m)
        self._record(m, self.state.some, self.state.active, self._first_quarter(self.state.together))
        return m

    def _words(self, words):
        """The edge words in `words`, one per pixel."""
        return [words.word_select(i, self.sensor.phases) for i in range(self.sensor.minigroup_pixels)]

    def _edges(self, m):
        """Stages 1 to 3: what the gate and the mask let through. Data move only where there is an edge: `some` says so at each stage."""
        state, pixels, phases = self.state, self.sensor.minigroup_pixels, self.sensor.phases
        state.words_2 = Signal(pixels * phases, reset_less=True)
        state.words = Signal(pixels * phases, reset_less=True)
        state.active = Signal(pixels, reset_less=True)
        state.some_2 = Signal(reset_less=True)
        state.some = Signal(reset_less=True)
        at_port = Signal(pixels * phases, reset_less=True)
        accepted = Signal(pixels * phases)
        some_1 = Signal()
        m.d.comb += [
            word.eq(edges & (self.accept & self.mask[i]).replicate(phases))
            for i, (word, edges) in enumerate(zip(self._words(accepted), self._words(at_port)))
        ]
        m.d.comb += [self.root.eq(any_of(m, self._words(accepted), "root_or")), some_1.eq(self.root.any())]
        m.d.sync += [at_port.eq(self.words), state.some_2.eq(some_1), state.some.eq(state.some_2)]
        with m.If(some_1):
            m.d.sync += state.words_2.eq(accepted)
        with m.If(state.some_2):
            m.d.sync += [
                state.words.eq(state.words_2),
                state.active.eq(Cat(word.any() for word in self._words(state.words_2))),
            ]
        state.together = any_of(m, self._words(state.words), "together")

    def _window(self, m):
        """Stages 4 and 5: the pixels that the window counts, and the map that they make."""
        state, pixels = self.state, self.sensor.minigroup_pixels
        some_4 = Signal(reset_less=True)
        active_4 = Signal(pixels, reset_less=True)
        hit = Signal(pixels, reset_less=True)
        at_first = Signal(pixels, reset_less=True)
        quarter = Signal(2, reset_less=True)
        m.d.sync += some_4.eq(state.some)
        with m.If(state.some):
            m.d.sync += [
                hit.eq(Cat((word & self.inside).any() for word in self._words(state.words))),
                at_first.eq(Cat((word & self.first).any() for word in self._words(state.words))),
                quarter.eq(self._first_quarter(state.together & self.inside)),
                active_4.eq(state.active),
            ]
        m.d.comb += self.blind.eq(some_4 & (active_4 & ~hit).any())

        hits = Signal(pixels, reset_less=True)
        firsts = Signal(pixels, reset_less=True)
        offset = Signal(len(self.offset), reset_less=True)
        with m.If(self.opening):
            m.d.sync += [hits.eq(hit & some_4.replicate(pixels)), firsts.eq(at_first & some_4.replicate(pixels))]
        with m.Elif(some_4):
            m.d.sync += hits.eq(hits | hit)
        with m.If(some_4 & (self.opening | ~hits.any())):
            m.d.sync += offset.eq(Cat(quarter, self.elapsed))
        m.d.comb += [self.hits.eq(hits), self.firsts.eq(firsts), self.offset.eq(offset)]

    def _first_quarter(self, word):
        """Number of the first quarter of the cycle with an edge in `word`, which has one."""
        size = self.sensor.quarter_ticks
        first = C(QUARTERS - 1, 2)
        for q in reversed(range(QUARTERS - 1)):
            first = Mux(word[q * size : (q + 1) * size].any(), q, first)
        return first

    def _record(self, m, some, active, quarter):
        """Stage 3: the collection of the minigroup's own stamping circuit.

        active: pixels with an edge in the cycle, valid where there is `some`; quarter: of the cycle, of the first of these edges.
        """
        state = self.state
        state.left = left = Signal(2)  # cycles of the collection, behind this one
        state.seen = seen = Signal(len(active), reset_less=True)
        state.stamp = stamp = Signal(self.sensor.record_stamp_bits, reset_less=True)
        starts = Signal()
        runs = Signal()
        seen_next = Signal(len(active))
        left_next = Signal(2)
        added = active & some.replicate(len(active))
        m.d.comb += [
            starts.eq(
                self.frame.minigroup_records & some & self.may_open & (self.wrap | ((left == 0) & ~self.latched))
            ),
            runs.eq(starts | (left != 0)),
            seen_next.eq(Mux(starts, added, seen | added)),
            left_next.eq(Mux(starts, self.frame.mg_window, left) - 1),
            self.entry.map.eq(seen),
            self.entry.stamp.eq(stamp),
        ]

        # Both outcomes are counted beside the question whether a collection starts, which is known last.
        def enough(pixels, name):
            return popcount(m, pixels, name) >= self.frame.mg_threshold

        alone, with_seen = enough(active, "alone_count"), enough(seen | added, "seen_count")
        with m.If(self.wrap):
            m.d.sync += self.latched.eq(0)
        with m.If(starts):
            m.d.sync += stamp.eq(Cat(quarter, self.coarse))
        with m.If(runs):
            m.d.sync += [seen.eq(seen_next), left.eq(left_next)]
            with m.If(left_next == 0):
                m.d.sync += self.latched.eq(Mux(starts, alone, with_seen))
