# SPDX-License-Identifier: Apache-2.0
"""CoincID tree: combines the minigroups into the subgroup's root, runs the coincidence window, and identifies its pixels.

The paper (III-A): the tree is "modelled to propagate events and perform coincidence along with generating the address
or ID of the SPADs which contributed to an event"; after every detection it "resets itself, making it available for
the successive detection". Window arithmetic, the lowest index as winner, and the guard at a period's end are our
choice.
"""

from typing import Any

from amaranth.hdl import C, Cat, Module, Mux, Signal, Value
from amaranth.lib.wiring import In, Out, Signature

from ..model.contract.parameters import Sensor, bits_for
from . import bus
from .clock_gate import ClockGate, stopped
from .logic import any_of, lowest, named, popcount, total
from .minigroup import Minigroup, Recorder
from .tdc import line_signature
from .unit import Unit, place


class WindowState:
    """Inner registers and signals of a front end, in every view.

    elapsed: cycles since the window opened, saturated. hits: of its map, collected by the leaves. closed: it has closed
    (stage 5). half, counts: a window whose pixels have been counted in parts (stage 6).
    """

    def __init__(self, sensor: Sensor):
        self.elapsed = Signal(sensor.elapsed_bits)
        self.hits = Signal(sensor.pixels)
        self.closed = Signal()
        self.closed_6 = Signal()
        self.half = Signal(bus.window_layout(sensor), reset_less=True)
        part = 1 << (bits_for(sensor.pixels - 1) + 1) // 2
        self.parts = [self.hits[k : k + part] for k in range(0, sensor.pixels, part)]
        self.counts = [Signal(range(len(part) + 1), name=f"count_{k}") for k, part in enumerate(self.parts)]


