# SPDX-License-Identifier: Apache-2.0
"""Proofs of the blocks that keep time: TDC, gate, sequencer.

Each proof names its parts in order: what the inputs may be, the specification, what is proven, and
the invariants that only help the induction.
"""

from amaranth.hdl import Const, Mux, Signal, Value
from attrs import frozen

from ..hdl import bus
from ..hdl.controller import SETTLED
from ..hdl.gating import Gating
from ..hdl.sequencer import LEAD, TO_FINISH, Sequencer
from ..hdl.tdc import START_TO_PHASE, Tdc
from ..model.contract.counts import pause_cycles
from ..model.contract.dither import DITHER_BITS_MAX, GAP_BITS, LFSR_BITS, LFSR_TAPS
from ..model.contract.packet import COUNTS, FORMAT_NAMES
from ..model.contract.parameters import Sensor
from ..model.contract.settings import GATE_BITS, SEARCH_PULSES_MAX
from .proof_bench import Bench, proof
from .sensors import SMALL, SMALL_COUNTS


@proof(depth=START_TO_PHASE, cover=12)
def tdc(b: Bench):
    """A line's stamp is the first set phase of its own root only; the coarse count restarts with
    the laser.
    """
    sensor = Sensor()  # full size: 32 phases, two lines
    unit = b.place(Tdc(sensor))
    line_0 = unit.line_0
    line_1 = unit.line_1
    coarse = Signal(sensor.coarse_bits)
    b.m.d.sync += coarse.eq(Mux(b.past(unit.start, START_TO_PHASE - 1), 0, coarse + 1))
    for line in (line_0, line_1):
        before = b.past(line.root)
        b.always(line.any == before.any())
        b.always(before.bit_select(line.phase, 1), where=before)
        for k in range(sensor.phases):
            b.always(~before[:k].any(), where=line.any & (line.phase == k))
        b.always(line.coarse == coarse)
    b.cover(line_0.any & ~line_1.any & (line_0.phase == 31))
    both = line_0.any & line_1.any
    b.cover(both & (line_0.phase == 5) & (line_1.phase == 7) & (line_0.coarse == 3))


@frozen
class Gate:
    """Where a period is, and the gate in it.

    cycle: of the period; shift: of the gate, one cycle later; opens: the gate's first cycle;
    inside: the gate is open; passes: edges count.
    """

    cycle: Signal
    shift: Signal
    opens: Signal
    inside: Signal
    passes: Signal


@proof(depth=3, cover=24)
def gating(b: Bench):
    """Edges pass if and only if a frame runs and the gate is open (or off); the SPADs are on in the
    same cycles.
    """
    unit = b.place(Gating(SMALL))
    settings = unit.settings
    running = unit.timing.running
    gate = _gate(b, unit)
    _periods_are_legal(b, unit, gate)

    b.always(unit.accept == b.past(gate.passes, 3))
    on = b.past(gate.inside, 2) | ~b.past(settings.gating)
    b.always(unit.spad_gate == on, where=b.past(1, 2))
    b.always(~b.past(gate.inside, 2), where=~unit.spad_gate)

    _gate_is_in_registers(b, unit, gate)

    b.cover(
        settings.gating
        & unit.accept
        & (b.past(gate.cycle, 3) == 3)
        & (settings.gate_start == 1)
        & (gate.shift == 2)
    )
    b.cover(settings.gating & running & ~unit.accept & b.past(unit.accept))


def _gate(b: Bench, unit: Gating) -> Gate:
    """Specify the gate: it opens `gate_start` and the shift after the period's beginning."""
    timing = unit.timing
    settings = unit.settings
    cycle = Signal(SMALL.coarse_bits + 1)
    shift = Signal(SMALL.coarse_bits + 1)
    cycle_now = b.same("cycle_now", Mux(timing.start, 0, cycle + 1))
    shift_now = b.same("shift_now", Mux(timing.start, timing.shift, shift))
    b.m.d.sync += cycle.eq(cycle_now)
    b.m.d.sync += shift.eq(shift_now)
    opens = b.same("opens", settings.gate_start + shift_now)
    before_end = cycle_now < opens + settings.gate_len
    inside = b.same("inside", timing.running & (cycle_now >= opens) & before_end)
    passes = b.same("passes", timing.running & (inside | ~settings.gating))
    return Gate(cycle_now, shift, opens, inside, passes)


