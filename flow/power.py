# SPDX-License-Identifier: Apache-2.0
"""Power of a netlist in standard cells: transitions of its nets in simulated frames, times the
energies of the library.

The netlist is the hierarchical one of `synth.py`, so every block has its own sum. Icarus plays
frames through it and dumps every net; the words are checked against the golden model. The power
of a cell has three parts: the transitions of its pins times the energies of `liberty.py`; the
transitions of its nets times half their capacitance times the supply squared; and leakage. The
capacitance is that of the pins and, with `wire_ff`, of the wires. The power of a clock net
counts in the blocks that contain its pins. The cells are NanGate 45 nm at the typical corner
(1.1 V, 25 degrees C). The simulation has no delays, so there are no glitches. The netlist has no
clock tree; `clock_tree_mw` computes one with a model.
"""

import json
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from io import BufferedIOBase
from operator import add
from typing import Any, TypeAlias

import numpy as np
from attrs import astuple, frozen
from vcd.reader import TokenKind, tokenize

from ..model.contract.parameters import TOP, Sensor
from ..model.shared.folders import build_root
from ..tb.frame_record import FrameJob
from ..tb.play import play_in
from ..tb.rtl import sensor_key
from ..tools.build import ToolchainError
from ..tools.wheels import yosys_once
from .gls import netlist_build
from .liberty import Cell, Pin, read_cells, supply_v
from .synth import CELLS, synthesize
from .yosys import CLOCK_BUFFER, LIBERTY, SINKS_MAX

FLAT, NETLIST = "flat.json", "netlist.v"
CLOCK, RESET, LASER = "clk", "rst", "laser"
MW_PER_FJ_MHZ = 1e-6  # fJ * MHz
MW_PER_NW = 1e-6
# Net, with its instances before it -> int64[frames, bits], lowest bit first.
Toggles: TypeAlias = Mapping[str, np.ndarray]


@frozen
class Power:
    """Power of some cells, in mW.

    clock: inside flip-flops and latches when their clock changes, and in the pins that the clock
    drives. internal: all other power inside the cells. switching: in the pins and wires that the
    cells drive. idle: the part of `clock` in cycles in which the output of the flip-flop does
    not change, which is the most that clock gates can save.
    """

    clock: float = 0.0
    internal: float = 0.0
    switching: float = 0.0
    leakage: float = 0.0
    idle: float = 0.0

    @property
    def total(self) -> float:
        return self.clock + self.internal + self.switching + self.leakage

    def __add__(self, other: "Power") -> "Power":
        return Power(*map(add, astuple(self), astuple(other)))


@frozen
class Instance:
    """A cell of the netlist. block: path of the instances that contain it, with dots. nets: pin
    -> number of its net.
    """

    block: str
    kind: str
    nets: Mapping[str, int]


@frozen
class Design:
    """A flattened netlist: its cells, and net -> its names. A name has the path of its
    instances, and a bit.
    """

    scopes: list[str]
    instances: list[Instance]
    names: Mapping[int, list[tuple[str, int]]]
    library: Mapping[str, Cell]
    supply_v: float


def design(sensor: Sensor) -> Design:
    """Return the sensor in standard cells."""
    synthesized = synthesize(sensor, CELLS)
    files = {
        name: (synthesized.folder / name).read_text(encoding="utf-8") for name in (LIBERTY, NETLIST)
    }
    script = (
        f"read_liberty -lib {LIBERTY}",
        f"read_verilog {NETLIST}",
        f"hierarchy -top {TOP}",
        "flatten",
        f"write_json {FLAT}",
    )
    folder = yosys_once(
        synthesized.folder.with_name(f"{synthesized.folder.name}-flat"), files, script
    )
    module = json.loads((folder / FLAT).read_text(encoding="utf-8"))["modules"][TOP]
    instances, scopes = [], {""}
    for name, cell in module["cells"].items():
        if cell["type"].startswith("$"):
            scopes.add(name)
            continue
        block = name.rpartition(".")[0]
        nets = {
            pin: bits[0]
            for pin, bits in cell["connections"].items()
            if bits and isinstance(bits[0], int)
        }
        instances.append(Instance(block, cell["type"], nets))
        scopes.add(block)
    names: dict[int, list[tuple[str, int]]] = {}
    for net, named in module["netnames"].items():
        for i, bit in enumerate(named["bits"]):
            if isinstance(bit, int):
                names.setdefault(bit, []).append((net, i))
    liberty = folder / LIBERTY
    library = read_cells(liberty, {CLOCK_BUFFER, *(instance.kind for instance in instances)})
    return Design(sorted(scopes), instances, names, library, supply_v(liberty))


