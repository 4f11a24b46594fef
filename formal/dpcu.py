# SPDX-License-Identifier: Apache-2.0
"""Proofs of the DPCU and of a subgroup's settings.

Each proof names its parts in order: what the inputs may be, the specification, what is proven, and
the invariants that only help the induction.
"""

from amaranth.hdl import Cat, Mux, Signal, Value
from attrs import frozen

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


@frozen
class PlacedDpcu:
    """A DPCU on the bench, with the words that it gets at the beginning of a frame.

    budget, limit, bounds, floor: of the controller, the same in every frame; step: 0 while there
    are no words, or TAKE, then the number of the word, the last one is BEGIN; take, begin: they are
    on the bus; taken, begun: so they have been; between: no frame runs, and none begins; written:
    then, a setting is written; starting: a frame begins; in_frame: nothing of its beginning is on
    its way.
    """

    unit: Dpcu
    budget: Value
    limit: Value
    bounds: list[Value]
    floor: Value
    step: Signal
    take: Signal
    begin: Signal
    taken: Signal
    begun: Signal
    between: Signal
    written: Signal
    starting: Signal
    in_frame: Signal

    def count(self, name: str):
        """Return one of the counters."""
        return self.unit.counters.word_select(COUNTER_NAMES.index(name), COUNTER_BITS)


@frozen
class Step:
    """One step of the threshold. now, before: it is controlled in this frame, and in the previous.

    stepped: one step from the threshold in use; controlled: the same, between floor and bounds.
    """

    now: Value
    before: Signal
    stepped: Value
    controlled: Signal


@proof(depth=4, cover=34)
def dpcu(b: Bench):
    """Windows are committed if and only if they meet the threshold; counters balance; the
    controller moves one step in its limits.
    """
    dut = _place_dpcu(b)
    _tree_obeys(b, dut)

    step = _step(b, dut)

    _threshold_decides(b, dut)
    _counters_balance(b, dut)
    _counters_rise_in_a_frame(b, dut)
    _threshold_moves_one_step(b, dut, step)

    _step_is_in_registers(b, dut, step)

    b.cover(dut.unit.commit & (dut.count("threshold_used") == 3) & step.now & step.before)
    b.cover((dut.count("rejected") == 2) & (dut.count("dropped") == 1))


def _place_dpcu(b: Bench) -> PlacedDpcu:
    """Place a DPCU behind the bus of the register front and beside a FIFO.

    Between frames, settings are written. When nothing is on its way, the bus says TAKE, then names
    budgets, limits and bounds, then BEGIN with the floor.
    """
    m = b.m
    unit = Dpcu(SMALL)
    operation = Signal(bus.Operation)
    data = Signal(DATA_BITS)
    in_stream = Signal()
    stored = b.same("kept", b.anything(1))
    b.place(
        unit,
        operation=operation,
        data=data,
        in_stream=in_stream,
        stored=stored & b.past(unit.commit),
        dropped=~stored & b.past(unit.commit),  # as proven for the FIFO
    )
    budget = b.constant(DATA_BITS)
    limit = b.constant(DATA_BITS)
    bounds = [b.constant(DATA_BITS) for _ in range(AUTO_BOUNDS)]
    floor = b.constant(range(THRESHOLD_MAX + 1))
    b.assume(budget <= limit)  # as proven for the controller

    step = Signal(range(WORDS + 2))
    take = b.same("take", b.anything(1) & (step == 0))
    begin = b.same("begin", step == WORDS + 1)
    between = Signal(init=1)
    written = b.same("written", b.anything(1) & between & ~take)
    m.d.sync += between.eq((between | (b.anything(1) & (step == 0))) & ~take)
    m.d.sync += step.eq(Mux(begin, 0, step + ((step != 0) | take)))
    m.d.comb += data.eq(b.anything(DATA_BITS))
    with m.Switch(step):
        with m.Case(0):
            with m.If(take):
                m.d.comb += operation.eq(bus.Operation.TAKE)
            with m.Elif(written):
                m.d.comb += operation.eq(bus.Operation.WRITE)
        with m.Case(WORDS + 1):
            m.d.comb += operation.eq(bus.Operation.BEGIN)
            m.d.comb += data.eq(floor)
        for stream in range(STREAMS):
            for word, (named, value) in enumerate(
                ((bus.Operation.BUDGET, budget), (bus.Operation.LIMIT, limit))
            ):
                with m.Case(1 + 2 * stream + word):
                    m.d.comb += operation.eq(named)
                    m.d.comb += in_stream.eq(stream < 2)
                    if stream == 1:
                        m.d.comb += data.eq(value)
        for k, bound in enumerate(bounds):
            with m.Case(1 + BUDGETS + k):
                m.d.comb += operation.eq(bus.Operation.COMPARE)
                m.d.comb += data.eq(bound)

    taken = Signal()
    begun = Signal()
    m.d.sync += taken.eq(taken | take)
    m.d.sync += begun.eq(begun | begin)
    starting = b.same("starting", take | (step != 0))
    past_start = ~between & ~starting & ~b.past(starting) & ~b.past(starting, 2)
    return PlacedDpcu(
        unit=unit,
        budget=budget,
        limit=limit,
        bounds=bounds,
        floor=floor,
        step=step,
        take=take,
        begin=begin,
        taken=taken,
        begun=begun,
        between=between,
        written=written,
        starting=starting,
        in_frame=b.same("in_frame", past_start),
    )