def _periods_are_legal(b: Bench, unit: Gating, gate: Gate) -> None:
    """Assume what is proven for sequencer and register front.

    A frame begins with a period; a period has at most 2^coarse_bits cycles; settings stay and have
    passed the checks.
    """
    timing = unit.timing
    settings = unit.settings
    running = timing.running
    highest = (1 << SMALL.coarse_bits) - 1
    b.assume(timing.start, where=running & ~b.past(running))
    b.assume(running, where=timing.start)
    b.assume((gate.cycle <= highest) & (timing.shift <= highest + 1), where=running)
    b.assume_stable(settings.as_value(), where=b.past(running) | b.past(running, 2))
    b.assume(settings.gate_start <= highest, where=settings.gating)


def _gate_is_in_registers(b: Bench, unit: Gating, gate: Gate) -> None:
    """Help the induction: registers hold the cycles until the gate opens, and until it closes."""
    settings = unit.settings
    running = unit.timing.running
    cycle = b.past(gate.cycle)
    opens = b.past(gate.opens)
    since = b.same("since", Mux(cycle > opens, cycle - opens, 0))
    left = Mux(settings.gate_len > since, settings.gate_len - since, 0)
    here = b.past(running) & settings.gating
    b.always(unit.until_now == Mux(opens > cycle, opens - cycle, 0), where=here)
    b.always(unit.left_now == left, where=here)
    b.always(unit.running == (b.past(running) | b.past(running, 2) << 1))
    b.always(unit.start == b.past(unit.timing.start))


@frozen
class Periods:
    """The periods as the contract counts them, one cycle behind the sequencer's own counters.

    `timing` of the sequencer is as late. since: cycles since the period began; number: of the
    period; in_period: one runs; gap: cycles of a gap that are left, out of gap_length; wait: cycles
    of dither's wait that are left, also while it is in the gap; alive: any of the three; last: a
    period's last cycle; over: the cycle after it; cut: the cycle after an abort in a gap; aborting: no period
    follows this one; lfsr: draws the waits; exact: the gate's shift, without a limit; pulses,
    steps: where progressive gating is.
    """

    since: Signal
    number: Signal
    in_period: Signal
    gap: Signal
    gap_length: Signal
    wait: Signal
    alive: Signal
    last: Signal
    over: Signal
    cut: Signal
    aborting: Signal
    lfsr: Signal
    exact: Signal
    pulses: Signal
    steps: Signal


@proof(depth=6, cover=40)
def sequencer(b: Bench):
    """A frame has `pulses` periods of `period` cycles with gaps and dither's waits, or ends with
    the aborted one or in the aborted gap; windows obey the guard.

    No window opens in the guard, in a gap or in a wait.
    """
    unit = _sequencer(b, SMALL)
    b.cover(unit.timing.may_open)


@proof(depth=6, cover=40)
def sequencer_with_counts(b: Bench):
    """The same of a sensor with counts; in a frame of counts, the gap after steps 1 and 2 is at
    least the pause of the search, which is told once, and no window opens.
    """
    unit = _sequencer(b, SMALL_COUNTS)
    b.cover(unit.timing.search & (unit.search_step == bus.Step.WIDE))
    b.cover(unit.timing.may_open)


def _sequencer(b: Bench, sensor: Sensor) -> Sequencer:
    """Prove the sequencer of a sensor, and return it."""
    unit = b.place(Sequencer(sensor))
    busy = _front_obeys(b, unit)

    periods = _periods(b, unit)

    _strobes_are_in_their_cycles(b, unit, periods)
    _gate_moves_by_the_exact_shift(b, unit, periods)
    ending = _frame_is_done_once(b, unit, periods)

    _one_frame_at_a_time(b, unit, periods, busy, ending)
    _periods_are_in_registers(b, unit, periods)
    if sensor.counts:
        _steps_are_in_registers(b, unit)
    _end_is_in_registers(b, unit, ending)

    plan = unit.plan
    timing = unit.timing
    gap = periods.gap
    wait = periods.wait
    starts_after_wait = timing.start & b.past(wait == 1) & b.past(wait == 3, 3)
    starts_after_gap = timing.start & b.past(gap == 1) & b.past(gap == 3, 3)
    starts_after_both = timing.start & b.past(wait == 1) & b.past(gap == 1, 2)
    was_cut = Signal()
    b.m.d.sync += was_cut.eq(was_cut | periods.cut)
    b.cover(unit.done & (plan.pulses == 2) & (unit.number == 1))
    b.cover(unit.done & (plan.pulses == 9))
    b.cover(timing.start & (timing.shift == 3))
    b.cover(starts_after_wait & (periods.number == 2))
    b.cover(starts_after_gap & (periods.number == 1))
    b.cover(starts_after_both)
    b.cover(unit.done & was_cut & (unit.pulse == 1))
    return unit


