# SPDX-License-Identifier: Apache-2.0
"""Search for regions and gates: the circuit of a subgroup that works between the steps of a frame
of counts.

`docs/contract.md` has the rule. It takes one minigroup after the other, and reads the minigroups'
memories as if a period went by without hits. The paper has no counts; all of this is our own choice.
"""

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib.wiring import In, Out

from ..model.contract import counts
from ..model.contract.parameters import Sensor
from . import bus
from .logic import item_of
from .minigroup_counts import NOTE_BITS, NOTES
from .unit import Unit

# A wide bin's value: twice its own hits, and those of four neighbours.
_VALUE_MAX = 6 * ((1 << counts.WIDE_BITS) - 1)
_VALUE_BITS = _VALUE_MAX.bit_length()
# Rounds of the search for regions: one for each bit of the lowest value of a region, then one that
# counts the higher values, and one that marks the regions.
_COUNT_ROUND = _VALUE_BITS
_MARK_ROUND = _VALUE_BITS + 1
# Cycles of a round of the search for gates: the last bins are compared, and the gate is known.
_GATE_ROUND_CYCLES = counts.CYCLES_MAX + 4
_HEIGHT_BITS = (counts.PEAK_BINS * ((1 << counts.NARROW_BITS) - 1)).bit_length()
_WEIGHTS = (1, 3, 5, 7)  # twice the distance of a bin's middle from the peak's beginning
_MOMENT_BITS = (sum(_WEIGHTS) * ((1 << counts.NARROW_BITS) - 1)).bit_length()
_PEAK_BEGIN_BITS = (counts.NARROW_PER_CYCLE * counts.CYCLES_MAX - 1).bit_length()


