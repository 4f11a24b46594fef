# SPDX-License-Identifier: Apache-2.0
"""Proofs of the DPCU and of a subgroup's settings."""

from amaranth.hdl import Cat, Mux, Signal

from ..hdl import bus
from ..hdl.dpcu import Dpcu, counter_bits
from ..hdl.settings import SubgroupRegisters
from ..model.contract import registers
from ..model.contract.counters import COUNTER_BITS, COUNTER_NAMES
from ..model.contract.registers import DATA_BITS
from ..model.contract.settings import AUTO_BOUNDS, THRESHOLD_MAX
from .proof_bench import Bench, proof
from .sensors import SMALL

FULL = (1 << COUNTER_BITS) - 1  # a saturated counter of photons,
FULL_OF_CYCLES = (1 << counter_bits("opened", SMALL)) - 1  # and one of cycles in a frame


STREAMS = 3  # on the bus: the previous stream, the subgroup's own, the next one
BUDGETS = 2 * STREAMS  # words: each stream's budget and limit
WORDS = BUDGETS + AUTO_BOUNDS


def _reached(bounds, opened):
    """Return the number of bounds that the opened windows reach."""
    return sum((bound <= opened for bound in bounds), start=0)


def _least(*values):
    """Return the lowest value."""
    least, *others = values
    for other in others:
        least = Mux(other < least, other, least)
    return least


@proof(depth=4, cover=34)
def dpcu(b: Bench):
    """Windows are committed if and only if they meet the threshold; counters balance; the controller moves one step in its limits."""
    sensor, m = SMALL, b.m
    unit = Dpcu(sensor)
    settings, closed, window = unit.settings, unit.closed, unit.window
    operation, data, in_stream = Signal(bus.Operation), Signal(DATA_BITS), Signal()
    stored = b.same("kept", b.anything(1))
    b.place(
        unit,
        operation=operation,
        data=data,
        in_stream=in_stream,
        stored=stored & b.past(unit.commit),
        dropped=~stored & b.past(unit.commit),  # as proven for the FIFO
    )
    count = {
        name: unit.counters.word_select(i, COUNTER_BITS) for i, name in enumerate(COUNTER_NAMES)
    }

    # Between frames, when nothing is on its way, the bus says TAKE, then names budgets, limits and bounds, then BEGIN with the floor.
    budget, limit = b.constant(DATA_BITS), b.constant(DATA_BITS)
    bounds = [b.constant(DATA_BITS) for _ in range(AUTO_BOUNDS)]
    b.assume(budget <= limit)  # as proven for the controller
    floor = b.constant(range(THRESHOLD_MAX + 1))
    step = Signal(range(WORDS + 2))  # 0: idle or TAKE; then the words; the last one: BEGIN
    take, begin = b.same("take", b.anything(1) & (step == 0)), b.same("begin", step == WORDS + 1)
    m.d.sync += step.eq(Mux(begin, 0, step + ((step != 0) | take)))
    m.d.comb += data.eq(b.anything(DATA_BITS))
    with m.Switch(step):
        with m.Case(0):
            m.d.comb += operation.eq(Mux(take, bus.Operation.TAKE, bus.Operation.IDLE))
        with m.Case(WORDS + 1):
            m.d.comb += [operation.eq(bus.Operation.BEGIN), data.eq(floor)]
        for k in range(STREAMS):
            for word, (named, value) in enumerate(
                ((bus.Operation.BUDGET, budget), (bus.Operation.LIMIT, limit))
            ):
                with m.Case(1 + 2 * k + word):
                    m.d.comb += [operation.eq(named), in_stream.eq(k < 2)]
                    if k == 1:
                        m.d.comb += data.eq(value)
        for k in range(AUTO_BOUNDS):
            with m.Case(1 + BUDGETS + k):
                m.d.comb += [operation.eq(bus.Operation.COMPARE), data.eq(bounds[k])]
    taken, begun = Signal(), Signal()
    m.d.sync += [taken.eq(taken | take), begun.eq(begun | begin)]
    b.assume(~settings.auto, where=~taken)  # as settings are after a reset
    starting = b.same("starting", take | (step != 0))
    quiet = b.same("quiet", ~(closed | b.past(closed) | b.past(closed, 2) | b.past(closed, 3)))
    b.assume(quiet, where=starting)
    b.assume(~closed, where=b.past(starting) | b.past(starting, 2) | b.past(starting, 3))
    b.assume_stable(settings.as_value(), where=~b.past(take))
    b.assume(
        (settings.threshold != 0) & (settings.threshold <= sensor.pixels) & (settings.window != 0)
    )
    b.assume((window.count != 0) & (window.count <= sensor.pixels))  # as proven for the tree

    # The comparison with the threshold.
    threshold = Mux(settings.coincidence, count["threshold_used"], 1)
    in_frame = b.same("in_frame", ~starting & ~b.past(starting) & ~b.past(starting, 2))
    b.always(unit.commit == b.past(closed & (window.count >= threshold)), where=b.past(in_frame))
    b.always(unit.event.as_value() == b.last(window.as_value()), where=unit.commit & b.past(1))
    b.always(
        unit.window_ticks == b.last(Mux(settings.coincidence, settings.window, 1)), where=b.past(1)
    )
    b.always(unit.threshold == threshold, where=in_frame & b.past(1, 3))
    b.always(unit.reduced_threshold + 1 == threshold, where=in_frame & begun)
    meets_lower = b.past(closed & (window.count + 1 >= threshold))
    b.always(unit.meets_lower == meets_lower, where=b.past(in_frame & begun))

    # The balance of the counters. A commit is stored or dropped one cycle later.
    under = b.same("under", count["opened"] != FULL_OF_CYCLES)
    b.always(count["opened"] == count["committed"] + count["rejected"], where=under)
    b.always(
        count["committed"] == count["stored"] + count["dropped"] + b.past(unit.commit), where=under
    )
    b.always(count["photons"] >= count["opened"], where=under & (count["photons"] != FULL))
    b.always(
        (count["lower"] >= count["committed"]) & (count["lower"] <= count["opened"]),
        where=under & begun,
    )
    counted = [name for name in COUNTER_NAMES if name != "threshold_used"]
    for name in counted:
        b.always(
            (count[name] == b.past(count[name]))
            | (count[name] == 0)
            | (count[name] > b.past(count[name])),
            where=b.past(1),
        )

    # The threshold: one step from the programmed one in the first controlled frame, later from the previous frame's.
    now, before = settings.auto & settings.coincidence, Signal()
    with m.If(take):
        m.d.sync += before.eq(now)
    opened, committed, lower, used = (
        count[name] for name in ("opened", "committed", "lower", "threshold_used")
    )
    above, below = (
        (committed > limit) & (used < THRESHOLD_MAX),
        (committed <= limit) & (used > 1) & (lower <= budget),
    )
    stepped = Mux(above, used + 1, Mux(below, used - 1, used))
    bounded = b.same("bounded", _least(stepped, 1 + _reached(bounds, opened)))
    controlled = b.same("controlled", Mux(bounded < floor, floor, bounded))
    b.always(used == b.past(Mux(now & before, controlled, settings.threshold)), where=b.past(begin))
    b.always((used != 0) & (used <= sensor.pixels), where=begun)
    b.always(used <= THRESHOLD_MAX, where=b.past(begin & now & before))
    b.always(Cat(count[name] for name in counted) == 0, where=b.past(begin))
    b.always(used == b.past(used), where=b.past(1) & ~b.past(begin))
    b.always(step <= WORDS + 1)
    b.always(begun, where=before | (taken & (step == 0)))
    b.always(unit.stepped == _least(stepped, THRESHOLD_MAX), where=begun & (step > 6))
    b.always(unit.controlled == now)
    b.always(unit.stays == before)
    b.always(unit.ceiling + unit.reached == 1, where=(step != 0) & (step <= 1 + BUDGETS))
    for k in range(1, AUTO_BOUNDS + 1):
        b.always(
            unit.ceiling + unit.reached == 1 + _reached(bounds[:k], opened),
            where=step == 1 + BUDGETS + k,
        )
    b.always(unit.falls == (lower <= budget), where=step > 3)
    b.always(unit.rises == (committed > limit), where=step > 4)
    b.cover(unit.commit & (used == 3) & now & before)
    b.cover((count["rejected"] == 2) & (count["dropped"] == 1))


