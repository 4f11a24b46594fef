# SPDX-License-Identifier: Apache-2.0
"""The Verilated emulator behind its serial pins: a port for the host's serial transport, without a
board.
"""

import ctypes
import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from ..model.contract.parameters import Sensor
from ..model.shared.errors import check_integer
from ..model.shared.folders import build_root
from ..model.shared.sources import digest
from ..tb import toolchain
from ..tb.rtl import emitted, listed
from ..tb.verilated import COMPILER, include, objects_in, run_time, verilated_unit
from ..tools.build import Compile, compile_once
from ..tools.libraries import Functions, load
from .parameters import BUFFER_BEATS, CLOCKS_PER_BIT, Emulator
from .rtl.top import EMULATOR_LIST, SERIAL_TOP, emulator_files

SOURCE = Path(__file__).with_name("emulator.cpp")
LIBRARY = "libemulator.so"
READ_CYCLES = 2000  # time that a read waits for a byte
# for an answer on the fastest line, in simulated time; the longest request takes half of it
PATIENCE_S = 200e-6
ROOM = 4096
RESET_CYCLES = 8
SIMULATED_CLOCKS_PER_BIT = 4  # the fastest line


def simulated(
    sensor: Sensor, buffer_beats: int = BUFFER_BEATS, clocks_per_bit: int = SIMULATED_CLOCKS_PER_BIT
) -> Emulator:
    """Return an emulator of `sensor` for simulation, with the fastest line by default."""
    return Emulator(sensor=sensor, buffer_beats=buffer_beats, clocks_per_bit=clocks_per_bit)


def clocks_at(baud: int, clock_mhz: float) -> int:
    """Return the clock cycles per bit of a serial line. Raises `InputError` if the clock cannot
    make it.
    """
    clock_hz = clock_mhz * 1e6
    fewest, most = CLOCKS_PER_BIT
    low, high = math.ceil(clock_hz / most), math.floor(clock_hz / fewest)
    return round(clock_hz / check_integer("baud", baud, low, high, f"at {clock_mhz:g} MHz"))


def emulator_rtl(emulator: Emulator) -> list[Path]:
    """Return the emulator's Verilog files, emitted once for its parameters and the state of the
    sources.
    """
    name = f"emulator-{emulator.sensor.rows}x{emulator.sensor.cols}"
    folder = emitted(name, repr(emulator), lambda: emulator_files(emulator), "board")
    return listed(folder / EMULATOR_LIST)


def build_emulator(emulator: Emulator) -> Path:
    """Compile the library of an emulator's RTL behind its pins, once."""
    return build_line(emulator_rtl(emulator), SERIAL_TOP, [toolchain.NOT_INLINED])


def build_line(
    sources: list[Path], top: str, options: Sequence[str] = (), optimise: str = toolchain.OPTIMISE
) -> Path:
    """Compile the library of a design with the ports clk, rst, rx and tx, once. options: for
    Verilator; optimise: of g++.
    """
    unit = verilated_unit(top, "Vemulator", sources, options, optimise)
    directory = (
        build_root()
        / "verilated"
        / f"emulator-{digest(unit.name, *COMPILER, SOURCE.read_text(encoding='utf-8'))}"
    )

    def make(_: Path, run: Compile) -> None:
        command = [*COMPILER, "-O2", "-shared", "-o", LIBRARY, str(SOURCE), f"-I{unit}", *include()]
        run([*command, *map(str, objects_in(unit, run_time())), "-lpthread", "-latomic"])

    return compile_once(directory, make) / LIBRARY


@cache
def _library(path: Path) -> ctypes.CDLL:
    pointer, i64 = ctypes.c_void_p, ctypes.c_int64
    functions: Functions = {
        "new": (pointer, [ctypes.c_int]),
        "delete": (None, [pointer]),
        "reset": (None, [pointer, i64]),
        "connect": (None, [pointer, ctypes.c_int]),
        "send": (None, [pointer, ctypes.c_char_p, i64]),
        "run": (i64, [pointer, i64, ctypes.c_char_p, i64]),
        "cycle": (i64, [pointer]),
    }
    return load(path, "coincid_line", functions)


class SimulatedPort:
    """Serial port of a simulated emulator, for `SerialTransport`. A context manager. It begins with
    a reset.

    Its time is simulated, and passes only in `read`. clock_mhz: of the emulator. library: a design
    in place of the emulator's RTL; it resets itself.
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
        """Reset the emulator."""
        self._library.coincid_line_reset(self._line, RESET_CYCLES)

    def connect(self, connected: bool) -> None:
        """Pull the cable, or plug it in again."""
        self._library.coincid_line_connect(self._line, connected)

    def write(self, data: bytes) -> None:
        """Send bytes; time goes on while they are sent."""
        self._library.coincid_line_send(self._line, data, len(data))

    def read(self) -> bytes:
        """Return the next byte as soon as it arrives, or nothing after `READ_CYCLES`."""
        n = self._library.coincid_line_run(self._line, READ_CYCLES, self._room, ROOM)
        return self._room.raw[:n]

    @property
    def cycles(self) -> int:
        """Return the number of simulated clock cycles."""
        return self._library.coincid_line_cycle(self._line)

    def now(self) -> float:
        """Simulated seconds."""
        return self.cycles / (self.clock_mhz * 1e6)
