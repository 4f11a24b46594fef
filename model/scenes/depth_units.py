# SPDX-License-Identifier: Apache-2.0
"""From the numbers of a depth file to metres."""

from pathlib import Path

import numpy as np

from ..shared.errors import InputError
from ..shared.files import FilePath
from .conventions import DISPARITY, KINECT_RAW, PER_METRE, ROTATED, check_unit, stored_unit

ROTATED_BITS = 3  # SUN RGB-D: the bits of millimetres, rotated to the left
KINECT_BITS = 11
KINECT_NUMERATOR, KINECT_END = 351.3, 1092.5  # NYU's toolbox: metres = 351.3 / (1092.5 - number)
KITTI_FORM = f"{DISPARITY}/256"


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
    with np.errstate(invalid="ignore"):  # a signaling NaN is no depth, either
        values = samples.astype(np.float64)
    if stored.startswith(DISPARITY):
        return _from_disparities(path, values, unit)
    return values / (PER_METRE[stored] if stored in PER_METRE else int(stored.removeprefix("1/")))


def raw_numbers(path: FilePath, samples: np.ndarray, unit: str) -> np.ndarray:
    """Return the numbers with which a convention tells "no depth": those of the file, or the
    Kinect's own.
    """
    return _bits16(path, samples, unit).byteswap() if stored_unit(unit) == KINECT_RAW else samples


def fits_16_bits(samples: np.ndarray) -> bool:
    """Return whether samples are integers of 16 bits, whatever type holds them."""
    return bool(samples.dtype.kind in "iu" and samples.min() >= 0 and samples.max() <= 0xFFFF)


def _bits16(path: FilePath, samples: np.ndarray, unit: str) -> np.ndarray:
    """uint16: samples of 16 bits, whatever type holds them. Raises `InputError`."""
    if not fits_16_bits(samples):
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
            for line in beside.read_text(encoding="utf-8-sig").splitlines()
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
