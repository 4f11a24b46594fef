# SPDX-License-Identifier: Apache-2.0
"""The threshold controller in constant light: it settles, within the capacity of the stream."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coincid.model.contract.config import parse_config
from coincid.model.contract.settings import THRESHOLD_MAX
from coincid.model.golden.controller import Controller
from coincid.model.golden.frame import Golden
from coincid.model.golden.shape import COUNTER
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
    """Within five frames, and within eight after a change of the light."""
    config, edges = shaded
    config, golden = config.with_frame(capacity=capacity), Golden(config.sensor)
    for photons, frames in ((edges, 5), (edges.take(np.arange(0)), 8), (edges, 8)):
        cycle = limit_cycle(config, photons, golden)
        assert (cycle.frames, cycle.subgroups) == (1, 0) and cycle.begins <= frames
        assert (0 < cycle.load <= 1) == (photons is edges)


@given(data=st.data())
def test_any_counts_come_to_rest(data):
    """Whatever the windows of each subgroup are, the controller comes to rest, below a limit cycle of any length."""
    subgroups = data.draw(st.integers(1, 6))
    most = data.draw(st.sampled_from((9, 100, 10_000)))
    counts = st.lists(
        st.integers(0, most), min_size=THRESHOLD_MAX, max_size=THRESHOLD_MAX
    )  # with at least 1, 2 ... pixels
    windows = np.array([sorted(data.draw(counts), reverse=True) for _ in range(subgroups)])
    frame = {"capacity": data.draw(st.integers(0, 2 * most * subgroups)), "auto_bounds": [0] * 6}
    settings = {"auto": True, "threshold": data.draw(st.integers(1, THRESHOLD_MAX))}
    config = parse_config({"sensor": {"rows": 8, "cols": 8 * subgroups}, "frame": frame, "subgroup": settings})
    controller, seen, every = Controller(config.sensor), [], np.arange(subgroups)
    while not seen or seen[-1] not in seen[:-1]:
        threshold = controller.begin(config)
        counters = np.zeros((subgroups, len(COUNTER)), np.int64)
        counters[:, COUNTER.opened], counters[:, COUNTER.threshold_used] = windows[:, 0], threshold
        counters[:, COUNTER.committed] = windows[every, threshold - 1]
        counters[:, COUNTER.lower] = windows[every, np.maximum(threshold - 2, 0)]
        controller.end(config, counters)
        seen.append((*threshold.tolist(), *controller.budget.tolist(), *controller.limit.tolist()))
    assert seen[-1] == seen[-2]
