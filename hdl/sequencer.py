# SPDX-License-Identifier: Apache-2.0
"""Frame sequencer: back-to-back laser periods, progressive gating, and the frame's beginning and end.

The paper gives the laser's repetition rate and the laser pulses of a frame; the sequencing is our choice.
"""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract import latency
from ..model.contract.dither import DITHER_BITS_MAX, LFSR_BITS, LFSR_TAPS
from ..model.contract.parameters import Sensor
from ..model.contract.settings import GATE_BITS
from . import bus
from .controller import SETTLED
from .unit import Unit
from .voted import Voted

LEAD = 3  # number of cycles that `timing` is ahead of the ports
HEAD_TO_GRANT = 2  # from `frame_begin` to the readout's earliest grant
END_TO_GRANT = 1  # from `finish` to the readout's earliest grant of the end packet
# Cycles from `wrap` after the last period, which comes LEAD + 1 cycles before the first cycle after it, to `finish`.
TO_FINISH = LEAD + 1 + latency.FINISH - END_TO_GRANT


class SequencerState:
    """Inner registers and signals of a sequencer.

    waiting: between two periods; left: cycles of this wait. start: the strobe, delayed for the registers behind it.
    active: from the beginning of a frame until it is done. step, last_step: registers, because `pulses` and `steps` change at
    the end of a period only. draining, drained: the frame is ending, and for how long it has been. delivered: bit k, for more
    than k cycles.
    """

    number: Voted

    def __init__(self, sensor: Sensor):
        coarse_bits = sensor.coarse_bits
        self.running = Signal()
        self.waiting = Signal()
        self.ends = Signal()
        self.first = Signal()
        self.wrap = Signal()
        self.cycle = Signal(coarse_bits + 1)
        self.pulse = Signal(bus.PULSE_BITS + 1)
        self.start = Signal(2)
        self.restart = self.start[-1]
        self.aborted = Signal()
        self.active = Signal()
        self.lfsr = Signal(LFSR_BITS)
        self.mask = Signal(DITHER_BITS_MAX)
        self.left = Signal(DITHER_BITS_MAX)
        self.shift = Signal(coarse_bits + 1)
        self.pulses = Signal(GATE_BITS)
        self.steps = Signal(GATE_BITS)
        self.step = Signal()
        self.last_step = Signal()
        self.draining = Signal()
        self.drained = Signal(range(TO_FINISH + 1))
        self.delivered = Signal(SETTLED)


