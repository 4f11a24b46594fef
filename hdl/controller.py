# SPDX-License-Identifier: Apache-2.0
"""Threshold controller of a stream ("fill the stream"): the budget that its subgroups share.

The paper gives every subgroup a threshold of its own and does not say how it is found. Our choice is a controller that
shares the capacity of a stream; `docs/contract.md` states its rule. The thresholds themselves are in the subgroups
(`dpcu.py`), which receive the budget when the next frame begins.
"""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract.counters import COUNTER_BITS, COUNTER_NAMES
from ..model.contract.packet import BEAT_BITS, layout
from ..model.contract.parameters import Sensor
from ..model.contract.registers import DATA_BITS
from . import bus
from .logic import carry_select, saturating_add
from .unit import Unit
from .voted import Voted

STEP_BITS = 4  # a budget changes by 1/16 of itself in a frame
# Beat and word of these counters in the packet; the sums wait for the later one.
COMMITTED, LOWER = (divmod(COUNTER_NAMES.index(name), BEAT_BITS // COUNTER_BITS) for name in ("committed", "lower"))
SETTLED = 4  # cycles from the last beat of counters in a frame to the new budget


class ControllerState:
    """Inner registers and signals of a controller.

    take: the settings take effect. known: the budget, a cycle later, because vote and sums take one cycle each. complete:
    `committed` and `lower` belong together; `now` and `then` do. fresh: no frame has been taken since reset.
    """

    budget: Voted

    def __init__(self, sensor: Sensor):
        self.take = Signal()
        self.capacity = Signal(DATA_BITS)
        self.share = Signal(DATA_BITS)
        self.widened = Signal(DATA_BITS + 1)
        self.narrowed = Signal(DATA_BITS)
        self.wide = Signal(DATA_BITS)
        self.narrow = Signal(DATA_BITS)
        self.known = Signal(DATA_BITS)
        self.beat = Signal(range(layout(sensor).counter_beats))
        self.committed = Signal(COUNTER_BITS)
        self.lower = Signal(COUNTER_BITS)
        self.controlled = Signal()
        self.complete = Signal(2)
        self.now = Signal(COUNTER_BITS)
        self.then = Signal(COUNTER_BITS)
        self.total = Signal(DATA_BITS + 1)
        self.more = Signal(DATA_BITS + 1)
        self.fresh = Signal(init=1)
        self.too_much = Signal()
        self.fits = Signal()


class Controller(Unit):
    """Controller of a stream. It does not need to know how many subgroups the stream has.

    Ports
    -----
    command : in, configuration bus
    capacity, share : in, as programmed; they take effect at TAKE
    counted : in, from the readout: the counters as they leave at the end of the frame
    done : in, strobe: the frame has been delivered, at least `SETTLED` cycles after its last counters
    budget : out, events for each subgroup; changes with `done`. Before the first frame it equals the share

    Reset clears the budget.
    """

    unit_name = "coincid_controller"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            {
                "command": In(bus.CONFIG_BUS),
                "capacity": In(DATA_BITS),
                "share": In(DATA_BITS),
                "counted": In(bus.COUNTED),
                "done": In(1),
                "budget": Out(DATA_BITS),
            }
        )
        self.state = ControllerState(sensor)

    def elaborate(self, platform):
        m = Module()
        m.d.comb += self.state.take.eq(self.command.operation == bus.Operation.TAKE)
        self._candidates(m)
        self._sums(m)
        self._budget(m)
        return m

    def _candidates(self, m):
        """The two candidates for the next budget, ready long before the counters.

        One is a step wider, up to the capacity; the other is a step narrower, down to the share.
        """
        state = self.state
        with m.If(state.take):
            m.d.sync += [state.capacity.eq(self.capacity), state.share.eq(self.share)]
        m.d.sync += state.known.eq(self.budget)
        budget, step = Cat(1, state.known), state.known >> STEP_BITS  # the lowest bits carry a 1 into the sums
        wider, narrower = Signal(DATA_BITS), Signal(DATA_BITS)
        m.d.comb += [wider.eq(step), narrower.eq(~step)]
        m.d.sync += [
            state.widened.eq(carry_select(m, budget, Cat(1, wider), "widened_sum")[1:]),
            state.narrowed.eq(carry_select(m, budget, Cat(1, narrower), "narrowed_sum")[1:]),
            state.wide.eq(Mux(state.widened < state.capacity, state.widened, state.capacity)),
            state.narrow.eq(Mux(state.narrowed > state.share, state.narrowed, state.share)),
        ]

    def _sums(self, m):
        """Sum up the events of all subgroups, one after the other: as committed, and as expected with the wider budget.

        A subgroup's threshold would fall if the windows at the next lower threshold fit the budget. At a threshold of 1,
        `lower` equals `committed`. Both sums saturate at twice the highest capacity.
        """
        state = self.state
        beats = layout(self.sensor).counter_beats
        whole = Signal()
        for counter, (beat, word) in ((state.committed, COMMITTED), (state.lower, LOWER)):
            with m.If(self.counted.valid & (state.beat == beat)):
                m.d.sync += counter.eq(self.counted.beat.word_select(word, COUNTER_BITS))
        m.d.comb += whole.eq(self.counted.valid & (state.beat == LOWER[0]))
        with m.If(self.counted.valid):
            m.d.sync += [
                state.beat.eq(Mux(state.beat == beats - 1, 0, state.beat + 1)),
                state.controlled.eq(self.counted.controlled),
            ]
        m.d.sync += [
            state.complete.eq(state.complete << 1 | whole),
            state.now.eq(state.committed),
            state.then.eq(Mux(state.controlled & (state.lower <= state.wide), state.lower, state.committed)),
        ]
        with m.If(state.complete[-1]):
            saturating_add(m, state.total, state.now)
            saturating_add(m, state.more, state.then)
        with m.If(state.take):
            m.d.sync += [state.beat.eq(0), state.total.eq(0), state.more.eq(0)]

    def _budget(self, m):
        """Narrow the budget if too much was sent; widen it if everything would still fit; begin with the first share."""
        state = self.state
        state.budget = budget = Voted(m, "budget_kept", DATA_BITS)
        m.d.comb += self.budget.eq(budget.value)
        m.d.sync += [state.too_much.eq(state.total > state.capacity), state.fits.eq(state.more <= state.capacity)]
        with m.If(state.take):
            m.d.sync += state.fresh.eq(0)
        with m.If(state.fresh):
            m.d.comb += budget.next.eq(self.share)
        with m.Elif(self.done & state.too_much):
            m.d.comb += budget.next.eq(state.narrow)
        with m.Elif(self.done & state.fits):
            m.d.comb += budget.next.eq(state.wide)
