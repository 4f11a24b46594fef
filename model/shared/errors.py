# SPDX-License-Identifier: Apache-2.0
"""The one exception that a user is meant to read, and checks that raise it: of integers, and of
optional packages.
"""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from numbers import Integral
from operator import index

TOLD_MAX = 100  # characters of a wrong value in a message
BEHIND_FIELD = (" = ", ": ", "[")  # what follows a field at the beginning of a message
SEED_MAX = (1 << 63) - 1  # highest seed of random numbers: it fits a column of int64


class InputError(ValueError):
    """Invalid input. The message names the field and its legal range; commands print it and exit
    with code 2.

    Attributes
    ----------
    field : str or None
        What is wrong, as the message names it at its beginning, such as "frame.period"; None if
        it is not a single field.
    low, high : float or None
        The legal range, if the field has one.
    """

    def __init__(
        self,
        message: str,
        *,
        field: str | None = None,
        low: float | None = None,
        high: float | None = None,
    ) -> None:
        super().__init__(message)
        self.field = field
        self.low = low
        self.high = high

    def within(self, where: object) -> "InputError":
        """Return the same error with the file or the point in which it was found in front of its
        message.
        """
        return InputError(f"{where}: {self}", field=self.field, low=self.low, high=self.high)

    def renamed(self, name: str) -> str:
        """Return the message with another name of the field, as a user knows it."""
        message = str(self)
        if self.field is None:
            return message
        behind = message.removeprefix(self.field)
        # a message may begin with a file, whose name may begin like the field
        return name + behind if behind.startswith(BEHIND_FIELD) else message


def told_number(value: float) -> str:
    """Return a number as text from which the same number comes back, as short as possible."""
    for text in (f"{value:g}", f"{value:.15g}"):
        if float(text) == value:
            return text
    return str(value)


def told_value(value: object) -> str:
    """Return a value as one line of a message. A long one is told by its first characters."""
    try:
        told = repr(value)
    except ValueError:  # Python does not write integers of thousands of digits
        return "a number of thousands of digits"
    if "\n" in told:  # an array
        told = " ".join(told.split())
    return told if len(told) <= TOLD_MAX else f"{told[:TOLD_MAX]} ..."


def wrong_value(
    name: str, value: object, legal: str, *, low: float | None = None, high: float | None = None
) -> InputError:
    """Return the error for the field `name` with an illegal `value`. legal: what it must be, as
    "an integer from 1 to 8".
    """
    return InputError(
        f"{name} = {told_value(value)}: must be {legal}", field=name, low=low, high=high
    )


def out_of_range(name: str, value: object, low: int, high: int, why: str = "") -> InputError:
    """Return the error for `name` = `value` outside [`low`, `high`]; `why` gives the reason for
    the range.
    """
    reason = f" ({why})" if why else ""
    return wrong_value(name, value, f"an integer from {low} to {high}{reason}", low=low, high=high)


def check_integer(name: str, value: object, low: int, high: int, why: str = "") -> int:
    """Return `value` as an int if it is an integer, also one of NumPy (a bool is not), from
    `low` to `high`. Raises `InputError`.
    """
    number = None
    if isinstance(value, Integral) and not isinstance(value, bool):
        with suppress(TypeError):  # NumPy's durations count as integers, too
            number = index(value)
    if number is None or not low <= number <= high:
        raise out_of_range(name, value, low, high, why)
    return number


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Context for importing the packages of the extra `name` of pyproject.toml. Raises
    `InputError` if one is missing.
    """
    try:
        yield
    except ModuleNotFoundError as missing:
        if str(missing.name).partition(".")[0] == "coincid":  # our own mistake
            raise
        raise InputError(
            f"{missing.name} is not installed; run: pip install 'coincid[{name}]'"
        ) from None
