# SPDX-License-Identifier: Apache-2.0
"""Power of a netlist in standard cells: what its nets do in simulated frames, times what OpenSTA knows of the cells.

The netlist is the hierarchical one of `synth.py`, so that every block has its own sum. Icarus plays frames through it, checked against the
golden model, and dumps every net; the number of transitions of each cell's output goes to OpenSTA, which multiplies them by the library's
internal energies, pin capacitances and the supply, and adds leakage. NanGate 45 nm, typical corner (1.1 V, 25 degrees C), no wires, ideal
clock: a clock tree and wires come on top. The simulation has no delays, so a net moves at most once for each edge of the clock: glitches
are not counted.
"""

import json
import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from attrs import frozen

from ..model.contract.parameters import TOP, Sensor
from ..model.shared.folders import build_root
from ..tb.frames import FrameJob
from ..tb.play import play_in
from ..tb.rtl import sensor_key
from ..tb.toolchain import ToolchainError, build_once
from .gls import netlist_build
from .mapped import FLOP
from .synth import CELLS, synthesize
from .yosys import LIBERTY, run_program, run_yosys

PS_PER_NS = 1000
NAMED, NETLIST = "named.json", "netlist.v"
LASER = "laser"
MW_PER_W = 1000.0
Modules: TypeAlias = Mapping[str, Any]
Toggles: TypeAlias = Mapping[tuple[str, str], np.ndarray]  # (scope, net) -> int64[frames, bits], lowest bit first


@frozen
class Power:
    """Of some cells, in mW. internal: inside the cells; switching: of the pins that they drive; leakage."""

    internal: float = 0.0
    switching: float = 0.0
    leakage: float = 0.0

    @property
    def total(self) -> float:
        return self.internal + self.switching + self.leakage

    def __add__(self, other: "Power") -> "Power":
        return Power(
            self.internal + other.internal, self.switching + other.switching, self.leakage + other.leakage
        )


@frozen
class Cell:
    """A leaf of the hierarchy. path: its block's instances; outputs: pin -> (net, bit) in that block."""

    path: tuple[str, ...]
    name: str
    kind: str
    outputs: Mapping[str, tuple[str, int]]

    def pin(self, name: str) -> str:
        return "/".join((*self.path, self.name, name))


@frozen
class Design:
    """A netlist with the names that Verilog has: its folder, blocks (path, module) and cells."""

    folder: Path
    blocks: list[tuple[tuple[str, ...], str]]
    cells: list[Cell]


def design(sensor: Sensor) -> Design:
    """The sensor in standard cells."""
    synthesized = synthesize(sensor, CELLS)

    def make(folder: Path) -> None:
        for name in (LIBERTY, NETLIST):
            (folder / name).write_bytes((synthesized.folder / name).read_bytes())
        run_yosys(f"read_liberty -lib {LIBERTY}\nread_verilog {NETLIST}\nwrite_json {NAMED}\n", folder)

    folder = build_once(synthesized.folder.with_name(f"{synthesized.folder.name}-named"), make)
    modules = json.loads((folder / NAMED).read_text())["modules"]
    blocks = list(_blocks(modules, TOP, ()))
    return Design(folder, blocks, [cell for path, name in blocks for cell in _cells(modules, path, name)])


def _is_block(modules: Modules, kind: str) -> bool:
    return kind in modules and "blackbox" not in modules[kind]["attributes"]


def _blocks(modules: Modules, name: str, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], str]]:
    yield path, name
    for instance, cell in modules[name]["cells"].items():
        if _is_block(modules, cell["type"]):
            yield from _blocks(modules, cell["type"], (*path, instance))


def _cells(modules: Modules, path: tuple[str, ...], name: str) -> Iterator[Cell]:
    module = modules[name]
    nets = {
        bit: (net, i)
        for net, named in module["netnames"].items()
        for i, bit in enumerate(named["bits"])
        if isinstance(bit, int)
    }
    for instance, cell in module["cells"].items():
        if not _is_block(modules, cell["type"]):
            outputs = {
                pin: nets[bits[0]]
                for pin, bits in cell["connections"].items()
                if cell["port_directions"][pin] == "output" and bits and isinstance(bits[0], int)
            }
            yield Cell(path, instance, cell["type"], outputs)


