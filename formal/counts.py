# SPDX-License-Identifier: Apache-2.0
"""Proofs of counts: a minigroup's memory, and the search between the steps.

Each proof names its parts in order: what the inputs may be, the specification, what is proven, and
the invariants that only help the induction.

A proof follows one bin, or one peak, that may be any. So what holds for it holds for all.
"""

from typing import Any

from amaranth.hdl import Cat, Const, Mux, ResetSignal, Signal, Value
from attrs import frozen

from ..hdl import bus
from ..hdl.minigroup_counts import NOTE_BITS, NOTES, MinigroupCounts
from ..model.contract import counts
from ..model.contract.parameters import QUARTERS
from .proof_bench import Bench, elaborated, proof
from .sensors import SMALL_COUNTS

RANK_BITS = counts.REGIONS.bit_length()
PIXELS = SMALL_COUNTS.minigroup_pixels
WIDE_MAX = (1 << counts.WIDE_BITS) - 1
NARROW_MAX = (1 << counts.NARROW_BITS) - 1
COUNT_MAX = (1 << counts.COUNT_BITS) - 1


@frozen
class Hits:
    """The hits of a cycle, in stage 3: one cycle after they were accepted.

    cycle: its number; counted: pixels whose hits count; late: hits in the second half of the cycle;
    quarters: two bits for each pixel.
    """

    cycle: Signal
    counted: Signal
    late: Signal
    quarters: Signal

    def number(self, b: Bench, name: str, which: Value | int = -1) -> Signal:
        """Return how many of some hits count."""
        return b.same(name, sum((self.counted & which)[:PIXELS], start=Const(0)))


@frozen
class Search:
    """What the search has written. marks: of wide bins; first: number of marks before each bin, and
    of all; gates: their first cycles.
    """

    marks: Signal
    first: list[Value]
    gates: Signal
    marked: Signal
    gated: Signal


@frozen
class WatchedBin:
    """A bin that is followed, or two that are in one place of the memory.

    row, value: where it is, and what is there; before: what the contract has in it; now: the same
    with this cycle's hits; hit: it gets hits in this cycle; full: and becomes full; lost: its place
    or its hits are not known any more.
    """

    row: Value
    value: Value
    before: Signal
    now: Value
    hit: Signal
    full: Signal
    lost: Value


@proof(depth=3, cover=20)
def minigroup_counts(b: Bench):
    """Every bin of every step has the contract's hits, from its clearing to the end of the step;
    who becomes full stops, with the right pulse, and nobody else.
    """
    unit = b.place(MinigroupCounts(SMALL_COUNTS))
    elaborated(unit.rows)
    hits = _hits(b, unit)
    search = _search_obeys(b, unit)
    in_order = _cycles_obey(b, unit, search)

    place = b.same("place", b.constant(counts.GATE_BITS))
    wide = _wide_bin(b, unit, hits, place)
    narrow = _narrow_bins(b, unit, hits, place, search)
    pixel = b.same("pixel", b.constant(range(PIXELS)))
    count = _count_bin(b, unit, hits, place, search, pixel)
    bins = {bus.Step.WIDE: wide, bus.Step.NARROW: narrow, bus.Step.GATED: count}
    known = {step: _bin_is_right(b, unit, step, watched, hits) for step, watched in bins.items()}

    _all_stop_together(b, unit, hits, bins, known, search)
    _pixel_stops(b, unit, hits, count, known[bus.Step.GATED], pixel, search)
    _search_is_shown(b, unit, bins, known, place, search, in_order)

    _hits_are_in_registers(b, unit, hits)
    _rank_is_in_registers(b, unit, search, in_order)

    for step, watched in bins.items():
        b.cover(known[step] & watched.hit & (watched.before != 0))


