# SPDX-License-Identifier: Apache-2.0
"""Quality of a depth picture: the share of wrong pixels, and the error of the others.

Ref: paper IV, Fig. 7, for the tolerance.
"""

import numpy as np

from ..shared.constants import SPEED_OF_LIGHT_M_S, SUCCESS_TOLERANCE_S

OTHER_SURFACE_M = 0.15  # an error above this means another surface, or background
TOLERANCE_M = SUCCESS_TOLERANCE_S * SPEED_OF_LIGHT_M_S / 2


def wrong_pixels(
    depth_m: np.ndarray, truth_m: np.ndarray, tolerance_m: float = TOLERANCE_M
) -> np.ndarray:
    """bool[rows, cols]: the depth is missing, or |depth - truth| is above `tolerance_m`.

    depth_m, truth_m: float64[rows, cols]; a pixel without truth (NaN) is not wrong. tolerance_m:
    default is `SUCCESS_TOLERANCE_S`, one way.
    """
    return ~np.isnan(truth_m) & ~(np.abs(depth_m - truth_m) <= tolerance_m)


def wrong_share(
    depth_m: np.ndarray, truth_m: np.ndarray, tolerance_m: float = TOLERANCE_M
) -> float:
    """Return the share of wrong pixels among those with a truth."""
    return float(
        wrong_pixels(depth_m, truth_m, tolerance_m).sum() / max(1, np.sum(~np.isnan(truth_m)))
    )


def off_surfaces(depth_m: np.ndarray, surfaces_m: np.ndarray) -> np.ndarray:
    """bool[...]: the depth is missing, or beyond the paper's tolerance of every surface that the
    pixel sees.

    depth_m: float64[...]. surfaces_m: float64[..., surfaces], NaN = none; a pixel without any is
    not off.
    """
    near = np.abs(depth_m[..., None] - surfaces_m) <= TOLERANCE_M
    return ~np.isnan(surfaces_m).all(axis=-1) & ~near.any(axis=-1)


def range_error(depth_m: np.ndarray, truth_m: np.ndarray) -> tuple[float, float]:
    """Return (bias, RMS) in metres of depth - truth (float64, any shape), over the pixels with
    both; NaN if none.
    """
    error_m = (depth_m - truth_m)[~np.isnan(depth_m - truth_m)]
    if not len(error_m):
        return np.nan, np.nan
    return float(error_m.mean()), float(np.sqrt(np.mean(error_m**2)))
