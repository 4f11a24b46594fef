# SPDX-License-Identifier: Apache-2.0
"""Interpolation for compiled code."""

import numpy as np

from .compiled import part


@part(error_model="numpy")
def interpolated(x: float, xs: np.ndarray, ys: np.ndarray) -> float:
    """Return the value at `x` of the line through points, as `np.interp` does.

    xs: float64[n], ascending; where some are equal, the line is vertical. ys: float64[n].
    """
    last = len(xs) - 1
    if x <= xs[0]:
        return float(ys[0])
    if x >= xs[last]:
        return float(ys[last])
    low = 0  # xs[low] < x <= xs[high]
    high = last
    while high - low > 1:
        middle = (low + high) // 2
        if xs[middle] < x:
            low = middle
        else:
            high = middle
    return float(ys[low] + (x - xs[low]) / (xs[high] - xs[low]) * (ys[high] - ys[low]))
