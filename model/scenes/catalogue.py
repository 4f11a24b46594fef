# SPDX-License-Identifier: Apache-2.0
"""The catalogue of scenes: makes a `Scene` from the name or file that a user gives."""

import os
from collections.abc import Callable, Iterator, Sequence
from os import PathLike

import numpy as np
from attrs import fields

from ..light.light import NEAREST_M
from ..light.timing import RANGE_M
from ..shared.errors import InputError, check_integer, told_value
from ..shared.files import FilePath
from ..shared.quantities import check_real
from .archives import is_in_archive
from .conventions import ARCHIVES, ARRAYS, DEPTH_FILES
from .daylight import SHADE, sun_and_shade, tunnel
from .depth_file import depth_scene
from .depth_pictures import ARRAY, array_in_file, picture_files
from .flat_scenes import FIVE_OBJECTS, LETTER_F, flat, planes_scene, returns, two_targets
from .meaning import Meaning
from .ray_scene import is_ray_scene, ray_scene
from .recorded_light import histogram_scene
from .scene import REFLECTIVITY, Scene

DISTANCES = ("DISTANCE", "NEAR", "FAR")  # parameters in metres; the others are shares
_TWO = (("NEAR", 5.0), ("FAR", 9.0), ("REFLECTIVITY", REFLECTIVITY))
BUILT_IN: dict[
    str, tuple[tuple[tuple[str, float], ...], Callable[..., Scene]]
] = {  # name: parameters with their defaults, and the function that builds it
    "five-objects": ((), lambda rows, cols, name: planes_scene(FIVE_OBJECTS, rows, cols, name)),
    "letter-f": ((), lambda rows, cols, name: planes_scene(LETTER_F, rows, cols, name)),
    "flat": ((("DISTANCE", 10.0), ("REFLECTIVITY", REFLECTIVITY)), flat),
    "two-targets": (_TWO, two_targets),
    "two-returns": (
        _TWO,
        lambda rows, cols, name, *given: returns(
            rows, cols, name, [(m, given[2] / 2) for m in given[:2]]
        ),
    ),
    "sun-and-shade": ((("SHADE", SHADE),), sun_and_shade),
    "tunnel": ((("SHADE", SHADE),), tunnel),
}

# the scene of any number of surfaces per pixel, and the sign before a reflectivity
RETURNS, AT = ("returns", "@")
NAMES = (*BUILT_IN, RETURNS)

USUAL_KLUX, DAYLIGHT_KLUX = 50.0, {"sun-and-shade": 100.0, "tunnel": 100.0}


def has_reflectivity(reflectivity: float | np.ndarray) -> bool:
    """Return whether a reflectivity is another one than the default."""
    try:
        return bool(np.any(reflectivity != REFLECTIVITY))
    except TypeError:  # NumPy does not compare arrays with fields
        return True


def usual_klux(source: str, bin_ps: float | None = None) -> float:
    """Return the ambient light of a scene if none is given: full sun in scenes about sun and
    shade, and nothing besides the background of recorded histograms.
    """
    if bin_ps is not None:
        return 0.0
    return DAYLIGHT_KLUX.get(str(source).partition(":")[0], USUAL_KLUX)


