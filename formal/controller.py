# SPDX-License-Identifier: Apache-2.0
"""Proof of the threshold controller: sums, and the budget and limit computed from them.

The proof names its parts in order: what the inputs may be, the specification, what is proven, and
the invariants that only help the induction. The subgroup's part is in `dpcu.py`.
"""

from amaranth.hdl import Cat, Mux, Signal, Value
from attrs import frozen

from ..hdl import bus
from ..hdl.controller import FILLED, SETTLED, STEPS, SUMS, Controller
from ..model.contract.counters import COUNTER_BITS, COUNTER_NAMES
from ..model.contract.packet import BEAT_BITS
from ..model.contract.registers import DATA_BITS
from ..model.contract.settings import BUDGET_GROWTHS, LIMIT_DROP
from .proof_bench import Bench, proof
from .sensors import SMALL

# In the packet.
COMMITTED, LOWER = (COUNTER_NAMES.index(name) * COUNTER_BITS for name in ("committed", "lower"))
BEATS = LOWER // BEAT_BITS + 1  # `lower` is in the last beat
SUM_MAX = (1 << DATA_BITS + 1) - 1


def _turned(values: list[Value], turns: int) -> list[Value]:
    """Return the values as a ring of registers shows them after some turns."""
    return [values[(k + turns) % len(values)] for k in range(len(values))]


@frozen
class PlacedController:
    """A controller on the bench, with settings that stay, and where it is in a frame.

    take: the frame's settings are taken; frame: it has begun and is not done; taken: cycles since
    the last `take`, at most `SETTLED`, or 0; beat: number of the next beat of counters;
    some: a subgroup's counters have come; last: their last beat comes; since_last: cycles since.
    """

    unit: Controller
    capacity: Value
    share: Value
    take: Signal
    frame: Signal
    taken: Signal
    beat: Signal
    some: Signal
    last: Signal
    since_last: Signal


@frozen
class Candidates:
    """Budgets from which the controller chooses. grown: without bounds, the present one first."""

    grown: list[Value]
    bounded: list[Signal]


@frozen
class Counters:
    """Counters that are at work, until those of the next subgroup are complete.

    committed: of the next subgroup, once it has come; now: committed at the threshold in use; then:
    at the lower one; controlled: the subgroup has a controlled threshold.
    """

    committed: Signal
    now: Signal
    then: Signal
    controlled: Signal


@frozen
class Sums:
    """Sums of the counters: of all that was committed, then with each candidate.

    slots: bit k: sum k is next; totals: up to `SUM_MAX`; fits: not above the capacity.
    """

    slots: Value
    totals: list[Signal]
    fits: list[Signal]


@frozen
class Choice:
    """What the controller has to choose after a frame.

    most: commits of the busiest controlled subgroup; fitting: the highest candidate whose sum fits;
    top: `most` or the limit, if that is lower; dropped: some of it less; reduced_limit and
    raised_limit: the limit after too much, and after a frame that fits; too_much: more than the
    capacity.
    """

    most: Signal
    fitting: Signal
    top: Signal
    dropped: Signal
    reduced_limit: Signal
    raised_limit: Value
    too_much: Signal


@proof(depth=3, cover=30)
def controller(b: Bench):
    """Counters are summed once per subgroup and candidate; budget and limit obey their rule; too
    much never raises them.
    """
    dut = _place_controller(b)

    candidates = _candidates(b, dut)
    counters = _counters(b, dut)
    sums = _sums(b, dut, candidates, counters)
    choice = _choice(b, dut, candidates, counters, sums)

    _budget_and_limit_obey_the_rule(b, dut, sums, choice)
    _too_much_never_raises_them(b, dut, choice)

    _frame_is_known(b, dut)
    _candidates_are_in_registers(b, dut, candidates)
    _counters_are_in_registers(b, dut, counters)
    _sums_are_in_registers(b, dut, sums)
    _rings_turn(b, dut, candidates, sums)
    _choice_is_in_registers(b, dut, choice)

    budget = dut.unit.budget
    b.cover(b.past(dut.unit.done) & (budget > b.past(budget)) & (b.past(sums.totals[0]) > 5))
    b.cover(b.past(dut.unit.done) & b.past(choice.too_much))


