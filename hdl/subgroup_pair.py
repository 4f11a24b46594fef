# SPDX-License-Identifier: Apache-2.0
"""Module: subgroups 2k and 2k + 1 and the always-on TDC that they share (paper, Fig. 3: generic
block of the sensor).
"""

from amaranth.hdl import Cat, Module, Signal, ValueLike
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from ..model.contract.parameters import Sensor
from . import bus
from .front_end_views import POLYPHASE
from .subgroup import OwnPorts, Subgroup, own_ports, shared_ports
from .unit import Unit, place
from .voted import agreed_reset


class SensorModule(Unit):
    """Module. The sensor is an array of modules, so a simulator compiles the module only once.

    Ports
    -----
    `shared_ports` of the subgroups; for line k `own_ports` with the suffix _k; number : in, the
    module's number; test_enable : in, opens clock gates and latches for a test of the chip. Every
    other input goes straight into a register, and every output comes from one.

    view: view of the front end, from `front_end_views.py`. `lines` = 1: the last module of an odd
    number of subgroups. Reset is registered, here and in each subgroup, so it acts one cycle later.
    """

    def __init__(self, sensor: Sensor, lines: int = 2, view=POLYPHASE):
        self.sensor, self.lines, self.view = sensor, lines, view
        self.unit_name = f"{view.prefix}module" if lines == 2 else f"{view.prefix}module_{lines}"
        own = {
            f"{name}_{k}": member
            for k in range(lines)
            for name, member in own_ports(sensor, view).items()
        }
        super().__init__(
            **shared_ports(sensor),
            **own,
            number=In(bus.SUBGROUP_BITS - 1),
            test_enable=In(1),
        )

    def elaborate(self, platform):
        m = Module()
        numbers = [Cat(k, self.number) for k in range(self.lines)]
        own = [OwnPorts(self, f"_{k}") for k in range(self.lines)]
        _put_lines(m, platform, self, numbers, own)
        return m


class Slice(Unit):
    """One subgroup with its line of the TDC, which a bit-sliced simulation plays once for all
    subgroups of the array.

    Ports: `shared_ports` and `own_ports` of the subgroup; number : in, the subgroup's; test_enable :
    in. The lines of a module's TDC are independent, and both use the same registered start and reset. So an array of
    slices equals an array of modules.
    """

    unit_name = "coincid_slice"

    def __init__(self, sensor: Sensor, view=POLYPHASE):
        self.sensor, self.view = sensor, view
        super().__init__(
            **shared_ports(sensor),
            **own_ports(sensor, view),
            number=In(bus.SUBGROUP_BITS),
            test_enable=In(1),
        )

    def elaborate(self, platform):
        m = Module()
        _put_lines(m, platform, self, [self.number], [OwnPorts(self)])
        return m


def _put_lines(
    m: Module, platform, unit: Unit, numbers: list[ValueLike], own: list[OwnPorts]
) -> None:
    """Put a TDC and its subgroups into `m`.

    numbers: of the subgroups; own: the unit's ports of each.
    """
    sensor = unit.sensor
    view = unit.view
    start = Signal(reset_less=True)
    m.d.sync += start.eq(unit.timing.start)
    tdc = view.tdc(sensor, len(numbers))
    place(m, "tdc", tdc, platform, agreed_reset(m), start=start)
    for k, (number, ports) in enumerate(zip(numbers, own, strict=True)):
        subgroup = Subgroup(sensor, view)
        place(
            m,
            f"subgroup_{k}",
            subgroup,
            platform,
            subgroup=number,
            command=unit.command,
            period=unit.period,
            frame=unit.frame,
            timing=unit.timing,
            words=ports.words,
            grant=ports.grant,
            send=ports.send,
            test_enable=unit.test_enable,
        )
        wiring.connect(m, subgroup.line, getattr(tdc, f"line_{k}"))
        m.d.comb += [
            ports.spad_gate.eq(subgroup.spad_gate),
            ports.valid.eq(subgroup.valid),
            ports.beat.eq(subgroup.beat),
            ports.beat_controlled.eq(subgroup.beat_controlled),
            ports.stored.eq(subgroup.stored),
            ports.record_stored.eq(subgroup.record_stored),
            ports.data.eq(subgroup.data),
            ports.gate_late.eq(subgroup.gate_late),
            ports.upset.eq(subgroup.upset),
        ]
