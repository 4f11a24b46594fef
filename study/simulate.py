# SPDX-License-Identifier: Apache-2.0
"""Simulates a scene for `coincid sim`: its light, its frames through the sensor in three schemes,
and the depth of each scheme.

`schemes.py` has the schemes. Every beat and commit of the RTL is checked against the golden model
while it runs.
"""

import json
import os
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from attrs import frozen
from numpy.typing import ArrayLike
from rich.console import Console
from rich.table import Table

from ..lab.measures import Number
from ..lab.outcomes import Frame, Run
from ..lab.pace import frames_per_s, pulse_energy_j, told_pace
from ..lab.setup import SETTLING, Setup
from ..model.contract.config import Config, frame_table, own_rule, sensor_table
from ..model.contract.counters import COUNTER_NAMES
from ..model.contract.packet import BEAT_BITS
from ..model.contract.parameters import TOP, Sensor
from ..model.contract.pixels import subgroup_image
from ..model.contract.result import ResultFile, at_end, counter_arrays
from ..model.contract.settings import SUBGROUP
from ..model.depth.depth import write_depths
from ..model.depth.estimate import estimate_depth
from ..model.depth.methods import DEFAULT_METHOD
from ..model.golden.frame import Golden, Trace
from ..model.light.photons import edge_chunks
from ..model.light.timing import Timing
from ..model.scenes.ambient import told_klux
from ..model.scenes.scene import Scene
from ..model.shared.errors import InputError, extra, wrong_value
from ..model.shared.files import whole_file
from ..model.shared.interrupts import in_background
from ..model.shared.pulse import with_pulse
from ..tb.frame_record import FrameJob, Recorded
from ..tb.replay import DEFAULT_VIEW, chosen_view
from ..tb.rtl_errors import Mismatch
from .config_file import mask_text
from .progress import Bar, first_time
from .schemes import (
    CONTROLLED,
    best_threshold,
    long_scheme_runs,
    scheme_runs,
    schemes_of,
    seeing_all,
)
from .show.frame_content import FrameView
from .usefulness import is_useful, useless_sentence

if TYPE_CHECKING:
    from ..hdl.front_end_views import View

# the waveform and its views for GTKWave and Surfer, by the names of `tb/wave_views.py`
WAVES = f"{TOP}.fst", f"{TOP}.gtkw", f"{TOP}.sucl"
EVENTS, DEPTH, REPORT, PAGE = "events.npz", "depth.npz", "report.json", "report.html"
# of a scene that moves: the depth of every frame, as arrays and as an animation
DEPTHS, ANIMATION = "depth_frames.npz", "depth_frames.gif"
PICTURES = {  # file: (estimator of `model/depth/estimate.py`, suffix of the report's keys, heading)
    "depth.png": (DEFAULT_METHOD, "", "planes through the likelihood of all events"),
    "depth_peak.png": ("maximum", "_peak", "peak of every pixel's histogram, as in the paper"),
}
COUNTED = {"depth.png": (DEFAULT_METHOD, "", "planes through the likelihood of all counts")}
LIGHT = "light.png"  # the estimated light, by the estimator of the first picture
LINK_GBPS = 8.0  # if nothing else sets the rate: the pins of such a chip can carry this much
# if the configuration sets no format: such a link carries the most events in it
LINK_FORMAT = "compact"
PAGE_EVENTS_MAX = 3_000_000  # in the report's page, about 100 MB
SLOW_ENGINE, SLOW_SETTLING = "icarus", 2
Progressed = Callable[[int], None]


@frozen(eq=False)
class Played:
    """All frames of the schemes, which one sensor played in turn.

    runs: one per scheme, with the golden model's traces; its last frame represents the scheme.
    result: all frames. cycles: of all frames; checked: number of compared beats and commits;
    seconds: time that the engine took. wave: path of the waveform or None.
    """

    runs: dict[str, Run]
    result: ResultFile
    cycles: int
    checked: int
    seconds: float
    wave: Path | None

    @property
    def frames(self) -> dict[str, Frame]:
        """The last frame of each scheme, which represents it."""
        return {name: run.frame() for name, run in self.runs.items()}


