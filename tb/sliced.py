# SPDX-License-Identifier: Apache-2.0
"""Sliced engine: plays whole frames of the RTL without Python in the loop; every subgroup is a
lane of a SIMD word.

A subgroup with its line of the TDC (`hdl/subgroup_pair.py`, `Slice`) becomes a netlist in slices
(room `slices`), the core is Verilated, and `sliced.cpp` wires them. So one pass plays all
subgroups, and several sensors if there are lanes for them. Registers are programmed over the
real AXI4-Lite port; beats come back with the cycles of their transfer.
"""

import ctypes
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from threading import Event, Lock
from typing import Any

import numpy as np

from ..hdl.minigroup import Minigroup
from ..hdl.sensor import CORE
from ..hdl.sequencer import IDLE_AFTER
from ..hdl.subgroup import shared_ports
from ..hdl.subgroup_pair import Slice
from ..host.driver import Driver
from ..host.transport import RefusedError, changes
from ..model.contract import registers
from ..model.contract.config import Config
from ..model.contract.edges import Edges
from ..model.contract.parameters import Sensor
from ..model.contract.pixels import port_bits
from ..model.shared.errors import check_integer
from ..model.shared.folders import build_root
from ..slices.emit import DarkInput
from ..slices.library import LANES, compiled, library, widest
from ..slices.probe import Probe, numbers
from ..slices.synthesis import Design
from ..slices.waves import write_vcd
from ..tools.libraries import Functions, array_at, load
from . import toolchain
from .engines import sensors_together
from .frame_record import STORED_TO_COMMIT, FrameJob, Recorded, cycle_limit
from .rtl import of_one_subgroup, rtl_in_two, sensor_key
from .rtl_errors import SimulationError
from .slice_proof import prove_module
from .verilated import objects_in, run_time, verilated_unit

SOURCE = Path(__file__).with_name("sliced.cpp")
# Of the core's ports for a stream, without their suffix, in the order of the arguments of `visit`.
STREAM_NETS = "stored", "record_stored", "valid", "beat", "beat_controlled", "grant", "send"
CHUNK_CYCLES = 20_000  # between two checks of progress and Ctrl-C
RESET_CYCLES = 4
SOFT_RESET_CYCLES = 30  # after which a write to `control` has had its effect
# the core is a sixth of the time of a frame; with -O2 it takes half as long again to compile
CORE_OPTIMISE = "-O1"
FINE, REFUSED, HANGS = range(3)


def design(sensor: Sensor) -> Design:
    """Return the netlist in slices of a subgroup with its line of the TDC. It does not depend on
    the size of the array.
    """
    _, files = rtl_in_two(sensor)
    return Design(
        sensor_key(of_one_subgroup(sensor)),
        {path.name: path.read_text(encoding="utf-8") for path in files},
        Slice.unit_name,
        units=[Minigroup.unit_name],
        dark_inputs=[DarkInput(Minigroup.unit_name, "words", sensor.phases)],
    )


def wiring_header(sensor: Sensor) -> str:
    """Return the C++ header that describes a sensor to `sliced.cpp`."""
    firsts = [sensor.stream_subgroups(stream).start for stream in range(sensor.streams)]
    most = max(len(sensor.stream_subgroups(stream)) for stream in range(sensor.streams))
    widest = max(Slice(sensor).flat_ports()[name][1].shape().width for name in shared_ports(sensor))
    visits = []
    for stream in range(sensor.streams):
        axis = [
            f"core.{sensor.stream_name(stream)}_{wire}"
            for wire in ("tdata", "tvalid", "tready", "tlast")
        ]
        nets = [f"core.{net}_of_{stream}" for net in STREAM_NETS]
        visits.append(f"    visit({stream}, {', '.join(axis + nets)});")
    return "\n".join(
        [
            "#pragma once",
            '#include "Vcore.h"',
            f"constexpr int SUBGROUPS = {sensor.subgroups}, STREAMS = {sensor.streams}, STORED_TO_COMMIT = {STORED_TO_COMMIT};",
            # Two more words, so that 64 bits can be read from any place.
            f"constexpr int GRANT_WORDS = {-(-most // 32) + 2}, SHARED_WORDS = {-(-widest // 32)}, RESET_CYCLES = {RESET_CYCLES};",
            f"constexpr int STREAM_FIRST[] = {{{', '.join(map(str, firsts))}}};",
            f"constexpr int64_t IDLE_PERIOD = {_idle_period(sensor)};",
            "template <class Visit> void for_each_stream(Vcore& core, Visit visit) {",
            *visits,
            "}",
            "",
        ]
    )


