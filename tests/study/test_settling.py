# SPDX-License-Identifier: Apache-2.0
"""The threshold controller in constant light: it settles, within the capacity of the stream."""

import numpy as np
import pytest

from coincid.model.contract.config import parse_config
from coincid.model.light.light import Light
from coincid.model.light.photons import generate_edges
from coincid.model.light.spad import Spad
from coincid.model.light.timing import Timing
from coincid.study.settling import limit_cycle


@pytest.fixture(scope="module")
def shaded():
    """Return a frame of a sensor with nine subgroups, each in light of its own, from shade to sun."""
    sensor = {"rows": 24, "cols": 24}
    config = parse_config(
        {"sensor": sensor, "frame": {"pulses": 40, "auto_bounds": [0] * 6}, "subgroup": {"auto": True}}
    )
    row, col = np.divmod(np.arange(24 * 24), 24)
    background_cps = 1e4 * 2.0 ** (row // 8 * 3 + col // 8)
    light = Light(rows=24, cols=24, distance_m=6.0, signal_per_pulse=0.1, background_cps=background_cps)
    return config, generate_edges(light, Spad(), Timing.from_config(config), pulses=40, seed=3)


@pytest.mark.parametrize("capacity", (200, 300, 1000, 5000, 50_000))
def test_the_same_photons_settle_without_a_limit_cycle(shaded, capacity):
    config, edges = shaded
    cycle = limit_cycle(config.with_frame(capacity=capacity), edges)
    assert cycle is not None and cycle.frames == 1 and cycle.subgroups == 0
    assert 0 < cycle.load <= 1
