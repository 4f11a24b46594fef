# SPDX-License-Identifier: Apache-2.0
"""The controller against constant thresholds: it beats each of them where sun and shade meet on a scarce link."""

from coincid.study.constant_thresholds import THRESHOLDS, Stream, shares


def test_the_controller_beats_every_constant_between_sun_and_shade():
    for of_method in shares("sun-and-shade", 100.0, Stream(32, 8)).values():
        assert len(of_method.fixed) == len(THRESHOLDS)
        assert of_method.controller < of_method.fixed.min()
