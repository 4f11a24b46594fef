# SPDX-License-Identifier: Apache-2.0
"""The register map for RTL, documentation, C header and test benches; registers of settings come from the settings' tables.

Addresses are bytes. The global block is at 0, the block of subgroup s at `SUBGROUP_BASE + SUBGROUP_STRIDE * s`. Ranges
and reset values that depend on the sensor's parameters are functions of `Sensor`. Settings take effect at the start of a
frame; counters are valid while the sensor is not busy.
"""

import enum
from collections.abc import Callable, Iterator

from attrs import field, frozen

from . import settings
from .counters import COUNTERS, EVENTS_MAX
from .parameters import SENSOR, Sensor
from .settings import SWITCHES, frame_defaults
from .table import Kind, Setting

DATA_BITS = 32
ADDRESS_BITS = 20
SUBGROUP_BASE = 0x1000
SUBGROUP_STRIDE = 0x80
ID_VALUE = 0x434F494E  # "COIN"
VERSION_VALUE = 0x00020003  # 16 bits each for major and minor; every change that software can see raises it

Value = Callable[[Sensor], int]


class Access(enum.Enum):
    """How software may use a register."""

    CONSTANT = "read-only, fixed by the build"
    SETTING = "read and write, taken at frame start"
    PULSE = "write 1 to act, reads 0"
    STATUS = "read; write 1 to clear the bits that allow it"
    COUNTER = "read-only, valid while not busy"


CONSTANT, SETTING, PULSE, STATUS, COUNTER = Access


def _value(value: int | Value) -> Value:
    return value if callable(value) else lambda _: value


@frozen
class Bits:
    """A named part of a register."""

    name: str
    lsb: int
    doc: str
    width: int = 1
    clears: bool = False  # writing 1 clears it


@frozen
class Register:
    """A register, or an array of `count` registers at consecutive words; none if it is not built. `low`, `high`: range that a write accepts."""

    name: str
    offset: int
    access: Access
    doc: str
    reset: Value = field(default=_value(0), converter=_value)
    low: Value = field(default=_value(0), converter=_value)
    high: Value = field(default=_value(0), converter=_value)
    count: Value = field(default=_value(1), converter=_value)
    bits: tuple[Bits, ...] = ()

    def bit(self, name: str) -> int:
        """Return the lowest bit of the part called `name`."""
        return next(bits.lsb for bits in self.bits if bits.name == name)


def _constants(setting: Setting) -> list[Register]:
    """Return the registers of a parameter of the sensor; a size has two."""
    name, offset = setting.name, setting.offset or 0
    if setting.kind is not Kind.SIZE:
        return [_constant(name, offset, setting.doc, lambda s: getattr(s, name))]
    return [
        _constant(f"{name}_rows", offset, f"SPAD rows of a {name}.", lambda s: getattr(s, name)[0]),
        _constant(f"{name}_cols", offset + 4, f"SPAD columns of a {name}.", lambda s: getattr(s, name)[1]),
    ]


def _constant(name: str, offset: int, doc: str, value: Value) -> Register:
    return Register(name, offset, CONSTANT, doc, reset=value)


def _settings(table: dict[str, Setting]) -> list[Register]:
    """Return the registers of a table of settings, by address."""
    found = [_setting(setting, setting.offset) for setting in table.values() if setting.offset is not None]
    return sorted(found, key=lambda register: register.offset)


def _setting(setting: Setting, offset: int) -> Register:
    return Register(
        setting.name,
        offset,
        SETTING,
        setting.doc,
        low=lambda s: setting.limits(s)[0],
        high=lambda s: setting.limits(s)[1],
        reset=lambda s: setting.reset_of(s, frame_defaults(s)),
        count=setting.words,
    )


