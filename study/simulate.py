"""The main job: a scene, its light, three frames through the sensor, and the depth that each of them gives.

The frames see the same photons and differ in one thing: `off`, coincidence off (the paper's scheme 1); `fixed`, the programmed
threshold; `auto`, per subgroup the threshold that the controller found in the frame before. Every beat and commit of the RTL is
checked against the golden model while it runs.
"""

import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from attrs import frozen
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from ..model.contract.config import SUBGROUP_INTEGERS, Config
from ..model.contract.edges import Edges
from ..model.contract.parameters import TOP
from ..model.contract.result import ResultBuilder, write_result
from ..model.depth.estimate import estimate_depth
from ..model.golden.frame import Golden, Trace
from ..model.light.photons import generate_edges
from ..model.light.spad import Spad, SpadGate
from ..model.light.timing import Timing
from ..model.scenes.scene import Scene, scene_light
from ..model.shared.errors import InputError
from ..model.shared.files import whole_file
from ..tb.errors import Mismatch
from ..tb.frames import FrameJob, Recorded
from ..tb.replay import DEFAULT_VIEW, chosen_view
from ..tb.waves import views
from .pictures import Panel, depth_row
from .run import scene_of

if TYPE_CHECKING:
    from ..hdl.views import View

EVENTS, REPORT = "events.npz", "report.json"
PICTURES = {  # file: (estimator of `model/depth/estimate.py`, what the report's keys end with, heading)
    "depth.png": ("joint", "", "surfaces from the ID maps"),
    "depth_peak.png": ("maximum", "_peak", "peak of every pixel's histogram, as in the paper"),
}
SCHEMES = {  # name: (title, settings that it overrides)
    "off": ("coincidence off", {"coincidence": False, "auto": False}),
    "fixed": ("threshold {threshold}", {"coincidence": True, "auto": False}),
    "auto": ("threshold per subgroup", {"coincidence": True, "auto": True}),
}
Progressed = Callable[[int], None]


@frozen(eq=False)
class Frames:
    """What the frames of `SCHEMES`, one after the other, made of the same edges.

    configs: of each. arrays: of the result file (`model/contract/result.py`), frame k = scheme k. cycles: of all frames; checked: beats and commits
    that were compared; seconds: that the engine took. wave: the waveform or None.
    """

    configs: list[Config]
    arrays: dict[str, np.ndarray]
    cycles: int
    checked: int
    seconds: float
    wave: Path | None


def run_frames(
    config: Config,
    edges: Edges,
    engine: str,
    out: Path,
    *,
    waves: bool = False,
    progress: Progressed = lambda cycles: None,
    view: "str | View" = DEFAULT_VIEW,
) -> Frames:
    """Plays `edges` once for each of `SCHEMES` through an engine of `replay.ENGINES`; a simulator's log goes to `out`.

    `progress` gets the cycles done; view: as of `replay.chosen_view`. Raises `Mismatch` at the first difference between RTL and golden
    model, `SimulationError`, `toolchain.ToolchainError`.
    """
    chosen = chosen_view(engine, view, config.clock_mhz)
    configs = [config.with_frame(frames=1).with_settings(**settings) for _, settings in SCHEMES.values()]
    golden = Golden(config.sensor)
    wave: Path | None = None
    began = time.perf_counter()
    traces = [golden.frame(scheme, edges) for scheme in configs]
    shown: Sequence[Trace | Recorded] = traces
    if chosen is not None:
        from ..tb.play import play

        began = time.perf_counter()
        jobs = [FrameJob(scheme, edges, trace) for scheme, trace in zip(configs, traces)]
        shown, wave = play(jobs, engine, out, waves=waves, progress=progress, view=chosen)
    seconds = time.perf_counter() - began
    result = ResultBuilder(config)
    for frame in shown:
        result.add(frame.beats, frame.commit_subgroup, frame.commit_cycle)
    checked = sum(getattr(frame, "checked", 0) for frame in shown)
    return Frames(configs, result.arrays(), sum(map(_cycles, shown)), checked, seconds, wave)


