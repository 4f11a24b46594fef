# SPDX-License-Identifier: Apache-2.0
"""Short form of `make soak`, and its light."""

import pytest

from .random_cases import SENSORS
from .soak import LIGHTS, configuration, soak


@pytest.mark.parametrize("light", LIGHTS)
def test_soak(light):
    *_, checked = soak(configuration(SENSORS["odd"], pulses=3), light, frames=6, seed=1)
    assert checked > 1000