def _front_obeys(b: Bench, unit: Sequencer) -> Signal:
    """Assume what is proven for the register front; return whether a frame has been started.

    A start comes only after the previous frame is done. The plan stays, and has passed the checks.
    """
    plan = unit.plan
    start = unit.start_frame
    busy = Signal()
    b.m.d.sync += busy.eq(Mux(start, 1, busy & ~unit.done))
    b.assume(~busy, where=start)
    b.assume_stable(plan.as_value(), where=busy)
    legal_period = (plan.period > SMALL.guard) & (plan.period <= SMALL.period_max)
    b.assume(legal_period & (plan.pulses != 0) & (plan.pulses <= 1 << 16))
    b.assume((plan.gate_steps != 0) & (plan.dither_bits <= DITHER_BITS_MAX))
    if unit.sensor.counts:
        b.assume((plan.search_pulses != 0) & (plan.search_pulses <= SEARCH_PULSES_MAX))
    return busy


def _ends_step(unit: Sequencer, begun: Value) -> list[Value]:
    """Return whether the last one of so many periods ends step 1, and whether it ends step 2."""
    plan = unit.plan
    if not unit.sensor.counts:
        return [Const(0), Const(0)]
    counting = plan.format == FORMAT_NAMES.index(COUNTS.name)
    return [counting & (begun == k * plan.search_pulses) for k in (1, 2)]


def _gap_after(unit: Sequencer, begun: Value) -> Value:
    """Return the cycles of the gap after so many periods: the longer one of gap and pause."""
    gap: Value = unit.plan.gap
    pauses = pause_cycles(unit.sensor.minigroups)
    for ends, pause in zip(_ends_step(unit, begun), pauses, strict=True):
        gap = Mux(ends & (gap < pause), pause, gap)
    return gap


def _periods(b: Bench, unit: Sequencer) -> Periods:
    """Specify periods, waits and shifts of a frame."""
    m = b.m
    plan = unit.plan
    begins = b.past(unit.start_frame, 3)
    since = Signal(SMALL.coarse_bits + 1)
    number = Signal(bus.PULSE_BITS + 1)
    in_period = Signal()
    over = Signal()
    cut = Signal()
    aborting = Signal()
    lfsr = Signal(LFSR_BITS)
    gap = Signal(GAP_BITS)
    gap_length = Signal(GAP_BITS)
    wait = Signal(DITHER_BITS_MAX)

    gap_after = b.same("gap_after", _gap_after(unit, number + 1))
    last = b.same("last", in_period & (since == plan.period - 1))
    more = b.same("more", (number != plan.pulses - 1) & ~aborting)
    stepped = b.same("stepped", (lfsr >> 1) ^ Mux(lfsr[0], LFSR_TAPS, 0))
    chosen = b.same("chosen", stepped & ((1 << plan.dither_bits) - 1))
    in_gap = b.same("in_gap", gap != 0)
    alive = b.same("alive", in_period | in_gap | (wait != 0))
    aborted_now = b.past(unit.abort_frame)

    m.d.sync += since.eq(Mux(last | ~in_period | begins, 0, since + 1))
    with m.If(begins):
        m.d.sync += in_period.eq(1)
        m.d.sync += number.eq(0)
        m.d.sync += lfsr.eq(plan.dither_seed)
        m.d.sync += gap.eq(0)
        m.d.sync += wait.eq(0)
    with m.Elif(last):
        m.d.sync += number.eq(number + 1)
        m.d.sync += in_period.eq(more & (gap_after == 0) & (chosen == 0))
        m.d.sync += gap.eq(Mux(more, gap_after, 0))
        m.d.sync += gap_length.eq(gap_after)
        m.d.sync += wait.eq(Mux(more, chosen, 0))
        m.d.sync += lfsr.eq(stepped)
    with m.Elif(in_gap & aborted_now):
        m.d.sync += gap.eq(0)
        m.d.sync += wait.eq(0)
    with m.Elif(in_gap):
        m.d.sync += gap.eq(gap - 1)
        m.d.sync += in_period.eq((gap == 1) & (wait == 0))
    with m.Elif(wait != 0):
        m.d.sync += wait.eq(wait - 1)
        m.d.sync += in_period.eq(wait == 1)
    with m.Elif(in_period):
        m.d.sync += lfsr.eq(stepped)
    takes_abort = unit.abort_frame & unit.running
    m.d.sync += aborting.eq(Mux(b.past(unit.start_frame, 2), 0, aborting | takes_abort))
    m.d.sync += over.eq(last)
    m.d.sync += cut.eq(in_gap & aborted_now)

    exact = Signal(2 * GATE_BITS)
    pulses = Signal(GATE_BITS)
    steps = Signal(GATE_BITS)
    with m.If(begins):
        m.d.sync += exact.eq(0)
        m.d.sync += pulses.eq(0)
        m.d.sync += steps.eq(0)
    with m.Elif(last):
        m.d.sync += pulses.eq(pulses + 1)
        with m.If(pulses == plan.gate_every - 1):
            m.d.sync += pulses.eq(0)
            m.d.sync += steps.eq(steps + 1)
            m.d.sync += exact.eq(exact + plan.gate_step)
            with m.If(steps == plan.gate_steps - 1):
                m.d.sync += steps.eq(0)
                m.d.sync += exact.eq(0)
    return Periods(
        since=since,
        number=number,
        in_period=in_period,
        gap=gap,
        gap_length=gap_length,
        wait=wait,
        alive=alive,
        last=last,
        over=over,
        cut=cut,
        aborting=aborting,
        lfsr=lfsr,
        exact=exact,
        pulses=pulses,
        steps=steps,
    )