def _cycles(frame: Recorded | Trace) -> int:
    """Cycles of a frame, to its last beat."""
    return getattr(frame, "cycles", None) or 1 + max(int(cycles[-1]) for cycles in frame.beat_cycle)


def simulate(
    source: str,
    config: Config,
    *,
    klux: float,
    seed: int,
    engine: str,
    out: Path,
    console: Console,
    waves: bool = False,
    spad_gate: bool = False,
    view: "str | View" = DEFAULT_VIEW,
) -> dict[str, Any]:
    """Simulates the scene `source` (`model/scenes/scene.py`); leaves `PICTURES`, events.npz and report.json in `out` and returns the report.

    events.npz: a result file of three frames, in the order of `SCHEMES`. spad_gate: gating keeps the SPADs off outside the gate.
    Raises `InputError`, and what `run_frames` raises; after a `Mismatch` only the report is there, with `mismatches` = 1.
    """
    shown = chosen_view(engine, view, config.clock_mhz)
    if config.format == "short":
        raise InputError("frame.format = 'short': must be id or full, as depth comes from the ID map")
    timing, scene = Timing.from_config(config), scene_of(config, source)
    light = scene_light(scene, klux)
    gate = SpadGate.from_config(config) if spad_gate else None
    given = {
        "scene": scene.name,
        "klux": klux,
        "seed": seed,
        "engine": engine,
        "view": shown.name if shown else DEFAULT_VIEW,
        "clock_mhz": config.clock_mhz,
        "tick_s": timing.tick_s,
        "range_m": timing.range_m,
        "spad_gate": spad_gate,
        "configuration": settings_of(config),
    }
    results = [out / name for name in (*PICTURES, EVENTS)]
    with _Bar(console) as bar:
        bar.stage("photons")
        edges = generate_edges(
            light, Spad(), timing, pulses=config.pulses, seed=seed, gate=gate, workers=os.cpu_count() or 1
        )
        if shown is not None:
            bar.stage("RTL: emitted and compiled once")
            from ..tb.play import prepare

            prepare(engine, config.sensor, waves, shown)
        bar.stage(f"{len(SCHEMES)} frames on {engine}", len(SCHEMES) * config.frame_cycles)
        try:
            frames = run_frames(config, edges, engine, out, waves=waves, progress=bar.done, view=view)
        except Mismatch as mismatch:
            for path in results:  # of an earlier run
                path.unlink(missing_ok=True)
            _write_report(out, {"mismatches": 1, "mismatch": str(mismatch)} | given)
            raise
        bar.stage("depth")
        titles = {name: title.format(threshold=_span(config.threshold)) for name, (title, _) in SCHEMES.items()}
        shares: dict[str, float] = {}
        for file, (method, suffix, heading) in PICTURES.items():
            panels = [
                Panel(titles[name], estimate_depth(frames.arrays, scheme, method=method, frame=k).depth_m[:, :, 0])
                for k, (name, scheme) in enumerate(zip(SCHEMES, frames.configs))
            ]
            heading = f"{scene.name}, {klux:g} klux, {config.pulses} laser pulses: {heading}"
            found = depth_row(out / file, panels, scene.truth_m, heading)
            shares |= {f"wrong_share_{name}{suffix}": share for name, share in zip(SCHEMES, found)}
    write_result(out / EVENTS, frames.arrays)
    report = _report(frames, edges) | shares | given
    _write_report(out, report)
    written = [*results, out / REPORT]
    if frames.wave:
        written += [out / frames.wave.name, *views(out / frames.wave.name)]
    else:
        for path in out.glob(f"{TOP}.*"):  # of an earlier run
            path.unlink()
    _tell(console, scene, frames, titles, report, written)
    return report


