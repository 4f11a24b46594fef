# SPDX-License-Identifier: Apache-2.0
"""Stress test of the asynchronous front end: arbitrary edges, random at every scale, and flops
that fall to either side.

The front end and its TDC run alone under Icarus. Every SPAD line is a random process of its own:
bursts of femtoseconds, gaps of cycles, edges exactly at the borders of cycles and ticks. Mask,
gate and window change between periods, and there are random resets. A word is wrong if its map
is empty, its winner is not in the map, or its count is not that of the map. The front end is
locked up if it shows no word for too long, or does not respond to a single edge at rest. The
bench is `async_stress.v`.

`python -m coincid.tb.stress EDGES [SEED]` prints the counts.
"""

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from amaranth.hdl import Value

from ..hdl.export import units_files
from ..hdl.front_end_views import Asynchronous
from ..hdl.silicon.circuit import Circuit
from ..hdl.unit import Unit
from ..model.contract.parameters import Sensor
from ..model.shared.errors import check_integer
from ..model.shared.folders import build_root
from ..model.shared.sources import digest
from ..tools.build import ToolchainError, build_once, compile_in
from . import toolchain

BENCH = Path(__file__).with_name("async_stress.v")
INCLUDE = "front.vh"  # file that benches of a front end include
EDGES_MAX = 1 << 31
APERTURE_PS = 20  # of a flop whose data has just changed
DRIVEN = ("spad", "mask", "gate", "window_ticks")  # ports that a bench drives, and their fields
FIELDS = ("frame", "timing")
SHOWN = "window"  # port whose fields a bench reads


def stress(
    edges: int, seed: int = 1, *, sensor: Sensor | None = None, circuit: Circuit | None = None
) -> dict[str, int]:
    """Run `edges` random edges; return the numbers of edges, windows, records, wrong words and
    lock-ups.

    Raises `ToolchainError` if Icarus is missing or fails.
    """
    edges = check_integer("edges", edges, 1, EDGES_MAX)
    front = Front(sensor or Sensor(rows=8, cols=8), circuit or Circuit())
    arguments = [f"+edges={edges}", f"+seed={seed}"]
    return json.loads(run_bench(BENCH, front.files(), arguments=arguments, aperture=True)[-1])


def run_bench(
    bench: Path,
    files: Mapping[str, str],
    *,
    parameters: Mapping[str, int] | None = None,
    arguments: Sequence[str] = (),
    aperture: bool = False,
) -> list[str]:
    """Return the lines that a bench prints under Icarus: a Verilog file whose module has the
    file's name.

    files: name -> text of the files that it instantiates (.v) and includes (.vh). parameters: of
    the module. arguments: of the simulator. aperture: flops may fall to either side if their
    data has just changed. Raises `ToolchainError`.
    """
    top, files = bench.stem, {**files, bench.name: bench.read_text(encoding="utf-8")}
    options = [
        f"-P{top}.{name}={value.bit_length() + 1}'d{value}"
        for name, value in (parameters or {}).items()
    ]
    options += [f"-DCOINCID_APERTURE_PS={APERTURE_PS}"] * aperture
    key = digest(toolchain.icarus(), *options, *(part for item in files.items() for part in item))

    def make(scratch: Path) -> None:
        for name, text in files.items():
            (scratch / name).write_text(text, encoding="utf-8")
        sources = [name for name in files if name.endswith(".v")]
        command = ["iverilog", "-g2012", *options, "-o", "bench.vvp", "-s", top, *sources]
        compile_in(scratch, scratch / "compile.log", command)

    folder = build_once(build_root() / "bench" / f"{top}-{key}", make)
    done = subprocess.run(
        ["vvp", "-n", "bench.vvp", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    if done.returncode or not done.stdout.strip():
        raise ToolchainError(
            f"{top}: the simulation failed: {done.stderr.strip() or 'it printed nothing'}"
        )
    return done.stdout.strip().splitlines()


class Front:
    """A front end with only its TDC, for benches that include `INCLUDE`."""

    def __init__(self, sensor: Sensor, circuit: Circuit):
        view = Asynchronous(circuit)
        view.check(sensor)
        self.sensor, self.circuit, self.cells = sensor, circuit, view.cells
        self.front, self.tdc = view.front_end(sensor), view.tdc(sensor, 1)

    def files(self) -> dict[str, str]:
        """Return all files except the bench."""
        cells = {path.name: path.read_text(encoding="utf-8") for path in self.cells}
        return units_files([self.front, self.tdc]) | cells | {INCLUDE: self.include()}

    def include(self) -> str:
        """Return the part of a bench that depends on the sensor: clock, front end and TDC,
        sizes, and named signals.

        The bench drives `rst`, `start_tdc`, `DRIVEN` and the fields of `FIELDS`; it reads the
        other ports and the fields of `SHOWN`.
        """
        sensor = self.sensor
        sizes = {
            "PIXELS": sensor.pixels,
            "PHASES": sensor.phases,
            "WINDOW_MAX": sensor.window_max,
            "GUARD": sensor.guard,
            "CLOCK_FS": self.circuit.clock_fs,
        }
        lines = [f"localparam {name} = {value};" for name, value in sizes.items()]
        lines += [
            "reg clk = 0, rst = 1, start_tdc = 0;",
            "always #(CLOCK_FS / 2 / 1000.0) clk = ~clk;",
        ]
        of_front, of_tdc = _widths(self.front), _widths(self.tdc)
        for port, width in of_front.items():
            if port in FIELDS:
                fields = list(getattr(self.front, port).shape())
                lines += [f"reg [{field.width - 1}:0] {name} = 0;" for name, field in fields]
                joined = ", ".join(name for name, _ in reversed(fields))
                lines.append(f"wire [{width - 1}:0] {port} = {{{joined}}};")
            else:
                lines.append(
                    f"reg [{width - 1}:0] {port} = 0;"
                    if port in DRIVEN
                    else f"wire [{width - 1}:0] {port};"
                )
        for name, field in getattr(self.front, SHOWN).shape():
            lines.append(
                f"wire [{field.width - 1}:0] {name} = {SHOWN}[{field.offset}+:{field.width}];"
            )
        wires = {port: port.replace("line_0__", "line__") for port in of_tdc} | {
            "start": "start_tdc"
        }
        lines += [
            _instance(self.tdc, "tdc", wires),
            _instance(self.front, "front", {port: port for port in of_front}),
        ]
        return "".join(f"  {line}\n" for line in lines)


def _widths(unit: Unit) -> dict[str, int]:
    return {port: len(Value.cast(value)) for port, (_, value) in unit.flat_ports().items()}


def _instance(unit: Unit, name: str, wires: Mapping[str, str]) -> str:
    pins = ", ".join(f".{port}({wire})" for port, wire in wires.items())
    return f"{unit.unit_name} {name} (.clk(clk), .rst(rst), {pins});"


if __name__ == "__main__":
    print(json.dumps(stress(*map(int, sys.argv[1:]))))
