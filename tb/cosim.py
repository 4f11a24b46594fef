# SPDX-License-Identifier: Apache-2.0
"""The cocotb test that plays frames through the sensor. It runs inside the simulator; `play.py`
starts it.

The test bench acts at falling edges: there it reads the outputs of the cycle and sets new
inputs. The rising edge that ends the cycle takes these.
"""

import os
import pickle
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import cocotb
import numpy as np
from cocotb.clock import Clock
from cocotb.task import Task
from cocotb.triggers import FallingEdge, RisingEdge, Timer
from cocotb_bus.drivers.amba import AXI4LiteMaster

from coincid.hdl import bus
from coincid.hdl.sequencer import LEAD
from coincid.hdl.silicon.circuit import STEP_FS, clock_fs
from coincid.host.transport import changes
from coincid.model.contract import registers
from coincid.model.contract.config import Config
from coincid.model.contract.edges import Edges
from coincid.model.contract.link import takes_beat
from coincid.model.contract.parameters import CLOCK_MHZ, Sensor
from coincid.tb.frame_record import (
    JOB_VARIABLE,
    MISMATCH,
    PROGRESS,
    RESULT,
    STORED_TO_COMMIT,
    Recorded,
    cycle_limit,
    load_job,
)
from coincid.tb.rtl_errors import Mismatch
from coincid.tb.scoreboard import Scoreboard
from coincid.tb.stimulus import FS_PER_PS, line_levels, port_words

PROGRESS_CYCLES = 500


class SensorBench:
    """Handles of the sensor, the master of its register bus, and the frame player."""

    step_fs = 2 * FS_PER_PS  # half cycles are whole picoseconds, the simulation's time step

    def __init__(self, dut: Any, sensor: Sensor, clock_mhz: float = CLOCK_MHZ):
        self.dut, self.sensor, self.cycle_fs = dut, sensor, clock_fs(clock_mhz, self.step_fs)
        self.axi = AXI4LiteMaster(dut, "s_axi", dut.clk)
        self.spad = [getattr(dut, f"spad_{s}") for s in range(sensor.subgroups)]
        names = [sensor.stream_name(stream) for stream in range(sensor.streams)]
        self.tdata, self.tvalid, self.tready, self.tlast = (
            [getattr(dut, f"{name}_{wire}") for name in names]
            for wire in ("tdata", "tvalid", "tready", "tlast")
        )
        self.stored = [getattr(dut, f"stored_of_{stream}") for stream in range(sensor.streams)]
        self.programmed: dict[int, int] = {}  # byte address -> value

    async def reset(self) -> None:
        """Start the clock and reset the sensor; afterwards the bench does not know the
        programmed settings.
        """
        for line in (*self.spad, *self.tready):
            line.value = 0
        self.dut.test_enable.value = 0
        self.dut.rst.value = 1
        Clock(self.dut.clk, self.cycle_fs, "fs").start()
        for _ in range(4):
            await RisingEdge(self.dut.clk)
        self.dut.rst.value = 0
        for _ in range(4):
            await RisingEdge(self.dut.clk)
        self.programmed.clear()

    async def write(self, name: str, value: int, subgroup: int = 0, index: int = 0) -> None:
        """Write a register. A refused write raises cocotb-bus's `AXIProtocolError`."""
        await self.axi.write(registers.address(name, subgroup, index), value)

    async def read(self, name: str, subgroup: int = 0, index: int = 0) -> int:
        """Read a register."""
        return int(await self.axi.read(registers.address(name, subgroup, index)))

    async def program(self, config: Config) -> None:
        """Write the settings that differ from those programmed before."""
        for address, value in changes(config.register_writes(), self.programmed):
            await self.axi.write(address, value)
            self.programmed[address] = value

    def shine(self, config: Config, edges: Edges) -> dict[int, list[tuple[int, int]]]:
        """Return the words that `play` drives, by cycle of the frame."""
        return port_words(config, edges)

    async def play(
        self,
        config: Config,
        edges: Edges,
        ready: np.ndarray,
        board: Scoreboard | None = None,
        progress: Callable[[int], None] = lambda cycle: None,
    ) -> Recorded:
        """Play a frame and return its record. `board` raises at the first difference from the
        golden model.
        """
        words = self.shine(config, edges)
        await self.program(config)
        inputs = _Inputs(self, words, config.link_share, ready)
        outputs = _Outputs(self, board)
        falling = FallingEdge(self.dut.clk)
        started = await self._start(falling)
        limit = cycle_limit(config, len(ready))
        frame_cycles = config.frame_cycles
        cycle = 0
        while True:
            is_ready = inputs.drive(cycle)
            outputs.read_commits(cycle)
            if is_ready:
                outputs.read_beats(cycle)
            cycle += 1
            if cycle % PROGRESS_CYCLES == 0:
                progress(cycle)
            if not outputs.running and cycle >= frame_cycles:
                break
            assert cycle < limit, f"no frame end after {cycle} cycles: the sensor hangs"
            await falling
        if board:
            board.finish()
        await started
        await self._acknowledge()
        return outputs.record(cycle)

    async def _start(self, falling: FallingEdge) -> Task[None]:
        """Start a frame and wait for cycle 0 of its first period; return the task that writes
        the register.
        """
        started = cocotb.start_soon(self.write("control", registers.control("start")[1]))
        laser = self.dut.laser
        for line in self.tready:
            line.value = 0
        while True:
            await falling
            if laser.value == 1:
                return started
            if started.done():
                started.result()  # a refused start raises here

    async def _acknowledge(self) -> None:
        """Wait until the sensor is done, and clear this bit of its status."""
        done = registers.BY_NAME["status"].bit("done")
        while not await self.read("status") >> done & 1:
            pass
        await self.write("status", 1 << done)