@frozen(eq=False)
class GoldenRuns:
    """The runs of the schemes, with the golden model's frames.

    threshold: of `fixed`. seconds: that the golden model took, and the photons of a long run.
    """

    runs: dict[str, Run]
    threshold: ArrayLike
    seconds: float

    @classmethod
    def of(cls, run: Run, threshold: ArrayLike) -> "GoldenRuns":
        """Play the frames of `scheme_runs`."""
        began = time.perf_counter()
        runs = scheme_runs(run, threshold)
        return cls(runs, threshold, time.perf_counter() - began)


def pictures_of(config: Config) -> dict[str, tuple[str, str, str]]:
    """Return the pictures of depth: `PICTURES`, or those of the format `counts`."""
    return COUNTED if config.counting else PICTURES


def with_link(config: Config, link_gbps: float | None = None) -> Config:
    """Return a configuration with a link. link_gbps: its rate; None: that of the configuration if
    it was given (0: no limit), else `LINK_GBPS`.
    """
    if link_gbps is not None or "frame.link_gbps" not in config.given:
        config = config.with_frame(link_gbps=LINK_GBPS if link_gbps is None else link_gbps)
    return config if "frame.format" in config.given else config.with_frame(format=LINK_FORMAT)


def play_runs(
    golden: GoldenRuns,
    engine: str,
    out: Path,
    *,
    waves: bool = False,
    progress: Progressed = lambda cycles: None,
    view: "str | View" = DEFAULT_VIEW,
) -> Played:
    """Play the frames of the golden model through an engine of `tb/engines.py`, too; a simulator's
    log goes to `out`.

    progress: called with the number of finished cycles; view: as in `replay.chosen_view`. Raises
    `Mismatch` at the first difference between RTL and golden model, `SimulationError`,
    `ToolchainError`.
    """
    runs = golden.runs
    config = next(iter(runs.values())).config
    chosen = chosen_view(engine, view, config.clock_mhz)
    wave: Path | None = None
    seconds = golden.seconds
    frames: Iterable[Trace | Recorded] = chain.from_iterable(one.traces for one in runs.values())
    if chosen is not None:
        from ..tb.play import play

        jobs = [
            FrameJob(one.config, one.frame_edges(k), trace)
            for one in runs.values()
            for k, trace in enumerate(one.traces)
        ]
        began = time.perf_counter()
        frames, wave = play(jobs, engine, out, waves=waves, progress=progress, view=chosen)
        seconds = time.perf_counter() - began
    result = ResultFile(config)
    cycles = 0
    checked = 0
    for frame in frames:
        result.add(frame.beats, frame.commit_subgroup, frame.commit_cycle)
        cycles += _cycles(frame)
        checked += getattr(frame, "checked", 0)
    return Played(runs, result, cycles, checked, seconds, wave)


def _cycles(frame: Recorded | Trace) -> int:
    """Return the cycles of a frame, up to its last beat."""
    return getattr(frame, "cycles", None) or 1 + max(int(cycles[-1]) for cycles in frame.beat_cycle)


