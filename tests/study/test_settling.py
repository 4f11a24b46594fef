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


FRAMES = 5  # of any photons, after which the controller is at rest
CHANGED = 8  # after a change of the light


@pytest.mark.parametrize("capacity", (200, 300, 1000, 5000, 50_000))
def test_the_same_photons_settle_without_a_limit_cycle(shaded, capacity):
    config, edges = shaded
    golden = Golden(config.sensor)
    cycle = limit_cycle(config.with_frame(capacity=capacity), edges, golden)
    assert cycle is not None and cycle.frames == 1 and cycle.subgroups == 0
    assert 0 < cycle.load <= 1
    assert cycle.begins <= FRAMES
    dark = limit_cycle(config.with_frame(capacity=capacity), edges.take(np.arange(0)), golden)
    light = limit_cycle(config.with_frame(capacity=capacity), edges, golden)
    assert dark.frames == light.frames == 1 and max(dark.begins, light.begins) <= CHANGED


@given(data=st.data())
def test_any_counts_come_to_rest(data):
    """Whatever the windows of each subgroup are, the controller comes to rest, below a limit cycle of any length."""
    subgroups = data.draw(st.integers(1, 6))
    most = data.draw(st.sampled_from((9, 100, 10_000)))
    counts = st.lists(st.integers(0, most), min_size=THRESHOLD_MAX, max_size=THRESHOLD_MAX)
    windows = np.array(
        [sorted(data.draw(counts), reverse=True) for _ in range(subgroups)]
    )  # with at least 1, 2 ... pixels
    frame = {"capacity": data.draw(st.integers(0, 2 * most * subgroups)), "auto_bounds": [0] * 6}
    settings = {"auto": True, "threshold": data.draw(st.integers(1, THRESHOLD_MAX))}
    config = parse_config({"sensor": {"rows": 8, "cols": 8 * subgroups}, "frame": frame, "subgroup": settings})
    controller, seen, every = Controller(config.sensor), [], np.arange(subgroups)
    while True:
        threshold = controller.begin(config)
        counters = np.zeros((subgroups, len(COUNTER)), np.int64)
        counters[:, COUNTER.opened], counters[:, COUNTER.threshold_used] = windows[:, 0], threshold
        counters[:, COUNTER.committed] = windows[every, threshold - 1]
        counters[:, COUNTER.lower] = windows[every, np.maximum(threshold - 2, 0)]
        controller.end(config, counters)
        now = (*threshold.tolist(), *controller.budget.tolist(), *controller.limit.tolist())
        if now in seen:
            break
        seen.append(now)
    assert now == seen[-1]
