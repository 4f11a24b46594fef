# SPDX-License-Identifier: Apache-2.0
"""Plays frames through the RTL, in the sliced engine or in a simulator under cocotb."""

import pickle
import tempfile
from collections.abc import Callable
from pathlib import Path

from ..hdl.front_end_views import POLYPHASE, View
from ..hdl.subgroup_pair import SensorModule
from ..model.contract.parameters import TOP, Sensor
from . import toolchain
from .frame_record import MISMATCH, PROGRESS, RESULT, FrameJob, Recorded, save_job
from .rtl import rtl, sensor_key
from .rtl_errors import Mismatch, SimulationError
from .scoreboard import check
from .sliced import build_library, play_side_by_side


def prepare(engine: str, sensor: Sensor, waves: bool = False, view: View = POLYPHASE) -> None:
    """Compile everything that `engine` needs for `play`, unless it is there already."""
    if engine == "sliced":
        build_library(sensor)
    else:
        build_sensor(sensor, engine, waves, view)


def build_sensor(
    sensor: Sensor, simulator: str, waves: bool = False, view: View = POLYPHASE
) -> toolchain.Build:
    """Return the sensor in a view from `hdl/front_end_views.py`, compiled for a simulator, now
    or earlier.
    """
    delays = not view.by_words
    public = [f"{TOP}.stored_of_*"] + [f"{TOP}.timing"] * delays
    return toolchain.build(
        simulator,
        rtl(sensor, view),
        TOP,
        key=sensor_key(sensor, view),
        waves=waves,
        public=public,
        blocks=[] if delays else [SensorModule(sensor, view=view).unit_name],
        delays=delays,
    )


def play(
    frames: list[FrameJob],
    engine: str,
    out_dir: Path,
    *,
    waves: bool = False,
    progress: Callable[[int], None] | None = None,
    view: View = POLYPHASE,
) -> tuple[list[Recorded], Path | None]:
    """Play frames of one sensor through its RTL; return their records, and the waveform.
    `progress` gets cycles done.

    engine: from `engines.py`, without golden; view and waves: as `replay.chosen_view` allows.
    Raises `Mismatch` at the first difference from a frame's expectation, `SimulationError` for
    any other failure, and `ToolchainError`.
    """
    if engine == "sliced":
        (records,) = play_side_by_side([frames], progress)
        for number, (job, record) in enumerate(zip(frames, records, strict=True)):
            if job.expected is not None:
                record.checked = check(job.config.sensor, job.expected, record, number)
        return records, None
    build = build_sensor(frames[0].config.sensor, engine, waves, view)
    records, run = play_in(build, frames, out_dir, lines=not view.by_words, progress=progress)
    return records, run.wave


def play_in(
    build: toolchain.Build,
    frames: list[FrameJob],
    out_dir: Path,
    *,
    lines: bool = False,
    progress: Callable[[int], None] | None = None,
) -> tuple[list[Recorded], toolchain.SimulationFiles]:
    """Play frames in a compiled simulator by the cocotb test; `lines` as in `save_job`, the rest
    as in `play`.
    """

    def line(text: str) -> None:
        if progress and text.startswith(PROGRESS):
            progress(int(text.split()[1]))

    with tempfile.TemporaryDirectory(prefix="coincid-") as folder:
        job = Path(folder) / "job"
        try:
            run = build.run(
                "coincid.tb.cosim", env=save_job(job, frames, lines), out_dir=out_dir, echo=line
            )
        except SimulationError as error:
            if job.with_suffix(MISMATCH).exists():
                wave = f"waveform {error.wave}" if error.wave else "no waveform was asked for"
                raise Mismatch(
                    f"{job.with_suffix(MISMATCH).read_text(encoding='utf-8')} ({wave}; log {error.log})"
                ) from None
            raise
        return pickle.loads(job.with_suffix(RESULT).read_bytes()), run