def _idle_period(sensor: Sensor) -> int:
    """Return the cycles after which an idle slice is as it was: its coarse counter has wrapped."""
    return max(1 << sensor.coarse_bits, 1 << IDLE_AFTER.bit_length())


def build_library(sensor: Sensor, sensors: int = 1) -> ctypes.CDLL:
    """Compile the engine for some sensors at once, unless it is there already, and load it. A
    process looks for it once.
    """
    return _library(sensor, lanes(sensor, sensors), build_root())


@cache
def _library(sensor: Sensor, width: int, root: Path) -> ctypes.CDLL:
    """Return the engine for words of `width` bits. root: folder of its build."""
    for_core, for_slices = rtl_in_two(sensor)
    with ThreadPoolExecutor() as pool:
        proof = pool.submit(prove_module, sensor, for_slices)
        core = pool.submit(
            verilated_unit, CORE, "Vcore", for_core, [toolchain.NOT_INLINED], CORE_OPTIMISE
        )
        support = pool.submit(run_time)
        slices = design(sensor)
        compiled(slices, width)  # while the core is compiled
        proof.result()
        objects = objects_in(core.result(), support.result())
    include = [core.result(), toolchain.verilator().parents[1] / "include"]
    path = library(slices, width, SOURCE, wiring_header(sensor), include, objects)
    pointer, i64, u32, i32 = ctypes.c_void_p, ctypes.c_int64, ctypes.c_uint32, ctypes.c_int
    rows = ctypes.POINTER(pointer)
    functions: Functions = {
        "new": (pointer, [i32]),
        "delete": (None, [pointer]),
        "run": (i32, [pointer, i64]),
        "run_busy": (i32, [pointer, i64]),
        "cycles": (i64, [pointer]),
        "write": (None, [pointer, i32, u32, u32]),
        "read": (None, [pointer, i32, u32]),
        "wait": (None, [pointer, i32, u32, u32]),
        "frame": (
            None,
            [
                pointer,
                i32,
                u32,
                u32,
                i64,
                pointer,
                pointer,
                pointer,
                pointer,
                i64,
                i64,
                i64,
                i64,
            ],
        ),
        "write_during_frame": (None, [pointer, i32, u32, u32]),
        "reset": (None, [pointer, i32]),
        "give_up": (None, [pointer, i32]),
        "outcome": (i32, [pointer, i32]),
        "value": (u32, [pointer, i32]),
        "cycle": (i64, [pointer, i32]),
        "hung": (i64, [pointer, i32]),
        "records": (i64, [pointer, i32]),
        "beats": (i64, [pointer, i32, i64, i32, rows]),
        "commits": (i64, [pointer, i32, i64, rows]),
        "forget": (None, [pointer, i32]),
        "tap": (None, [pointer, i32, i32]),
        "untap": (None, [pointer, i32]),
        "samples": (i64, [pointer, i32, i32, rows]),
        "words": (pointer, [pointer, i32, i32, ctypes.POINTER(i32)]),
    }
    return load(path, "sliced", functions)