class GateSearch(Unit):
    """Search of one subgroup.

    Regions: the ten highest values are those above the tenth, and the first of those that equal it.
    The tenth is found bit by bit, from the highest on: a bit is one if at least ten values reach the
    number with it. Each bit takes a round through the wide bins.

    Gates: a round goes through the cycles of a period and finds the peak. A second one does the same
    without the bins of the first gate.

    Ports
    -----
    start : in, strobe: search for what `step` needs next; frame_begin : in, strobe: end any search,
        and clear the memories; step : in
    last_gate : in, last cycle in which a gate may begin
    wide, narrow : in, of each minigroup, what it shows one cycle after it was given `cycle`
    busy : out; searching : out, `cycle` is needed; cycle : out, number of the cycle to be shown; group : out, minigroup whose marks or
        gates are written
    note_to, note, set_gates, gates : out, to this minigroup, as in `MinigroupCounts`
    clear, clear_row : out, this row of all minigroups becomes 0; done : out, strobe: the next step
        may begin

    Latency: at most `pause_cycles` of `model/contract/counts.py`, less the time that hits take to the
    memory. Reset ends a search.
    """

    unit_name = "coincid_gate_search"

    def __init__(self, sensor: Sensor):
        n = sensor.minigroups
        self.sensor = sensor
        super().__init__(
            start=In(1),
            frame_begin=In(1),
            step=In(bus.Step),
            last_gate=In(counts.GATE_BITS),
            wide=In(n * counts.WIDE_BITS),
            narrow=In(n * counts.REGION_BITS),
            busy=Out(1),
            cycle=Out(counts.GATE_BITS),
            group=Out(range(n)),
            note_to=Out(NOTES),
            note=Out(NOTE_BITS),
            set_gates=Out(1),
            gates=Out(counts.GATES * counts.GATE_BITS),
            searching=Out(1),
            clear=Out(1),
            clear_row=Out(range(counts.ROWS)),
            done=Out(1),
        )
        # What is read.
        self.for_regions = Signal()  # a search for regions is going on
        self.for_gates = Signal()  # a search for gates is going on
        self.searched = Signal()  # the search went on in the cycle before
        self.clears_after = Signal()  # the memories are cleared after a search
        self.number = Signal(range(_GATE_ROUND_CYCLES))  # of the cycle that is read
        self.round = Signal(range(_MARK_ROUND + 1))
        self.reads = Signal(range(n))  # the minigroup
        self.round_ends = Signal()
        self.last_round = Signal()
        # What is shown, one cycle later.
        self.shown = Signal()
        self.shown_last = Signal()  # it is the last one of its round
        self.shown_round = Signal.like(self.round)
        self.shown_group = Signal.like(self.reads)
        self.shown_word = Signal(range(counts.WIDE_BINS))  # number of the wide bin
        self.left_out = Signal()  # the narrow bins are left out
        # Regions: a value, again one cycle later.
        self.valued = Signal()
        self.value = Signal(_VALUE_BITS)
        self.value_last = Signal()  # it is the last one of its round
        self.value_round = Signal.like(self.round)
        self.value_group = Signal.like(self.reads)
        self.value_word = Signal(range(counts.WIDE_BINS))  # number of its wide bin
        self.tenth = Signal(_VALUE_BITS)  # bits of the tenth value that are known
        self.limit = Signal(_VALUE_BITS)  # values from here on are counted
        self.found = Signal(range(counts.WIDE_BINS + 1))  # number of them in the round
        self.equal_left = Signal(range(counts.REGIONS + 1))  # values like the tenth to be marked
        # Gates: the cycle's bins and those before them, then peaks, then the highest peak.
        self.bins = [Signal(counts.NARROW_BITS, name=f"bin_{k}") for k in range(5)]
        self.peak_cycle = Signal(range(_GATE_ROUND_CYCLES))  # cycle of the peaks' last bins
        self.heights = [Signal(_HEIGHT_BITS, name=f"height_{k}") for k in range(2)]
        self.moments = [Signal(_MOMENT_BITS, name=f"moment_{k}") for k in range(2)]
        self.height = Signal(_HEIGHT_BITS)
        self.moment = Signal(_MOMENT_BITS)
        self.peak_begin = Signal(_PEAK_BEGIN_BITS)  # number of its first bin
        self.first_gate = Signal(counts.GATE_BITS)

    def elaborate(self, platform):
        m = Module()
        self._sequence(m)
        self._read_value(m)
        self._find_regions(m)
        self._read_bins(m)
        self._find_peak(m)
        self._set_gates(m)
        self._clear(m)
        return m

    def _sequence(self, m):
        """Go through the cycles of a round, the rounds of a minigroup, and the minigroups."""
        last_group = self.sensor.minigroups - 1
        last_cycle = counts.CYCLES_MAX - counts.WIDE_CYCLES
        m.d.comb += [
            self.searching.eq(self.for_regions | self.for_gates | self.shown | self.valued),
            self.busy.eq(self.searching | self.searched | self.clear | self.done),
            self.cycle.eq(self.number),
            self.round_ends.eq(
                Mux(
                    self.for_regions,
                    self.number == last_cycle,
                    self.number == _GATE_ROUND_CYCLES - 1,
                )
            ),
            self.last_round.eq(
                Mux(self.for_regions, self.round == _MARK_ROUND, self.round == counts.GATES - 1)
            ),
        ]
        with m.If(self.for_regions | self.for_gates):
            step = Mux(self.for_regions, counts.WIDE_CYCLES, 1)
            m.d.sync += self.number.eq(Mux(self.round_ends, 0, self.number + step))
            with m.If(self.round_ends):
                m.d.sync += self.round.eq(Mux(self.last_round, 0, self.round + 1))
            with m.If(self.round_ends & self.last_round):
                m.d.sync += self.reads.eq(Mux(self.reads == last_group, 0, self.reads + 1))
                with m.If(self.reads == last_group):
                    m.d.sync += [self.for_regions.eq(0), self.for_gates.eq(0)]
        with m.If(self.start):
            m.d.sync += [
                self.for_regions.eq(self.step == bus.Step.WIDE),
                self.for_gates.eq(self.step == bus.Step.NARROW),
            ]
        with m.If(self.start | self.frame_begin):
            m.d.sync += [self.number.eq(0), self.round.eq(0), self.reads.eq(0)]
        with m.If(self.frame_begin):
            m.d.sync += [self.for_regions.eq(0), self.for_gates.eq(0)]
        m.d.sync += [
            self.shown.eq(self.for_regions & ~self.frame_begin),
            self.shown_last.eq(self.round_ends),
            self.shown_round.eq(self.round),
            self.shown_group.eq(self.reads),
            self.shown_word.eq(self.number >> counts.WIDE_CYCLES.bit_length() - 1),
        ]

    def _read_value(self, m):
        """Regions: read a wide bin's value."""
        rows, cols = (
            whole // part
            for whole, part in zip(self.sensor.subgroup, self.sensor.minigroup, strict=True)
        )
        own = [self.wide.word_select(g, counts.WIDE_BITS) for g in range(rows * cols)]
        nothing = Const(0, counts.WIDE_BITS)
        beside = {
            "above": [own[g - cols] if g >= cols else nothing for g in range(len(own))],
            "below": [own[g + cols] if g + cols < len(own) else nothing for g in range(len(own))],
            "left": [own[g - 1] if g % cols else nothing for g in range(len(own))],
            "right": [own[g + 1] if (g + 1) % cols else nothing for g in range(len(own))],
        }
        hits = item_of(m, self.shown_group, own, "own_hits")
        of_neighbours = [
            item_of(m, self.shown_group, items, f"hits_{side}") for side, items in beside.items()
        ]
        m.d.sync += [
            self.valued.eq(self.shown),
            self.value.eq((hits << 1) + sum(of_neighbours[1:], of_neighbours[0])),
            self.value_last.eq(self.shown_last),
            self.value_round.eq(self.shown_round),
            self.value_group.eq(self.shown_group),
            self.value_word.eq(self.shown_word),
        ]

    def _find_regions(self, m):
        """Regions: find the bits of the tenth value, count the values above it, and mark."""
        reaches = Signal()  # the value reaches the limit
        found_now = Signal.like(self.found)
        marks = Signal()
        marking = Signal()
        above = Signal(_VALUE_BITS)
        m.d.comb += [
            above.eq(self.tenth + 1),
            self.limit.eq(self.tenth | (Const(1 << _VALUE_BITS - 1) >> self.value_round)),
            marking.eq(self.valued & (self.value_round == _MARK_ROUND)),
            reaches.eq(self.value >= Mux(self.value_round >= _COUNT_ROUND, above, self.limit)),
            found_now.eq(self.found + reaches),
            marks.eq(reaches | ((self.value == self.tenth) & (self.equal_left != 0))),
        ]
        with m.If(self.valued):
            m.d.sync += self.found.eq(Mux(self.value_last, 0, found_now))
            with m.If(self.value_last & (self.value_round == _COUNT_ROUND)):
                m.d.sync += self.equal_left.eq(counts.REGIONS - found_now)
            with m.Elif(self.value_last & (self.value_round == _MARK_ROUND)):
                m.d.sync += self.tenth.eq(0)
            with m.Elif(self.value_last & (found_now >= counts.REGIONS)):
                m.d.sync += self.tenth.eq(self.limit)
        with m.If(marking):
            m.d.sync += self.note.eq(Cat(self.note[1:], marks))
            with m.If(marks & ~reaches):
                m.d.sync += self.equal_left.eq(self.equal_left - 1)
        m.d.sync += self.note_to.eq(0)
        with m.If(marking & self.value_word[: (NOTE_BITS - 1).bit_length()].all()):
            word = self.value_word[(NOTE_BITS - 1).bit_length() :]
            m.d.sync += [self.note_to.eq(1 << word), self.group.eq(self.value_group)]
        with m.If(self.start | self.frame_begin):
            m.d.sync += [self.found.eq(0), self.tenth.eq(0), self.valued.eq(0)]

    def _read_bins(self, m):
        """Gates: read the narrow bins of a cycle, without those of the first gate in the second
        round.
        """
        narrow = self.narrow
        n = self.sensor.minigroups
        items = [narrow.word_select(g, counts.REGION_BITS) for g in range(n)]
        read = item_of(m, self.shown_group, items, "narrow_read")
        since_gate = Signal(counts.GATE_BITS)
        in_gate = Signal()
        m.d.comb += [
            since_gate.eq(self.number - self.first_gate),
            in_gate.eq(
                (self.first_gate != counts.NO_GATE)
                & (since_gate < counts.GATE_CYCLES)
                & (self.round != 0)
            ),
        ]
        m.d.sync += self.left_out.eq(in_gate | ~self.for_gates | (self.number >= counts.CYCLES_MAX))
        *before, low, high = self.bins
        bins = Mux(self.left_out, 0, read)
        m.d.sync += [
            low.eq(bins[: counts.NARROW_BITS]),
            high.eq(bins[counts.NARROW_BITS :]),
            *(old.eq(new) for old, new in zip(before, self.bins[2:], strict=True)),
            self.peak_cycle.eq(self.number - 2),
        ]

    def _find_peak(self, m):
        """Gates: compare the two peaks that end in a cycle with the highest one of the round.

        A peak that reaches beyond the period is never higher than the last one in it.
        """
        for k, (height, moment) in enumerate(zip(self.heights, self.moments, strict=True)):
            of_peak = self.bins[k : k + counts.PEAK_BINS]
            weighted = [bins * weight for bins, weight in zip(of_peak, _WEIGHTS, strict=True)]
            m.d.sync += [
                height.eq(sum(of_peak[1:], of_peak[0])),
                moment.eq(sum(weighted[1:], weighted[0])),
            ]
        first_is = Signal()
        second_is = Signal()
        m.d.comb += [
            first_is.eq((self.peak_cycle >= 2) & (self.heights[0] > self.height)),
            second_is.eq(
                (self.peak_cycle >= 1)
                & (self.heights[1] > self.height)
                & (~first_is | (self.heights[1] > self.heights[0]))
            ),
        ]
        last_bin = Signal(_PEAK_BEGIN_BITS)
        m.d.comb += last_bin.eq(Cat(Const(1, 1), self.peak_cycle))
        with m.If(second_is):
            m.d.sync += [
                self.height.eq(self.heights[1]),
                self.moment.eq(self.moments[1]),
                self.peak_begin.eq(last_bin - (counts.PEAK_BINS - 1)),
            ]
        with m.Elif(first_is):
            m.d.sync += [
                self.height.eq(self.heights[0]),
                self.moment.eq(self.moments[0]),
                self.peak_begin.eq(last_bin - counts.PEAK_BINS),
            ]
        with m.If(self.number == 0):
            m.d.sync += [self.height.eq(0)]

    def _set_gates(self, m):
        """Gates: keep the first gate, and write both."""
        centred = self._centred_gate(m)
        second = self._beside_first(m, centred)
        m.d.sync += self.set_gates.eq(0)
        with m.If(self.for_gates & self.round_ends):
            with m.If(self.round == 0):
                m.d.sync += self.first_gate.eq(centred)
            with m.Else():
                m.d.sync += [
                    self.gates.eq(Cat(self.first_gate, second)),
                    self.set_gates.eq(1),
                    self.group.eq(self.reads),
                ]

    def _centred_gate(self, m) -> Value:
        """Return the first cycle of the gate around the highest peak."""
        middle_later = Signal(2)  # the gate begins so many cycles later than the earliest one
        begin = Signal(counts.GATE_BITS + 2)  # two more than the first cycle
        gate = Signal(counts.GATE_BITS)
        odd = self.peak_begin[0]

        def beyond(heights: int) -> Value:
            return self.moment >= heights * self.height

        m.d.comb += [
            middle_later.eq(Mux(odd, 1 + beyond(4), beyond(2) + beyond(6))),
            begin.eq((self.peak_begin >> 1) + middle_later),
        ]
        with m.If(self.height == 0):
            m.d.comb += gate.eq(counts.NO_GATE)
        with m.Elif(begin < 2):
            m.d.comb += gate.eq(0)
        with m.Elif(begin - 2 > self.last_gate):
            m.d.comb += gate.eq(self.last_gate)
        with m.Else():
            m.d.comb += gate.eq(begin - 2)
        return gate

    def _beside_first(self, m, gate: Value) -> Value:
        """Return the second gate: moved if it overlaps the first one, or none."""
        first = self.first_gate
        second = Signal(counts.GATE_BITS, name="second_gate")
        later = Signal(counts.GATE_BITS + 1)  # behind the first gate
        m.d.comb += [second.eq(gate), later.eq(first + counts.GATE_CYCLES)]
        with m.If(gate != counts.NO_GATE):
            with m.If((gate >= first) & (gate < later)):
                m.d.comb += second.eq(Mux(later > self.last_gate, counts.NO_GATE, later))
            with m.Elif((gate < first) & (gate + counts.GATE_CYCLES > first)):
                earlier = first - counts.GATE_CYCLES
                m.d.comb += second.eq(Mux(earlier < 0, counts.NO_GATE, earlier))
        return second

    def _clear(self, m):
        """After a search, and when a frame begins, clear the memories."""
        ended = self.searched & ~self.searching
        m.d.sync += [self.searched.eq(self.searching & ~self.frame_begin), self.done.eq(0)]
        with m.If(self.clear):
            m.d.sync += self.clear_row.eq(self.clear_row + 1)
            with m.If(self.clear_row == counts.ROWS - 1):
                m.d.sync += [self.clear.eq(0), self.done.eq(self.clears_after)]
        with m.If(ended | self.frame_begin):
            m.d.sync += [
                self.clear.eq(1),
                self.clear_row.eq(0),
                self.clears_after.eq(~self.frame_begin),
            ]
        with m.If(self.frame_begin):
            m.d.sync += self.done.eq(0)
