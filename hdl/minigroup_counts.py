# SPDX-License-Identifier: Apache-2.0
"""Counts of a minigroup: the memory, and what each cycle's hits add to it.

`docs/contract.md` has the rule. The paper has no counts; all of this is our own choice.
"""

from amaranth.hdl import Cat, Const, Module, Mux, ResetSignal, Signal, Value
from amaranth.lib.wiring import In, Out

from ..model.contract import counts
from ..model.contract.parameters import QUARTERS, Sensor
from . import bus
from .clock_gate import ClockGate, behind
from .logic import popcount
from .memory import Memory
from .unit import Unit, place

NOTE_BITS = bus.PULSE_BITS  # the pulse with which a pixel stopped; before that, marks of wide bins
NOTES = counts.WIDE_BINS // NOTE_BITS
_WIDE_MAX = (1 << counts.WIDE_BITS) - 1
_NARROW_MAX = (1 << counts.NARROW_BITS) - 1
_COUNT_MAX = (1 << counts.COUNT_BITS) - 1
_RANK_BITS = counts.REGIONS.bit_length()
_ROW_ADDRESS_BITS = (counts.ROWS - 1).bit_length()
_WIDE_LSB = counts.WIDE_CYCLES.bit_length() - 1  # of a wide bin's number in that of a cycle
_LANE_BITS = counts.WIDE_PER_ROW.bit_length() - 1


