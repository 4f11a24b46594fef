# SPDX-License-Identifier: Apache-2.0
"""Transients for tests."""

import numpy as np

from coincid.model.scenes.transient import Transient, sparse


def synthetic(table, surface_m=5.0, ambient=0.4):
    """Return a transient from strengths [rows, cols, bins]."""
    rows, cols, bins = table.shape
    counts, index, strength = sparse(table.reshape(rows * cols, bins))
    surface_m, ambient = (
        np.broadcast_to(surface_m, (rows, cols)).copy(),
        np.broadcast_to(ambient, (rows, cols)).copy(),
    )
    return Transient(
        first=np.r_[0, np.cumsum(counts)],
        index=index,
        strength_per_m2=strength,
        surface_m=surface_m,
        ambient=ambient,
    )
