# SPDX-License-Identifier: Apache-2.0
"""Scenes from depth files, resampled to the sensor. The rules of the resampling are our choice."""

from pathlib import Path

import numpy as np

from ..light.light import NEAREST_M
from ..light.timing import RANGE_M
from ..shared.errors import InputError
from ..shared.files import FilePath
from ..shared.quantities import check_real, real_array
from .depth_units import check_unit, fitting_unit, metres
from .image_files import (
    centre_crop,
    check_picture_array,
    covered_samples,
    open_picture,
    read_array,
    read_exr,
    read_pfm,
)
from .scene import REFLECTIVITY, Scene

DARKEST, BRIGHTEST = 0.05, 0.8  # reflectivities of black and white in a colour picture
WRONG_SHARE_MAX = (
    0.1  # share of a file's samples beyond the range or negative; with more, the unit is wrong
)
VALID_SHARE_MIN = 0.1  # lowest share of the sensor's pixels that must have a depth
NOWHERE_M = 65504.0  # the largest half float: what renderers write where there is nothing
READERS = {".npy": read_array, ".pfm": read_pfm, ".exr": read_exr}
SUFFIXES = (".png", ".tif", ".tiff", *READERS)
ARRAY = "array"  # name of distances that are no file
SCALES = 1e-3, 1e3


def depth_scene(
    depth: FilePath | np.ndarray,
    rows: int,
    cols: int,
    *,
    colour: FilePath | None = None,
    reflectivity: float | np.ndarray = REFLECTIVITY,
    scale: float = 1.0,
    unit: str | None = None,
    range_m: float = RANGE_M,
) -> Scene:
    """Return a scene from a depth file, or from an array of distances. Raises `InputError`.

    The file is a picture of 16 bits or floats (PNG, TIFF), NPY, PFM or OpenEXR; without `unit`
    (see `depth_units`), floats are metres and integers of a file millimetres, and numbers of an
    array are metres. The picture is cropped around its centre to the sensor's aspect ratio. A
    pixel of the sensor takes the nearest of the samples that it covers, with the
    reflectivity at that very sample: nothing is averaged across an edge. Samples that are 0,
    infinite, NaN or negative, or at or beyond `range_m`, are left out, and noted.

    scale: factor for all distances, applied first. colour: a picture of the same view; its
    luminance (linear light) maps to `DARKEST` to `BRIGHTEST`.
    """
    if not np.ndim(reflectivity):
        reflectivity = check_real("reflectivity", reflectivity, 0, 1)
    if isinstance(depth, np.ndarray):
        path, usual, samples = ARRAY, "m", check_picture_array("scene", depth)
    else:
        path, samples = str(depth), _read_depth(depth)
        usual = "m" if samples.dtype.kind == "f" else "mm"
    unit = usual if unit is None else check_unit(unit)
    sample_m = metres(path, samples, unit) * check_real("scale", scale, *SCALES)
    sample_m[~(np.abs(sample_m) < NOWHERE_M)] = np.nan
    seen_m = sample_m[sample_m > 0]
    better = (
        fitting_unit(samples, unit, float(np.median(seen_m)), range_m)
        if len(seen_m) and scale == 1
        else ""
    )
    height, width = sample_m.shape
    top, left, crop_height, crop_width = centre_crop(height, width, rows, cols)
    sample_m = sample_m[top : top + crop_height, left : left + crop_width]
    notes = [f"{path}: distances times {scale:g}"] if scale != 1 else []
    if (crop_height, crop_width) != (height, width):
        notes.append(
            f"{path}: cropped to the middle {crop_height} x {crop_width} of {height} x {width} samples"
        )
    sample_m, masked = _usable(path, sample_m, range_m, better)
    notes += [*masked, *([f"{path}: {better}"] if better else [])]
    row, col = _nearest_surface(sample_m, rows, cols)
    distance_m = sample_m[row, col]
    valid_share = np.mean(~np.isnan(distance_m))
    if valid_share < VALID_SHARE_MIN:
        raise InputError(
            f"{path}: {valid_share:.1%} of the sensor's pixels have a usable depth, must be at least {VALID_SHARE_MIN:.0%}"
        )
    if valid_share < 1:
        notes.append(
            f"{path}: {np.isnan(distance_m).sum()} of {rows * cols} pixels without depth are masked"
        )
    if colour is None and not isinstance(reflectivity, np.ndarray):
        notes.append(
            f"{path}: reflectivity {reflectivity:g} everywhere, because no colour picture is given"
        )
        surface = np.full((rows, cols), float(reflectivity))
    else:
        given = real_array("reflectivity", reflectivity, (height, width), 0, 1)
        albedo = given if colour is None else _read_reflectivity(colour)
        surface = albedo[
            (2 * (top + row) + 1) * albedo.shape[0] // (2 * height),
            (2 * (left + col) + 1) * albedo.shape[1] // (2 * width),
        ]
    return Scene(
        name=Path(path).name, distance_m=distance_m, reflectivity=surface, notes=tuple(notes)
    )


