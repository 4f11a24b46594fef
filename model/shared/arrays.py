# SPDX-License-Identifier: Apache-2.0
"""Arrays that are joined, that become longer, and that forget their beginning."""

from collections.abc import Sequence

import numpy as np


def joined(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Return the rows of all arrays, contiguous; a single array that is contiguous is not copied."""
    if len(arrays) == 1:
        return np.ascontiguousarray(arrays[0])
    return np.concatenate(arrays)


def longer(array: np.ndarray, length: int) -> np.ndarray:
    """Return an array of so many items, with those of `array` first and zeros behind them."""
    result = np.zeros(length, array.dtype)
    result[: len(array)] = array
    return result


def keep_only(array: np.ndarray, first: int, number: int) -> None:
    """Move so many items, from `first` on, to the array's beginning."""
    array[:number] = array[first : first + number].copy()
