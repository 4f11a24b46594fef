# SPDX-License-Identifier: Apache-2.0
"""TDC of the asynchronous view: a multiphase generator and a free-running Gray coarse counter,
sampled by events.

The paper (III-A): two subgroups "share a single always-on time-to-digital converter (TDC) with
independent lines for timestamping"; the event samples its internal states. The Gray code, and the
copy half a cycle later that resolves a count in transition, are our choice.
"""

from amaranth.hdl import ClockSignal, Const, Instance, Module, Signal
from amaranth.lib.wiring import In, Out, Signature

from ...model.contract.parameters import Sensor
from ..tdc import START_TO_PHASE
from ..unit import Unit
from .circuit import ERROR_BITS, Circuit, lag_fs, sample

STAGE = 3  # of the cycle that `base` and `cycle` describe: one later than in the polyphase line


def line_signature(sensor: Sensor) -> Signature:
    """Return a sampling line, seen from the subgroup: the sampled signals, and the cycle number at
    stage 3.

    phases : in, phases / 2 taps, each high for half a cycle from its phase boundary on; they lag
        the clock by `lag_fs`
    gray_a, gray_b : in, coarse count in Gray code: from the cycle's start, and half a cycle later;
        half : in, lowest bit of gray_b
    mark, shut, wipe : in, strobes (docs/async.md)
    base : in, coarse count in cycle 0 of the period; cycle : in, number of the cycle in its period
        (stage 3)
    """
    bits = sensor.coarse_bits
    return Signature(
        {
            "phases": In(sensor.phases // 2),
            "gray_a": In(bits),
            "gray_b": In(bits),
            "half": In(1),
            "mark": In(1),
            "shut": In(1),
            "wipe": In(1),
            "base": In(bits),
            "cycle": In(bits),
        }
    )


class AsyncTdc(Unit):
    """TDC of a module.

    Ports
    -----
    start : in, first cycle of a period, registered in the module
    line_0, line_1 : sampling lines (`line_signature`, seen from the other side); neither disturbs
        the other

    Reset sets the coarse counter to 0. The counter never stops and never restarts, so only one bit
    of its Gray code changes at a time.
    """

    def __init__(self, sensor: Sensor, circuit: Circuit, lines: int = 2):
        self.sensor, self.circuit, self.lines = sensor, circuit, lines
        self.unit_name = "coincid_async_tdc" if lines == 2 else f"coincid_async_tdc_{lines}"
        super().__init__(
            start=In(1), **{f"line_{k}": Out(line_signature(sensor).flip()) for k in range(lines)}
        )

    def elaborate(self, platform):
        m = Module()
        sensor = self.sensor
        bits = sensor.coarse_bits
        phases = Signal(sensor.phases // 2)
        mark = Signal()
        shut = Signal()
        wipe = Signal()
        errors = self.circuit.mismatch_fs or (0,) * sensor.phases
        m.submodules.generator = Instance(
            "coincid_phases",
            p_PHASES=sensor.phases,
            p_CLOCK_FS=self.circuit.clock_fs,
            p_LAG_FS=lag_fs(sensor),
            p_MISMATCH_FS=Const(
                sum((e % (1 << ERROR_BITS)) << ERROR_BITS * k for k, e in enumerate(errors)),
                ERROR_BITS * len(errors),
            ),
            i_clk=ClockSignal(),
            o_phases=phases,
            o_mark=mark,
            o_shut=shut,
            o_wipe=wipe,
        )
        count = Signal(bits)
        gray = Signal(bits)  # the same in Gray code
        following = Signal(bits)
        m.d.comb += following.eq(count + 1)
        m.d.sync += [
            count.eq(following),
            gray.eq(following ^ (following >> 1)),
        ]
        gray_a = sample(m, "gray_a", phases[0], gray)
        gray_b = sample(m, "gray_b", ~phases[0], gray)
        half = sample(m, "half", ~phases[0], count[0])

        # The same count for the cycle of stage 3, and its value in cycle 0 of the period.
        coming = Signal(START_TO_PHASE)
        stage_3 = Signal(bits, init=-STAGE % (1 << bits))
        base = Signal(bits)
        cycle = Signal(bits)
        m.d.sync += [
            coming.eq((coming << 1) | self.start),
            stage_3.eq(stage_3 + 1),
            cycle.eq(cycle + 1),
        ]
        with m.If(coming[-1]):
            m.d.sync += [
                cycle.eq(0),
                base.eq(stage_3 + 1),
            ]
        for k in range(self.lines):
            line = getattr(self, f"line_{k}")
            m.d.comb += [
                line.phases.eq(phases),
                line.gray_a.eq(gray_a),
                line.gray_b.eq(gray_b),
                line.half.eq(half),
                line.mark.eq(mark),
                line.shut.eq(shut),
                line.wipe.eq(wipe),
                line.base.eq(base),
                line.cycle.eq(cycle),
            ]
        return m
