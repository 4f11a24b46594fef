# SPDX-License-Identifier: Apache-2.0
"""The schemes that `coincid sim` compares, and their runs.

The scheme `off` has coincidence off (the paper's scheme 1), `fixed` has one threshold for all
subgroups, and `auto` has the thresholds of the controller, which first settles in frames of new
photons. The compared frames see the same photons. In the format `counts`, thresholds have no effect,
so there is one scheme, `counts`.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..lab.long_frames import PlayedFrames, Progress, play_last_frame, play_long_frames
from ..lab.measures import Number
from ..lab.outcomes import Run
from ..lab.setup import fixed_thresholds
from ..model.contract.config import Config
from ..model.golden.frame import Golden
from ..model.scenes.scene import Scene
from .progress import Bar

SCHEMES = {  # name: (title, settings that differ), in the order of the frames
    "off": ("coincidence off", {"coincidence": False, "auto": False}),
    "fixed": ("one threshold: {threshold}", {"coincidence": True, "auto": False}),
    "auto": ("controller", {"coincidence": True, "auto": True}),
}
CONTROLLED = "auto"
COUNTING: dict[str, tuple[str, dict[str, bool]]] = {"counts": ("counts in gates", {})}
PROGRESS_PARTS = 1000


def schemes_of(config: Config) -> dict[str, tuple[str, dict[str, bool]]]:
    """Return those of `SCHEMES` that a sensor supports, or the one of the format `counts`."""
    if config.counting:
        return COUNTING
    return {
        name: scheme
        for name, scheme in SCHEMES.items()
        if config.sensor.controller or name != CONTROLLED
    }


def seeing_all(config: Config, scene: Scene) -> list[str]:
    """Return the schemes that play all frames: the controller; without it, the last scheme of a
    scene that moves.
    """
    last = list(schemes_of(config))[-1]
    return [last] if last == CONTROLLED or scene.later else []


def best_threshold(run: Run) -> int:
    """Return the threshold with the fewest wrong pixels in the last frame of the golden model, the
    lowest among equals.
    """
    wrong = {
        threshold: run.alone(-1, subgroup=_settings("fixed", threshold))["wrong_share"]
        for threshold in fixed_thresholds(run.config.sensor)
    }
    return _least_wrong(wrong)


def _settings(scheme: str, threshold: ArrayLike | None) -> dict[str, Any]:
    """Return the settings of the subgroups that a scheme has. threshold: of `fixed`; the others have
    none.
    """
    _, settings = (SCHEMES | COUNTING)[scheme]
    return settings | ({"threshold": threshold} if scheme == "fixed" else {})


def _least_wrong(wrong: dict[int, Number]) -> int:
    """Return the threshold with the smallest share, the lowest among equals."""
    return min(wrong, key=lambda threshold: (wrong[threshold] or 0.0, threshold))


def scheme_runs(run: Run, threshold: ArrayLike) -> dict[str, Run]:
    """Return the run of each scheme. Those of `seeing_all` see the photons of all frames; the
    others only see those of the last frame.
    """
    golden, runs = Golden(run.config.sensor), {}
    all_frames = seeing_all(run.config, run.scene)
    for name in schemes_of(run.config):
        settings = _settings(name, threshold)
        if name in all_frames:
            own = run.but(subgroup=settings)
        else:
            own = run.alone(-1, subgroup=settings)
        traces = [golden.frame(own.config, own.frame_edges(k)) for k in range(own.config.frames)]
        runs[name] = Run(
            own.setup, workers=run.workers, edges=own.edges, played=PlayedFrames.whole(traces)
        )
    return runs


def long_scheme_runs(
    run: Run, threshold: np.ndarray | None, bar: Bar
) -> tuple[dict[str, Run], np.ndarray]:
    """Return what `scheme_runs` returns for a run that does not keep its edges, and the threshold
    of `fixed`.

    threshold: of `fixed`; None: the best one (`best_threshold`). The photons are drawn twice: once
    for the schemes that see the last frame only, once for the one that sees all.
    """
    sensor = run.config.sensor
    all_frames = seeing_all(run.config, run.scene)
    schemes = schemes_of(run.config)
    settings: dict[str | int, dict[str, Any]] = {}
    for name in schemes:
        if name == "fixed" and threshold is None:
            settings |= {one: _settings(name, one) for one in fixed_thresholds(sensor)}
        elif name not in all_frames:
            settings[name] = _settings(name, threshold)
    alone = _last_frame_runs(run, settings, bar) if settings else {}
    if threshold is None:
        bar.stage("best threshold")
        best, alone["fixed"] = _take_best(alone, fixed_thresholds(sensor))
        threshold = np.full_like(run.config.threshold, best)

    golden = Golden(sensor)
    runs = {}
    for name in schemes:
        if name in all_frames:
            own = run.but(subgroup=_settings(name, threshold))
            runs[name] = _all_frames_run(golden, own, bar)
        else:
            runs[name] = alone[name]
            golden.follow(runs[name].config, runs[name].counters(0))
    return runs, threshold


def _take_best(runs: dict[str | int, Run], thresholds: Iterable[int]) -> tuple[int, Run]:
    """Take the runs of these thresholds out of `runs`; return the best threshold and its run.

    At most two runs have their depth in memory at the same time.
    """
    wrong: dict[int, Number] = {}
    best: tuple[int, Run] | None = None
    for threshold in thresholds:
        candidate = runs.pop(threshold)
        wrong[threshold] = candidate["wrong_share"]
        if _least_wrong(wrong) == threshold:
            best = threshold, candidate
    assert best is not None, "a sensor has at least one threshold"
    return best


def _last_frame_runs(
    run: Run, settings: dict[str | int, dict[str, Any]], bar: Bar
) -> dict[str | int, Run]:
    """Return runs of the last frame alone, each with its settings of the subgroups."""
    frames = run.config.frames
    last = run.setup.but(frame={"frames": 1}, scene=run.scene.at(frames - 1))
    setups = {name: last.but(subgroup=own) for name, own in settings.items()}
    played = play_last_frame(
        [(Golden(setup.config.sensor), setup.config) for setup in setups.values()],
        frames,
        run.setup.photons.chunks(run.workers),
        run.workers,
        _stage(bar, "photons, and thresholds of the last frame"),
    )
    return {
        name: Run(setup, cache=run.cache, workers=run.workers, played=one)
        for (name, setup), one in zip(setups.items(), played, strict=True)
    }


def _all_frames_run(golden: Golden, run: Run, bar: Bar) -> Run:
    """Return a run whose frames the golden model has played behind the ones before."""
    played = play_long_frames(
        golden,
        run.config,
        run.setup.photons.chunks(run.workers),
        _stage(bar, "photons and golden model"),
    )
    return Run(run.setup, cache=run.cache, workers=run.workers, played=played)


def _stage(bar: Bar, name: str) -> Progress:
    """Begin a stage, and return what shows its progress."""
    bar.stage(name, PROGRESS_PARTS)
    return lambda share, _: bar.done(int(share * PROGRESS_PARTS))
