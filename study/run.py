# SPDX-License-Identifier: Apache-2.0
"""A run from the scene to the sensor's output, with methods for the usual next steps: the front door of the library."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..lab import run as lab
from ..lab.setup import Setup, scene_of
from ..model.contract.config import Config, load_config
from ..model.contract.result import events_table, write_result
from ..model.light.light import BACKGROUNDS
from ..model.light.link_budget import Optics
from ..model.light.spad import Spad
from ..model.scenes.ambient import Ambient
from ..model.scenes.scene import Scene
from .point_cloud import point_cloud, write_ply

if TYPE_CHECKING:
    from .show.notebook import PixelHistogram, Shown


class Run(lab.Run):
    """A simulated run: its inputs, and the sensor's output of all its frames.

    `simulate` returns it. Arguments and errors of the methods are those of the functions that they name.

    Attributes
    ----------
    config : Config
        The checked configuration.
    scene : Scene
        Distances and reflectivities that the pixels see.
    light : Light
        Detected signal and background of every pixel.
    edges : Edges
        All SPAD avalanches of the run.
    result : dict of str to numpy.ndarray
        The arrays of the result file, of all frames (docs/contract.md, "Files").
    """

    def events(self) -> Any:
        """Return one row per event that left the sensor; see `events_table`."""
        return events_table(self.result)

    def histogram(self, pixel: int, **options: Any) -> "PixelHistogram":
        """Return hits of one pixel per tick (see `pixel_histogram`); a notebook draws it with truth and candidates."""
        from .show.notebook import PixelHistogram

        return PixelHistogram.of(self, pixel, **options)

    def point_cloud(self, optics: Optics | None = None, *, normals: bool = False, **options: Any) -> np.ndarray:
        """Return points in space; `options` are those of `estimate_depth`. See `point_cloud`."""
        return point_cloud(self.depth(**options), optics, normals=normals)

    def to_pandas(self) -> Any:
        """Return the same as `events`, under the name that pandas users expect."""
        return self.events()

    def plot(self, **options: Any) -> "Shown":
        """Return all views of one frame, linked to each other, for a notebook (`frame`, `method`)."""
        from .show.notebook import plot

        return plot(self, **options)

    def timeline(self, subgroup: int, pulse: int, **options: Any) -> "Shown":
        """Return every edge and window of one subgroup in one laser period, for a notebook (`frame`)."""
        from .show.notebook import plot_timeline

        return plot_timeline(self, subgroup, pulse, **options)

    def _repr_html_(self) -> str:
        """Return what a notebook shows of the run: `show.notebook.summary`."""
        from .show.notebook import summary

        return summary(self)

    def to_ply(self, path: str | Path, **options: Any) -> None:
        """Write `point_cloud` as a PLY file."""
        write_ply(path, self.point_cloud(**options))

    def save(self, path: str | Path) -> None:
        """Write the result file (NPZ), whole or not at all."""
        write_result(path, self.result)


def simulate(
    config: Config | str | Path | None = None,
    scene: Scene | str = "five-objects",
    *,
    klux: Ambient = 50.0,
    background: str = BACKGROUNDS[0],
    seed: int = 1,
    spad: Spad | None = None,
    engine: str = "golden",
) -> Run:
    """Simulate all frames of a configuration: photons of a scene, then the sensor.

    The same arguments always give the same arrays.

    Parameters
    ----------
    config : Config, str, Path or None
        A configuration, or what `load_config` accepts: a TOML file, the name of a preset, or None for the defaults.
    scene : Scene or str
        A scene, or what `load_scene` accepts: a built-in scene, a depth file, or a ray-traced scene.
    klux : float, numpy.ndarray or str
        Ambient light in klux; also an array in klux, `"2|100"` for two halves, or a file (docs/light.md).
    background : str
        `reflected`: in proportion to the reflectivity of each surface; `even`: the same for every pixel.
    seed : int
        Seed of the photons.
    spad : Spad or None
        The detector; None is the one of the paper.
    engine : str
        `golden` (the model, no RTL tool needed), `sliced`, `verilator` or `icarus` (the RTL).

    Returns
    -------
    Run
        Inputs and result, with methods for depth, events, histograms and point clouds.

    Raises
    ------
    InputError
        If an argument is out of range; the message names the field and its legal range.
    """
    config = config if isinstance(config, Config) else load_config(config)
    setup = Setup(
        config=config,
        scene=scene if isinstance(scene, Scene) else scene_of(config, scene),
        klux=klux,
        background=background,
        seed=seed,
        spad=spad or Spad(),
        engine=engine,
    )
    run = Run(setup, workers=os.cpu_count() or 1)
    _ = run.result  # so that errors come from here
    return run