def _tree_obeys(b: Bench, dut: PlacedDpcu) -> None:
    """Assume what is proven for tree and settings. No window closes while a frame begins.

    The settings change after TAKE, or as they are written if the sensor does not hold them.
    """
    unit = dut.unit
    settings = unit.settings
    closed = unit.closed
    count = unit.window.count
    starting = dut.starting
    b.assume_stable(settings.as_value(), where=~b.past(dut.take | dut.written))
    legal_threshold = (settings.threshold != 0) & (settings.threshold <= SMALL.pixels)
    b.assume(legal_threshold & (settings.window != 0))
    b.assume((count != 0) & (count <= SMALL.pixels))
    quiet = b.same("quiet", ~(closed | b.past(closed) | b.past(closed, 2) | b.past(closed, 3)))
    b.assume(quiet, where=starting | dut.between)
    b.assume(~closed, where=b.past(starting) | b.past(starting, 2) | b.past(starting, 3))


def _step(b: Bench, dut: PlacedDpcu) -> Step:
    """Specify the next threshold, from the previous frame's counters."""
    settings = dut.unit.settings
    committed = dut.count("committed")
    used = dut.count("threshold_used")
    now = settings.auto & settings.coincidence
    before = Signal()
    with b.m.If(dut.begin):
        b.m.d.sync += before.eq(now)
    above = (committed > dut.limit) & (used < THRESHOLD_MAX)
    few_below = dut.count("lower") <= dut.budget
    below = (committed <= dut.limit) & (used > 1) & few_below
    stepped = Mux(above, used + 1, Mux(below, used - 1, used))
    ceiling = 1 + _reached(dut.bounds, dut.count("opened"))
    bounded = b.same("bounded", _least(stepped, ceiling))
    controlled = b.same("controlled", Mux(bounded < dut.floor, dut.floor, bounded))
    return Step(now, before, stepped, controlled)


def _threshold_decides(b: Bench, dut: PlacedDpcu) -> None:
    """State that a window is committed if it meets the threshold, and only then, as it is.

    Without coincidence a window has one tick, and every one is committed.
    """
    unit = dut.unit
    settings = unit.settings
    closed = unit.closed
    count = unit.window.count
    threshold = Mux(settings.coincidence, dut.count("threshold_used"), 1)
    meets = b.past(closed & (count >= threshold))
    b.always(unit.commit == meets, where=b.past(dut.in_frame))
    same_window = unit.event.as_value() == b.last(unit.window.as_value())
    b.always(same_window, where=unit.commit & b.past(1))
    window_ticks = b.last(Mux(settings.coincidence, settings.window, 1))
    b.always(unit.window_ticks == window_ticks, where=b.past(1))
    b.always(unit.threshold == threshold, where=dut.in_frame & b.past(1, 3))
    in_begun_frame = dut.in_frame & dut.begun
    b.always(unit.reduced_threshold + 1 == threshold, where=in_begun_frame)
    meets_lower = b.past(closed & (count + 1 >= threshold))
    b.always(unit.meets_lower == meets_lower, where=b.past(in_begun_frame))


def _counters_balance(b: Bench, dut: PlacedDpcu) -> None:
    """State the balance of the counters. A commit is stored or dropped one cycle later."""
    opened = dut.count("opened")
    committed = dut.count("committed")
    photons = dut.count("photons")
    lower = dut.count("lower")
    under = b.same("under", opened != FULL_OF_CYCLES)
    b.always(opened == committed + dut.count("rejected"), where=under)
    delivered = dut.count("stored") + dut.count("dropped") + b.past(dut.unit.commit)
    b.always(committed == delivered, where=under)
    b.always(photons >= opened, where=under & (photons != FULL))
    b.always((lower >= committed) & (lower <= opened), where=under & dut.begun)


def _counters_rise_in_a_frame(b: Bench, dut: PlacedDpcu) -> None:
    """State that counters only rise, and begin a frame at 0."""
    counters = [dut.count(name) for name in COUNTER_NAMES if name != "threshold_used"]
    for counter in counters:
        before = b.past(counter)
        rises_or_clears = (counter == before) | (counter == 0) | (counter > before)
        b.always(rises_or_clears, where=b.past(1))
    b.always(Cat(counters) == 0, where=b.past(dut.begin))


