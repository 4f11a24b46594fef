# SPDX-License-Identifier: Apache-2.0
"""Doubts about a depth file: its numbers seem to mean something else than what is taken, or they
are no distances at all.
"""

import numpy as np

from .conventions import (
    DATA_SETS,
    DISPARITY,
    INDOORS_M,
    KINECT_RAW,
    PER_METRE,
    ROTATED,
    convention,
    stored_unit,
)
from .depth_units import KINECT_BITS, KITTI_FORM, ROTATED_BITS, fits_16_bits, metres

NEAR_M = 0.2  # smallest usual median
# data set -> divisor of its samples, and the lowest share of them that are such multiples: the
# strays of TUM come from its registration, those of SUN RGB-D lie beyond 8.19 m
MULTIPLES = {"tum": (5, 0.99), ROTATED: (1 << ROTATED_BITS, 0.9)}
SWAPPED_SHARE_MIN = 0.99  # of the samples, below `KINECT_BITS` with their bytes swapped
ODD_SHARE_MAX = 0.5  # share of multiples up to which samples are not those of a data set
MANY_VALUES = 50  # so many different numbers are multiples by no accident
# A depth picture is smooth except at edges. Shares of the difference of two samples anywhere:
MANY_SAMPLES = 1000  # needed to tell
NOISE_MIN = 0.5  # from this mean difference of neighbours on, the picture looks like noise
SWAPPED_MIN = 0.1  # from this one on, ...
SMOOTHER_MIN = 3  # ... and with so many times smaller differences with the bytes swapped


def no_picture(samples: np.ndarray, sample_m: np.ndarray) -> str:
    """Return a sentence if samples look like noise, or like samples with swapped bytes; else
    nothing.

    samples: of the file, two-dimensional; sample_m: the same in metres, NaN = no depth.
    """
    seen = sample_m > 0
    roughness = _roughness(sample_m, seen)
    if roughness < SWAPPED_MIN:
        return ""
    if fits_16_bits(samples):
        swapped = samples.astype(np.uint16).byteswap()
        if _roughness(samples, seen) >= SMOOTHER_MIN * _roughness(swapped, seen):
            return (
                "the two bytes of the samples seem to be swapped: the other way round,"
                " neighbours are much more alike; write the file with its bytes in order"
            )
    if roughness < NOISE_MIN:
        return ""
    return (
        "neighbouring samples differ as much as distant ones, as in noise; this may be no depth"
        " picture"
    )


def _roughness(samples: np.ndarray, seen: np.ndarray) -> float:
    """Return the mean difference of neighbours in a row over that of samples half a picture
    apart; 0 where either cannot be told.
    """
    values = np.where(seen, samples, 0).astype(np.float64)
    rows, cols = values.shape
    both = seen[:, 1:] & seen[:, :-1]
    beside = np.abs(values[:, 1:] - values[:, :-1])[both]
    moved = (rows // 2, cols // 2)
    apart_both = seen & np.roll(seen, moved, (0, 1))
    apart = np.abs(values - np.roll(values, moved, (0, 1)))[apart_both]
    if min(len(beside), len(apart)) < MANY_SAMPLES:
        return 0.0
    usual = float(apart.mean())
    return float(beside.mean()) / usual if usual > 0 else 0.0


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
