# SPDX-License-Identifier: Apache-2.0
"""Code density test: measures the widths of a TDC's taps with edges of uniform light, as on real
silicon.

Under light that is uniform in time, each code collects counts in proportion to the width of its
bin.
"""

import numpy as np
from attrs import frozen

from ..shared.errors import InputError, check_integer
from ..shared.quantities import shape_of


@frozen(eq=False)
class CodeDensity:
    """Result per phase, float64[phases], in LSB (clock cycle / phases).

    dnl_lsb: width of each phase minus the mean width. inl_lsb: running sum of that, the error of
    each phase's upper border. sigma_lsb: standard error of each width. edges: number of edges
    counted.
    """

    dnl_lsb: np.ndarray
    inl_lsb: np.ndarray
    sigma_lsb: np.ndarray
    edges: int


def code_density(tick: np.ndarray, phases: int) -> CodeDensity:
    """Measure the taps from the ticks (integers) of edges under uniform light.

    Raises `InputError` if there is less than one edge per phase on average.
    """
    phases = check_integer("phases", phases, 2, 1024)
    shape = shape_of("tick", tick)
    tick = np.asarray(tick)
    if len(shape) != 1 or tick.dtype.kind not in "iu":
        raise InputError(f"tick: holds {tick.dtype}{list(shape)}, must hold integers [n]")
    if len(tick) < phases:
        raise InputError(
            f"tick: holds {len(tick)} edges, must hold at least one per phase ({phases})"
        )
    share = np.bincount(tick % phases, minlength=phases) / len(tick)
    dnl_lsb = share * phases - 1
    sigma_lsb = phases * np.sqrt(share * (1 - share) / len(tick))
    return CodeDensity(dnl_lsb, np.cumsum(dnl_lsb), sigma_lsb, len(tick))
