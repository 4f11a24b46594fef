# SPDX-License-Identifier: Apache-2.0
"""Numba for this project's kernels: compiled code is kept on disk until one of its possible sources changes.

Numba only checks the file of the compiled function itself, but a kernel includes functions and constants from other
files. The kernel's room, the contract and this room hold everything that it may use, so the folder of its compiled code
is named by their digest.
"""

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, overload

import numba

from .errors import InputError
from .folders import build_root
from .sources import sources_digest

_NUMBA: Any = numba.config  # it reads its settings at import, so type checkers do not know them
_SHARED_BY_ALL = ("model.contract", "model.shared")
_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])


@overload
def njit(function: _Kernel) -> _Kernel: ...
@overload
def njit(*, allocates: bool = True, **options: Any) -> Callable[[_Kernel], _Kernel]: ...
def njit(function: Callable[..., Any] | None = None, *, allocates: bool = True, **options: Any) -> Callable[..., Any]:
    """`numba.njit`, with or without options, with compiled code kept on disk and without the lock of the interpreter.

    Code that calls the function from C is not made.

    allocates=False: the function and the functions it calls make no arrays, and do not count references to their
    arguments. If functions with many array arguments are called for every photon, that counting costs more than they do.
    """
    if function is None:
        return partial(njit, allocates=allocates, **options)
    options |= {"nogil": True, "no_cfunc_wrapper": True} | ({} if allocates else {"_nrt": False, "forceinline": True})
    folder = None if _NUMBA.DISABLE_JIT else _folder(_room(function.__module__))
    if folder is None:
        return numba.njit(**options)(function)
    others = _NUMBA.CACHE_DIR  # cache folder of other packages
    _NUMBA.CACHE_DIR = str(folder)
    try:
        return numba.njit(cache=True, **options)(function)
    finally:
        _NUMBA.CACHE_DIR = others


def is_compiled(module: str) -> bool:
    """Return whether some process has kept compiled code of the present sources of a module's room."""
    folder = _folder(_room(module))
    return folder is None or any(folder.rglob("*.nbi"))


def _room(module: str) -> str:
    """Return the package below `coincid` that holds `module`."""
    return module.rpartition(".")[0].partition(".")[2]


@cache
def _folder(room: str) -> Path | None:
    """Return the folder for a room's compiled code, or None if it cannot be written: then every process compiles anew."""
    try:
        return build_root() / "numba" / sources_digest(*sorted({room, *_SHARED_BY_ALL}))
    except InputError:
        return None
