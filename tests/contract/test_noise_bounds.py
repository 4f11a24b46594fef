# SPDX-License-Identifier: Apache-2.0
"""Default limits of the controller, against a tree that noise opens again and again."""

from math import exp, factorial

import numpy as np
import pytest

from coincid.model.contract.config import parse_config
from coincid.model.contract.counters import EVENTS_MAX
from coincid.model.contract.noise_bounds import noise_bounds
from coincid.model.contract.parameters import Sensor, guard_cycles

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


@pytest.mark.parametrize(("phases", "window_ticks"), [(16, 16), (16, 40), (8, 16)])
def test_noise_fills_a_window_by_the_law_of_poisson(phases, window_ticks):
    """Where noise opens as many windows as a bound says, four windows of each pulse have the other
    photons that the threshold asks for.
    """
    sensor = Sensor(rearm=3, phases=phases)
    bounds = noise_bounds(
        sensor, window_ticks=window_ticks, period_cycles=PERIOD_CYCLES, pulses=PULSES
    )
    guard = guard_cycles(window_ticks, phases, sensor.rearm)
    open_ticks = PULSES * phases * (PERIOD_CYCLES - guard)
    busy_ticks = window_ticks + (phases - 1) / 2 + phases * sensor.rearm
    for others, opened in enumerate(bounds):
        mean = window_ticks / (open_ticks / opened - busy_ticks)  # further photons in a window
        fewer = sum(exp(-mean) * mean**n / factorial(n) for n in range(others))
        assert opened * (1 - fewer) == pytest.approx(4 * PULSES, rel=0.01), others + 1


def test_where_noise_opens_too_few_windows_it_never_raises_a_threshold():
    """In one cycle of a period, noise opens a window or two."""
    config = parse_config({"frame": {"period": 6}})
    assert config.auto_bounds.tolist() == [EVENTS_MAX] * 6
    assert noise_bounds(Sensor(), window_ticks=1, period_cycles=100, pulses=1)[0] < EVENTS_MAX