@proof(depth=3, cover=8)
def subgroup_settings(b: Bench):
    """Settings change only at a TAKE, all at once. Only writes to this subgroup program them. A read gives the word, of others 0."""
    sensor = SMALL
    unit = SubgroupRegisters(sensor)
    command, number = unit.command, b.constant(bus.SUBGROUP_BITS)
    write = command.operation == bus.Operation.WRITE
    b.assume(command.parity == command.data.xor(), where=write)
    for offset, register, _ in registers.words(
        registers.SUBGROUP, sensor
    ):  # as proven for the register front
        b.assume(command.data <= register.high(sensor), where=write & (command.word == offset // 4))
    b.place(unit, subgroup=number)
    b.always(~unit.upset)
    for upset in unit.upsets:
        b.always(~upset)
    taken = b.past(command.operation == bus.Operation.TAKE)
    b.always(unit.settings.as_value() == b.last(unit.programmed.as_value()), where=taken)
    b.stable(unit.settings.as_value(), where=command.operation != bus.Operation.TAKE)
    b.stable(
        unit.programmed.as_value(),
        where=(command.operation != bus.Operation.WRITE) | (command.subgroup != number),
    )
    named = command.operation != bus.Operation.IDLE
    b.always(unit.data == 0, where=b.past(named & (command.subgroup != number), 2))
    b.always(
        unit.gate_late
        == b.past(unit.programmed.gating & (unit.programmed.gate_start >= unit.period))
    )
    for word, value in unit.shown.items():
        b.always(
            unit.data == b.last(value),
            where=b.past(named & (command.subgroup == number) & (command.word == word), 2),
        )
    b.always(~unit.named.any(), where=b.past(named & (command.subgroup != number)))
    b.cover(taken & (unit.settings.threshold == 5))
    b.cover(unit.data == 7)
