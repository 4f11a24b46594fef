# SPDX-License-Identifier: Apache-2.0
"""The sensors that proofs are about: as small as parameters allow, every structure in them twice at least."""

from ..model.contract.parameters import Sensor

SMALL = Sensor(
    rows=4, cols=8, phases=4, coarse_bits=4, window_max=9, rearm=1, fifo_depth=2, subgroup=(4, 4), minigroup=(2, 2)
)
