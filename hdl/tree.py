"""CoincID tree: combines the minigroups to the subgroup's root, runs the coincidence window, and names its pixels.

The paper (III-A): the tree is "modelled to propagate events and perform coincidence along with generating the address
or ID of the SPADs which contributed to an event"; after every detection it "resets itself, making it available for
the successive detection". Window arithmetic, the lowest index as winner, and the guard at a period's end are our
choice.
"""

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
        sensor, phases = self.sensor, self.sensor.phases
        leaves = [place(m, f"minigroup_{g}", Minigroup(sensor), platform) for g in range(sensor.minigroups)]

        # Root: sampled by the TDC line at stage 2.
        m.d.sync += self.line.root.eq(any_of(m, [leaf.root for leaf in leaves], "root_or"))

        # Timing strobes brought to stage 3 (they come two cycles ahead of the ports, one register here makes it one).
        may_open = Signal(5)
        wrap = Signal(5)
        m.d.sync += [may_open.eq((may_open << 1) | self.timing.may_open), wrap.eq((wrap << 1) | self.timing.wrap)]

        # Stage 3: the window. The loop at clock speed is only (open, left, rearm).
        window_open = Signal()
        left = Signal(range(sensor.window_max + phases))
        rearm = Signal(range(sensor.rearm + 1))
        opening = Signal()
        closing = Signal()
        end = Signal(range(sensor.window_max + phases))
        inside = Signal(phases)
        first = Signal(phases)
        m.d.comb += [
            opening.eq(~window_open & (rearm == 0) & may_open[-1] & self.line.any),
            end.eq(Mux(window_open, left, self.line.phase + self.window_ticks)),
            closing.eq((opening | window_open) & (end <= phases)),
            first.eq(self.line.up_to & ~(self.line.up_to << 1)),
        ]
        below_end = Signal(phases)  # phases before the open window's end
        m.d.comb += below_end.eq(Mux(left >= phases, ~0, (C(1, phases + 1) << left[: bits_for(phases - 1)]) - 1))
        after = Signal(phases)  # phases from the end of a window that opens now
        m.d.comb += after.eq(
            Mux(self.window_ticks >= phases, 0, self.line.up_to << self.window_ticks[: bits_for(phases - 1)])
        )
        m.d.comb += inside.eq(Mux(window_open, below_end, ~after & opening.replicate(phases)))
        with m.If(opening | window_open):
            m.d.sync += [left.eq(end - phases), window_open.eq(~closing)]
        with m.If(closing):
            m.d.sync += rearm.eq(sensor.rearm)
        with m.Elif(rearm != 0):
            m.d.sync += rearm.eq(rearm - 1)

        # Stage 4 and 5: the leaves find their hits and collect the map; the stamp of the opening edge stays beside it.
        opening_4 = Signal()
        closing_4 = Signal()
        closed = Signal()
        elapsed = Signal.like(leaves[0].elapsed)
        stamp_4 = Signal(sensor.stamp_bits)
        stamp = Signal(sensor.stamp_bits)
        m.d.sync += [
            opening_4.eq(opening),
            closing_4.eq(closing),
            closed.eq(closing_4),
            elapsed.eq(Mux(opening, 0, elapsed + 1)),
            self.blind.eq(any_of(m, [leaf.blind for leaf in leaves], "blind_or")),
        ]
        with m.If(opening):
            m.d.sync += stamp_4.eq(Cat(self.line.phase, self.line.coarse))
        with m.If(opening_4):
            m.d.sync += stamp.eq(stamp_4)
        hits = Signal(sensor.pixels)
        firsts = Signal(sensor.pixels)
        for g, leaf in enumerate(leaves):
            members = sensor.members(g)
            m.d.comb += [
                leaf.words.eq(Cat(self.words.word_select(i, phases) for i in members)),
                leaf.mask.eq(Cat(self.mask[i] for i in members)),
                leaf.accept.eq(self.accept),
                leaf.inside.eq(inside),
                leaf.first.eq(first),
                leaf.opening.eq(opening_4),
                leaf.elapsed.eq(elapsed),
                leaf.frame.eq(self.frame),
                leaf.may_open.eq(may_open[-1]),
                leaf.wrap.eq(wrap[-1]),
                leaf.coarse.eq(self.line.coarse),
                self.latched[g].eq(leaf.latched),
                self.entries[g].eq(leaf.entry),
            ]
            m.d.comb += [hits[i].eq(leaf.hits[j]) for j, i in enumerate(members)]
            m.d.comb += [firsts[i].eq(leaf.firsts[j]) for j, i in enumerate(members)]
        m.d.comb += self.record_due.eq(wrap[-1])

        # Stage 6 and 7: winner and count, in two steps of equal depth.
        closed_6 = Signal()
        half = Signal(bus.window_layout(sensor))
        chunk = 1 << (bits_for(sensor.pixels - 1) + 1) // 2
        chunks = [hits[at : at + chunk] for at in range(0, sensor.pixels, chunk)]
        counts = [Signal(range(len(part) + 1), name=f"count_{k}") for k, part in enumerate(chunks)]
        m.d.sync += [closed_6.eq(closed), self.closed.eq(closed_6)]
        with m.If(closed):
            m.d.sync += [
                half.stamp.eq(stamp),
                half.hits.eq(hits),
                half.winner.eq(encode(m, lowest(m, firsts, "lowest"), "winner")),
                *(half.offsets[g].eq(leaf.offset) for g, leaf in enumerate(leaves)),
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
        return m
