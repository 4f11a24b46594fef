# SPDX-License-Identifier: Apache-2.0
"""Scenes from depth pictures, resampled to the sensor: still ones, and sequences that move."""

from pathlib import Path

import numpy as np
from attrs import evolve

from ..light.light import NEAREST_M
from ..light.timing import RANGE_M
from ..shared.arguments import given_or_new
from ..shared.errors import InputError
from ..shared.files import FilePath
from ..shared.quantities import check_real, real_array, shape_of
from .conventions import RAY, convention
from .depth_pictures import Pictures, Stored, picture_files, pictures_of
from .depth_units import metres, raw_numbers
from .doubts import fitting_unit, no_picture
from .image_files import COLOUR_FILES, centre_crop, open_picture
from .meaning import Meaning
from .pixel_surface import choose_samples
from .scene import REFLECTIVITY, Scene
from .view import View

DARKEST, BRIGHTEST = 0.05, 0.8  # reflectivities of black and white in a colour picture
WRONG_SHARE_MAX = (
    0.1  # share of a file's samples beyond the range or negative; with more, the unit is wrong
)
VALID_SHARE_MIN = 0.1  # lowest share of the sensor's pixels that must have a depth
NOWHERE_M = 65504.0  # renderers write this and more where there is nothing
# width by height of a picture in a sequence, from which on it may be no picture
HISTOGRAM_SHAPE = 4
ASPECT_TOLERANCE = 0.02  # relative difference between the shapes of a depth and its colour picture
WHITE = {"I;16": 65535, "I;16B": 65535, "I": 65535}  # value of white, by the mode of a grey picture


def depth_scene(
    depth: FilePath | np.ndarray,
    rows: int,
    cols: int,
    *,
    colour: FilePath | None = None,
    reflectivity: float | np.ndarray = REFLECTIVITY,
    meaning: Meaning | None = None,
    range_m: float = RANGE_M,
) -> Scene:
    """Return a scene from a depth file, from a sequence of them, or from an array of distances.
    Raises `InputError`.

    The file is one of `DEPTH_FILES`; numbers of an array are metres. The
    picture is cropped around its centre to the sensor's aspect ratio. `pixel_surface` has the
    rule by which samples stand for a pixel; the reflectivity is that of the very same samples.
    Samples that mean "no depth", are negative, or at or beyond `range_m`, are left out, and noted.
    In a sequence (`depth_pictures`), the scene of each frame is that of its picture.

    colour: a picture of the same view; its luminance (linear light) maps to `DARKEST` to
    `BRIGHTEST`. Of a sequence, it may be a sequence, too. reflectivity: a number, or an array of
    the shape of a picture or of all.
    """
    meaning = given_or_new("meaning", meaning, Meaning)
    of_shares = shape_of("reflectivity", reflectivity)
    if not of_shares:
        reflectivity = check_real("reflectivity", reflectivity, 0, 1)
    pictures = pictures_of(depth, meaning)
    if not pictures.moves and of_shares[2:] == (1,):
        reflectivity = np.asanyarray(reflectivity)[:, :, 0]  # as distances may have it
    shares: list[float | np.ndarray] = [reflectivity] * pictures.count
    if isinstance(reflectivity, np.ndarray) and reflectivity.ndim == 3:
        shares = list(reflectivity)
        if len(shares) != pictures.count:
            raise InputError(
                f"reflectivity: has {len(shares)} pictures, must have {pictures.count}"
            )
    colours = _colours_of(colour, pictures)
    scenes: list[Scene] = []
    shape = None
    for number in range(pictures.count):
        stored = pictures.read(number)
        shape = shape or stored.numbers.shape
        if stored.numbers.shape != shape:
            raise InputError(
                f"{stored.path}: has {_size(stored.numbers.shape)} samples, must have {_size(shape)}"
                " as the first picture of the sequence"
            )
        scenes.append(
            _picture_scene(
                stored,
                rows,
                cols,
                colour=colours[number],
                reflectivity=shares[number],
                meaning=meaning,
                range_m=range_m,
            )
        )
    first, *later = scenes
    if not pictures.moves:
        return first
    each = f"{pictures.name}: {pictures.count} pictures, one for each frame; notes are of the first"
    if shape is not None and shape[1] > HISTOGRAM_SHAPE * shape[0]:
        each += "; histograms, rows x cols x bins, need the width of their bins (--bin-ps)"
    return evolve(first, name=pictures.name, later=tuple(later), notes=(each, *first.notes))


def _colours_of(colour: FilePath | None, pictures: Pictures) -> list[FilePath | None]:
    """Return the colour picture of each depth picture. Raises `InputError`."""
    files = None if colour is None else picture_files(str(colour), COLOUR_FILES)
    if files is None:
        return [colour] * pictures.count
    if len(files) != pictures.count:
        raise InputError(
            f"{colour}: has {len(files)} pictures, must have one or as many as {pictures.name}:"
            f" {pictures.count}"
        )
    return list(files)


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))