def _hits(b: Bench, unit: MinigroupCounts) -> Hits:
    """Specify the hits that count: of pixels that have not stopped, in cycles that count."""
    hits = b.past(unit.accepted)
    quarters = b.past(unit.quarters)
    in_step = (unit.step != bus.Step.NONE).replicate(PIXELS)
    counted = b.same("counted_now", hits & ~unit.stopped & in_step)
    late = b.same("late", Cat(quarters.word_select(j, 2)[1] for j in range(PIXELS)))
    return Hits(b.last(unit.cycle), counted, late, quarters)


def _search_obeys(b: Bench, unit: MinigroupCounts) -> Search:
    """Assume what is proven for the search and for the subgroup's counts.

    A step begins, and the memory is cleared, when no hit is on its way, except that the last row is
    cleared while the first cycle of a frame is in stage 2. The search writes at most
    ten marks at the end of step 1, and gates that do not overlap at the end of step 2. Rows are
    read when the periods are over.
    """
    m = b.m
    comes = unit.accepted.any()
    some = comes | b.past(comes)
    b.assume_stable(unit.step.as_value(), where=~b.last(unit.begin) & ~b.last(ResetSignal()))
    b.assume(~some, where=unit.begin | b.past(unit.begin))
    b.assume(~comes, where=unit.shows | unit.reading)
    b.assume(~b.past(comes), where=unit.clear)
    last_row = (unit.clear_row == counts.ROWS - 1) & (unit.step == bus.Step.WIDE)
    b.assume(last_row & (unit.cycle == 0), where=unit.clear & comes)
    b.assume(unit.cycle == b.last(unit.next_cycle), where=comes)
    b.assume(unit.note_to == 0, where=unit.step != bus.Step.WIDE)
    b.assume((unit.note_to == 0) | ~some)
    b.assume(~unit.set_gates, where=unit.step == bus.Step.GATED)

    marks = Signal(counts.WIDE_BINS)
    words_marked = Signal(NOTES)
    for k in range(NOTES):
        with m.If(unit.note_to[k]):
            m.d.sync += marks.word_select(k, NOTE_BITS).eq(unit.note)
            m.d.sync += words_marked[k].eq(1)
        with m.Elif(unit.stopping.any()):
            m.d.sync += words_marked[k].eq(0)
    first: list[Value] = [Const(0, RANK_BITS)]
    for w in range(counts.WIDE_BINS):
        beyond = first[-1] == (1 << RANK_BITS) - 1
        after = Mux(beyond, first[-1], first[-1] + marks[w])[:RANK_BITS]
        first.append(b.same(f"regions_to_{w}", after))
    marked = b.same("marked", words_marked.all())
    in_step_2 = unit.step == bus.Step.NARROW
    b.assume(marked, where=in_step_2 & some)
    b.assume(first[-1] <= counts.REGIONS, where=in_step_2 & marked)

    gates = Signal(counts.GATES * counts.GATE_BITS)
    gated = Signal()
    with m.If(unit.set_gates):
        m.d.sync += [gates.eq(unit.gates), gated.eq(1)]
    b.assume(gates_are_legal(unit.gates), where=unit.set_gates)
    b.assume(gated, where=(unit.step == bus.Step.GATED) & some)
    b.always(unit.gates_kept == gates, where=gated)
    for k in range(NOTES):
        same = unit.stops.word_select(k, NOTE_BITS) == marks.word_select(k, NOTE_BITS)
        b.always(same, where=words_marked[k])
    b.always(gates_are_legal(gates), where=gated)
    return Search(marks, first, gates, marked, gated)


def gates_are_legal(gates: Value) -> Value:
    """Return whether gates are within 256 cycles, and do not overlap."""
    begins = [gates.word_select(g, counts.GATE_BITS) for g in range(counts.GATES)]
    none = [begin == counts.NO_GATE for begin in begins]
    one, other = begins
    apart = (one + counts.GATE_CYCLES <= other) | (other + counts.GATE_CYCLES <= one)
    within = [begin <= counts.CYCLES_MAX - counts.GATE_CYCLES for begin in begins]
    legal = [has_none | inside for has_none, inside in zip(none, within, strict=True)]
    return legal[0] & legal[1] & (apart | none[0] | none[1])