GLOBAL: tuple[Register, ...] = (
    Register("id", 0x00, CONSTANT, "Identifies the sensor: COIN in ASCII.", reset=ID_VALUE),
    Register("version", 0x04, CONSTANT, "Version of this map: major << 16 | minor.", reset=VERSION_VALUE),
    *(register for setting in SENSOR.values() for register in _constants(setting)),
    Register(
        "control",
        0x40,
        PULSE,
        "Starts and ends a frame. A start that the checks refuse is answered with SLVERR and has no effect.",
        high=3,
        bits=(Bits("start", 0, "Begins a frame."), Bits("abort", 1, "Makes the running period the last of the frame.")),
    ),
    Register(
        "status",
        0x44,
        STATUS,
        "State and sticky errors.",
        high=0xFFFF_FFFF,
        bits=(
            Bits("busy", 0, "A frame is running or being delivered."),
            Bits("done", 1, "A frame has been delivered since this bit was cleared.", clears=True),
            Bits("bad_value", 2, "A write outside its register's range was refused.", clears=True),
            Bits(
                "bad_address",
                3,
                "An access to an unmapped address, or a write to a read-only one, was refused.",
                clears=True,
            ),
            Bits("bad_strobe", 4, "A write of less than the whole word was refused.", clears=True),
            Bits("start_busy", 5, "A start was refused: busy.", clears=True),
            Bits("start_period", 6, "A start was refused: the period is not above the guard G.", clears=True),
            Bits("start_bounds", 7, "A start was refused: auto_bounds descend.", clears=True),
            Bits("start_gate", 8, "A start was refused: gating on, gate_start not below the period.", clears=True),
            Bits(
                "start_upset",
                9,
                "A start was refused: a setting differs from what was written; write all settings again.",
                clears=True,
            ),
        ),
    ),
    *_settings(settings.FRAME),
    Register(
        "share",
        0x100,
        SETTING,
        "Threshold controller, stream i: capacity // number of its subgroups. First value and lower limit of the budget.",
        count=lambda s: s.streams * s.controller,
        high=EVENTS_MAX,
        reset=EVENTS_MAX,
    ),
    Register(
        "budget",
        0x200,
        COUNTER,
        "Threshold controller, stream i: a subgroup lowers its threshold if it would then commit no more events.",
        count=lambda s: s.streams * s.controller,
        reset=EVENTS_MAX,
    ),
    Register(
        "limit",
        0x300,
        COUNTER,
        "Threshold controller, stream i: a subgroup that commits more events raises its threshold.",
        count=lambda s: s.streams * s.controller,
        reset=EVENTS_MAX,
    ),
)

MODE = Register(
    "mode",
    0x00,
    SETTING,
    "The four modes are coincidence x gating.",
    high=lambda s: sum(switch.limits(s)[1] << switch.bit for switch in SWITCHES.values()),
    reset=sum(switch.default << switch.bit for switch in SWITCHES.values()),
    bits=tuple(Bits(name, switch.bit, switch.doc) for name, switch in SWITCHES.items()),
)

SUBGROUP: tuple[Register, ...] = (
    MODE,
    *_settings(settings.SUBGROUP),
    *(Register(name, 0x40 + 4 * i, COUNTER, doc) for i, (name, doc) in enumerate(COUNTERS)),
)

BY_NAME = {register.name: register for register in (*GLOBAL, *SUBGROUP)}
WRITABLE = (SETTING, PULSE, STATUS)


def built(table: tuple[Register, ...], sensor: Sensor) -> tuple[Register, ...]:
    """Return the registers that a sensor has."""
    return tuple(register for register in table if register.count(sensor))


def words(table: tuple[Register, ...], sensor: Sensor) -> Iterator[tuple[int, Register, int]]:
    """Yield (byte offset, register, index in its array) for every word of a block."""
    for register in table:
        for index in range(register.count(sensor)):
            yield register.offset + 4 * index, register, index


def address(name: str, subgroup: int = 0, index: int = 0) -> int:
    """Return the byte address of a register word; `subgroup` only counts for the registers of a subgroup."""
    register = BY_NAME[name]
    base = SUBGROUP_BASE + SUBGROUP_STRIDE * subgroup if register in SUBGROUP else 0
    return base + register.offset + 4 * index


def control(bit: str) -> tuple[int, int]:
    """Return (address, value) of the write that sets a bit of `control`: `start` or `abort`."""
    return address("control"), 1 << BY_NAME["control"].bit(bit)


def reset_values(sensor: Sensor) -> dict[int, int]:
    """Return byte address -> value after reset, for the words of every setting."""
    values: dict[int, int] = {}
    for table, subgroups in ((GLOBAL, 1), (SUBGROUP, sensor.subgroups)):
        for _, register, index in words(table, sensor):
            if register.access is SETTING:
                values |= {address(register.name, s, index): register.reset(sensor) for s in range(subgroups)}
    return values
