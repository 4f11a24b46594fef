# SPDX-License-Identifier: Apache-2.0
"""Minigroup: the leaf of the coincID tree, and the minigroup's own stamping circuit.

The paper (III-A): the subgroup is clustered into minigroups; every minigroup "provides a coarse
timestamp along with generating the spatial address/ID of the contributing events". Our choices are
the collection that latches a record, its stamp in quarters of a cycle, and the step of the coarse
offsets.
"""

from itertools import pairwise
from typing import Any

from amaranth.hdl import Cat, Const, Module, Mux, ResetSignal, Signal, Value
from amaranth.lib.wiring import In, Out

from ..model.contract.parameters import Sensor
from . import bus
from .clock_gate import ClockGate, behind
from .logic import any_of, first_one, least, popcount
from .memory import Memory
from .unit import Unit, place


def hit_ports(sensor: Sensor, pixels: int) -> dict[str, Any]:
    """Return the ports for counts: accepted, quarters (stage 2), if the sensor has counts."""
    return {"accepted": Out(pixels), "quarters": Out(2 * pixels)} if sensor.counts else {}


class Recorder(Unit):
    """What minigroups have in common in both views: coarse offsets, and the minigroup's own
    stamping circuit.

    own: further ports. `Minigroup` describes the common ones. A method that forms one of the
    circuits returns the condition under which the circuit's registers may change.
    """

    def __init__(self, sensor: Sensor, **own: Any):
        self.sensor = sensor
        super().__init__(
            **own,
            blind=Out(1),
            opening=In(1),
            elapsed=In(sensor.elapsed_bits),
            hits=Out(sensor.minigroup_pixels),
            offset=Out(sensor.offset_bits),
            frame=In(bus.frame_layout(sensor)),
            may_open=In(1),
            wrap=In(1),
            coarse=In(sensor.coarse_bits),
            latched=Out(1),
            entry=Out(bus.entry_layout(sensor)),
            test_enable=In(1),
        )
        # The record collection.
        self.left = Signal(2)  # its cycles after the present one
        self.seen = Signal(sensor.minigroup_pixels, reset_less=True)  # its map
        self.started = Signal(reset_less=True)  # it began one cycle ago
        self.stamp = Memory(1, sensor.record_stamp_bits)

    def _stamps(self, m, platform, active, begins, step_4) -> list[Value]:
        """Form offsets and records, or, in a sensor without them, zeros. Arguments: as below."""
        moves = []
        if self.sensor.offsets:
            moves.append(self._offset(m, begins, step_4))
        else:
            m.d.comb += self.offset.eq(0)
        if self.sensor.records:
            moves.append(self._record(m, platform, active, step_4))
        else:
            m.d.comb += [
                self.latched.eq(0),
                self.entry.eq(Const({}, self.entry.shape())),
            ]
        return moves

    def _offset(self, m, begins, step_4) -> Value:
        """Stages 5 to 8: form the offset of a window's first edge.

        A strobe and a step travel along, because they have fewer bits.

        begins: the edge is the minigroup's first in the window (stage 4).
        """
        offset = Signal(len(self.offset), reset_less=True)
        stages = range(5, 8)
        strobes = [begins, *(Signal(name=f"begins_{n}", reset_less=True) for n in stages)]
        steps = [step_4, *(Signal.like(step_4, name=f"step_{n}") for n in stages)]
        moves = Cat(strobes).any()
        with m.If(ResetSignal() | moves):
            for delayed in (strobes, steps):
                for sooner, later in pairwise(delayed):
                    m.d.sync += later.eq(sooner)
        with m.If(strobes[-1]):
            m.d.sync += offset.eq(Cat(steps[-1], self.elapsed))
        m.d.comb += self.offset.eq(offset)
        return moves

    def _record(self, m, platform, active, step_4) -> Value:
        """Stage 3: the record collection, which is the minigroup's own stamping circuit.

        active: pixels with an edge in the cycle; step_4: step of the first of these edges, one
        cycle later.
        """
        pixels = len(active)
        left = self.left
        seen = self.seen
        # The stamp is written one cycle later, when it is known. It is never written while an entry
        # is taken, because its memory may consist of latches.
        place(
            m,
            "stamp",
            self.stamp,
            platform,
            write=self.started,
            data=Cat(step_4[-2:], self.coarse),  # quarter of the cycle
            test_enable=self.test_enable,
        )
        starts = Signal()
        runs = Signal()
        seen_next = Signal(pixels)
        left_next = Signal(2)
        ends = Signal()
        enough = Signal()
        m.d.comb += [
            starts.eq(
                self.frame.minigroup_records
                & active.any()
                & self.may_open
                & (self.wrap | ((left == 0) & ~self.latched))
            ),
            runs.eq(starts | (left != 0)),
            seen_next.eq((active & runs.replicate(pixels)) | (seen & ~starts.replicate(pixels))),
            left_next.eq(Mux(starts, self.frame.mg_window, left) - runs),
            ends.eq(runs & (left_next == 0)),
            enough.eq(popcount(m, seen_next, "seen_count") >= self.frame.mg_threshold),
            self.entry.map.eq(seen),
            self.entry.stamp.eq(self.stamp.value),
        ]
        moves = runs | self.started | (self.wrap & self.latched)
        with m.If(ResetSignal() | moves):
            m.d.sync += [
                self.started.eq(starts),
                seen.eq(seen_next),
                left.eq(left_next),
                self.latched.eq(Mux(ends, enough, self.latched & ~self.wrap)),
            ]
        return moves


