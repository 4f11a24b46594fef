# SPDX-License-Identifier: Apache-2.0
"""Short form of `make soak`, and its light."""

import numpy as np
import pytest

from .random_cases import SENSORS
from .soak import DEAD_TICKS, LIGHTS, configuration, saturation, soak


@pytest.mark.parametrize("light", LIGHTS)
def test_soak(light):
    assert soak(configuration(SENSORS["default"], pulses=3), light, frames=6, seed=1) > 1000


def test_saturation_is_every_dead_time():
    config = configuration(SENSORS["one"] | {"cols": 16}, pulses=2)
    edges = saturation(config, 0, 1)
    at = (edges.pulse * config.period_ticks + edges.tick)[edges.pixel == 5]
    assert (np.diff(at) == DEAD_TICKS).all()
    assert len(edges) == 128 * (2 * config.period_ticks // DEAD_TICKS)
