# SPDX-License-Identifier: Apache-2.0
"""Settings as data: everything that files, registers, commands, explorer and documents say about
a key is in its `Setting`.

The attributes of `Sensor`, `FrameSettings` and `SubgroupSettings` carry it as metadata.
"""

import enum
import re
import tomllib
from typing import Any, TypeAlias

import numpy as np
from attrs import fields, frozen

from ..shared.errors import check_integer, wrong_value
from ..shared.quantities import check_choice, check_real, check_switch

NO_BIT = -1
Limit: TypeAlias = float | str  # a number, or the name of an attribute of `Sensor` that holds it


class Kind(enum.StrEnum):
    """What a file holds under a key."""

    INTEGER = "integer"
    REAL = "real"
    SWITCH = "switch"
    CHOICE = "choice"  # its register holds the number of the choice
    INTEGERS = "integers"  # a list of `count`
    SIZE = "size"  # [rows, cols]
    MASK = "mask"  # hex digits; bit i = pixel i


@frozen(kw_only=True)
class Setting:
    """A key of the configuration file.

    default: value of a key that is not written; it is never above the highest legal value.
    follows: key of [frame] whose value is the default. derived: the default is None, and the
    value then follows from the finished configuration; it counts something per frame. low, high:
    legal range. count: number of integers, and of words of the register. offset: place of the
    register, or of the first one, in its block. bit: place of a switch in the register `mode`.
    reset: value of the register after a reset; None: the default. last_choice_needs: the parameter
    that says whether the sensor has the last choice. needs: the parameter that says
    whether the sensor has this part; if it is 0, a switch must be off, and any other setting
    must be left out and has no register.
    """

    name: str
    table: str
    kind: Kind
    doc: str
    default: Any = None
    follows: str = ""
    derived: bool = False
    unit: str = ""
    low: Limit = 0
    high: Limit = 1
    choices: tuple[str, ...] = ()
    last_choice_needs: str = ""
    count: Limit = 1
    offset: int | None = None
    bit: int = NO_BIT
    reset: Limit | None = None
    needs: str = ""

    @property
    def key(self) -> str:
        """Return the key with its table, as messages have it."""
        return f"{self.table}.{self.name}"

    def limits(self, sensor: Any) -> tuple[Any, Any]:
        """Return the lowest and the highest legal value; of a choice, their numbers."""
        if self.kind is Kind.CHOICE:
            last_built = not self.last_choice_needs or getattr(sensor, self.last_choice_needs)
            return 0, len(self.choices) - (1 if last_built else 2)
        if self.kind is Kind.SWITCH:
            return 0, int(self.built(sensor))
        return number(self.low, sensor), number(self.high, sensor)

    def built(self, sensor: Any) -> bool:
        """Return whether the sensor has what this sets."""
        return not self.needs or bool(getattr(sensor, self.needs))

    def words(self, sensor: Any) -> int:
        """Return the number of its register's words."""
        return number(self.count, sensor) if self.kind is Kind.SWITCH or self.built(sensor) else 0

    def default_of(self, sensor: Any, frame: Any = None) -> Any:
        """Return the value of a key that is not written. frame: `FrameSettings`, for a key that
        follows one of them.
        """
        if self.kind is Kind.MASK:
            return f"{(1 << sensor.pixels) - 1:x}"
        default = getattr(frame, self.follows) if self.follows else self.default
        return (
            min(default, self.limits(sensor)[1])
            if self.kind is Kind.INTEGER and default is not None
            else default
        )

    def reset_of(self, sensor: Any, frame: Any) -> int:
        """Return the value of a word of its register after a reset. frame: `FrameSettings`,
        those of the reset.
        """
        if self.reset is not None:
            return int(number(self.reset, sensor))
        default = self.default_of(sensor, frame)
        return self.choices.index(default) if self.kind is Kind.CHOICE else int(default)

    def of_text(self, text: str) -> Any:
        """Return the value that a text stands for, as a file would hold it; nothing is checked."""
        if self.kind in (Kind.CHOICE, Kind.MASK):
            return text
        if self.kind is Kind.SIZE:
            text = f"[{text.strip('[]').replace('x', ',')}]"
        try:
            document = tomllib.loads(f"value = {text}")
            # further lines may name further keys
            return document["value"] if len(document) == 1 else text
        except (ValueError, RecursionError):  # no TOML, or more than Python reads
            return text

    def checked(self, where: str, value: Any, sensor: Any) -> Any:
        """Return the checked value of the key; the mask becomes bool[pixels]. Raises
        `InputError` that names `where`.
        """
        value = _plain(value)
        if value is None and self.derived:
            return None
        low, high = self.limits(sensor)
        match self.kind:
            case Kind.REAL:
                return check_real(where, value, low, high)
            case Kind.SWITCH:
                return check_switch(where, value)
            case Kind.CHOICE:
                return check_choice(where, value, self.choices)
            case Kind.INTEGERS:
                if not isinstance(value, list) or len(value) != self.count:
                    raise wrong_value(
                        where,
                        value,
                        f"{self.count} integers from {low} to {high}",
                        low=low,
                        high=high,
                    )
                return [check_integer(where, item, low, high) for item in value]
            case Kind.SIZE:
                return _checked_size(where, value, low, high)
            case Kind.MASK:
                return _checked_mask(where, value, sensor.pixels)
        return check_integer(where, value, low, high)


def number(limit: Limit, sensor: Any) -> Any:
    """Return the number that a limit stands for."""
    return getattr(sensor, limit) if isinstance(limit, str) else limit


def settings_of_class(of: type, table: str) -> dict[str, Setting]:
    """Return the settings that the attributes of a class describe, by name. table: of the
    configuration file.
    """
    return {
        a.name: Setting(name=a.name, table=table, **a.metadata) for a in fields(of) if a.metadata
    }


def _plain(value: Any) -> Any:
    """Return a value as a file would hold it: no NumPy types, no tuples."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def _checked_size(where: str, value: Any, low: int, high: int) -> tuple[int, int]:
    legal = (
        isinstance(value, list) and len(value) == 2 and all(type(n) is int and n > 0 for n in value)
    )
    if not legal or not low <= value[0] * value[1] <= high:
        raise wrong_value(
            where, value, f"[rows, cols] of {low} to {high} pixels", low=low, high=high
        )
    return value[0], value[1]


def _checked_mask(where: str, value: Any, pixels: int) -> np.ndarray:
    if (
        isinstance(value, list)
        and len(value) == pixels
        and all(isinstance(on, bool) for on in value)
    ):
        return np.array(value)
    if (
        not isinstance(value, str)
        or not re.fullmatch(r"(0[xX])?[0-9a-fA-F]+", value)
        or int(value, 16) >> pixels
    ):
        raise wrong_value(
            where, value, f"a string of hex digits below 2^{pixels} (bit i = pixel i)"
        )
    return np.array([int(value, 16) >> i & 1 for i in range(pixels)], bool)
