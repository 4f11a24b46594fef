"""DPCU: judges every closed window, keeps the subgroup's threshold, and counts.

The paper (III-A): based on the chosen mode "a valid signal is generated when the mode-dependent condition is
satisfied in order to write the data into the FIFO register"; the DPCUs "keep track of the number of photons detected
within a coincidence window, allowing us to set different thresholds in every subgroup". How the threshold follows the
photons (bounds that the last frame's photons reach) and the loss counters are our choice.
"""

from types import SimpleNamespace

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract.parameters import Sensor
from ..model.contract.registers import AUTO_BOUNDS, COUNTER_BITS, COUNTER_NAMES, DATA_BITS
from . import bus
from .logic import saturating_add
from .unit import Unit


class Dpcu(Unit):
    """Digital processing and communication unit of a subgroup.

    Ports
    -----
    settings : in, the frame's; operation, bound : in, the configuration bus, registered
    window_ticks : out, the window in force (1 where coincidence is off)
    start : in, a period's first cycle, two cycles ahead of the ports
    closed, window : in, from the tree (stage 7); commit, event : out, to the FIFO one cycle later (stage 8: the commit cycle)
    blind, stored, dropped, mg_stored, mg_dropped : in, strobes to count
    pulse : out, the period's number in the frame (stage 8)
    counters : out, in the order of the register table; settled a few cycles after the last window

    Reset clears the counters and forgets the controller's last frame: the first frame uses the programmed threshold.
    """

    unit_name = "coincid_dpcu"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            {
                "settings": In(bus.settings_layout(sensor)),
                "operation": In(bus.Operation),
                "bound": In(DATA_BITS),
                "window_ticks": Out(sensor.window_bits),
                "start": In(1),
                "closed": In(1),
                "window": In(bus.window_layout(sensor)),
                "commit": Out(1),
                "event": Out(bus.window_layout(sensor)),
                "blind": In(1),
                "stored": In(1),
                "dropped": In(1),
                "mg_stored": In(1),
                "mg_dropped": In(1),
                "pulse": Out(bus.PULSE_BITS),
                "counters": Out(COUNTER_BITS * len(COUNTER_NAMES)),
            }
        )

    def elaborate(self, platform):
        m = Module()
        self.state = SimpleNamespace()
        self.state.count = count = {name: Signal(COUNTER_BITS, name=name) for name in COUNTER_NAMES}
        m.d.comb += [self.counters.word_select(i, COUNTER_BITS).eq(count[name]) for i, name in enumerate(COUNTER_NAMES)]
        self._judgement(m)
        self._pulses(m)
        self._counters(m)
        self._controller(m)
        return m

    def _judgement(self, m):
        """Windows that meet the threshold go to the FIFO. Coincidence off is a window of one tick and a threshold of one."""
        state = self.state
        state.threshold = threshold = Signal(self.sensor.count_bits, init=1)
        enough = Signal()
        m.d.sync += [
            self.window_ticks.eq(Mux(self.settings.coincidence, self.settings.window, 1)),
            threshold.eq(Mux(self.settings.coincidence, state.count["threshold_used"], 1)),
            self.commit.eq(self.closed & enough),
        ]
        m.d.comb += enough.eq(self.window.count >= threshold)
        with m.If(self.closed):
            m.d.sync += self.event.eq(self.window)

    def _pulses(self, m):
        """The period's number: the strobe reaches stage 8 ten registers after it comes in."""
        coming = Signal(9)
        m.d.sync += coming.eq((coming << 1) | self.start)
        with m.If(coming[-1]):
            m.d.sync += self.pulse.eq(self.pulse + 1)

    def _counters(self, m):
        """Counters, a stage behind what they count, so that no adder hangs on the commit."""
        count = self.state.count
        judged = Signal()
        judged_count = Signal.like(self.window.count)
        m.d.sync += [judged.eq(self.closed), judged_count.eq(self.window.count)]
        strobes = {
            "opened": judged,
            "committed": self.commit,
            "rejected": judged & ~self.commit,
            "blind": self.blind,
            "stored": self.stored,
            "dropped": self.dropped,
            "mg_stored": self.mg_stored,
            "mg_dropped": self.mg_dropped,
        }
        for name, strobe in strobes.items():
            with m.If(strobe):
                saturating_add(m, count[name], 1)
        with m.If(judged):
            saturating_add(m, count["photons"], judged_count)

    def _controller(self, m):
        """The frame's threshold, by the bounds that the last frame's photons reach; clears what counts for a frame."""
        state, count = self.state, self.state.count
        state.steps = steps = Signal(range(AUTO_BOUNDS + 1))  # bounds reached
        state.frame_before = frame_before = Signal()
        reached = Signal()
        m.d.comb += reached.eq(count["photons"] >= self.bound)
        with m.Switch(self.operation):
            with m.Case(bus.Operation.TAKE):
                m.d.sync += steps.eq(0)
            with m.Case(bus.Operation.COMPARE):
                m.d.sync += steps.eq(steps + reached)
            with m.Case(bus.Operation.BEGIN):
                m.d.sync += [counter.eq(0) for counter in count.values()]
                m.d.sync += [
                    count["threshold_used"].eq(
                        Mux(self.settings.auto & frame_before, steps + 1, self.settings.threshold)
                    ),
                    frame_before.eq(1),
                    self.pulse.eq(~0),
                ]
