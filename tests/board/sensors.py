# SPDX-License-Identifier: Apache-2.0
"""The smallest sensor of the emulator, for netlists, releases and placements."""

from coincid.model.contract.parameters import Sensor

from ..random_cases import configured

SENSOR = Sensor(
    rows=4,
    cols=4,
    phases=4,
    window_max=4,
    coarse_bits=6,
    fifo_depth=4,
    subgroup=(4, 4),
    minigroup=(4, 4),
)


def config(**frame):
    """Return its configuration with other settings of the frame."""
    return configured(
        SENSOR,
        {"period": 24, "pulses": 2, "clock_mhz": 100, "format": "id"} | frame,
        {"threshold": 2, "window": 4},
    )
