# SPDX-License-Identifier: Apache-2.0
"""Comparison of depths."""

import numpy as np


def assert_equal_depths(one, other, parts=("depth_m", "confidence"), returns=None):
    """Check that parts of two depths are equal, NaN included, or those of so many first returns."""
    for name in parts:
        mine = getattr(one, name)
        its = getattr(other, name)
        if mine.ndim > 2:
            mine = mine[:, :, :returns]
            its = its[:, :, :returns]
        assert np.array_equal(mine, its, equal_nan=mine.dtype.kind == "f"), name
