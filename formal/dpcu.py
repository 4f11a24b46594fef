"""Proofs of the DPCU and of a subgroup's settings."""

from amaranth.hdl import Cat, Mux, Signal

from ..hdl import bus
from ..hdl.dpcu import Dpcu
from ..hdl.settings import SubgroupSettings
from ..model.contract.registers import AUTO_BOUNDS, COUNTER_BITS, COUNTER_NAMES, DATA_BITS
from .bench import Bench, proof
from .sensors import SMALL

FULL = (1 << COUNTER_BITS) - 1  # counters saturate


def _reached(bounds, photons):
    """How many bounds the photons reach."""
    return sum((bound <= photons for bound in bounds), start=0)


@proof(depth=4, cover=16)
def dpcu(b: Bench):
    """Windows are committed exactly where the count meets the threshold; counters balance; the controller follows its bounds."""
    sensor, m = SMALL, b.m
    unit = Dpcu(sensor)
    settings, operation, bound = Signal(bus.settings_layout(sensor)), Signal(bus.Operation), Signal(DATA_BITS)
    closed, window, stored = Signal(), Signal(bus.window_layout(sensor)), Signal()
    m.d.comb += [signal.as_value().eq(b.anything(signal.shape().size)) for signal in (settings, window)]
    m.d.comb += [signal.eq(b.anything(len(signal))) for signal in (closed, stored)]
    body = b.place(
        "dut",
        unit,
        settings=settings,
        operation=operation,
        bound=bound,
        closed=closed,
        window=window,
        stored=stored & b.past(unit.commit),
        dropped=~stored & b.past(unit.commit),  # as proven of the FIFO
    )
    count = {name: unit.counters.word_select(i, COUNTER_BITS) for i, name in enumerate(COUNTER_NAMES)}

    # The bus says TAKE, then names the bounds, then BEGIN, between frames: when nothing is on its way.
    bounds = [b.constant(DATA_BITS) for _ in range(AUTO_BOUNDS)]
    step = Signal(range(AUTO_BOUNDS + 2))  # 0: idle or TAKE; k: bound k - 1; the last: BEGIN
    take = b.same("take", b.anything(1) & (step == 0))
    m.d.sync += step.eq(Mux(step == AUTO_BOUNDS + 1, 0, step + ((step != 0) | take)))
    m.d.comb += bound.eq(b.anything(DATA_BITS))
    with m.Switch(step):
        with m.Case(0):
            m.d.comb += operation.eq(Mux(take, bus.Operation.TAKE, bus.Operation.IDLE))
        with m.Case(AUTO_BOUNDS + 1):
            m.d.comb += operation.eq(bus.Operation.BEGIN)
        for k in range(AUTO_BOUNDS):
            with m.Case(k + 1):
                m.d.comb += [operation.eq(bus.Operation.COMPARE), bound.eq(bounds[k])]
    starting = b.same("starting", take | (step != 0))
    quiet = b.same("quiet", ~(closed | b.past(closed) | b.past(closed, 2) | b.past(closed, 3)))
    b.assume(quiet, where=starting)
    b.assume_stable(settings.as_value(), where=~b.past(take))
    b.assume((settings.threshold != 0) & (settings.window != 0))
    b.assume((window.count != 0) & (window.count <= sensor.pixels))  # as proven of the tree

    # The judgement.
    threshold = Mux(settings.coincidence, count["threshold_used"], 1)
    in_frame = b.same("in_frame", ~starting & ~b.past(starting) & ~b.past(starting, 2))
    b.always(unit.commit == b.past(closed & (window.count >= threshold)), where=b.past(in_frame))
    b.always(unit.event.as_value() == b.last(window.as_value()), where=b.past(closed))
    b.always(unit.window_ticks == b.last(Mux(settings.coincidence, settings.window, 1)), where=b.past(1))
    b.always(body.threshold == threshold, where=in_frame & b.past(1, 3))

    # The balance. A commit is stored or dropped a cycle later.
    under = b.same("under", count["opened"] != FULL)
    b.always(count["opened"] == count["committed"] + count["rejected"], where=under)
    b.always(count["committed"] == count["stored"] + count["dropped"] + b.past(unit.commit), where=under)
    b.always(count["photons"] >= count["opened"], where=under & (count["photons"] != FULL))
    for name in COUNTER_NAMES[:-1]:
        b.always(
            (count[name] == b.past(count[name])) | (count[name] == 0) | (count[name] > b.past(count[name])),
            where=b.past(1),
        )

    # The controller.
    frames = Signal()
    m.d.sync += frames.eq(frames | (step == AUTO_BOUNDS + 1))
    photons = b.past(count["photons"])
    programmed = b.last(settings.threshold)
    expected = Mux(b.last(settings.auto) & b.past(frames), 1 + _reached(bounds, photons), programmed)
    b.always(count["threshold_used"] == expected, where=b.past(step == AUTO_BOUNDS + 1))
    b.always(Cat(list(count.values())[:-1]) == 0, where=b.past(step == AUTO_BOUNDS + 1))
    b.always(
        count["threshold_used"] == b.past(count["threshold_used"]), where=b.past(1) & ~b.past(step == AUTO_BOUNDS + 1)
    )
    for k in range(AUTO_BOUNDS):
        b.always(body.steps == _reached(bounds[:k], count["photons"]), where=step == k + 1)
    b.always(body.steps == _reached(bounds, count["photons"]), where=step == AUTO_BOUNDS + 1)
    b.always(body.frame_before == frames)
    b.cover(unit.commit & (count["threshold_used"] == 3) & settings.auto)
    b.cover((count["rejected"] == 2) & (count["dropped"] == 1))


@proof(depth=1, cover=2)
def controller_is_monotone(b: Bench):
    """More photons in a frame never lower the next one's threshold: as proven of the DPCU it is 1 + the number of bounds reached."""
    bounds = [b.constant(DATA_BITS) for _ in range(AUTO_BOUNDS)]
    fewer, more = b.constant(COUNTER_BITS), b.constant(COUNTER_BITS)
    b.always(_reached(bounds, fewer) <= _reached(bounds, more), where=fewer <= more)
    b.cover((fewer < more) & (_reached(bounds, fewer) < _reached(bounds, more)))


@proof(depth=3, cover=8)
def subgroup_settings(b: Bench):
    """Settings change only at a TAKE, all at once; only a write to this subgroup programs them; others' reads give 0."""
    sensor, m = SMALL, b.m
    unit = SubgroupSettings(sensor)
    command, number = Signal(bus.CONFIG_BUS), b.constant(bus.SUBGROUP_BITS)
    m.d.comb += command.as_value().eq(b.anything(command.shape().size))
    body = b.place("dut", unit, command=command, subgroup=number)
    taken = b.past(command.operation == bus.Operation.TAKE)
    b.always(unit.settings.as_value() == b.last(body.programmed.as_value()), where=taken)
    b.stable(unit.settings.as_value(), where=command.operation != bus.Operation.TAKE)
    b.stable(
        body.programmed.as_value(), where=(command.operation != bus.Operation.WRITE) | (command.subgroup != number)
    )
    b.always(unit.data == 0, where=b.past(1, 2) & ~b.past(command.subgroup == number, 2))
    b.always(unit.gate_late == b.past(body.programmed.gating & (body.programmed.gate_start >= unit.period)))
    b.always(body.word.all(), where=b.past(1) & ~b.past(command.subgroup == number))
    b.cover(taken & (unit.settings.threshold == 5))
    b.cover(unit.data == 7)
