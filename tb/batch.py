# SPDX-License-Identifier: Apache-2.0
"""Batch engine: plays whole frames through the Verilated sensor, without Python in the loop.

The repeated unit (a module) and the rest (the core) are compiled once each and wired in C++ (`batch.cpp`), so the build
does not grow with the array. Registers are programmed over the real AXI4-Lite port; beats come back with the cycles of
their transfer.
"""

import ctypes
import os
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from ..hdl.sensor import COMBINED, CORE, GRANTED, LISTED
from ..hdl.subgroup import own_ports
from ..host.driver import Driver
from ..host.transport import RefusedError
from ..model.contract import registers
from ..model.contract.config import Config
from ..model.contract.edges import Edges
from ..model.contract.parameters import Sensor
from ..model.contract.ports import port_bits
from ..model.shared.folders import build_root
from ..model.shared.sources import digest
from . import toolchain
from .errors import SimulationError
from .frames import STORED_TO_COMMIT, Recorded, cycle_limit
from .rtl import rtl_in_two, sensor_key

SOURCE = Path(__file__).with_name("batch.cpp")
LIBRARY = "libcoincid.so"
MODULE = "coincid_module"
RUN_TIME = "libverilated.a"
CHUNK_CYCLES = 20_000  # between two checks of progress and Ctrl-C
MODULES_A_THREAD = 2  # fewer modules are not worth a thread
RUNNING, DELIVERED, HANGS = range(3)
VERILATOR = ("--cc", *toolchain.VERILATOR_OPTIONS)
COMPILER = ("-std=gnu++20", "-O2", "-fPIC")
# Each unit is one file for the compiler: separate, forty small files and two precompiled headers take twice as long.
MAKE_OPTIONS = ("VM_PARALLEL_BUILDS=0", f"OPT_FAST={toolchain.OPTIMISE}", "OPT_GLOBAL=-O2")


def wiring_header(sensor: Sensor) -> str:
    """Return the C++ header that describes a sensor to `batch.cpp`."""
    n = sensor.subgroups
    firsts = [sensor.stream_subgroups(stream).start for stream in range(sensor.streams)]
    most = max(len(sensor.stream_subgroups(stream)) for stream in range(sensor.streams))
    visits = []
    for stream in range(sensor.streams):
        axis = [f"core.{sensor.stream_name(stream)}_{wire}" for wire in ("tdata", "tvalid", "tready", "tlast")]
        nets = [f"core.{net}_of_{stream}" for net in (*LISTED, *COMBINED, *GRANTED)]
        visits.append(f"    visit({stream}, {', '.join(axis + nets)});")
    lines = ["template <int LINE> struct Line;"]
    for line in range(2):
        lines.append(f"template <> struct Line<{line}> {{")
        lines += [
            f"    static auto& {port}(Vmodule& module) {{ return module.{port}_{line}; }}" for port in own_ports(sensor)
        ]
        lines.append("};")
    return "\n".join(
        [
            "#pragma once",
            '#include "Vcore.h"',
            '#include "Vmodule.h"',
            f"constexpr int SUBGROUPS = {n}, STREAMS = {sensor.streams}, STORED_TO_COMMIT = {STORED_TO_COMMIT};",
            f"constexpr int GRANT_WORDS = {-(-most // 32) + 1};",
            f"constexpr int STREAM_FIRST[] = {{{', '.join(map(str, firsts))}}};",
            "template <class Visit> void for_each_stream(Vcore& core, Visit visit) {",
            *visits,
            "}",
            *lines,
            "",
        ]
    )


