"""A run from the scene to what left the sensor, with what one asks of it next: the front door of the library."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from attrs import frozen

from ..model.contract.config import Config, load_config
from ..model.contract.edges import Edges
from ..model.contract.result import events_table, write_result
from ..model.depth.estimate import Depth, estimate_depth
from ..model.depth.histograms import pixel_histogram
from ..model.light.light import Light
from ..model.light.link_budget import Optics
from ..model.light.photons import generate_edges
from ..model.light.spad import Spad
from ..model.light.timing import Timing
from ..model.scenes.catalogue import load_scene
from ..model.scenes.scene import Scene, scene_light
from ..tb.replay import replay
from .point_cloud import point_cloud, write_ply


@frozen(eq=False, kw_only=True)
class Run:
    """What was simulated, and what left the sensor: the arrays of the result file, of all frames (`model/contract/result.py`).

    Every method is a function of the same module set to this run; arguments and errors are the function's.
    """

    config: Config
    scene: Scene
    light: Light
    edges: Edges
    result: dict[str, np.ndarray]

    def depth(self, **options: Any) -> Depth:
        """`estimate_depth`: distance of every pixel (`frame`, `method`, `returns`)."""
        return estimate_depth(self.result, self.config, **options)

    def events(self) -> Any:
        """`events_table`: a row for every event."""
        return events_table(self.result)

    def histogram(self, pixel: int, **options: Any) -> np.ndarray:
        """`pixel_histogram`: hits of a pixel, by tick (`frame`, `source`)."""
        return pixel_histogram(self.result, self.config, pixel, **options)

    def point_cloud(self, optics: Optics | None = None, **options: Any) -> np.ndarray:
        """`point_cloud` of the depth that `estimate_depth` gives with the other options."""
        return point_cloud(self.depth(**options), optics)

    def to_ply(self, path: str | Path, **options: Any) -> None:
        """`write_ply` of the same."""
        write_ply(path, self.point_cloud(**options))

    def save(self, path: str | Path) -> None:
        """`write_result`: the result file (NPZ)."""
        write_result(path, self.result)


def simulate(
    config: Config | str | Path | None = None,
    scene: Scene | str = "five-objects",
    *,
    klux: float = 50.0,
    seed: int = 1,
    spad: Spad | None = None,
    engine: str = "golden",
) -> Run:
    """The scene's photons in all frames of a configuration, through an engine of `tb/replay.py`.

    config: or what `load_config` takes; scene: or what `load_scene` takes; seed: of the light. Raises `InputError`.
    """
    config = config if isinstance(config, Config) else load_config(config)
    scene = scene if isinstance(scene, Scene) else scene_of(config, scene)
    light = scene_light(scene, klux)
    edges = generate_edges(
        light,
        spad or Spad(),
        Timing.from_config(config),
        pulses=config.frames * config.pulses,
        seed=seed,
        workers=os.cpu_count() or 1,
    )
    return Run(config=config, scene=scene, light=light, edges=edges, result=replay(engine, config, edges))


def scene_of(config: Config, source: str) -> Scene:
    """The scene that `source` names (`load_scene`), as the pixels of a configuration see it within its laser period's range."""
    sensor = config.sensor
    return load_scene(source, sensor.rows, sensor.cols, range_m=Timing.from_config(config).range_m)