def lanes(sensor: Sensor, sensors: int) -> int:
    """Return the width of the word that plays some sensors fastest on this processor.

    Short words need less memory, but words of 64 bits have no instruction for an arbitrary
    function of three words.
    """
    each = sensor.subgroups
    chunks = -(-sensors // (64 // each)) if each < 64 else -(-each // 64) * sensors
    widths = [width for width in LANES[1:] if width <= widest()]
    return next((width for width in widths if width >= 64 * chunks), widths[-1])


class Engine:
    """Sensors with the same parameters, in the lanes of one library, that come from a reset."""

    def __init__(self, sensor: Sensor, sensors: int = 1):
        self._library = build_library(sensor, sensors)
        self._lanes = lanes(sensor, sensors)
        self._engine = self._library.sliced_new(sensors)

    def close(self) -> None:
        self._library.sliced_delete(self._engine)
        self._engine = None

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function of `sliced.cpp`. Raises `SimulationError` after `close`."""
        if self._engine is None:
            raise SimulationError("the sliced engine is closed")
        return getattr(self._library, f"sliced_{name}")(self._engine, *arguments)

    def run(self, progress: Callable[[], None] = lambda: None) -> None:
        """Run until no sensor has anything left to do."""
        while self.call("run_busy", CHUNK_CYCLES):
            progress()

    def words(self, sensor: int, subgroup: int, words: int) -> tuple[np.ndarray, int]:
        """Return the words that hold a subgroup, uint64[words, parts], and its lane in them."""
        lane = ctypes.c_int()
        pointer = self.call("words", sensor, subgroup, ctypes.byref(lane))
        return array_at(pointer, (words, self._lanes // 64)), lane.value


class SlicedSensor:
    """A sensor that comes from a reset. A context manager.

    It is a transport of the host driver, which programs it. A frame needs light, so `frame`
    starts it.
    engine, number: an engine with several sensors, and the number of this one; None: an engine
    of its own.
    """

    def __init__(self, sensor: Sensor, engine: Engine | None = None, number: int = 0):
        self.sensor = sensor
        self._engine, self._number = engine or Engine(sensor), number
        self.driver = Driver(self, sensor, fresh=True)
        self._beats: list[np.ndarray] = [np.zeros(0, np.uint64)] * sensor.streams
        self._recorded: list[int] = []

    def __enter__(self) -> "SlicedSensor":
        return self

    def __exit__(self, *_: object) -> None:
        self._engine.close()

    def _call(self, name: str, *arguments: Any) -> Any:
        return self._engine.call(name, self._number, *arguments)

    def write(self, address: int, value: int) -> None:
        """Write a register. Raises `RefusedError` if the sensor answers SLVERR."""
        self._call("write", address, value)
        self._finish(f"write of {value:#x} to {address:#07x}")

    def read(self, address: int) -> int:
        """Read a register. Raises `RefusedError` if the sensor answers SLVERR."""
        self._call("read", address)
        self._finish(f"read of {address:#07x}")
        return self._call("value")

    def receive(self, stream: int) -> np.ndarray:
        """Return the beats (uint64) of the last frame; a second call returns none."""
        beats, self._beats[stream] = self._beats[stream], np.zeros(0, np.uint64)
        return beats

    def frame(
        self,
        config: Config,
        edges: Edges,
        ready: np.ndarray | None = None,
        progress: Callable[[int], None] = lambda cycle: None,
    ) -> Recorded:
        """Program the settings, play a frame, and return its record, as `cosim.SensorBench.play`
        does.
        """
        self.begin(config, edges, ready)
        return self.end(progress)

    def begin(self, config: Config, edges: Edges, ready: np.ndarray | None = None) -> None:
        """Program the settings and start a frame, which `step` and `end` play."""
        self.driver.program(config)
        self._post(config, edges, ready)

    def step(self, cycles: int = 1) -> bool:
        """Play some cycles of the frame, and return whether it goes on."""
        return bool(self._engine.call("run", cycles))

    @property
    def cycle(self) -> int:
        """Cycle of the frame that `begin` has started, -1 before its first one."""
        return self._call("cycle")

    def abort(self) -> None:
        """Make the running period the last one of the frame that `begin` has started; in a gap,
        end it.
        """
        self._call("write_during_frame", *registers.control("abort"))

    def reset(self) -> None:
        """Reset the sensor, whatever it is doing. Its settings and the frame are gone."""
        self._call("reset")
        self.driver = Driver(self, self.sensor, fresh=True)

    def soft_reset(self) -> None:
        """Reset the sensor by its register during the frame that `begin` has started, and forget
        the frame.
        """
        self._call("write_during_frame", *registers.control("reset"))
        self.step(SOFT_RESET_CYCLES)
        self._call("give_up")
        self.driver = Driver(self, self.sensor, fresh=True)

    def end(self, progress: Callable[[int], None] = lambda cycle: None) -> Recorded:
        """Play the rest of the frame and return its record."""
        self._finish("start", lambda: progress(self._call("cycle")))
        self.driver.finish()
        (record,) = self.records()
        self._beats = list(record.beats)
        return record

    def post(self, programmed: dict[int, int], job: FrameJob) -> None:
        """Queue a frame behind everything else. programmed: the settings that the sensor will
        have by then, which are updated.
        """
        for address, value in changes(job.config.register_writes(), programmed):
            self._call("write", address, value)
            programmed[address] = value
        self._post(job.config, job.edges, job.ready)
        done = 1 << registers.BY_NAME["status"].bit("done")
        self._call("wait", registers.address("status"), done)
        self._call("write", registers.address("status"), done)

    def _post(self, config: Config, edges: Edges, ready: np.ndarray | None) -> None:
        receiver = np.ascontiguousarray([] if ready is None else ready, np.uint8)
        columns = [np.ascontiguousarray(column, np.int64) for column in port_bits(config, edges)]
        self._call(
            "frame",
            *registers.control("start"),
            len(columns[0]),
            *(column.ctypes.data for column in columns),
            receiver.ctypes.data,
            len(receiver),
            config.link_share.numerator,
            config.link_share.denominator,
            cycle_limit(config, len(receiver)),
        )

    def _finish(self, what: str, progress: Callable[[], None] = lambda: None) -> None:
        self._engine.run(progress)
        self.check(what)

    def check(self, what: str) -> None:
        """Raise `RefusedError` or `SimulationError` if anything that the sensor had to do has
        failed.
        """
        outcome = self._call("outcome")
        if outcome == HANGS:
            raise SimulationError(
                f"no frame end within {self._call('hung')} cycles: the sensor hangs"
            )
        if outcome == REFUSED:
            self._call("forget")
            status = (
                f", status {self.read(registers.address('status')):#x}" if what == "start" else ""
            )
            raise RefusedError(f"{what}: SLVERR{status}")

    def records(self) -> list[Recorded]:
        """Return the records of the frames since the last call."""
        found = []
        for k in range(self._call("records")):
            beats, cycles = [], []
            for stream in range(self.sensor.streams):
                rows = self._rows("beats", k, stream)
                beats.append(rows[:, 0].copy())
                cycles.append(rows[:, 1].astype(np.int64))
            commits = self._rows("commits", k).astype(np.int64)
            commits = commits[np.argsort(commits[:, 0], kind="stable")]
            found.append(
                Recorded(
                    beats, cycles, commits[:, 0], commits[:, 1], max(int(c[-1]) for c in cycles) + 1
                )
            )
        self._call("forget")
        return found

    def _rows(self, name: str, *which: int, columns: int = 2) -> np.ndarray:
        """Return rows that the engine keeps, uint64[n, columns]."""
        pointer = ctypes.c_void_p()
        n = self._call(name, *which, ctypes.byref(pointer))
        return array_at(pointer.value, (n, columns))

    def peek(self, subgroup: int, name: str) -> int:
        """Return the present value of a signal of a subgroup, by its path below
        `hdl/subgroup_pair.py`'s `Slice`.
        """
        probe = _probe(self.sensor)
        words, lane = self._words(subgroup)
        part = np.ascontiguousarray(words[:, lane // 64, None])
        return numbers(probe.values(part, [name])[name])[lane % 64]

    def poke(self, subgroup: int, name: str, value: int) -> None:
        """Set a register of a subgroup. Raises `KeyError` if it is not a register."""
        probe = _probe(self.sensor)
        words, lane = self._words(subgroup)
        for k, word in enumerate(probe.words(name)):
            bit = np.uint64(1 << (lane % 64))
            words[word, lane // 64] = words[word, lane // 64] & ~bit | bit * np.uint64(
                value >> k & 1
            )

    def _words(self, subgroup: int) -> tuple[np.ndarray, int]:
        """Return the words that hold a subgroup, and its lane in them. Raises `InputError`."""
        words = _probe(self.sensor).layout.words
        return self._engine.words(self._number, self._checked(subgroup), words)

    def _checked(self, subgroup: int) -> int:
        return check_integer("subgroup", subgroup, 0, self.sensor.subgroups - 1)

    def signals(self) -> list[str]:
        """Return the paths of all signals of a subgroup, for `peek` and `waves`."""
        return sorted(_probe(self.sensor).signals)

    def watch(self, *subgroups: int) -> None:
        """Record these subgroups in every cycle from now on, for `waves`. Raises `InputError`."""
        recorded = [self._checked(subgroup) for subgroup in subgroups]
        self._call("untap")
        self._recorded = recorded
        for subgroup in recorded:
            self._call("tap", subgroup)

    def waves(self, path: Path, names: Sequence[str] | None = None, cycle_ps: int = 2000) -> None:
        """Write what was watched as a VCD file. names: paths of signals; None: all. cycle_ps:
        length of a clock cycle.
        """
        lanes = {}
        for k, subgroup in enumerate(self._recorded):
            columns = -(-_probe(self.sensor).layout.words // 64)
            lanes[f"subgroup_{subgroup}"] = self._rows("samples", k, columns=columns)
        write_vcd(path, _probe(self.sensor), lanes, names=names, cycle_ps=cycle_ps)


@cache
def _probe(sensor: Sensor) -> Probe:
    return Probe(design(sensor).emission())


def play_side_by_side(
    chains: Sequence[Sequence[FrameJob]],
    progress: Callable[[int], None] | None = None,
    threads: int | None = None,
) -> list[list[Recorded]]:
    """Play chains of frames, each chain on a sensor of its own that comes from a reset; return
    their records.

    progress: called with the cycles done, summed over the sensors. threads: None: one per core.
    """
    sensor = chains[0][0].config.sensor
    threads = min(threads or os.cpu_count() or 1, len(chains))
    each = min(sensors_together(sensor.subgroups), -(-len(chains) // threads))
    build_library(sensor, each)  # once, before the threads
    batches = [chains[k : k + each] for k in range(0, len(chains), each)]
    done, lock, stopped = [0] * len(batches), Lock(), Event()

    def play(number: int) -> list[list[Recorded]]:
        def tell() -> None:
            if stopped.is_set():
                raise InterruptedError
            with lock:
                done[number] = engine.call("cycles")
                if progress:
                    progress(sum(done))

        engine = Engine(sensor, each)
        try:
            sensors = [SlicedSensor(sensor, engine, k) for k in range(len(batches[number]))]
            for one, chain in zip(sensors, batches[number], strict=True):
                programmed = registers.reset_values(sensor)
                for job in chain:
                    one.post(programmed, job)
            engine.run(tell)
            tell()
            for one in sensors:
                one.check("start")
            return [one.records() for one in sensors]
        finally:
            engine.close()

    with ThreadPoolExecutor(threads) as pool:
        try:
            return [records for found in pool.map(play, range(len(batches))) for records in found]
        except BaseException:
            stopped.set()  # the other threads end, too
            raise
