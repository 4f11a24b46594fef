# SPDX-License-Identifier: Apache-2.0
"""From the numbers of a depth file to metres, and which unit would fit if the one that is taken
does not.
"""

from pathlib import Path

import numpy as np

from ..shared.errors import InputError
from ..shared.files import FilePath
from .conventions import (
    DATA_SETS,
    DISPARITY,
    INDOORS_M,
    KINECT_RAW,
    PER_METRE,
    ROTATED,
    check_unit,
    convention,
    stored_unit,
)

ROTATED_BITS = 3  # SUN RGB-D: the bits of millimetres, rotated to the left
KINECT_BITS = 11
KINECT_NUMERATOR, KINECT_END = 351.3, 1092.5  # NYU's toolbox: metres = 351.3 / (1092.5 - number)
KITTI_FORM = f"{DISPARITY}/256"
NEAR_M = 0.2  # smallest usual median
# data set -> divisor of its samples, and the lowest share of them that are such multiples: the
# strays of TUM come from its registration, those of SUN RGB-D lie beyond 8.19 m
MULTIPLES = {"tum": (5, 0.99), ROTATED: (1 << ROTATED_BITS, 0.9)}
SWAPPED_SHARE_MIN = 0.99  # of the samples, below `KINECT_BITS` with their bytes swapped
ODD_SHARE_MAX = 0.5  # share of multiples up to which samples are not those of a data set
MANY_VALUES = 50  # so many different numbers are multiples by no accident


def metres(path: FilePath, samples: np.ndarray, unit: str) -> np.ndarray:
    """float64: samples in metres; NaN = no depth. path: of the file, for messages and calib.txt.
    Raises `InputError`.
    """
    stored = stored_unit(check_unit(unit))
    if stored == ROTATED:
        bits = _bits16(path, samples, unit)
        return (bits >> ROTATED_BITS | bits << (16 - ROTATED_BITS)) / 1000
    if stored == KINECT_RAW:
        raw = _bits16(path, samples, unit).byteswap().astype(np.float64)
        return np.where(
            raw < KINECT_END,
            KINECT_NUMERATOR / (KINECT_END - np.minimum(raw, KINECT_END - 1)),
            np.nan,
        )
    values = samples.astype(np.float64)
    if stored.startswith(DISPARITY):
        return _from_disparities(path, values, unit)
    return values / (PER_METRE[stored] if stored in PER_METRE else int(stored.removeprefix("1/")))


def raw_numbers(path: FilePath, samples: np.ndarray, unit: str) -> np.ndarray:
    """Return the numbers with which a convention tells "no depth": those of the file, or the
    Kinect's own.
    """
    return _bits16(path, samples, unit).byteswap() if stored_unit(unit) == KINECT_RAW else samples


def _bits16(path: FilePath, samples: np.ndarray, unit: str) -> np.ndarray:
    """uint16: samples of 16 bits, whatever type holds them. Raises `InputError`."""
    if samples.dtype.kind not in "iu" or samples.min() < 0 or samples.max() > 0xFFFF:
        raise InputError(
            f"{path}: holds {samples.dtype}, must hold 16-bit integers for the unit {unit}"
        )
    return samples.astype(np.uint16)


def _from_disparities(path: FilePath, values: np.ndarray, unit: str) -> np.ndarray:
    """float64: metres from disparities, of which some units store N numbers per pixel."""
    focal_px, baseline_m, offset_px = _stereo(path, unit)
    _, _, per_pixel = stored_unit(unit).partition("/")
    disparity_px = values / int(per_pixel or 1) + offset_px
    with np.errstate(divide="ignore", invalid="ignore"):
        distance_m = focal_px * baseline_m / disparity_px
    return np.where(np.isfinite(values) & (values > 0), distance_m, np.nan)


def _stereo(path: FilePath, unit: str) -> tuple[float, float, float]:
    """Return (focal length in pixels, baseline in metres, offset of the disparities in pixels)."""
    name, _, given = unit.partition(":")
    if given:
        try:
            numbers = [float(number) for number in given.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) not in (2, 3) or not np.isfinite(numbers).all() or min(numbers[:2]) <= 0:
            raise InputError(
                f"unit = {unit!r}: must be {name}:FOCAL_PX,BASELINE_M[,OFFSET_PX]: a focal length and a baseline above "
                f"0, three numbers at most; {DISPARITY}/N if the file has N numbers per pixel (KITTI: {KITTI_FORM})"
            )
        return numbers[0], numbers[1], sum(numbers[2:])
    beside = Path(path).with_name("calib.txt")
    try:
        lines = dict(
            line.split("=", 1)
            for line in beside.read_text(encoding="utf-8").splitlines()
            if "=" in line
        )
        return (
            float(lines["cam0"].strip("[] ").split()[0]),
            float(lines["baseline"]) / 1000,
            float(lines.get("doffs", 0)),
        )
    except (OSError, KeyError, ValueError, IndexError):
        wanted = f"{stored_unit(unit)}:FOCAL_PX,BASELINE_M or a calib.txt beside the file, with cam0 and baseline"
        raise InputError(f"{path}: is read as disparities, which needs {wanted}") from None