class Minigroup(Recorder):
    """Leaf of the tree with `minigroup_pixels` SPADs.

    Stages count from the port: edges at 1, the window at 2, hits and record at 3, map at 5, offset
    at 8.

    Ports
    -----
    words : in, pixels * phases bits, the SPADs' edge words; mask : in, pixels (stage 0)
    root : out, phases, OR of the words of the unmasked pixels (stage 0: straight from the port to a
        register of the tree)
    accept : in, the gate is open and a frame is running (stage 1)
    whole : in, the window covers the cycle; part : in, it covers the phases before `end`; first :
        in, the cycle's first phase (stage 2)
    at_first : out, pixels, the pixel's edge is at that phase (stage 2)
    blind : out, an accepted edge lies outside the window (stage 3)
    accepted, quarters : out, pixels with an accepted edge, and its quarter of the cycle, if counts
        are built (stage 2)
    opening : in, the window opened in this cycle (stage 4)
    hits : out, pixels, the window's map (stage 5)
    elapsed : in, cycles since the window opened (stage 7)
    offset : out, coarse offset of the first counted edge, valid if hits was not 0 (stage 8, at
        which the FIFO takes it)
    frame : in, settings; may_open, wrap : in (stage 3); coarse : in, coarse count of the TDC (stage
        4)
    latched, entry : out, the record of the period, to be taken during `wrap` (stage 3)
    test_enable : in, opens clock gate and latches for a test of the chip

    Reset clears the record circuit. The rest needs no reset, because nothing is accepted outside a
    frame and every window starts from an empty map. All stages load in a reset. Otherwise those
    that are undefined at power-on stay so in a simulator with four states, because their own value
    is in the condition under which they load.

    The registers of stages 1, 3 and 5, and of the stages behind each, change only while they hold
    or get something valid. Otherwise a gate stops the minigroup's clock.
    """

    unit_name = "coincid_minigroup"

    def __init__(self, sensor: Sensor):
        pixels = sensor.minigroup_pixels
        phases = sensor.phases
        super().__init__(
            sensor,
            words=In(pixels * phases),
            mask=In(pixels),
            accept=In(1),
            root=Out(phases),
            whole=In(1),
            part=In(1),
            end=In(sensor.phase_bits),
            first=In(sensor.phase_bits),
            at_first=Out(pixels),
            **hit_ports(sensor, pixels),
        )
        # Numbers are those of stages.
        self.valid_1 = Signal(pixels, reset_less=True)  # pixels with an edge
        self.valid_2 = Signal(pixels, reset_less=True)  # pixels with an edge that is accepted
        self.active = Signal(pixels, reset_less=True)  # the same at stage 3
        self.hit_3 = Signal(pixels, reset_less=True)  # pixels with an edge that the window counts
        self.hit_4 = Signal(pixels, reset_less=True)
        # Phase of each pixel's first edge; the last phase if it has none.
        self.phases_1 = self._phases("phases_1")
        self.phases_2 = self._phases("phases_2")
        self.step = Signal(sensor.step_bits, reset_less=True)  # step of the first edge (stage 3)
        self.step_4 = Signal(sensor.step_bits, reset_less=True)
        self.awake_1 = Signal()  # stage 1 may change
        self.awake_3 = Signal()  # stages 2 and 3 may change
        self.clock_gate = ClockGate(small=True)

    def _phases(self, name: str) -> list[Signal]:
        """Return a register for a phase of each pixel."""
        bits = self.sensor.phase_bits
        pixels = range(self.sensor.minigroup_pixels)
        return [Signal(bits, name=f"{name}_{i}", reset_less=True) for i in pixels]

    def elaborate(self, platform):
        m = Module()
        self._edges(m)
        self._hits(m)
        awake = [
            self.awake_1,
            self.awake_3,
            *self._map(m, platform),
        ]
        return behind(m, platform, self.clock_gate, Cat(awake).any(), self.test_enable)

    def _edges(self, m):
        """Stages 1 and 2: encode each pixel's word at the port: is there an edge, and at which
        phase is the first one?

        The words themselves are not registered: at 32 phases, that register would be the largest
        part of the sensor.
        """
        sensor = self.sensor
        pixels = sensor.minigroup_pixels
        phases = sensor.phases
        valid_0 = Signal(pixels)
        roots = [Signal(phases, name=f"root_{i}") for i in range(pixels)]
        for i, root in enumerate(roots):
            word = self.words.word_select(i, phases)
            on = self.mask[i]
            valid, phase = first_one(m, word, f"first_{i}")
            m.d.comb += [root.eq(word & on.replicate(phases)), valid_0[i].eq(valid & on)]
            with m.If(self.awake_1):
                m.d.sync += self.phases_1[i].eq(phase | ~on.replicate(sensor.phase_bits))
        m.d.comb += [
            self.root.eq(any_of(m, roots, "root_or")),
            self.awake_1.eq(ResetSignal() | valid_0.any() | self.valid_1.any()),
            self.awake_3.eq(
                ResetSignal() | Cat(self.valid_1, self.valid_2, self.active, self.hit_3).any()
            ),
        ]
        with m.If(self.awake_1):
            m.d.sync += self.valid_1.eq(valid_0)
        with m.If(self.awake_3):
            m.d.sync += [
                self.valid_2.eq(self.valid_1 & self.accept.replicate(pixels)),
                *(
                    phase_2.eq(phase_1)
                    for phase_1, phase_2 in zip(self.phases_1, self.phases_2, strict=True)
                ),
            ]

    def _hits(self, m):
        """Stages 2 and 3: find the pixels with an edge, those that the window counts, and the step
        of the first edge.

        A pixel without an edge has the last phase, so it is never earlier than one with an edge.
        """
        sensor = self.sensor
        pixels = sensor.minigroup_pixels
        before_end = Cat(phase < self.end for phase in self.phases_2)
        steps = [phase[-sensor.step_bits :] for phase in self.phases_2]
        m.d.comb += [
            self.at_first.eq(self.valid_2 & Cat(phase == self.first for phase in self.phases_2)),
            self.blind.eq((self.active & ~self.hit_3).any()),
        ]
        if sensor.counts:
            m.d.comb += [
                self.accepted.eq(self.valid_2),
                self.quarters.eq(Cat(phase[-2:] for phase in self.phases_2)),
            ]
        counted = self.whole.replicate(pixels) | (self.part.replicate(pixels) & before_end)
        with m.If(self.awake_3):
            m.d.sync += [
                self.active.eq(self.valid_2),
                self.hit_3.eq(self.valid_2 & counted),
                self.step.eq(least(m, steps, "first_step")),
            ]

    def _map(self, m, platform) -> list[Value]:
        """Stages 4 and 5: collect the hits in the map, and what a window and a record get of them.

        In a cycle, the window counts the earlier edges and not the later ones. So the first edge is
        a counted one.
        """
        pixels = self.sensor.minigroup_pixels
        hits = Signal(pixels, reset_less=True)
        moves = Cat(self.active, self.hit_4).any() | (self.opening & hits.any())
        empties = self.opening | ResetSignal()
        with m.If(ResetSignal() | moves):
            m.d.sync += [
                self.hit_4.eq(self.hit_3),
                self.step_4.eq(self.step),
                hits.eq(self.hit_4 | (hits & ~empties.replicate(pixels))),
            ]
        m.d.comb += self.hits.eq(hits)
        begins = self.hit_4.any() & (self.opening | ~hits.any())
        return [
            moves,
            *self._stamps(m, platform, self.active, begins, self.step_4),
        ]
