# SPDX-License-Identifier: Apache-2.0
"""Measures the speed of the model and the simulators on this machine, and writes a flat JSON file
and a table.

Each number is the median of several rounds. A round runs every engine once, so that other load on
the machine affects all of them. `KEYS` lists what is measured, and how.
"""

import json
import os
import platform
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

from ..lab.setup import Setup
from ..model.contract.config import Config, parse_config
from ..model.contract.edges import Edges
from ..model.contract.result import ResultBuilder
from ..model.depth.estimate import estimate_depth
from ..model.depth.methods import DEFAULT_METHOD
from ..model.golden.frame import Golden, Trace
from ..model.shared import markdown
from ..model.shared.files import whole_file
from ..model.shared.interrupts import worker_processes
from ..tb import pysim
from ..tb.engines import SIMULATORS
from ..tb.frame_record import FrameJob, Recorded
from ..tb.play import build_sensor, play
from ..tb.scoreboard import check
from ..tb.sliced import SlicedSensor, build_library, play_side_by_side

SCENE, KLUX, SEED = "five-objects", 50.0, 1
REPEATS = 5
MANY = 32  # frames at once
SIZES = {
    "32x32": {"rows": 32, "cols": 32},
    "256x128": {"rows": 128, "cols": 256, "streams": 8},
}  # name: keys of [sensor]
PULSES = {
    "cocotb_verilator": 40,
    "cocotb_icarus": 8,
    "amaranth": 2,
}  # slow engines only play the beginning of the frame
CYCLES_PER_S = "{}_cycles_per_s"
KIB_PER_MIB = 1024

# name: (size, format, method) of frames from photons through the golden model to depth
TO_DEPTH = {
    "32x32_maximum": ("32x32", "id", "maximum"),
    "32x32_matched": ("32x32", "id", "matched"),
    "32x32_planes": ("32x32", "id", "planes"),
    "32x32_planes_full": ("32x32", "full", "planes"),
    "256x128_planes": ("256x128", "id", "planes"),
}

_BEGINNING = (
    "the same RTL in {}, the frame's first {} pulses; without start-up and register accesses"
)
_Result = TypeVar("_Result")
_VERSIONS = {
    "amaranth": "Amaranth",
    "cocotb": "cocotb",
    "numba": "Numba",
    "numpy": "NumPy",
    "verilator": "Verilator",
}
KEYS = {  # key: (unit, what it is)
    "sliced_cycles_per_s": ("cycles/s", "RTL in the sliced engine, from arrays of edges to arrays of beats; with register accesses"),
    "sliced_many_cycles_per_s": ("cycles/s", f"{MANY} such frames in parallel, summed over the frames; one thread per core"),
    "cocotb_verilator_cycles_per_s": ("cycles/s", _BEGINNING.format("Verilator under cocotb", PULSES["cocotb_verilator"])),
    "cocotb_icarus_cycles_per_s": ("cycles/s", _BEGINNING.format("Icarus under cocotb", PULSES["cocotb_icarus"])),
    "amaranth_cycles_per_s": ("cycles/s", _BEGINNING.format("Amaranth's own simulator", PULSES["amaranth"])),
    "golden_cycles_per_s": ("cycles/s", "golden model, from arrays of edges to arrays of beats; one thread"),
    "golden_many_cycles_per_s": ("cycles/s", f"{MANY} such frames, summed over the frames; one thread per core"),
    "golden_edges_per_s": ("edges/s", "the same for one frame, in edges"),
    "photon_edges_per_s": ("edges/s", "photons to edges; one thread per core"),
    "sliced_per_cocotb_verilator": ("", "ratio of their cycles/s"),
    "golden_per_sliced": ("", "ratio of their cycles/s"),
    **{
        f"{key}_{size}_{name}": (unit, text)
        for key, parts in {
            "frame": {
                "sliced_s": ("s", "a frame from photons through the RTL (sliced engine, with reset and register accesses) to depth"),
                "photons_s": ("s", "of this: photons"), "sensor_s": ("s", "of this: RTL"), "depth_s": ("s", "of this: decoding and depth"),
                "peak_mib": ("MiB", "peak memory of a process for this frame alone, with Python and Numba"),
            },
            "build": {
                "s": ("s", "build of the sliced engine in an empty build folder: Verilog, Yosys, Verilator, compilation"),
                "warm_s": ("s", "the same if the build exists already"),
            },
        }.items() for size in SIZES for name, (unit, text) in parts.items()
    },
    **{
        f"to_depth_{name}_s": ("s", f"a frame of {size} from photons through the golden model to depth by {method}, format {form}")
        for name, (size, form, method) in TO_DEPTH.items()
    },
    "edges": ("", "in the frame of 32x32"),
    "repeats": ("", "rounds"),
    "machine_cpu": ("", "processor"),
    "machine_cores": ("", "cores that this process may use"),
    "machine_memory_mib": ("MiB", "main memory"),
    "machine_load": ("", "load average over the last minute before the start"),
    "version_python": ("", "Python"),
    **{f"version_{package}": ("", name) for package, name in _VERSIONS.items()},
    "version_icarus": ("", "Icarus"),
    "version_gxx": ("", "g++"),
}  # fmt: skip


