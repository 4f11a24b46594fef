# SPDX-License-Identifier: Apache-2.0
"""Proofs of the search for regions and gates, and of its place among the periods.

The order and the time of a search are those of counters that go through its minigroups, rounds and
bins, so no proof plays a whole search. What it finds is proven for one wide bin, or one peak, that
may be any, against a specification that sees every bin once in a round.
"""

from collections.abc import Callable

from amaranth.hdl import Cat, Const, Mux, Signal, Value
from attrs import evolve, frozen

from ..hdl import bus
from ..hdl.counts import Counts
from ..hdl.gate_search import GateSearch
from ..hdl.minigroup_counts import NOTE_BITS
from ..model.contract import counts
from .counts import gates_are_legal
from .proof_bench import Bench, proof
from .sensors import SMALL_COUNTS

N = SMALL_COUNTS.minigroups
# In a subgroup of 3 x 3 minigroups, one has a neighbour on each side: its value can be the highest.
WITH_ALL_NEIGHBOURS = evolve(SMALL_COUNTS, rows=6, cols=12, subgroup=(6, 6))
VALUE_MAX = 6 * ((1 << counts.WIDE_BITS) - 1)
VALUE_BITS = VALUE_MAX.bit_length()
COUNT_ROUND = VALUE_BITS  # behind one round for each bit
MARK_ROUND = VALUE_BITS + 1
REGION_ROUNDS = VALUE_BITS + 2
GATE_ROUND = counts.CYCLES_MAX + 4  # cycles
REGION_CYCLES = N * REGION_ROUNDS * counts.WIDE_BINS
GATE_CYCLES = N * counts.GATES * GATE_ROUND
TO_VALUE = 2  # cycles from a bin's number to its value
PAUSES = counts.pause_cycles(N)


@frozen
class Search:
    """Where a search is.

    active: from its start until it is done; since: cycles since then; regions: what it is for;
    reads: it reads bins; group, round, position: which; begun: cycles since a frame has begun, or 0
    after the memory has been cleared.
    """

    active: Signal
    since: Signal
    regions: Signal
    reads: Signal
    group: Signal
    round: Signal
    position: Signal
    begun: Signal

    @property
    def in_regions(self) -> Value:
        """Return whether it reads wide bins."""
        return self.reads & self.regions

    @property
    def in_gates(self) -> Value:
        """Return whether it reads narrow bins."""
        return self.reads & ~self.regions


@proof(depth=3, cover=14)
def gate_search(b: Bench):
    """A search reads the bins of each minigroup in order, as often as it has to, and is done within
    the contract's pause; it writes each minigroup's four words of marks, or its gates, once, and
    clears the memory.
    """
    unit = b.place(GateSearch(SMALL_COUNTS))
    search = _search(b, unit)
    _search_is_done_in_time(b, unit, search)
    _memory_is_cleared(b, unit, search)
    _words_are_written(b, unit, search)
    _value_is_in_registers(b, unit, search)
    b.cover(unit.clear & (unit.clear_row == counts.ROWS - 1))


def _search(b: Bench, unit: GateSearch, state: Callable[..., None] | None = None) -> Search:
    """Specify a search: it goes through groups, rounds and bins. It starts when no other goes on,
    and the beginning of a frame ends it. state: the bench's function for when it starts.
    """
    m = b.m
    state = state or b.assume
    active = Signal()
    since = Signal(range(max(PAUSES) + 1))
    regions = Signal()
    reads = Signal()
    groups = unit.sensor.minigroups
    group = Signal(range(groups))
    number = Signal(range(REGION_ROUNDS))
    position = Signal(range(GATE_ROUND))
    begun = Signal(range(counts.ROWS + 1))

    starts_one = (unit.step == bus.Step.WIDE) | (unit.step == bus.Step.NARROW)
    state(~unit.busy & ~unit.frame_begin & starts_one, where=unit.start)

    last_position = Mux(regions, counts.WIDE_BINS, GATE_ROUND) - 1
    last_round = Mux(regions, REGION_ROUNDS, counts.GATES) - 1
    round_ends = b.same("spec_round_ends", position == last_position)
    group_ends = b.same("spec_group_ends", round_ends & (number == last_round))
    m.d.sync += since.eq(Mux(since == max(PAUSES), since, since + 1))
    m.d.sync += begun.eq(Mux((begun == 0) | (begun == counts.ROWS), 0, begun + 1))
    with m.If(reads):
        m.d.sync += position.eq(Mux(round_ends, 0, position + 1))
        with m.If(round_ends):
            m.d.sync += number.eq(Mux(group_ends, 0, number + 1))
        with m.If(group_ends):
            m.d.sync += group.eq(group + 1)
            m.d.sync += reads.eq(group != groups - 1)
    with m.If(unit.done):
        m.d.sync += active.eq(0)
    with m.If(unit.start):
        m.d.sync += [active.eq(1), reads.eq(1), since.eq(1), regions.eq(unit.step == bus.Step.WIDE)]
        m.d.sync += [group.eq(0), number.eq(0), position.eq(0)]
    with m.If(unit.frame_begin):
        m.d.sync += [active.eq(0), reads.eq(0), begun.eq(1)]
    search = Search(active, since, regions, reads, group, number, position, begun)

    b.always(unit.for_regions == search.in_regions)
    b.always(unit.for_gates == search.in_gates)
    same_place = (unit.reads == group) & (unit.round == number)
    number_read = Mux(regions, position * counts.WIDE_CYCLES, position)
    b.always(same_place & (unit.number == number_read), where=reads)
    b.always(unit.cycle == number_read[: counts.GATE_BITS], where=reads)
    goes_on = ~unit.start & ~unit.frame_begin
    b.always(unit.shown == b.past(search.in_regions & ~unit.frame_begin))
    b.always(unit.valued == b.past(unit.shown & goes_on))
    b.always(~unit.shown & ~unit.valued, where=search.in_gates)
    b.always(round_ends | (position < last_position), where=reads)
    b.always((number <= last_round) & (group < groups), where=reads)
    b.always(unit.clear & ~unit.searching & ~unit.searched, where=begun != 0)
    b.always(unit.clear_row == begun - 1, where=begun != 0)
    return search


