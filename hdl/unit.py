# SPDX-License-Identifier: Apache-2.0
"""Units: blocks that are emitted once and instantiated, so the Verilog has the hierarchy of the sensor."""

from types import SimpleNamespace

from amaranth.hdl import ClockSignal, Instance, Module, ResetInserter, ResetSignal, Signal
from amaranth.lib import wiring


class Unit(wiring.Component):
    """A block with a stable Verilog name. Variants by other parameters than the sensor's need different `unit_name`s.

    state: inner registers and signals by name, for proofs and tests; `elaborate` sets it.
    """

    unit_name: str
    state: SimpleNamespace
    clocked = True  # has the ports clk and rst
    _MustUse__silence = True  # an unused unit is fine where an instance replaces it; Amaranth would warn of it

    def flat_ports(self) -> dict[str, tuple[wiring.Flow, Signal]]:
        """Port name in the Verilog -> (direction, signal)."""
        return {"__".join(map(str, path)): (member.flow, value) for path, member, value in self.signature.flatten(self)}


class Export:
    """Elaboration platform that turns units into instances and collects them in `units`, to be emitted separately."""

    def __init__(self):
        self.units: dict[str, Unit] = {}


def place(m: Module, name: str, unit: Unit, platform, reset=None) -> Unit:
    """Put `unit` into `m`, as a submodule or, under an `Export` platform, as an instance. reset: replaces the domain's."""
    if not isinstance(platform, Export):
        m.submodules[name] = unit if reset is None else ResetInserter(reset)(unit)
        return unit
    platform.units.setdefault(unit.unit_name, unit)
    ports = {f"{'i' if flow is wiring.In else 'o'}_{port}": value for port, (flow, value) in unit.flat_ports().items()}
    if unit.clocked:
        ports |= {"i_clk": ClockSignal(), "i_rst": ResetSignal() if reset is None else reset}
    m.submodules[name] = Instance(unit.unit_name, **ports)
    return unit
