# SPDX-License-Identifier: Apache-2.0
"""Sensors for the proofs: as small as the parameters allow, but with every structure at least
twice.
"""

from attrs import evolve

from ..model.contract.parameters import Sensor

SMALL = Sensor(
    rows=4,
    cols=8,
    phases=4,
    coarse_bits=4,
    window_max=9,
    rearm=1,
    fifo_depth=2,
    subgroup=(4, 4),
    minigroup=(2, 2),
)

# With maps of 64 pixels, which are longer than the payload of a beat of a group.
LONG_PARTS = evolve(SMALL, rows=8, cols=16, subgroup=(8, 8))

# With counts, which use the same structures and none of those of events less.
SMALL_COUNTS = evolve(SMALL, counts=1)