def simulate_to_folder(
    setup: Setup,
    *,
    out: Path,
    console: Console,
    threshold: int | None = None,
    settling: int | None = None,
    waves: bool = False,
    **told: Any,
) -> dict[str, Any]:
    """Simulate a scene; leave `pictures_of`, `LIGHT`, report.html, events.npz, depth.npz and
    report.json in `out`, and return the report.

    threshold: of `fixed`; None: that of the configuration if it gives one, else the best of 1 to 7
    for this scene; frames of counts have none. settling: number of frames of `auto`, of which the
    last one counts (None: `SETTLING` + 1, or one for each picture of a scene that moves); unused
    without the controller in a still scene, of which one frame is played. A scene that moves also
    leaves `DEPTHS` and `ANIMATION`, of the last scheme.
    told: further entries of the report. events.npz
    is a result file of all frames, in the order of `SCHEMES`; depth.npz is `Depth.save` of the last
    frame. Raises `InputError`, and the errors of `play_runs`; after a `Mismatch`, only the
    report exists, with `mismatches` = 1.
    """
    config, engine, view = setup.config, setup.engine, setup.view
    shown = chosen_view(engine, view, config.clock_mhz, waves)
    config.check_map()
    if threshold is not None:
        if config.counting:
            raise wrong_value("threshold", threshold, "left out, because frames have counts")
        config = config.with_settings(threshold=threshold)
    scene = setup.seen
    schemes = schemes_of(config)
    all_frames = seeing_all(config, scene)
    settling = _frames_of(scene, engine, settling) if all_frames else 1
    timing, ambient = Timing.from_config(config), told_klux(setup.klux)
    golden = setup.but(
        config=config, frame={"frames": settling}, engine="golden", view=DEFAULT_VIEW
    )
    run = Run(golden, workers=os.cpu_count() or 1)
    given = {"scene": run.scene.name} | told
    given |= {
        "klux": ambient,
        "background": setup.background,
        "seed": setup.seed,
        "engine": engine,
        "view": shown.name if shown else DEFAULT_VIEW,
        "frames": settling,
        "clock_mhz": config.clock_mhz,
        "tick_s": timing.tick_s,
        "range_m": timing.range_m,
        "spad_gate": setup.spad_gate,
        "frames_per_s": frames_per_s(config),
        "pulse_nj": pulse_energy_j(config) * 1e9,
        "configuration": settings_of(config),
    }
    pictures = pictures_of(config)
    results = [out / name for name in (*pictures, LIGHT, EVENTS, DEPTH, PAGE)]
    others = [out / name for name in PICTURES if name not in pictures]
    for path in (*others, out / DEPTHS, out / ANIMATION):  # from an earlier run
        path.unlink(missing_ok=True)
    compiled = partial(_prepare, engine, config.sensor, waves, shown)
    total = sum(settling if name in all_frames else 1 for name in schemes)
    with Bar(console, lines=True) as bar, in_background(compiled) as preparing:
        chooses = not config.counting and "subgroup.threshold" not in config.given
        predicted = _golden_runs(run, chooses, shown is None, bar)
        if shown is not None:
            bar.stage("RTL: emitted and compiled once")
            preparing.result()
        bar.stage(f"{total} frames on {engine}", total * config.frame_cycles)
        try:
            played = play_runs(predicted, engine, out, waves=waves, progress=bar.done, view=view)
        except Mismatch as mismatch:
            for path in results:  # from an earlier run
                path.unlink(missing_ok=True)
            _write_report(out, {"mismatches": 1, "mismatch": str(mismatch)} | given)
            raise
        bar.stage(first_time("depth", estimate_depth.__module__))
        titles = {
            name: title.format(threshold=_span(np.asarray(predicted.threshold)))
            for name, (title, _) in schemes.items()
        }
        ambient_shown = ambient if isinstance(ambient, str) else f"{ambient:g}"
        heading = f"{run.scene.name}, {ambient_shown} klux, {config.pulses} laser pulses"
        shares = _pictures(out, heading, titles, played.frames)
        _light_picture(out / LIGHT, heading, titles, played.frames)
        if scene.later:
            bar.stage("depth of all frames")
            shares |= _write_frames(out, heading, played)
            results += [out / DEPTHS, out / ANIMATION]
    played.result.write(out / EVENTS, with_pulse({}, run.pulse))
    list(played.frames.values())[-1].first.save(out / DEPTH)
    notes = [*run.scene.notes, *run.light.notes(), *_told_full(played.result)]
    too_many = _too_many_for_page(played.frames)
    if too_many:
        notes.append(too_many)
        (out / PAGE).unlink(missing_ok=True)  # from an earlier run
    if too_many or not _write_report_page(out / PAGE, heading, titles, played.frames):
        results.remove(out / PAGE)
    report = _report(played) | shares | given
    _write_report(out, report)
    _tell_if_useless(console, setup, config, report, list(titles))
    written = [*results, out / REPORT]
    if played.wave:
        from ..tb.wave_views import views  # which needs an RTL tool

        written += [out / played.wave.name, *views(out / played.wave.name)]
    else:
        for name in WAVES:  # from an earlier run
            (out / name).unlink(missing_ok=True)
    _tell(console, notes, config, titles, report, written)
    return report


