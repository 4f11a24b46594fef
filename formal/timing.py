# SPDX-License-Identifier: Apache-2.0
"""Proofs of the blocks that keep time: TDC, gate, sequencer."""

from amaranth.hdl import Mux, Signal

from ..hdl import bus
from ..hdl.controller import SETTLED
from ..hdl.gating import Gating
from ..hdl.sequencer import LEAD, TO_FINISH, Sequencer
from ..hdl.tdc import START_TO_PHASE, Tdc
from ..model.contract.dither import DITHER_BITS_MAX, LFSR_BITS, LFSR_TAPS
from ..model.contract.parameters import Sensor
from ..model.contract.settings import GATE_BITS
from .proof_bench import Bench, proof
from .sensors import SMALL


@proof(depth=START_TO_PHASE, cover=12)
def tdc(b: Bench):
    """A line's stamp is the first set phase of its own root only; the coarse count restarts with the laser."""
    sensor, m = Sensor(), b.m  # full size: 32 phases, two lines
    unit = b.place(Tdc(sensor))
    coarse = Signal(sensor.coarse_bits)
    m.d.sync += coarse.eq(Mux(b.past(unit.start, START_TO_PHASE - 1), 0, coarse + 1))
    lines = [unit.line_0, unit.line_1]
    for line in lines:
        before = b.past(line.root)
        b.always(line.any == before.any())
        b.always(before.bit_select(line.phase, 1), where=before)
        for k in range(sensor.phases):
            b.always(~before[:k].any(), where=line.any & (line.phase == k))
        b.always(line.coarse == coarse)
    b.cover(lines[0].any & ~lines[1].any & (lines[0].phase == 31))
    b.cover(
        lines[0].any
        & lines[1].any
        & (lines[0].phase == 5)
        & (lines[1].phase == 7)
        & (lines[0].coarse == 3)
    )


@proof(depth=3, cover=24)
def gating(b: Bench):
    """Edges pass if and only if a frame runs and the gate is open (or off); the SPADs are on in the same cycles."""
    sensor, m = SMALL, b.m
    unit = b.place(Gating(sensor))
    timing, settings = unit.timing, unit.settings
    highest = (1 << sensor.coarse_bits) - 1

    # A frame begins with a period; a period has at most 2^coarse_bits cycles; settings stay and have passed the checks.
    cycle, shift = Signal(sensor.coarse_bits + 1), Signal(sensor.coarse_bits + 1)
    cycle_now = b.same("cycle_now", Mux(timing.start, 0, cycle + 1))
    shift_now = b.same("shift_now", Mux(timing.start, timing.shift, shift))
    m.d.sync += [cycle.eq(cycle_now), shift.eq(shift_now)]
    running = timing.running
    b.assume(timing.start, where=running & ~b.past(running))
    b.assume(running, where=timing.start)
    b.assume((cycle_now <= highest) & (timing.shift <= highest + 1), where=running)
    b.assume_stable(settings.as_value(), where=b.past(running) | b.past(running, 2))
    b.assume(settings.gate_start <= highest, where=settings.gating)

    opens = b.same("opens", settings.gate_start + shift_now)
    inside = b.same(
        "inside", running & (cycle_now >= opens) & (cycle_now < opens + settings.gate_len)
    )
    passes = b.same("passes", running & (inside | ~settings.gating))
    b.always(unit.accept == b.past(passes, 3))
    b.always(unit.spad_gate == b.past(inside, 2) | ~b.past(settings.gating), where=b.past(1, 2))
    b.always(~b.past(inside, 2), where=~unit.spad_gate)
    # Invariants: the cycles until the gate opens, and until it closes.
    c, f = b.past(cycle_now), b.past(opens)
    since = b.same("since", Mux(c > f, c - f, 0))
    here = b.past(running) & settings.gating
    b.always(unit.until_now == Mux(f > c, f - c, 0), where=here)
    b.always(
        unit.left_now == Mux(settings.gate_len > since, settings.gate_len - since, 0), where=here
    )
    b.always(unit.running == (b.past(running) | b.past(running, 2) << 1))
    b.always(unit.start == b.past(timing.start))
    b.cover(
        settings.gating
        & unit.accept
        & (b.past(cycle_now, 3) == 3)
        & (settings.gate_start == 1)
        & (shift == 2)
    )
    b.cover(settings.gating & running & ~unit.accept & b.past(unit.accept))


