# SPDX-License-Identifier: Apache-2.0
"""Frame sequencer: laser periods and the waits between them, progressive gating, and the frame's
beginning and end.

The paper gives the laser's repetition rate and the laser pulses of a frame; the sequencing is our
choice.
"""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract import latency
from ..model.contract.counts import pause_cycles
from ..model.contract.dither import DITHER_BITS_MAX, GAP_BITS, LFSR_BITS, LFSR_TAPS
from ..model.contract.parameters import Sensor
from ..model.contract.settings import GATE_BITS
from . import bus
from .controller import SETTLED
from .unit import Unit
from .voted import Voted

LEAD = 3  # number of cycles that `timing` is ahead of the ports
HEAD_TO_GRANT = 2  # from `frame_begin` to the readout's earliest grant
END_TO_GRANT = 1  # from `finish` to the readout's earliest grant of the end packet
# Cycles from `wrap` after the last period, which comes LEAD + 1 cycles before the first cycle after
# it, to `finish`.
TO_FINISH = LEAD + 1 + latency.FINISH - END_TO_GRANT
# Cycles of a gap after which only its counter changes, until the gap is over.
IDLE_AFTER = SETTLED + 2


class Sequencer(Unit):
    """Sequencer of the sensor.

    Ports
    -----
    plan : in, the frame's settings; start_frame, abort_frame : in, strobes
    timing : out, word of the cycle three cycles ahead; laser : out, high in cycle 0 of every
        period, in step with the ports
    frame_begin : out, strobe to the readouts; number : out, frame number; finish : out, the last
        event is on its way
    delivered : in, all readouts have sent their end packets; done : out, strobe
    resting : out, no frame is in progress

    Between two periods comes the gap, then dither's wait. After steps 1 and 2 of a frame of counts
    the gap is long enough for the subgroups' search. Their cycles belong to the frame but to
    no period, and no edge counts in them. An abort in the gap ends the frame; in dither's wait it
    makes the next period the last one.

    Reset ends a frame at once and sets the frame number to 0. No upset makes a frame last for ever:
    a counter beyond its end counts as being at its end, and a frame without a running period ends.
    A start begins a frame in any state.
    """

    unit_name = "coincid_sequencer"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            plan=In(bus.plan_layout(sensor)),
            start_frame=In(1),
            abort_frame=In(1),
            timing=Out(bus.time_layout(sensor)),
            laser=Out(1),
            frame_begin=Out(1),
            number=Out(bus.PULSE_BITS),
            finish=Out(1),
            delivered=In(1),
            done=Out(1),
            resting=Out(1),
        )
        self.start = Signal(2)  # the strobe, delayed for the registers behind it
        self.restart = self.start[-1]
        self.active = Signal()  # from the beginning of a frame until it is done
        # Periods.
        self.running = Signal()  # from the first period to the end of the last one
        self.first = Signal()  # the frame has begun one cycle ago
        self.cycle = Signal(sensor.coarse_bits + 1)  # number of the cycle in its period
        self.pulse = Signal(bus.PULSE_BITS + 1)  # number of the period in the frame
        self.ends = Signal()  # the cycle is the last of a period
        self.wrap = Signal()  # the cycle before was the last of a period
        self.aborted = Signal()  # this period is the last one
        # Steps of a frame of counts.
        self.counting = Signal()  # the frame has counts
        self.search_step = Signal(bus.Step)  # of the last period that has begun
        self.step_pulses = Signal(bus.PULSE_BITS)  # periods of this step that have begun
        self.step_ends = Signal()  # the period is the last one of step 1 or 2
        # Between two periods.
        self.waiting = Signal()  # in the gap or in dither's wait
        self.in_gap = Signal()  # where it waits
        self.has_gap = Signal()  # the frame has gaps
        self.least_gap = Signal(GAP_BITS)  # with the pause of a search, if counts are built
        self.waited = Signal(GAP_BITS)  # cycles of the gap, with this one
        self.gap_over = Signal()  # this cycle is the gap's last one
        self.left = Signal(DITHER_BITS_MAX)  # cycles of dither's wait
        self.mask = Signal(DITHER_BITS_MAX)  # the bits of `lfsr` that give it
        self.lfsr = Signal(LFSR_BITS)
        # Progressive gating. `step` and `last_step` are registers, because `pulses` and `steps`
        # change only at the end of a period.
        self.shift = Signal(sensor.coarse_bits + 1)  # shift of the gate, in cycles
        self.pulses = Signal(GATE_BITS)  # periods since the last step
        self.steps = Signal(GATE_BITS)  # steps since the shift was 0
        self.step = Signal()  # the shift changes at the end of the period
        self.last_step = Signal()  # and becomes 0
        # The end of a frame.
        self.draining = Signal()  # the frame is ending
        self.drained = Signal(range(TO_FINISH + 1))  # for so many cycles
        self.delivered_for = Signal(SETTLED)  # bit k: delivered for more than k cycles

    def elaborate(self, platform):
        m = Module()
        self._periods(m)
        self._gap(m)
        self._dither(m)
        self._shift(m)
        self._timing(m)
        self._end(m)
        if self.sensor.counts:
            self._steps(m)
        return m

    def _periods(self, m):
        """Count the cycles of a period and the periods of the frame."""
        settings = self.plan
        last_cycle = Signal.like(self.cycle)
        last_pulse = Signal.like(self.pulse)
        m.d.sync += [
            last_cycle.eq(settings.period - 1),
            last_pulse.eq(settings.pulses - 1),
            self.start.eq((self.start << 1) | self.start_frame),
            self.cycle.eq(Mux(self.ends | self.waiting, 0, self.cycle + 1)),
            self.wrap.eq(self.ends),
            self.first.eq(self.restart),
        ]
        m.d.comb += self.ends.eq(self.running & ~self.waiting & (self.cycle >= last_cycle))
        with m.If(self.abort_frame & self.running):
            m.d.sync += self.aborted.eq(1)
            with m.If(self.in_gap):
                m.d.sync += self.running.eq(0)
        with m.If(self.ends):
            m.d.sync += self.pulse.eq(self.pulse + 1)
            with m.If(self.aborted | self.abort_frame | (self.pulse >= last_pulse)):
                m.d.sync += self.running.eq(0)
        with m.If(self.restart):
            m.d.sync += [
                self.running.eq(1),
                self.cycle.eq(0),
                self.pulse.eq(0),
                self.aborted.eq(0),
                self.active.eq(1),
            ]

    def _gap(self, m):
        """Count the cycles of the gap. The comparison is one cycle ahead, in a register."""
        last = Signal.like(self.waited)
        gap = self._least_gap(m) if self.sensor.counts else self.plan.gap
        m.d.sync += [
            self.has_gap.eq(gap != 0),
            last.eq(gap - 1),
            # Without a gap `last` wraps: an upset that begins one ends in the next cycle.
            self.gap_over.eq((self.waited >= last) | ~self.has_gap),
            self.waited.eq(0),
        ]
        with m.If((self.in_gap & ~self.gap_over) | (self.ends & self.has_gap)):
            m.d.sync += self.waited.eq(self.waited + 1)

    def _least_gap(self, m):
        """Return the cycles of the gap after this period, with those of a search."""
        regions, gates = pause_cycles(self.sensor.minigroups)
        gap = self.least_gap
        pause = Mux(self.search_step == bus.Step.WIDE, regions, gates)
        is_longer = self.step_ends & (self.plan.gap < pause)
        m.d.comb += gap.eq(Mux(is_longer, pause, self.plan.gap))
        return gap

    def _steps(self, m):
        """Count the periods of the first two steps of a frame of counts, at their beginnings.

        After the last period of a step, the subgroups search.
        """
        step = self.search_step
        searched = Signal()  # the step has as many periods as it shall have
        m.d.comb += searched.eq(self.step_pulses >= self.plan.search_pulses)
        m.d.sync += [
            self.counting.eq(bus.is_counts(self.plan.format)),
            self.step_ends.eq(self.counting & searched & (step != bus.Step.GATED)),
            self.timing.search.eq(self.wrap & self.step_ends),
        ]
        with m.If(self.running & ~self.waiting & (self.cycle == 0)):
            m.d.sync += self.step_pulses.eq(self.step_pulses + 1)
            with m.If(self.step_ends):
                m.d.sync += [
                    step.eq(bus.step_after(step)),
                    self.step_pulses.eq(1),
                ]
        with m.If(self.restart):
            m.d.sync += [
                step.eq(bus.Step.WIDE),
                self.step_pulses.eq(0),
                self.step_ends.eq(0),
            ]

    def _dither(self, m):
        """Draw dither's wait, and wait: for the gap, then for the cycles that are drawn. The LFSR
        steps in every cycle of the periods.
        """
        following = Signal(LFSR_BITS)
        drawn = Signal.like(self.left)
        m.d.comb += following.eq((self.lfsr >> 1) ^ Mux(self.lfsr[0], LFSR_TAPS, 0))
        m.d.comb += drawn.eq(following & self.mask)
        m.d.sync += self.mask.eq((1 << self.plan.dither_bits) - 1)
        with m.If(self.waiting & self.in_gap):
            with m.If(self.gap_over):
                m.d.sync += [self.in_gap.eq(0), self.waiting.eq(self.left.any())]
        with m.Elif(self.waiting):
            m.d.sync += [self.left.eq(self.left - 1), self.waiting.eq(self.left > 1)]
        with m.Elif(self.running):
            m.d.sync += self.lfsr.eq(following)
            with m.If(self.ends):
                m.d.sync += [
                    self.left.eq(drawn),
                    self.waiting.eq(self.has_gap | drawn.any()),
                    self.in_gap.eq(self.has_gap),
                ]
        with m.If(self.restart):
            m.d.sync += self.lfsr.eq(self.plan.dither_seed)
        with m.If(self.restart | ~self.running):
            m.d.sync += [self.left.eq(0), self.waiting.eq(0), self.in_gap.eq(0)]

    def _shift(self, m):
        """Progressive gating: compute the gate's shift in this period, saturated at a shift with
        which no gate opens.
        """
        settings = self.plan
        coarse_bits = self.sensor.coarse_bits
        beyond = 1 << coarse_bits
        more = Signal(GATE_BITS + 1)
        m.d.comb += more.eq(self.shift + settings.gate_step)
        m.d.sync += [
            self.step.eq((settings.gate_every != 0) & (self.pulses == settings.gate_every - 1)),
            self.last_step.eq(self.steps == settings.gate_steps - 1),
        ]
        with m.If(self.ends):
            m.d.sync += self.pulses.eq(Mux(self.step, 0, self.pulses + 1))
            with m.If(self.step):
                with m.If(self.last_step):
                    m.d.sync += [self.steps.eq(0), self.shift.eq(0)]
                with m.Else():
                    m.d.sync += [
                        self.steps.eq(self.steps + 1),
                        self.shift.eq(Mux(more >= beyond, beyond, more)),
                    ]
        with m.If(self.restart):
            m.d.sync += [self.shift.eq(0), self.pulses.eq(0), self.steps.eq(0)]

    def _timing(self, m):
        """Form the subgroups' word for the cycle, and the laser and frame strobes, which are in
        step with the ports.
        """
        in_period = Signal()
        last_open = Signal.like(self.cycle)
        m.d.comb += in_period.eq(self.running & ~self.waiting)
        may_open = in_period & (self.cycle < last_open)
        if self.sensor.counts:
            may_open = may_open & ~self.counting
        m.d.sync += [
            last_open.eq(self.plan.period - self.sensor.guard),
            self.timing.running.eq(in_period),
            self.timing.start.eq(in_period & (self.cycle == 0)),
            self.timing.wrap.eq(self.wrap),
            self.timing.may_open.eq(may_open),
            self.timing.shift.eq(self.shift),
        ]
        laser = Signal(LEAD - 1)
        m.d.sync += [laser.eq((laser << 1) | self.timing.start), self.laser.eq(laser[-1])]
        # `first` comes one cycle before `timing` shows cycle 0, which is LEAD + 1 cycles before the
        # ports.
        until_begin = Signal(LEAD + latency.FRAME_START - HEAD_TO_GRANT)
        m.d.sync += [
            until_begin.eq((until_begin << 1) | self.first),
            self.frame_begin.eq(until_begin[-1]),
        ]

    def _end(self, m):
        """End the frame: wait until nothing more is stored, then until everything is delivered;
        then `done`.

        It is delivered for `SETTLED` cycles, so that the threshold controllers know their budgets.
        """
        self.number_voted = number = Voted(m, "number_voted", bus.PULSE_BITS)
        m.d.comb += self.number.eq(number.value)
        m.d.sync += [
            self.delivered_for.eq(Cat(1, self.delivered_for) & self.delivered.replicate(SETTLED)),
            self.done.eq(0),
            self.finish.eq(self.draining & (self.drained >= TO_FINISH - 1)),
            self.resting.eq(~(self.start.any() | self.active | self.draining | self.done)),
        ]
        with m.If(self.draining & (self.drained < TO_FINISH)):
            m.d.sync += self.drained.eq(self.drained + 1)
        # In the cycle after the last period both are set; after an upset, it may be only one of
        # them.
        with m.If((self.active | self.wrap) & ~self.running & ~self.draining):
            m.d.sync += [self.draining.eq(1), self.drained.eq(1)]
        with m.If(self.finish & self.delivered_for[-1]):
            m.d.sync += [
                self.finish.eq(0),
                self.active.eq(0),
                self.draining.eq(0),
                self.drained.eq(0),
                self.done.eq(1),
            ]
            m.d.comb += number.next.eq(number.value + 1)
        with m.If(self.restart):
            m.d.sync += [self.finish.eq(0), self.draining.eq(0), self.drained.eq(0)]