def count_toggles(sensor: Sensor, frames: list[FrameJob]) -> Toggles:
    """Play frames with the same number of pulses through the netlist; return the transitions of
    every net in each frame.
    """
    scopes = [".".join(filter(None, (TOP, scope))) for scope in design(sensor).scopes]
    build = netlist_build(sensor, CELLS, scopes)
    out = build_root() / "power" / sensor_key(sensor)
    play_in(build, frames, out)
    config = frames[0].config
    with (out / f"{TOP}.vcd").open("rb") as vcd:
        cycles = [job.config.frame_cycles for job in frames]
        return transitions(vcd, config.pulses, cycles, round(1e6 / config.clock_mhz))


def transitions(
    vcd: BufferedIOBase, pulses: int, frame_cycles: list[int], cycle_ps: int
) -> Toggles:
    """Return the transitions of every net in a VCD in each frame. A frame begins when `LASER`
    rises for its first pulse.
    """
    nets: dict[str, str] = {}  # net -> identifier in the file
    counts: dict[str, np.ndarray] = {}
    scope: list[str] = []
    tokens = tokenize(vcd)
    for kind, _, declared in tokens:
        data: Any = declared  # its type depends on the kind
        if kind is TokenKind.SCOPE:
            scope.append(data.ident.lstrip("\\"))
        elif kind is TokenKind.UPSCOPE:
            scope.pop()
        elif kind is TokenKind.VAR:
            nets[".".join([*scope[1:], data.reference.lstrip("\\")])] = data.id_code
            counts[data.id_code] = np.zeros((len(frame_cycles), data.size), np.int64)
        elif kind is TokenKind.ENDDEFINITIONS:
            break
    last = {code: np.zeros(count.shape[1], np.uint8) for code, count in counts.items()}
    begins: list[int] = []
    rises, reset_seen = 0, False
    for now, values in _steps(tokens):
        in_reset = last[nets[RESET]][0] == ord("1")
        reset_seen |= in_reset
        if reset_seen and not in_reset and values.get(nets[LASER]) == "1":
            if rises % pulses == 0:
                begins.append(now)
            rises += 1
        frame = len(begins) - 1
        counted = (
            0 <= frame < len(frame_cycles) and now < begins[frame] + frame_cycles[frame] * cycle_ps
        )
        for code, text in values.items():
            value = np.frombuffer(text.rjust(counts[code].shape[1], "0").encode(), np.uint8)[::-1]
            if counted:
                counts[code][frame] += value != last[code]
            last[code] = value
    if len(begins) != len(frame_cycles):
        raise ToolchainError(
            f"power: the simulation shows {len(begins)} frames of {len(frame_cycles)}"
        )
    return {name: counts[code] for name, code in nets.items()}


