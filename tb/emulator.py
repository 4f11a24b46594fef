# SPDX-License-Identifier: Apache-2.0
"""The emulator behind its serial pins, Verilated: a port for the host's serial transport, with no board."""

import ctypes
import os
import shutil
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from ..hdl.emulator.top import EMULATOR_LIST, SERIAL_TOP, emulator_files
from ..model.contract.emulator import BUFFER_BEATS, Emulator
from ..model.contract.parameters import Sensor
from ..model.shared.folders import build_root
from ..model.shared.sources import digest, sources_digest
from . import toolchain
from .batch import COMPILER, MAKE_OPTIONS, VERILATOR

SOURCE = Path(__file__).with_name("emulator.cpp")
LIBRARY = "libemulator.so"
READ_CYCLES = 2000  # that a read without an answer waits
PATIENCE_S = (
    200e-6  # for an answer at the fastest simulated line, in simulated time: the longest request takes half of it
)
ROOM = 4096
RESET_CYCLES = 8
SIMULATED_CLOCKS_PER_BIT = 4  # the fastest line


def simulated(
    sensor: Sensor, buffer_beats: int = BUFFER_BEATS, clocks_per_bit: int = SIMULATED_CLOCKS_PER_BIT
) -> Emulator:
    """An emulator of `sensor` for simulation, with the fastest line where none is given."""
    return Emulator(sensor=sensor, buffer_beats=buffer_beats, clocks_per_bit=clocks_per_bit)


def emulator_rtl(emulator: Emulator, serial: bool = True) -> list[Path]:
    """The emulator's Verilog files, emitted once for its parameters and the state of the sources."""
    key = digest(repr(emulator), str(serial), sources_digest("hdl", "model.contract", "model.shared"))

    def emit(folder: Path) -> None:
        for name, text in emulator_files(emulator, serial).items():
            (folder / name).write_text(text)

    sensor = emulator.sensor
    folder = toolchain.build_once(build_root() / "verilog" / f"emulator-{sensor.rows}x{sensor.cols}-{key}", emit)
    return [folder / name for name in (folder / EMULATOR_LIST).read_text().split()]


def build_emulator(emulator: Emulator) -> Path:
    """The library of an emulator's RTL behind its pins, compiled once."""
    name = f"emulator-{emulator.sensor.rows}x{emulator.sensor.cols}"
    return build_line(emulator_rtl(emulator), SERIAL_TOP, name, [toolchain.NOT_INLINED])


def build_line(
    sources: Sequence[Path],
    top: str,
    name: str,
    options: Sequence[str] = (),
    make_options: Sequence[str] = MAKE_OPTIONS,
) -> Path:
    """The library of a design with the ports clk, rst, rx and tx, compiled once. options: of Verilator; make_options: of its make file."""
    program = toolchain.verilator()
    texts = [part for path in sources for part in (path.name, path.read_text())]
    key = digest(str(program), top, *VERILATOR, *options, *COMPILER, *make_options, SOURCE.read_text(), *texts)
    directory = build_root() / "batch" / f"{name}-{key}"

    def make(scratch: Path) -> None:
        log = directory.with_name(f"{directory.name}.log")
        log.unlink(missing_ok=True)
        for path in sources:
            shutil.copyfile(path, scratch / path.name)
        names = [path.name for path in sources]
        flags = [*options, "-CFLAGS", "-fPIC", "--top-module", top, "--prefix", "Vemulator", "--Mdir", "."]
        toolchain.compile_in(scratch, log, [str(program), *VERILATOR, *flags, *names])
        targets = ["libVemulator.a", "libverilated.a"]
        jobs = str(os.cpu_count())
        toolchain.compile_in(scratch, log, ["make", "-s", "-j", jobs, "-f", "Vemulator.mk", *make_options, *targets])
        include = ["-I.", f"-I{program.parents[1] / 'include'}"]
        command = ["g++", "-shared", *COMPILER, "-o", LIBRARY, str(SOURCE), *include, *targets, "-lpthread", "-latomic"]
        toolchain.compile_in(scratch, log, command)
        for path in scratch.iterdir():
            if path.name != LIBRARY:
                path.unlink()

    return toolchain.build_once(directory, make) / LIBRARY


@cache
def _library(path: Path) -> ctypes.CDLL:
    library = ctypes.CDLL(str(path))
    pointer, i64 = ctypes.c_void_p, ctypes.c_int64
    signatures = {
        "new": (pointer, [ctypes.c_int]),
        "delete": (None, [pointer]),
        "reset": (None, [pointer, i64]),
        "connect": (None, [pointer, ctypes.c_int]),
        "send": (None, [pointer, ctypes.c_char_p, i64]),
        "run": (i64, [pointer, i64, ctypes.c_char_p, i64]),
        "cycle": (i64, [pointer]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, f"coincid_line_{name}")
        function.restype, function.argtypes = result, arguments
    return library


class SimulatedPort:
    """The serial port of a simulated emulator as it wakes up: what the host's `SerialTransport` takes. A context manager.

    Its time is simulated: it passes in `read` alone. clock_mhz: of the emulator. library: of another design than the emulator's RTL, which
    resets itself.
    """

    def __init__(self, emulator: Emulator, clock_mhz: float, library: Path | None = None):
        self.emulator, self.clock_mhz = emulator, clock_mhz
        self._library = _library(library or build_emulator(emulator))
        self._line = self._library.coincid_line_new(emulator.clocks_per_bit)
        self._room = ctypes.create_string_buffer(ROOM)
        if library is None:
            self.reset()

    def __enter__(self) -> "SimulatedPort":
        return self

    def __exit__(self, *_: object) -> None:
        self._library.coincid_line_delete(self._line)
        self._line = None

    def reset(self) -> None:
        """Resets the emulator."""
        self._library.coincid_line_reset(self._line, RESET_CYCLES)

    def connect(self, connected: bool) -> None:
        """Pulls the cable, or puts it back."""
        self._library.coincid_line_connect(self._line, connected)

    def write(self, data: bytes) -> None:
        """Sends bytes, while time goes on."""
        self._library.coincid_line_send(self._line, data, len(data))

    def read(self) -> bytes:
        """What comes: as soon as a byte does, or nothing in `READ_CYCLES`."""
        n = self._library.coincid_line_run(self._line, READ_CYCLES, self._room, ROOM)
        return self._room.raw[:n]

    @property
    def cycles(self) -> int:
        """Clock cycles that were simulated."""
        return self._library.coincid_line_cycle(self._line)

    def now(self) -> float:
        """Simulated seconds."""
        return self.cycles / (self.clock_mhz * 1e6)
