# SPDX-License-Identifier: Apache-2.0
"""The register map for RTL, documentation, C header and test benches; registers of settings come
from the settings' tables.

Addresses are bytes. The global block is at 0, the block of subgroup s at
`SUBGROUP_BASE + SUBGROUP_STRIDE * s`. Ranges and reset values that depend on the sensor's
parameters are functions of `Sensor`. Settings take effect at the start of a frame; counters are
valid while the sensor is not busy.
"""

import enum
from collections.abc import Callable, Iterator
from operator import attrgetter

from attrs import field, frozen

from ..shared.errors import wrong_value
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
# 16 bits each for major and minor; every change that software can see raises it.
VERSION_VALUE = 0x00020005  # of a sensor without counts
VERSION_WITH_COUNTS = 0x00020006

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
    """A register, or an array of `count` registers at consecutive words; none if it is not
    built. `low`, `high`: range that a write accepts.
    """

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


def _registers(table: dict[str, Setting]) -> list[Register]:
    """Return the registers of a table of settings, by address."""
    placed = {one.offset: one for one in table.values() if one.offset is not None}
    return [
        register for offset in sorted(placed) for register in _of_setting(placed[offset], offset)
    ]


def _of_setting(of: Setting, offset: int) -> list[Register]:
    """Return the registers of a setting or of a parameter of the sensor; a size has two."""
    name, doc = of.name, of.doc
    if of.kind is Kind.SIZE:
        rows, cols = f"SPAD rows of a {name}.", f"SPAD columns of a {name}."
        return [
            Register(f"{name}_rows", offset, CONSTANT, rows, lambda s: getattr(s, name)[0]),
            Register(f"{name}_cols", offset + 4, CONSTANT, cols, lambda s: getattr(s, name)[1]),
        ]
    if of.table == "sensor":
        return [Register(name, offset, CONSTANT, doc, attrgetter(name), count=of.words)]
    register = Register(
        name,
        offset,
        SETTING,
        doc,
        reset=lambda s: of.reset_of(s, frame_defaults(s)),
        low=lambda s: of.limits(s)[0],
        high=lambda s: of.limits(s)[1],
        count=of.words,
    )
    return [register]


def _of_stream(name: str, offset: int, access: Access, doc: str, high: int = 0) -> Register:
    """Return a register of the threshold controller, of which a sensor has one per stream."""
    doc = f"Threshold controller, stream i: {doc}"
    return Register(
        name, offset, access, doc, EVENTS_MAX, high=high, count=lambda s: s.streams * s.controller
    )


_STICKY = {  # from bit 1 of the status on: bits that stay until software clears them
    "done": "A frame has been delivered since this bit was cleared.",
    "bad_value": "A write outside its register's range was refused.",
    "bad_address": "An access to an unmapped address, or a write to a read-only one, was refused.",
    "bad_strobe": "A write of less than the whole word was refused.",
    "start_busy": "A start was refused: busy.",
    "start_period": "A start was refused: the period is not above the guard G.",
    "start_bounds": "A start was refused: auto_bounds descend.",
    "start_gate": "A start was refused: gating on, gate_start not below the period.",
    "start_upset": "A start was refused: a setting differs from what was written; write all settings again.",
}
GLOBAL: tuple[Register, ...] = (
    Register("id", 0x00, CONSTANT, "Identifies the sensor: COIN in ASCII.", reset=ID_VALUE),
    Register(
        "version",
        0x04,
        CONSTANT,
        "Version of this map: major << 16 | minor.",
        reset=lambda s: VERSION_WITH_COUNTS if s.counts else VERSION_VALUE,
    ),
    *_registers(SENSOR),
    Register(
        "control",
        0x40,
        PULSE,
        "Starts and ends a frame, and resets the sensor. A start that the checks refuse is answered "
        "with SLVERR and has no effect.",
        high=7,
        bits=(
            Bits("start", 0, "Begins a frame."),
            Bits(
                "abort",
                1,
                "Makes the running period the last of the frame; in a gap, ends the frame. Ignored"
                " beside start.",
            ),
            Bits(
                "reset",
                2,
                "Resets everything except the register bus, as rst does; start and abort are ignored.",
            ),
        ),
    ),
    Register(
        "status",
        0x44,
        STATUS,
        "State and sticky errors.",
        high=0xFFFF_FFFF,
        bits=(
            Bits("busy", 0, "A frame is running or being delivered."),
            *(
                Bits(name, lsb, doc, clears=True)
                for lsb, (name, doc) in enumerate(_STICKY.items(), start=1)
            ),
        ),
    ),
    *_registers(settings.FRAME),
    _of_stream(
        "share",
        0x100,
        SETTING,
        "capacity // number of its subgroups. First value and lower limit of the budget.",
        high=EVENTS_MAX,
    ),
    _of_stream(
        "budget",
        0x200,
        COUNTER,
        "a subgroup lowers its threshold if it would then commit no more events.",
    ),
    _of_stream(
        "limit", 0x300, COUNTER, "a subgroup that commits more events raises its threshold."
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
    *_registers(settings.SUBGROUP),
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
    """Return the byte address of a register word; `subgroup` only counts for the registers of a
    subgroup. Raises `InputError` for a name that no register has.
    """
    register = BY_NAME.get(name) if isinstance(name, str) else None
    if register is None:
        raise wrong_value("name", name, f"one of {', '.join(BY_NAME)}")
    base = SUBGROUP_BASE + SUBGROUP_STRIDE * subgroup if register in SUBGROUP else 0
    return base + register.offset + 4 * index


def control(bit: str) -> tuple[int, int]:
    """Return (address, value) of the write that sets a bit of `control`: `start`, `abort` or
    `reset`.
    """
    return address("control"), 1 << BY_NAME["control"].bit(bit)


def reset_values(sensor: Sensor) -> dict[int, int]:
    """Return byte address -> value after reset, for the words of every setting."""
    values: dict[int, int] = {}
    for table, subgroups in ((GLOBAL, 1), (SUBGROUP, sensor.subgroups)):
        for _, register, index in words(table, sensor):
            if register.access is SETTING:
                values |= {
                    address(register.name, s, index): register.reset(sensor)
                    for s in range(subgroups)
                }
    return values