def _usable(
    depth: object, sample_m: np.ndarray, range_m: float, better: str
) -> tuple[np.ndarray, list[str]]:
    """Return `sample_m` with NaN for unusable samples, and notes about them. better: what to say
    about the unit.
    """
    missing = np.isnan(sample_m) | (sample_m == 0)
    negative = sample_m < 0
    far = sample_m >= range_m
    near = (sample_m > 0) & (sample_m < NEAREST_M)
    notes = []
    if missing.all():
        raise InputError(
            f"{depth}: every sample is 0 or NaN, must hold distances above 0 and below {range_m:.4g} m"
        )
    for what, bad in (
        ("negative", negative),
        (f"at or beyond the laser period's range of {range_m:.4g} m", far),
        (f"below {NEAREST_M:g} m", near),
    ):
        share = bad.sum() / (~missing).sum()
        if share > WRONG_SHARE_MAX:
            worst = float(sample_m[bad].flat[0])
            raise InputError(
                f"{depth}: {share:.0%} of the samples are {what} (such as {worst:.6g} m), must be above 0 and below "
                f"{range_m:.4g} m; {better or 'floats are metres, integers millimetres, unless a unit is given'}"
            )
        if bad.any():
            notes.append(f"{depth}: {bad.sum()} samples {what} left out")
    if missing.any():
        notes.append(f"{depth}: {missing.sum()} of {missing.size} samples hold no depth (0 or NaN)")
    return np.where(missing | negative | far | near, np.nan, sample_m), notes


def _nearest_surface(sample_m: np.ndarray, rows: int, cols: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (row, col) of the nearest sample that each pixel of the sensor covers; int64[rows,
    cols] each.

    A picture with fewer samples than the sensor has pixels is repeated. NaN counts as the farthest.
    """
    height, width = sample_m.shape
    row, col, cell = covered_samples(height, width, rows, cols)
    far_first = np.argsort(-sample_m[row, col].ravel(), kind="stable")
    far_first = np.roll(
        far_first, np.isnan(sample_m[row, col]).sum()
    )  # NaN sorts last, must be written first
    chosen = np.empty(rows * cols, np.int64)
    chosen[cell.ravel()[far_first]] = far_first  # of several writes the last one wins: the nearest
    at_row, at_col = np.divmod(chosen, len(col))
    return row[at_row, 0].reshape(rows, cols), col[at_col].reshape(rows, cols)


def _read_depth(path: FilePath) -> np.ndarray:
    """Number[height, width]: the samples of a depth file. Raises `InputError`."""
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES and not _is_picture(path):
        raise InputError(
            f"{path}: is no scene, must be a depth file ({', '.join(SUFFIXES)}), or a Mitsuba scene (.xml)"
        )
    return check_picture_array(path, READERS.get(suffix, _read_grey)(path))


def _is_picture(path: FilePath) -> bool:
    """Return whether some format of pictures fits the content."""
    try:
        open_picture(path)
        return True
    except InputError:
        return False


def _read_grey(path: FilePath) -> np.ndarray:
    """Return the samples of a picture; colour and 8 bits are refused, because they cannot be
    depth in millimetres.
    """
    with open_picture(path) as picture:
        if picture.mode != "F" and not picture.mode.startswith("I"):
            raise InputError(
                f"{path}: is a picture of mode {picture.mode} (colour or 8 bit), "
                "must be depth: one channel of 16 bits or floats"
            )
        return np.array(picture)


def _read_reflectivity(path: FilePath) -> np.ndarray:
    """float64[height, width]: linear luminance (sRGB primaries) between `DARKEST` and
    `BRIGHTEST`.
    """
    with open_picture(path) as picture:
        srgb = np.asarray(picture.convert("RGB"), np.float64) / 255
    linear = np.where(
        srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4
    )  # IEC 61966-2-1
    return DARKEST + (BRIGHTEST - DARKEST) * (linear @ [0.2126, 0.7152, 0.0722])