class Sequencer(Unit):
    """Sequencer of the sensor.

    Ports
    -----
    plan : in, the frame's settings; start_frame, abort_frame : in, strobes
    timing : out, word of the cycle three cycles ahead; laser : out, high in cycle 0 of every period, in step with the ports
    frame_begin : out, strobe to the readouts; number : out, frame number; finish : out, the last event is on its way
    delivered : in, all readouts have sent their end packets; done : out, strobe
    resting : out, no frame is in progress

    With dither, the cycles between two periods belong to the frame but to no period, and no edge counts in them. An
    abort in such a cycle makes the next period the last one.

    Reset ends a frame at once and sets the frame number to 0. No upset makes a frame last for ever: a counter beyond its
    end counts as being at its end, and a frame without a running period ends. A start begins a frame in any state.
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
        self.state = SequencerState(sensor)

    def elaborate(self, platform):
        m = Module()
        self._periods(m)
        self._dither(m)
        self._shift(m)
        self._timing(m)
        self._end(m)
        return m

    def _periods(self, m):
        """Count the cycles of a period and the periods of the frame."""
        state, settings = self.state, self.plan
        last_cycle = Signal.like(state.cycle)
        last_pulse = Signal.like(state.pulse)
        m.d.sync += [
            last_cycle.eq(settings.period - 1),
            last_pulse.eq(settings.pulses - 1),
            state.start.eq((state.start << 1) | self.start_frame),
            state.cycle.eq(Mux(state.ends | state.waiting, 0, state.cycle + 1)),
            state.wrap.eq(state.ends),
            state.first.eq(state.restart),
        ]
        m.d.comb += state.ends.eq(state.running & ~state.waiting & (state.cycle >= last_cycle))
        with m.If(self.abort_frame & state.running):
            m.d.sync += state.aborted.eq(1)
        with m.If(state.ends):
            m.d.sync += state.pulse.eq(state.pulse + 1)
            with m.If(state.aborted | self.abort_frame | (state.pulse >= last_pulse)):
                m.d.sync += state.running.eq(0)
        with m.If(state.restart):
            m.d.sync += [
                state.running.eq(1),
                state.cycle.eq(0),
                state.pulse.eq(0),
                state.aborted.eq(0),
                state.active.eq(1),
            ]

    def _dither(self, m):
        """Count the cycles until the next period. The LFSR steps in every cycle of the periods."""
        state = self.state
        following = Signal(LFSR_BITS)
        m.d.comb += following.eq((state.lfsr >> 1) ^ Mux(state.lfsr[0], LFSR_TAPS, 0))
        m.d.sync += state.mask.eq((1 << self.plan.dither_bits) - 1)
        with m.If(state.waiting):
            m.d.sync += [state.left.eq(state.left - 1), state.waiting.eq(state.left > 1)]
        with m.Elif(state.running):
            m.d.sync += state.lfsr.eq(following)
            with m.If(state.ends):
                m.d.sync += [state.left.eq(following & state.mask), state.waiting.eq((following & state.mask).any())]
        with m.If(state.restart):
            m.d.sync += [state.lfsr.eq(self.plan.dither_seed), state.left.eq(0), state.waiting.eq(0)]

    def _shift(self, m):
        """Progressive gating: the gate's shift in this period, saturated where no gate can open any more."""
        state, settings, coarse_bits = self.state, self.plan, self.sensor.coarse_bits
        beyond = 1 << coarse_bits
        more = Signal(GATE_BITS + 1)
        m.d.comb += more.eq(state.shift + settings.gate_step)
        m.d.sync += [
            state.step.eq((settings.gate_every != 0) & (state.pulses == settings.gate_every - 1)),
            state.last_step.eq(state.steps == settings.gate_steps - 1),
        ]
        with m.If(state.ends):
            m.d.sync += state.pulses.eq(Mux(state.step, 0, state.pulses + 1))
            with m.If(state.step):
                with m.If(state.last_step):
                    m.d.sync += [state.steps.eq(0), state.shift.eq(0)]
                with m.Else():
                    m.d.sync += [state.steps.eq(state.steps + 1), state.shift.eq(Mux(more >= beyond, beyond, more))]
        with m.If(state.restart):
            m.d.sync += [state.shift.eq(0), state.pulses.eq(0), state.steps.eq(0)]

    def _timing(self, m):
        """Form the subgroups' word for the cycle, and the laser and frame strobes, which are in step with the ports."""
        state = self.state
        in_period = Signal()
        last_open = Signal.like(state.cycle)
        m.d.comb += in_period.eq(state.running & ~state.waiting)
        m.d.sync += [
            last_open.eq(self.plan.period - self.sensor.guard),
            self.timing.running.eq(in_period),
            self.timing.start.eq(in_period & (state.cycle == 0)),
            self.timing.wrap.eq(state.wrap),
            self.timing.may_open.eq(in_period & (state.cycle < last_open)),
            self.timing.shift.eq(state.shift),
        ]
        laser = Signal(LEAD - 1)
        m.d.sync += [laser.eq((laser << 1) | self.timing.start), self.laser.eq(laser[-1])]
        # `first` comes one cycle before `timing` shows cycle 0, which is LEAD + 1 cycles before the ports.
        until_begin = Signal(LEAD + latency.FRAME_START - HEAD_TO_GRANT)
        m.d.sync += [until_begin.eq((until_begin << 1) | state.first), self.frame_begin.eq(until_begin[-1])]

    def _end(self, m):
        """End the frame: wait until nothing more is stored, then until everything is delivered; then `done`.

        It is delivered for `SETTLED` cycles, so that the threshold controllers know their budgets.
        """
        state = self.state
        state.number = number = Voted(m, "number_kept", bus.PULSE_BITS)
        m.d.comb += self.number.eq(number.value)
        m.d.sync += [
            state.delivered.eq(Cat(1, state.delivered) & self.delivered.replicate(SETTLED)),
            self.done.eq(0),
            self.finish.eq(state.draining & (state.drained >= TO_FINISH - 1)),
            self.resting.eq(~(state.start.any() | state.active | state.draining | self.done)),
        ]
        with m.If(state.draining & (state.drained < TO_FINISH)):
            m.d.sync += state.drained.eq(state.drained + 1)
        # In the cycle after the last period both are set; after an upset, it may be only one of them.
        with m.If((state.active | state.wrap) & ~state.running & ~state.draining):
            m.d.sync += [state.draining.eq(1), state.drained.eq(1)]
        with m.If(self.finish & state.delivered[-1]):
            m.d.sync += [
                self.finish.eq(0),
                state.active.eq(0),
                state.draining.eq(0),
                state.drained.eq(0),
                self.done.eq(1),
            ]
            m.d.comb += number.next.eq(number.value + 1)
        with m.If(state.restart):
            m.d.sync += [self.finish.eq(0), state.draining.eq(0), state.drained.eq(0)]
