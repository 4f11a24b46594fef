# SPDX-License-Identifier: Apache-2.0
"""Arrays joined without a copy where none is needed."""

from collections.abc import Sequence

import numpy as np


def joined(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Return the rows of all arrays, contiguous; a single array that is contiguous is not copied."""
    if len(arrays) == 1:
        return np.ascontiguousarray(arrays[0])
    return np.concatenate(arrays)