def _strobes_are_in_their_cycles(b: Bench, unit: Sequencer, periods: Periods) -> None:
    """State when a period starts, ends, and lets windows open, and when the laser fires."""
    timing = unit.timing
    in_period = periods.in_period
    since = periods.since
    before_guard = since < unit.plan.period - SMALL.guard
    begin = b.same("begin", b.past(unit.start_frame, 4))
    b.always(timing.running == in_period)
    b.always(timing.start == (in_period & (since == 0)))
    b.always(timing.start, where=begin)
    b.always(timing.wrap == periods.over)
    may_open = in_period & before_guard
    if unit.sensor.counts:
        may_open &= unit.plan.format != FORMAT_NAMES.index(COUNTS.name)
        one, other = _ends_step(unit, periods.number)
        b.always(timing.search == (periods.over & (one | other)))
    b.always(timing.may_open == may_open)
    b.always(unit.laser == b.past(timing.start, LEAD))
    b.always(periods.number < unit.plan.pulses, where=periods.alive)


def _gate_moves_by_the_exact_shift(b: Bench, unit: Sequencer, periods: Periods) -> None:
    """State the shift of progressive gating: the exact one, saturated where no gate can open."""
    most = 1 << SMALL.coarse_bits
    shift = Mux(periods.exact > most, most, periods.exact)
    b.always(unit.timing.shift == shift, where=periods.alive)


def _frame_is_done_once(b: Bench, unit: Sequencer, periods: Periods) -> Signal:
    """State when a frame is done: `SETTLED` cycles after all streams have delivered.

    The next frame has the next number. Return whether the frame is ending.
    """
    ending = Signal()
    settled = Signal(range(SETTLED + 1))
    periods_end = (periods.over | periods.cut) & ~periods.alive
    b.m.d.sync += ending.eq(Mux(periods_end, 1, ending & ~unit.done))
    b.m.d.sync += settled.eq(Mux(unit.delivered, settled + (settled != SETTLED), 0))
    b.always(ending & b.past(settled == SETTLED), where=unit.done)
    for k in range(SETTLED):
        b.always(unit.delivered_for[k] == (settled > k))
    b.always(~periods.alive, where=unit.finish | unit.done)
    next_number = (b.past(unit.number) + unit.done)[: bus.PULSE_BITS]
    b.always(unit.number == next_number, where=b.past(1))
    return ending


def _one_frame_at_a_time(
    b: Bench, unit: Sequencer, periods: Periods, busy: Signal, ending: Signal
) -> None:
    """Help the induction: whatever goes on belongs to the frame that was started."""
    in_frame = (
        unit.running
        | unit.start.any()
        | b.past(unit.start_frame)
        | unit.draining
        | periods.alive
        | unit.done
        | ending
    )
    b.always(busy, where=in_frame & ~unit.done | unit.finish)


