# SPDX-License-Identifier: Apache-2.0
"""Units: blocks that are emitted once and instantiated, so the Verilog has the hierarchy of the sensor."""

from typing import Any

from amaranth.hdl import (
    ClockSignal,
    DomainRenamer,
    Instance,
    IOPort,
    IOValue,
    Module,
    ResetInserter,
    ResetSignal,
    Signal,
    Value,
    ValueLike,
)
from amaranth.lib import wiring
from attrs import field, frozen


@frozen
class Port:
    """A port of a unit in the Verilog."""

    name: str
    width: int
    is_input: bool


class Unit(wiring.Component):
    """A block with a stable Verilog name. Variants that differ by more than the sensor need different `unit_name`s.

    Inner signals and registers that several functions or a proof read are attributes.
    """

    unit_name: str
    clocked = True  # has the ports clk and rst
    separator = "__"  # in the Verilog, between the names of an interface and of its members
    _MustUse__silence = True  # an instance may replace a unit; Amaranth would warn of the unused unit

    def __init__(self, **ports: Any):
        super().__init__(ports)
        for name, (_, signal) in self.flat_ports().items():
            signal.name = name

    def inner(self, names: str, shape: Any = 1, **options: Any) -> None:
        """Make inner signals or registers of one shape, which become attributes with these names."""
        for name in names.split():
            setattr(self, name, Signal(shape, name=name, **options))

    def for_cells(self) -> str | None:
        """Return the block's other Verilog for standard cells, or None."""
        return None

    def flat_ports(self) -> dict[str, tuple[wiring.Flow, Signal]]:
        """Port name in the Verilog -> (direction, signal); without clock and reset."""
        return {
            self.separator.join(map(str, path)): (member.flow, Value.cast(value))
            for path, member, value in self.signature.flatten(self)
        }

    def outputs(self) -> dict[str, Signal]:
        """Return the outputs by name."""
        return {name: signal for name, (flow, signal) in self.flat_ports().items() if flow is wiring.Out}

    def fed(self, nets: dict[str, Any]) -> dict[str, Any]:
        """Return those of the nets that have the name of an input."""
        inputs = {name for name, (flow, _) in self.flat_ports().items() if flow is wiring.In}
        return {name: net for name, net in nets.items() if name in inputs}

    def ports(self) -> list[Port]:
        """Return the ports in the Verilog, without clock and reset."""
        return [Port(name, len(value), flow is wiring.In) for name, (flow, value) in self.flat_ports().items()]


@frozen
class Export:
    """Elaboration platform that turns units into instances and collects them in `units`, to be emitted separately.

    pads: inputs of the emitted unit that go straight to an instance. Amaranth numbers the bits of all other inputs
    together, with 16 bits, which is too little for the SPADs of a large sensor.
    """

    units: dict[str, Unit] = field(factory=dict)
    pads: dict[str, IOPort] = field(factory=dict)

    def pad(self, name: str, width: int) -> IOPort:
        """Return the input `name` of the emitted unit as a pad."""
        return self.pads.setdefault(name, IOPort(width, name=name))


def place(
    m: Module, name: str, unit: Unit, platform, reset=None, domain: str = "sync", **inputs: ValueLike | IOPort
) -> Unit:
    """Put `unit` into `m`, as a submodule or, under an `Export` platform, as an instance.

    reset: instead of the domain's; domain: of the unit's clock. inputs: drivers of the unit's inputs of these names, in full
    width; the caller connects the other ports.
    """
    ports = unit.flat_ports()
    given = {port: value if isinstance(value, IOValue) else Value.cast(value) for port, value in inputs.items()}
    for port, value in given.items():
        flow, signal = ports[port]
        assert flow is wiring.In, f"{unit.unit_name}: {port} is an output"
        assert len(value) == len(signal), f"{unit.unit_name}: {port} has {len(signal)} bits, not {len(value)}"
    if not isinstance(platform, Export):
        inner = unit if reset is None else ResetInserter(reset)(unit)
        m.submodules[name] = inner if domain == "sync" else DomainRenamer(domain)(inner)
        m.d.comb += [ports[port][1].eq(value) for port, value in given.items()]
        return unit
    platform.units.setdefault(unit.unit_name, unit)
    connected = {
        f"{'i' if flow is wiring.In else 'o'}_{port}": given.get(port, signal) for port, (flow, signal) in ports.items()
    }
    if unit.clocked:
        connected |= {"i_clk": ClockSignal(domain), "i_rst": ResetSignal(domain) if reset is None else reset}
    m.submodules[name] = Instance(unit.unit_name, **connected)
    return unit
