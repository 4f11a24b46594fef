# SPDX-License-Identifier: Apache-2.0
"""A sensor that tools for netlists process in seconds."""

from coincid.model.contract.parameters import Sensor

SMALL = Sensor(
    rows=4,
    cols=4,
    subgroup=(4, 4),
    minigroup=(2, 2),
    phases=4,
    window_max=8,
    fifo_depth=1,
    coarse_bits=6,
)
