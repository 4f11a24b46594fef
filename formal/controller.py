# SPDX-License-Identifier: Apache-2.0
"""Proof of the threshold controller: the sums, and the budget computed from them; the subgroup's part is in `dpcu.py`."""

from amaranth.hdl import Cat, Mux, Signal

from ..hdl import bus
from ..hdl.controller import SETTLED, Controller
from ..model.contract.counters import COUNTER_BITS, COUNTER_NAMES
from ..model.contract.packet import BEAT_BITS
from ..model.contract.registers import DATA_BITS
from .bench import Bench, proof
from .sensors import SMALL

COMMITTED, LOWER = (COUNTER_NAMES.index(name) * COUNTER_BITS for name in ("committed", "lower"))  # in the packet
BEATS = LOWER // BEAT_BITS + 1  # `lower` is in the last beat
SUM_MAX = (1 << DATA_BITS + 1) - 1


@proof(depth=5, cover=18)
def controller(b: Bench):
    """Counters are summed once per subgroup; the budget obeys its rule and limits; a total above capacity never raises it."""
    m, unit = b.m, Controller(SMALL)
    capacity, share = b.constant(DATA_BITS), b.constant(DATA_BITS)
    take, done, counted = Signal(), Signal(), Signal(bus.COUNTED)
    m.d.comb += [take.eq(b.anything(1)), done.eq(b.anything(1)), counted.eq(b.anything(counted.shape().size))]
    command = Signal(bus.CONFIG_BUS)
    m.d.comb += command.operation.eq(Mux(take, bus.Operation.TAKE, bus.Operation.IDLE))
    body = b.place("dut", unit, command=command, capacity=capacity, share=share, counted=counted, done=done)

    # A frame is taken. Later its counters come in `BEATS` beats each. It is done `SETTLED` cycles after the last of them.
    frame, beat, quiet = Signal(), Signal(range(BEATS)), Signal(range(SETTLED + 1))
    last = b.same("last", counted.valid & (beat == BEATS - 1))
    m.d.sync += [
        frame.eq((frame | take) & ~done),
        beat.eq(Mux(take | last, 0, beat + counted.valid)),
        quiet.eq(Mux(take | counted.valid, 1, quiet + (quiet != SETTLED))),
    ]
    taken = Signal(range(SETTLED + 1))
    m.d.sync += taken.eq(Mux(take, 1, Mux(taken == 0, 0, taken + (taken != SETTLED))))
    b.assume(share <= capacity)
    b.assume(~frame & ~done, where=take)
    b.assume(frame & (taken == SETTLED), where=counted.valid | done)
    b.assume((beat == 0) & (quiet == SETTLED) & ~counted.valid, where=done)

    # The sums. A subgroup's contribution is complete with its last beat, and is added two cycles later.
    committed, budget = Signal(COUNTER_BITS), unit.budget
    with m.If(counted.valid & (beat == COMMITTED // BEAT_BITS)):
        m.d.sync += committed.eq(counted.beat >> COMMITTED % BEAT_BITS)
    lower = counted.beat.word_select(LOWER % BEAT_BITS // COUNTER_BITS, COUNTER_BITS)
    widened = b.same("widened", budget + (budget // 16) + 1)
    wide = b.same("wide", Mux(widened < capacity, widened, capacity)[:DATA_BITS])
    then = b.same("then", Mux(counted.controlled & (lower <= wide), lower, committed))
    for total, part in ((body.total, committed), (body.more, then)):
        added = b.same("added", b.past(total) + b.past(part, 3))
        b.always(total == Mux(added > SUM_MAX, SUM_MAX, added), where=b.past(last, 3))
        b.always(total == b.past(total), where=b.past(1) & ~b.past(last, 3) & ~b.past(take))
        b.always(total == 0, where=b.past(take))
        b.always(total <= SUM_MAX)

    # The budget.
    too_much = b.same("too_much", body.total > capacity)
    narrowed = b.same("narrowed", budget - (budget // 16))
    narrow = Mux(narrowed > share, narrowed, share)
    expected = Mux(too_much, narrow, Mux(body.more <= capacity, wide, budget))
    running = b.same("running", ~body.fresh)
    b.always(budget == b.past(expected), where=b.past(done))
    b.always(budget == b.past(budget), where=b.past(running & ~done))
    b.always(budget == share, where=b.past(1) & b.past(~running))
    b.always((budget >= share) & (budget <= capacity), where=running)
    b.always(budget <= b.past(budget), where=b.past(done & too_much))
    b.always(budget >= b.past(budget), where=b.past(done & ~too_much))

    # Invariants.
    b.always(body.budget.agree)
    b.always(running == (taken != 0))
    b.always((beat < BEATS) & (body.beat == beat))
    b.always(running, where=frame)
    b.always((body.capacity == capacity) & (body.share == share), where=running)
    b.always(body.complete == Cat(b.past(last), b.past(last, 2)))
    b.always(body.committed == committed, where=beat != 0)
    stands = ~b.past(done) & ~b.past(done, 2) & ~b.past(done, 3)
    b.always((body.wide == wide) & (body.narrow == narrow), where=(taken == SETTLED) & stands)
    b.cover(b.past(done) & (budget > b.past(budget)) & (b.past(body.total) > 5))
    b.cover(b.past(done) & b.past(too_much))
