# SPDX-License-Identifier: Apache-2.0
"""Checked physical quantities: attrs fields and arrays with a legal range."""

from collections.abc import Callable, Hashable
from contextlib import suppress
from math import inf, isfinite, nan
from numbers import Real
from typing import Any, TypeAlias, TypeVar

import numpy as np
from attrs import Attribute, Converter, field
from numpy.typing import ArrayLike

from .errors import InputError, check_integer, told_number, wrong_value

Numbers: TypeAlias = float | np.ndarray  # one number, or one for each of many: they broadcast
_T = TypeVar("_T")


def check_real(name: str, value: Any, low: float, high: float = inf) -> float:
    """Return `value` as a float if it is finite and within [`low`, `high`]. Raises `InputError`."""
    number = nan
    if isinstance(value, Real) and not isinstance(value, bool):
        # an integer that is larger than any float, or a duration of NumPy, which counts as an integer
        with suppress(OverflowError, TypeError):
            number = float(value)
    if not low <= number <= high or not isfinite(number):
        raise wrong_value(name, value, f"a number {_range(low, high)}", low=low, high=high)
    return number


def check_choice(name: str, value: _T, choices: tuple[_T, ...]) -> _T:
    """Return `value` if it is one of `choices`. Raises `InputError`."""
    # an array, which is not hashable, has no truth when it is compared
    if not isinstance(value, Hashable) or value not in choices:
        raise wrong_value(name, value, f"one of {', '.join(map(str, choices))}")
    return value


def check_switch(name: str, value: Any) -> bool:
    """Return `value` if it is a bool. Raises `InputError`."""
    if not isinstance(value, bool):
        raise wrong_value(name, value, "true or false")
    return value


def real(default: float | None, low: float, high: float = inf) -> Any:
    """Return an attrs field that holds a finite float within [`low`, `high`], or None if that is
    the default.
    """
    return _checked_field(default, lambda name, value: check_real(name, value, low, high))


def switch(default: bool) -> Any:
    """Return an attrs field that holds a bool, also one of NumPy."""
    return _checked_field(
        default,
        lambda name, value: check_switch(
            name, bool(value) if isinstance(value, np.bool_) else value
        ),
    )


def integer(default: Any, low: int, high: int) -> Any:
    """Return an attrs field that holds an int from `low` to `high`. default: NOTHING = it must be
    given.
    """
    return _checked_field(default, lambda name, value: check_integer(name, value, low, high))


def _checked_field(default: Any, checked: Callable[[str, Any], Any]) -> Any:
    """Return an attrs field that holds what `checked` makes of a value; it takes the field's name,
    too.
    """

    def of_field(value: Any, attribute: "Attribute[Any]") -> Any:
        return None if value is None and default is None else checked(attribute.name, value)

    return field(default=default, converter=Converter(of_field, takes_field=True))


def shape_of(name: str, value: ArrayLike) -> tuple[int, ...]:
    """Return the shape of an array, or of lists that stand for one. Raises `InputError` for lists
    of different lengths.
    """
    try:
        return np.shape(value)
    except ValueError:
        raise InputError(
            f"{name}: has lists of different lengths, must be an array", field=name
        ) from None


def real_array(
    name: str,
    value: ArrayLike,
    shape: tuple[int, ...],
    low: float,
    high: float = inf,
    *,
    nan: bool = False,
) -> np.ndarray:
    """Return `value` as a read-only float64 array of `shape` (by broadcasting) within [`low`,
    `high`], or NaN with `nan`. What the mask of an array hides is NaN.
    """
    try:
        if np.iscomplexobj(value):
            raise TypeError
        array = np.asarray(_shown(value), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(
            f"{name}: must hold numbers {_range(low, high)}", field=name, low=low, high=high
        ) from None
    try:
        # a copy, so that the caller's array stays writable
        array = np.array(np.broadcast_to(array, shape), order="C")
    except ValueError:
        message = f"{name}: has shape {array.shape}, must be {shape} or broadcast to it"
        raise InputError(message, field=name) from None
    bad = ~(np.isfinite(array) & (array >= low) & (array <= high))
    if nan:
        bad &= ~np.isnan(array)
    if bad.any():
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        legal = _range(low, high).removeprefix("of ") + " or NaN" * nan
        message = f"{name}{list(where) or ''} = {array[where]}: must be {legal}"
        raise InputError(message, field=name, low=low, high=high)
    array.flags.writeable = False
    return array


def _shown(value: ArrayLike) -> ArrayLike:
    """Return an array with NaN in place of what its mask hides."""
    if isinstance(value, np.ma.MaskedArray):
        return np.where(np.ma.getmaskarray(value), np.nan, np.ma.getdata(value))
    return value


def given(value: ArrayLike) -> np.ndarray:
    """Converter of an attrs field that `__attrs_post_init__` turns into an array: keeps `value`,
    tells type checkers.
    """
    return value  # type: ignore[return-value]


def _range(low: float, high: float) -> str:
    if isfinite(high):
        return f"from {told_number(low)} to {told_number(high)}"
    return f"of at least {told_number(low)}" if isfinite(low) else "that is finite"
