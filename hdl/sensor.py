# SPDX-License-Identifier: Apache-2.0
"""The sensor: an array of modules, a register front, a sequencer, and one readout per stream.

The wiring is a table (`Netlist`), because it is used twice: as Verilog text for any size (an Amaranth top cannot have
65,536 bits of ports), and as an Amaranth design for Amaranth's own simulator.
"""

from typing import Any

from amaranth.hdl import Cat, Module, Signal, Value
from amaranth.lib import wiring
from attrs import define, field, frozen

from ..model.contract.parameters import TOP, Sensor
from .controller import Controller
from .deserialiser import PHASES_MAX, Deserialiser
from .logic import any_of
from .module import SensorModule
from .readout import Readout
from .registers import Registers
from .sequencer import Sequencer
from .subgroup import own_ports
from .unit import Unit
from .views import POLYPHASE

FPGA_TOP = "coincid_fpga"
CORE = "coincid_core"
COMBINE = {"or": " | ", "and": " & ", "cat": ", "}  # how nets are combined; cat: the first has the lowest bits


@frozen
class Port:
    """A port of the top module."""

    name: str
    width: int
    is_input: bool


@define
class Netlist:
    """Table of a top module's wiring.

    ports: of the top. instances: (name, unit, {unit's port: net or constant}). nets: name -> width. joins: net ->
    (operation, nets).
    """

    ports: list[Port] = field(factory=list)
    instances: list[tuple[str, Unit, dict[str, Any]]] = field(factory=list)
    nets: dict[str, int] = field(factory=dict)
    joins: dict[str, tuple[str, list[Any]]] = field(factory=dict)

    def add(self, name: str, unit: Unit, **nets) -> None:
        """Add an instance. Ports that are not in `nets` connect to the net of the same name."""
        ports = {port: nets.pop(port, port) for port in unit.flat_ports()}
        assert not nets, f"{unit.unit_name} has no port {next(iter(nets))}"
        for port, net in ports.items():
            if isinstance(net, str):
                width = len(Value.cast(unit.flat_ports()[port][1]))
                assert self.nets.setdefault(net, width) == width, f"{net}: widths differ"
        self.instances.append((name, unit, ports))

    def join(self, net: str, operation: str, parts: list[str]) -> None:
        """Make `net` the OR, AND or concatenation of `parts`."""
        widths = [self.nets[part] for part in parts]
        self.nets.setdefault(net, sum(widths) if operation == "cat" else widths[0])
        self.joins[net] = operation, parts