def _picture_scene(
    stored: Stored,
    rows: int,
    cols: int,
    *,
    colour: FilePath | None,
    reflectivity: float | np.ndarray,
    meaning: Meaning,
    range_m: float,
) -> Scene:
    """Return the scene of a single depth picture."""
    path = stored.path
    notes = list(stored.notes)
    sample_m, better = _samples_in_metres(stored, meaning, range_m, notes)
    doubts = _doubts(stored, sample_m, better)
    height, width = sample_m.shape
    top, left, crop_height, crop_width = centre_crop(height, width, rows, cols)
    crop = slice(top, top + crop_height), slice(left, left + crop_width)
    sample_m = sample_m[crop]
    if meaning.scale != 1:
        notes.append(f"{path}: distances times {meaning.scale:g}")
    if (crop_height, crop_width) != (height, width):
        notes.append(
            f"{path}: cropped to the middle {crop_height} x {crop_width} of {height} x {width} samples"
        )
    sample_m, masked = _usable(path, sample_m, range_m, better)
    notes += masked

    view = View()
    if meaning.fov_deg is not None:
        view = View.of_part(meaning.fov_deg, (height, width), (crop_height, crop_width))
    chosen = choose_samples(sample_m, rows, cols)
    distance_m = np.where(chosen.hole, np.nan, chosen.middle(sample_m))
    if meaning.z:
        distance_m *= view.ray_per_z(rows, cols)
        distance_m[distance_m >= range_m] = np.nan
    elif stored.is_file:
        notes += _ray_note(path, meaning.unit, view)
    notes += _check_valid(path, distance_m)
    if colour is not None:
        albedo = _at_samples(colour, _read_reflectivity(colour), (height, width))
    elif np.ndim(reflectivity):
        told = _told_where_seen(reflectivity, stored.hidden)
        albedo = real_array("reflectivity", told, (height, width), 0, 1)
    else:
        notes.append(
            f"{path}: reflectivity {reflectivity:g} everywhere, because no colour picture is given"
        )
        albedo = np.full((height, width), float(reflectivity))
    return Scene(
        name=Path(path).name,
        distance_m=distance_m,
        reflectivity=chosen.middle(albedo[crop]),
        view=view,
        doubts=doubts,
        notes=tuple(notes),
    )


def _told_where_seen(
    reflectivity: float | np.ndarray, hidden: np.ndarray | bool
) -> float | np.ndarray:
    """Return reflectivities without the mask of those whose samples have no depth, which nothing
    reads. hidden: bool of a picture, by the mask of its distances.
    """
    if not isinstance(reflectivity, np.ma.MaskedArray) or reflectivity.shape != np.shape(hidden):
        return reflectivity
    told = np.where(np.ma.getmaskarray(reflectivity), np.nan, np.ma.getdata(reflectivity))
    return np.where(hidden, 0.0, told)


def _doubts(stored: Stored, sample_m: np.ndarray, better: str) -> tuple[str, ...]:
    """Return sentences about samples that may not be what they are taken for. better: which unit
    fits better, or nothing.
    """
    told = better or no_picture(stored.numbers, sample_m)
    return (f"{stored.path}: {told}",) if told else ()


def _samples_in_metres(
    stored: Stored, meaning: Meaning, range_m: float, notes: list[str]
) -> tuple[np.ndarray, str]:
    """Return the samples of a depth picture in metres times the scale, and a sentence.

    The samples are NaN where they mean "no depth", or lie in the sky. The sentence says which
    other unit fits better, or is empty. What was taken for no depth is added to `notes`.
    """
    path = stored.path
    samples = stored.numbers
    unit = stored.unit if meaning.unit is None else meaning.unit
    sample_m = metres(path, samples, unit)
    marks = np.concatenate([meaning.marks, stored.missing])
    marked = _marked(raw_numbers(path, samples, unit), marks)
    if marked.any():
        notes.append(
            f"{path}: {marked.sum()} samples are {_listed(samples[marked])}, which is taken for no depth"
        )
    sky_m = NOWHERE_M if meaning.sky_m is None else min(meaning.sky_m, NOWHERE_M)
    no_depth = stored.hidden | marked | ~(np.abs(sample_m) < NOWHERE_M) | (sample_m >= sky_m)
    sample_m[no_depth] = np.nan
    sample_m *= meaning.scale
    seen = sample_m > 0
    better = ""
    if seen.any() and meaning.scale == 1:
        middle_m = float(np.median(sample_m[seen]))
        named = meaning.unit is not None
        better = fitting_unit(samples[seen], unit, named, middle_m, range_m)
    return sample_m, better


def _check_valid(path: str, distance_m: np.ndarray) -> list[str]:
    """Return a note if some pixels have no depth. Raises `InputError` if too many have none."""
    valid_share = np.mean(~np.isnan(distance_m))
    if valid_share < VALID_SHARE_MIN:
        raise InputError(
            f"{path}: {valid_share:.1%} of the sensor's pixels have a usable depth, must be at least {VALID_SHARE_MIN:.0%}"
        )
    if valid_share == 1:
        return []
    holes = np.isnan(distance_m).sum()
    return [f"{path}: {holes} of {distance_m.size} pixels without depth are masked"]


