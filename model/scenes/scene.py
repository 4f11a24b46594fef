"""A scene: for every pixel of the sensor the distance and reflectivity of what it looks at, and the light that comes of it."""

from typing import Any

import numpy as np
from attrs import field, frozen

from ..light.light import NEAREST_M, Light
from ..shared.errors import InputError
from ..shared.quantities import given, real_array
from .transient import Transient

NO_OBJECT = 0
REFLECTIVITY = 0.4  # where nothing says another: that of the paper's flat target


@frozen(kw_only=True, eq=False)
class Scene:
    """What rows x cols pixels look at.

    distance_m, reflectivity: float64[rows, cols, targets] (two-dimensional input: one target); distance NaN = no target,
    and a pixel without any is invalid. labels: int64[rows, cols], number of the object, `NO_OBJECT` where that means
    nothing. notes: sentences that the user should read (what was cropped, masked, assumed). transient: of a ray-traced scene,
    whose light it is then; distance and reflectivity are what is looked for, not where the light comes from.
    Raises `InputError` for distances below `NEAREST_M` and reflectivities outside 0 to 1.
    """

    name: str
    distance_m: np.ndarray = field(converter=given)
    reflectivity: np.ndarray = field(converter=given)
    labels: np.ndarray = field(default=NO_OBJECT, converter=given)
    notes: tuple[str, ...] = ()
    transient: Transient | None = None

    def __attrs_post_init__(self) -> None:
        distance_m = np.asarray(self.distance_m, np.float64)
        reflectivity = np.asarray(self.reflectivity, np.float64)
        if distance_m.ndim == 2:
            distance_m = distance_m[:, :, None]
            reflectivity = reflectivity[:, :, None] if reflectivity.ndim == 2 else reflectivity
        if distance_m.ndim != 3:
            raise InputError(f"distance_m: has {distance_m.ndim} dimensions, must have 2 or 3: rows, cols, targets")
        shape = distance_m.shape
        object.__setattr__(self, "distance_m", real_array("distance_m", distance_m, shape, NEAREST_M, nan=True))
        object.__setattr__(self, "reflectivity", real_array("reflectivity", reflectivity, shape, 0, 1))
        object.__setattr__(self, "labels", np.broadcast_to(np.asarray(self.labels, np.int64), shape[:2]))

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
        """float64[rows, cols]: the nearest target's distance, NaN where a pixel is invalid."""
        return np.fmin.reduce(self.distance_m, axis=2)


def scene_light(scene: Scene, klux: float, **others: Any) -> Light:
    """The light of `scene` under `klux` of background, by the presets of `light.py`; `others` are fields of `Light`."""
    if scene.transient is not None:
        return scene.transient.light(klux, **others)
    return Light.from_scene(scene.distance_m, scene.reflectivity, klux, **others)
