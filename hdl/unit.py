# SPDX-License-Identifier: Apache-2.0
"""Blocks that are emitted once and instantiated: the hierarchy of the Verilog is the hierarchy of the sensor."""

from types import SimpleNamespace

from amaranth.hdl import ClockSignal, Instance, Module, ResetInserter, ResetSignal, Signal
from amaranth.lib import wiring


class Unit(wiring.Component):
    """A block with a stable Verilog name. `unit_name` differs where parameters beyond the sensor's differ.

    state: registers and what else is inside, by name, for those who state something about them; `elaborate` makes it.
    """

    unit_name: str
    state: SimpleNamespace
    clocked = True  # has the ports clk and rst
    _MustUse__silence = True  # an instance may stand for the unit, which Amaranth would report as forgotten

    def flat_ports(self) -> dict[str, tuple[wiring.Flow, Signal]]:
        """Port name in the Verilog -> (direction, signal)."""
        return {"__".join(map(str, path)): (member.flow, value) for path, member, value in self.signature.flatten(self)}


class Export:
    """An elaboration platform: units become instances, and are noted in `units` to be emitted by themselves."""

    def __init__(self):
        self.units: dict[str, Unit] = {}


def place(m: Module, name: str, unit: Unit, platform, reset=None) -> Unit:
    """Puts `unit` into `m`: whole, or under an `Export` platform as an instance. `reset` replaces the domain's reset."""
    if not isinstance(platform, Export):
        m.submodules[name] = unit if reset is None else ResetInserter(reset)(unit)
        return unit
    platform.units.setdefault(unit.unit_name, unit)
    ports = {f"{'i' if flow is wiring.In else 'o'}_{port}": value for port, (flow, value) in unit.flat_ports().items()}
    if unit.clocked:
        ports |= {"i_clk": ClockSignal(), "i_rst": ResetSignal() if reset is None else reset}
    m.submodules[name] = Instance(unit.unit_name, **ports)
    return unit
