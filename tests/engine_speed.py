# SPDX-License-Identifier: Apache-2.0
"""Speed of the sliced engine beside the whole RTL in Verilator without cocotb: same RTL, same light, same machine.

`python -m tests.engine_speed [--rounds N]` prints build times, memory and a table of cycles per second. A round plays every
program once, so that other load affects all. Verilator's model has no public signals and no waveform; its host
(`lean.cpp`) only drives and counts.
"""

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from coincid.model.contract import registers
from coincid.model.contract.config import Config
from coincid.model.contract.edges import Edges
from coincid.model.contract.parameters import TOP, Sensor
from coincid.model.contract.pixels import port_bits
from coincid.study.bench import Job
from coincid.tb import toolchain
from coincid.tb.frame_record import FrameJob
from coincid.tb.rtl import rtl
from coincid.tb.sliced import SlicedSensor, build_library, play_side_by_side
from coincid.tools.build import compile_in

SOURCE = Path(__file__).with_name("lean.cpp")
SIZE = "32x32"
EACH = 32  # frames of a thread, or of a process
COMPILER = ("-CFLAGS", "-std=gnu++20", "-MAKEFLAGS", "OPT_FAST=-O2")
MIB = 1 << 20


def build_lean(sensor: Sensor, threads: int, folder: Path) -> Path:
    """Compile Verilator's whole sensor with its host, and return the program."""
    spads = ", ".join(f"top.spad_{s}.data()" for s in range(sensor.subgroups))
    text = f"inline uint32_t* const* spads(Vtop& top) {{ static uint32_t* const all[] = {{{spads}}}; return all; }}\n"
    (folder / "spads.h").write_text(text)
    words = f"--cc --exe --build -j 2 --threads {threads} --top-module {TOP} --prefix Vtop --Mdir . -o lean -CFLAGS -I{folder}"
    options = [*words.split(), *toolchain.VERILATOR_OPTIONS, *COMPILER]
    compile_in(folder, folder / "log", [str(toolchain.verilator()), *options, str(SOURCE), *map(str, rtl(sensor))])
    return folder / "lean"


def write_frame(path: Path, config: Config, edges: Edges) -> None:
    """Write a frame as `lean.cpp` reads it."""
    cycle, subgroup, bit = port_bits(config, edges)
    order = np.argsort(cycle, kind="stable")
    writes = config.register_writes()
    status = registers.address("status"), 1 << registers.BY_NAME["status"].bit("done")
    head = [len(writes), *(number for write in writes for number in write)]
    head += [*registers.control("start"), *status, config.frame_cycles, len(order)]
    rows = np.stack([cycle[order], subgroup[order], bit[order]], axis=1)
    path.write_bytes(np.concatenate([np.array(head, np.int64), rows.astype(np.int64).ravel()]).tobytes())


def lean_rate(program: Path, frame: Path, processes: int, repeats: int) -> float:
    """Return cycles per second, summed over processes that play at once."""
    running = [
        subprocess.Popen([str(program), str(frame), str(repeats)], stdout=subprocess.PIPE, text=True)
        for _ in range(processes)
    ]
    rates = []
    for process in running:
        rows = [line.split() for line in process.communicate()[0].splitlines()]
        assert process.returncode == 0
        rates.append(sum(int(row[0]) for row in rows) / sum(float(row[1]) for row in rows))
    return sum(rates)


def sliced_rate(job: FrameJob, repeats: int) -> float:
    with SlicedSensor(job.config.sensor) as sensor:
        began, cycles = time.perf_counter(), 0
        for _ in range(repeats):
            cycles += sensor.frame(job.config, job.edges).cycles
        return cycles / (time.perf_counter() - began)


def many_rate(job: FrameJob, threads: int) -> float:
    began = time.perf_counter()
    records = play_side_by_side([[job]] * (EACH * threads), threads=threads)
    return sum(record.cycles for (record,) in records) / (time.perf_counter() - began)


def cost(function: Callable[[], object]) -> tuple[float, float]:
    """Return seconds and the most memory, MiB, of a function in a process of its own and of the programs that it starts."""
    read, write = os.pipe()
    began = time.perf_counter()
    if not (child := os.fork()):
        function()
        most = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        os.write(write, str(most / 1024).encode())
        os._exit(0)
    os.waitpid(child, 0)
    return time.perf_counter() - began, float(os.read(read, 100))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    job = Job.of(SIZE)
    busy, idle = (FrameJob(job.config, edges) for edges in (job.edges(), job.edges().take(np.zeros(0, np.int64))))
    sensor = job.config.sensor
    with tempfile.TemporaryDirectory(prefix="coincid-") as scratch:
        folder, programs, rows = Path(scratch), {}, {}
        os.environ["COINCID_BUILD"] = str(folder / "build")
        cost(lambda: rtl(sensor))  # a process of its own: Yosys would keep threads, which a fork would not have
        toolchain.verilator()
        for threads in (1, 2):
            (folder / f"lean{threads}").mkdir()
            seconds, mib = cost(lambda: build_lean(sensor, threads, folder / f"lean{threads}"))  # noqa: B023
            programs[threads] = folder / f"lean{threads}" / "lean"
            print(f"built: Verilator, {threads} threads: {seconds:.0f} s, {mib:,.0f} MiB", flush=True)
        seconds, mib = cost(lambda: build_library(sensor))
        print(f"built: sliced: {seconds:.0f} s, {mib:,.0f} MiB", flush=True)
        build_library(sensor, EACH)
        for name, frame in (("busy", busy), ("idle", idle)):
            write_frame(folder / name, frame.config, frame.edges)
        play_side_by_side([[busy]] * 2)  # loads what is compiled
        for number in range(rounds):
            print(f"round {number + 1} of {rounds}", flush=True)
            for name, frame in (("busy", busy), ("idle", idle)):
                for what, rate in (
                    ("one frame, Verilator, 1 thread", lambda: lean_rate(programs[1], folder / name, 1, 2)),  # noqa: B023
                    ("one frame, Verilator, 2 threads", lambda: lean_rate(programs[2], folder / name, 1, 2)),  # noqa: B023
                    ("one frame, sliced, 1 thread", lambda: sliced_rate(frame, 5)),  # noqa: B023
                    ("many, Verilator, 2 processes", lambda: lean_rate(programs[1], folder / name, 2, 2)),  # noqa: B023
                    (f"many, sliced, 1 thread of {EACH} frames", lambda: many_rate(frame, 1)),  # noqa: B023
                    (f"many, sliced, 2 threads of {EACH} frames", lambda: many_rate(frame, 2)),  # noqa: B023
                ):
                    rows.setdefault(what, {}).setdefault(name, []).append(rate())
    print("\n| cycles/s | busy frame | idle frame |\n| --- | ---: | ---: |")
    for what, rates in rows.items():
        print(f"| {what} | " + " | ".join(f"{statistics.median(rates[name]):,.0f}" for name in ("busy", "idle")) + " |")


if __name__ == "__main__":
    sys.exit(main())
