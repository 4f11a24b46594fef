# SPDX-License-Identifier: Apache-2.0
"""The sensor: an array of modules, a register front, a sequencer, and per stream one readout and
one threshold controller.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from amaranth.hdl import Cat, Const, Module, ValueLike
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, Signature

from ..model.contract.packet import BEAT_BITS
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
from .subgroup import OwnPorts, shared_ports
from .subgroup_pair import SensorModule
from .unit import Export, Unit, place

FPGA_TOP = "coincid_fpga"
CORE = "coincid_core"
Put = Callable[..., Any]  # puts a unit into a design as `place` does: put(name, unit, **inputs)


def outer_ports(sensor: Sensor) -> dict[str, Any]:
    """Ports of the sensor towards its software: registers, laser, streams."""
    streams = {sensor.stream_name(k): Out(STREAM) for k in range(sensor.streams)}
    return {"s_axi": In(LITE), "laser": Out(1)} | streams


def inner_ports(sensor: Sensor) -> dict[str, Any]:
    """Ports of the core towards the modules.

    `shared_ports`, as outputs; data, gate_late, settings_upset : in, OR of all subgroups';
    soft_reset : out, resets the modules, in addition to `rst`; and for every stream k, of its
    subgroups:
    stored_of_k, record_stored_of_k : in, one bit per subgroup
    valid_of_k, beat_of_k, beat_controlled_of_k : in, OR of the subgroups'
    grant_of_k : out, one bit per subgroup; send_of_k : out
    """
    ports = {name: Out(member.shape) for name, member in shared_ports(sensor).items()}
    ports |= {"data": In(DATA_BITS), "gate_late": In(1), "settings_upset": In(1)}
    ports |= {"soft_reset": Out(1)}
    for k in range(sensor.streams):
        subgroups = len(sensor.stream_subgroups(k))
        ports |= {
            f"stored_of_{k}": In(subgroups),
            f"record_stored_of_{k}": In(subgroups),
            f"valid_of_{k}": In(1),
            f"beat_of_{k}": In(BEAT_BITS),
            f"beat_controlled_of_{k}": In(1),
            f"grant_of_{k}": Out(subgroups),
            f"send_of_{k}": Out(bus.Send),
        }
    return ports


class StreamPorts:
    """Those of the `inner_ports` that belong to stream k, without the suffix _of_k."""

    def __init__(self, inner: Any, k: int):
        self._inner = inner
        self._suffix = f"_of_{k}"

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name + self._suffix)


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

    Ports: `outer_ports`; spad_gate : out, bit s is the gate of subgroup s; spad_s : in, SPADs of
    subgroup s in the view's form; test_enable : in, opens clock gates and latches for a test of the
    chip, 0 otherwise.

    levels: instead of spad_s, line_s : in, levels of the SPADs of subgroup s, which has a
    deserialiser, and
    phase_clocks : in, its clocks.
    """

    separator = "_"

    def __init__(self, sensor: Sensor, view=POLYPHASE, levels: bool = False):
        view.check(sensor)
        self.sensor, self.view, self.levels = sensor, view, levels
        self.unit_name = FPGA_TOP if levels else TOP
        self.spads = {
            f"{'line' if levels else 'spad'}_{s}": sensor.pixels
            if levels
            else view.spad_bits(sensor)
            for s in range(sensor.subgroups)
        }
        clocks = {"phase_clocks": In(sensor.phases // 2 - 1)} if levels else {}
        spads = {name: In(bits) for name, bits in self.spads.items()}
        super().__init__(
            **outer_ports(sensor),
            test_enable=In(1),
            spad_gate=Out(sensor.subgroups),
            **clocks,
            **spads,
        )

    def elaborate(self, platform):
        m = Module()
        put = partial(place, m, platform=platform)
        words = [
            platform.pad(name, bits) if isinstance(platform, Export) else getattr(self, name)
            for name, bits in self.spads.items()
        ]
        if self.levels:
            words = [
                put(
                    f"deserialiser_{s}",
                    Deserialiser(self.sensor),
                    lines=lines,
                    clocks=self.phase_clocks,
                ).words
                for s, lines in enumerate(words)
            ]
        _, gates = wire_sensor(m, put, self.sensor, self, words, self.test_enable, self.view)
        m.d.comb += self.spad_gate.eq(gates)
        return m


def has_fpga_top(sensor: Sensor) -> bool:
    """Return whether the clocks of an FPGA's PLL can sample the SPAD lines."""
    return sensor.phases <= PHASES_MAX


def wire_core(m: Module, put: Put, sensor: Sensor, outer: Any, inner: Any) -> Sequencer:
    """Put the blocks of the core into `m`, between `outer_ports` and `inner_ports`.

    Return the sequencer.
    """
    registers = Registers(sensor)
    sequencer = Sequencer(sensor)
    readouts = [Readout(sensor, len(sensor.stream_subgroups(k))) for k in range(sensor.streams)]
    controllers = [Controller(sensor) for _ in readouts] if sensor.controller else []
    thresholds: dict[str, ValueLike] = {}
    if controllers:
        thresholds = dict(
            budget=Cat(controller.budget for controller in controllers),
            limit=Cat(controller.limit for controller in controllers),
        )
    put(
        "registers",
        registers,
        data=inner.data,
        gate_late=inner.gate_late,
        settings_upset=inner.settings_upset,
        done=sequencer.done,
        resting=sequencer.resting,
        **thresholds,
    )
    put(
        "sequencer",
        sequencer,
        soft_reset=registers.soft_reset,
        plan=registers.plan,
        start_frame=registers.start_frame,
        abort_frame=registers.abort_frame,
        delivered=Cat(readout.delivered for readout in readouts).all(),
    )
    wiring.connect(m, wiring.flipped(outer.s_axi), registers.s_axi)
    m.d.comb += [
        outer.laser.eq(sequencer.laser),
        inner.command.eq(registers.command),
        inner.period.eq(registers.period),
        inner.frame.eq(registers.frame),
        inner.timing.eq(sequencer.timing),
        inner.soft_reset.eq(registers.soft_reset),
    ]
    for k, controller in enumerate(controllers):
        put(
            f"controller_{k}",
            controller,
            soft_reset=registers.soft_reset,
            command=registers.command,
            capacity=registers.capacity,
            share=registers.share[k],
            counted=readouts[k].counted,
            done=sequencer.done,
        )
    for k, readout in enumerate(readouts):
        stream = StreamPorts(inner, k)
        put(
            f"readout_{k}",
            readout,
            soft_reset=registers.soft_reset,
            stored=stream.stored,
            record_stored=stream.record_stored,
            valid=stream.valid,
            beat=stream.beat,
            beat_controlled=stream.beat_controlled,
            frame=registers.frame,
            plan=registers.plan,
            number=sequencer.number,
            frame_begin=sequencer.frame_begin,
            finish=sequencer.finish,
        )
        wiring.connect(m, wiring.flipped(getattr(outer, sensor.stream_name(k))), readout.m_axis)
        m.d.comb += [
            stream.grant.eq(readout.grant),
            stream.send.eq(readout.send),
        ]
    return sequencer


def wire_sensor(
    m: Module,
    put: Put,
    sensor: Sensor,
    outer: Any,
    words: list[ValueLike],
    test_enable: ValueLike,
    view=POLYPHASE,
) -> tuple[Sequencer, Cat]:
    """Put the blocks of the sensor into `m`, behind `outer_ports`.

    words: the SPADs of every subgroup, in the view's form. Return the sequencer and the subgroups'
    gates.
    """
    inner: Any = Signature(inner_ports(sensor)).create(path=())
    sequencer = wire_core(m, put, sensor, outer, inner)
    subgroups: list[OwnPorts] = []
    for k in range(0, sensor.subgroups, 2):
        lines = range(k, min(k + 2, sensor.subgroups))
        module = SensorModule(sensor, len(lines), view)
        put(
            f"module_{k // 2}",
            module,
            soft_reset=inner.soft_reset,
            number=Const(k // 2, module.number.shape()),
            command=inner.command,
            period=inner.period,
            frame=inner.frame,
            timing=inner.timing,
            test_enable=test_enable,
            **_of_line(sensor, inner, words, 0, lines[0]),
            **(_of_line(sensor, inner, words, 1, lines[1]) if len(lines) > 1 else {}),
        )
        subgroups += [OwnPorts(module, f"_{line}") for line in range(len(lines))]

    def combined(name, values):
        return any_of(m, list(values), f"{name}_from")

    m.d.comb += [
        inner.data.eq(combined("data", (one.data for one in subgroups))),
        inner.gate_late.eq(combined("gate_late", (one.gate_late for one in subgroups))),
        inner.settings_upset.eq(combined("settings_upset", (one.upset for one in subgroups))),
    ]
    for k in range(sensor.streams):
        stream = StreamPorts(inner, k)
        members = [subgroups[s] for s in sensor.stream_subgroups(k)]
        controlled = (one.beat_controlled for one in members)
        m.d.comb += [
            stream.stored.eq(Cat(one.stored for one in members)),
            stream.record_stored.eq(Cat(one.record_stored for one in members)),
            stream.valid.eq(combined(f"valid_of_{k}", (one.valid for one in members))),
            stream.beat.eq(combined(f"beat_of_{k}", (one.beat for one in members))),
            stream.beat_controlled.eq(combined(f"beat_controlled_of_{k}", controlled)),
        ]
    return sequencer, Cat(one.spad_gate for one in subgroups)


def _of_line(
    sensor: Sensor, inner: Any, words: list[ValueLike], line: int, subgroup: int
) -> dict[str, ValueLike]:
    """Return the drivers of a module's inputs for one of its lines, which belongs to `subgroup`."""
    number = sensor.stream_of(subgroup)
    stream = StreamPorts(inner, number)
    return {
        f"words_{line}": words[subgroup],
        f"grant_{line}": stream.grant[sensor.stream_subgroups(number).index(subgroup)],
        f"send_{line}": stream.send,
    }
