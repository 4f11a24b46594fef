# SPDX-License-Identifier: Apache-2.0
"""TDC: one always-on coarse counter and the phase decode of two independent sampling lines.

The paper (III-A): two subgroups "share a single always-on time-to-digital converter (TDC) with
independent lines for timestamping"; the event samples its internal states. In this synchronous
view, the states are sampled in every cycle, and the first one that an event marks is decoded. Our
choice: the counter restarts with the laser trigger, so its value is the time since the trigger.
"""

from amaranth.hdl import Module, Signal
from amaranth.lib.wiring import In, Out, Signature

from ..model.contract.parameters import Sensor
from .logic import first_one
from .unit import Unit

# From the module's registered start strobe (two cycles ahead of the ports) to the decoded phase at
# stage 2.
START_TO_PHASE = 4


def line_signature(sensor: Sensor) -> Signature:
    """Return a sampling line, seen from the subgroup.

    root : out, phases, the sampled root of the tree (stage 1). any : in, an edge in the cycle;
        phase : in, its first phase; coarse : in, number of the cycle in its period (all stage 2).
    """
    return Signature(
        {
            "root": Out(sensor.phases),
            "any": In(1),
            "phase": In(sensor.phase_bits),
            "coarse": In(sensor.coarse_bits),
        }
    )


class Tdc(Unit):
    """TDC of a module.

    Ports
    -----
    start : in, first cycle of a period, registered in the module
    line_0, line_1 : sampling lines (`line_signature`, seen from the other side); latency one cycle;
        each is independent of the other

    Reset sets the coarse counter to 0; from then on it counts, with or without a frame.
    """

    def __init__(self, sensor: Sensor, lines: int = 2):
        self.sensor = sensor
        self.lines = lines
        self.unit_name = "coincid_tdc" if lines == 2 else f"coincid_tdc_{lines}"
        super().__init__(
            start=In(1), **{f"line_{k}": In(line_signature(sensor)) for k in range(lines)}
        )

    def elaborate(self, platform):
        m = Module()
        coming = Signal(START_TO_PHASE - 1)
        coarse = Signal(self.sensor.coarse_bits)
        m.d.sync += [coming.eq((coming << 1) | self.start), coarse.eq(coarse + 1)]
        with m.If(coming[-1]):
            m.d.sync += coarse.eq(0)
        for k in range(self.lines):
            line = getattr(self, f"line_{k}")
            some, phase = first_one(m, line.root, f"first_{k}")
            m.d.comb += line.coarse.eq(coarse)
            m.d.sync += [line.any.eq(some), line.phase.eq(phase)]
        return m
