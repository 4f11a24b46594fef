# SPDX-License-Identifier: Apache-2.0
"""Checks of arguments that several rooms take."""

from typing import TypeVar

from .errors import check_integer, wrong_value

_T = TypeVar("_T")

WORKERS_MAX = 256


def check_workers(workers: int) -> int:
    """Return a number of threads. Raises `InputError`."""
    return check_integer("workers", workers, 1, WORKERS_MAX)


def check_kind(name: str, value: _T, *kinds: type) -> _T:
    """Return `value` if it is of one of these classes; `NoneType` stands for None. Raises
    `InputError`.
    """
    if not isinstance(value, kinds):
        told = ["None" if kind is type(None) else kind.__name__ for kind in kinds]
        raise wrong_value(name, value, " or ".join(told))
    return value


def given_or_new(name: str, value: _T | None, kind: type[_T]) -> _T:
    """Return `value` if it is of this class, or one with the defaults for None. Raises
    `InputError`.
    """
    return kind() if value is None else check_kind(name, value, kind)