def load_scene(
    source: str | np.ndarray,
    rows: int,
    cols: int,
    *,
    colour: FilePath | None = None,
    reflectivity: float | np.ndarray = REFLECTIVITY,
    scale: float = 1.0,
    unit: str | None = None,
    missing: float | Sequence[float] | None = None,
    sky_m: float | None = None,
    z: bool = False,
    fov_deg: float | None = None,
    channel: str | None = None,
    bin_ps: float | None = None,
    recorded_pulses: int | None = None,
    range_m: float = RANGE_M,
) -> Scene:
    """Return the scene that a name or a file describes, for rows x cols pixels.

    Parameters
    ----------
    source : str or numpy.ndarray
        An array of distances in metres (see `depth_scene`);
        a built-in scene with parameters after a colon (`five-objects`, `letter-f`,
        `flat:DISTANCE,REFLECTIVITY`, `two-targets:NEAR,FAR` in stripes, `two-returns:NEAR,FAR`
        in every pixel, `returns:METRES,METRES,...` in every pixel, each METRES or
        METRES@REFLECTIVITY, `sun-and-shade:SHADE`, `tunnel:SHADE`; distances are in metres, and
        SHADE is the share of the light that reaches the shade); a depth file, `DEPTH` or
        `DEPTH,COLOUR` (see `depth_scene`), or `ARCHIVE:NAME` for an array in a NPZ, HDF5 or
        MATLAB file; a sequence of depth files, of which frame k sees picture k: a folder, a
        pattern such as `depth_%04d.png` or `depth_*.png`, or an array with a leading axis; or a
        scene for the ray tracer, `ray:NAME` or a Mitsuba file that ends with .xml.
    rows, cols : int
        Size of the sensor in pixels.
    colour : str, Path or None
        Picture that gives the reflectivities of a depth file; of a sequence, also a sequence.
    reflectivity : float or numpy.ndarray
        Reflectivity without such a picture, 0 to 1; an array has the shape of the distances.
    scale : float
        Factor for the distances of a depth file.
    unit : str or None
        Unit of a depth file: m, cm, mm, 1/N (of a metre),
        disparity[/N]:FOCAL_PX,BASELINE_M[,OFFSET_PX] (N numbers per pixel), or the name of a
        data set, camera or program (see `CONVENTIONS`). None: floats are metres, integers of a
        file millimetres.
    missing : float, sequence of float or None
        Numbers in a depth file that mean "no depth", besides 0, NaN, infinity, 65504, 65535 and
        the limits of integer types.
    sky_m : float or None
        Distance in metres, before the scale, from which on there is nothing to see.
    z : bool
        Distances are along the axis of the lens; otherwise they are along the rays through the
        pixels.
    fov_deg : float or None
        Horizontal field of view of the whole picture, which has square samples. None: the part
        that the sensor sees fills its field of view.
    channel : str or None
        Channel of a picture that has several; None: the one that is called depth or Z.
    bin_ps : float or None
        Width in picoseconds of the bins of histograms, rows x cols x bins, which the source holds
        instead of depth: an array, NPY, NPZ, HDF5 or MATLAB (see `histogram_scene`).
    recorded_pulses : int or None
        Laser pulses whose photons these histograms count. None: they are scaled to the light for
        which the sensor is made.
    range_m : float
        Range of the laser period in metres; surfaces beyond it are left out.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        If the name is unknown, the file cannot be read, or a value is out of range.
    """
    rows = check_integer("rows", rows, 1, 4096)
    cols = check_integer("cols", cols, 1, 4096)
    range_m = check_real("range_m", range_m, NEAREST_M)
    meaning = Meaning(
        unit=unit,
        scale=scale,
        missing=missing,
        sky_m=sky_m,
        z=z,
        fov_deg=fov_deg,
        channel=channel,
        bin_ps=bin_ps,
        recorded_pulses=recorded_pulses,
    )
    if isinstance(source, str | PathLike):
        text = source = str(source)
        if is_ray_scene(text) or _is_built_in(text):
            _check_no_meaning(text, meaning)
            if has_reflectivity(reflectivity):
                raise InputError(
                    f"reflectivity: goes with depth files and arrays, not with scene {text!r}"
                    " (some built-in scenes take one after the colon, as in flat:5,0.9)"
                )
            if colour is not None:
                raise InputError(f"colour = {str(colour)!r}: goes with depth files only")
            return _named_scene(text, rows, cols, range_m)
        pair = _depth_and_colour(text)
        if pair is not None:
            source, beside = pair
            if colour is not None:
                raise InputError(
                    f"scene {text!r}: names a colour picture, and another one is given: {colour}"
                )
            colour = beside
        if not _is_depth(source):
            picture_files(source, DEPTH_FILES)  # tells of a pattern that fits no file
            raise InputError(f"{source}: no such file (built-in scenes: {', '.join(NAMES)})")
    elif not isinstance(source, np.ndarray):
        raise InputError(
            f"scene = {_told(source)}: must be a Scene, a name or file of one, or an array of"
            " distances in metres"
        )
    if meaning.bin_ps is not None:
        _check_only_histograms(meaning, colour, reflectivity)
        return _histograms(source, rows, cols, meaning, range_m)
    return depth_scene(
        source,
        rows,
        cols,
        colour=colour,
        reflectivity=reflectivity,
        meaning=meaning,
        range_m=range_m,
    )


def _check_only_histograms(
    meaning: Meaning, colour: FilePath | None, reflectivity: float | np.ndarray
) -> None:
    """Raise `InputError` if something was said about depth, and the file holds histograms."""
    if colour is not None:
        raise InputError(f"colour = {str(colour)!r}: goes with depth files only, not with bin_ps")
    if has_reflectivity(reflectivity):
        raise InputError("reflectivity: goes with depth files and arrays, not with bin_ps")
    for name, value in _said(meaning):
        if name not in ("bin_ps", "recorded_pulses"):
            raise InputError(
                f"{name} = {told_value(value)}: goes with depth files only, not with bin_ps"
            )