def fitting_unit(
    samples: np.ndarray, unit: str, given: bool, median_m: float, range_m: float
) -> str:
    """Return a sentence with the unit that would fit better, if the median distance is unusual,
    or the samples are those of another data set; else nothing.

    samples: of the file; unit: the one that was assumed or given.
    """
    whole = samples.dtype.kind in "iu"
    known = convention(unit)
    if known is not None:
        far_m = known.far_m
    else:
        far_m = INDOORS_M if whole and not given else range_m
    stored = stored_unit(unit)
    seen = samples[samples > 0] if whole else samples[:0]
    if NEAR_M <= median_m <= far_m:
        likely = _likely(seen, MANY_VALUES)
        if not likely or DATA_SETS[likely].stored == stored:
            return _unlike(seen, stored)
        fits_m = float(np.median(metres("", seen, likely)))
        if not NEAR_M <= fits_m <= INDOORS_M:
            return ""
        looks = f"the samples look like {DATA_SETS[likely].files} ({DATA_SETS[likely].told})"
        return (
            f"{looks}; with the unit {likely} the median distance is {fits_m:.3g} m, not"
            f" {median_m:.3g} m"
        )
    unusual = f"the median distance is {median_m:.3g} m"
    if stored == DISPARITY:
        _, _, numbers = unit.partition(":")
        there = f"{KITTI_FORM}:{numbers}" if numbers else "kitti-disparity"
        return (
            f"{unusual}; with the unit {there} it is {median_m * 256:.3g} m"
            if median_m < NEAR_M
            else ""
        )
    likely = _likely(seen, 1)
    fits_m = float(np.median(metres("", seen, likely))) if likely else 0.0
    if likely and DATA_SETS[likely].stored != stored and NEAR_M <= fits_m <= range_m:
        looks = f"the samples look like {DATA_SETS[likely].files} ({DATA_SETS[likely].told})"
        return f"{unusual}, and {looks}; with the unit {likely} it is {fits_m:.3g} m"
    if stored.startswith(DISPARITY) or stored in (ROTATED, KINECT_RAW):
        return _unlike(seen, stored)
    number = median_m * (
        PER_METRE[stored] if stored in PER_METRE else int(stored.removeprefix("1/"))
    )
    for other, per_metre in PER_METRE.items():
        if NEAR_M <= number / per_metre <= INDOORS_M and other != stored:
            return f"{unusual}; with the unit {other} it is {number / per_metre:.3g} m"
    return ""


def _unlike(seen: np.ndarray, stored: str) -> str:
    """Return a sentence if samples are no such multiples as the data set of their unit has, and
    would be usual as millimetres; else nothing.
    """
    for name, (divisor, _) in MULTIPLES.items():
        if DATA_SETS[name].stored != stored or len(np.unique(seen)) < MANY_VALUES:
            continue
        share = np.mean(seen % divisor == 0)
        as_millimetres_m = float(np.median(seen)) / PER_METRE["mm"]
        if share < ODD_SHARE_MAX and NEAR_M <= as_millimetres_m <= INDOORS_M:
            return (
                f"only {share:.0%} of the samples are multiples of {divisor}, as {name} writes them;"
                f" with the unit mm the median distance is {as_millimetres_m:.3g} m"
            )
    return ""


def _likely(seen: np.ndarray, values_min: int) -> str:
    """Return the data set that writes such integers, or nothing.

    values_min: so many different ones there must be.
    """
    if not len(seen) or seen.max() > 0xFFFF:
        return ""
    values = len(np.unique(seen))
    if values < values_min:
        return ""
    swapped = seen.astype(np.uint16).byteswap()
    if values > 1 and np.mean(swapped < 1 << KINECT_BITS) >= SWAPPED_SHARE_MIN:
        return KINECT_RAW
    for name, (divisor, share_min) in MULTIPLES.items():
        if np.mean(seen % divisor == 0) >= share_min:
            return name
    return ""