def _frames_of(scene: Scene, engine: str, settling: int | None) -> int:
    """Return the number of frames of a scheme that sees all frames. settling: as it was given."""
    if settling:
        return settling
    if scene.later:
        return scene.pictures
    return SLOW_SETTLING if engine == SLOW_ENGINE else SETTLING + 1


def _golden_runs(run: Run, chooses: bool, streams: bool, bar: Bar) -> GoldenRuns:
    """Play the schemes through the golden model.

    chooses: `fixed` has the best threshold, not that of the configuration. streams: a long run
    does not need all its edges at a time.
    """
    fixed = run.config.threshold
    if run.is_long and streams:
        began = time.perf_counter()
        runs, fixed = long_scheme_runs(run, None if chooses else fixed, bar)
        return GoldenRuns(runs, fixed, time.perf_counter() - began)
    bar.stage(first_time("photons", edge_chunks.__module__))
    _ = run.edges
    if chooses:
        bar.stage(first_time("best threshold", Golden.__module__))
        fixed = np.full_like(fixed, best_threshold(run))
    bar.stage(first_time("golden model", Golden.__module__))
    return GoldenRuns.of(run, fixed)


def _prepare(engine: str, sensor: Sensor, waves: bool, view: "View | None") -> None:
    """Import the drawing modules, and compile the RTL for its engine (view None: the golden model);
    both take long.
    """
    from . import pictures  # noqa: F401

    with suppress(InputError), extra("explore"):
        from .show import report  # noqa: F401
    if view is not None:
        from ..tb.play import prepare

        prepare(engine, sensor, waves, view)


def _too_many_for_page(seen: dict[str, Frame]) -> str:
    """Return why the compared frames do not fit on a page, or nothing."""
    events = sum(int(frame.counter("stored").sum()) for frame in seen.values())
    if events <= PAGE_EVENTS_MAX:
        return ""
    return f"{PAGE} is left out: its frames have {events:,} events, {PAGE_EVENTS_MAX:,} fit on it"


def _write_report_page(
    path: Path, heading: str, titles: dict[str, str], seen: dict[str, Frame]
) -> bool:
    """Write the views of the compared frames as one HTML file; return False if the extra `explore`
    is not installed.
    """
    try:
        with extra("explore"):
            from .show.report import write_report
    except InputError:
        path.unlink(missing_ok=True)  # from an earlier run
        return False
    write_report(path, heading, [FrameView(titles[name], frame) for name, frame in seen.items()])
    return True


def _pictures(
    out: Path, heading: str, titles: dict[str, str], seen: dict[str, Frame]
) -> dict[str, Any]:
    """Write `pictures_of`; return the shares of wrong pixels, by the paper's criterion and by 15 cm,
    under the report's keys.
    """
    from .pictures import Panel, depth_row

    shares: dict[str, Any] = {}
    last = seen[list(seen)[-1]]
    told = "the controller's thresholds" if CONTROLLED in seen else "the thresholds"
    blocks = told, subgroup_image(last.threshold, last.config.sensor)
    shown = None if last.config.counting else blocks  # no threshold has an effect on counts
    for file, (method, suffix, what) in pictures_of(last.config).items():
        frames = {name: frame.by(method) for name, frame in seen.items()}
        panels = [
            Panel(titles[name], frame.depth_m, frame.first.reason) for name, frame in frames.items()
        ]
        depth_row(out / file, panels, last.truth_m, f"{heading}: {what}", blocks=shown)
        for name, frame in frames.items():
            key = f"wrong_share_{name}{suffix}"
            shares |= {key: frame["wrong_share"], f"{key}_15cm": frame["wrong_share_15cm"]}
    return shares


