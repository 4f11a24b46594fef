# SPDX-License-Identifier: Apache-2.0
"""The main entry of the library: `simulate`, and the run that it returns, with methods for the
usual next steps.
"""

import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..lab import outcomes
from ..lab.options import OPTIONS, documented
from ..lab.setup import Setup, for_pictures, scene_of, with_tables
from ..model.contract.config import PER_FRAME, SETTINGS, Config, load_config
from ..model.contract.pixels import pixel_number
from ..model.contract.result import events_table, write_result
from ..model.depth.depth import write_depths
from ..model.depth.methods import DEFAULT_METHOD, Method
from ..model.golden.frame import Golden
from ..model.light.light import BACKGROUNDS
from ..model.light.link_budget import Optics
from ..model.light.photons import edge_chunks
from ..model.light.spad import Spad
from ..model.scenes.ambient import Ambient
from ..model.scenes.catalogue import NAMES, has_reflectivity, usual_klux
from ..model.scenes.scene import REFLECTIVITY, Scene
from ..model.shared.compiled import is_compiled
from ..model.shared.errors import InputError
from ..model.shared.files import check_suffix
from ..model.shared.pulse import PulseSource, pulse_of
from ..tb.replay import DEFAULT_VIEW
from .point_cloud import point_cloud, write_ply
from .progress import COMPILES

if TYPE_CHECKING:
    from .show.notebook import PixelHistogram, Shown


class Run(outcomes.Run):
    """A simulated run: its inputs, and the sensor's output in all its frames.

    `simulate` returns it. Each method has the arguments and errors of the function that its
    docstring names.

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
        The arrays of the result file, of all frames (docs/files.md).
    """

    def events(self) -> Any:
        """Return one row per event that left the sensor; see `events_table`."""
        return events_table(self.result)

    def histogram(self, pixel: int | tuple[int, int], **options: Any) -> "PixelHistogram":
        """Return the hits of one pixel per tick (see `pixel_histogram`). A notebook draws them with
        the truth and the candidates.

        pixel: (row, column), or row * columns + column.
        """
        from .show.notebook import PixelHistogram

        return PixelHistogram.of(self, pixel_number(self.config.sensor, pixel), **options)

    def point_cloud(
        self, optics: Optics | None = None, *, normals: bool = False, **options: Any
    ) -> np.ndarray:
        """Return points in space; `options` are those of `estimate_depth`. See `point_cloud`.

        optics: None = the field of view of the scene.
        """
        if optics is None:
            view = self.scene.view
            optics = Optics(fov_h_deg=view.h_deg, fov_v_deg=view.v_deg)
        return point_cloud(self.depth(**options), optics, normals=normals)

    def to_pandas(self) -> Any:
        """Return the same table as `events`, under the name that users of pandas expect."""
        return self.events()

    def plot(self, **options: Any) -> "Shown":
        """Return all views of one frame, linked to each other, for a notebook (`frame`,
        `method`).
        """
        from .show.notebook import plot

        return plot(self, **options)

    def timeline(self, subgroup: int, pulse: int, **options: Any) -> "Shown":
        """Return every edge and window of one subgroup in one laser period, for a notebook
        (`frame`).
        """
        from .show.notebook import plot_timeline

        return plot_timeline(self, subgroup, pulse, **options)

    def _repr_html_(self) -> str:
        """Return the summary that a notebook shows (`show.notebook.summary`)."""
        from .show.notebook import summary

        return summary(self)

    def to_ply(self, path: str | Path, **options: Any) -> None:
        """Write `point_cloud` as a PLY file; its folder must exist."""
        check_suffix(path, ".ply")
        if not Path(path).parent.is_dir():
            raise InputError(
                f"{path}: cannot be written: the folder {Path(path).parent} does not exist"
            )
        write_ply(path, self.point_cloud(**options))

    def save_depth(self, path: str | Path, **options: Any) -> None:
        """Write the depth as NPZ (`Depth.save`); `options` are those of `estimate_depth`."""
        check_suffix(path, ".npz")  # before the depth is computed
        self.depth(**options).save(path)

    def save_depths(self, path: str | Path, method: Method | None = None) -> None:
        """Write the depth of all frames as NPZ, with the frames as first axis (`write_depths`)."""
        check_suffix(path, ".npz")
        frames = self._all_frames(method)
        truth_m = [frame.truth_m for frame in frames]
        write_depths(path, [frame.first for frame in frames], truth_m)

    def animate(self, path: str | Path, method: Method | None = None) -> None:
        """Write truth and depth of all frames as an animation: GIF, or an animated PNG."""
        from .animation import check_animation, write_animation

        check_animation(path)
        write_animation(path, self._all_frames(method), self.scene.name)

    def _all_frames(self, method: Method | None) -> list[outcomes.Frame]:
        return [self.frame(number, method) for number in range(self.config.frames)]

    def save(self, path: str | Path) -> None:
        """Write the result file (NPZ), whole or not at all. Raises `InputError` for another
        suffix.
        """
        write_result(path, self.result)