@proof(depth=6, cover=40)
def sequencer(b: Bench):
    """A frame has `pulses` periods of `period` cycles with dither waits, or ends with the aborted one; windows obey the guard.

    No window opens in the guard or in a wait.
    """
    sensor, m = SMALL, b.m
    unit = b.place(Sequencer(sensor))
    plan, start, abort, delivered = unit.plan, unit.start_frame, unit.abort_frame, unit.delivered

    # A start comes only after the previous frame is done. The plan stays, and has passed the start checks.
    busy = Signal()
    m.d.sync += busy.eq(Mux(start, 1, busy & ~unit.done))
    b.assume(~busy, where=start)
    b.assume_stable(plan.as_value(), where=busy)
    b.assume(
        (plan.period > sensor.guard)
        & (plan.period <= sensor.period_max)
        & (plan.pulses != 0)
        & (plan.pulses <= 1 << 16)
    )
    b.assume((plan.gate_steps != 0) & (plan.dither_bits <= DITHER_BITS_MAX))

    # The periods as the contract counts them, one cycle behind the sequencer's own counters, like `timing`.
    since, period, frame = Signal(sensor.coarse_bits + 1), Signal(bus.PULSE_BITS + 1), Signal()
    over, aborting = Signal(), Signal()
    timing = unit.timing
    begin = b.same("begin", b.past(start, 4))
    last = b.same("last", frame & (since == plan.period - 1))
    more = b.same("more", (period != plan.pulses - 1) & ~aborting)
    lfsr, waits = Signal(LFSR_BITS), Signal(DITHER_BITS_MAX)
    stepped = b.same("stepped", (lfsr >> 1) ^ Mux(lfsr[0], LFSR_TAPS, 0))
    chosen = b.same("chosen", stepped & ((1 << plan.dither_bits) - 1))
    alive = b.same("alive", frame | (waits != 0))
    m.d.sync += since.eq(Mux(last | (waits != 0) | b.past(start, 3), 0, since + 1))
    with m.If(b.past(start, 3)):
        m.d.sync += [frame.eq(1), period.eq(0), lfsr.eq(plan.dither_seed), waits.eq(0)]
    with m.Elif(last):
        m.d.sync += [
            period.eq(period + 1),
            frame.eq(more & (chosen == 0)),
            waits.eq(Mux(more, chosen, 0)),
            lfsr.eq(stepped),
        ]
    with m.Elif(waits != 0):
        m.d.sync += [waits.eq(waits - 1), frame.eq(waits == 1)]
    with m.Elif(frame):
        m.d.sync += lfsr.eq(stepped)
    m.d.sync += aborting.eq(Mux(b.past(start, 2), 0, aborting | (abort & unit.running)))
    m.d.sync += over.eq(last)
    b.always(timing.running == frame)
    b.always(timing.start == (frame & (since == 0)))
    b.always(timing.start, where=begin)
    b.always(timing.wrap == over)
    b.always(timing.may_open == (frame & (since < plan.period - sensor.guard)))
    b.always(unit.laser == b.past(timing.start, LEAD))
    b.always(period < plan.pulses, where=alive)

    # Progressive gating: the exact shift, saturated where no gate can open.
    exact, pulses, steps = Signal(2 * GATE_BITS), Signal(GATE_BITS), Signal(GATE_BITS)
    with m.If(b.past(start, 3)):
        m.d.sync += [exact.eq(0), pulses.eq(0), steps.eq(0)]
    with m.Elif(last):
        m.d.sync += pulses.eq(pulses + 1)
        with m.If(pulses == plan.gate_every - 1):
            m.d.sync += [pulses.eq(0), steps.eq(steps + 1), exact.eq(exact + plan.gate_step)]
            with m.If(steps == plan.gate_steps - 1):
                m.d.sync += [steps.eq(0), exact.eq(0)]
    most = 1 << sensor.coarse_bits
    b.always(timing.shift == Mux(exact > most, most, exact), where=alive)

    # The end: the frame is done once, `SETTLED` cycles after all streams have delivered; the next one has the next number.
    ending, settled = Signal(), Signal(range(SETTLED + 1))
    m.d.sync += [
        ending.eq(Mux(over & ~alive, 1, ending & ~unit.done)),
        settled.eq(Mux(delivered, settled + (settled != SETTLED), 0)),
    ]
    b.always(ending & b.past(settled == SETTLED), where=unit.done)
    for k in range(SETTLED):
        b.always(unit.delivered_for[k] == (settled > k))
    b.always(~alive, where=unit.finish | unit.done)
    b.always(unit.number == (b.past(unit.number) + unit.done)[: bus.PULSE_BITS], where=b.past(1))

    # Invariants: the sequencer's registers are one cycle ahead of its outputs.
    one_frame = (
        unit.running | unit.start.any() | b.past(start) | unit.draining | alive | unit.done | ending
    )
    b.always(busy, where=one_frame & ~unit.done | unit.finish)
    b.always(b.past(unit.running) == alive)
    b.always(~frame, where=waits != 0)
    b.always(since == 0, where=waits != 0)
    b.always(b.past(unit.left) == waits, where=alive)
    b.always(unit.waiting == (unit.left != 0))
    b.always(b.past(unit.lfsr) == lfsr, where=alive)
    b.always(unit.mask == b.past((1 << plan.dither_bits) - 1), where=b.past(1))
    b.always((b.past(unit.pulses) == pulses) & (b.past(unit.steps) == steps), where=alive)
    b.always(
        b.past(unit.step) == ((plan.gate_every != 0) & (pulses == plan.gate_every - 1)),
        where=frame & (since != 0),
    )
    b.always(b.past(unit.last_step) == (steps == plan.gate_steps - 1), where=frame & (since != 0))
    b.always((steps < plan.gate_steps) & (exact <= (steps << GATE_BITS) - steps), where=alive)
    b.always(unit.aborted == aborting)
    b.always(ending == b.past(unit.draining))
    b.always(unit.draining == (unit.drained != 0))
    b.always(
        unit.active == (unit.running | unit.wrap | unit.draining), where=~unit.running | ~unit.wrap
    )
    b.always(unit.active, where=unit.running)
    b.always(unit.number_voted.agree)
    b.always(unit.finish == (unit.drained == TO_FINISH))
    b.always(unit.drained <= TO_FINISH)
    b.always(~unit.running & ~unit.start.any(), where=unit.draining)
    b.always(b.past(unit.cycle) == since, where=alive)
    b.always(b.past(unit.pulse) == period, where=alive)
    b.cover(unit.done & (plan.pulses == 2) & (unit.number == 1))
    b.cover(unit.done & (plan.pulses == 9))
    b.cover(timing.start & (timing.shift == 3))
    b.cover(timing.start & b.past(waits == 1) & b.past(waits == 3, 3) & (period == 2))