def _marked(numbers: np.ndarray, marks: np.ndarray) -> np.ndarray:
    """Return which numbers of a file mean "no depth". bool of the shape of `numbers`.

    The limits of a type of integers do so, as well.
    """
    if numbers.dtype.kind == "f":
        with np.errstate(over="ignore"):  # half floats hold no larger number
            return np.isin(numbers, marks.astype(numbers.dtype))
    limits = np.iinfo(numbers.dtype)
    ends = [end for end in (limits.min, limits.max) if end != 0]
    return np.isin(numbers, marks) | np.isin(numbers, ends)


def _listed(values: np.ndarray) -> str:
    return " or ".join(f"{value:.10g}" for value in np.unique(values).tolist())


def _ray_note(path: str, unit: str | None, view: View) -> list[str]:
    """Return what was assumed about the distances, if no convention says it."""
    known = convention(unit)
    if known is not None and known.along == RAY:
        return []
    corner = view.ray_per_z(64, 64)[0, 0] - 1
    return [
        f"{path}: distances are taken along the rays; if they are along the axis (z), as depth cameras and most "
        f"renderers write them, --z makes the corners {corner:.0%} farther"
    ]


def _usable(
    depth: object, sample_m: np.ndarray, range_m: float, better: str
) -> tuple[np.ndarray, list[str]]:
    """Return `sample_m` with NaN for unusable samples, and notes about them. better: what to say
    about the unit.

    If all samples that are negative or beyond the range have the same value, they mean that
    there is nothing.
    """
    missing = np.isnan(sample_m) | (sample_m == 0)
    negative = sample_m < 0
    far = sample_m >= range_m
    near = (sample_m > 0) & (sample_m < NEAREST_M)
    usable = ~(missing | negative | far | near)
    notes = []
    if missing.all():
        raise InputError(
            f"{depth}: every sample is 0 or NaN, must hold distances above 0 and below {range_m:.4g} m"
        )
    for what, bad, may_mark in (
        ("negative", negative, True),
        (f"at or beyond the laser period's range of {range_m:.4g} m", far, True),
        (f"below {NEAREST_M:g} m", near, False),
    ):
        values = np.unique(sample_m[bad])
        if may_mark and len(values) == 1 and usable.mean() >= VALID_SHARE_MIN:
            notes.append(
                f"{depth}: {bad.sum()} samples {what} left out (all {values[0]:.6g} m, taken for no depth)"
            )
            continue
        share = bad.sum() / (~missing).sum()
        if share > WRONG_SHARE_MAX:
            worst = float(sample_m[bad].flat[0])
            guess = better or "floats are metres, integers millimetres, unless a unit is given"
            raise InputError(
                f"{depth}: {share:.0%} of the samples are {what} (such as {worst:.6g} m), must be above 0 and below "
                f"{range_m:.4g} m; {guess}; --missing VALUE or --sky DISTANCE leaves out what is no surface"
            )
        if bad.any():
            notes.append(f"{depth}: {bad.sum()} samples {what} left out")
    if missing.any():
        notes.append(f"{depth}: {missing.sum()} of {missing.size} samples hold no depth")
    return np.where(usable, sample_m, np.nan), notes


def _at_samples(colour: FilePath, albedo: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """float64 of `shape`: what a picture of the same view shows at the samples of a depth
    picture. Raises `InputError`.
    """
    (height, width), (other_height, other_width) = shape, albedo.shape
    aspect = width / height
    if abs(other_width / other_height / aspect - 1) > ASPECT_TOLERANCE:
        raise InputError(
            f"{colour}: has {other_height} x {other_width} samples, must have the shape of the depth's {height} x {width}, "
            "or a multiple; crop one of them to the view of the other"
        )
    row = (2 * np.arange(height) + 1) * other_height // (2 * height)
    col = (2 * np.arange(width) + 1) * other_width // (2 * width)
    return albedo[row[:, None], col]


def _read_reflectivity(path: FilePath) -> np.ndarray:
    """float64[height, width]: linear luminance (sRGB primaries) between `DARKEST` and `BRIGHTEST`.

    Integers are sRGB, and the largest of their type is white. Floats are linear light from 0 to 1.
    """
    with open_picture(path) as picture:
        if picture.mode == "F":
            return DARKEST + (BRIGHTEST - DARKEST) * real_array(
                f"{path}: light", np.asarray(picture), picture.size[::-1], 0, 1
            )
        if picture.mode in WHITE:
            grey = np.asarray(picture, np.float64) / WHITE[picture.mode]
            srgb = np.repeat(grey[:, :, None], 3, axis=2)
        else:
            srgb = np.asarray(picture.convert("RGB"), np.float64) / 255
    # IEC 61966-2-1
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return DARKEST + (BRIGHTEST - DARKEST) * (linear @ [0.2126, 0.7152, 0.0722])
