# SPDX-License-Identifier: Apache-2.0
"""Proof of the threshold controller: the sums, budget and limit computed from them; the subgroup's part is in `dpcu.py`."""

from amaranth.hdl import Cat, Mux, Signal, Value

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


@proof(depth=3, cover=30)
def controller(b: Bench):
    """Counters are summed once per subgroup and candidate; budget and limit obey their rule; too much never raises them."""
    m, unit = b.m, Controller(SMALL)
    capacity, share = b.constant(DATA_BITS), b.constant(DATA_BITS)
    take, done, counted = b.same("take", b.anything(1)), unit.done, unit.counted
    b.place(unit, command=None, capacity=capacity, share=share)
    m.d.comb += unit.command.operation.eq(Mux(take, bus.Operation.TAKE, bus.Operation.IDLE))

    # A frame is taken. Later its counters come in `BEATS` beats each. It is done `SETTLED` cycles after the last of them.
    frame, beat, some = Signal(), Signal(range(BEATS)), Signal()
    last = b.same("last", counted.valid & (beat == BEATS - 1))
    since_last, taken = Signal(range(SETTLED + 1), init=SETTLED), Signal(range(SETTLED + 1))
    m.d.sync += [
        frame.eq((frame | take) & ~done),
        beat.eq(Mux(take | last, 0, beat + counted.valid)),
        some.eq((some | last) & ~take),
        since_last.eq(Mux(last, 1, since_last + (since_last != SETTLED))),
        taken.eq(Mux(take, 1, Mux(taken == 0, 0, taken + (taken != SETTLED)))),
    ]
    b.assume(share <= capacity)
    b.assume(~frame & ~done, where=take)
    b.assume(frame & (taken == SETTLED), where=counted.valid | done)
    b.assume(some & (beat == 0) & (since_last == SETTLED) & ~counted.valid, where=done)

    # The candidates, which are ready when counters come.
    budget, limit = unit.budget, unit.limit
    grown = [budget, *(budget + (budget >> growth) + 1 for growth in BUDGET_GROWTHS)]
    candidates = []
    for k, one in enumerate(grown):
        below = b.same(f"below_{k}", Mux(one < capacity, one, capacity)[:DATA_BITS])
        candidates.append(b.same(f"candidate_{k}", Mux(below > share, below, share)))
    running = b.same("running", ~unit.fresh)
    b.always((running == (taken != 0)) & (taken <= SETTLED) & (since_last <= SETTLED))
    b.always(running, where=frame)
    b.always(frame, where=running & (taken != SETTLED))
    b.always((unit.capacity_taken == capacity) & (unit.share_taken == share), where=running)
    b.always(unit.known == b.past(budget), where=b.past(1))
    for k in range(STEPS + FILLED):
        b.always(unit.filling[k] == (taken == 1 + k))
    for k, (one, candidate) in enumerate(zip(grown, candidates)):
        begins = 3 + k
        growth = Cat(1, budget >> BUDGET_GROWTHS[k - 1]) if k else 0
        b.always(unit.growth == growth, where=frame & (taken == begins))
        b.always(unit.grown == one[: DATA_BITS + 1], where=frame & (taken == begins + 1))
        b.always(
            unit.bounded == Mux(one < capacity, one, capacity), where=frame & (taken == begins + 2)
        )
        b.always(unit.candidate == candidate, where=frame & (taken == begins + 3))
        for place in range(
            k + 1, STEPS
        ):  # on their way to place k, one step for each candidate after them
            b.always(
                unit.steps[place] == candidate, where=frame & (taken == begins + 3 + STEPS - place)
            )

    # The sums. The counters of a subgroup are at work until those of the next one are complete.
    committed, now, then, controlled = (
        Signal(COUNTER_BITS),
        Signal(COUNTER_BITS),
        Signal(COUNTER_BITS),
        Signal(),
    )
    with m.If(counted.valid & (beat == COMMITTED // BEAT_BITS)):
        m.d.sync += committed.eq(counted.beat >> COMMITTED % BEAT_BITS)
    with m.If(last):
        m.d.sync += [
            now.eq(committed),
            then.eq(counted.beat.word_select(LOWER % BEAT_BITS // COUNTER_BITS, COUNTER_BITS)),
            controlled.eq(counted.controlled),
        ]
    b.always((beat < BEATS) & (unit.beat == beat))
    b.always(unit.committed == committed, where=beat != 0)
    b.always((unit.now == now) & (unit.then == then) & (unit.controlled == controlled), where=some)
    b.always(since_last > beat, where=some)
    b.always(frame & (taken == SETTLED), where=(beat != 0) | some & frame)
    b.always(frame & some, where=since_last != SETTLED)
    slots = Cat(since_last == 1 + k for k in range(SUMS))
    b.always(unit.slot == slots)
    b.always(unit.adding == b.past(slots.any()))
    b.always(unit.added == b.past(unit.adding))
    b.always(unit.of_all == Cat(b.past(slots[0]), b.past(slots[0], 2)))
    sums = [Signal(DATA_BITS + 1, name=f"expected_{k}") for k in range(SUMS)]
    fits = [Signal(name=f"expected_fits_{k}") for k in range(SUMS)]
    at_work = Signal(DATA_BITS + 1)
    for k, total in enumerate(sums):
        with m.If(b.past(slots[k])):
            m.d.comb += at_work.eq(total)
    added = b.same("added", at_work + unit.part)
    for k, (total, fit) in enumerate(zip(sums, fits)):
        part = Mux(controlled & (then <= candidates[k - 1]), then, now) if k else now
        b.always(unit.part == b.past(part), where=b.past(slots[k]))
        with m.If(b.past(slots[k])):
            m.d.sync += total.eq(Mux(added > SUM_MAX, SUM_MAX, added))
        with m.If(take):
            m.d.sync += total.eq(0)
        with m.If(b.past(slots[k], 2)):
            m.d.sync += fit.eq(total <= capacity)
        b.always(fit == (total <= capacity), where=some & (since_last >= 4 + k))
    turns, fit_turns = Signal(range(SUMS)), Signal(range(SUMS))
    m.d.sync += [
        turns.eq(Mux(b.past(slots.any()), Mux(turns == SUMS - 1, 0, turns + 1), turns)),
        fit_turns.eq(turns),
    ]
    step_turns = Signal(range(STEPS))
    for k in range(SUMS):
        b.always(Cat(unit.sums) == Cat(_turned(sums, k)), where=turns == k)
        b.always(unit.fits == Cat(_turned(fits, k)), where=fit_turns == k)
        b.always(turns == k, where=b.past(slots[k]))
        b.always(fit_turns == k, where=b.past(slots[k], 2))
    b.always(turns == 0, where=~b.past(slots.any()))
    b.always(fit_turns == b.past(turns))
    m.d.sync += step_turns.eq(
        Mux(slots[1:].any(), Mux(step_turns == STEPS - 1, 0, step_turns + 1), step_turns)
    )
    b.always(step_turns == 0, where=~slots[1:].any())
    for k in range(STEPS):
        stands = frame & (taken > STEPS + FILLED) & (step_turns == k)
        b.always(Cat(unit.steps) == Cat(_turned(candidates, k)), where=stands)
        b.always(step_turns == k, where=slots[1 + k])
    b.always(unit.far_too_much == (sums[0] > 2 * capacity), where=some & (since_last >= 4))

    # Budget and limit.
    most = Signal(COUNTER_BITS)
    with m.If(take):
        m.d.sync += most.eq(0)
    with m.Elif(slots[0] & controlled & (now > most)):
        m.d.sync += most.eq(now)
    fitting = share
    for fit, candidate in zip(fits[1:], candidates):
        fitting = Mux(fit, candidate, fitting)
    fitting = b.same("fitting", fitting)
    top = b.same("top", Mux(most < limit, most, limit))
    dropped = b.same("dropped", top - (top >> LIMIT_DROP))
    reduced_limit = b.same("reduced_limit", Mux(dropped > share, dropped, share))
    b.always(unit.most == most, where=running)
    b.always(unit.top == top, where=some & frame & (since_last >= 3))
    b.always(unit.dropped == dropped, where=some & frame & (since_last >= 4))
    b.always(unit.reduced_limit == reduced_limit, where=some & frame & (since_last >= 5))
    b.always(unit.fitting == fitting, where=some & frame & (since_last >= SETTLED - 1))
    raised_limit = Mux(fitting > top, fitting, top)
    b.always(unit.raised_limit == raised_limit, where=some & frame & (since_last >= SETTLED))
    too_much = b.same("too_much", sums[0] > capacity)
    next_limit = Mux(too_much, Mux(sums[0] > 2 * capacity, share, reduced_limit), raised_limit)
    b.always(budget == b.past(Mux(too_much, share, fitting)), where=b.past(done))
    b.always(limit == b.past(next_limit), where=b.past(done))
    b.always((budget == b.past(budget)) & (limit == b.past(limit)), where=b.past(running & ~done))
    b.always((budget == share) & (limit == share), where=b.past(1) & b.past(~running))
    b.always((budget >= share) & (budget <= capacity), where=running)
    b.always(budget <= limit, where=running)
    b.always((budget <= b.past(budget)) & (limit <= b.past(limit)), where=b.past(done & too_much))
    b.always(unit.budget_voted.agree)
    b.cover(b.past(done) & (budget > b.past(budget)) & (b.past(sums[0]) > 5))
    b.cover(b.past(done) & b.past(too_much))
