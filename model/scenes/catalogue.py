"""The catalogue of scenes: from what a user names to a `Scene`, whichever file makes it."""

from collections.abc import Callable
from pathlib import Path

from ..light.light import NEAREST_M
from ..light.timing import RANGE_M
from ..shared.errors import InputError, check_integer
from ..shared.files import FilePath
from ..shared.quantities import check_real
from .depth_file import depth_scene
from .planes import FIVE_OBJECTS, LETTER_F, flat, planes_scene, two_returns, two_targets
from .ray_scene import is_ray_scene, ray_scene
from .scene import REFLECTIVITY, Scene

_TWO = (("NEAR", 5.0), ("FAR", 9.0), ("REFLECTIVITY", REFLECTIVITY))
BUILT_IN: dict[
    str, tuple[tuple[tuple[str, float], ...], Callable[..., Scene]]
] = {  # name: parameters with their defaults, and the function that builds it
    "five-objects": ((), lambda rows, cols, name: planes_scene(FIVE_OBJECTS, rows, cols, name)),
    "letter-f": ((), lambda rows, cols, name: planes_scene(LETTER_F, rows, cols, name)),
    "flat": ((("DISTANCE", 10.0), ("REFLECTIVITY", REFLECTIVITY)), flat),
    "two-targets": (_TWO, two_targets),
    "two-returns": (_TWO, two_returns),
}


def load_scene(
    source: str,
    rows: int,
    cols: int,
    *,
    colour: FilePath | None = None,
    reflectivity: float = REFLECTIVITY,
    range_m: float = RANGE_M,
) -> Scene:
    """The scene that `source` names, at rows x cols.

    source: a built-in one (`five-objects`, `letter-f`, `flat:DISTANCE,REFLECTIVITY`, `two-targets:NEAR,FAR`: stripes,
    `two-returns:NEAR,FAR`: both in every pixel; metres), a file (`depth_scene`): `DEPTH` or `DEPTH,COLOUR`, or one for the ray
    tracer (`ray_scene`): `ray:NAME`, or a Mitsuba scene that ends with .xml.
    colour: picture for the reflectivity of a file, else the constant `reflectivity`. range_m: what the laser period holds.
    Raises `InputError`.
    """
    check_integer("rows", rows, 1, 4096)
    check_integer("cols", cols, 1, 4096)
    source = depth = str(source)
    if is_ray_scene(source):
        return ray_scene(source, rows, cols, range_m=range_m)
    name, _, values = source.partition(":")
    if name in BUILT_IN and not Path(source).exists():
        defaults, build = BUILT_IN[name]
        return build(rows, cols, source, *_numbers(name, values, defaults, range_m))
    if "," in depth and not Path(depth).exists():
        depth, _, beside = depth.rpartition(",")
        if colour is not None:
            raise InputError(f"scene {source!r}: names a colour picture, and another one is given: {colour}")
        colour = beside
    if not Path(depth).exists():
        raise InputError(f"{depth}: no such file (built-in scenes: {', '.join(BUILT_IN)})")
    return depth_scene(depth, rows, cols, colour=colour, reflectivity=reflectivity, range_m=range_m)


def _numbers(name: str, text: str, defaults: tuple[tuple[str, float], ...], range_m: float) -> list[float]:
    """The comma-separated numbers after a built-in scene's name, the rest by default."""
    given = text.split(",") if text else []
    if len(given) > len(defaults):
        form = ",".join(what for what, _ in defaults)
        raise InputError(f"scene {name}:{text}: must be {name}{':' if form else ''}{form}")
    values = []
    for i, (what, default) in enumerate(defaults):
        low, high = (0.0, 1.0) if what == "REFLECTIVITY" else (NEAREST_M, range_m)
        try:
            value: float | str = float(given[i]) if i < len(given) else default
        except ValueError:
            value = given[i]
        values.append(check_real(f"scene {name}: {what}", value, low, high))
    return values
