"""Runs frames through an engine: the golden model, or the RTL in a simulator."""

import pickle
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..hdl.export import FILE_LIST, verilog_files
from ..hdl.sensor import TOP
from ..model.config import Config
from ..model.edges import Edges
from ..model.golden import Trace
from ..model.parameters import Sensor
from ..model.result import ResultBuilder, golden_result
from . import toolchain
from .cosim import JOB_VARIABLE, PROGRESS
from .frames import FrameJob, Recorded

ENGINES = ("golden", "verilator", "icarus")


def sensor_key(sensor: Sensor) -> str:
    """Names a build for people: the parameters that differ from the defaults come after the size."""
    default = Sensor()
    parts = [f"{sensor.rows}x{sensor.cols}"]
    for name in ("phases", "coarse_bits", "window_max", "rearm", "fifo_depth", "streams", "subgroup", "minigroup"):
        value = getattr(sensor, name)
        if value != getattr(default, name):
            parts.append(name + ("x".join(map(str, value)) if isinstance(value, tuple) else str(value)))
    return "-".join(parts)


def rtl(sensor: Sensor) -> list[Path]:
    """The sensor's Verilog files, emitted once for its parameters and the state of the sources."""
    sources = [path for folder in ("hdl", "model") for path in sorted((Path(__file__).parents[1] / folder).glob("*.py"))]
    key = toolchain.digest(repr(sensor), *(path.read_bytes() for path in sources))

    def emit(directory: Path) -> None:
        for name, text in verilog_files(sensor).items():
            (directory / name).write_text(text)

    directory = toolchain.build_once(toolchain.build_root() / "verilog" / f"{sensor_key(sensor)}-{key}", emit)
    return [directory / name for name in (directory / FILE_LIST).read_text().split()]


def build_sensor(sensor: Sensor, simulator: str, waves: bool = False) -> toolchain.Build:
    """The sensor compiled for a simulator, or found compiled."""
    return toolchain.build(simulator, rtl(sensor), TOP, key=sensor_key(sensor), waves=waves, public=[f"{TOP}.stored_of_*"])


def play(
    frames: list[FrameJob], simulator: str, out_dir: Path, *, waves: bool = False,
    progress: Callable[[int], None] | None = None,
) -> tuple[list[Recorded], Path | None]:
    """Plays frames of one sensor through its RTL; returns what each showed, and the waveform. `progress` gets cycles done.

    Raises `scoreboard.Mismatch` at the first difference from a frame's expectation, `toolchain.SimulationError` for any other failure, and
    `toolchain.ToolchainError`.
    """
    build = build_sensor(frames[0].config.sensor, simulator, waves)

    def line(text: str) -> None:
        if progress and text.startswith(PROGRESS):
            progress(int(text.split()[1]))

    with tempfile.TemporaryDirectory(prefix="coincid-") as folder:
        job = Path(folder) / "job"
        job.write_bytes(pickle.dumps(frames))
        try:
            run = build.run("coincid.tb.cosim", env={JOB_VARIABLE: str(job)}, out_dir=out_dir, seed=1, echo=line)
        except toolchain.SimulationError as error:
            if job.with_suffix(MISMATCH).exists():
                wave = f"waveform {error.wave}" if error.wave else "no waveform was asked for"
                raise Mismatch(f"{job.with_suffix(MISMATCH).read_text()} ({wave}; log {error.log})") from None
            raise
        return pickle.loads(job.with_suffix(RESULT).read_bytes()), run.wave


def replay(
    engine: str, config: Config, edges: Edges, ready: np.ndarray | None = None, progress: Callable[[int], None] | None = None
) -> dict[str, np.ndarray]:
    """All frames of `config` through an engine: the arrays of the result file. `progress` gets cycles done."""
    ready = np.zeros(0, np.uint8) if ready is None else ready
    if engine == "golden":
        done = progress or (lambda cycles: None)
        return golden_result(config, edges, ready, lambda frames: done(frames * config.pulses * config.period))
    frames = [FrameJob(config, edges.frame(number, config.pulses)[0], ready=ready) for number in range(config.frames)]
    with tempfile.TemporaryDirectory(prefix="coincid-") as folder:
        records, _ = play(frames, engine, Path(folder), progress=progress)
    result = ResultBuilder(config)
    for record in records:
        result.add(record.beats, record.commit_subgroup, record.commit_cycle)
    return result.arrays()


__all__ = ["ENGINES", "Trace", "build_sensor", "play", "replay", "rtl", "sensor_key"]