class MinigroupCounts(Unit):
    """Counts of one minigroup.

    In each cycle at most one row of the memory changes. It is read in stage 2 into the register
    `held`. In stage 3 the hits are added, and the row is written.

    Ports
    -----
    accepted, quarters : in, pixels with a hit, and the quarter of its cycle (stage 2)
    step : in, step of the frame. cycle, first : in, number of the cycle in its period, and whether it
        is 0 (stage 2); next_cycle : in, the number of the next cycle (stage 1); pulse : in, number of the pulse in step 3 (stage 3)
    begin : in, a step begins: all pixels count again
    clear, clear_row : in, this row becomes 0
    shows : in, show what is at `cycle`, without hits; reading, read_row : in, show this row instead
    wide, narrow, row : out, one cycle later: hits of the wide bin at `cycle`; hits of both narrow bins
        of `cycle`, 0 outside of the regions; the row
    note_to, note : in, marks of wide bins, from the search: one bit for each of the `NOTES` words
    set_gates, gates : in, first cycles of the gates, from the search
    stopped : out, pixels that have stopped; stops : out, the pulses with which they did
    gates_kept : out, first cycles of the gates
    test_enable : in, opens clock gate and latches for a test of the chip

    Reset forgets the hits of the cycle; the memory is cleared when a step begins.
    """

    unit_name = "coincid_minigroup_counts"

    def __init__(self, sensor: Sensor):
        pixels = sensor.minigroup_pixels
        self.sensor = sensor
        super().__init__(
            accepted=In(pixels),
            quarters=In(2 * pixels),
            step=In(bus.Step),
            cycle=In(counts.GATE_BITS),
            first=In(1),
            next_cycle=In(counts.GATE_BITS),
            pulse=In(bus.PULSE_BITS),
            begin=In(1),
            clear=In(1),
            clear_row=In(_ROW_ADDRESS_BITS),
            shows=In(1),
            reading=In(1),
            read_row=In(_ROW_ADDRESS_BITS),
            wide=Out(counts.WIDE_BITS),
            narrow=Out(counts.REGION_BITS),
            row=Out(counts.ROW_BITS),
            note_to=In(NOTES),
            note=In(NOTE_BITS),
            set_gates=In(1),
            gates=In(counts.GATES * counts.GATE_BITS),
            stopped=Out(pixels),
            stops=Out(pixels * NOTE_BITS),
            gates_kept=Out(counts.GATES * counts.GATE_BITS),
            test_enable=In(1),
        )
        # Stage 2: the place of the cycle.
        self.place = Signal(_ROW_ADDRESS_BITS)  # number of the row
        self.mark = Signal()  # the cycle is in a region
        self.rank = Signal(_RANK_BITS, reset_less=True)  # of the next region in the period
        self.rank_now = Signal(_RANK_BITS)
        self.upper = Signal()  # the region is in the upper one of its cycle's rows
        self.next_in_gate = Signal(counts.GATES)  # the next cycle is in this gate
        self.in_gate = Signal(counts.GATES)  # the cycle is in this gate
        self.counts_here = Signal()  # the step counts in this cycle
        # Stage 3: the cycle's hits, the row to which they are added, and where in the row.
        self.hits = Signal(pixels)
        self.quarter = Signal(2 * pixels, reset_less=True)
        self.held = Signal(counts.ROW_BITS, reset_less=True)
        self.held_row = Signal(_ROW_ADDRESS_BITS, reset_less=True)
        self.wide_lane = Signal(_LANE_BITS, reset_less=True)
        self.narrow_lane = Signal(_RANK_BITS - 1, reset_less=True)
        self.marked = Signal(reset_less=True)  # `mark` of this cycle
        self.counted = Signal(pixels)  # hits of pixels that have not stopped
        self.adds = Signal()  # there are some
        self.added = Signal(counts.ROW_BITS)  # the row with them
        self.full = Signal(pixels)  # pixels that stop
        # Stage 4.
        self.stopping = Signal(pixels)  # pixels that have stopped in step 3, in the cycle before
        self.pulse_before = Signal(bus.PULSE_BITS, reset_less=True)
        self.rows = Memory(counts.ROWS, counts.ROW_BITS)
        self.notes = [Memory(1, NOTE_BITS) for _ in range(NOTES)]
        self.gate_memory = Memory(1, counts.GATES * counts.GATE_BITS)
        self.clock_gate = ClockGate(small=True)

    def elaborate(self, platform):
        m = Module()
        self._place_notes(m, platform)
        self._find_place(m)
        self._read(m, platform)
        self._add(m)
        awake = [
            ResetSignal(),
            self.accepted.any(),
            self.hits.any(),
            self.stopping.any(),
            self.begin,
            self.clear,
            self.shows,
            self.reading,
            self.note_to.any(),
            self.set_gates,
            (self.step == bus.Step.NARROW) & (self.first | self._leaves_region()),
            (self.step == bus.Step.GATED) & self.next_in_gate.any(),
            self.in_gate.any(),
        ]
        return behind(m, platform, self.clock_gate, Cat(awake).any(), self.test_enable)

    def _place_notes(self, m, platform):
        """Place the memories for the marks, or the pulses with which pixels stopped, and for the
        gates.

        A pixel's pulse is written in the cycle after it has stopped.
        """
        m.d.sync += self.pulse_before.eq(self.pulse)
        for k, memory in enumerate(self.notes):
            place(
                m,
                f"note_{k}",
                memory,
                platform,
                write=self.note_to[k] | self.stopping[k],
                data=Mux(self.note_to[k], self.note, self.pulse_before),
                test_enable=self.test_enable,
            )
        place(
            m,
            "gates_of_minigroup",
            self.gate_memory,
            platform,
            write=self.set_gates,
            data=self.gates,
            test_enable=self.test_enable,
        )
        m.d.comb += [
            self.stops.eq(Cat(memory.value for memory in self.notes)),
            self.gates_kept.eq(self.gate_memory.value),
        ]

    def _leaves_region(self) -> Value:
        """Return whether the cycle is the last one of a region."""
        return self.mark & self.cycle[:_WIDE_LSB].all()

    def _find_place(self, m):
        """Stage 2: find the row of the cycle: from the wide bin, from the region, or from the gate."""
        wide_bin = self.cycle[_WIDE_LSB:]
        in_region = self.cycle[:_WIDE_LSB]
        m.d.comb += [
            self.mark.eq(self.stops.bit_select(wide_bin, 1)),
            self.rank_now.eq(Mux(self.first, 0, self.rank)),
            self.upper.eq(self.rank_now >= counts.REGIONS_PER_ROW),
        ]
        for g, in_gate in enumerate(self.next_in_gate):
            begin = self.gate_memory.value.word_select(g, counts.GATE_BITS)
            since = Signal(counts.GATE_BITS, name=f"since_{g}")
            m.d.comb += [
                since.eq(self.next_cycle - begin),
                in_gate.eq((since < counts.GATE_CYCLES) & (begin != counts.NO_GATE)),
            ]
        is_gated = (self.step == bus.Step.GATED).replicate(counts.GATES)
        m.d.sync += self.in_gate.eq(self.next_in_gate & is_gated)
        with m.If(self.step == bus.Step.NARROW):
            m.d.sync += self.rank.eq(self.rank_now + self._leaves_region())
        with m.Switch(self.step):
            with m.Case(bus.Step.WIDE):
                m.d.comb += [self.place.eq(wide_bin[_LANE_BITS:]), self.counts_here.eq(1)]
            with m.Case(bus.Step.NARROW):
                m.d.comb += [
                    self.place.eq(Cat(self.upper, in_region)),
                    self.counts_here.eq(self.mark),
                ]
            with m.Case(bus.Step.GATED):
                m.d.comb += [
                    self.place.eq(Cat(in_region, self.in_gate[1])),
                    self.counts_here.eq(self.in_gate.any()),
                ]
        with m.If(self.reading):
            m.d.comb += self.place.eq(self.read_row)

    def _read(self, m, platform):
        """Stage 2: read the row, and stage 3: write it. A row that is being written is not read: its
        new value is taken.
        """
        place(
            m,
            "rows",
            self.rows,
            platform,
            write=self.clear | self.adds,
            to=Mux(self.clear, self.clear_row, self.held_row),
            data=Mux(self.clear, 0, self.added),
            row=self.place,
            test_enable=self.test_enable,
        )
        is_written = self.adds & (self.held_row == self.place)
        some = self.accepted.any()
        pixels = self.sensor.minigroup_pixels
        m.d.sync += self.hits.eq(self.accepted & self.counts_here.replicate(pixels))
        with m.If(some | self.shows | self.reading):
            m.d.sync += [
                self.quarter.eq(self.quarters),
                self.held.eq(Mux(is_written, self.added, self.rows.value)),
                self.held_row.eq(self.place),
                self.wide_lane.eq(self.cycle[_WIDE_LSB:]),
                self.narrow_lane.eq(self.rank_now - Mux(self.upper, counts.REGIONS_PER_ROW, 0)),
                self.marked.eq(self.mark),
            ]
        m.d.comb += self.row.eq(self.held)

    def _add(self, m):
        """Stage 3: add the cycle's hits to the row, and stop what has become full."""
        pixels = self.sensor.minigroup_pixels
        m.d.comb += [
            self.counted.eq(self.hits & ~self.stopped),
            self.adds.eq(self.counted.any()),
        ]
        wide, wide_full = self._wide(m)
        narrow, narrow_full = self._narrow(m)
        gated, gated_full = self._gated(m)
        with m.Switch(self.step):
            with m.Case(bus.Step.WIDE):
                m.d.comb += [self.added.eq(wide), self.full.eq(wide_full.replicate(pixels))]
            with m.Case(bus.Step.NARROW):
                m.d.comb += [self.added.eq(narrow), self.full.eq(narrow_full.replicate(pixels))]
            with m.Case(bus.Step.GATED):
                m.d.comb += [self.added.eq(gated), self.full.eq(gated_full)]
        m.d.sync += self.stopping.eq(0)
        with m.If(self.adds):
            m.d.sync += [
                self.stopped.eq(self.stopped | self.full),
                self.stopping.eq(self.full & (self.step == bus.Step.GATED).replicate(pixels)),
            ]
        with m.If(self.begin):
            m.d.sync += self.stopped.eq(0)

    def _wide(self, m) -> tuple[Value, Value]:
        """Return the row with the hits in its wide bin, and whether the bin is full; show the bin."""
        total = Signal(counts.WIDE_BITS + 1, name="wide_total")
        m.d.comb += [
            self.wide.eq(self.held.word_select(self.wide_lane, counts.WIDE_BITS)),
            total.eq(self.wide + popcount(m, self.counted, "wide_hits")),
        ]
        full = total >= _WIDE_MAX
        now = Mux(full, _WIDE_MAX, total)
        row = self._with_lane(self.wide_lane, counts.WIDE_BITS, counts.WIDE_PER_ROW, now)
        return row, full

    def _narrow(self, m) -> tuple[Value, Value]:
        """Return the row with the hits in its narrow bins, and whether one is full; show the bins."""
        bins = Signal(counts.REGION_BITS, name="narrow_bins")
        m.d.comb += [
            bins.eq(self.held.word_select(self.narrow_lane, counts.REGION_BITS)),
            self.narrow.eq(Mux(self.marked, bins, 0)),
        ]
        late = self.quarter[1::2]  # hits in the second half of the cycle
        now = []
        is_full = []
        for half, there in enumerate((self.counted & ~late, self.counted & late)):
            total = Signal(counts.NARROW_BITS + 1, name=f"narrow_total_{half}")
            before = bins.word_select(half, counts.NARROW_BITS)
            m.d.comb += total.eq(before + popcount(m, there, f"narrow_hits_{half}"))
            is_full.append(total >= _NARROW_MAX)
            now.append(Mux(is_full[-1], _NARROW_MAX, total)[: counts.NARROW_BITS])
        lanes = counts.REGIONS_PER_ROW
        row = self._with_lane(self.narrow_lane, counts.REGION_BITS, lanes, Cat(now))
        return row, Cat(is_full).any()

    def _with_lane(self, lane: Value, width: int, lanes: int, value: Value) -> Value:
        """Return the row with another value in one of its lanes."""
        parts = [
            Mux(lane == k, value, self.held.word_select(k, width))[:width] for k in range(lanes)
        ]
        return Cat(*parts, self.held[lanes * width :])

    def _gated(self, m) -> tuple[Value, Value]:
        """Return the row of a gate's cycle with the pixels' hits, and the pixels of which a bin is
        full.
        """
        pixels = len(self.counted)
        parts = []
        full = [Const(0)] * pixels
        for number in range(QUARTERS):
            for j, is_counted in enumerate(self.counted):
                hit = is_counted & (self.quarter.word_select(j, 2) == number)
                before = self.held.word_select(number * pixels + j, counts.COUNT_BITS)
                now = Signal(counts.COUNT_BITS, name=f"count_{number}_{j}")
                m.d.comb += now.eq(before + hit)
                parts.append(now)
                full[j] = full[j] | (hit & (now == _COUNT_MAX))
        return Cat(parts), Cat(full)
