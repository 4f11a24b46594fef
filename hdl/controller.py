# SPDX-License-Identifier: Apache-2.0
"""Threshold controller of a stream ("fill the stream"): the budget that its subgroups share, and their limit.

The paper gives every subgroup a threshold of its own and does not say how it is found. Our choice is a controller that
shares the capacity of a stream; `docs/contract.md` states its rule. The thresholds themselves are in the subgroups
(`dpcu.py`), which receive budget and limit when the next frame begins.
"""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract.counters import COUNTER_BITS, COUNTER_NAMES
from ..model.contract.packet import BEAT_BITS, layout
from ..model.contract.parameters import Sensor
from ..model.contract.registers import DATA_BITS
from ..model.contract.settings import BUDGET_GROWTHS, LIMIT_DROP
from . import bus
from .logic import carry_select
from .unit import Unit
from .voted import Voted

# Beat and word of these counters in the packet; the sums wait for the later one.
COMMITTED, LOWER = (divmod(COUNTER_NAMES.index(name), BEAT_BITS // COUNTER_BITS) for name in ("committed", "lower"))
STEPS = 1 + len(BUDGET_GROWTHS)  # candidates for the next budget
SUMS = 1 + STEPS  # what was committed, and what each of them would let through
FILLED = 5  # cycles from the beginning of a frame to the first candidate: one for the first share, four to compute it
SETTLED = SUMS + 5  # cycles from the last beat of counters in a frame to the new budget and limit


class ControllerState:
    """Inner registers and signals of a controller.

    take: the settings take effect. known: the budget, a cycle later, because vote and sums take one cycle each.
    filling: which candidate is begun, in one hot, and the strobes of those on their way to `steps`.
    slot: which sum the counters of a subgroup, `now` and `then`, are added to, in one hot; adding, added: one and two cycles
    later, for any sum; of_all: likewise, for the sum of what was committed. `steps` and `sums` rotate, so that the first of
    each is at work. fits: for each sum, whether the stream can carry it. too_much, far_too_much: the
    stream cannot carry what was committed, nor half of it. most: the highest count on which the controller acts; top: not
    above the limit. fresh: no frame has been taken since reset.
    """

    budget: Voted

    def __init__(self, sensor: Sensor):
        self.take = Signal()
        self.capacity = Signal(DATA_BITS)
        self.share = Signal(DATA_BITS)
        self.known = Signal(DATA_BITS)
        self.filling = Signal(STEPS + FILLED)
        self.growth = Signal(DATA_BITS + 1)  # the lowest bit carries a 1 into the sum
        self.grown = Signal(DATA_BITS + 1)
        self.bounded = Signal(DATA_BITS)
        self.candidate = Signal(DATA_BITS)
        self.steps = [Signal(DATA_BITS, name=f"step_{k}") for k in range(STEPS)]
        self.beat = Signal(range(layout(sensor).counter_beats))
        self.committed = Signal(COUNTER_BITS)
        self.controlled = Signal()
        self.slot = Signal(SUMS)
        self.adding = Signal()
        self.added = Signal()
        self.of_all = Signal(2)
        self.now = Signal(COUNTER_BITS)
        self.then = Signal(COUNTER_BITS)
        self.part = Signal(COUNTER_BITS)
        self.sums = [Signal(DATA_BITS + 1, name=f"sum_{k}") for k in range(SUMS)]
        self.fits = Signal(SUMS)
        self.far_too_much = Signal()
        self.fitting = Signal(DATA_BITS)
        self.most = Signal(COUNTER_BITS)
        self.top = Signal(DATA_BITS)
        self.dropped = Signal(DATA_BITS)
        self.lower_limit = Signal(DATA_BITS)
        self.higher_limit = Signal(DATA_BITS)
        self.fresh = Signal(init=1)


class Controller(Unit):
    """Controller of a stream. It does not need to know how many subgroups the stream has.

    Ports
    -----
    command : in, configuration bus
    capacity, share : in, as programmed; they take effect at TAKE
    counted : in, from the readout: the counters as they leave at the end of the frame
    done : in, strobe: the frame has been delivered, at least `SETTLED` cycles after its last counters
    budget, limit : out, events up to which a subgroup lowers its threshold, and beyond which it raises it; they change with
    `done`. Before the first frame they equal the share

    Reset clears budget and limit.
    """

    unit_name = "coincid_controller"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        assert layout(sensor).counter_beats >= SUMS  # one subgroup has left the sums before the next one comes
        super().__init__(
            command=In(bus.CONFIG_BUS),
            capacity=In(DATA_BITS),
            share=In(DATA_BITS),
            counted=In(bus.COUNTED),
            done=In(1),
            budget=Out(DATA_BITS),
            limit=Out(DATA_BITS),
        )
        self.state = ControllerState(sensor)

    def elaborate(self, platform):
        m = Module()
        m.d.comb += self.state.take.eq(self.command.operation == bus.Operation.TAKE)
        self._candidates(m)
        self._counters(m)
        self._sums(m)
        self._limits(m)
        self._results(m)
        return m

    def _candidates(self, m):
        """Compute the candidates for the next budget when a frame begins: as it is, and grown by several steps.

        None is above the capacity or below the share. They are computed one behind the other.
        """
        state = self.state
        with m.If(state.take):
            m.d.sync += [state.capacity.eq(self.capacity), state.share.eq(self.share)]
        m.d.sync += state.growth.eq(0)
        for k, shift in enumerate(BUDGET_GROWTHS):
            with m.If(state.filling[2 + k]):
                m.d.sync += state.growth.eq(Cat(1, state.known >> shift))
        m.d.sync += [
            state.known.eq(self.budget),
            state.filling.eq(Cat(state.take, state.filling)),
            state.grown.eq(carry_select(m, Cat(1, state.known), state.growth, "grown_sum")[1:]),
            state.bounded.eq(Mux(state.grown < state.capacity, state.grown, state.capacity)),
            state.candidate.eq(Mux(state.bounded > state.share, state.bounded, state.share)),
        ]

    def _counters(self, m):
        """Wait for both counters of a subgroup; then they are at work until those of the next one are complete."""
        state = self.state
        beats = layout(self.sensor).counter_beats
        complete = Signal()
        m.d.comb += complete.eq(self.counted.valid & (state.beat == LOWER[0]))
        with m.If(self.counted.valid & (state.beat == COMMITTED[0])):
            m.d.sync += state.committed.eq(self.counted.beat.word_select(COMMITTED[1], COUNTER_BITS))
        with m.If(self.counted.valid):
            m.d.sync += state.beat.eq(Mux(state.beat == beats - 1, 0, state.beat + 1))
        with m.If(complete):
            m.d.sync += [
                state.now.eq(state.committed),
                state.then.eq(self.counted.beat.word_select(LOWER[1], COUNTER_BITS)),
                state.controlled.eq(self.counted.controlled),
            ]
        with m.If(state.take):
            m.d.sync += state.beat.eq(0)
        m.d.sync += [
            state.slot.eq(Cat(complete, state.slot)),
            state.adding.eq(state.slot.any()),
            state.added.eq(state.adding),
            state.of_all.eq(Cat(state.slot[0], state.of_all)),
        ]

    def _sums(self, m):
        """Sum up the events of all subgroups: as committed, and as expected with each candidate for the budget.

        A subgroup's threshold would fall if the windows at the next lower threshold fit the budget. At a threshold of 1,
        `lower` equals `committed`. The sums saturate at twice the highest capacity.
        """
        state = self.state
        falls = state.controlled & ~state.slot[0] & (state.then <= state.steps[0])
        m.d.sync += state.part.eq(Mux(falls, state.then, state.now))
        with m.If(state.slot[1:].any() | state.filling[FILLED:].any()):
            last = Mux(state.filling[FILLED:].any(), state.candidate, state.steps[0])
            m.d.sync += [step.eq(after) for step, after in zip(state.steps, (*state.steps[1:], last))]
        total = Signal(DATA_BITS + 2)
        m.d.comb += total.eq(carry_select(m, state.sums[0], state.part, "sum_of_part"))
        with m.If(state.adding):
            m.d.sync += [one.eq(after) for one, after in zip(state.sums, state.sums[1:])]
            m.d.sync += state.sums[-1].eq(Mux(total[-1], ~0, total))
        with m.If(state.added):
            m.d.sync += state.fits.eq(Cat(state.fits[1:], state.sums[-1] <= state.capacity))
        with m.If(state.of_all[-1]):
            m.d.sync += state.far_too_much.eq(state.sums[-1] > Cat(0, state.capacity))
        with m.If(state.take):
            m.d.sync += [one.eq(0) for one in state.sums]

    def _limits(self, m):
        """Two candidates for the next limit: below the highest count that the controller can lower, and not below it."""
        state = self.state
        with m.If(state.slot[0] & state.controlled & (state.now > state.most)):
            m.d.sync += state.most.eq(state.now)
        with m.If(state.take):
            m.d.sync += state.most.eq(0)
        drop = Signal(DATA_BITS)
        m.d.comb += drop.eq(~(state.top >> LIMIT_DROP))
        m.d.sync += [
            state.top.eq(Mux(state.most < self.limit, state.most, self.limit)),
            state.dropped.eq(carry_select(m, Cat(1, state.top), Cat(1, drop), "dropped_sum")[1:]),
            state.lower_limit.eq(Mux(state.dropped > state.share, state.dropped, state.share)),
            state.higher_limit.eq(Mux(state.fitting > state.top, state.fitting, state.top)),
        ]

    def _results(self, m):
        """Take the highest candidate that fits, if the stream could carry the frame; begin with the first share."""
        state = self.state
        state.budget = budget = Voted(m, "budget_kept", DATA_BITS)
        m.d.comb += self.budget.eq(budget.value)
        fitting = state.share
        for fits, step in zip(state.fits[1:], state.steps):
            fitting = Mux(fits, step, fitting)
        m.d.sync += state.fitting.eq(fitting)
        with m.If(state.take):
            m.d.sync += state.fresh.eq(0)
        with m.If(state.fresh):
            m.d.comb += budget.next.eq(self.share)
            m.d.sync += self.limit.eq(self.share)
        with m.Elif(self.done & state.fits[0]):
            m.d.comb += budget.next.eq(state.fitting)
            m.d.sync += self.limit.eq(state.higher_limit)
        with m.Elif(self.done):
            m.d.comb += budget.next.eq(state.share)
            m.d.sync += self.limit.eq(Mux(state.far_too_much, state.share, state.lower_limit))
