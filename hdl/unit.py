# SPDX-License-Identifier: Apache-2.0
"""Units: blocks that are emitted once and instantiated, so the Verilog has the hierarchy of the
sensor.
"""

from typing import Any

from amaranth.hdl import (
    ClockSignal,
    DomainRenamer,
    Fragment,
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
from amaranth.hdl._ast import SignalSet
from amaranth.hdl._ir import Design, PortDirection
from amaranth.hdl._mem import MemoryInstance
from amaranth.lib import wiring
from attrs import field, frozen


@frozen
class Port:
    """A port of a unit in the Verilog."""

    name: str
    width: int
    is_input: bool


class Unit(wiring.Component):
    """A block with a stable Verilog name.

    Variants that differ by more than the sensor need different `unit_name`s.

    Inner signals and registers that several functions or a proof read are attributes.
    """

    unit_name: str
    clocked = True  # has the ports clk and rst
    separator = "__"  # in the Verilog, between the names of an interface and of its members
    _MustUse__silence = (
        True  # an instance may replace a unit; Amaranth would warn of the unused unit
    )

    def __init__(self, **ports: Any):
        super().__init__(ports)
        for name, (_, signal) in self.flat_ports().items():
            signal.name = name

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
        return {
            name: signal for name, (flow, signal) in self.flat_ports().items() if flow is wiring.Out
        }

    def ports(self) -> list[Port]:
        """Return the ports in the Verilog, without clock and reset."""
        return [
            Port(name, len(value), flow is wiring.In)
            for name, (flow, value) in self.flat_ports().items()
        ]


@frozen
class Export:
    """Elaboration platform that turns units into instances and collects them, to be emitted
    separately.

    units: by their name in the Verilog. placed: by their name inside the unit that is elaborated.
    pads: inputs of the emitted unit that go straight to an instance. Amaranth numbers the bits of
    all other inputs together, with 16 bits, which is too little for the SPADs of a large sensor.
    """

    units: dict[str, Unit] = field(factory=dict)
    placed: dict[str, Unit] = field(factory=dict)
    pads: dict[str, IOPort] = field(factory=dict)

    def pad(self, name: str, width: int) -> IOPort:
        """Return the input `name` of the emitted unit as a pad."""
        return self.pads.setdefault(name, IOPort(width, name=name))


def place(
    m: Module,
    name: str,
    unit: Unit,
    platform,
    reset=None,
    domain: str = "sync",
    soft_reset: Value | None = None,
    **inputs: ValueLike | IOPort,
) -> Unit:
    """Put `unit` into `m`, as a submodule or, under an `Export` platform, as an instance.

    reset: instead of the domain's; domain: of the unit's clock. soft_reset: resets the unit, too.
    inputs: a driver, in full width, for every input. The caller connects interfaces with
    `wiring.connect` and reads outputs as attributes of the unit. Raises `ConnectionError` for an input that does not exist or has no
    driver.
    """
    ports = unit.flat_ports()
    given = {port: _driver(value) for port, value in inputs.items()}
    _check_inputs(name, unit, given)
    if isinstance(platform, Export):
        platform.units.setdefault(unit.unit_name, unit)
        platform.placed[name] = unit
        resets = ResetSignal(domain) if reset is None else reset
        if soft_reset is not None:
            resets |= soft_reset
        m.submodules[name] = _instance(unit, given, resets, domain)
        return unit
    inner = unit
    for given_reset in (reset, soft_reset):
        if given_reset is not None:
            inner = ResetInserter(given_reset)(inner)
    m.submodules[name] = inner if domain == "sync" else DomainRenamer(domain)(inner)
    m.d.comb += [ports[port][1].eq(value) for port, value in given.items()]
    return unit


def _driver(value: ValueLike | IOPort) -> Value | IOValue:
    return value if isinstance(value, IOValue) else Value.cast(value)


def _check_inputs(name: str, unit: Unit, given: dict[str, Value | IOValue]) -> None:
    """Check that exactly the unit's inputs are given, in full width. Interfaces are not given."""
    block = f"{name} ({unit.unit_name})"
    ports = unit.flat_ports()
    for port, value in given.items():
        if port not in ports or ports[port][0] is not wiring.In:
            raise wiring.ConnectionError(f"{block} has no input `{port}`")
        width = len(ports[port][1])
        if len(value) != width:
            raise wiring.ConnectionError(f"{block}: `{port}` has {width} bits, not {len(value)}")
    for port, member in unit.signature.members.items():
        if member.is_port and member.flow is wiring.In and port not in given:
            raise wiring.ConnectionError(f"{block}: nothing drives the input `{port}`")


def _instance(unit: Unit, given: dict[str, Value | IOValue], reset, domain: str) -> Instance:
    """Return an instance of a unit."""
    connected: dict[str, Any] = {}
    for port, (flow, signal) in unit.flat_ports().items():
        if flow is wiring.In:
            connected[f"i_{port}"] = given.get(port, signal)
        else:
            connected[f"o_{port}"] = signal
    if unit.clocked:
        connected["i_clk"] = ClockSignal(domain)
        connected["i_rst"] = reset
    return Instance(unit.unit_name, **connected)


def check_drivers(unit: Unit, design: Design, placed: dict[str, Unit]) -> None:
    """Check that something drives all that an elaborated unit and the units inside it read, and its
    outputs.

    Amaranth would make what nothing drives a constant, without a word. Raises `ConnectionError`.
    """
    driven = SignalSet()
    read = SignalSet()
    _add_signals(design.fragment, driven, read)
    for _, value, direction in design.ports:
        if direction is PortDirection.Input and isinstance(value, Signal):
            driven.add(value)
    for port, (flow, signal) in unit.flat_ports().items():
        if flow is wiring.Out and len(signal) and signal not in driven:
            raise wiring.ConnectionError(f"{unit.unit_name}: nothing drives the output `{port}`")
    for name, inner in placed.items():
        for port, (flow, signal) in inner.flat_ports().items():
            is_plain = port in inner.signature.members
            if flow is wiring.In and not is_plain and signal not in driven:
                block = f"{name} ({inner.unit_name}) in {unit.unit_name}"
                raise wiring.ConnectionError(f"{block}: nothing drives the input `{port}`")
    for signal in read:
        if len(signal) and signal not in driven:
            raise wiring.ConnectionError(f"{unit.unit_name}: nothing drives `{signal.name}`")


def _add_signals(fragment: Fragment, driven: SignalSet, read: SignalSet) -> None:
    """Add the signals that a fragment drives and reads, with everything inside it."""
    for statements in fragment.statements.values():
        driven.update(statements._lhs_signals())
        read.update(statements._rhs_signals())
    if isinstance(fragment, Instance):
        for value, kind in fragment.ports.values():
            if kind == "o":
                driven.update(value._lhs_signals())
            elif isinstance(value, Value):
                read.update(value._rhs_signals())
    if isinstance(fragment, MemoryInstance):
        for port in fragment._read_ports:
            driven.update(port._data._lhs_signals())
            read.update(port._addr._rhs_signals())
        for port in fragment._write_ports:
            for value in (port._addr, port._data, port._en):
                read.update(value._rhs_signals())
    for inner, _, _ in fragment.subfragments:
        _add_signals(inner, driven, read)
