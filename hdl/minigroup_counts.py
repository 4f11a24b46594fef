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

    In each cycle at most one row of the memory changes. It is read and added to in stage 3, kept in
    the register `held`, and written in the next cycle.

    Ports
    -----
    accepted, quarters : in, pixels with a hit, and the quarter of its cycle (stage 2)
    step : in, step of the frame. cycle, first : in, number of the cycle in its period, and whether it
        is 0; counting : in, hits of this cycle count; pulse : in, number of the pulse in step 3 (all
        stage 3)
    begin : in, a step begins: all pixels count again
    clear, clear_row : in, this row becomes 0
    note_to, note : in, marks of wide bins, from the search: one bit for each of the `NOTES` words
    set_gates, gates : in, first cycles of the gates, from the search
    reading, read_row : in, show this row
    wide : out, hits of the wide bin at `cycle`; narrow : out, hits of both narrow bins of `cycle`, 0
        outside of the regions; row : out, row of the memory (all in the same cycle)
    stopped : out, pixels that have stopped; stops : out, the pulses with which they did
    gates_kept : out, first cycles of the gates
    test_enable : in, opens clock gate and latches for a test of the chip

    Reset empties `held`; the memory is cleared when a step begins.
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
            counting=In(1),
            pulse=In(bus.PULSE_BITS),
            begin=In(1),
            clear=In(1),
            clear_row=In(_ROW_ADDRESS_BITS),
            note_to=In(NOTES),
            note=In(NOTE_BITS),
            set_gates=In(1),
            gates=In(counts.GATES * counts.GATE_BITS),
            reading=In(1),
            read_row=In(_ROW_ADDRESS_BITS),
            wide=Out(counts.WIDE_BITS),
            narrow=Out(counts.REGION_BITS),
            row=Out(counts.ROW_BITS),
            stopped=Out(pixels),
            stops=Out(pixels * NOTE_BITS),
            gates_kept=Out(counts.GATES * counts.GATE_BITS),
            test_enable=In(1),
        )
        # The cycle's hits (stage 3).
        self.hits = Signal(pixels)
        self.quarter = Signal(2 * pixels, reset_less=True)
        # The row that was added to in the cycle before.
        self.holds = Signal()
        self.held = Signal(counts.ROW_BITS, reset_less=True)
        self.held_row = Signal(_ROW_ADDRESS_BITS, reset_less=True)
        self.adds = Signal()  # this cycle's hits add to a row
        self.place = Signal(_ROW_ADDRESS_BITS)  # its number, or that of the row to be shown
        self.stopping = Signal(pixels)  # pixels that have stopped in the cycle before
        self.rank = Signal(_RANK_BITS, reset_less=True)  # of the next region in the period
        self.rank_now = Signal(_RANK_BITS)
        self.mark = Signal()  # the cycle is in a region
        self.in_gate = Signal(counts.GATES)  # the cycle is in this gate
        self.rows = Memory(counts.ROWS, counts.ROW_BITS)
        self.notes = [Memory(1, NOTE_BITS) for _ in range(NOTES)]
        self.gate_memory = Memory(1, counts.GATES * counts.GATE_BITS)
        self.clock_gate = ClockGate(small=True)

    def elaborate(self, platform):
        m = Module()
        self._take_hits(m)
        self._place_notes(m, platform)
        self._find_place(m)
        self._place_rows(m, platform)
        self._add(m)
        awake = [
            ResetSignal(),
            self.accepted.any(),
            self.hits.any(),
            self.holds,
            self.stopping.any(),
            self.begin,
            self.clear,
            self.note_to.any(),
            self.set_gates,
            (self.step == bus.Step.NARROW) & (self.first | self._leaves_region()),
        ]
        return behind(m, platform, self.clock_gate, Cat(awake).any(), self.test_enable)

    def _take_hits(self, m):
        """Stage 3: the hits, in registers."""
        m.d.sync += self.hits.eq(self.accepted)
        with m.If(self.accepted.any()):
            m.d.sync += self.quarter.eq(self.quarters)

    def _place_notes(self, m, platform):
        """Place the memories for the marks, or the pulses with which pixels stopped, and for the
        gates.

        A pixel's pulse is written in the cycle after it has stopped.
        """
        pulse_before = Signal.like(self.pulse, reset_less=True)
        m.d.sync += pulse_before.eq(self.pulse)
        for k, memory in enumerate(self.notes):
            place(
                m,
                f"note_{k}",
                memory,
                platform,
                write=self.note_to[k] | self.stopping[k],
                data=Mux(self.note_to[k], self.note, pulse_before),
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
        """Find the row of the cycle: from the wide bin, from the region, or from the gate."""
        wide_bin = self.cycle[_WIDE_LSB:]
        in_region = self.cycle[:_WIDE_LSB]
        upper = Signal()  # the region is in the upper one of its cycle's rows
        m.d.comb += [
            self.mark.eq(self.stops.bit_select(wide_bin, 1)),
            self.rank_now.eq(Mux(self.first, 0, self.rank)),
            upper.eq(self.rank_now >= counts.REGIONS_PER_ROW),
        ]
        for g, in_gate in enumerate(self.in_gate):
            begin = self.gate_memory.value.word_select(g, counts.GATE_BITS)
            since = Signal(counts.GATE_BITS, name=f"since_{g}")
            m.d.comb += [
                since.eq(self.cycle - begin),
                in_gate.eq((since < counts.GATE_CYCLES) & (begin != counts.NO_GATE)),
            ]
        with m.If(self.step == bus.Step.NARROW):
            m.d.sync += self.rank.eq(self.rank_now + self._leaves_region())
        with m.If(self.reading):
            m.d.comb += self.place.eq(self.read_row)
        with m.Elif(self.step == bus.Step.WIDE):
            m.d.comb += self.place.eq(wide_bin[_LANE_BITS:])
        with m.Elif(self.step == bus.Step.NARROW):
            m.d.comb += self.place.eq(Cat(upper, in_region))
        with m.Else():
            m.d.comb += self.place.eq(Cat(in_region, self.in_gate[1]))

    def _place_rows(self, m, platform):
        """Place the memory of rows, and show the row of the cycle.

        The row that is being written is not read: `held` has it.
        """
        place(
            m,
            "rows",
            self.rows,
            platform,
            write=self.clear | self.holds,
            to=Mux(self.clear, self.clear_row, self.held_row),
            data=Mux(self.clear, 0, self.held),
            row=self.place,
            test_enable=self.test_enable,
        )
        is_held = self.holds & (self.held_row == self.place)
        m.d.comb += self.row.eq(Mux(is_held, self.held, self.rows.value))

    def _add(self, m):
        """Add the cycle's hits to the row, and stop what has become full."""
        pixels = self.sensor.minigroup_pixels
        counted = Signal(pixels)  # hits that count
        m.d.comb += counted.eq(self.hits & ~self.stopped & self.counting.replicate(pixels))
        added = Signal(counts.ROW_BITS)
        full = Signal(pixels)  # one for each pixel that stops; in steps 1 and 2 all stop together
        wide, wide_full = self._wide(m, counted)
        narrow, narrow_full = self._narrow(m, counted)
        gated, gated_full = self._gated(m, counted)
        with m.If(self.step == bus.Step.WIDE):
            m.d.comb += [
                self.adds.eq(counted.any()),
                added.eq(wide),
                full.eq(wide_full.replicate(pixels)),
            ]
        with m.Elif(self.step == bus.Step.NARROW):
            m.d.comb += [
                self.adds.eq(counted.any() & self.mark),
                added.eq(narrow),
                full.eq(narrow_full.replicate(pixels)),
            ]
        with m.Elif(self.step == bus.Step.GATED):
            m.d.comb += [
                self.adds.eq(counted.any() & self.in_gate.any()),
                added.eq(gated),
                full.eq(gated_full),
            ]
        m.d.sync += [
            self.holds.eq(self.adds),
            self.stopping.eq(0),
        ]
        with m.If(self.adds):
            m.d.sync += [
                self.held.eq(added),
                self.held_row.eq(self.place),
                self.stopped.eq(self.stopped | full),
                self.stopping.eq(full & (self.step == bus.Step.GATED).replicate(pixels)),
            ]
        with m.If(self.begin):
            m.d.sync += self.stopped.eq(0)

    def _wide(self, m, counted) -> tuple[Value, Value]:
        """Return the row with the hits in its wide bin, and whether the bin is full; show the bin."""
        lane = self.cycle[_WIDE_LSB : _WIDE_LSB + _LANE_BITS]
        total = Signal(counts.WIDE_BITS + 1)
        m.d.comb += [
            self.wide.eq(self.row.word_select(lane, counts.WIDE_BITS)),
            total.eq(self.wide + popcount(m, counted, "wide_hits")),
        ]
        full = total >= _WIDE_MAX
        bin_now = Mux(full, _WIDE_MAX, total)
        return self._with_lane(lane, counts.WIDE_BITS, counts.WIDE_PER_ROW, bin_now), full

    def _narrow(self, m, counted) -> tuple[Value, Value]:
        """Return the row with the hits in its narrow bins, and whether one is full; show the bins."""
        upper = self.rank_now >= counts.REGIONS_PER_ROW
        lane = Signal(_RANK_BITS)
        bins = Signal(counts.REGION_BITS)
        m.d.comb += [
            lane.eq(self.rank_now - Mux(upper, counts.REGIONS_PER_ROW, 0)),
            bins.eq(self.row.word_select(lane, counts.REGION_BITS)),
            self.narrow.eq(Mux(self.mark, bins, 0)),
        ]
        late = self.quarter[1::2]  # hits in the second half of the cycle
        now = []
        is_full = []
        for half, there in enumerate((counted & ~late, counted & late)):
            total = Signal(counts.NARROW_BITS + 1, name=f"narrow_{half}")
            before = bins.word_select(half, counts.NARROW_BITS)
            m.d.comb += total.eq(before + popcount(m, there, f"narrow_hits_{half}"))
            is_full.append(total >= _NARROW_MAX)
            now.append(Mux(is_full[-1], _NARROW_MAX, total)[: counts.NARROW_BITS])
        row = self._with_lane(lane, counts.REGION_BITS, counts.REGIONS_PER_ROW, Cat(now))
        return row, Cat(is_full).any()

    def _with_lane(self, lane: Value, width: int, lanes: int, value: Value) -> Value:
        """Return the row with another value in one of its lanes."""
        parts = [
            Mux(lane == k, value, self.row.word_select(k, width))[:width] for k in range(lanes)
        ]
        return Cat(*parts, self.row[lanes * width :])

    def _gated(self, m, counted) -> tuple[Value, Value]:
        """Return the row of a gate's cycle with the pixels' hits, and the pixels of which a bin is
        full.
        """
        parts = []
        full = [Const(0)] * len(counted)
        for number in range(QUARTERS):
            for j, is_counted in enumerate(counted):
                hit = is_counted & (self.quarter.word_select(j, 2) == number)
                before = self.row.word_select(number * len(counted) + j, counts.COUNT_BITS)
                now = Signal(counts.COUNT_BITS, name=f"count_{number}_{j}")
                m.d.comb += now.eq(before + hit)
                parts.append(now)
                full[j] = full[j] | (hit & (now == _COUNT_MAX))
        return Cat(parts), Cat(full)
