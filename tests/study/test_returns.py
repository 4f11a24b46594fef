# SPDX-License-Identifier: Apache-2.0
"""Four surfaces per pixel, and a point at 150 m."""

import pytest

from coincid.lab.outcomes import Run
from coincid.model.depth.quality import TOLERANCE_M
from coincid.study import returns


@pytest.mark.parametrize("step_m", returns.STEPS_M)
def test_four_surfaces_in_every_histogram(step_m):
    shares = returns.all_found(Run(returns.setup(returns.NEAREST_M[0], step_m)))
    assert min(shares.values()) >= 0.95


def test_a_cycle_hides_its_second_surface_in_bright_light():
    slow, fast = (
        returns.all_found(Run(returns.setup(4.0, 0.15, photons=0.6, pulses=1000, faster=faster)))["map"]
        for faster in (False, True)
    )
    assert slow < 0.05 and fast > 0.9


def test_a_point_at_150_m():
    near, far = (abs(returns.point_error_m(Run(returns.point(0.1, 10.0, 1000, 0, nj)))) for nj in (2.0, 0.01))
    assert near < TOLERANCE_M < far
