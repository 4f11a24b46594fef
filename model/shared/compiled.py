# SPDX-License-Identifier: Apache-2.0
"""Numba for this project's kernels: compiled code is kept on disk until one of its possible
sources changes.

Numba only checks the file of the compiled function itself, but a kernel includes functions and
constants from other files. The kernel's package, those of the kernels and parts that its module
imports, the contract and this room hold everything that it may use, so the folder of its compiled
code is named by their digest.

Kernels consist of `part`s, which are compiled into them and never called from Python. So what
takes time for each
compiled function is left out: a wrapper for calls from Python, a file on disk, and one version
for each constant that is passed.
"""

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, overload

import numba
from numba.core import types
from numba.core.registry import CPUDispatcher

from .errors import InputError
from .folders import build_root
from .sources import packages_digest

_NUMBA: Any = numba.config  # it reads its settings at import, so type checkers do not know them
_without_value: Any = types.unliteral  # the type of a constant, without the constant
_SHARED_BY_ALL = ("coincid.model.contract", "coincid.model.shared")
_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])


class _Compiled(CPUDispatcher):
    """A function that Numba compiles once for all numbers of a type; Numba's own is compiled for
    each constant.
    """

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return how a call with these types is compiled."""
        general = [_without_value(one) for one in args]
        general_by_name = {name: _without_value(one) for name, one in kws.items()}
        return super().get_call_template(general, general_by_name)

    def compile(self, sig: Any) -> Any:
        """Compile for a signature, and keep the code. Raises `InputError` if the disk is full."""
        try:
            return super().compile(sig)
        except OSError as error:
            raise InputError(
                f"build directory {build_root()}: {error.strerror}; COINCID_BUILD names another"
            ) from None


class _Part(_Compiled):
    """A function that only compiled functions may call."""

    def __call__(self, *args: Any, **kws: Any) -> Any:
        raise TypeError(
            f"{self.py_func.__name__} is a part of kernels, and cannot be called from Python"
        )


@overload
def njit(function: _Kernel) -> _Kernel: ...
@overload
def njit(*, allocates: bool = True, **options: Any) -> Callable[[_Kernel], _Kernel]: ...
def njit(
    function: Callable[..., Any] | None = None, *, allocates: bool = True, **options: Any
) -> Callable[..., Any]:
    """Compile a kernel with Numba, keep its code on disk, and run it without the lock of the
    interpreter.

    Code that calls the function from C is not made. options: as of `numba.njit`.

    allocates=False: the kernel and its parts make no arrays, and do not count references to
    their arguments.
    """
    if function is None:
        return partial(njit, allocates=allocates, **options)
    if _NUMBA.DISABLE_JIT:
        return function
    kernel = _dispatcher(_Compiled, function, allocates, options)
    folder = _folder(*sorted(_packages_of(function)))
    if folder is None:
        return kernel
    others = _NUMBA.CACHE_DIR  # cache folder of other packages
    _NUMBA.CACHE_DIR = str(folder)
    try:
        kernel.enable_caching()
    finally:
        _NUMBA.CACHE_DIR = others
    return kernel


@overload
def part(function: _Kernel) -> _Kernel: ...
@overload
def part(
    *, allocates: bool = False, inlined: bool = True, **options: Any
) -> Callable[[_Kernel], _Kernel]: ...
def part(
    function: Callable[..., Any] | None = None,
    *,
    allocates: bool = False,
    inlined: bool = True,
    **options: Any,
) -> Callable[..., Any]:
    """Compile a part of kernels: a function that only they and their other parts call.

    allocates=True: the part makes arrays. If not, it counts no references to its arguments: if
    parts with many array arguments are called for every photon, that counting costs more than
    they do. inlined=False: it is called instead of being compiled into each place that calls it,
    as befits what is rare or long. options: as of `numba.njit`.
    """
    if function is None:
        return partial(part, allocates=allocates, inlined=inlined, **options)
    if _NUMBA.DISABLE_JIT:
        return function
    own = {"no_cpython_wrapper": True, "forceinline": inlined and not allocates}
    return _dispatcher(_Part, function, allocates, options | own)


def _dispatcher(
    kind: Callable[..., Any], function: Callable[..., Any], allocates: bool, options: dict[str, Any]
) -> Any:
    """Return a function as Numba sees it."""
    common = {"nopython": True, "boundscheck": None, "nogil": True, "no_cfunc_wrapper": True}
    if not allocates:
        common["_nrt"] = False
    return kind(py_func=function, targetoptions=common | options)


def is_compiled(module: str) -> bool:
    """Return whether some process has kept compiled code of the present sources of a module's
    package.
    """
    folder = _folder(_package(module))
    return folder is None or any(folder.rglob("*.nbi"))


def _package(module: str) -> str:
    """Return the package that holds `module`."""
    return module.rpartition(".")[0]


def _packages_of(function: Callable[..., Any]) -> set[str]:
    """Return the package of a kernel, and those of the kernels and parts that its module takes in."""
    taken_in = [one for one in function.__globals__.values() if isinstance(one, _Compiled)]
    return {_package(function.__module__), *(_package(one.py_func.__module__) for one in taken_in)}


@cache
def _folder(*packages: str) -> Path | None:
    """Return the folder for the compiled code of kernels that packages are the sources of, or None
    if it cannot be written: then every process compiles anew.
    """
    try:
        return build_root() / "numba" / packages_digest(*sorted({*packages, *_SHARED_BY_ALL}))
    except InputError:
        return None