def _histograms(
    source: str | np.ndarray, rows: int, cols: int, meaning: Meaning, range_m: float
) -> Scene:
    """Return the scene of histograms in an array or a file. Raises `InputError`."""
    if isinstance(source, np.ndarray):
        return histogram_scene(ARRAY, source, rows, cols, meaning, range_m)
    path = str(source)
    counts = array_in_file(path)
    if counts is None:
        raise InputError(f"{path}: must be {', '.join((*ARRAYS, *ARCHIVES))} to hold histograms")
    return histogram_scene(path, counts, rows, cols, meaning, range_m)


def _told(source: object) -> str:
    """Return what a user gave as a scene: a list is told by its kind, not by its numbers."""
    if isinstance(source, list | tuple):
        return f"{type(source).__name__} (numpy.array(scene) makes an array of it)"
    return told_value(source)


def _depth_and_colour(text: str) -> tuple[str, str] | None:
    """Return the two paths of DEPTH,COLOUR at the comma that divides existing files, or else at
    the last one.
    """
    if "," not in text or os.path.exists(text):
        return None
    commas = [at for at, sign in enumerate(text) if sign == ","]
    depth = [at for at in commas if _is_depth(text[:at])]
    both = [at for at in depth if _is_depth(text[at + 1 :])]
    if not both and _is_depth(text):
        return None
    at = (both or depth or commas)[-1]
    return text[:at], text[at + 1 :]


def _is_depth(text: str) -> bool:
    """Return whether a text names files that exist: one, a sequence, or an array of an archive."""
    if os.path.exists(text) or is_in_archive(text):
        return True
    try:
        return picture_files(text, DEPTH_FILES) is not None
    except InputError:
        return False


def _check_no_meaning(source: str, meaning: Meaning) -> None:
    """Raise `InputError` if something was said about a depth file, and the scene is none."""
    for name, value in _said(meaning):
        raise InputError(
            f"{name} = {told_value(value)}: goes with depth files only, not with scene {source!r}"
        )


def _said(meaning: Meaning) -> Iterator[tuple[str, object]]:
    """Yield name and value of what is not the default."""
    for one in fields(Meaning):
        value = getattr(meaning, one.name)
        if isinstance(value, np.ndarray) or value != one.default:
            yield one.name, value


def _named_scene(source: str, rows: int, cols: int, range_m: float) -> Scene:
    """Return a scene for the ray tracer, or a built-in one."""
    if is_ray_scene(source):
        return ray_scene(source, rows, cols, range_m=range_m)
    name, _, values = source.partition(":")
    if name == RETURNS:
        return returns(rows, cols, source, _targets(values, range_m))
    defaults, build = BUILT_IN[name]
    return build(rows, cols, source, *_numbers(name, values, defaults, range_m))


def _is_built_in(source: str) -> bool:
    return source.partition(":")[0] in NAMES and not os.path.exists(source)


def _numbers(
    name: str, text: str, defaults: tuple[tuple[str, float], ...], range_m: float
) -> list[float]:
    """Return the comma-separated numbers after a built-in scene's name, and defaults for the
    rest.
    """
    given = text.split(",") if text else []
    if len(given) > len(defaults):
        form = ",".join(what for what, _ in defaults)
        raise InputError(f"scene {name}:{text}: must be {name}{':' if form else ''}{form}")
    values = []
    for i, (what, default) in enumerate(defaults):
        low, high = (NEAREST_M, range_m) if what in DISTANCES else (0.0, 1.0)
        values.append(_number(name, what, given[i] if i < len(given) else str(default), low, high))
    return values


def _targets(text: str, range_m: float) -> list[tuple[float, float]]:
    """Return (distance in metres, reflectivity) of each surface in `text`; those without one
    share the default evenly.
    """
    parts = [one.partition(AT) for one in text.split(",")]
    shared = str(REFLECTIVITY / len(parts))
    return [
        (
            _number(RETURNS, "METRES", metres, NEAREST_M, range_m),
            _number(RETURNS, "REFLECTIVITY", share if at else shared, 0.0, 1.0),
        )
        for metres, at, share in parts
    ]


def _number(scene: str, what: str, text: str, low: float, high: float) -> float:
    try:
        value: float | str = float(text)
    except ValueError:
        value = text
    return check_real(f"scene {scene}: {what}", value, low, high)