def _place_controller(b: Bench) -> PlacedController:
    """Place a controller. A frame is taken; later its counters come in `BEATS` beats each.

    It is done `SETTLED` cycles after the last of them. What is programmed is the same whenever a frame
    is taken, and may be anything while the frame runs.
    """
    m = b.m
    unit = Controller(SMALL)
    capacity = b.constant(DATA_BITS)
    share = b.constant(DATA_BITS)
    programmed_capacity = b.same("programmed_capacity", b.anything(DATA_BITS))
    programmed_share = b.same("programmed_share", b.anything(DATA_BITS))
    take = b.same("take", b.anything(1))
    done = unit.done
    counted = unit.counted
    b.place(unit, command=None, capacity=programmed_capacity, share=programmed_share)
    m.d.comb += unit.command.operation.eq(Mux(take, bus.Operation.TAKE, bus.Operation.IDLE))

    frame = Signal()
    beat = Signal(range(BEATS))
    some = Signal()
    last = b.same("last", counted.valid & (beat == BEATS - 1))
    since_last = Signal(range(SETTLED + 1), init=SETTLED)
    taken = Signal(range(SETTLED + 1))
    m.d.sync += frame.eq((frame | take) & ~done)
    m.d.sync += beat.eq(Mux(take | last, 0, beat + counted.valid))
    m.d.sync += some.eq((some | last) & ~take)
    m.d.sync += since_last.eq(Mux(last, 1, since_last + (since_last != SETTLED)))
    m.d.sync += taken.eq(Mux(take, 1, Mux(taken == 0, 0, taken + (taken != SETTLED))))

    b.assume(share <= capacity)
    b.assume(programmed_capacity == capacity, where=take)
    b.assume(programmed_share == share, where=take | unit.fresh)
    b.assume(~frame & ~done, where=take)
    b.assume(frame & (taken == SETTLED), where=counted.valid | done)
    b.assume(some & (beat == 0) & (since_last == SETTLED) & ~counted.valid, where=done)
    return PlacedController(
        unit=unit,
        capacity=capacity,
        share=share,
        take=take,
        frame=frame,
        taken=taken,
        beat=beat,
        some=some,
        last=last,
        since_last=since_last,
    )


def _candidates(b: Bench, dut: PlacedController) -> Candidates:
    """Specify the candidates: the budget and more, between share and capacity."""
    budget = dut.unit.budget
    grown = [budget, *(budget + (budget >> growth) + 1 for growth in BUDGET_GROWTHS)]
    bounded = []
    for k, one in enumerate(grown):
        at_most = Mux(one < dut.capacity, one, dut.capacity)[:DATA_BITS]
        below = b.same(f"below_{k}", at_most)
        bounded.append(b.same(f"candidate_{k}", Mux(below > dut.share, below, dut.share)))
    return Candidates(grown, bounded)


