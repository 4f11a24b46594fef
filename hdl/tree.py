"""CoincID tree: combines the minigroups to the subgroup's root, runs the coincidence window, and names its pixels.

The paper (III-A): the tree is "modelled to propagate events and perform coincidence along with generating the address
or ID of the SPADs which contributed to an event"; after every detection it "resets itself, making it available for
the successive detection". Window arithmetic, the lowest index as winner, and the guard at a period's end are our
choice.
"""

from types import SimpleNamespace

from amaranth.hdl import C, Cat, Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract.parameters import Sensor, bits_for
from . import bus
from .logic import any_of, encode, lowest, popcount, total
from .minigroup import Minigroup
from .tdc import line_signature
from .unit import Unit, place


class CoincidenceTree(Unit):
    """The tree of a subgroup with its window.

    Stages count from the port, as in `Minigroup`; a window that closes in cycle c leaves at stage 7, that is in cycle c + 7.

    Ports
    -----
    words : in, pixels * phases, edge words (stage 0); mask, accept : in (stage 1)
    window_ticks : in, the coincidence window (1 where coincidence is off); frame : in, settings
    timing : in, registered in the module, two cycles ahead of the ports
    line : the subgroup's TDC sampling line
    closed : out, a window has closed: `window` holds it (stage 7)
    blind : out, a cycle with an edge that found the tree not armed (stage 5)
    record_due : out, a period has ended; latched, entries : out, its minigroups' records (stage 3)

    Reset arms the tree. Between two windows of one subgroup there may be no cycle at all: the pipeline takes one a cycle.
    """

    unit_name = "coincid_tree"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            {
                "words": In(sensor.pixels * sensor.phases),
                "mask": In(sensor.pixels),
                "accept": In(1),
                "window_ticks": In(sensor.window_bits),
                "frame": In(bus.frame_layout(sensor)),
                "timing": In(bus.time_layout(sensor)),
                "line": Out(line_signature(sensor)),
                "closed": Out(1),
                "window": Out(bus.window_layout(sensor)),
                "blind": Out(1),
                "record_due": Out(1),
                "latched": Out(sensor.minigroups),
                "entries": Out(bus.record_layout(sensor)["entries"].shape),
            }
        )

    def elaborate(self, platform):
        m = Module()
        sensor = self.sensor
        self.state = SimpleNamespace()
        self.state.leaves = [place(m, f"minigroup_{g}", Minigroup(sensor), platform) for g in range(sensor.minigroups)]
        # Root: sampled by the TDC line at stage 2.
        m.d.sync += self.line.root.eq(any_of(m, [leaf.root for leaf in self.state.leaves], "root_or"))
        self._strobes(m)
        self._window(m)
        self._opened(m)
        self._leaves(m)
        self._closed(m)
        return m

    def _strobes(self, m):
        """Timing strobes brought to stage 3: they come two cycles ahead of the ports, one register here makes it one."""
        state = self.state
        state.may_open = Signal(5)
        state.wrap = Signal(5)
        m.d.sync += [
            state.may_open.eq((state.may_open << 1) | self.timing.may_open),
            state.wrap.eq((state.wrap << 1) | self.timing.wrap),
        ]
        m.d.comb += self.record_due.eq(state.wrap[-1])

    def _window(self, m):
        """Stage 3: the window. The loop at clock speed is only (open, left, rearm)."""
        state, phases = self.state, self.sensor.phases
        state.window_open = window_open = Signal()
        state.left = left = Signal(
            range(self.sensor.window_max + phases)
        )  # ticks of the window from this cycle's start
        state.rearm = rearm = Signal(range(self.sensor.rearm + 1))
        state.opening = opening = Signal()
        state.closing = closing = Signal()
        end = Signal.like(left)
        m.d.comb += [
            opening.eq(~window_open & (rearm == 0) & state.may_open[-1] & self.line.any),
            end.eq(Mux(window_open, left, self.line.phase + self.window_ticks)),
            closing.eq((opening | window_open) & (end <= phases)),
        ]
        with m.If(opening | window_open):
            m.d.sync += [left.eq(end - phases), window_open.eq(~closing)]
        with m.If(closing):
            m.d.sync += rearm.eq(self.sensor.rearm)
        with m.Elif(rearm != 0):
            m.d.sync += rearm.eq(rearm - 1)
        self._covered(m, phases)

    def _covered(self, m, phases):
        """Stage 3: which phases of the cycle the window covers, and which is the first with an edge."""
        state = self.state
        state.inside = Signal(phases)
        state.first = Signal(phases)
        below_end = Signal(phases)  # phases before the open window's end
        after = Signal(phases)  # phases from the end of a window that opens now
        in_cycle = bits_for(phases - 1)
        m.d.comb += [
            state.first.eq(self.line.up_to & ~(self.line.up_to << 1)),
            below_end.eq(Mux(state.left >= phases, ~0, (C(1, phases + 1) << state.left[:in_cycle]) - 1)),
            after.eq(Mux(self.window_ticks >= phases, 0, self.line.up_to << self.window_ticks[:in_cycle])),
            state.inside.eq(Mux(state.window_open, below_end, ~after & state.opening.replicate(phases))),
        ]

    def _opened(self, m):
        """Stages 4 and 5: the stamp of the opening edge, and the cycles since; the leaves find their hits and collect the map beside it."""
        state = self.state
        state.opening_4 = Signal()
        state.closed = Signal()
        state.elapsed = Signal.like(state.leaves[0].elapsed)
        state.stamp_4 = Signal(self.sensor.stamp_bits)
        state.stamp = Signal(self.sensor.stamp_bits)
        closing_4 = Signal()
        m.d.sync += [
            state.opening_4.eq(state.opening),
            closing_4.eq(state.closing),
            state.closed.eq(closing_4),
            state.elapsed.eq(Mux(state.opening, 0, state.elapsed + 1)),
        ]
        with m.If(state.opening):
            m.d.sync += state.stamp_4.eq(Cat(self.line.phase, self.line.coarse))
        with m.If(state.opening_4):
            m.d.sync += state.stamp.eq(state.stamp_4)

    def _leaves(self, m):
        """What goes to the minigroups, and what they say."""
        state, phases = self.state, self.sensor.phases
        state.hits = Signal(self.sensor.pixels)
        state.firsts = Signal(self.sensor.pixels)
        for g, leaf in enumerate(state.leaves):
            members = self.sensor.members(g)
            m.d.comb += [
                leaf.words.eq(Cat(self.words.word_select(i, phases) for i in members)),
                leaf.mask.eq(Cat(self.mask[i] for i in members)),
                leaf.accept.eq(self.accept),
                leaf.inside.eq(state.inside),
                leaf.first.eq(state.first),
                leaf.opening.eq(state.opening_4),
                leaf.elapsed.eq(state.elapsed),
                leaf.frame.eq(self.frame),
                leaf.may_open.eq(state.may_open[-1]),
                leaf.wrap.eq(state.wrap[-1]),
                leaf.coarse.eq(self.line.coarse),
                self.latched[g].eq(leaf.latched),
                self.entries[g].eq(leaf.entry),
                *(state.hits[i].eq(leaf.hits[j]) for j, i in enumerate(members)),
                *(state.firsts[i].eq(leaf.firsts[j]) for j, i in enumerate(members)),
            ]
        m.d.sync += self.blind.eq(any_of(m, [leaf.blind for leaf in state.leaves], "blind_or"))

    def _closed(self, m):
        """Stages 6 and 7: winner and count of a closed window, in two steps of equal depth."""
        state, pixels = self.state, self.sensor.pixels
        closed_6 = Signal()
        half = Signal(bus.window_layout(self.sensor))
        chunk = 1 << (bits_for(pixels - 1) + 1) // 2
        chunks = [state.hits[at : at + chunk] for at in range(0, pixels, chunk)]
        counts = [Signal(range(len(part) + 1), name=f"count_{k}") for k, part in enumerate(chunks)]
        m.d.sync += [closed_6.eq(state.closed), self.closed.eq(closed_6)]
        with m.If(state.closed):
            m.d.sync += [
                half.stamp.eq(state.stamp),
                half.hits.eq(state.hits),
                half.winner.eq(encode(m, lowest(m, state.firsts, "lowest"), "winner")),
                *(half.offsets[g].eq(leaf.offset) for g, leaf in enumerate(state.leaves)),
                *(count.eq(popcount(m, part, f"ones_{k}")) for k, (count, part) in enumerate(zip(counts, chunks))),
            ]
        with m.If(closed_6):
            m.d.sync += [
                self.window.stamp.eq(half.stamp),
                self.window.hits.eq(half.hits),
                self.window.winner.eq(half.winner),
                self.window.offsets.eq(half.offsets),
                self.window.count.eq(total(m, counts, "count_sum")),
            ]