def build_library(sensor: Sensor) -> Path:
    """Compile the engine's library for a sensor, once."""
    for_core, for_module = rtl_in_two(sensor)
    header = wiring_header(sensor)
    # The module does not depend on the array, so sensors of all sizes share its library. If the number of subgroups is odd,
    # the last module is used by half. Nearly all time is spent in the modules; inlined, they run twice as fast. The core is
    # what grows with the array.
    module = verilated_unit(MODULE, "Vmodule", for_module)
    core = verilated_unit(CORE, "Vcore", for_core, [toolchain.NOT_INLINED])
    key = _key(header, SOURCE.read_text(), module.name, core.name)
    directory = build_root() / "batch" / f"{sensor_key(sensor)}-{key}"

    def make(scratch: Path) -> None:
        log = directory.with_name(f"{directory.name}.log")
        log.unlink(missing_ok=True)
        (scratch / "wiring.h").write_text(header)
        include = ["-I.", f"-I{module}", f"-I{core}", f"-I{toolchain.verilator().parents[1] / 'include'}"]
        command = ["g++", "-shared", *COMPILER, "-o", LIBRARY, str(SOURCE), *include]
        archives = [core / "libVcore.a", module / "libVmodule.a", run_time()]
        toolchain.compile_in(scratch, log, [*command, *map(str, archives), "-lpthread", "-latomic"])

    return toolchain.build_once(directory, make) / LIBRARY


def verilated_unit(top: str, prefix: str, sources: list[Path], options: Sequence[str] = ()) -> Path:
    """Verilate a unit: its headers and archive, in a folder keyed by its sources and options."""
    return _archive(f"lib{prefix}.a", top, prefix, {path.name: path.read_text() for path in sources}, options)


def run_time() -> Path:
    """Return the archive of Verilator's run-time library, the same one for every unit."""
    top = "coincid_nothing"
    return _archive(RUN_TIME, top, "Vnothing", {f"{top}.v": f"module {top}; endmodule\n"}) / RUN_TIME


def _archive(archive: str, top: str, prefix: str, sources: Mapping[str, str], options: Sequence[str] = ()) -> Path:
    """Return a folder with an archive that Verilator's make file builds for the `sources`, and their headers."""
    contents = (part for item in sources.items() for part in item)
    directory = build_root() / "batch" / f"{top}-{_key(archive, top, *options, *contents)}"

    def make(scratch: Path) -> None:
        log = directory.with_name(f"{directory.name}.log")
        log.unlink(missing_ok=True)
        for name, text in sources.items():
            (scratch / name).write_text(text)
        flags = [*options, "-CFLAGS", "-fPIC", "--top-module", top, "--prefix", prefix, "--Mdir", "."]
        toolchain.compile_in(scratch, log, [str(toolchain.verilator()), *VERILATOR, *flags, *sources])
        jobs = str(os.cpu_count())
        toolchain.compile_in(scratch, log, ["make", "-s", "-j", jobs, "-f", f"{prefix}.mk", *MAKE_OPTIONS, archive])
        for path in scratch.iterdir():
            if path.suffix not in (".h", ".a"):
                path.unlink()

    return toolchain.build_once(directory, make)


def _key(*parts: str) -> str:
    return digest(str(toolchain.verilator()), *VERILATOR, *COMPILER, *MAKE_OPTIONS, *parts)


