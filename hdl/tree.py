# SPDX-License-Identifier: Apache-2.0
"""CoincID tree: combines the minigroups into the subgroup's root, runs the coincidence window, and
identifies its pixels.

The paper (III-A): the tree is "modelled to propagate events and perform coincidence along with
generating the address or ID of the SPADs which contributed to an event"; after every detection it
"resets itself, making it available for the successive detection". Window arithmetic, the lowest
index as winner, and the guard at a period's end are our choice.
"""

from typing import Any

from amaranth.hdl import C, Cat, Module, Mux, Signal, Value
from amaranth.lib.wiring import In, Out, Signature

from ..model.contract.parameters import Sensor, bits_for
from . import bus
from .clock_gate import ClockGate, stopped
from .logic import any_of, lowest, popcount, total
from .minigroup import Minigroup, Recorder, hit_ports
from .tdc import line_signature
from .unit import Unit, place


class FrontEnd(Unit):
    """What the front ends of both views have in common: their leaves, and the count of a closed
    window.

    line: the sampling line. own: ports towards the SPADs. `CoincidenceTree` describes the others.
    """

    def __init__(self, sensor: Sensor, line: Signature, **own: Any):
        self.sensor = sensor
        super().__init__(
            **own,
            window_ticks=In(sensor.window_bits),
            frame=In(bus.frame_layout(sensor)),
            timing=In(bus.time_layout(sensor)),
            line=Out(line),
            closed=Out(1),
            window=Out(bus.window_layout(sensor)),
            offsets=Out(bus.offsets_layout(sensor)),
            blind=Out(1),
            record_due=Out(1),
            latched=Out(sensor.minigroups),
            entries=Out(bus.record_layout(sensor)["entries"].shape),
            test_enable=In(1),
        )
        self.elapsed = Signal(sensor.elapsed_bits)  # cycles since the window opened, saturated
        self.hits = Signal(sensor.pixels)  # map of the window, collected by the leaves
        self.closed_5 = Signal()  # the window has closed (stage 5)
        self.closed_6 = Signal()
        # A window whose pixels have been counted in parts (stage 6).
        self.half = Signal(bus.window_layout(sensor), reset_less=True)
        part = 1 << (bits_for(sensor.pixels - 1) + 1) // 2
        self.parts = [self.hits[k : k + part] for k in range(0, sensor.pixels, part)]
        self.counts = [
            Signal(range(len(part) + 1), name=f"counts_{k}") for k, part in enumerate(self.parts)
        ]

    def _leaf(self, m, g: int, leaf: Recorder) -> None:
        """Collect what minigroup `g` gives."""
        sensor = self.sensor
        m.d.comb += [
            self.offsets[g].eq(leaf.offset if sensor.offsets else 0),
            self.latched[g].eq(leaf.latched),
            self.entries[g].eq(leaf.entry),
        ]
        for i, hit in zip(sensor.members(g), leaf.hits, strict=True):
            m.d.comb += self.hits[i].eq(hit)

    def _of_minigroup(self, g: int, bits: Value) -> Value:
        """Return the part of minigroup `g` in a value that has a part for every pixel."""
        width = len(bits) // self.sensor.pixels
        return Cat(bits.word_select(i, width) for i in self.sensor.members(g))

    def _elapse(self, m, opened):
        """Stage 7: count the cycles since the window opened, for the leaves' offsets. opened: stage
        6.
        """
        elapsed = self.elapsed
        with m.If(opened | ~elapsed.all()):
            m.d.sync += elapsed.eq(Mux(opened, 0, elapsed + 1))

    def _closed(self, m, stamp, winner, clock="sync"):
        """Stages 6 and 7: count a closed window in two steps of equal depth. clock: domain of the
        strobes.
        """
        half = self.half
        counts = self.counts
        m.d[clock] += [self.closed_6.eq(self.closed_5), self.closed.eq(self.closed_6)]
        with m.If(self.closed_5):
            m.d.sync += [half.stamp.eq(stamp), half.hits.eq(self.hits), half.winner.eq(winner)]
            for k, (count, part) in enumerate(zip(counts, self.parts, strict=True)):
                m.d.sync += count.eq(popcount(m, part, f"ones_{k}"))
        with m.If(self.closed_6):
            m.d.sync += [
                self.window.stamp.eq(half.stamp),
                self.window.hits.eq(half.hits),
                self.window.winner.eq(half.winner),
                self.window.count.eq(total(m, counts, "count_sum")),
            ]


