# SPDX-License-Identifier: Apache-2.0
"""Counters at their end: measures, estimates and reports are those of wider counters, or say that
they are not known.
"""

import numpy as np
import pytest

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.counters import COUNTER_NAMES

PULSES = 300


def run_of(counter_bits, threshold=1, **frame):
    return Run(
        Setup.of(
            "flat:6,0.3",
            sensor={"rows": 8, "cols": 16, "counter_bits": counter_bits},
            frame={"pulses": PULSES} | frame,
            subgroup={"threshold": threshold},
            klux=60.0,
        )
    )


def test_without_drops_only_sums_over_windows_are_not_known():
    exact, full = run_of(32).frame(), run_of(9).frame()
    assert full.run.result["committed"].max() == 511 < exact.counter("committed").min()
    for measure in (
        "events",
        "committed",
        "opened",
        "dropped",
        "dropped_share",
        "commits_per_pulse",
    ):
        assert full[measure] == exact[measure], measure
    for measure in ("bits", "beats", "link_load", "events_per_s", "capacity_share"):
        assert full[measure] == exact[measure], measure
    assert (full["photons"], full["blind_cycles"]) == (None, None)


def test_measures_of_too_many_drops_are_not_known():
    slow = {"link_gbps": 2.0}
    exact, full = run_of(32, **slow).frame(), run_of(9, **slow).frame()
    assert exact.counter("dropped").min() > 511
    assert full["events"] == exact["events"]
    assert full["beats"] == exact["beats"]
    for measure in ("opened", "committed", "dropped", "dropped_share", "commits_per_pulse"):
        assert full[measure] is None, measure


def test_a_counter_at_its_end_in_one_subgroup_is_that_of_wider_counters_if_it_is_known():
    """Else it is the least that it may be; before the result is made, and with it."""
    for thresholds in ([1, 64], [64, 1]):
        exact, full = (
            Run(one.setup.but(config=one.config.with_settings(threshold=thresholds))).frame()
            for one in (run_of(32), run_of(9))
        )
        ended = exact.counter("committed") > 511
        assert sorted(ended) == [False, True]
        for _ in range(2):
            known = [name for name in COUNTER_NAMES if full.knows(name)]
            assert {"committed", "stored", "dropped"} <= {*known} and "opened" not in known
            for name in COUNTER_NAMES:
                found, expected = full.counter(name), exact.counter(name)
                assert np.all(found <= expected), name
                assert name not in known or np.array_equal(found, expected), name
            assert full.run.result["committed"].max() == 511


@pytest.mark.parametrize("threshold", [1, 2])
@pytest.mark.parametrize("method", ["planes", "background"])
def test_estimates_are_those_of_wider_counters(method, threshold):
    exact = run_of(32, threshold).depth(method)
    full = run_of(9, threshold).depth(method)
    if threshold == 2:  # too many rejected windows
        assert np.nanmean(abs(full.depth_m - exact.depth_m)) < 0.05
        return
    for name in ("depth_m", "signal_per_pulse"):
        assert np.array_equal(getattr(full, name), getattr(exact, name), equal_nan=True), name
