# SPDX-License-Identifier: Apache-2.0
"""The sensor: an array of modules, a register front, a sequencer, and per stream one readout and one threshold controller."""

from collections.abc import Callable
from functools import partial
from typing import Any

from amaranth.hdl import Cat, Const, Module, ValueLike
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, Signature

from ..model.contract.parameters import TOP, Sensor
from ..model.contract.registers import DATA_BITS
from . import bus
from .axi import LITE, STREAM
from .controller import Controller
from .deserialiser import PHASES_MAX, Deserialiser
from .front_end_views import POLYPHASE
from .logic import any_of
from .readout import Readout
from .registers import Registers
from .sequencer import Sequencer
from .subgroup import own_ports, shared_ports
from .subgroup_pair import SensorModule
from .unit import Export, Unit, place

FPGA_TOP = "coincid_fpga"
CORE = "coincid_core"
LISTED = ("stored", "record_stored")  # reach a readout with one bit per subgroup
COMBINED = ("valid", "beat", "beat_controlled")  # reach a readout as the OR of its subgroups'
GRANTED = ("grant", "send")  # from a readout to its subgroups
ANSWERED = ("data", "gate_late", "settings_upset")  # reach the registers as the OR of all subgroups'

Put = Callable[..., Any]  # puts a unit into a design as `place` does: put(name, unit, **inputs)


def outer_ports(sensor: Sensor) -> dict[str, Any]:
    """Ports of the sensor towards its software: registers, laser, streams."""
    streams = {sensor.stream_name(k): Out(STREAM) for k in range(sensor.streams)}
    return {"s_axi": In(LITE), "laser": Out(1)} | streams


def inner_ports(sensor: Sensor) -> dict[str, Any]:
    """Ports of the core towards the modules.

    `shared_ports`, as outputs; data, gate_late, settings_upset : in, OR of all subgroups'; per stream k, of its
    subgroups: `LISTED`_of_k, `COMBINED`_of_k : in; `GRANTED`_of_k : out.
    """
    ports = {name: Out(member.shape) for name, member in shared_ports(sensor).items()}
    ports |= {"data": In(DATA_BITS), "gate_late": In(1), "settings_upset": In(1)}
    own = own_ports(sensor)
    for k in range(sensor.streams):
        n = len(sensor.stream_subgroups(k))
        ports |= {f"{name}_of_{k}": In(n) for name in LISTED}
        ports |= {f"{name}_of_{k}": In(own[name].shape) for name in COMBINED}
        ports |= {f"grant_of_{k}": Out(n), f"send_of_{k}": Out(bus.Send)}
    return ports


class Core(Unit):
    """The sensor without its modules, for simulations in which a program wires the modules itself.

    Ports: `outer_ports`, `inner_ports`.
    """

    unit_name, separator = CORE, "_"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(**outer_ports(sensor), **inner_ports(sensor))

    def elaborate(self, platform):
        m = Module()
        wire_core(m, partial(place, m, platform=platform), self.sensor, self, self)
        return m