def benchmark(
    out: Path, *, repeats: int = REPEATS, tell: Callable[[str], None] = print
) -> dict[str, int | float | str]:
    """Measure all of `KEYS`, write them to `out` (JSON) and to a table beside it (.md), and return
    them.

    tell: called with a line at every stage. Raises `ToolchainError`, `SimulationError` and
    `Mismatch`.
    """
    result: dict[str, Any] = _machine() | {"repeats": repeats}
    config, photons = _job("32x32")
    edges = photons()
    result["edges"] = len(edges)
    tell("building")
    for simulator in SIMULATORS:
        build_sensor(config.sensor, simulator)
    result |= _versions()
    _fast_rates(config, photons)  # loads the compiled code
    rounds = []
    for number in range(repeats):
        tell(f"engines: round {number + 1} of {repeats}")
        slow = {CYCLES_PER_S.format(name): _rate(config, edges, name) for name in PULSES}
        rounds.append(_fast_rates(config, photons) | slow)
    result |= _medians(rounds)
    result["golden_edges_per_s"] = (
        result["golden_cycles_per_s"] * len(edges) / (config.pulses * config.period)
    )
    result["sliced_per_cocotb_verilator"] = (
        result["sliced_cycles_per_s"] / result["cocotb_verilator_cycles_per_s"]
    )
    result["golden_per_sliced"] = result["golden_cycles_per_s"] / result["sliced_cycles_per_s"]
    for size in SIZES:
        tell(f"{size}: {repeats} frames")
        result |= _in_new_process(_whole_frames, size, repeats)
    for name in TO_DEPTH:
        tell(f"photons to depth, {name}: {repeats} frames")
        result[f"to_depth_{name}_s"] = _in_new_process(_to_depth_s, name, repeats)
    rounds = []
    for number in range(repeats):
        tell(f"builds: round {number + 1} of {repeats}")
        rounds.append({})
        for size in SIZES:
            with tempfile.TemporaryDirectory(prefix="coincid-") as folder:
                for key in (f"build_{size}_s", f"build_{size}_warm_s"):
                    rounds[-1][key] = _in_new_process(_build_s, size, COINCID_BUILD=folder)
    result |= _medians(rounds)
    result = {
        key: float(f"{result[key]:.4g}") if isinstance(result[key], float) else result[key]
        for key in KEYS
    }
    with whole_file(out, "w") as file:
        file.write(json.dumps(result, indent=2) + "\n")
    with whole_file(out.with_suffix(".md"), "w") as file:
        file.write(table(result))
    return result


def table(result: dict[str, int | float | str]) -> str:
    """Return the result as a Markdown table."""
    rows = ((f"`{key}`", _shown(result[key]), unit, text) for key, (unit, text) in KEYS.items())
    return "\n".join([*markdown.table(("key", "value", "unit", ""), rows, left=(0, 2, 3)), ""])


def _shown(value: int | float | str) -> str:
    if isinstance(value, float):
        # what three digits round up to 1000 has no exponent, either
        return f"{value:,.0f}" if value >= 999.5 else f"{value:.3g}"
    return f"{value:,}" if isinstance(value, int) else value


def _job(size: str) -> tuple[Config, Callable[[], Edges]]:
    """Return the input of every engine: the preset `silicon` at a size, and a function that draws
    its photons.
    """
    setup = Setup.of(SCENE, sensor=SIZES[size], klux=KLUX, seed=SEED)
    return setup.config, partial(setup.photons.edges, os.cpu_count() or 1)


def _fast_rates(config: Config, photons: Callable[[], Edges]) -> dict[str, float]:
    """Measure the rates of the engines that play whole frames."""
    photons_s, edges = _timed(photons)
    golden_s, trace = _timed(Golden(config.sensor).frame, config, edges)
    golden_many_s, _ = _timed(Golden(config.sensor).frames_of, config, [edges] * MANY)
    with SlicedSensor(config.sensor) as sensor:
        sliced_s, record = _timed(sensor.frame, config, edges)
    many_s, many = _timed(play_side_by_side, [[FrameJob(config, edges)]] * MANY)
    for one in (record, *(frame for (frame,) in many)):
        check(config.sensor, trace, one)
    return {
        "photon_edges_per_s": len(edges) / photons_s,
        "golden_cycles_per_s": record.cycles / golden_s,
        "golden_many_cycles_per_s": MANY * record.cycles / golden_many_s,
        "sliced_cycles_per_s": record.cycles / sliced_s,
        "sliced_many_cycles_per_s": MANY * record.cycles / many_s,
    }