def _counters(b: Bench, dut: PlacedController) -> Counters:
    """Specify the counters at work: two numbers from the beats of a subgroup."""
    m = b.m
    counted = dut.unit.counted
    committed = Signal(COUNTER_BITS)
    now = Signal(COUNTER_BITS)
    then = Signal(COUNTER_BITS)
    controlled = Signal()
    with m.If(counted.valid & (dut.beat == COMMITTED // BEAT_BITS)):
        m.d.sync += committed.eq(counted.beat >> COMMITTED % BEAT_BITS)
    lower = counted.beat.word_select(LOWER % BEAT_BITS // COUNTER_BITS, COUNTER_BITS)
    with m.If(dut.last):
        m.d.sync += now.eq(committed)
        m.d.sync += then.eq(lower)
        m.d.sync += controlled.eq(counted.controlled)
    return Counters(committed, now, then, controlled)


def _sums(b: Bench, dut: PlacedController, candidates: Candidates, counters: Counters) -> Sums:
    """Specify the sums: sum k takes a subgroup's part in the cycle after slot k."""
    m = b.m
    unit = dut.unit
    slots = Cat(dut.since_last == 1 + k for k in range(SUMS))
    totals = [Signal(DATA_BITS + 1, name=f"expected_{k}") for k in range(SUMS)]
    fits = [Signal(name=f"expected_fits_{k}") for k in range(SUMS)]
    at_work = Signal(DATA_BITS + 1)
    for k, total in enumerate(totals):
        with m.If(b.past(slots[k])):
            m.d.comb += at_work.eq(total)
    added = b.same("added", at_work + unit.part)
    for k, (total, fit) in enumerate(zip(totals, fits, strict=True)):
        part = counters.now
        if k:
            falls = counters.controlled & (counters.then <= candidates.bounded[k - 1])
            part = Mux(falls, counters.then, counters.now)
        # So the sum has the part by the rule: what is added is what the controller adds.
        b.always(unit.part == b.past(part), where=b.past(slots[k]))
        with m.If(b.past(slots[k])):
            m.d.sync += total.eq(Mux(added > SUM_MAX, SUM_MAX, added))
        with m.If(dut.take):
            m.d.sync += total.eq(0)
        with m.If(b.past(slots[k], 2)):
            m.d.sync += fit.eq(total <= dut.capacity)
    return Sums(slots, totals, fits)


def _choice(
    b: Bench,
    dut: PlacedController,
    candidates: Candidates,
    counters: Counters,
    sums: Sums,
) -> Choice:
    """Specify what is chosen: the highest budget that fits, and the limit that goes with it."""
    m = b.m
    share = dut.share
    limit = dut.unit.limit
    most = Signal(COUNTER_BITS)
    with m.If(dut.take):
        m.d.sync += most.eq(0)
    with m.Elif(sums.slots[0] & counters.controlled & (counters.now > most)):
        m.d.sync += most.eq(counters.now)
    fitting = share
    for fit, candidate in zip(sums.fits[1:], candidates.bounded, strict=True):
        fitting = Mux(fit, candidate, fitting)
    fitting = b.same("fitting", fitting)
    top = b.same("top", Mux(most < limit, most, limit))
    dropped = b.same("dropped", top - (top >> LIMIT_DROP))
    return Choice(
        most=most,
        fitting=fitting,
        top=top,
        dropped=dropped,
        reduced_limit=b.same("reduced_limit", Mux(dropped > share, dropped, share)),
        raised_limit=Mux(fitting > top, fitting, top),
        too_much=b.same("too_much", sums.totals[0] > dut.capacity),
    )


def _running(dut: PlacedController):
    """Return whether a frame has begun since the reset."""
    return ~dut.unit.fresh


def _budget_and_limit_obey_the_rule(
    b: Bench, dut: PlacedController, sums: Sums, choice: Choice
) -> None:
    """State that budget and limit change after a frame only, to what is to be chosen."""
    unit = dut.unit
    share = dut.share
    budget = unit.budget
    limit = unit.limit
    running = _running(dut)
    after_too_much = Mux(sums.totals[0] > 2 * dut.capacity, share, choice.reduced_limit)
    next_limit = Mux(choice.too_much, after_too_much, choice.raised_limit)
    b.always(budget == b.past(Mux(choice.too_much, share, choice.fitting)), where=b.past(unit.done))
    b.always(limit == b.past(next_limit), where=b.past(unit.done))
    both_stay = (budget == b.past(budget)) & (limit == b.past(limit))
    b.always(both_stay, where=b.past(running & ~unit.done))
    b.always((budget == share) & (limit == share), where=b.past(1) & b.past(~running))
    b.always((budget >= share) & (budget <= dut.capacity), where=running)
    b.always(budget <= limit, where=running)


def _too_much_never_raises_them(b: Bench, dut: PlacedController, choice: Choice) -> None:
    """State that neither budget nor limit rises after a frame with too many events."""
    unit = dut.unit
    none_rises = (unit.budget <= b.past(unit.budget)) & (unit.limit <= b.past(unit.limit))
    b.always(none_rises, where=b.past(unit.done & choice.too_much))


def _frame_is_known(b: Bench, dut: PlacedController) -> None:
    """Help the induction: in which order things come in a frame."""
    taken = dut.taken
    since_last = dut.since_last
    running = b.same("running", _running(dut))
    begun = running == (taken != 0)
    b.always(begun & (taken <= SETTLED) & (since_last <= SETTLED))
    b.always(running, where=dut.frame)
    b.always(dut.frame, where=running & (taken != SETTLED))
    b.always(since_last > dut.beat, where=dut.some)
    counters_come = (dut.beat != 0) | dut.some & dut.frame
    b.always(dut.frame & (taken == SETTLED), where=counters_come)
    b.always(dut.frame & dut.some, where=since_last != SETTLED)


def _candidates_are_in_registers(b: Bench, dut: PlacedController, candidates: Candidates) -> None:
    """Help the induction: candidate k goes through a pipeline, then along a row of registers."""
    unit = dut.unit
    taken = dut.taken
    frame = dut.frame
    budget = unit.budget
    running = _running(dut)
    settings_taken = (unit.capacity_taken == dut.capacity) & (unit.share_taken == dut.share)
    b.always(settings_taken, where=running)
    b.always(unit.known == b.past(budget), where=b.past(1))
    for k in range(STEPS + FILLED):
        b.always(unit.filling[k] == (taken == 1 + k))
    for k, (one, candidate) in enumerate(zip(candidates.grown, candidates.bounded, strict=True)):
        begins = 3 + k
        growth = Cat(1, budget >> BUDGET_GROWTHS[k - 1]) if k else 0
        at_most = Mux(one < dut.capacity, one, dut.capacity)
        b.always(unit.growth == growth, where=frame & (taken == begins))
        b.always(unit.grown == one[: DATA_BITS + 1], where=frame & (taken == begins + 1))
        b.always(unit.bounded == at_most, where=frame & (taken == begins + 2))
        b.always(unit.candidate == candidate, where=frame & (taken == begins + 3))
        # On its way to place k, one step for each candidate after it.
        for place in range(k + 1, STEPS):
            here = taken == begins + 3 + STEPS - place
            b.always(unit.steps[place] == candidate, where=frame & here)


def _counters_are_in_registers(b: Bench, dut: PlacedController, counters: Counters) -> None:
    """Help the induction: the controller has taken the counters from the beats."""
    unit = dut.unit
    b.always((dut.beat < BEATS) & (unit.beat == dut.beat))
    b.always(unit.committed == counters.committed, where=dut.beat != 0)
    b.always(
        (unit.now == counters.now)
        & (unit.then == counters.then)
        & (unit.controlled == counters.controlled),
        where=dut.some,
    )


def _sums_are_in_registers(b: Bench, dut: PlacedController, sums: Sums) -> None:
    """Help the induction: the stages of the adder, and comparisons of sums with the capacity."""
    unit = dut.unit
    slots = sums.slots
    b.always(unit.slot == slots)
    b.always(unit.adding == b.past(slots.any()))
    b.always(unit.added == b.past(unit.adding))
    b.always(unit.of_all == Cat(b.past(slots[0]), b.past(slots[0], 2)))
    for k, (total, fit) in enumerate(zip(sums.totals, sums.fits, strict=True)):
        compared = dut.some & (dut.since_last >= 4 + k)
        b.always(fit == (total <= dut.capacity), where=compared)
    far_too_much = sums.totals[0] > 2 * dut.capacity
    b.always(unit.far_too_much == far_too_much, where=dut.some & (dut.since_last >= 4))


def _rings_turn(b: Bench, dut: PlacedController, candidates: Candidates, sums: Sums) -> None:
    """Help the induction: sums and candidates are in rings of registers, which turn by slots."""
    m = b.m
    unit = dut.unit
    slots = sums.slots
    turns = Signal(range(SUMS))
    fit_turns = Signal(range(SUMS))
    step_turns = Signal(range(STEPS))
    next_turn = Mux(turns == SUMS - 1, 0, turns + 1)
    next_step_turn = Mux(step_turns == STEPS - 1, 0, step_turns + 1)
    m.d.sync += turns.eq(Mux(b.past(slots.any()), next_turn, turns))
    m.d.sync += fit_turns.eq(turns)
    m.d.sync += step_turns.eq(Mux(slots[1:].any(), next_step_turn, step_turns))
    for k in range(SUMS):
        b.always(Cat(unit.sums) == Cat(_turned(sums.totals, k)), where=turns == k)
        b.always(unit.fits == Cat(_turned(sums.fits, k)), where=fit_turns == k)
        b.always(turns == k, where=b.past(slots[k]))
        b.always(fit_turns == k, where=b.past(slots[k], 2))
    b.always(turns == 0, where=~b.past(slots.any()))
    b.always(fit_turns == b.past(turns))
    b.always(step_turns == 0, where=~slots[1:].any())
    for k in range(STEPS):
        stands = dut.frame & (dut.taken > STEPS + FILLED) & (step_turns == k)
        b.always(Cat(unit.steps) == Cat(_turned(candidates.bounded, k)), where=stands)
        b.always(step_turns == k, where=slots[1 + k])


def _choice_is_in_registers(b: Bench, dut: PlacedController, choice: Choice) -> None:
    """Help the induction: each part of the choice is ready in time."""
    unit = dut.unit
    since_last = dut.since_last
    counting = dut.some & dut.frame
    b.always(unit.most == choice.most, where=_running(dut))
    b.always(unit.top == choice.top, where=counting & (since_last >= 3))
    b.always(unit.dropped == choice.dropped, where=counting & (since_last >= 4))
    b.always(unit.reduced_limit == choice.reduced_limit, where=counting & (since_last >= 5))
    b.always(unit.fitting == choice.fitting, where=counting & (since_last >= SETTLED - 1))
    b.always(unit.raised_limit == choice.raised_limit, where=counting & (since_last >= SETTLED))
    b.always(unit.budget_voted.agree)
