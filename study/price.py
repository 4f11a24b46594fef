# SPDX-License-Identifier: Apache-2.0
"""Estimates area and power in 45 nm from the project's measurements; nothing is synthesized here.

Areas come from `make cost` (docs/cost.md), which varies one parameter at a time; their ratios are
multiplied. Power comes from `make power` (docs/power.md) for the default subgroup, and is scaled in
proportion to area and clock. Use both to compare configurations; an exact number needs synthesis.
"""

import numpy as np

from ..model.contract.config import Config
from ..model.contract.parameters import Sensor

UM2_PER_PIXEL = {  # parameter: (values, um2 per pixel with the other parameters' defaults)
    "pixels": ((16, 32, 64, 256), (1115.2, 813.1, 658.3, 538.6)),
    "minigroup_pixels": ((1, 4, 16), (1176.5, 658.3, 531.0)),
    "phases": ((8, 16, 32, 64), (567.6, 615.1, 658.3, 761.5)),
    "offsets": ((0, 1), (514.6, 658.3)),
    "records": ((0, 1), (599.6, 658.3)),
    "controller": ((0, 1), (646.6, 658.3)),
    "fifo_depth": ((8, 16), (557.1, 658.3)),
}
UW_PER_PIXEL = ((0.0, 5.0, 50.0, 100.0), (17.0, 23.0, 37.0, 50.0))  # klux, and uW at 500 MHz
MEASURED_MHZ = 500.0


def um2_per_pixel(sensor: Sensor) -> float:
    """Return the area of the synchronous view per pixel."""
    default = Sensor()
    area = _between("phases", default.phases)
    for name in UM2_PER_PIXEL:
        area *= _between(name, getattr(sensor, name)) / _between(name, getattr(default, name))
    return area


def uw_per_pixel(config: Config, klux: float) -> float:
    """Return the power per pixel under ambient light, in a laser period."""
    measured = float(np.interp(klux, *UW_PER_PIXEL))
    return (
        measured
        * config.clock_mhz
        / MEASURED_MHZ
        * um2_per_pixel(config.sensor)
        / um2_per_pixel(Sensor())
    )


def while_measured(config: Config) -> str:
    """Return the words that tell when a sensor has the power of `uw_per_pixel`: not in a gap,
    whose power is not measured.
    """
    return " in a period" * bool(config.gap)


def _between(name: str, value: int) -> float:
    """Return the area at a value of a parameter, on the line between its measured neighbours."""
    values, areas = UM2_PER_PIXEL[name]
    return float(np.exp(np.interp(np.log1p(value), np.log1p(values), np.log(areas))))
