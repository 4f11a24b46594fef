# SPDX-License-Identifier: Apache-2.0
"""Compiled libraries of our own, as Python uses them: functions with their types, and arrays
that they keep.
"""

import ctypes
from collections.abc import Mapping, Sequence
from math import prod
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

# name -> types of the answer and of the arguments
Functions: TypeAlias = Mapping[str, tuple[Any, Sequence[Any]]]


def load(path: Path, prefix: str, functions: Functions) -> ctypes.CDLL:
    """Load a library whose functions are called `prefix_name`."""
    library = ctypes.CDLL(str(path))
    for name, (answer, arguments) in functions.items():
        function = getattr(library, f"{prefix}_{name}")
        function.restype, function.argtypes = answer, arguments
    return library


def array_at(
    address: int | None, shape: Sequence[int], kind: npt.DTypeLike = np.uint64
) -> np.ndarray:
    """Return the array of a library's memory at an address. An empty array needs none, and any
    will do.
    """
    if address is None:
        return np.zeros(shape, kind)
    memory = (ctypes.c_char * (prod(shape) * np.dtype(kind).itemsize)).from_address(address)
    return np.frombuffer(memoryview(memory), kind).reshape(shape)
