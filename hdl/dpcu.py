# SPDX-License-Identifier: Apache-2.0
"""DPCU: compares every closed window with the threshold, sets the subgroup's threshold, and counts.

The paper (III-A): based on the chosen mode "a valid signal is generated when the mode-dependent
condition is satisfied in order to write the data into the FIFO register"; the DPCUs "keep track of
the number of photons detected within a coincidence window, allowing us to set different thresholds
in every subgroup". Our own choices are the loss counters and the way the thresholds are found
(`controller.py`; the part of each subgroup is here).
"""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract.counters import COUNTER_BITS, COUNTER_NAMES
from ..model.contract.parameters import Sensor
from ..model.contract.registers import BY_NAME, DATA_BITS
from ..model.contract.settings import THRESHOLD_MAX
from . import bus
from .clock_gate import ClockGate, behind
from .logic import count_up, saturating_add
from .unit import Unit


def counter_bits(name: str, sensor: Sensor) -> int:
    """Return the width of a counter; 0: not built. Only the count of photons can exceed the number
    of cycles in a frame.
    """
    periods = BY_NAME["pulses"].high(sensor)
    match name:
        case "threshold_used":
            return sensor.count_bits
        case "mg_stored" | "mg_dropped":
            most = periods * sensor.records
        case "lower":
            most = periods * sensor.period_max * sensor.controller
        case "photons":
            most = sensor.counter_max
        case _:
            most = periods * sensor.period_max
    return min(sensor.counter_bits, most.bit_length())