@documented
def simulate(
    config: Config | str | Path | None = None,
    scene: Scene | str | np.ndarray = "five-objects",
    *,
    scale: float = 1.0,
    unit: str | None = None,
    missing: float | Sequence[float] | None = None,
    sky_m: float | None = None,
    z: bool = False,
    fov_deg: float | None = None,
    channel: str | None = None,
    bin_ps: float | None = None,
    recorded_pulses: int | None = None,
    reflectivity: float | np.ndarray = REFLECTIVITY,
    klux: Ambient | None = None,
    background: str = BACKGROUNDS[0],
    pulse: PulseSource | None = None,
    seed: int = 1,
    spad: Spad | None = None,
    spad_gate: bool = False,
    engine: str = "golden",
    view: str = DEFAULT_VIEW,
    method: Method = DEFAULT_METHOD,
    **settings: Any,
) -> Run:
    """Simulate all frames of a configuration: photons of a scene, then the sensor.

    The same arguments always give the same arrays.

    Parameters
    ----------
    config : Config, str, Path or None
        A configuration, or what `load_config` accepts: a TOML file, the name of a preset, or None
        for the defaults.
    {options}
    **settings
        Settings of the configuration by their names, such as threshold=3, pulses=50 or rows=64,
        instead of those of `config`.

    An array of distances is in metres, has any shape (rows, cols), and may be followed by
    `reflectivity`, a number or an array of that shape; 0 and NaN are holes. With a leading axis
    it is a scene that moves: frame k sees picture k, and there are as many frames as pictures,
    unless `frames` says otherwise. So it is with a folder or a pattern of depth files.

    Returns
    -------
    Run
        Inputs and result, with methods for depth, events, histograms and point clouds.

    Warns
    -----
    UserWarning
        If the numbers of a depth file or an array seem to mean something else than what they are
        taken for, or to be no distances.

    Raises
    ------
    InputError
        If an argument is out of range; the message names the field and its legal range.
    """
    _check_order(config)
    config = with_settings(config if isinstance(config, Config) else load_config(config), settings)
    meaning = {
        "scale": scale,
        "unit": unit,
        "missing": missing,
        "sky_m": sky_m,
        "z": z,
        "fov_deg": fov_deg,
        "channel": channel,
        "bin_ps": bin_ps,
        "recorded_pulses": recorded_pulses,
    }
    if isinstance(scene, Scene):
        given = {"reflectivity": has_reflectivity(reflectivity)}
        for name, value in meaning.items():
            given[name] = isinstance(value, np.ndarray) or value != OPTIONS[name].default
        for name in (name for name, is_given in given.items() if is_given):
            raise InputError(
                f"{name}: goes with depth files and arrays of distances, not with a Scene"
            )
    seen = scene_of(config, scene, reflectivity=reflectivity, **meaning)
    for doubt in seen.doubts:
        warnings.warn(doubt, stacklevel=2)
    setup = Setup(
        config=for_pictures(config, seen),
        scene=seen,
        klux=usual_klux(str(scene) if isinstance(scene, str | os.PathLike) else "", bin_ps)
        if klux is None
        else klux,
        background=background,
        pulse=pulse_of(pulse),
        seed=seed,
        spad=Spad() if spad is None else spad,
        spad_gate=spad_gate,
        engine=engine,
        view=view,
        estimators=(method,),
    )
    if not is_compiled(edge_chunks.__module__) or not is_compiled(Golden.__module__):
        print(f"coincid: {COMPILES}", file=sys.stderr, flush=True)
    run = Run(setup, workers=os.cpu_count() or 1)
    _ = run.result  # computed here, so that errors appear in this call
    return run


def _check_order(config: object) -> None:
    """Raise `InputError` if the first argument, the configuration, is a scene."""
    if config is None or isinstance(config, Config):
        return
    told = f"{type(config).__name__}: is no configuration"
    if isinstance(config, str | os.PathLike):
        if str(config).partition(":")[0] not in NAMES or os.path.exists(config):
            return
        told = f"{config!r}: is a scene"
    raise InputError(
        f"config = {told}; the configuration comes first: simulate(None, scene), or simulate(scene=...)"
    )


def with_settings(config: Config, settings: dict[str, Any]) -> Config:
    """Return a copy of `config` with other settings, by their names in any table. They are checked
    together. Raises `InputError`.
    """
    for name in settings:
        if name not in SETTINGS:
            raise InputError(
                f"{name}: unknown argument or setting, must be one of {', '.join((*OPTIONS, *SETTINGS))}"
            )
    tables: dict[str, dict[str, Any]] = {"frame": _for_pulses(config, settings)}
    for name, value in settings.items():
        tables.setdefault(SETTINGS[name].table, {})[name] = value
    try:
        return with_tables(config, tables)
    except InputError as error:
        raise _blaming(error, settings) from None


def _for_pulses(config: Config, settings: dict[str, Any]) -> dict[str, Any]:
    """Return the settings that count something per frame, in proportion to the pulses of
    `settings`; none if these have no pulses.
    """
    if "pulses" not in settings:
        return {}
    pulses = SETTINGS["pulses"].checked("frame.pulses", settings["pulses"], config.sensor)
    replaced = {name: None for name in PER_FRAME if name in settings}
    # not the format, which may change with the pulses, and not all go with all formats
    config = config.with_frame(format=SETTINGS["format"].default, **replaced)
    frame = config.with_pulses(pulses).frame
    scaled = {name: getattr(frame, name) for name in PER_FRAME}
    return {name: value for name, value in scaled.items() if value is not None}


def _blaming(error: InputError, settings: dict[str, Any]) -> InputError:
    """Return an error about another setting with the keys of the changes that led to it."""
    keys = [SETTINGS[name].key for name in settings]
    if (error.field or "").partition("[")[0] in keys:
        return error
    changed = ", ".join(keys)
    return InputError(f"{changed}: does not go with the other settings ({error})", field=changed)
