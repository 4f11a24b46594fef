# SPDX-License-Identifier: Apache-2.0
"""Units of depth files: from samples to metres, and which unit would fit if the one that is
assumed does not.

A unit is `m`, `cm`, `mm`, `1/N` (of a metre), `disparity:FOCAL_PX,BASELINE_M[,OFFSET_PX]`, or
the name of a data set.
"""

import re
from pathlib import Path

import numpy as np

from ..shared.errors import InputError
from ..shared.files import FilePath

PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
ROTATED, DISPARITY = "sun-rgbd", "disparity"
ROTATED_BITS = 3  # SUN RGB-D: the bits of millimetres, rotated to the left
DATA_SETS = {  # name: (unit, what it is)
    "tum": ("1/5000", "TUM RGB-D, ICL-NUIM: PNG in 1/5000 m"),
    "kitti": ("1/256", "KITTI: PNG in 1/256 m"),
    "nyu": ("mm", "NYU, ScanNet, Kinect: PNG in millimetres"),
    ROTATED: (ROTATED, "SUN RGB-D: PNG in 1/8000 m with rotated bits"),
    "middlebury": (
        DISPARITY,
        "Middlebury: PFM of disparities, with the data set's calib.txt beside it",
    ),
}
_METRIC = ", ".join(PER_METRE)
_DISPARITIES = f"{DISPARITY}:FOCAL_PX,BASELINE_M (optionally also ,OFFSET_PX)"
UNIT_FORMS = f"{_METRIC}, 1/N (of a metre), {_DISPARITIES}, {', '.join(DATA_SETS)}"
NEAR_M, FAR_M = (
    0.2,
    8.0,
)  # usual medians: at least NEAR_M, and at most FAR_M in files of integers, as depth cameras write
MULTIPLES = {
    5: "tum",
    1 << ROTATED_BITS: ROTATED,
}  # divisor of all samples -> the data set that writes such samples


def check_unit(unit: str) -> str:
    """Return `unit` if it is one. Raises `InputError`."""
    known = (
        unit in PER_METRE
        or unit in DATA_SETS
        or unit == DISPARITY
        or unit.startswith(f"{DISPARITY}:")
    )
    if not known and not re.fullmatch(r"1/[1-9]\d{0,6}", unit):
        raise InputError(f"unit = {unit!r}: must be one of {UNIT_FORMS}")
    return unit


def metres(path: FilePath, samples: np.ndarray, unit: str) -> np.ndarray:
    """float64: samples in metres; NaN = no depth. path: of the file, for messages and calib.txt.
    Raises `InputError`.
    """
    unit = DATA_SETS[check_unit(unit)][0] if unit in DATA_SETS else check_unit(unit)
    if unit == ROTATED:
        if samples.dtype != np.uint16:
            raise InputError(
                f"{path}: holds {samples.dtype}, must hold 16-bit integers for the unit {ROTATED}"
            )
        samples = samples >> ROTATED_BITS | samples << (16 - ROTATED_BITS)
        unit = "mm"
    values = samples.astype(np.float64)
    if unit.startswith(DISPARITY):
        focal_px, baseline_m, offset_px = _stereo(path, unit)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance_m = focal_px * baseline_m / (values + offset_px)
        return np.where(np.isfinite(values) & (values > 0), distance_m, np.nan)
    return values / (PER_METRE[unit] if unit in PER_METRE else int(unit.removeprefix("1/")))


def _stereo(path: FilePath, unit: str) -> tuple[float, float, float]:
    """Return (focal length in pixels, baseline in metres, offset of the disparities in pixels)."""
    _, _, given = unit.partition(":")
    if given:
        try:
            focal_px, baseline_m, *offset_px = map(float, given.split(","))
            return focal_px, baseline_m, sum(offset_px)
        except ValueError:
            raise InputError(
                f"unit = {unit!r}: must be {DISPARITY}:FOCAL_PX,BASELINE_M[,OFFSET_PX]"
            ) from None
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
        wanted = f"{DISPARITY}:FOCAL_PX,BASELINE_M or a calib.txt beside the file, with cam0 and baseline"
        raise InputError(f"{path}: is read as disparities, which needs {wanted}") from None


def fitting_unit(samples: np.ndarray, unit: str, median_m: float, range_m: float) -> str:
    """Return a sentence with the unit that would fit better, if the median distance is unusual;
    else nothing.

    samples: of the file; unit: the one that was assumed or given.
    """
    whole = samples.dtype.kind in "iu"
    if unit not in PER_METRE or NEAR_M <= median_m <= (FAR_M if whole else range_m):
        return ""
    stored = median_m * PER_METRE[unit]
    seen = samples[samples > 0] if whole else samples[:0]
    found = int(np.gcd.reduce(seen)) if len(seen) else 0
    if (
        likely := next(
            (name for step, name in MULTIPLES.items() if found and found % step == 0), None
        )
    ) is not None:
        fits_m = float(np.median(metres("", seen, likely)))
        why = f"the median distance is {median_m:.3g} m, and the samples look like {DATA_SETS[likely][1]}"
        return f"{why}; with the unit {likely} it is {fits_m:.3g} m"
    for other, per_metre in PER_METRE.items():
        if NEAR_M <= stored / per_metre <= FAR_M and other != unit:
            return f"the median distance is {median_m:.3g} m; with the unit {other} it is {stored / per_metre:.3g} m"
    return ""