class _Inputs:
    """The light and `tready` of a frame. A line is written only when its value changes.

    words: (subgroup, word) by cycle of the frame. link_share: of the cycles in which the link takes
    a beat. receiver: as `ready` of a `FrameJob`.
    """

    def __init__(
        self,
        bench: SensorBench,
        words: dict[int, list[tuple[int, int]]],
        link_share: Fraction,
        receiver: np.ndarray,
    ):
        self._spad = bench.spad
        self._tready = bench.tready
        self._words = words
        self._link_share = link_share
        self._refused = {int(cycle) for cycle in np.flatnonzero(receiver == 0)}
        self._driven: set[int] = set()  # subgroups with light in the cycle before
        self._was_ready: bool | None = None

    def drive(self, cycle: int) -> bool:
        """Set the inputs of a cycle, and return `tready`."""
        now = self._words.get(cycle, ())
        for subgroup, word in now:
            self._spad[subgroup].value = word
        driven = {subgroup for subgroup, _ in now}
        for subgroup in self._driven - driven:
            self._spad[subgroup].value = 0
        self._driven = driven
        is_ready = cycle not in self._refused and takes_beat(self._link_share, cycle)
        if is_ready is not self._was_ready:
            for line in self._tready:
                line.value = int(is_ready)
            self._was_ready = is_ready
        return is_ready


class _Outputs:
    """The commits and beats of a frame. `board` raises at the first that differs from the golden
    model.

    running: streams whose last beat has not been read.
    """

    def __init__(self, bench: SensorBench, board: Scoreboard | None):
        streams = range(bench.sensor.streams)
        self.running = list(streams)
        self._bench = bench
        self._board = board
        self._first = [bench.sensor.stream_subgroups(stream).start for stream in streams]
        self._commits: list[tuple[int, int]] = []  # (subgroup, cycle)
        self._beats: list[list[int]] = [[] for _ in streams]
        self._beat_cycle: list[list[int]] = [[] for _ in streams]

    def read_commits(self, cycle: int) -> None:
        """Read which subgroups stored an event in a cycle."""
        for stream, stored in enumerate(self._bench.stored):
            bits = int(stored.value)
            while bits:
                lowest = bits & -bits
                bits ^= lowest
                subgroup = self._first[stream] + lowest.bit_length() - 1
                commit_cycle = cycle - STORED_TO_COMMIT
                self._commits.append((subgroup, commit_cycle))
                if self._board:
                    self._board.commit(subgroup, commit_cycle)

    def read_beats(self, cycle: int) -> None:
        """Read the beats that the running streams transfer in a cycle with `tready`."""
        bench = self._bench
        for stream in tuple(self.running):
            if bench.tvalid[stream].value == 1:
                data = int(bench.tdata[stream].value)
                last = bench.tlast[stream].value == 1
                self._beats[stream].append(data)
                self._beat_cycle[stream].append(cycle)
                if self._board:
                    self._board.beat(stream, cycle, data, last)
                if last:
                    self.running.remove(stream)

    def record(self, cycles: int) -> Recorded:
        """Return the record of a frame that took some cycles."""
        self._commits.sort(key=lambda commit: commit[0])
        commit_subgroup, commit_cycle = np.array(self._commits, np.int64).reshape(-1, 2).T
        return Recorded(
            [np.array(beats, np.uint64) for beats in self._beats],
            [np.array(cycle, np.int64) for cycle in self._beat_cycle],
            commit_subgroup,
            commit_cycle,
            cycles,
            self._board.checked if self._board else 0,
        )


class LineBench(SensorBench):
    """Bench of the asynchronous view: every edge rises at its own picosecond, driven by the task
    `light`.
    """

    step_fs = STEP_FS

    def shine(self, config: Config, edges: Edges) -> dict[int, list[tuple[int, int]]]:
        self.light = cocotb.start_soon(self._shine(line_levels(config, edges)))
        return {}

    async def _shine(self, levels: tuple[list[int], list[int], list[int]]) -> None:
        falling, start = (
            FallingEdge(self.dut.clk),
            1 << bus.time_layout(self.sensor)["start"].offset,
        )
        while True:
            await falling
            if int(self.dut.timing.value) & start:
                break
        # time of this falling edge; cycle 0 of the frame begins at 0
        now = self.cycle_fs // 2 - LEAD * self.cycle_fs
        for at, subgroup, word in zip(*levels, strict=True):
            if at > now:
                await Timer(at - now, "fs")
                now = at
            self.spad[subgroup].value = word


@cocotb.test()
async def play_job(dut: Any) -> None:
    """Play the job named in the environment and leave its records beside it, or else the first
    difference, as text.
    """
    path = Path(os.environ[JOB_VARIABLE])
    job, lines = load_job(path)
    bench = (LineBench if lines else SensorBench)(
        dut, job[0].config.sensor, job[0].config.clock_mhz
    )
    await bench.reset()
    records, before = [], 0
    for number, frame in enumerate(job):
        board = Scoreboard(bench.sensor, frame.expected, number) if frame.expected else None

        def progress(cycle: int, base: int = before) -> None:
            print(PROGRESS, base + cycle, flush=True)

        try:
            record = await bench.play(frame.config, frame.edges, frame.ready, board, progress)
        except Mismatch as mismatch:
            path.with_suffix(MISMATCH).write_text(str(mismatch), encoding="utf-8")
            raise
        before += record.cycles
        records.append(record)
    path.with_suffix(RESULT).write_bytes(pickle.dumps(records))