def settings_of(config: Config) -> dict[str, Any]:
    """The configuration in the shape of its file; a subgroup's setting is a list where subgroups differ."""
    sensor = {
        attribute.name: getattr(config.sensor, attribute.name) for attribute in type(config.sensor).__attrs_attrs__
    }
    subgroup = {name: getattr(config, name).tolist() for name in ("coincidence", "gating", "auto", *SUBGROUP_INTEGERS)}
    subgroup["mask"] = [f"{sum(1 << int(i) for i in np.flatnonzero(mask)):x}" for mask in config.mask]
    return {
        "sensor": sensor,
        "frame": config.frame,
        "subgroup": {name: v[0] if len(set(v)) == 1 else v for name, v in subgroup.items()},
    }


def _report(frames: Frames, edges: Edges) -> dict[str, Any]:
    """Flat keys; numbers are of all frames together, or end with the scheme."""
    arrays = frames.arrays
    report = {
        "cycles": frames.cycles,
        "edges": len(SCHEMES) * len(edges),
        "events": len(arrays["pulse"]),
        "dropped": int(arrays["dropped"].sum()),
        "mismatches": 0,
        "checked": frames.checked,
        "cycles_per_s": round(frames.cycles / frames.seconds, 1),
        "seconds": round(frames.seconds, 3),
    }
    for k, name in enumerate(SCHEMES):
        report |= {
            f"events_{name}": int(arrays["stored"][k].sum()),
            f"dropped_{name}": int(arrays["dropped"][k].sum()),
            f"threshold_{name}": _thresholds(frames, k).tolist(),
        }
    return report


def _thresholds(frames: Frames, k: int) -> np.ndarray:
    """int64[subgroups]: what a window had to hold in frame k."""
    return np.where(frames.configs[k].coincidence, frames.arrays["threshold_used"][k], 1)


def _write_report(out: Path, report: dict[str, Any]) -> None:
    with whole_file(out / REPORT, "w") as file:
        file.write(json.dumps(report, indent=2) + "\n")


def _span(values: np.ndarray) -> str:
    low, high = values.min(), values.max()
    return f"{low}" if low == high else f"{low} to {high}"


class _Bar:
    """Progress in stages; a terminal sees a bar, anything else a line a stage."""

    def __init__(self, console: Console):
        self.console = console
        columns = (
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(),
        )
        self.progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self.task: TaskID | None = None

    def __enter__(self) -> "_Bar":
        self.progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.progress.stop()

    def stage(self, name: str, total: int | None = None) -> None:
        if self.task is not None:
            self.progress.remove_task(self.task)
        self.task = self.progress.add_task(name, total=total)
        if self.progress.disable:
            self.console.print(name)

    def done(self, amount: int) -> None:
        if self.task is not None:
            self.progress.update(self.task, completed=amount)


def _tell(
    console: Console, scene: Scene, frames: Frames, titles: dict[str, str], report: dict[str, Any], written: list[Path]
) -> None:
    """The table at the end."""
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("frame", no_wrap=True)
    for title in ("threshold", "events", "dropped", "wrong pixels", "peaks only"):
        table.add_column(title, justify="right")
    for k, name in enumerate(SCHEMES):
        table.add_row(
            titles[name],
            _span(_thresholds(frames, k)),
            f"{report[f'events_{name}']:,}",
            f"{report[f'dropped_{name}']:,}",
            f"{report[f'wrong_share_{name}']:.1%}",
            f"{report[f'wrong_share_{name}_peak']:.1%}",
        )
    console.print(table)
    for note in scene.notes:
        console.print(note, markup=False, emoji=False, soft_wrap=True)
    checked = (
        f"{report['checked']:,} beats and commits equal the golden model's"
        if report["checked"]
        else "golden model only, no RTL"
    )
    console.print(
        f"{report['cycles']:,} cycles in {report['seconds']:.1f} s ({report['cycles_per_s']:,.0f} cycles/s): {checked}"
    )
    console.print("results: " + " ".join(map(str, written)), soft_wrap=True)
