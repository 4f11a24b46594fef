# SPDX-License-Identifier: Apache-2.0
"""Logarithm, exponential and maximum of float32 for kernels: unlike those of `math`, they
compile to vector code.

The first two work on the bits of the number: its exponent, and a polynomial of its fraction.
"""

import math

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from ..shared.compiled import part

EXP_MIN = np.float32(-80.0)  # exponentials of less are those of this
_FRACTION_BITS, _BIAS = np.int32(23), 127  # of a float32
_BIAS_OF_LOG = np.float32(_BIAS)  # integers wider than 32 bits would halve the speed
_FRACTION = np.int32((1 << 23) - 1)
_FRACTION_UNIT = np.float32(2.0**-23)
_LN_2, _LOG2_E = np.float32(math.log(2)), np.float32(1 / math.log(2))


def _polynomial(function: np.ufunc, degree: int) -> tuple[np.float32, ...]:
    """Return the coefficients of a polynomial for a function between 0 and 1."""
    fit = Chebyshev.interpolate(function, degree, domain=[0, 1])
    return tuple(fit.convert(kind=Polynomial).coef.astype(np.float32))


_LOG_1P = _polynomial(np.log1p, 6)  # error below 2e-6
_EXP_2 = _polynomial(np.exp2, 4)  # relative error below 5e-6


@part
def fast_log(value: np.float32) -> np.float32:
    """Return the logarithm of a positive, normal float32."""
    c, bits = _LOG_1P, np.float32(value).view(np.int32)
    x = np.float32(bits & _FRACTION) * _FRACTION_UNIT
    y = c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * (c[5] + x * c[6])))))
    return y + _LN_2 * (np.float32(np.int32(bits >> _FRACTION_BITS)) - _BIAS_OF_LOG)


@part
def fast_exp(value: np.float32) -> np.float32:
    """Return the exponential of a float32 that is not above 0."""
    c, power = _EXP_2, max(value, EXP_MIN) * _LOG2_E
    whole = np.int32(power)
    x = power - (np.float32(whole) - np.float32(1))
    y = c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4])))
    return y * np.int32(np.int32(whole + _BIAS - 1) << _FRACTION_BITS).view(np.float32)


@part(fastmath={"nnan", "nsz"})
def top_of(line: np.ndarray) -> np.float32:
    """Return the highest of some values; the options make it vector code."""
    top = line[0]
    for k in range(1, len(line)):
        top = max(top, line[k])
    return top