def _light_picture(
    path: Path, heading: str, titles: dict[str, str], seen: dict[str, Frame]
) -> None:
    """Write the estimated light of the first returns."""
    from .pictures import light_row

    panels = []
    for name, frame in seen.items():
        light = frame.first.signal_per_pulse
        assert light is not None, "every estimator tells the light"
        panels.append((titles[name], light[:, :, 0]))
    truth = list(seen.values())[-1].light.total_signal.reshape(panels[0][1].shape)
    light_row(path, panels, truth, f"{heading}: light, photons per pulse")


def _write_frames(out: Path, heading: str, played: Played) -> dict[str, list[Number]]:
    """Write the depth of all frames of the last scheme; return their shares of wrong pixels under
    the report's key.
    """
    from .animation import write_animation

    run = list(played.runs.values())[-1]
    frames = [run.frame(number) for number in range(run.config.frames)]
    write_depths(out / DEPTHS, [frame.first for frame in frames], [one.truth_m for one in frames])
    write_animation(out / ANIMATION, frames, heading)
    return {"wrong_share_frames": [frame["wrong_share"] for frame in frames]}


def settings_of(config: Config) -> dict[str, Any]:
    """Return the configuration as tables of its file; a setting of the subgroups is a list if they
    differ.
    """
    subgroup = {name: getattr(config, name).tolist() for name in SUBGROUP}
    subgroup["mask"] = [mask_text(mask) for mask in config.mask]
    derived: dict[str, Any] = {}
    if config.sensor.controller:
        derived = {"auto_bounds": config.auto_bounds.tolist(), "capacity": config.capacity}
    if config.sensor.counts:
        derived["search_pulses"] = config.search_pulses
    return {
        "sensor": sensor_table(config.sensor) | own_rule(config.sensor),
        "frame": frame_table(config.frame) | derived,
        "subgroup": {name: v[0] if len(set(v)) == 1 else v for name, v in subgroup.items()},
    }


def _report(played: Played) -> dict[str, Any]:
    """Return the report with flat keys: totals of all frames, and numbers of a scheme under keys
    that end with its name.
    """
    is_known = "dropped" not in _full_counters(played.result)
    dropped = COUNTER_NAMES.index("dropped")
    report: dict[str, Any] = {
        "cycles": played.cycles,
        "edges": sum(run.edge_count for run in played.runs.values()),
        "events": played.result.events,
        "dropped": sum(int(of_frame[:, dropped].sum()) for of_frame in played.result.counters)
        if is_known
        else None,
        "mismatches": 0,
        "checked": played.checked,
        "cycles_per_s": round(played.cycles / played.seconds, 1),
        "seconds": round(played.seconds, 3),
    }
    for name, frame in played.frames.items():
        report |= {
            f"events_{name}": frame["events"],
            f"dropped_{name}": frame["dropped"],
            f"beats_{name}": frame["beats"],
            f"load_{name}": frame["link_load"],
            f"stream_load_{name}": frame["stream_load"],
            f"mean_gbps_{name}": frame["mean_gbps"],
            f"threshold_{name}": frame.threshold.tolist(),
        }
    return report


def _full_counters(result: ResultFile) -> list[str]:
    """Return the names of the counters that are at their end in some frame and subgroup."""
    sensor = result.config.sensor
    counters = counter_arrays(result.counters)
    return [name for name, counted in counters.items() if at_end(name, counted, sensor).any()]


def _told_full(result: ResultFile) -> list[str]:
    """Return a sentence about the counters that are at their end; nothing if none is."""
    full = _full_counters(result)
    if not full:
        return []
    sensor = result.config.sensor
    end = f"{sensor.counter_max:,} (sensor.counter_bits = {sensor.counter_bits})"
    return [f"note: counters at their end, {end}, have counted more: {', '.join(full)}"]


