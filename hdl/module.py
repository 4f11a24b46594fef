# SPDX-License-Identifier: Apache-2.0
"""Module: subgroups 2k and 2k + 1 and the always-on TDC that they share (paper, Fig. 3: generic block of the sensor)."""

from amaranth.hdl import Cat, Signal
from amaranth.hdl import Module as Design
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from ..model.contract.parameters import Sensor
from . import bus
from .subgroup import Subgroup, own_ports, shared_ports
from .unit import Unit, place
from .views import POLYPHASE
from .voted import agreed_reset


class SensorModule(Unit):
    """Module. The sensor is an array of modules, so a simulator compiles the module only once.

    Ports
    -----
    `shared_ports` of the subgroups; for line k `own_ports` with the suffix _k; number : in, the module's number.
    Every input goes straight into a register, and every output comes from one.

    view: view of the front end, from `views.py`. `lines` = 1 makes the last module of an odd number of subgroups. Reset
    is registered, here and in each subgroup, so it acts one cycle later.
    """

    def __init__(self, sensor: Sensor, lines: int = 2, view=POLYPHASE):
        self.sensor, self.lines, self.view = sensor, lines, view
        self.unit_name = f"{view.prefix}module" if lines == 2 else f"{view.prefix}module_{lines}"
        super().__init__(
            shared_ports(sensor)
            | {f"{name}_{k}": member for k in range(lines) for name, member in own_ports(sensor, view).items()}
            | {"number": In(bus.SUBGROUP_BITS - 1)}
        )

    def elaborate(self, platform):
        m = Design()
        sensor = self.sensor
        start = Signal(reset_less=True)
        m.d.sync += start.eq(self.timing.start)
        tdc = place(m, "tdc", self.view.tdc(sensor, self.lines), platform, agreed_reset(m))
        m.d.comb += tdc.start.eq(start)
        for k in range(self.lines):
            subgroup = place(m, f"subgroup_{k}", Subgroup(sensor, self.view), platform)
            m.d.comb += subgroup.subgroup.eq(Cat(k, self.number))
            m.d.comb += [getattr(subgroup, name).eq(getattr(self, name)) for name in shared_ports(sensor)]
            for name, member in own_ports(sensor, self.view).items():
                inner, outer = getattr(subgroup, name), getattr(self, f"{name}_{k}")
                m.d.comb += inner.eq(outer) if member.flow is In else outer.eq(inner)
            wiring.connect(m, subgroup.line, getattr(tdc, f"line_{k}"))
        return m