def _cycles_obey(b: Bench, unit: MinigroupCounts, search: Search) -> Signal:
    """Assume that hits come in consecutive cycles, from the first cycle of a period on.
    Return whether this cycle is one of them.
    """
    in_order = Signal()
    goes_on = b.past(in_order) & (unit.cycle != 0) & (unit.cycle == b.last(unit.cycle) + 1)
    same_step = b.last(unit.step) == unit.step.as_value()
    b.m.d.comb += in_order.eq(unit.first | (goes_on & same_step & b.past(search.marked)))
    b.assume(unit.cycle == 0, where=unit.first)
    b.assume(in_order, where=unit.accepted.any() & (unit.step == bus.Step.NARROW))
    return in_order


def _bin_is_right(
    b: Bench, unit: MinigroupCounts, step: Any, watched: WatchedBin, hits: Hits
) -> Signal:
    """State that a bin of the memory has the contract's hits; return when it is
    known: from its row's clearing on, until hits of another step are in the memory."""
    m = b.m
    known = Signal(name=f"{step.name.lower()}_known")
    with m.If(unit.clear & (unit.clear_row == watched.row)):
        m.d.sync += known.eq(1)
        m.d.sync += watched.before.eq(0)
    with m.Elif(unit.step == step):
        m.d.sync += watched.before.eq(watched.now)
    with m.Elif(hits.counted.any()):
        m.d.sync += known.eq(0)
    with m.If(watched.lost):
        m.d.sync += known.eq(0)
    b.always(watched.value == watched.before, where=known)
    return known


def _row(b: Bench, unit: MinigroupCounts, name: str, number: Value) -> Signal:
    """Return what is in a row of the memory."""
    look = unit.rows.rows.read_port(domain="comb")
    b.m.d.comb += look.addr.eq(number)
    return b.same(name, look.data)


