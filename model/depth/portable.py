# SPDX-License-Identifier: Apache-2.0
"""Logarithms and exponentials of arrays that are the same on every processor.

NumPy has several versions of each, one for each kind of vector unit, and their last bits differ.
Those of SciPy have one version, which for `log` and `exp` is the C library's.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import special


def exp(values: ArrayLike) -> Any:
    """Return e to the power of some values (float64, or float32 of float32)."""
    # Of Box and Cox: with the exponent 0, it is the exponential.
    return special.inv_boxcox(values, np.float32(0))


def log(values: ArrayLike) -> Any:
    """Return the logarithm of some values (float64, or float32 of float32)."""
    return special.xlogy(np.float32(1), values)


def log1p(values: ArrayLike) -> Any:
    """Return the logarithm of 1 plus some values (float64, or float32 of float32)."""
    return special.log1p(values)


def expm1(values: ArrayLike) -> Any:
    """Return e to the power of some values, less 1 (float64, or float32 of float32)."""
    return special.expm1(values)


def geometric_steps(first: float, last: float, number: int) -> np.ndarray:
    """float64[number]: values from the first to the last, each the same factor above the one
    before.
    """
    return np.array([first * (last / first) ** (k / (number - 1)) for k in range(number)])
