# SPDX-License-Identifier: Apache-2.0
"""The threshold controller in constant light settles."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.config import parse_config
from coincid.model.contract.settings import THRESHOLD_MAX
from coincid.model.golden.controller import Controller
from coincid.model.golden.frame import Golden
from coincid.model.golden.shape import COUNTER


@pytest.mark.parametrize("part", (1, 4, 16))
def test_the_same_photons_settle_in_five_frames(part):
    run = Run(Setup.of("five-objects", subgroup={"auto": True}, klux="5|100"))
    config, golden, states = (
        run.config.with_frame(capacity=run.config.capacity // part),
        Golden(run.config.sensor),
        [],
    )
    for _ in range(7):
        used = golden.frame(config, run.edges).counters[:, COUNTER.threshold_used]
        states.append((*golden.controller.budget, *golden.controller.limit, *used))
    assert states[0] != states[5] == states[6]


@given(data=st.data())
def test_any_counts_come_to_rest(data):
    """Whatever the windows of each subgroup are, the controller comes to rest, below a limit cycle
    of any length.
    """
    subgroups = data.draw(st.integers(1, 6))
    most = data.draw(st.sampled_from((9, 100, 10_000)))
    counts = st.lists(
        st.integers(0, most), min_size=THRESHOLD_MAX, max_size=THRESHOLD_MAX
    )  # with at least 1, 2 ... pixels
    windows = np.array([sorted(data.draw(counts), reverse=True) for _ in range(subgroups)])
    frame = {"capacity": data.draw(st.integers(0, 2 * most * subgroups)), "auto_bounds": [0] * 6}
    settings = {"auto": True, "threshold": data.draw(st.integers(1, THRESHOLD_MAX))}
    config = parse_config(
        {"sensor": {"rows": 8, "cols": 8 * subgroups}, "frame": frame, "subgroup": settings}
    )
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