@cache
def _library(path: Path) -> ctypes.CDLL:
    library = ctypes.CDLL(str(path))
    pointer, i64 = ctypes.c_void_p, ctypes.c_int64
    u32 = ctypes.c_uint32
    signatures = {
        "new": (pointer, [ctypes.c_int]),
        "delete": (None, [pointer]),
        "write": (ctypes.c_int, [pointer, u32, u32]),
        "read": (ctypes.c_int, [pointer, u32, ctypes.POINTER(u32)]),
        "start": (ctypes.c_int, [pointer, pointer, pointer, pointer, pointer, i64, i64, i64, u32, u32]),
        "run": (ctypes.c_int, [pointer, i64]),
        "cycle": (i64, [pointer]),
        "beats": (i64, [pointer, ctypes.c_int, ctypes.POINTER(pointer)]),
        "commits": (i64, [pointer, ctypes.POINTER(pointer)]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, f"coincid_{name}")
        function.restype, function.argtypes = result, arguments
    return library


class BatchSensor:
    """A sensor, first under reset, then in use. A context manager; `threads` share the modules.

    It is a transport of the host driver, which programs it. A frame needs light, so `frame` starts it.
    """

    def __init__(self, sensor: Sensor, threads: int | None = None):
        self.sensor = sensor
        self._library = _library(build_library(sensor))
        modules = -(-sensor.subgroups // 2)
        self._engine = self._library.coincid_new(
            threads or max(1, min(os.cpu_count() or 1, modules // MODULES_A_THREAD))
        )
        self.driver = Driver(self, sensor, fresh=True)
        self._beats: list[np.ndarray] = [np.zeros(0, np.uint64)] * sensor.streams

    def __enter__(self) -> "BatchSensor":
        return self

    def __exit__(self, *_: object) -> None:
        self._library.coincid_delete(self._engine)
        self._engine = None

    def write(self, address: int, value: int) -> None:
        """Write a register. Raises `RefusedError` if the sensor answers SLVERR."""
        if self._library.coincid_write(self._engine, address, value):
            raise RefusedError(f"write of {value:#x} to {address:#07x}: SLVERR")

    def read(self, address: int) -> int:
        """Read a register. Raises `RefusedError` if the sensor answers SLVERR."""
        value = ctypes.c_uint32()
        if self._library.coincid_read(self._engine, address, value):
            raise RefusedError(f"read of {address:#07x}: SLVERR")
        return value.value

    def receive(self, stream: int) -> np.ndarray:
        """Return the beats (uint64) of the last frame, once."""
        beats, self._beats[stream] = self._beats[stream], np.zeros(0, np.uint64)
        return beats

    def frame(
        self,
        config: Config,
        edges: Edges,
        ready: np.ndarray | None = None,
        progress: Callable[[int], None] = lambda cycle: None,
    ) -> Recorded:
        """Program the settings, play a frame, and return its record, as `cosim.SensorBench.play` does."""
        self.driver.program(config)
        ready = np.ascontiguousarray(config.tready(ready))
        cycle, bit, bounds = _by_subgroup(config, edges)
        control = registers.BY_NAME["control"]
        refused = self._library.coincid_start(
            self._engine,
            cycle.ctypes.data,
            bit.ctypes.data,
            bounds.ctypes.data,
            ready.ctypes.data,
            len(ready),
            config.frame_cycles,
            cycle_limit(config, len(ready)),
            registers.address("control"),
            1 << control.bit("start"),
        )
        if refused:
            raise RefusedError(f"start: SLVERR, status {self.read(registers.address('status')):#x}")
        while (status := self._library.coincid_run(self._engine, CHUNK_CYCLES)) == RUNNING:
            progress(self._library.coincid_cycle(self._engine))
        if status == HANGS:
            raise SimulationError(
                f"no frame end after {self._library.coincid_cycle(self._engine)} cycles: the sensor hangs"
            )
        self.driver.finish()
        beats, cycles = [], []
        for stream in range(self.sensor.streams):
            rows = self._rows(self._library.coincid_beats, stream)
            beats.append(rows[:, 0].copy())
            cycles.append(rows[:, 1].astype(np.int64))
        self._beats = list(beats)
        commits = self._rows(self._library.coincid_commits).astype(np.int64)
        commits = commits[np.argsort(commits[:, 0], kind="stable")]
        return Recorded(beats, cycles, commits[:, 0], commits[:, 1], max(int(c[-1]) for c in cycles) + 1)

    def _rows(self, get: Callable[..., int], *which: int) -> np.ndarray:
        """Return pairs of 64-bit words that the engine keeps, as uint64[n, 2]."""
        pointer = ctypes.c_void_p()
        n = get(self._engine, *which, ctypes.byref(pointer))
        if not n:
            return np.zeros((0, 2), np.uint64)
        return np.ctypeslib.as_array(ctypes.cast(pointer, ctypes.POINTER(ctypes.c_uint64)), (n, 2))


def _by_subgroup(config: Config, edges: Edges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return cycle (int64[n]) and port bit (int32[n]) of every edge by subgroup, then cycle, and the subgroups' bounds."""
    cycle, subgroup, bit = port_bits(config, edges)
    order = np.argsort(subgroup * config.frame_cycles + cycle, kind="stable")
    bounds = np.concatenate([[0], np.cumsum(np.bincount(subgroup, minlength=config.sensor.subgroups))])
    return cycle[order], bit[order].astype(np.int32), bounds.astype(np.int64)