def _steps(tokens: Iterator[Any]) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield each time in a VCD with the new values: identifier -> value, highest bit first."""
    now, values = 0, dict[str, str]()
    for kind, _, data in tokens:
        if kind is TokenKind.CHANGE_TIME:
            if values:
                yield now, values
            now, values = data, {}
        elif kind in (TokenKind.CHANGE_SCALAR, TokenKind.CHANGE_VECTOR):
            values[data.id_code] = data.value if isinstance(data.value, str) else f"{data.value:b}"
    if values:
        yield now, values


def power(
    of: Design, toggles: Toggles, frame: int, cycles: int, clock_mhz: float, wire_ff: float = 0.0
) -> dict[str, Power]:
    """Return path of a block -> power of the block without its sub-blocks in a frame.

    wire_ff: capacitance of the wire to each pin.
    """
    return _sums(of, _moves(of, toggles, frame), cycles, clock_mhz, wire_ff)


def power_at_rest(of: Design, clock_mhz: float, wire_ff: float = 0.0) -> dict[str, Power]:
    """Return the same while only the clock runs, so that the clock gates of the subgroups are
    closed.
    """
    return _sums(of, {net: 2 * (net == _clock_net(of)) for net in of.names}, 1, clock_mhz, wire_ff)


def _clock_net(of: Design) -> int:
    return next(net for net, names in of.names.items() if (CLOCK, 0) in names)


def _clock_nets(of: Design) -> set[int]:
    """Return the clock and the outputs of its gates."""
    return {_clock_net(of)} | {net for _, net, pin in _pins(of) if pin.clock and pin.output}


def _pins(of: Design) -> Iterator[tuple[str, int, Pin]]:
    """Yield (block, net, pin) of every connected pin."""
    for instance in of.instances:
        for name, net in instance.nets.items():
            yield instance.block, net, of.library[instance.kind].pins[name]


def clock_tree_mw(
    of: Design, toggles: Toggles, frame: int, cycles: int, clock_mhz: float, wire_ff: float
) -> dict[str, float]:
    """Return block -> power of the buffers and wires of a clock tree in a frame, for the blocks
    whose pins the tree drives.

    In this model every clock net, gated or not, has as many levels of buffers as it needs. Each
    buffer has `SINKS_MAX` loads, and a wire leads to every load.
    """
    moves, half = _moves(of, toggles, frame), of.supply_v**2 / 2
    sinks: dict[int, list[tuple[str, float]]] = {net: [] for net in _clock_nets(of)}
    for block, net, pin in _pins(of):
        if net in sinks and not pin.output:
            sinks[net].append((block, pin.capacitance_ff))
    power_mw: dict[str, float] = defaultdict(float)
    for net, loads in sinks.items():
        fj = _tree_fj(of.library[CLOCK_BUFFER], [farads for _, farads in loads], wire_ff, half)
        for block, _ in loads:
            power_mw[block] += moves[net] * fj / len(loads) * MW_PER_FJ_MHZ * clock_mhz / cycles
    return power_mw


def _tree_fj(buffer: Cell, loads_ff: list[float], wire_ff: float, half: float) -> float:
    """Return the energy of one transition in the buffers and wires of a clock net, in fJ. half:
    the supply squared / 2.
    """
    energies = buffer.pins["Z"].energies
    assert energies is not None
    number, load_ff, fj = len(loads_ff), sum(loads_ff), 0.0
    while number:
        fj += half * number * wire_ff
        if number <= SINKS_MAX:
            break
        buffers = math.ceil(number / SINKS_MAX)
        of_one_ff = (load_ff + number * wire_ff) / buffers
        number, load_ff = buffers, buffers * buffer.pins["A"].capacitance_ff
        fj += number * energies.at(of_one_ff) + half * load_ff
    return fj


def _sums(
    of: Design, moves: Mapping[int, int], cycles: int, clock_mhz: float, wire_ff: float
) -> dict[str, Power]:
    """Return the power of every block from the transitions of the nets in a number of cycles."""
    loads: dict[int, float] = defaultdict(float)
    for _, net, pin in _pins(of):
        if not pin.output:
            loads[net] += pin.capacitance_ff + wire_ff
    clock_nets = _clock_nets(of)
    per_cycle = MW_PER_FJ_MHZ * clock_mhz / cycles
    half = of.supply_v**2 / 2
    sums: dict[str, Power] = defaultdict(Power)
    for instance in of.instances:
        cell = of.library[instance.kind]
        clock = internal = switching = 0.0
        at_clock = at_output = 0  # transitions of the clock, and of the output
        gated = [
            net
            for name, net in instance.nets.items()
            if cell.pins[name].clock and cell.pins[name].output
        ]
        # transitions of the clock that a gate lets through
        passed = sum(moves[net] for net in gated)
        for name, net in instance.nets.items():
            pin, count = cell.pins[name], moves[net]
            energy = pin.energies.at(loads[net]) if pin.energies else 0.0
            if pin.clock and pin.output:
                clock += count * energy
                continue
            if pin.clock:
                at_clock = max(at_clock, count)
                clock += (count - passed) * energy
            else:
                internal += count * energy
            if pin.output:
                switching += count * half * loads[net]
                at_output = max(at_output, count)
            elif net in clock_nets:
                clock += count * half * (pin.capacitance_ff + wire_ff)
        for name, pin in cell.pins.items():  # an output without a net changes like the other output
            if pin.output and name not in instance.nets and pin.energies:
                internal += at_output * pin.energies.at(0.0)
        idle = clock * (1 - min(1, at_output / (at_clock / 2))) if at_clock and not gated else 0.0
        clock, internal, switching, idle = (
            per_cycle * fj for fj in (clock, internal, switching, idle)
        )
        own = Power(clock, internal, switching, MW_PER_NW * cell.leakage_nw, idle)
        sums[instance.block] += own
    return sums


def _moves(of: Design, toggles: Toggles, frame: int) -> dict[int, int]:
    """Return net -> transitions in a frame. Raises `ToolchainError` for a net that was not
    dumped.
    """
    moves = {}
    for net, names in of.names.items():
        found = next(((name, bit) for name, bit in names if name in toggles), None)
        if found is None:
            raise ToolchainError(f"power: the simulation does not show {names[0][0]}")
        moves[net] = int(toggles[found[0]][frame, found[1]])
    return moves