class CoincidenceTree(FrontEnd):
    """Tree of a subgroup with its coincidence window.

    Stages count from the port, as in `Minigroup`. A window that closes in cycle c leaves at stage
    7, in cycle c + 7.

    Ports
    -----
    words : in, pixels * phases, edge words; mask : in (stage 0). accept : in (stage 1)
    window_ticks : in, the coincidence window (1 if coincidence is off); frame : in, settings
    timing : in, registered in the module, two cycles ahead of the ports
    line : the subgroup's TDC sampling line
    accepted, quarters : out, of all pixels, in the order of minigroups, if counts are built (stage 2)
    closed : out, a window has closed, and `window` holds it (stage 7); offsets : out, its
        minigroups' offsets (stage 8)
    blind : out, a cycle with an accepted edge outside of the window (stage 5)
    record_due : out, a period has ended; latched, entries : out, its minigroups' records (stage 3)
    test_enable : in, opens clock gates and latches for a test of the chip

    Reset arms the tree. Two windows of one subgroup may follow each other without a gap: the
    pipeline takes one per cycle.
    """

    unit_name = "coincid_tree"

    def __init__(self, sensor: Sensor):
        super().__init__(
            sensor,
            line_signature(sensor),
            words=In(sensor.pixels * sensor.phases),
            mask=In(sensor.pixels),
            accept=In(1),
            **hit_ports(sensor, sensor.pixels),
        )
        self.leaves = [Minigroup(sensor) for _ in range(sensor.minigroups)]
        # Numbers are those of stages.
        self.may_open = Signal(5)  # bit n: a window may open in the cycle at stage n - 1
        self.wrap = Signal(5)  # bit n: the cycle at stage n - 1 follows a period's last one
        self.coarse_4 = Signal(sensor.coarse_bits)  # number of the cycle in its period, for records
        # The window, at stage 2.
        ticks = range(sensor.window_max + sensor.phases)
        self.window_open = Signal()  # it opened in an earlier cycle and goes on
        self.left = Signal(ticks)  # its ticks from the start of the cycle
        self.end = Signal(ticks)  # the same, also for a window that may just open
        self.rearm = Signal(range(sensor.rearm + 1))  # cycles until the next one may open
        self.opening = Signal()  # it opens in this cycle
        self.closing = Signal()  # it closes in this cycle
        self.whole = Signal()  # it covers the whole cycle
        self.part = Signal()  # it covers the phases before its end
        self.at_first = Signal(sensor.pixels)  # pixels with an edge at the cycle's first phase
        self.found_blind = Signal()  # a minigroup has an edge outside of a window (stage 3)
        self.blind_4 = Signal()
        # Strobes and numbers of the window on their way to stage 7.
        self.opening_3 = Signal()
        self.opening_4 = Signal()
        self.opening_5 = Signal()
        self.opening_6 = Signal()
        self.closing_3 = Signal()
        self.closing_4 = Signal()
        self.stamp_3 = Signal(sensor.stamp_bits)  # time of the opening edge
        self.stamp_4 = Signal(sensor.stamp_bits)
        self.stamp_5 = Signal(sensor.stamp_bits)
        self.winner_3 = Signal(sensor.winner_bits)  # pixel of the opening edge
        self.winner_4 = Signal(sensor.winner_bits)
        self.winner_5 = Signal(sensor.winner_bits)
        # Everything that moves on in every cycle, until it is out; a gate of its own drives its
        # clock domain, `clock`.
        self.strobes = [
            self.opening_3,
            self.opening_4,
            self.opening_5,
            self.opening_6,
            self.closing_3,
            self.closing_4,
            self.closed_5,
            self.closed_6,
            self.blind_4,
            self.wrap,
        ]
        self.clock_gate = ClockGate(small=True)

    def elaborate(self, platform):
        m = Module()
        sensor = self.sensor
        # Root: sampled at stage 1, and decoded by the TDC line behind it.
        leaves = self.leaves
        root = Signal(sensor.phases, reset_less=True)
        sampled = Signal(sensor.phases)
        m.d.comb += sampled.eq(any_of(m, [leaf.root for leaf in leaves], "root_or"))
        with m.If(sampled.any() | root.any()):
            m.d.sync += root.eq(sampled)
        m.d.comb += self.line.root.eq(root & self.accept.replicate(sensor.phases))
        moving = (
            Cat(self.opening, self.closing, self.found_blind, self.timing.wrap, *self.strobes).any()
            | (Cat(self.timing.may_open, self.may_open[:-1]) != self.may_open)
            | Cat(self.closed, self.blind).any()
        )
        self.clock = stopped(m, platform, self.clock_gate, moving, self.test_enable)
        self._strobes(m)
        self._window(m)
        self._opened(m)
        self._leaves(m, platform)
        self._closed(m, self.stamp_5, self.winner_5, self.clock)
        return m

    def _strobes(self, m):
        """Delay the timing strobes, which come two cycles ahead of the ports, to stage 3."""
        coarse_3 = Signal.like(self.coarse_4)
        m.d[self.clock] += [
            self.may_open.eq((self.may_open << 1) | self.timing.may_open),
            self.wrap.eq((self.wrap << 1) | self.timing.wrap),
        ]
        with m.If(self.frame.minigroup_records):
            m.d.sync += [coarse_3.eq(self.line.coarse), self.coarse_4.eq(coarse_3)]
        m.d.comb += self.record_due.eq(self.wrap[-1])

    def _window(self, m):
        """Stage 2: the window, and the part of the cycle that it covers. Only (open, left, rearm)
        loop within one cycle.
        """
        phases = self.sensor.phases
        live = Signal()  # a window is open in the cycle
        to_border = Signal()  # it would reach the cycle's end
        m.d.comb += [
            self.opening.eq(
                ~self.window_open & (self.rearm == 0) & self.may_open[-2] & self.line.any
            ),
            live.eq(self.opening | self.window_open),
            self.end.eq(Mux(self.window_open, self.left, self.line.phase + self.window_ticks)),
            self.closing.eq(live & (self.end <= phases)),
            to_border.eq(self.end >= phases),
            self.whole.eq(live & to_border),
            self.part.eq(live & ~to_border),
        ]
        with m.If(live):
            m.d.sync += [self.left.eq(self.end - phases), self.window_open.eq(~self.closing)]
        with m.If(self.closing):
            m.d.sync += self.rearm.eq(self.sensor.rearm)
        with m.Elif(self.rearm != 0):
            m.d.sync += self.rearm.eq(self.rearm - 1)

    def _opened(self, m):
        """Stages 3 to 5: stamp and winner of the opening edge."""
        sensor = self.sensor
        m.d[self.clock] += [
            self.opening_3.eq(self.opening),
            self.opening_4.eq(self.opening_3),
            self.opening_5.eq(self.opening_4),
            self.opening_6.eq(self.opening_5),
            self.closing_3.eq(self.closing),
            self.closing_4.eq(self.closing_3),
            self.closed_5.eq(self.closing_4),
        ]
        self._elapse(m, self.opening_6)
        one_of = Cat(self.at_first, C(0, (1 << sensor.winner_bits) - sensor.pixels))
        with m.If(self.opening):
            m.d.sync += [
                self.stamp_3.eq(Cat(self.line.phase, self.line.coarse)),
                self.winner_3.eq(lowest(m, one_of, "winner")),
            ]
        with m.If(self.opening_3):
            m.d.sync += [
                self.stamp_4.eq(self.stamp_3),
                self.winner_4.eq(self.winner_3),
            ]
        with m.If(self.opening_4):
            m.d.sync += [
                self.stamp_5.eq(self.stamp_4),
                self.winner_5.eq(self.winner_4),
            ]

    def _leaves(self, m, platform):
        """Place the minigroups."""
        for g, leaf in enumerate(self.leaves):
            place(
                m,
                f"minigroup_{g}",
                leaf,
                platform,
                words=self._of_minigroup(g, self.words),
                mask=self._of_minigroup(g, self.mask),
                accept=self.accept,
                whole=self.whole,
                part=self.part,
                end=self.end[: self.sensor.phase_bits],
                first=self.line.phase,
                opening=self.opening_4,
                elapsed=self.elapsed,
                frame=self.frame,
                may_open=self.may_open[-1],
                wrap=self.wrap[-1],
                coarse=self.coarse_4,
                test_enable=self.test_enable,
            )
            self._leaf(m, g, leaf)
            for i, here in zip(self.sensor.members(g), leaf.at_first, strict=True):
                m.d.comb += self.at_first[i].eq(here)
        if self.sensor.counts:
            m.d.comb += [
                self.accepted.eq(Cat(leaf.accepted for leaf in self.leaves)),
                self.quarters.eq(Cat(leaf.quarters for leaf in self.leaves)),
            ]
        m.d.comb += self.found_blind.eq(any_of(m, [leaf.blind for leaf in self.leaves], "blind_or"))
        m.d[self.clock] += [self.blind_4.eq(self.found_blind), self.blind.eq(self.blind_4)]
