# SPDX-License-Identifier: Apache-2.0
"""The threshold controller in constant light settles. `test_results.py` has the cycles of real photons."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from coincid.model.contract.config import parse_config
from coincid.model.contract.settings import THRESHOLD_MAX
from coincid.model.golden.controller import Controller
from coincid.model.golden.shape import COUNTER


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
