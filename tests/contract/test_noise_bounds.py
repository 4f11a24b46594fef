# SPDX-License-Identifier: Apache-2.0
"""Default limits of the controller, against a tree that noise opens again and again."""

import numpy as np
import pytest

from coincid.model.contract.noise_bounds import noise_bounds
from coincid.model.contract.parameters import Sensor

PULSES = 100
PERIOD_CYCLES = 250
WINDOW_TICKS = 16


@pytest.mark.parametrize("rearm", (0, 5, 15))
def test_no_limit_is_above_what_the_tree_can_open(rearm):
    """It opens no window while it is busy with another one: for the window, and the gap behind it."""
    sensor = Sensor(rearm=rearm)
    bounds = noise_bounds(
        sensor, window_ticks=WINDOW_TICKS, period_cycles=PERIOD_CYCLES, pulses=PULSES
    )
    busy_cycles = (WINDOW_TICKS + (sensor.phases - 1) / 2) / sensor.phases + rearm
    most = PULSES * PERIOD_CYCLES / busy_cycles
    assert np.all(np.diff(bounds) > 0)
    assert 0.3 * most < bounds[-1] < most