class FrontEnd(Unit):
    """What the front ends of both views have in common: their leaves, and the count of a closed window.

    line: the sampling line. own: ports towards the SPADs. `CoincidenceTree` describes the others.
    """

    state: WindowState

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
        )

    def _leaf(self, m, platform, g: int, leaf: Recorder, by_pixel: dict[str, Value], **shared) -> list[int]:
        """Connect minigroup `g`, and return its pixels. by_pixel: its inputs that have a part for every pixel of the subgroup."""
        state, sensor = self.state, self.sensor
        members = sensor.members(g)
        own = {
            name: Cat(value.word_select(i, len(value) // sensor.pixels) for i in members)
            for name, value in by_pixel.items()
        }
        place(m, f"minigroup_{g}", leaf, platform, elapsed=state.elapsed, frame=self.frame, **own, **shared)
        m.d.comb += [
            *([self.offsets[g].eq(leaf.offset)] if sensor.offsets else []),
            self.latched[g].eq(leaf.latched),
            self.entries[g].eq(leaf.entry),
            *(state.hits[i].eq(hit) for i, hit in zip(members, leaf.hits)),
        ]
        return members

    def _elapse(self, m, opened):
        """Stage 7: count the cycles since the window opened, for the leaves' offsets. opened: stage 6."""
        elapsed = self.state.elapsed
        with m.If(opened | ~elapsed.all()):
            m.d.sync += elapsed.eq(Mux(opened, 0, elapsed + 1))

    def _closed(self, m, stamp, winner, clock="sync"):
        """Stages 6 and 7: count a closed window in two steps of equal depth. clock: domain of the strobes."""
        state = self.state
        half, counts = state.half, state.counts
        m.d[clock] += [state.closed_6.eq(state.closed), self.closed.eq(state.closed_6)]
        with m.If(state.closed):
            m.d.sync += [half.stamp.eq(stamp), half.hits.eq(state.hits), half.winner.eq(winner)]
            m.d.sync += [
                count.eq(popcount(m, part, f"ones_{k}")) for k, (count, part) in enumerate(zip(counts, state.parts))
            ]
        with m.If(state.closed_6):
            m.d.sync += [
                self.window.stamp.eq(half.stamp),
                self.window.hits.eq(half.hits),
                self.window.winner.eq(half.winner),
                self.window.count.eq(total(m, counts, "count_sum")),
            ]


class TreeState(WindowState):
    """Inner registers and signals of a tree. Numbers are those of stages; `may_open` and `wrap` have a bit for each stage.

    left: ticks of the window from the start of the cycle, end: the same for a window that may just open; whole, part: the
    window covers all of the cycle, or the phases before its end; stamps, winners: of stages 3 to 5. openings, closings: the
    window's opening and its closing, delayed; found_blind: a minigroup has an edge outside of a window. strobes: all that
    move on in every cycle, until they are out, behind a gate of their own: `clock` is their domain.
    """

    clock: str

    def __init__(self, sensor: Sensor):
        super().__init__(sensor)
        self.leaves = [Minigroup(sensor) for _ in range(sensor.minigroups)]
        self.may_open = Signal(5)
        self.wrap = Signal(5)
        self.coarse_4 = Signal(sensor.coarse_bits)
        self.window_open = Signal()
        self.left = Signal(range(sensor.window_max + sensor.phases))
        self.rearm = Signal(range(sensor.rearm + 1))
        self.opening = Signal()
        self.closing = Signal()
        self.end = Signal.like(self.left)
        self.whole, self.part = named("whole part")
        self.at_first = Signal(sensor.pixels)
        self.openings = [Signal(name=f"opening_{n}") for n in (3, 4, 5, 6)]
        self.closings = [Signal(name=f"closing_{n}") for n in (3, 4)] + [self.closed]
        self.opening_4 = self.openings[1]
        self.found_blind, self.blind = named("found_blind blind")
        self.strobes = [*self.openings, *self.closings, self.closed_6, self.blind, self.wrap]
        self.stamps = [Signal(sensor.stamp_bits, name=f"stamp_{n}") for n in (3, 4, 5)]
        self.winners = [Signal(sensor.winner_bits, name=f"winner_{n}") for n in (3, 4, 5)]


class CoincidenceTree(FrontEnd):
    """Tree of a subgroup with its coincidence window.

    Stages count from the port, as in `Minigroup`. A window that closes in cycle c leaves at stage 7, in cycle c + 7.

    Ports
    -----
    words : in, pixels * phases, edge words; mask : in (stage 0). accept : in (stage 1)
    window_ticks : in, the coincidence window (1 if coincidence is off); frame : in, settings
    timing : in, registered in the module, two cycles ahead of the ports
    line : the subgroup's TDC sampling line
    closed : out, a window has closed, and `window` holds it (stage 7); offsets : out, its minigroups' offsets (stage 8)
    blind : out, a cycle with an edge while the tree was not armed (stage 5)
    record_due : out, a period has ended; latched, entries : out, its minigroups' records (stage 3)

    Reset arms the tree. Two windows of one subgroup may follow each other without a gap: the pipeline takes one per cycle.
    """

    unit_name = "coincid_tree"
    state: TreeState

    def __init__(self, sensor: Sensor):
        words, mask = In(sensor.pixels * sensor.phases), In(sensor.pixels)
        super().__init__(sensor, line_signature(sensor), words=words, mask=mask, accept=In(1))
        self.state = TreeState(sensor)
        self.clock_gate = ClockGate(small=True)

    def elaborate(self, platform):
        m = Module()
        sensor = self.sensor
        # Root: sampled at stage 1, and decoded by the TDC line behind it.
        leaves = self.state.leaves
        root = Signal(sensor.phases, reset_less=True)
        sampled = Signal(sensor.phases)
        m.d.comb += sampled.eq(any_of(m, [leaf.root for leaf in leaves], "root_or"))
        with m.If(sampled.any() | root.any()):
            m.d.sync += root.eq(sampled)
        m.d.comb += self.line.root.eq(root & self.accept.replicate(sensor.phases))
        state = self.state
        moving = (
            Cat(state.opening, state.closing, state.found_blind, self.timing.wrap, *state.strobes).any()
            | (Cat(self.timing.may_open, state.may_open[:-1]) != state.may_open)
            | Cat(self.closed, self.blind).any()
        )
        state.clock = stopped(m, platform, self.clock_gate, moving)
        self._strobes(m)
        self._window(m)
        self._opened(m)
        self._leaves(m, platform)
        self._closed(m, state.stamps[-1], state.winners[-1], state.clock)
        return m

    def _strobes(self, m):
        """Delay the timing strobes to stage 3: they come two cycles ahead of the ports; one register makes it one cycle."""
        state = self.state
        coarse_3 = Signal.like(state.coarse_4)
        m.d[state.clock] += [
            state.may_open.eq((state.may_open << 1) | self.timing.may_open),
            state.wrap.eq((state.wrap << 1) | self.timing.wrap),
        ]
        with m.If(self.frame.minigroup_records):
            m.d.sync += [coarse_3.eq(self.line.coarse), state.coarse_4.eq(coarse_3)]
        m.d.comb += self.record_due.eq(state.wrap[-1])

    def _window(self, m):
        """Stage 2: the window, and the part of the cycle that it covers. The one-cycle loop is only (open, left, rearm)."""
        state, phases = self.state, self.sensor.phases
        live, to_border = named("live to_border")
        m.d.comb += [
            state.opening.eq(~state.window_open & (state.rearm == 0) & state.may_open[-2] & self.line.any),
            live.eq(state.opening | state.window_open),
            state.end.eq(Mux(state.window_open, state.left, self.line.phase + self.window_ticks)),
            state.closing.eq(live & (state.end <= phases)),
            to_border.eq(state.end >= phases),
            state.whole.eq(live & to_border),
            state.part.eq(live & ~to_border),
        ]
        with m.If(live):
            m.d.sync += [state.left.eq(state.end - phases), state.window_open.eq(~state.closing)]
        with m.If(state.closing):
            m.d.sync += state.rearm.eq(self.sensor.rearm)
        with m.Elif(state.rearm != 0):
            m.d.sync += state.rearm.eq(state.rearm - 1)

    def _opened(self, m):
        """Stages 3 to 5: stamp and winner of the opening edge."""
        state, sensor = self.state, self.sensor
        m.d[state.clock] += [
            Cat(state.openings).eq(Cat(state.opening, state.openings[:-1])),
            Cat(state.closings).eq(Cat(state.closing, state.closings[:-1])),
        ]
        self._elapse(m, state.openings[-1])
        one_of = Cat(state.at_first, C(0, (1 << sensor.winner_bits) - sensor.pixels))
        with m.If(state.opening):
            m.d.sync += [
                state.stamps[0].eq(Cat(self.line.phase, self.line.coarse)),
                state.winners[0].eq(lowest(m, one_of, "winner")),
            ]
        for n, strobe in enumerate(state.openings[:2]):
            with m.If(strobe):
                m.d.sync += [delayed[n + 1].eq(delayed[n]) for delayed in (state.stamps, state.winners)]

    def _leaves(self, m, platform):
        """Connect the minigroups."""
        state = self.state
        shared = {
            "accept": self.accept,
            "whole": state.whole,
            "part": state.part,
            "end": state.end[: self.sensor.phase_bits],
            "first": self.line.phase,
            "opening": state.opening_4,
            "may_open": state.may_open[-1],
            "wrap": state.wrap[-1],
            "coarse": state.coarse_4,
        }
        for g, leaf in enumerate(state.leaves):
            members = self._leaf(m, platform, g, leaf, {"words": self.words, "mask": self.mask}, **shared)
            m.d.comb += [state.at_first[i].eq(here) for i, here in zip(members, leaf.at_first)]
        m.d.comb += state.found_blind.eq(any_of(m, [leaf.blind for leaf in state.leaves], "blind_or"))
        m.d[state.clock] += [state.blind.eq(state.found_blind), self.blind.eq(state.blind)]
