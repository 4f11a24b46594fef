# SPDX-License-Identifier: Apache-2.0
"""A scene: distance and reflectivity of the surfaces that every pixel sees, and the light that
comes from them.
"""

from typing import Any, Protocol

import numpy as np
from attrs import evolve, field, frozen

from ..light.light import NEAREST_M, RATE_MAX_CPS, Light
from ..shared.arguments import check_kind
from ..shared.errors import InputError, told_number
from ..shared.quantities import Numbers, given, real_array, shape_of
from .ambient import Ambient, ambient_klux, told_klux
from .view import View


class ShapedLight(Protocol):
    """Light of any shape in time: `Transient` and `RecordedLight`."""

    def depth_m(self) -> np.ndarray: ...
    def light(self, klux: Numbers, *, background: str = ..., **others: Any) -> Light: ...


NO_OBJECT = 0
LABEL_MAX = 2**31 - 1
REFLECTIVITY = 0.4  # default: the reflectivity of the paper's flat target


@frozen(kw_only=True, eq=False)
class Scene:
    """Scene that rows x cols pixels look at.

    name: for titles and reports. distance_m: float64[rows, cols, targets], NaN = no target; a
    two-dimensional array has one target. A pixel without a target is invalid. reflectivity:
    float64[rows, cols, targets], 0 to 1. labels: int64[rows, cols], number of the object, or
    `NO_OBJECT`. sunlit: float64[rows, cols], share of the ambient light that reaches the
    surface, 0 to 1. notes: sentences that the user should read: what was cropped, masked or
    assumed. doubts: sentences to be read before any result: the file seems to hold something else
    than what it was taken for.
    transient: light of a ray-traced scene or of recorded histograms, in which distance and
    reflectivity are only the truth. view: field of view that the pixels share. later: what the
    pixels see in the frames after the first one; empty: the same in all frames.

    Raises `InputError` if a distance is below `NEAREST_M`, or a reflectivity or share is outside
    0 to 1.
    """

    name: str
    distance_m: np.ndarray = field(converter=given)
    reflectivity: np.ndarray = field(converter=given)
    labels: np.ndarray = field(default=NO_OBJECT, converter=given)
    sunlit: np.ndarray = field(default=1.0, converter=given)
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    transient: ShapedLight | None = None
    view: View = View()
    later: tuple["Scene", ...] = ()

    def __attrs_post_init__(self) -> None:
        own = shape_of("distance_m", self.distance_m)
        distance_m = real_array("distance_m", self.distance_m, own, NEAREST_M, nan=True)
        own = shape_of("reflectivity", self.reflectivity)
        reflectivity = real_array("reflectivity", self.reflectivity, own, 0, 1)
        if distance_m.ndim == 2:
            distance_m = distance_m[:, :, None]
            reflectivity = reflectivity[:, :, None] if reflectivity.ndim == 2 else reflectivity
        if distance_m.ndim != 3:
            raise InputError(
                f"distance_m: has {distance_m.ndim} dimensions, must have 2 or 3: rows, cols, targets"
            )
        shape = distance_m.shape
        if not distance_m.size:
            raise InputError(
                f"distance_m: has shape {shape}, must have a target at least: rows, cols, targets",
                field="distance_m",
            )
        object.__setattr__(self, "distance_m", distance_m)
        object.__setattr__(
            self, "reflectivity", real_array("reflectivity", reflectivity, shape, 0, 1)
        )
        object.__setattr__(self, "sunlit", real_array("sunlit", self.sunlit, shape[:2], 0, 1))
        labels = real_array("labels", self.labels, shape[:2], -LABEL_MAX, LABEL_MAX)
        if (labels % 1).any():
            row, col = np.argwhere(labels % 1)[0]
            raise InputError(
                f"labels[{row}, {col}] = {labels[row, col]}: must be an integer", field="labels"
            )
        object.__setattr__(self, "labels", labels.astype(np.int64))

    def __repr__(self) -> str:
        """Return one line: name, size, and range of the distances."""
        size = f"{self.rows} x {self.cols} pixels"
        if not self.valid.any():
            return f"<Scene {self.name}: {size}, no target>"
        span = f"{np.nanmin(self.distance_m):.3g} to {np.nanmax(self.distance_m):.3g} m"
        moves = f", picture 1 of {self.pictures}" if self.later else ""
        return f"<Scene {self.name}: {size}, {span}{moves}>"

    @property
    def pictures(self) -> int:
        """Number of frames that this scene has a picture of its own for; 1 if nothing moves."""
        return 1 + len(self.later)

    def at(self, frame: int) -> "Scene":
        """Return what the pixels see in a frame, from 0 on. Raises `InputError` if the scene moves,
        and has no picture for this frame.
        """
        if not self.later:
            return self
        if not 0 <= frame < self.pictures:
            raise InputError(
                f"frames: frame {frame} has no picture: {self.name} has {self.pictures}, one for"
                f" each frame; must be at most {self.pictures} frames",
                field="frames",
            )
        return self.later[frame - 1] if frame else evolve(self, later=())

    @property
    def rows(self) -> int:
        return self.distance_m.shape[0]

    @property
    def cols(self) -> int:
        return self.distance_m.shape[1]

    @property
    def valid(self) -> np.ndarray:
        """bool[rows, cols]: pixels with a target."""
        return ~np.isnan(self.distance_m).all(axis=2)

    @property
    def truth_m(self) -> np.ndarray:
        """float64[rows, cols]: distance of the nearest target, NaN where a pixel is invalid."""
        return np.fmin.reduce(self.distance_m, axis=2)

    @property
    def surfaces_m(self) -> np.ndarray:
        """float64[rows, cols, surfaces]: distances at which a pixel sees a surface, NaN = none.

        These are the targets. A ray-traced pixel has two: the surface that fills most of it, and
        its strongest return.
        """
        if self.transient is None:
            return self.distance_m
        return np.dstack([self.distance_m, self.transient.depth_m()])


def scene_light(scene: Scene, klux: Ambient, **others: Any) -> Light:
    """Return the light of a scene, with the presets of docs/light.md. Raises `InputError`.

    klux: ambient light, as in `simulate`. others: `background`, and fields of `Light`.
    """
    check_kind("scene", scene, Scene)
    reaches_klux = ambient_klux(klux, scene.rows, scene.cols) * scene.sunlit
    try:
        if scene.transient is not None:
            return scene.transient.light(reaches_klux, **others)
        return Light.from_scene(scene.distance_m, scene.reflectivity, reaches_klux, **others)
    except InputError as error:
        if error.field != "background_cps":
            raise
        message = (
            f"klux = {told_klux(klux)}: is too much ambient light: a pixel would detect more than"
            f" {told_number(RATE_MAX_CPS)} photons per second"
        )
        raise InputError(message, field="klux") from None