def _wide_bin(b: Bench, unit: MinigroupCounts, hits: Hits, place: Value) -> WatchedBin:
    """Specify the wide bin of a cycle."""
    number = place // counts.WIDE_CYCLES
    row = b.same("wide_row", number // counts.WIDE_PER_ROW)
    lane = b.same("wide_lane", number % counts.WIDE_PER_ROW)
    before = Signal(counts.WIDE_BITS, name="wide_before")
    hit = b.same("wide_hit", hits.counted.any() & (hits.cycle // counts.WIDE_CYCLES == number))
    total = b.same("wide_total", before + hits.number(b, "wide_new"))
    full = b.same("wide_full", hit & (total >= WIDE_MAX))
    value = _row(b, unit, "row_of_wide", row).word_select(lane, counts.WIDE_BITS)
    now = Mux(hit, Mux(total > WIDE_MAX, WIDE_MAX, total), before)
    return WatchedBin(row, value, before, now, hit, full, Const(0))


def _narrow_bins(
    b: Bench, unit: MinigroupCounts, hits: Hits, place: Value, search: Search
) -> WatchedBin:
    """Specify both narrow bins of a cycle. They are in the row of their region."""
    region = place // counts.WIDE_CYCLES
    rank = b.same("rank_of_place", _chosen(search.first[:-1], region))
    upper = b.same("place_is_upper", rank >= counts.REGIONS_PER_ROW)
    row = b.same("narrow_row", 2 * (place % counts.WIDE_CYCLES) + upper)[:3]
    lane = b.same("narrow_lane", Mux(upper, rank - counts.REGIONS_PER_ROW, rank)[:3])
    is_region = b.same("place_is_region", search.marks.bit_select(region, 1))
    before = Signal(counts.REGION_BITS, name="narrow_before")
    hit = b.same("narrow_hit", hits.counted.any() & (hits.cycle == place) & is_region)
    halves = []
    full = []
    for half, which in enumerate((~hits.late, hits.late)):
        there = before.word_select(half, counts.NARROW_BITS)
        total = b.same(f"narrow_total_{half}", there + hits.number(b, f"narrow_new_{half}", which))
        full.append(total >= NARROW_MAX)
        halves.append(Mux(total > NARROW_MAX, NARROW_MAX, total)[: counts.NARROW_BITS])
    content = _row(b, unit, "row_of_narrow", row)
    value = content.word_select(lane, counts.REGION_BITS)
    lost = unit.note_to.any() | unit.stopping.any() | ~is_region | ~search.marked
    return WatchedBin(
        row=row,
        value=value,
        before=before,
        now=Mux(hit, Cat(halves), before),
        hit=hit,
        full=b.same("narrow_full", hit & (full[0] | full[1])),
        lost=lost,
    )


def _chosen(items: list[Value], number: Value) -> Value:
    """Return the item with a number."""
    while len(items) > 1:
        pairs = zip(items[::2], items[1::2], strict=True)
        items = [Mux(number[0], odd, even) for even, odd in pairs]
        number = number[1:]
    return items[0]


def _count_bin(
    b: Bench, unit: MinigroupCounts, hits: Hits, place: Value, search: Search, pixel: Signal
) -> WatchedBin:
    """Specify the count of a pixel in a quarter of a gate's cycle."""
    gate = b.same("gate", b.constant(range(counts.GATES)))
    quarter = b.same("quarter", b.constant(range(QUARTERS)))
    cycle = place[:2]  # of the gate, modulo its length
    row = b.same("count_row", Cat(cycle, gate))
    before = Signal(counts.COUNT_BITS, name="count_before")
    begin = search.gates.word_select(gate, counts.GATE_BITS)
    inside = b.same("inside", _inside(hits.cycle, begin) & (hits.cycle[:2] == cycle))
    of_pixel = hits.counted.bit_select(pixel, 1) & (hits.quarters.word_select(pixel, 2) == quarter)
    hit = b.same("count_hit", of_pixel & inside)
    content = _row(b, unit, "row_of_count", row)
    value = content.word_select(Cat(pixel, quarter), counts.COUNT_BITS)
    full = b.same("count_full", hit & (before == COUNT_MAX - 1))
    now = (before + hit)[: counts.COUNT_BITS]
    return WatchedBin(row, value, before, now, hit, full, Const(0))


def _inside(cycle: Value, begin: Value) -> Value:
    """Return whether a cycle is in the gate that begins with another one."""
    after = (cycle >= begin) & (cycle < begin + counts.GATE_CYCLES)
    return after & (begin != counts.NO_GATE)


def _all_stop_together(
    b: Bench,
    unit: MinigroupCounts,
    hits: Hits,
    bins: dict[Any, WatchedBin],
    known: dict[Any, Signal],
    search: Search,
) -> None:
    """State that in steps 1 and 2 the minigroup stops after the cycle in which a bin is full."""
    step = unit.step
    wide = (step == bus.Step.WIDE) & bins[bus.Step.WIDE].hit & known[bus.Step.WIDE]
    narrow = (step == bus.Step.NARROW) & bins[bus.Step.NARROW].hit & known[bus.Step.NARROW]
    everybody = (1 << PIXELS) - 1
    rises = unit.stopped & ~b.past(unit.stopped)
    for where, watched in ((wide, bins[bus.Step.WIDE]), (narrow, bins[bus.Step.NARROW])):
        b.always(unit.stopped == Mux(b.past(watched.full), everybody, 0), where=b.past(where))
    is_region = _chosen(list(search.marks), hits.cycle // counts.WIDE_CYCLES)
    outside = (step == bus.Step.NARROW) & ~is_region & search.marked
    nothing = b.same("nothing", ~hits.counted.any() | outside)
    b.always(rises == 0, where=b.past(nothing))
    all_or_none = (unit.stopped == 0) | (unit.stopped == everybody)
    b.always(all_or_none, where=(step == bus.Step.WIDE) | (step == bus.Step.NARROW))
    b.always(unit.stopped == 0, where=b.past(unit.begin))
    b.always((b.past(unit.stopped) & ~unit.stopped) == 0, where=b.past(~unit.begin))


def _pixel_stops(
    b: Bench,
    unit: MinigroupCounts,
    hits: Hits,
    count: WatchedBin,
    known: Signal,
    pixel: Signal,
    search: Search,
) -> None:
    """State that in step 3 a pixel stops with the hit with which its bin is full, and that the
    pulse of this hit is kept.
    """
    m = b.m
    in_step = b.same("in_step_3", unit.step == bus.Step.GATED)
    stopped = unit.stopped.bit_select(pixel, 1)
    rises = b.same("rises", stopped & ~b.past(stopped))
    b.always(rises == b.past(count.full), where=b.past(in_step & count.hit & known))
    begins = [search.gates.word_select(g, counts.GATE_BITS) for g in range(counts.GATES)]
    in_gate = _inside(hits.cycle, begins[0]) | _inside(hits.cycle, begins[1])
    hit = b.same("pixel_hit", hits.counted.bit_select(pixel, 1) & in_gate)
    b.always(~rises, where=b.past(in_step & ~hit))

    stop = Signal(bus.PULSE_BITS)
    pulse_known = Signal()
    of_hit = b.last(unit.pulse)
    was_in_step = b.past(in_step)
    with m.If(~in_step | unit.begin):
        m.d.sync += pulse_known.eq(0)
    with m.Elif(rises):
        m.d.sync += [stop.eq(of_hit), pulse_known.eq(was_in_step)]
    kept = unit.stops.word_select(pixel, NOTE_BITS)
    b.always(kept == stop, where=pulse_known & in_step)
    b.always(stopped, where=pulse_known & in_step)
    b.cover(pulse_known & in_step & (stop == 3))


def _search_is_shown(
    b: Bench,
    unit: MinigroupCounts,
    bins: dict[Any, WatchedBin],
    known: dict[Any, Signal],
    place: Value,
    search: Search,
    in_order: Signal,
) -> None:
    """State that the bins of a cycle are shown one cycle later, and the row that is read."""
    wide, narrow = bins[bus.Step.WIDE], bins[bus.Step.NARROW]
    same_bin = unit.cycle // counts.WIDE_CYCLES == place // counts.WIDE_CYCLES
    shows = unit.shows & ~unit.reading & ~unit.clear
    in_wide = b.past(shows & (unit.step == bus.Step.WIDE) & same_bin)
    b.always(unit.wide == wide.before, where=in_wide & known[bus.Step.WIDE])
    same_cycle = (unit.cycle == place) & in_order
    in_narrow = b.past(shows & (unit.step == bus.Step.NARROW) & same_cycle & search.marked)
    b.always(unit.narrow == narrow.before, where=in_narrow & known[bus.Step.NARROW])
    is_region = search.marks.bit_select(place // counts.WIDE_CYCLES, 1)
    b.always(unit.narrow == 0, where=in_narrow & search.marked & ~is_region)
    content = _row(b, unit, "row_that_is_read", b.last(unit.read_row))
    b.always(unit.row == content, where=b.past(unit.reading & ~unit.clear))


def _hits_are_in_registers(b: Bench, unit: MinigroupCounts, hits: Hits) -> None:
    """Help the induction: registers hold the hits."""
    counts_here = unit.counts_here.replicate(PIXELS)
    b.always(unit.hits == b.past(unit.accepted & counts_here))
    for j in range(PIXELS):
        same = unit.quarter.word_select(j, 2) == hits.quarters.word_select(j, 2)
        b.always(same, where=unit.hits[j])
    b.always(unit.stopping == 0, where=~b.past(hits.counted.any()))


def _rank_is_in_registers(
    b: Bench, unit: MinigroupCounts, search: Search, in_order: Signal
) -> None:
    """Help the induction: a register holds the number of regions before the cycle's."""
    rank = _chosen(search.first[:-1], unit.cycle // counts.WIDE_CYCLES)
    in_step = (unit.step == bus.Step.NARROW) & search.marked & in_order
    b.always(unit.rank_now == rank, where=in_step)