def _search_is_done_in_time(b: Bench, unit: GateSearch, search: Search) -> None:
    """State that a search is over before its pause is, and that it is done once.

    Help the induction: the time since the start follows from the place.
    """
    since = search.since
    regions = search.regions
    pause = Mux(regions, *PAUSES)
    done = Signal()
    with b.m.If(unit.start | unit.frame_begin):
        b.m.d.sync += done.eq(0)
    with b.m.Elif(unit.done):
        b.m.d.sync += done.eq(1)
    b.always(~unit.busy & done, where=b.past(search.active) & (since >= pause))
    b.always(since < pause, where=search.active)
    b.always(search.active & ~done, where=unit.done)
    b.always(unit.busy, where=search.active | (search.begun != 0))
    b.always(~search.active, where=done | (search.begun != 0))

    region_round = search.group * REGION_ROUNDS + search.round
    gate_round = search.group * counts.GATES + search.round
    before = Mux(regions, region_round * counts.WIDE_BINS, gate_round * GATE_ROUND)
    b.always(search.active & (since == before + search.position + 1), where=search.reads)
    read = b.same("read", Mux(regions, REGION_CYCLES + TO_VALUE, GATE_CYCLES))
    b.always(since > Mux(regions, REGION_CYCLES, GATE_CYCLES), where=search.active & ~search.reads)
    b.always(since <= read + counts.ROWS + 2, where=search.active)
    b.always(unit.done == (search.active & (since == read + counts.ROWS + 2)))
    searched = search.active & (since > 1) & (since <= read + 1)
    b.always(unit.searched == searched, where=search.begun == 0)
    clears = search.active & (since > read + 1) & (since <= read + 1 + counts.ROWS)
    b.always(unit.clear == (clears | (search.begun != 0)))
    b.always(unit.clear_row == since - read - 2, where=clears)
    b.always(unit.clears_after == clears, where=unit.clear)


def _memory_is_cleared(b: Bench, unit: GateSearch, search: Search) -> None:
    """State that each row is cleared once, after a search and when a frame begins, and not while a
    search reads.
    """
    m = b.m
    cleared = Signal(range(counts.ROWS + 1), init=counts.ROWS)
    with m.If(unit.frame_begin | unit.start):
        m.d.sync += cleared.eq(0)
    with m.Elif(unit.clear):
        m.d.sync += cleared.eq(cleared + 1)
    b.always((unit.clear_row == cleared) & ~search.reads, where=unit.clear)
    b.always(cleared < counts.ROWS, where=unit.clear)
    b.always(cleared == counts.ROWS, where=unit.done | ~unit.busy)
    # Help the induction.
    b.always(cleared == search.begun - 1, where=search.begun != 0)
    b.always((cleared == 0) | unit.clear | unit.done, where=search.active)