def _write_report(out: Path, report: dict[str, Any]) -> None:
    with whole_file(out / REPORT, "w") as file:
        file.write(json.dumps(report, indent=2) + "\n")


def _tell_if_useless(
    console: Console, setup: Setup, config: Config, report: dict[str, Any], schemes: list[str]
) -> None:
    """Print first that no scheme leaves a useful picture, and what would help; nothing if one
    does.
    """
    shares = [report[f"wrong_share_{name}"] for name in schemes]
    wrong = min(1.0 if share is None else share for share in shares)
    if is_useful(wrong):
        return
    last = setup.seen.at(report["frames"] - 1)
    changed = setup.but(config=config, scene=last, view=DEFAULT_VIEW, estimators=(DEFAULT_METHOD,))
    workers = os.cpu_count() or 1
    told = useless_sentence(wrong, changed, int(config.window.max()), workers)
    console.print(told, markup=False, emoji=False, soft_wrap=True)


def _span(values: np.ndarray) -> str:
    low, high = values.min(), values.max()
    return f"{low}" if low == high else f"{low} to {high}"


def _table(titles: dict[str, str], report: dict[str, Any]) -> Table:
    """Return the table of the schemes."""
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("frame", no_wrap=True)
    for title in ("threshold", "events", "dropped"):
        table.add_column(title, justify="right")
    for title in ("stream load", "link load", "wrong pixels", "by peaks"):
        table.add_column(title.replace(" ", "\n"), justify="right")
    for name, title in titles.items():
        table.add_row(
            title,
            _span(np.array(report[f"threshold_{name}"])),
            f"{report[f'events_{name}']:,}",
            "unknown" if (dropped := report[f"dropped_{name}"]) is None else f"{dropped:,}",
            f"{report[f'stream_load_{name}']:.0%}",
            f"{report[f'load_{name}']:.0%}",
            f"{report[f'wrong_share_{name}']:.1%}",
            f"{report[f'wrong_share_{name}_peak']:.1%}",
        )
    return table


def _counting_table(titles: dict[str, str], report: dict[str, Any]) -> Table:
    """Return the table of frames in the format `counts`."""
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("frame", no_wrap=True)
    for title in ("bits", "stream load", "link load", "wrong pixels"):
        table.add_column(title.replace(" ", "\n"), justify="right")
    for name, title in titles.items():
        table.add_row(
            title,
            f"{BEAT_BITS * report[f'beats_{name}']:,}",
            f"{report[f'stream_load_{name}']:.1%}",
            f"{report[f'load_{name}']:.1%}",
            f"{report[f'wrong_share_{name}']:.1%}",
        )
    return table


def _tell(
    console: Console,
    notes: list[str],
    config: Config,
    titles: dict[str, str],
    report: dict[str, Any],
    written: list[Path],
) -> None:
    """Print the table of the schemes, the notes and the written files."""
    console.print(_counting_table(titles, report) if config.counting else _table(titles, report))
    if CONTROLLED in titles:
        console.print(f"the controller's thresholds after {report['frames']} frames, by subgroup:")
        for row in subgroup_image(np.array(report[f"threshold_{CONTROLLED}"]), config.sensor):
            console.print("  " + " ".join(map(str, row)))
    for note in notes:
        console.print(note, markup=False, emoji=False, soft_wrap=True)
    if config.gap:
        rates = ", ".join(f"{report[f'mean_gbps_{name}'] * 1e3:.4g}" for name in titles)
        pace = f"{told_pace(config)}; mean rate of the link: {rates} Mbit/s"
        console.print(pace, soft_wrap=True)
    checked = (
        f"{report['checked']:,} beats and commits equal the golden model's"
        if report["checked"]
        else "golden model only, no RTL"
    )
    console.print(
        f"{report['cycles']:,} cycles in {report['seconds']:.1f} s ({report['cycles_per_s']:,.0f} cycles/s): {checked}"
    )
    console.print("results: " + " ".join(map(str, written)), soft_wrap=True)
