# SPDX-License-Identifier: Apache-2.0
"""The one exception that a user is meant to read, and checks that raise it: of integers, and of optional packages."""

from collections.abc import Iterator
from contextlib import contextmanager

SEED_MAX = (1 << 63) - 1  # highest seed of random numbers: it fits a column of int64


class InputError(ValueError):
    """Invalid input. The message names the field and its legal range; commands print it and exit with code 2."""


def out_of_range(name: str, value: object, low: int, high: int, why: str = "") -> InputError:
    """Return the error for `name` = `value` outside [`low`, `high`]; `why` gives the reason for the range."""
    return InputError(f"{name} = {value!r}: must be an integer from {low} to {high}{f' ({why})' if why else ''}")


def check_integer(name: str, value: object, low: int, high: int, why: str = "") -> int:
    """Return `value` if it is an integer (a bool is not) from `low` to `high`. Raises `InputError`."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise out_of_range(name, value, low, high, why)
    return value


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Context for importing the packages of the extra `name` of pyproject.toml. Raises `InputError` if one is missing."""
    try:
        yield
    except ModuleNotFoundError as missing:
        if str(missing.name).partition(".")[0] == "coincid":  # our own mistake
            raise
        raise InputError(f"{missing.name} is not installed; run: pip install 'coincid[{name}]'") from None
