# SPDX-License-Identifier: Apache-2.0
"""Registers by name: finds the word of `sensor["threshold", 3]` in the table of `model/contract/registers.py`."""

from typing import TypeAlias

from attrs import frozen

from ..model.contract import registers
from ..model.contract.parameters import Sensor
from ..model.contract.registers import WRITABLE, Register
from ..model.shared.errors import InputError, check_integer

Key: TypeAlias = str | tuple[str | int, ...]


@frozen
class Word:
    """A word of the register map. name: as shown in messages; low, high: range that a write accepts."""

    name: str
    address: int
    register: Register
    low: int
    high: int

    @classmethod
    def of(cls, name: str, address: int, register: Register, sensor: Sensor) -> "Word":
        """Return a word of a register."""
        return cls(name, address, register, register.low(sensor), register.high(sensor))

    def checked(self, value: object) -> int:
        """Return `value` if the sensor accepts it. Raises `InputError` with register and range."""
        if self.register.access not in WRITABLE:
            raise InputError(f"{self.name}: is read-only ({self.register.access.value})")
        number = int(value) if hasattr(value, "__index__") and not isinstance(value, bool) else value
        return check_integer(self.name, number, self.low, self.high)


def find(sensor: Sensor, key: Key) -> Word:
    """Return the word that `key` names: a register's name and, if it has them, the subgroup and the index in its array.

    Examples: `"period"`; `("auto_bounds", 2)`; `("threshold", 3)` of subgroup 3; `("mask", 3, 1)`, word 1 of subgroup
    3's mask. A missing index is 0. Raises `InputError` with the wrong part and the legal range.
    """
    name, *numbers = key if isinstance(key, tuple) else (key,)
    register = registers.BY_NAME.get(str(name))
    if register is None:
        raise InputError(f"register {name!r}: must be one of {', '.join(registers.BY_NAME)}")
    if not register.count(sensor):
        raise InputError(f"register {name!r}: the sensor is built without it")
    of_subgroup = register in registers.SUBGROUP
    subgroup = index = 0
    if of_subgroup:
        if not numbers:
            raise InputError(f"register {name!r}: is one per subgroup, must be written as [{name!r}, subgroup]")
        subgroup = check_integer(f"{name}: subgroup", numbers.pop(0), 0, sensor.subgroups - 1)
    if numbers:
        index = check_integer(f"{name}: index", numbers.pop(0), 0, register.count(sensor) - 1)
    if numbers:
        raise InputError(f"register {name!r}: {key!r} has too many indices")
    shown = [subgroup] * of_subgroup + [index] * (register.count(sensor) > 1)
    return Word.of(f"{name}{shown or ''}", registers.address(register.name, subgroup, index), register, sensor)