def _rate(config: Config, edges: Edges, name: str) -> float:
    """Measure the cycles per second of a slow engine, between its first and its last progress
    message.
    """
    config = config.with_frame(pulses=PULSES[name])
    edges, seen = edges.take(edges.pulse < config.pulses), []

    def progress(cycle: int) -> None:
        seen.append((time.perf_counter(), cycle))

    engine = name.removeprefix("cocotb_")
    if engine in SIMULATORS:
        with tempfile.TemporaryDirectory(prefix="coincid-") as folder:
            play([FrameJob(config, edges)], engine, Path(folder), progress=progress)
    else:
        pysim.play(config, edges, progress)
    (began, first), (ended, last) = seen[0], seen[-1]
    return (last - first) / (ended - began)


def _whole_frames(size: str, repeats: int) -> dict[str, float]:
    """Measure the medians of frames from photons to depth, and the peak memory of this process."""
    (config, photons), rounds = _job(size), []
    build_library(config.sensor)

    def play(edges: Edges) -> Recorded:
        with SlicedSensor(config.sensor) as sensor:
            return sensor.frame(config, edges)

    for _ in range(repeats + 1):  # the first frame loads compiled code
        photons_s, edges = _timed(photons)
        sensor_s, record = _timed(play, edges)
        depth_s, _ = _timed(_depth, config, record)
        whole_s = photons_s + sensor_s + depth_s
        rounds.append(
            {"photons_s": photons_s, "sensor_s": sensor_s, "depth_s": depth_s, "sliced_s": whole_s}
        )
    status = Path("/proc/self/status").read_text(
        encoding="utf-8"
    )  # unlike getrusage, this excludes the process that started this one
    peak_kib = int(status.partition("VmHWM:")[2].split()[0])
    return {
        f"frame_{size}_{name}": value
        for name, value in (_medians(rounds[1:]) | {"peak_mib": peak_kib / KIB_PER_MIB}).items()
    }


def _to_depth_s(name: str, repeats: int) -> float:
    """Measure the median time of a frame from photons through the golden model to depth."""
    size, form, method = TO_DEPTH[name]
    config, photons = _job(size)
    config = config.with_frame(format=form)
    golden = Golden(config.sensor)
    times = [  # the first frame loads compiled code
        _timed(lambda: _depth(config, golden.frame(config, photons()), method))[0]
        for _ in range(repeats + 1)
    ]
    return statistics.median(times[1:])


def _depth(config: Config, frame: Recorded | Trace, method: str = DEFAULT_METHOD) -> None:
    """Decode a frame and estimate its depth."""
    result = ResultBuilder(config)
    result.add(frame.beats, frame.commit_subgroup, frame.commit_cycle)
    estimate_depth(result.arrays(), config, method=method)


def _build_s(size: str) -> float:
    return _timed(build_library, parse_config({"sensor": SIZES[size]}).sensor)[0]


def _timed(function: Callable[..., _Result], *arguments: Any) -> tuple[float, _Result]:
    """Return the duration of a call in seconds, and its result."""
    began = time.perf_counter()
    result = function(*arguments)
    return time.perf_counter() - began, result


def _medians(rounds: list[dict[str, float]]) -> dict[str, float]:
    return {key: statistics.median(values[key] for values in rounds) for key in rounds[0]}


def _in_new_process(
    function: Callable[..., _Result], *arguments: object, **environment: str
) -> _Result:
    with worker_processes(1, _set_environment, environment) as pool:
        return pool.submit(function, *arguments).result()


def _set_environment(variables: dict[str, str]) -> None:
    os.environ.update(variables)


def _machine() -> dict[str, int | float | str]:
    cpuinfo = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    names = [
        line.partition(":")[2].strip()
        for line in cpuinfo.splitlines()
        if line.startswith("model name")
    ]
    return {
        "machine_cpu": names[0] if names else platform.machine(),
        "machine_cores": len(os.sched_getaffinity(0)),
        "machine_memory_mib": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") >> 20,
        "machine_load": os.getloadavg()[0],
    }


def _versions() -> dict[str, str]:
    def first_line(*command: str) -> str:
        return subprocess.run(
            command, capture_output=True, text=True, check=True, encoding="utf-8"
        ).stdout.partition("\n")[0]

    return {
        "version_python": platform.python_version(),
        **{f"version_{package}": version(package) for package in _VERSIONS},
        "version_icarus": first_line("iverilog", "-V"),
        "version_gxx": first_line("g++", "--version"),
    }