class SensorTop(Unit):
    """The sensor.

    Ports: `outer_ports`; spad_gate : out, bit s is the gate of subgroup s; spad_s : in, SPADs of subgroup s in the view's
    form.

    levels: instead of spad_s, line_s : in, levels of the SPADs of subgroup s, which has a deserialiser, and
    phase_clocks : in, its clocks.
    """

    separator = "_"

    def __init__(self, sensor: Sensor, view=POLYPHASE, levels: bool = False):
        self.sensor, self.view, self.levels = sensor, view, levels
        self.unit_name = FPGA_TOP if levels else TOP
        self.spads = {
            f"{'line' if levels else 'spad'}_{s}": sensor.pixels if levels else view.spad_bits(sensor)
            for s in range(sensor.subgroups)
        }
        clocks = {"phase_clocks": In(sensor.phases // 2 - 1)} if levels else {}
        spads = {name: In(bits) for name, bits in self.spads.items()}
        super().__init__(**outer_ports(sensor), spad_gate=Out(sensor.subgroups), **clocks, **spads)

    def elaborate(self, platform):
        m = Module()
        put = partial(place, m, platform=platform)
        words = [
            platform.pad(name, bits) if isinstance(platform, Export) else getattr(self, name)
            for name, bits in self.spads.items()
        ]
        if self.levels:
            words = [
                put(f"deserialiser_{s}", Deserialiser(self.sensor), lines=lines, clocks=self.phase_clocks).words
                for s, lines in enumerate(words)
            ]
        _, gates = wire_sensor(m, put, self.sensor, self, words, self.view)
        m.d.comb += self.spad_gate.eq(gates)
        return m


def has_fpga_top(sensor: Sensor) -> bool:
    """Return whether the clocks of an FPGA's PLL can sample the SPAD lines."""
    return sensor.phases <= PHASES_MAX


def wire_core(m: Module, put: Put, sensor: Sensor, outer: Any, inner: Any) -> Sequencer:
    """Put the blocks of the core into `m`, between `outer_ports` and `inner_ports`, and return the sequencer."""
    registers, sequencer = Registers(sensor), Sequencer(sensor)
    readouts = [Readout(sensor, len(sensor.stream_subgroups(k))) for k in range(sensor.streams)]
    controllers = [Controller(sensor) for _ in readouts] if sensor.controller else []
    nets: dict[str, Any] = registers.outputs() | sequencer.outputs()
    nets |= {name: getattr(inner, name) for name in ANSWERED}
    if controllers:
        nets |= {name: Cat(getattr(one, name) for one in controllers) for name in ("budget", "limit")}
    nets["delivered"] = Cat(readout.delivered for readout in readouts).all()
    put("registers", registers, **registers.fed(nets))
    put("sequencer", sequencer, **sequencer.fed(nets))
    wiring.connect(m, wiring.flipped(outer.s_axi), registers.s_axi)
    m.d.comb += outer.laser.eq(sequencer.laser)
    m.d.comb += [getattr(inner, name).eq(nets[name]) for name in shared_ports(sensor)]
    for k, controller in enumerate(controllers):
        of_stream = {"share": registers.share[k], "counted": readouts[k].counted}
        put(f"controller_{k}", controller, **controller.fed(nets | of_stream))
    for k, readout in enumerate(readouts):
        nets |= {name: getattr(inner, f"{name}_of_{k}") for name in (*LISTED, *COMBINED)}
        put(f"readout_{k}", readout, **readout.fed(nets))
        wiring.connect(m, wiring.flipped(getattr(outer, sensor.stream_name(k))), readout.m_axis)
        m.d.comb += [getattr(inner, f"{name}_of_{k}").eq(getattr(readout, name)) for name in GRANTED]
    return sequencer


def wire_sensor(
    m: Module, put: Put, sensor: Sensor, outer: Any, words: list[ValueLike], view=POLYPHASE
) -> tuple[Sequencer, Cat]:
    """Put the blocks of the sensor into `m`, behind `outer_ports`, and return the sequencer and the subgroups' gates.

    words: the SPADs of every subgroup, in the view's form.
    """
    inner: Any = Signature(inner_ports(sensor)).create(path=())
    sequencer = wire_core(m, put, sensor, outer, inner)
    subgroups = range(sensor.subgroups)
    own: list[dict[str, Any]] = []  # the ports of each subgroup
    for k in subgroups[::2]:
        lines = subgroups[k : k + 2]
        module = SensorModule(sensor, len(lines), view)
        inputs = {name: getattr(inner, name) for name in shared_ports(sensor)}
        for j, s in enumerate(lines):
            stream = sensor.stream_of(s)
            inputs[f"words_{j}"] = words[s]
            inputs[f"grant_{j}"] = getattr(inner, f"grant_of_{stream}")[sensor.stream_subgroups(stream).index(s)]
            inputs[f"send_{j}"] = getattr(inner, f"send_of_{stream}")
            own.append({name: getattr(module, f"{name}_{j}") for name in own_ports(sensor)})
        put(f"module_{k // 2}", module, number=Const(k // 2, module.number.shape()), **inputs)

    def combine(port, name, members):
        m.d.comb += getattr(inner, port).eq(any_of(m, [own[s][name] for s in members], f"{port}_from"))

    combine("data", "data", subgroups)
    combine("gate_late", "gate_late", subgroups)
    combine("settings_upset", "upset", subgroups)
    for k in range(sensor.streams):
        members = sensor.stream_subgroups(k)
        for name in COMBINED:
            combine(f"{name}_of_{k}", name, members)
        for name in LISTED:
            m.d.comb += getattr(inner, f"{name}_of_{k}").eq(Cat(own[s][name] for s in members))
    return sequencer, Cat(ports["spad_gate"] for ports in own)
