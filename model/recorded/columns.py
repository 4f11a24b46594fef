# SPDX-License-Identifier: Apache-2.0
"""Columns of numbers from files of other programs, checked."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from ..shared.errors import InputError
from ..shared.files import FilePath
from .recordings import INTEGER_MAX, SYNC_MAX

# int64 where all numbers are written as integers, else float64; of one length
Columns: TypeAlias = Sequence[np.ndarray]


def checked_columns(path: FilePath, arrays: dict[str, np.ndarray]) -> Columns:
    """Return the arrays as numeric columns of equal length, integers as int64. Raises
    `InputError`.
    """
    for name, array in arrays.items():
        held = np.asarray(array)  # HDF5 has datasets without any array
        if held.ndim != 1 or held.dtype.kind not in "iuf":
            raise InputError(
                f"{path}: {name}: holds {held.dtype}{list(held.shape)}, must hold numbers in one dimension"
            )
    lengths = {name: len(array) for name, array in arrays.items()}
    if len(set(lengths.values())) > 1:
        raise InputError(
            f"{path}: lengths differ: " + ", ".join(f"{name} {n}" for name, n in lengths.items())
        )
    return [_column(path, name, array) for name, array in arrays.items()]


def _column(path: FilePath, name: str, array: np.ndarray) -> np.ndarray:
    """Return int64 for integers, float64 for floats. Raises `InputError` for integers beyond
    int64.
    """
    if array.dtype.kind == "f":
        return array.astype(np.float64)
    if len(array) and int(array.max()) > INTEGER_MAX:
        raise InputError(f"{path}: {name}: holds {array.max()}, must be below 2^63")
    return array.astype(np.int64)


def integers(path: FilePath, name: str, values: np.ndarray) -> np.ndarray:
    """Return `values` as int64. Raises `InputError`."""
    with np.errstate(invalid="ignore"):
        bad = np.flatnonzero(~((values == np.floor(values)) & (np.abs(values) < SYNC_MAX)))
    if values.dtype.kind != "i" and len(bad):
        raise InputError(
            f"{path}: {name}[{bad[0]}] = {values[bad[0]]}: must be an integer, below 2^53 in a column of floats"
        )
    return values.astype(np.int64)


def not_negative(path: FilePath, name: str, values: np.ndarray) -> None:
    """Raise `InputError` unless all values are finite and at least 0."""
    bad = np.flatnonzero(~((values >= 0) & (values < np.inf)))
    if len(bad):
        raise InputError(
            f"{path}: {name}[{bad[0]}] = {values[bad[0]]}: must be a number of at least 0"
        )
