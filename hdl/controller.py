# SPDX-License-Identifier: Apache-2.0
"""Threshold controller of a stream ("fill the stream"): the budget that its subgroups share, and
their limit.

The paper gives every subgroup a threshold of its own and does not say how it is found. Our choice
is a controller that shares the capacity of a stream; `docs/contract.md` states its rule. The
thresholds themselves are in the subgroups (`dpcu.py`), which receive budget and limit when the next
frame begins.
"""

from itertools import pairwise

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

# Beat and word of these counters in the packet; the sums wait for the later counter.
COMMITTED, LOWER = (
    divmod(COUNTER_NAMES.index(name), BEAT_BITS // COUNTER_BITS) for name in ("committed", "lower")
)
STEPS = 1 + len(BUDGET_GROWTHS)  # candidates for the next budget
SUMS = 1 + STEPS  # of the committed events, and of those that each candidate would let through
# Cycles from the beginning of a frame to the first candidate: one for the first share, four to
# compute it.
FILLED = 5
SETTLED = SUMS + 5  # cycles from the last beat of counters in a frame to the new budget and limit


class Controller(Unit):
    """Controller of a stream. It does not need to know how many subgroups the stream has.

    Ports
    -----
    command : in, configuration bus
    capacity, share : in, as programmed; they take effect at TAKE
    counted : in, from the readout: the counters as they leave at the end of the frame
    done : in, strobe: the frame has been delivered, at least `SETTLED` cycles after its last
        counters
    budget, limit : out, events up to which a subgroup lowers its threshold, and beyond which it
        raises it; they change with `done`. Before the first frame they equal the share

    Reset clears budget and limit.
    """

    unit_name = "coincid_controller"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        # The sums are done with a subgroup before the next one comes.
        assert layout(sensor).counter_beats >= SUMS
        super().__init__(
            command=In(bus.CONFIG_BUS),
            capacity=In(DATA_BITS),
            share=In(DATA_BITS),
            counted=In(bus.COUNTED),
            done=In(1),
            budget=Out(DATA_BITS),
            limit=Out(DATA_BITS),
        )
        # Settings, and candidates for the next budget.
        self.take = Signal()  # the settings take effect
        self.capacity_taken = Signal(DATA_BITS)
        self.share_taken = Signal(DATA_BITS)
        self.known = Signal(DATA_BITS)  # the budget, a cycle later: vote and sums take a cycle each
        self.growth = Signal(DATA_BITS + 1)  # its lowest bit carries a 1 into the sum
        self.grown = Signal(DATA_BITS + 1)  # the budget, grown by this
        self.bounded = Signal(DATA_BITS)  # the same, at most the capacity
        self.candidate = Signal(DATA_BITS)  # the same, at least the share
        # The candidate that is begun, one-hot, and the strobes of those on their way to `steps`.
        self.filling = Signal(STEPS + FILLED)
        self.steps = [Signal(DATA_BITS, name=f"steps_{k}") for k in range(STEPS)]  # candidates
        # Counters of a subgroup, as they pass.
        self.beat = Signal(range(layout(self.sensor).counter_beats))  # number of the next beat
        self.committed = Signal(COUNTER_BITS)  # its committed events
        self.now = Signal(COUNTER_BITS)  # the same, when all its counters are known
        self.then = Signal(COUNTER_BITS)  # its events at the next lower threshold
        self.controlled = Signal()  # the controller sets its threshold
        # Sums of these counters over the subgroups: of the committed events, and of those that each
        # candidate would let through. `steps` and `sums` rotate, so the first of each is at work.
        self.sums = [Signal(DATA_BITS + 1, name=f"sums_{k}") for k in range(SUMS)]
        self.slot = Signal(SUMS)  # the sum to which the counters are added, one-hot
        self.part = Signal(COUNTER_BITS)  # what is added
        self.adding = Signal()  # a sum is added to; one cycle behind `slot`
        self.added = Signal()  # two cycles behind it
        self.of_all = Signal(2)  # bit k: the same for the committed events, k + 1 cycles behind
        self.fits = Signal(SUMS)  # for each sum: the stream can carry it
        self.far_too_much = Signal()  # the stream cannot carry half of what was committed
        # Results.
        self.fitting = Signal(DATA_BITS)  # the highest candidate that fits, or the share
        self.most = Signal(COUNTER_BITS)  # the highest count on which the controller acts
        self.top = Signal(DATA_BITS)  # the same, but at most the limit
        self.dropped = Signal(DATA_BITS)  # one step below it
        self.reduced_limit = Signal(DATA_BITS)
        self.raised_limit = Signal(DATA_BITS)
        self.fresh = Signal(init=1)  # no frame has been taken since reset

    def elaborate(self, platform):
        m = Module()
        m.d.comb += self.take.eq(self.command.operation == bus.Operation.TAKE)
        self._candidates(m)
        self._counters(m)
        self._sums(m)
        self._limits(m)
        self._results(m)
        return m

    def _candidates(self, m):
        """Compute the candidates for the next budget when a frame begins: as it is, and grown by
        several steps.

        None is above the capacity or below the share. They are computed one after the other.
        """
        with m.If(self.take):
            m.d.sync += [self.capacity_taken.eq(self.capacity), self.share_taken.eq(self.share)]
        m.d.sync += self.growth.eq(0)
        for k, shift in enumerate(BUDGET_GROWTHS):
            with m.If(self.filling[2 + k]):
                m.d.sync += self.growth.eq(Cat(1, self.known >> shift))
        m.d.sync += [
            self.known.eq(self.budget),
            self.filling.eq(Cat(self.take, self.filling)),
            self.grown.eq(carry_select(m, Cat(1, self.known), self.growth, "grown_sum")[1:]),
            self.bounded.eq(Mux(self.grown < self.capacity_taken, self.grown, self.capacity_taken)),
            self.candidate.eq(Mux(self.bounded > self.share_taken, self.bounded, self.share_taken)),
        ]

    def _counters(self, m):
        """Wait for both counters of a subgroup; then they are at work until those of the next one
        are complete.
        """
        beats = layout(self.sensor).counter_beats
        complete = Signal()
        m.d.comb += complete.eq(self.counted.valid & (self.beat == LOWER[0]))
        with m.If(self.counted.valid & (self.beat == COMMITTED[0])):
            m.d.sync += self.committed.eq(self.counted.beat.word_select(COMMITTED[1], COUNTER_BITS))
        with m.If(self.counted.valid):
            m.d.sync += self.beat.eq(Mux(self.beat == beats - 1, 0, self.beat + 1))
        with m.If(complete):
            m.d.sync += [
                self.now.eq(self.committed),
                self.then.eq(self.counted.beat.word_select(LOWER[1], COUNTER_BITS)),
                self.controlled.eq(self.counted.controlled),
            ]
        with m.If(self.take):
            m.d.sync += self.beat.eq(0)
        m.d.sync += [
            self.slot.eq(Cat(complete, self.slot)),
            self.adding.eq(self.slot.any()),
            self.added.eq(self.adding),
            self.of_all.eq(Cat(self.slot[0], self.of_all)),
        ]

    def _sums(self, m):
        """Sum up the events of all subgroups: as committed, and as expected with each candidate for
        the budget.

        A subgroup's threshold would fall if the windows at the next lower threshold fit the budget.
        At a threshold of 1, `lower` equals `committed`. The sums saturate at twice the highest
        capacity.
        """
        falls = self.controlled & ~self.slot[0] & (self.then <= self.steps[0])
        m.d.sync += self.part.eq(Mux(falls, self.then, self.now))
        with m.If(self.slot[1:].any() | self.filling[FILLED:].any()):
            last = Mux(self.filling[FILLED:].any(), self.candidate, self.steps[0])
            for step, after in pairwise([*self.steps, last]):
                m.d.sync += step.eq(after)
        total = Signal(DATA_BITS + 2)
        m.d.comb += total.eq(carry_select(m, self.sums[0], self.part, "sum_of_part"))
        with m.If(self.adding):
            for one, after in pairwise(self.sums):
                m.d.sync += one.eq(after)
            m.d.sync += self.sums[-1].eq(Mux(total[-1], ~0, total))
        with m.If(self.added):
            m.d.sync += self.fits.eq(Cat(self.fits[1:], self.sums[-1] <= self.capacity_taken))
        with m.If(self.of_all[-1]):
            m.d.sync += self.far_too_much.eq(self.sums[-1] > Cat(0, self.capacity_taken))
        with m.If(self.take):
            m.d.sync += [one.eq(0) for one in self.sums]

    def _limits(self, m):
        """Compute two candidates for the next limit: one below the highest count that the
        controller can lower, and one not below it.
        """
        with m.If(self.slot[0] & self.controlled & (self.now > self.most)):
            m.d.sync += self.most.eq(self.now)
        with m.If(self.take):
            m.d.sync += self.most.eq(0)
        drop = Signal(DATA_BITS)
        m.d.comb += drop.eq(~(self.top >> LIMIT_DROP))
        m.d.sync += [
            self.top.eq(Mux(self.most < self.limit, self.most, self.limit)),
            self.dropped.eq(carry_select(m, Cat(1, self.top), Cat(1, drop), "dropped_sum")[1:]),
            self.reduced_limit.eq(
                Mux(self.dropped > self.share_taken, self.dropped, self.share_taken)
            ),
            self.raised_limit.eq(Mux(self.fitting > self.top, self.fitting, self.top)),
        ]

    def _results(self, m):
        """Take the highest candidate that fits, if the stream could carry the frame; begin with the
        first share.
        """
        self.budget_voted = budget = Voted(m, "budget_voted", DATA_BITS)
        m.d.comb += self.budget.eq(budget.value)
        fitting = self.share_taken
        for fits, step in zip(self.fits[1:], self.steps, strict=True):
            fitting = Mux(fits, step, fitting)
        m.d.sync += self.fitting.eq(fitting)
        with m.If(self.take):
            m.d.sync += self.fresh.eq(0)
        with m.If(self.fresh):
            m.d.comb += budget.next.eq(self.share)
            m.d.sync += self.limit.eq(self.share)
        with m.Elif(self.done & self.fits[0]):
            m.d.comb += budget.next.eq(self.fitting)
            m.d.sync += self.limit.eq(self.raised_limit)
        with m.Elif(self.done):
            m.d.comb += budget.next.eq(self.share_taken)
            m.d.sync += self.limit.eq(Mux(self.far_too_much, self.share_taken, self.reduced_limit))