def simulate(sensor: Sensor, frames: list[FrameJob]) -> Toggles:
    """Plays frames, all of as many pulses, through the netlist and counts the transitions of every net in each of them."""
    scopes = [".".join((TOP, *path)) for path, _ in design(sensor).blocks]
    build = netlist_build(sensor, CELLS, scopes)
    out = build_root() / "power" / sensor_key(sensor)
    play_in(build, frames, out)
    with (out / f"{TOP}.vcd").open() as lines:
        return transitions(lines, frames[0].config.pulses, [job.config.frame_cycles for job in frames], sensor_ps(frames))


def sensor_ps(frames: list[FrameJob]) -> int:
    """A clock cycle in ps."""
    return round(1e6 / frames[0].config.clock_mhz)


def transitions(lines: Iterable[str], pulses: int, frame_cycles: list[int], cycle_ps: int) -> Toggles:
    """Transitions of every net of a VCD in each frame. A frame begins as `LASER` rises for its first pulse."""
    reader = iter(lines)
    nets, widths, laser = _declared(reader)
    begins: list[int] = []
    counts = {code: np.zeros((len(frame_cycles), width), np.int64) for code, width in widths.items()}
    last: dict[str, np.ndarray] = {}
    now, rises, frame = 0, 0, -1
    for line in reader:
        kind = line[0]
        if kind == "#":
            now = int(line[1:])
            frame = bisect_right(begins, now) - 1
            if frame >= 0 and now >= begins[frame] + frame_cycles[frame] * cycle_ps:
                frame = -1
        elif kind in "01":
            code = line[1:-1]
            if code == laser and kind == "1":
                if rises % pulses == 0:
                    begins.append(now)
                    frame = len(begins) - 1
                rises += 1
            if frame >= 0:
                counts[code][frame, 0] += 1
        elif kind == "b":
            text, code = line[1:-1].split(" ")
            value = np.frombuffer(text.rjust(widths[code], "0").encode(), np.uint8)[::-1]
            if frame >= 0 and code in last:
                counts[code][frame] += value != last[code]
            last[code] = value
    if len(begins) != len(frame_cycles):
        raise ToolchainError(f"power: the simulation shows {len(begins)} frames of {len(frame_cycles)}")
    return {place: counts[code] for place, code in nets.items()}


def _declared(reader: Iterator[str]) -> tuple[dict[tuple[str, str], str], dict[str, int], str]:
    """(scope, net) -> code; code -> width; code of `LASER`. Reads up to the end of the definitions."""
    nets: dict[tuple[str, str], str] = {}
    widths: dict[str, int] = {}
    scope: list[str] = []
    for line in reader:
        words = line.split()
        if not words:
            continue
        if words[0] == "$scope":
            scope.append(words[2].lstrip("\\"))
        elif words[0] == "$upscope":
            scope.pop()
        elif words[0] == "$var":
            nets[".".join(scope[1:]), words[4].lstrip("\\")] = words[3]
            widths[words[3]] = int(words[2])
        elif words[0] == "$enddefinitions":
            break
    return nets, widths, nets["", LASER]


def power(of: Design, toggles: Toggles | None, frame: int, cycles: int, clock_mhz: float) -> dict[tuple[str, ...], Power]:
    """Power of every block without its sub-blocks, by the path of its instances. toggles: None: only the clock moves."""
    lines = [
        f"read_liberty {LIBERTY}",
        f"read_verilog {NETLIST}",
        f"link_design {TOP}",
        f"create_clock -name clk -period {PS_PER_NS / clock_mhz:g} [get_ports clk]",
        "set_power_activity -input -activity 0 -duty 0",
    ]
    for cell in of.cells:
        for pin, (net, bit) in cell.outputs.items():
            moves = 0 if toggles is None else toggles[".".join(cell.path), net][frame, bit] / cycles
            lines.append(f"set_power_activity -pins [get_pins {{{cell.pin(pin)}}}] -activity {moves:.6g} -duty 0.5")
    lines += ["report_power -digits 9 -instances [get_cells -hierarchical *]", ""]
    (of.folder / "power.tcl").write_text("\n".join(lines))
    report = run_program(["sta", "-exit", "power.tcl"], of.folder, "sta")
    return _summed(report)


def _summed(report: str) -> dict[tuple[str, ...], Power]:
    sums: dict[tuple[str, ...], Power] = {}
    for internal, switching, leakage, name in re.findall(r"^ *(\S+) +(\S+) +(\S+) +\S+ (\S+)$", report, re.MULTILINE):
        path = tuple(name.split("/")[:-1])
        watts = (MW_PER_W * float(value) for value in (internal, switching, leakage))
        sums[path] = sums.get(path, Power()) + Power(*watts)
    return sums