def _threshold_moves_one_step(b: Bench, dut: PlacedDpcu, step: Step) -> None:
    """State the threshold of a frame, which changes only at its beginning.

    It is one step from the programmed one in the first controlled frame, and later from the
    previous frame's.
    """
    used = dut.count("threshold_used")
    stays_controlled = step.now & step.before
    threshold = Mux(stays_controlled, step.controlled, dut.unit.settings.threshold)
    b.always(used == b.past(threshold), where=b.past(dut.begin))
    b.always((used != 0) & (used <= SMALL.pixels), where=dut.begun)
    b.always(used <= THRESHOLD_MAX, where=b.past(dut.begin & step.now & step.before))
    b.always(used == b.past(used), where=b.past(1) & ~b.past(dut.begin))


def _step_is_in_registers(b: Bench, dut: PlacedDpcu, step: Step) -> None:
    """Help the induction: how far the next threshold is computed after each word on the bus."""
    unit = dut.unit
    word = dut.step
    committed = dut.count("committed")
    opened = dut.count("opened")
    ceiling = unit.ceiling + unit.reached
    b.always(word <= WORDS + 1)
    b.always(dut.begun, where=step.before | (dut.taken & (word == 0)))
    b.always(unit.stepped == _least(step.stepped, THRESHOLD_MAX), where=dut.begun & (word > 6))
    b.always(unit.controlled == step.now)
    b.always(unit.stays == step.before)
    b.always(ceiling == 1, where=(word != 0) & (word <= 1 + BUDGETS))
    for k in range(1, AUTO_BOUNDS + 1):
        reached = _reached(dut.bounds[:k], opened)
        b.always(ceiling == 1 + reached, where=word == 1 + BUDGETS + k)
    b.always(unit.falls == (dut.count("lower") <= dut.budget), where=word > 3)
    b.always(unit.rises == (committed > dut.limit), where=word > 4)


@proof(depth=3, cover=8)
def subgroup_settings(b: Bench):
    """Settings change only at a TAKE, all at once. Only writes to this subgroup program them. A
    read gives the word, of others 0.
    """
    unit = SubgroupRegisters(SMALL)
    number = b.constant(bus.SUBGROUP_BITS)
    _front_obeys(b, unit)
    b.place(unit, subgroup=number)

    _settings_change_at_take(b, unit, number)
    _reads_give_the_word(b, unit, number)
    _nothing_is_upset(b, unit)

    named = unit.command.operation != bus.Operation.IDLE
    other = unit.command.subgroup != number
    b.always(~unit.named.any(), where=b.past(named & other))

    taken = b.past(unit.command.operation == bus.Operation.TAKE)
    b.cover(taken & (unit.settings.threshold == 5))
    b.cover(unit.data == 7)


def _front_obeys(b: Bench, unit: SubgroupRegisters) -> None:
    """Assume what is proven for the register front: it writes only legal values."""
    command = unit.command
    write = command.operation == bus.Operation.WRITE
    b.assume(command.parity == command.data.xor(), where=write)
    for offset, register, _ in registers.words(registers.SUBGROUP, SMALL):
        to_register = write & (command.word == offset // 4)
        b.assume(command.data <= register.high(SMALL), where=to_register)


def _settings_change_at_take(b: Bench, unit: SubgroupRegisters, number) -> None:
    """State that settings come into force together, as the writes to this subgroup made them."""
    command = unit.command
    settings = unit.settings.as_value()
    programmed = unit.programmed.as_value()
    taken = b.past(command.operation == bus.Operation.TAKE)
    b.always(settings == b.last(programmed), where=taken)
    b.stable(settings, where=command.operation != bus.Operation.TAKE)
    no_write = command.operation != bus.Operation.WRITE
    b.stable(programmed, where=no_write | (command.subgroup != number))
    gate_start = unit.programmed.gate_start
    gate_late = unit.programmed.gating & (gate_start >= unit.period)
    b.always(unit.gate_late == b.past(gate_late))


def _reads_give_the_word(b: Bench, unit: SubgroupRegisters, number) -> None:
    """State that a read gives the named word two cycles later, and that of others 0."""
    command = unit.command
    named = command.operation != bus.Operation.IDLE
    b.always(unit.data == 0, where=b.past(named & (command.subgroup != number), 2))
    for word, value in unit.shown.items():
        here = named & (command.subgroup == number) & (command.word == word)
        b.always(unit.data == b.last(value), where=b.past(here, 2))


def _nothing_is_upset(b: Bench, unit: SubgroupRegisters) -> None:
    """State that no parity differs without an upset."""
    b.always(~unit.upset)
    for upset in unit.upsets:
        b.always(~upset)