def netlist(sensor: Sensor, levels: bool = False, view=POLYPHASE) -> Netlist:
    """Return the sensor's wiring. view: from `views.py`.

    levels: the ports are SPAD lines instead of edge words, and every subgroup has a deserialiser.
    """
    n = Netlist()
    subgroups = range(sensor.subgroups)

    def flat(unit, member, prefix):
        return {
            port: f"{prefix}_{port.split('__')[-1]}" for port in unit.flat_ports() if port.startswith(f"{member}__")
        }

    registers, sequencer = Registers(sensor), Sequencer(sensor)
    n.add("registers", registers, **flat(registers, "s_axi", "s_axi"))
    n.add("sequencer", sequencer)
    for k in range(0, sensor.subgroups, 2):
        lines = min(2, sensor.subgroups - k)
        own = {f"{name}_{j}": f"{name}_{k + j}" for j in range(lines) for name in own_ports(sensor)}
        own |= {f"words_{j}": f"spad_{k + j}" for j in range(lines)}
        own |= {f"send_{j}": f"send_of_{sensor.stream_of(k + j)}" for j in range(lines)}
        n.add(f"module_{k // 2}", SensorModule(sensor, lines, view), number=k // 2, **own)
    for stream in range(sensor.streams):
        members = sensor.stream_subgroups(stream)
        readout = Readout(sensor, len(members))
        for name in ("stored", "record_stored"):
            n.join(f"{name}_of_{stream}", "cat", [f"{name}_{s}" for s in members])
        for name in ("valid", "beat", "beat_controlled"):
            n.join(f"{name}_of_{stream}", "or", [f"{name}_{s}" for s in members])
        of_stream = {
            name: f"{name}_of_{stream}"
            for name in (
                "stored", "record_stored", "valid", "beat", "beat_controlled", "grant", "send", "delivered", "counted"
            )
        }  # fmt: skip
        n.add(f"readout_{stream}", readout, **of_stream, **flat(readout, "m_axis", sensor.stream_name(stream)))
        n.add(
            f"controller_{stream}",
            Controller(sensor),
            share=f"share_{stream}",
            counted=f"counted_of_{stream}",
            budget=f"budget_{stream}",
        )
        for i, s in enumerate(members):
            n.nets[f"grant_{s}"] = 1
            n.joins[f"grant_{s}"] = (
                ("bit", [f"grant_of_{stream}", i]) if len(members) > 1 else ("or", [f"grant_of_{stream}"])
            )
    n.join("delivered", "and", [f"delivered_of_{stream}" for stream in range(sensor.streams)])
    n.join("data", "or", [f"data_{s}" for s in subgroups])
    n.join("gate_late", "or", [f"gate_late_{s}" for s in subgroups])
    n.join("settings_upset", "or", [f"upset_{s}" for s in subgroups])
    n.join("spad_gate", "cat", [f"spad_gate_{s}" for s in subgroups])

    inputs: list[str] = []
    outputs = ["laser", "spad_gate"]
    for port, (flow, _) in registers.flat_ports().items():
        if port.startswith("s_axi__"):
            (inputs if flow is wiring.In else outputs).append(f"s_axi_{port.split('__')[1]}")
    for stream in range(sensor.streams):
        name = sensor.stream_name(stream)
        inputs.append(f"{name}_tready")
        outputs += [f"{name}_tdata", f"{name}_tvalid", f"{name}_tlast"]
    if levels:
        deserialiser = Deserialiser(sensor)
        for s in subgroups:
            n.add(f"deserialiser_{s}", deserialiser, lines=f"line_{s}", words=f"spad_{s}", clocks="phase_clocks")
        inputs += ["phase_clocks", *(f"line_{s}" for s in subgroups)]
    else:
        inputs += [f"spad_{s}" for s in subgroups]
    n.ports = [Port(name, n.nets[name], True) for name in inputs] + [
        Port(name, n.nets[name], False) for name in outputs
    ]
    return n


def _range(width: int) -> str:
    return f"[{width - 1}:0] " if width > 1 else ""


def verilog(sensor: Sensor, view=POLYPHASE) -> tuple[str, dict[str, Unit]]:
    """Return the top module as Verilog text, and the units that it instantiates, by name."""
    n = netlist(sensor, view=view)
    what = f"SPAD sensor of {sensor.rows} x {sensor.cols} pixels: wiring of its blocks."
    return module_text(TOP, what, n.ports, n.instances, n.nets, n.joins)


def has_fpga_top(sensor: Sensor) -> bool:
    """Return whether the clocks of an FPGA's PLL can sample the SPAD lines."""
    return sensor.phases <= PHASES_MAX


def fpga_verilog(sensor: Sensor) -> tuple[str, dict[str, Unit]]:
    """Return the top module for an FPGA, the sensor behind deserialisers, and the units that it instantiates."""
    n = netlist(sensor, levels=True)
    what = f"SPAD sensor of {sensor.rows} x {sensor.cols} pixels behind deserialisers: wiring of its blocks."
    return module_text(FPGA_TOP, what, n.ports, n.instances, n.nets, n.joins)


def core_verilog(sensor: Sensor) -> tuple[str, dict[str, Unit]]:
    """Return the sensor without its modules, and the units, for simulations in which a program wires the modules itself.

    Its ports are those of the top and, per stream k, the signals between the modules and its readout, named as the nets.
    """
    n = netlist(sensor)
    instances = [instance for instance in n.instances if not isinstance(instance[1], SensorModule)]
    driven = {
        name for _, unit, ports in instances for port, name in ports.items() if unit.flat_ports()[port][0] is wiring.Out
    }
    used = {
        name for _, unit, ports in instances for port, name in ports.items() if unit.flat_ports()[port][0] is wiring.In
    }
    joins = {net: n.joins[net] for net in ("delivered",)}
    ports = [Port(name, n.nets[name], True) for name in sorted(used - driven - joins.keys())]
    ports += [Port(name, n.nets[name], False) for name in sorted(driven)]
    return module_text(
        CORE, "SPAD sensor: registers, sequencer and readout.", ports, instances, {"delivered": 1}, joins
    )


def module_text(name, comment, ports, instances, nets, joins) -> tuple[str, dict[str, Unit]]:
    """Return a module of instances and joined nets as Verilog text, and the units that it instantiates."""
    port_names = {port.name for port in ports}
    lines = [f"// {comment}", f"module {name} (", "  input clk,", "  input rst,"]
    lines += [f"  {'input' if port.is_input else 'output'} {_range(port.width)}{port.name}," for port in ports]
    lines[-1] = lines[-1].rstrip(",")
    lines.append(");")
    lines += [f"  wire {_range(width)}{net};" for net, width in sorted(nets.items()) if net not in port_names]
    lines += [f"  assign {net} = {_expression(operation, parts)};" for net, (operation, parts) in sorted(joins.items())]
    units: dict[str, Unit] = {}
    for instance, unit, connections in instances:
        units.setdefault(unit.unit_name, unit)
        lines.append(f"  {unit.unit_name} {instance} (")
        for port, net in ({"clk": "clk", "rst": "rst"} | connections).items():
            if not isinstance(net, str):
                net = f"{len(Value.cast(unit.flat_ports()[port][1]))}'d{net}"
            lines.append(f"    .{port}({net}),")
        lines[-1] = lines[-1].rstrip(",")
        lines.append("  );")
    lines.append("endmodule")
    return "\n".join(lines) + "\n", units


def _expression(operation: str, parts: list[Any]) -> str:
    if operation == "bit":
        return f"{parts[0]}[{parts[1]}]"
    if operation == "constant":
        return str(parts[0])
    if operation == "cat":
        return "{" + ", ".join(reversed(parts)) + "}"
    while len(parts) > 1:  # balanced, so that the text has logarithmic depth
        pairs = [f"({a}{COMBINE[operation]}{b})" for a, b in zip(parts[::2], parts[1::2])]
        parts = pairs + parts[len(parts) & ~1 :]
    return parts[0]


class FlatSensor(wiring.Component):
    """The sensor as one Amaranth design, for Amaranth's simulator.

    It has the ports of the Verilog top. Amaranth's port width limits its size.
    """

    def __init__(self, sensor: Sensor):
        self.netlist = netlist(sensor)
        super().__init__(
            {port.name: (wiring.In if port.is_input else wiring.Out)(port.width) for port in self.netlist.ports}
        )

    def elaborate(self, platform):
        m = Module()
        n = self.netlist
        inputs = {port.name for port in n.ports if port.is_input}
        nets = {
            name: getattr(self, name) if name in inputs else Signal(width, name=name) for name, width in n.nets.items()
        }
        for net, (operation, parts) in n.joins.items():
            if operation == "bit":
                value = nets[parts[0]][parts[1]]
            elif operation == "cat":
                value = Cat(nets[part] for part in parts)
            else:
                values = [nets[part] if operation == "or" else ~nets[part] for part in parts]
                value = any_of(m, values, f"{net}_join")
                value = value if operation == "or" else ~value
            m.d.comb += nets[net].eq(value)
        for name, unit, connections in n.instances:
            m.submodules[name] = unit
            for port, (flow, signal) in unit.flat_ports().items():
                net = nets[connections[port]] if isinstance(connections[port], str) else connections[port]
                signal = Value.cast(signal)
                m.d.comb += signal.eq(net) if flow is wiring.In else net.eq(signal)
        m.d.comb += [getattr(self, port.name).eq(nets[port.name]) for port in n.ports if not port.is_input]
        return m