def _periods_are_in_registers(b: Bench, unit: Sequencer, periods: Periods) -> None:
    """Help the induction: the sequencer's registers are one cycle ahead of its outputs."""
    plan = unit.plan
    alive = periods.alive
    gap = periods.gap
    wait = periods.wait
    pulses = periods.pulses
    steps = periods.steps
    in_step = periods.in_period & (periods.since != 0)
    b.always(b.past(unit.running) == alive)
    between = (gap != 0) | (wait != 0)
    b.always(~periods.in_period, where=between)
    b.always(periods.since == 0, where=between)
    b.always(b.past(unit.in_gap) == (gap != 0), where=alive)
    b.always(b.past(unit.left) == wait, where=alive)
    b.always(unit.waiting == (unit.in_gap | (unit.left != 0)))
    has_gap = b.past(unit.has_gap)
    b.always(has_gap == (_gap_after(unit, periods.number + 1) != 0), where=periods.last)
    begun = Mux(gap == 0, 0, periods.gap_length - gap + 1)
    b.always(b.past(unit.waited) == begun[:GAP_BITS], where=alive)
    b.always(gap <= periods.gap_length, where=alive)
    b.always(periods.gap_length == _gap_after(unit, periods.number), where=gap != 0)
    b.always(b.past(unit.gap_over) == (gap == 1), where=gap != 0)
    b.always(b.past(unit.lfsr) == periods.lfsr, where=alive)
    b.always(unit.mask == b.past((1 << plan.dither_bits) - 1), where=b.past(1))
    b.always((b.past(unit.pulses) == pulses) & (b.past(unit.steps) == steps), where=alive)
    is_step = (plan.gate_every != 0) & (pulses == plan.gate_every - 1)
    b.always(b.past(unit.step) == is_step, where=in_step)
    b.always(b.past(unit.last_step) == (steps == plan.gate_steps - 1), where=in_step)
    exact_max = (steps << GATE_BITS) - steps
    b.always((steps < plan.gate_steps) & (periods.exact <= exact_max), where=alive)
    b.always(unit.aborted == periods.aborting)
    b.always(b.past(unit.cycle) == periods.since, where=alive)
    b.always(b.past(unit.pulse) == periods.number, where=alive)


def _steps_are_in_registers(b: Bench, unit: Sequencer) -> None:
    """Help the induction: registers hold the step, and how many of its periods have begun.

    They change one cycle after a period has begun; what follows from them is two cycles later.
    """
    plan = unit.plan
    in_period = unit.running & ~unit.waiting & (unit.cycle != 0)
    begun = b.same("periods_begun", unit.pulse + in_period)
    sought = plan.search_pulses
    is_counts = plan.format == FORMAT_NAMES.index(COUNTS.name)
    b.always(unit.counting == b.past(is_counts), where=b.past(1))
    past_first = is_counts & (begun > sought)
    past_second = is_counts & (begun > 2 * sought)
    step = Mux(past_second, bus.Step.GATED, Mux(past_first, bus.Step.NARROW, bus.Step.WIDE))
    periods = begun - Mux(past_second, 2 * sought, Mux(past_first, sought, 0))
    b.always(unit.search_step.as_value() == step, where=unit.running)
    b.always(unit.step_pulses == periods[: bus.PULSE_BITS], where=unit.running)
    one, other = _ends_step(unit, begun)
    settled = unit.running & ~unit.restart & (~in_period | (unit.cycle > 1))
    b.always(unit.step_ends == (one | other), where=settled & b.past(unit.running, 2))


def _end_is_in_registers(b: Bench, unit: Sequencer, ending: Signal) -> None:
    """Help the induction: what the sequencer holds while a frame's results leave."""
    b.always(ending == b.past(unit.draining))
    b.always(unit.draining == (unit.drained != 0))
    cut = b.past(unit.running & unit.in_gap & unit.abort_frame)
    active = unit.running | unit.wrap | cut | unit.draining
    b.always(unit.active == active, where=~unit.running | ~unit.wrap)
    b.always(unit.active, where=unit.running)
    b.always(unit.number_voted.agree)
    b.always(unit.finish == (unit.drained == TO_FINISH))
    b.always(unit.drained <= TO_FINISH)
    b.always(~unit.running & ~unit.start.any(), where=unit.draining)
