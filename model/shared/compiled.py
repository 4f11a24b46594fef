# SPDX-License-Identifier: Apache-2.0
"""Numba for this project's kernels: compiled code is kept on disk until any source that it may be made of changes.

Numba looks only at the file of the function that it is asked for, but a kernel takes in functions and constants of other files. A
kernel's room, the contract and this room hold all that it may use, so their digest names the folder of its compiled code.
"""

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, overload

import numba

from .errors import InputError
from .folders import build_root
from .sources import sources_digest

_NUMBA: Any = numba.config  # reads its settings when it is imported, so that no type checker knows them
_SHARED_BY_ALL = ("model.contract", "model.shared")
_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])


@overload
def njit(function: _Kernel) -> _Kernel: ...
@overload
def njit(*, allocates: bool = True, **options: Any) -> Callable[[_Kernel], _Kernel]: ...
def njit(function: Callable[..., Any] | None = None, *, allocates: bool = True, **options: Any) -> Callable[..., Any]:
    """`numba.njit`, with or without options, that keeps what it compiled and lets other threads run meanwhile.

    allocates=False: the function and what it calls make no array, and count no references to those that they are given. Where functions that
    take many arrays are called for every photon, that costs more than they do.
    """
    if function is None:
        return partial(njit, allocates=allocates, **options)
    options |= {"nogil": True} | ({} if allocates else {"_nrt": False})
    folder = None if _NUMBA.DISABLE_JIT else _folder(_room(function.__module__))
    if folder is None:
        return numba.njit(**options)(function)
    others = _NUMBA.CACHE_DIR  # where other packages keep theirs
    _NUMBA.CACHE_DIR = str(folder)
    try:
        return numba.njit(cache=True, **options)(function)
    finally:
        _NUMBA.CACHE_DIR = others


def _room(module: str) -> str:
    """The package below `coincid` that holds `module`."""
    return module.rpartition(".")[0].partition(".")[2]


@cache
def _folder(room: str) -> Path | None:
    """Where the compiled code of a room is kept; None where nothing can be written: then every process compiles anew."""
    try:
        return build_root() / "numba" / sources_digest(*sorted({room, *_SHARED_BY_ALL}))
    except InputError:
        return None
