# SPDX-License-Identifier: Apache-2.0
"""One Monte Carlo frame, from a scene's photons through the sensor to depth, and many of them on all cores."""

import os
from collections.abc import Callable, Hashable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from typing import Any, TypeAlias, TypeVar

import numpy as np
from attrs import evolve, field, frozen

from ...model.contract.config import Config, parse_config
from ...model.contract.edges import Edges
from ...model.depth.estimate import estimate_depth
from ...model.depth.quality import wrong_pixels
from ...model.golden.frame import golden_result
from ...model.light.photons import generate_edges
from ...model.light.spad import Spad
from ...model.light.timing import Timing
from ...model.scenes.catalogue import load_scene
from ...model.scenes.scene import Scene, scene_light
from ...model.shared.interrupts import worker_processes

Engine = Callable[[Config, Edges], dict[str, np.ndarray]]
Progress = Callable[[int, int], None]  # cases done, cases in total
Table: TypeAlias = dict[str, Any]  # of a configuration file
_Key = TypeVar("_Key", bound=Hashable)
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

PULSES, MANY = 100, 8  # pulses of a frame (paper IV); factor for a second run, which shows what is noise


@frozen(kw_only=True, eq=False)
class Case:
    """Input of one frame. sensor, frame, subgroup: tables of the configuration file. threshold: per subgroup, or None.

    methods: of `METHODS`, or `METHOD/SOURCE` with another source of histograms than the map. With several frames (for
    the controller), only the last one counts.
    """

    scene: str = "five-objects"
    klux: float = 50.0
    seed: int = 1
    sensor: Table = field(factory=dict)
    frame: Table = field(factory=dict)
    subgroup: Table = field(factory=dict)
    threshold: tuple[int, ...] | None = None
    methods: tuple[str, ...] = ("planes",)
    spad: Spad = field(factory=Spad)

    def config(self) -> Config:
        config = parse_config(
            {"sensor": self.sensor, "frame": {"pulses": PULSES} | self.frame, "subgroup": self.subgroup}
        )
        return config if self.threshold is None else config.with_settings(threshold=self.threshold)


@frozen(kw_only=True, eq=False)
class Outcome:
    """Result of a case: depth in metres by method, float64[rows, cols]; counts of the last frame, int64[subgroups]."""

    case: Case
    scene: Scene
    depth_m: dict[str, np.ndarray]
    opened: np.ndarray
    committed: np.ndarray
    stored: np.ndarray
    photons: np.ndarray
    threshold: np.ndarray
    mg_stored: np.ndarray
    frame_s: float

    def wrong(self, method: str) -> np.ndarray:
        """bool[rows, cols]."""
        return wrong_pixels(self.depth_m[method], self.scene.truth_m)

    def wrong_share(self, method: str) -> float:
        return float(self.wrong(method)[self.scene.valid].mean())

    def wrong_by_object(self, method: str) -> dict[int, float]:
        wrong, labels = self.wrong(method), self.scene.labels
        return {int(label): float(wrong[labels == label].mean()) for label in np.unique(labels)}

    @property
    def events_per_s(self) -> float:
        return float(self.stored.sum() / self.frame_s)


def run_case(case: Case, engine: Engine = golden_result) -> Outcome:
    """Run photons, sensor (`engine`: golden model or RTL) and depth."""
    config = case.config()
    scene, timing = load_scene(case.scene, config.sensor.rows, config.sensor.cols), Timing.from_config(config)
    edges = generate_edges(
        scene_light(scene, case.klux), case.spad, timing, pulses=config.pulses * config.frames, seed=case.seed
    )
    arrays, last = engine(config, edges), config.frames - 1
    depth_m = {}
    for name in case.methods:
        method, _, source = name.partition("/")
        depth = estimate_depth(arrays, config, method=method, source=source or "map", frame=last)
        depth_m[name] = depth.depth_m[:, :, 0]
    counts = {name: arrays[name][last] for name in ("opened", "committed", "stored", "photons", "mg_stored")}
    return Outcome(
        case=case,
        scene=scene,
        depth_m=depth_m,
        threshold=arrays["threshold_used"][last],
        frame_s=config.pulses * timing.period_s,
        **counts,
    )


class Runner:
    """Runs cases on `workers` processes, in order, and counts them; results do not depend on the number of workers."""

    def __init__(self, workers: int | None = None, progress: Progress = lambda done, total: None):
        self.workers = workers or os.cpu_count() or 1
        self.progress = progress
        self.done = self.total = 0
        self._pool: ProcessPoolExecutor | None = None
        self._processes = ExitStack()

    def __enter__(self) -> "Runner":
        if self.workers > 1:
            self._pool = self._processes.enter_context(worker_processes(self.workers))
        return self

    def __exit__(self, *raised: Any) -> None:
        self._processes.__exit__(*raised)

    def run(self, cases: Iterable[Case]) -> list[Outcome]:
        """Return the outcomes of `cases`, in their order."""
        return self.map(run_case, cases)

    def table(self, cases: dict[_Key, list[Case]]) -> dict[_Key, list[Outcome]]:
        """Return the outcomes by key."""
        outcomes = iter(self.run([case for group in cases.values() for case in group]))
        return {key: [next(outcomes) for _ in group] for key, group in cases.items()}

    def map(self, function: Callable[[_Item], _Result], items: Iterable[_Item]) -> list[_Result]:
        """Return `function` (of a module) of each item."""
        tasks = list(items)
        self.total += len(tasks)
        results = []
        for result in self._pool.map(function, tasks) if self._pool else map(function, tasks):
            results.append(result)
            self.done += 1
            self.progress(self.done, self.total)
        return results


def vary(
    case: Case,
    seeds: int = 1,
    *,
    pulses: int = PULSES,
    sensor: Table | None = None,
    frame: Table | None = None,
    subgroup: Table | None = None,
    **others: Any,
) -> list[Case]:
    """Return `case` with further settings, for several seeds; `others` are fields of `Case`."""
    changed = evolve(
        case,
        sensor=case.sensor | (sensor or {}),
        subgroup=case.subgroup | (subgroup or {}),
        frame=case.frame | {"pulses": pulses} | (frame or {}),
        **others,
    )
    return [evolve(changed, seed=seed + 1) for seed in range(seeds)]


def mean_of(items: Sequence[_Item], value: Callable[[_Item], float]) -> float:
    return float(np.mean([value(item) for item in items]))