def _words_are_written(b: Bench, unit: GateSearch, search: Search) -> None:
    """State when marks and gates are written, and to which minigroup."""
    marks = search.in_regions & (search.round == MARK_ROUND)
    ends_word = b.same("ends_word", marks & (search.position % NOTE_BITS == NOTE_BITS - 1))
    word: Value = Mux(ends_word, 1 << (search.position // NOTE_BITS), 0)
    for _ in range(TO_VALUE):
        word = b.past(Mux(unit.frame_begin, 0, word))
    word = b.past(word)
    b.always(unit.note_to == word)
    b.always(unit.group == b.past(search.group, TO_VALUE + 1), where=word.any())
    last_round = search.in_gates & (search.round == counts.GATES - 1)
    ends_gates = b.same("ends_gates", last_round & (search.position == GATE_ROUND - 1))
    b.always(unit.set_gates == b.past(ends_gates))
    b.always(unit.group == b.past(search.group), where=unit.set_gates)


def _value_is_in_registers(b: Bench, unit: GateSearch, search: Search) -> None:
    """Help the induction: registers hold where a value is from."""
    valued = unit.valued
    for cycles, here, of_stage in (
        (1, unit.shown, (unit.shown_group, unit.shown_round, unit.shown_word, unit.shown_last)),
        (2, valued, (unit.value_group, unit.value_round, unit.value_word, unit.value_last)),
    ):
        group, number, word, last = of_stage
        position = b.past(search.position, cycles)
        b.always(group == b.past(search.group, cycles), where=here)
        b.always(number == b.past(search.round, cycles), where=here)
        b.always(word == position, where=here)
        b.always(last == (position == counts.WIDE_BINS - 1), where=here)
    b.always(unit.value <= VALUE_MAX)


@proof(depth=2, cover=4)
def gate_search_values(b: Bench):
    """A value is twice the hits of a minigroup, and those of the minigroups beside it."""
    sensor = WITH_ALL_NEIGHBOURS
    unit = b.place(GateSearch(sensor))
    cols = sensor.subgroup[1] // sensor.minigroup[1]
    hits = [unit.wide.word_select(g, counts.WIDE_BITS) for g in range(sensor.minigroups)]
    value: Value = Const(0)
    for g, own in enumerate(hits):
        beside = [
            other
            for k, other in enumerate(hits)
            if abs(g // cols - k // cols) + abs(g % cols - k % cols) == 1
        ]
        value = Mux(unit.shown_group == g, 2 * own + sum(beside, start=Const(0)), value)
    b.always(unit.value == b.past(value), where=b.past(unit.shown_group < sensor.minigroups))
    b.cover(unit.value == 4 * ((1 << counts.WIDE_BITS) - 1))  # at a corner


@frozen
class Values:
    """The values of a round, before the one that is read in this cycle.

    here: a value of the minigroup that is followed is read; at_bin: it is that of the bin that is
    followed; own: this value; reach, above: so many reach it, and are above it; all_reach,
    all_above: the same of a whole round; before: values that equal it, in bins before it.
    """

    here: Signal
    at_bin: Signal
    number: Value
    round: Value
    last: Signal
    own: Signal
    reach: Signal
    above: Signal
    all_reach: Signal
    all_above: Signal
    before: Signal


@proof(depth=3, cover=10)
def gate_search_regions(b: Bench):
    """An arbitrary wide bin is marked exactly if fewer than ten values are higher, or equal and in
    bins before it.
    """
    unit = b.place(GateSearch(WITH_ALL_NEIGHBOURS))
    search = _search(b, unit)
    _value_is_in_registers(b, unit, search)
    group = b.same("watched_group", b.constant(range(unit.sensor.minigroups)))
    watched = b.same("watched_bin", b.constant(range(counts.WIDE_BINS)))
    values = _values(b, unit, group, watched)

    _bin_is_marked(b, unit, values, group, watched)

    _tenth_is_between(b, unit, values)
    _found_is_between(b, unit, search, values)
    _left_is_what_is_left(b, unit, values)

    b.cover(values.at_bin & (values.number == 3) & (values.reach == 2))


def _values(b: Bench, unit: GateSearch, group: Signal, watched: Signal) -> Values:
    """Specify the values of a round. They are the same in all rounds, since the memory does not
    change in a search.
    """
    m = b.m
    size = range(counts.WIDE_BINS + 1)
    own = b.same("own", b.constant(VALUE_BITS))
    b.assume(own <= VALUE_MAX)
    number = unit.value_word
    here = b.same("here", unit.valued & (unit.value_group == group))
    round_now = unit.value_round
    at_bin = b.same("at_bin", here & (number == watched))
    last = b.same("last_of_round", here & (number == counts.WIDE_BINS - 1))
    kept_reach = Signal(size)
    kept_above = Signal(size)
    all_reach = Signal(size)
    all_above = Signal(size)
    before = Signal(size)
    reach = b.same("reach", Mux(number == 0, 0, kept_reach))
    above = b.same("above_own", Mux(number == 0, 0, kept_above))
    reach_now = b.same("reach_now", reach + (unit.value >= own))
    above_now = b.same("above_now", above + (unit.value > own))
    with m.If(here):
        m.d.sync += [kept_reach.eq(reach_now), kept_above.eq(above_now)]
    with m.If(last & (round_now == 0)):
        m.d.sync += [all_reach.eq(reach_now), all_above.eq(above_now)]
    with m.If(at_bin & (round_now == 0)):
        m.d.sync += before.eq(reach - above)
    b.assume(unit.value == own, where=at_bin)
    again = (reach_now == all_reach) & (above_now == all_above)
    b.assume(again, where=last & (round_now != 0))
    b.assume(before == reach - above, where=at_bin & (round_now != 0))
    # Help the induction.
    b.always((above <= reach) & (reach <= number), where=here)
    after_bin = here & ((number > watched) | (round_now != 0))
    counted = Mux(round_now == 0, reach, all_reach) - Mux(round_now == 0, above, all_above)
    b.always(before < counted, where=after_bin)
    b.always(all_above <= all_reach, where=here & (round_now != 0))
    return Values(
        here=here,
        at_bin=at_bin,
        number=number,
        round=round_now,
        last=last,
        own=own,
        reach=reach,
        above=above,
        all_reach=all_reach,
        all_above=all_above,
        before=before,
    )


def _bin_is_marked(
    b: Bench, unit: GateSearch, values: Values, group: Signal, watched: Signal
) -> None:
    """State the mark of a bin, in the word that is written.

    Help the induction: in the round that marks, the word is shifted by one place with each bin.
    """
    marked = b.same("spec_mark", values.all_above + values.before < counts.REGIONS)
    place = watched % NOTE_BITS
    word = watched // NOTE_BITS
    written = unit.note_to.bit_select(word, 1) & (unit.group == group)
    b.always(unit.note.bit_select(place, 1) == marked, where=written)
    marks = values.here & (values.round == MARK_ROUND)
    since = (values.number - watched).as_unsigned()[: NOTE_BITS.bit_length()]
    same_word = (values.number // NOTE_BITS == word) & (values.number > watched)
    here = unit.note.bit_select((NOTE_BITS - since)[: NOTE_BITS.bit_length()], 1)
    b.always(here == marked, where=marks & same_word)
    written_after = b.past(marks & (values.number // NOTE_BITS == word))
    b.always(written_after, where=written)


def _tenth_is_between(b: Bench, unit: GateSearch, values: Values) -> None:
    """Help the induction: what is known of the tenth value, one bit with each round."""
    tenth = unit.tenth
    later = values.here & (values.round != 0)
    unknown = b.same("unknown", _power_of(values.round))
    for limit, number in ((values.own, values.all_reach), (values.own + 1, values.all_above)):
        b.always((number >= counts.REGIONS) | (limit == 0), where=later & (tenth >= limit))
        b.always(number < counts.REGIONS, where=later & (tenth + unknown <= limit))
    b.always((tenth & (unknown - 1)[:VALUE_BITS]) == 0, where=unit.valued)
    b.always(tenth <= VALUE_MAX)


def _power_of(number: Value) -> Value:
    """Return the distance of the numbers that the tenth value can be in a round."""
    power: Value = Const(1)
    for k in range(VALUE_BITS):
        power = Mux(number == k, 1 << (VALUE_BITS - k), power)
    return power


def _found_is_between(b: Bench, unit: GateSearch, search: Search, values: Values) -> None:
    """Help the induction: how many values have reached the limit, beside those that are counted for
    the bin.
    """
    found = unit.found
    bits = values.here & (values.round < COUNT_ROUND)
    step = _power_of(values.round) >> 1
    limit = b.same("spec_limit", unit.tenth + step)
    b.always(unit.limit == limit, where=unit.valued & (unit.value_round < COUNT_ROUND))
    for bound, number in ((values.own, values.reach), (values.own + 1, values.above)):
        b.always(found >= number, where=bits & (limit <= bound))
        b.always(found <= number, where=bits & (limit >= bound))
    counts_above = values.here & (values.round == COUNT_ROUND)
    b.always(found == values.above, where=counts_above & (unit.tenth == values.own))
    b.always(found <= values.number, where=unit.valued)
    too_high = unit.valued & (unit.value_round < COUNT_ROUND) & (limit > VALUE_MAX)
    b.always(found == 0, where=too_high)
    at_begin = search.in_regions & (b.past(unit.start) | b.past(unit.start, TO_VALUE))
    b.always((found == 0) & (unit.tenth == 0), where=at_begin)
    b.always(unit.tenth == 0, where=unit.valued & (unit.value_round == 0))


def _left_is_what_is_left(b: Bench, unit: GateSearch, values: Values) -> None:
    """Help the induction: how many values that equal the tenth are still marked."""
    marks = values.here & (values.round == MARK_ROUND)
    equal = values.reach - values.above
    taken = values.all_above + equal
    left = Mux(taken >= counts.REGIONS, 0, counts.REGIONS - taken)
    b.always(unit.equal_left == left, where=marks & (unit.tenth == values.own))


@frozen
class Peak:
    """A peak that is followed, in a round.

    begin: number of its first bin; height, moment: of the bins that have been read.
    """

    begin: Signal
    bins: list[Signal]
    height: Signal
    moment: Signal


@proof(depth=2, cover=20)
def gate_search_gates(b: Bench):
    """The peak that a round finds is as high as an arbitrary one, and higher than one before it;
    the gates are those of the contract, in the period, and do not overlap.
    """
    unit = b.place(GateSearch(SMALL_COUNTS))
    search = _search(b, unit)
    b.assume(unit.last_gate <= counts.CYCLES_MAX - counts.GATE_CYCLES)
    b.assume_stable(unit.last_gate, where=search.in_gates | b.past(search.in_gates))
    first = _first_gate(b, unit, search)
    peak = _peak(b, unit, search, first)

    ends = b.same("peak_found", search.in_gates & (search.position == GATE_ROUND - 1))
    _highest_is_found(b, unit, peak, ends)
    _gates_are_those_of_the_contract(b, unit, search, first, ends)

    _bins_are_in_registers(b, unit, search, peak)
    _highest_is_in_registers(b, unit, search, peak)
    b.cover(search.in_gates & (unit.height == 9))


def _first_gate(b: Bench, unit: GateSearch, search: Search) -> Signal:
    """Specify the first gate, which is known from the end of the first round on.

    All rounds read the same bins: if there is no first gate, all are 0.
    """
    first = Signal(counts.GATE_BITS, name="spec_first")
    with b.m.If(search.in_gates & (search.round == 0) & (search.position == GATE_ROUND - 1)):
        b.m.d.sync += first.eq(_gate(b, unit, "first"))
    second_round = search.in_gates & (search.round == 1)
    b.always(unit.first_gate == first, where=second_round)
    in_second = second_round | b.past(second_round)
    b.assume(unit.narrow == 0, where=in_second & (first == counts.NO_GATE))
    nothing = second_round & (first == counts.NO_GATE)
    b.always(~Cat(*unit.bins).any(), where=nothing)
    peaks = Cat(unit.height, *unit.heights)
    b.always(~peaks.any(), where=nothing & (search.position != 0))
    b.always((first <= unit.last_gate) | (first == counts.NO_GATE), where=second_round)
    return first


def _gate(b: Bench, unit: GateSearch, name: str) -> Signal:
    """Return the gate of the peak that was found, by the contract's formula."""
    begin = unit.peak_begin
    height = unit.height
    moment = unit.moment
    even = begin // 2 - 2 + (moment >= 2 * height) + (moment >= 6 * height)
    odd = begin // 2 - 1 + (moment >= 4 * height)
    wanted = b.same(f"{name}_wanted", Mux(begin % 2 == 0, even, odd))
    late = Mux(wanted > unit.last_gate, unit.last_gate, wanted)
    kept = Mux(wanted < 0, 0, late)
    return b.same(f"{name}_of_peak", Mux(height == 0, counts.NO_GATE, kept)[: counts.GATE_BITS])


def _highest_is_found(b: Bench, unit: GateSearch, peak: Peak, ends: Signal) -> None:
    """State that at the end of a round the highest peak is known, the first of equal ones."""
    is_found = unit.peak_begin == peak.begin
    as_high = (unit.height > peak.height) | (unit.peak_begin <= peak.begin) | (peak.height == 0)
    b.always((unit.height >= peak.height) & as_high, where=ends)
    same = (unit.height == peak.height) & (unit.moment == peak.moment)
    b.always(same, where=ends & is_found & (unit.height != 0))


def _gates_are_those_of_the_contract(
    b: Bench, unit: GateSearch, search: Search, first: Signal, ends: Signal
) -> None:
    """State the gates that are written."""
    gate = _gate(b, unit, "second")
    overlap = (gate < first + counts.GATE_CYCLES) & (first < gate + counts.GATE_CYCLES)
    both = (gate != counts.NO_GATE) & (first != counts.NO_GATE)
    behind = first + counts.GATE_CYCLES
    ahead = first - counts.GATE_CYCLES
    moved = b.same("moved", Mux(gate >= first, behind, ahead))
    within = (moved >= 0) & (moved <= unit.last_gate)
    beside = Mux(within, moved, counts.NO_GATE)
    second = b.same("spec_second", Mux(both & overlap, beside, gate)[: counts.GATE_BITS])
    written = b.past(ends & (search.round == 1))
    b.always(unit.gates == b.past(Cat(first, second)), where=written)
    b.always(unit.set_gates == written)
    begins = [unit.gates.word_select(g, counts.GATE_BITS) for g in range(counts.GATES)]
    for begin in begins:
        in_period = (begin <= b.past(unit.last_gate)) | (begin == counts.NO_GATE)
        b.always(in_period, where=unit.set_gates)
    b.always(gates_are_legal(unit.gates), where=unit.set_gates)


def _peak(b: Bench, unit: GateSearch, search: Search, first: Signal) -> Peak:
    """Specify the bins of a peak, in the order in which a round reads them. In the second round
    those of the first gate are 0.
    """
    m = b.m
    most = counts.NARROW_PER_CYCLE * counts.CYCLES_MAX - counts.PEAK_BINS
    begin = b.same("watched_peak", b.constant(range(most + 1)))
    b.assume(begin <= most)
    cycle = b.past(search.position)  # that is shown
    of_group = unit.narrow.word_select(b.past(search.group), counts.REGION_BITS)
    in_first = (cycle >= first) & (cycle < first + counts.GATE_CYCLES) & (first != counts.NO_GATE)
    empty = (cycle >= counts.CYCLES_MAX) | ((b.past(search.round) == 1) & in_first)
    both = b.same("both_bins", Mux(empty, 0, of_group))
    shown = b.past(search.in_gates)
    bins = [Signal(counts.NARROW_BITS, name=f"peak_bin_{k}") for k in range(counts.PEAK_BINS)]
    with m.If(shown):
        for k, kept in enumerate(bins):
            with m.If(cycle == 0):
                m.d.sync += kept.eq(0)
            with m.If(2 * cycle == begin + k):
                m.d.sync += kept.eq(both[: counts.NARROW_BITS])
            with m.If(2 * cycle + 1 == begin + k):
                m.d.sync += kept.eq(both[counts.NARROW_BITS :])
    height = b.same("peak_height", sum(bins, start=Const(0)))
    moment = b.same("peak_moment", sum((2 * k + 1) * kept for k, kept in enumerate(bins)))
    return Peak(begin, bins, height, moment)


def _bins_are_in_registers(b: Bench, unit: GateSearch, search: Search, peak: Peak) -> None:
    """Help the induction: registers hold the last bins, and the peaks that end in a cycle."""
    cycle = search.position
    in_round = search.in_gates & (cycle != 0)
    bins_max = counts.NARROW_PER_CYCLE * counts.CYCLES_MAX
    at_begin = search.in_gates & (cycle == 0)
    begun = search.begun
    # A search comes after periods, so a reset is long ago.
    awake = Signal(range(counts.ROWS + 1))
    b.m.d.sync += awake.eq(Mux(awake == counts.ROWS, awake, awake + 1))
    b.assume(awake == counts.ROWS, where=unit.start)
    b.always(awake <= counts.ROWS)

    def calm(cycles: int) -> Value:
        is_calm = ~search.reads & ((begun == 0) | (begun > cycles)) & (awake > cycles)
        return is_calm | search.in_regions

    for j, kept in enumerate(unit.bins):
        number = b.same(f"number_of_bin_{j}", 2 * cycle - len(unit.bins) - 2 + j)
        for k, watched in enumerate(peak.bins):
            b.always(kept == watched, where=in_round & (number == peak.begin + k))
        b.always(kept == 0, where=in_round & ((number < 0) | (number >= bins_max)))
        b.always(
            kept == 0, where=calm((len(unit.bins) - j + 3) // counts.NARROW_PER_CYCLE) | at_begin
        )
    for k, (height, moment) in enumerate(zip(unit.heights, unit.moments, strict=True)):
        number = b.same(f"number_of_peak_{k}", 2 * cycle - len(unit.bins) - 4 + k)
        known = (height == peak.height) & (moment == peak.moment)
        b.always(known, where=in_round & (number == peak.begin))
        b.always(height == 0, where=in_round & (number < 1 - counts.PEAK_BINS))
        b.always(height == 0, where=in_round & (number >= bins_max))
        b.always(height == 0, where=calm(5) & ~b.past(search.reads))
    b.always(unit.left_out, where=calm(1) | at_begin)
    b.always(unit.peak_cycle == cycle - 3, where=in_round & (cycle > 2))


def _highest_is_in_registers(b: Bench, unit: GateSearch, search: Search, peak: Peak) -> None:
    """Help the induction: the highest peak of those that have been compared in this round."""
    in_round = search.in_gates & (search.position != 0)
    compared = b.same("compared", 2 * search.position - 10)  # the last one
    after = in_round & (peak.begin <= compared)
    as_high = (unit.height > peak.height) | (unit.peak_begin <= peak.begin) | (peak.height == 0)
    b.always((unit.height >= peak.height) & as_high, where=after)
    same = (unit.height == peak.height) & (unit.moment == peak.moment)
    is_peak = (unit.peak_begin == peak.begin) & (unit.height != 0)
    b.always(same, where=after & is_peak)
    b.always((unit.height == 0) | (unit.peak_begin <= compared), where=in_round)
    b.always(unit.height == 0, where=in_round & (compared < 0))


# From the strobe that starts a period, or from that which asks for a search, to stage 2.
TO_STAGE_2 = 4
STAGES = 5
# Earliest start of a period after the beginning of a frame, since both follow from one strobe.
BEGIN_TO_START = 4


@frozen
class Periods:
    """What the strobes say of the cycle that is at stage 2.

    here: it may have hits; cycle: its number in the period, at most 256; pulse: of step 3, at stage
    3; step: by the searches that the frame has had; length: of the last period before a search, at
    most 256.

    Of the strobes, four stages before: in_period, of_counts: a period is going on, in a frame of
    counts; searches, waited: the searches that have been asked for, and how long ago.
    """

    here: Value
    cycle: Signal
    pulse: Signal
    step: Value
    length: Signal
    in_period: Signal
    of_counts: Signal
    searches: Signal
    waited: Signal


@proof(depth=8, cover=24)
def counts_of_subgroup(b: Bench):
    """While hits may come, the minigroups are told the cycle, the step and the pulse, and no search
    goes on; what leaves is that of the minigroup whose turn it is.
    """
    unit = Counts(SMALL_COUNTS)
    for minigroup in unit.minigroups:
        b.free(minigroup)
    b.place(unit)
    periods = _periods(b, unit)
    _minigroups_are_told(b, unit, periods)
    _one_minigroup_is_shown(b, unit)

    search = _search(b, unit.gate_search, b.always)
    _search_is_done_in_time(b, unit.gate_search, search)
    last_gate = unit.last_gate == periods.length - counts.GATE_CYCLES
    b.always(last_gate, where=search.active)
    _searches_are_in_registers(b, unit, periods, search)
    b.cover(periods.here & (periods.cycle == 3))
    b.cover(unit.gate_search.for_regions)


def _periods(b: Bench, unit: Counts) -> Periods:
    """Specify the periods of a frame, and assume what is proven for the sequencer.

    A frame begins when no period is going on, and its first period some cycles later. A search is
    asked for twice at most, after a period; the next period waits for its pause.
    """
    m = b.m
    begin = unit.frame_begin
    start = unit.start
    asks = unit.search
    went_on = Signal()
    in_period = b.same("in_period", start | (went_on & ~unit.wrap))
    of_counts = Signal()
    searches = Signal(range(3))
    waited = Signal(range(max(PAUSES) + 1), init=max(PAUSES))
    begun = Signal(range(BEGIN_TO_START))
    cycles = Signal(range(counts.CYCLES_MAX + 1))
    length = Signal(range(counts.CYCLES_MAX + 1))
    pause = Mux(searches == 1, *PAUSES)

    may_ask = went_on & unit.wrap & of_counts & (searches < 2)
    b.assume(may_ask & ~start & ~begin, where=asks)
    b.assume((waited >= pause) & (begun == 0) & ~begin, where=start)
    b.assume(cycles >= counts.GATE_CYCLES, where=asks)
    drained = [b.past(in_period, k) for k in range(STAGES + 2)]
    b.assume(~Cat(drained).any(), where=begin)
    here = b.past(in_period, TO_STAGE_2)
    b.assume(here, where=unit.accepted.any())

    longer = Mux(cycles == counts.CYCLES_MAX, cycles, cycles + 1)
    m.d.sync += cycles.eq(Mux(start, 1, longer))
    m.d.sync += waited.eq(Mux(waited == max(PAUSES), waited, waited + 1))
    m.d.sync += begun.eq(Mux(begun == BEGIN_TO_START - 1, 0, begun + (begun != 0)))
    m.d.sync += went_on.eq(in_period)
    with m.If(asks):
        m.d.sync += [searches.eq(searches + 1), waited.eq(1), length.eq(cycles)]
    with m.If(begin):
        m.d.sync += [searches.eq(0), waited.eq(max(PAUSES)), begun.eq(1)]
        m.d.sync += of_counts.eq(unit.counting)

    arrives = b.past(start, TO_STAGE_2)
    step = Mux(of_counts, 1 + b.past(searches, TO_STAGE_2), 0)
    kept_cycle = Signal(range(counts.CYCLES_MAX + 1))
    kept_pulse = Signal(bus.PULSE_BITS)
    cycle = b.same("cycle_of_period", Mux(arrives, 0, kept_cycle))
    next_pulse = kept_pulse + b.past(arrives & (step == bus.Step.GATED))
    pulse = b.same("pulse_of_step", next_pulse[: bus.PULSE_BITS])
    beyond = cycle == counts.CYCLES_MAX
    m.d.sync += kept_cycle.eq(Mux(beyond, cycle, cycle + 1))
    m.d.sync += kept_pulse.eq(Mux(begin, 0, pulse))

    # Help the induction.
    b.always((searches <= 2) & (waited <= max(PAUSES)))
    b.always(begun == 0, where=in_period)
    b.always(of_counts | (searches == 0))
    b.always((waited >= pause) | (searches == 0), where=in_period)
    b.always(unit.cycle == cycle, where=here)
    b.always(unit.pulse == pulse)
    b.always(unit.starts == Cat(b.past(start, k) for k in range(1, STAGES + 1)))
    b.always(unit.searches == Cat(b.past(asks, k) for k in range(1, STAGES + 1)))
    b.always(cycle == b.past(cycles, TO_STAGE_2), where=here & ~arrives)
    return Periods(
        here=here,
        cycle=cycle,
        pulse=pulse,
        step=step,
        length=length,
        in_period=in_period,
        of_counts=of_counts,
        searches=searches,
        waited=waited,
    )


def _searches_are_in_registers(b: Bench, unit: Counts, periods: Periods, search: Search) -> None:
    """Help the induction: the step changes when a search that was asked for is done."""
    pending = b.same("pending", unit.searches.any() | search.active)
    step = Mux(periods.of_counts, 1 + periods.searches - pending, 0)
    b.always(unit.step.as_value() == step)
    b.always(~pending, where=periods.in_period)
    b.always(periods.of_counts & (periods.searches != 0), where=pending)
    b.always(search.regions == (periods.searches == 1), where=search.active)
    b.always(periods.waited == search.since + STAGES, where=search.active)
    for k, asked in enumerate(unit.searches):
        b.always((periods.waited == k + 1) & ~search.active, where=asked)
    known = unit.last_gate == periods.length - counts.GATE_CYCLES
    b.always(known, where=unit.searches[TO_STAGE_2 - 1 :].any())


def _minigroups_are_told(b: Bench, unit: Counts, periods: Periods) -> None:
    """State the inputs of every minigroup while hits may come, and that no search disturbs it."""
    here = periods.here
    within = periods.cycle != counts.CYCLES_MAX
    in_step_3 = b.past(here & (periods.step == bus.Step.GATED))
    stage_3 = b.past(here)
    pixels = SMALL_COUNTS.minigroup_pixels
    for g, minigroup in enumerate(unit.minigroups):
        of_group = unit.accepted.word_select(g, pixels)
        b.always(minigroup.accepted == (of_group & within.replicate(pixels)))
        b.always(minigroup.quarters == unit.quarters.word_select(g, 2 * pixels))
        b.always(minigroup.cycle == periods.cycle, where=here & within)
        b.always(b.last(minigroup.next_cycle) == periods.cycle, where=here & within)
        b.always(minigroup.first == (periods.cycle == 0), where=here)
        b.always(minigroup.step.as_value() == periods.step, where=here)
        b.always(minigroup.pulse == periods.pulse, where=in_step_3)
        written = minigroup.begin | minigroup.note_to.any() | minigroup.set_gates
        b.always(~written & ~minigroup.shows, where=here)
        b.always(~minigroup.begin & ~minigroup.clear, where=stage_3)
        b.always(~b.past(minigroup.begin), where=here)
        last_row = (minigroup.clear_row == counts.ROWS - 1) & (periods.cycle == 0)
        b.always(last_row, where=here & minigroup.clear)


def _one_minigroup_is_shown(b: Bench, unit: Counts) -> None:
    """State what leaves: the first minigroup's, and then the next one's with each packet.

    Before a period of step 3 has begun, there are no gates, pulses and hits.
    """
    number = Signal(range(SMALL_COUNTS.minigroups))
    with b.m.If(unit.frame_begin):
        b.m.d.sync += number.eq(0)
    with b.m.Elif(unit.next_minigroup):
        b.m.d.sync += number.eq(number + 1)
    b.always(unit.minigroup == number)
    begun = (unit.step == bus.Step.GATED) & (unit.pulse != 0)
    for g, minigroup in enumerate(unit.minigroups):
        here = number == g
        gates = Mux(begun, minigroup.gates_kept, (1 << len(minigroup.gates_kept)) - 1)
        b.always(unit.shown.gates == gates, where=here)
        b.always(unit.shown.row == Mux(begun, minigroup.row, 0), where=here)
        for j in range(SMALL_COUNTS.minigroup_pixels):
            stop = minigroup.stops.word_select(j, NOTE_BITS)
            pulses = Mux(minigroup.stopped[j], stop, unit.pulse)
            shown = unit.shown.pulses.word_select(j, bus.PULSE_BITS)
            b.always(shown == Mux(begun, pulses, 0), where=here)