class Dpcu(Unit):
    """Digital processing and communication unit of a subgroup.

    Ports
    -----
    settings : in, of the frame; operation, data : in, the configuration bus, registered
    in_stream : in, a budget or limit on the bus is for this subgroup's stream, or for an earlier
        one, which is replaced later; data and in_stream are unused without the threshold controller
    window_ticks : out, the window in force (1 if coincidence is off)
    start : in, first cycle of a period, two cycles ahead of the ports
    closed, window : in, from the tree (stage 7); commit, event : out, to the FIFO one cycle later
        (stage 8: the commit cycle)
    blind, stored, dropped, mg_stored, mg_dropped : in, strobes to count
    pulse : out, the period's number in the frame (stage 8)
    counters : out, in the order of the register table; settled a few cycles after the last window
    controlled : out, the threshold controller sets the threshold
    test_enable : in, opens the clock gate for a test of the chip

    Reset clears the counters. A gate stops the clock while no operation, strobe, window or loss
    comes.
    """

    unit_name = "coincid_dpcu"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            settings=In(bus.settings_layout(sensor)),
            operation=In(bus.Operation),
            data=In(DATA_BITS),
            in_stream=In(1),
            window_ticks=Out(sensor.window_bits),
            start=In(1),
            closed=In(1),
            window=In(bus.window_layout(sensor)),
            commit=Out(1),
            event=Out(bus.window_layout(sensor)),
            blind=In(1),
            stored=In(1),
            dropped=In(1),
            mg_stored=In(1),
            mg_dropped=In(1),
            pulse=Out(bus.PULSE_BITS),
            counters=Out(COUNTER_BITS * len(COUNTER_NAMES)),
            controlled=Out(1),
            test_enable=In(1),
        )
        # The counters, by name.
        self.count = {name: Signal(counter_bits(name, sensor), name=name) for name in COUNTER_NAMES}
        self.awake = Signal()  # an operation may still change threshold or window
        self.coming = Signal(9)  # strobes of periods on their way to stage 8
        self.judged = Signal()  # a window was closed one cycle ago
        self.threshold = Signal(sensor.count_bits, init=1)  # in force; 1 if coincidence is off
        # Threshold controller.
        self.reduced_threshold = Signal(sensor.count_bits)  # one below the threshold
        self.meets_lower = Signal()  # a closed window meets it
        self.stays = Signal()  # the controller was in charge in the last frame, too
        self.rises = Signal()  # the threshold rises by one step,
        self.falls = Signal()  # or else falls by one
        self.stepped = Signal(range(THRESHOLD_MAX + 1))  # the threshold after this step
        # Number of the bounds compared so far that are reached, without the last one, for which
        # `reached` says it.
        self.ceiling = Signal(range(THRESHOLD_MAX + 1))
        self.reached = Signal()
        self.clock_gate = ClockGate(small=True)

    def elaborate(self, platform):
        m = Module()
        for i, counter in enumerate(self.count.values()):
            m.d.comb += self.counters.word_select(i, COUNTER_BITS).eq(counter)
        self._told(m)
        self._judgement(m)
        self._pulses(m)
        self._counters(m)
        self._threshold(m)
        events = Cat(
            self.closed,
            self.judged,
            self.commit,
            self.meets_lower,
            self.blind,
            self.stored,
            self.dropped,
        )
        records = Cat(self.mg_stored, self.mg_dropped)
        awake = self.awake | self.start | self.coming.any() | events.any() | records.any()
        return behind(m, platform, self.clock_gate, awake, self.test_enable)

    def _told(self, m):
        """Wake threshold and window after an operation of the bus.

        They do not change during a frame.
        """
        told = Signal(2, init=-1)  # an operation came one and two cycles ago
        tells = Signal()
        m.d.comb += [
            tells.eq(self.operation != bus.Operation.IDLE),
            self.awake.eq(tells | told.any()),
        ]
        with m.If(self.awake):
            m.d.sync += told.eq(Cat(tells, told))

    def _judgement(self, m):
        """Commit the windows that meet the threshold.

        Without coincidence, the window is one tick and the threshold one.
        """
        enough = Signal()
        with m.If(self.awake):
            m.d.sync += [
                self.window_ticks.eq(Mux(self.settings.coincidence, self.settings.window, 1)),
                self.threshold.eq(Mux(self.settings.coincidence, self.count["threshold_used"], 1)),
            ]
        commits = Signal()
        m.d.comb += commits.eq(self.closed & enough)
        m.d.sync += self.commit.eq(commits)
        if self.sensor.controller:
            with m.If(self.awake):
                m.d.sync += self.reduced_threshold.eq(self.threshold - 1)
            m.d.sync += self.meets_lower.eq(self.closed & self._meets(self.reduced_threshold))
        else:
            m.d.comb += self.meets_lower.eq(0)
        with m.If(commits):
            m.d.sync += self.event.eq(self.window)
        m.d.comb += enough.eq(self._meets(self.threshold))

    def _meets(self, threshold):
        """Return whether the closed window meets a threshold by the sensor's rule of coincidence."""
        window = self.window
        sensor = self.sensor
        return sensor.rule.judging_circuit(window.hits, window.count, threshold, sensor.subgroup)

    def _pulses(self, m):
        """Count the periods. The strobe reaches stage 8 ten registers after the input."""
        coming = self.coming
        with m.If(self.start | coming.any()):
            m.d.sync += coming.eq((coming << 1) | self.start)
        with m.If(coming[-1]):
            m.d.sync += self.pulse.eq(self.pulse + 1)

    def _counters(self, m):
        """Count one stage behind the counted signals, so that no adder is in the path of the
        commit.
        """
        count = self.count
        judged = self.judged
        judged_count = Signal.like(self.window.count)
        m.d.sync += judged.eq(self.closed)
        with m.If(self.closed):
            m.d.sync += judged_count.eq(self.window.count)
        strobes = {
            "opened": judged,
            "committed": self.commit,
            "rejected": judged & ~self.commit,
            "blind": self.blind,
            "stored": self.stored,
            "dropped": self.dropped,
            "mg_stored": self.mg_stored,
            "mg_dropped": self.mg_dropped,
            "lower": self.meets_lower,
        }
        for name, strobe in strobes.items():
            if len(count[name]):
                count_up(m, count[name], strobe)
        with m.If(judged):
            saturating_add(m, count["photons"], judged_count)

    def _threshold(self, m):
        """Set the frame's threshold: the programmed one, or the controller's; clear the frame's
        counters.
        """
        count = self.count
        if self.sensor.controller:
            threshold = self._controlled(m)
        else:
            threshold = self.settings.threshold
            m.d.comb += self.controlled.eq(0)
        with m.If(self.operation == bus.Operation.BEGIN):
            m.d.sync += [counter.eq(0) for counter in count.values()]
            m.d.sync += [count["threshold_used"].eq(threshold), self.pulse.eq(~0)]

    def _controlled(self, m):
        """Return the threshold of a frame that begins: the programmed one, or one step from the
        last frame's.
        """
        count = self.count
        settings = self.settings
        raised = Signal.like(self.ceiling)
        bounded = Signal.like(self.stepped)
        floor = self.data[: len(self.stepped)]
        m.d.comb += [
            self.controlled.eq(settings.auto & settings.coincidence),
            raised.eq(self.ceiling + self.reached),
            bounded.eq(Mux(self.stepped < raised, self.stepped, raised)),
        ]
        with m.If(self.awake):
            m.d.sync += [
                self.reached.eq(
                    (self.operation == bus.Operation.COMPARE) & (count["opened"] >= self.data)
                ),
                self.ceiling.eq(raised),
                self.stepped.eq(
                    _step(count["threshold_used"][: self.sensor.count_bits], self.rises, self.falls)
                ),
            ]
        with m.Switch(self.operation):
            with m.Case(bus.Operation.TAKE):
                m.d.sync += self.ceiling.eq(1)
            with m.Case(bus.Operation.BUDGET):
                with m.If(self.in_stream):
                    m.d.sync += self.falls.eq(count["lower"] <= self.data)
            with m.Case(bus.Operation.LIMIT):
                with m.If(self.in_stream):
                    m.d.sync += self.rises.eq(count["committed"] > self.data)
            with m.Case(bus.Operation.BEGIN):
                # Not at TAKE: a sensor that does not hold its settings has the new ones by then.
                m.d.sync += self.stays.eq(self.controlled)
        own = Mux(bounded < floor, floor, bounded)
        return Mux(self.controlled & self.stays, own, settings.threshold)


def _step(threshold, rises, falls):
    """Return the threshold after one step, from 1 to `THRESHOLD_MAX`.

    A programmed threshold may have been higher.
    """
    threshold = threshold | (threshold == 0)  # only an upset makes it 0
    up = Mux(threshold < THRESHOLD_MAX, threshold + 1, THRESHOLD_MAX)
    down = Mux(threshold > THRESHOLD_MAX, THRESHOLD_MAX, threshold - (threshold > 1))
    stay = Mux(threshold > THRESHOLD_MAX, THRESHOLD_MAX, threshold)
    return Mux(rises, up, Mux(falls, down, stay))
