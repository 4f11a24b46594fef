# SPDX-License-Identifier: Apache-2.0
"""The register map: one table for RTL, configuration files, documentation, C header and test benches.

Addresses are bytes. The global block is at 0, the block of subgroup s at `SUBGROUP_BASE + SUBGROUP_STRIDE * s`. Ranges
and reset values that depend on the sensor's parameters are functions of `Sensor`. Settings take effect at the start of a
frame; counters are valid while the sensor is not busy.
"""

import enum
from collections.abc import Callable, Iterator

from attrs import field, frozen

from .dither import DITHER_BITS_MAX, LFSR_BITS
from .parameters import Sensor

DATA_BITS = 32
ADDRESS_BITS = 20
SUBGROUP_BASE = 0x1000
SUBGROUP_STRIDE = 0x80
MASK_BITS = 32
COUNTER_BITS = 32
AUTO_BOUNDS = 6
ID_VALUE = 0x434F494E  # "COIN"
VERSION_VALUE = 0x00020000  # 16 bits each for major and minor; every change that software can see raises it
THRESHOLD_MAX = 1 + AUTO_BOUNDS  # highest threshold of the controller
EVENTS_MAX = (1 << COUNTER_BITS) - 1  # saturation value of a counter

Value = Callable[[Sensor], int]


class Access(enum.Enum):
    """How software may use a register."""

    CONSTANT = "read-only, fixed by the build"
    SETTING = "read and write, taken at frame start"
    PULSE = "write 1 to act, reads 0"
    STATUS = "read; write 1 to clear the bits that allow it"
    COUNTER = "read-only, valid while not busy"


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


@frozen(kw_only=True)
class Register:
    """A register, or an array of `count` registers at consecutive words. `low`, `high`: range that a write accepts."""

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


def _gate_doc(what: str) -> str:
    return f"Gate: {what}, in cycles."


def _mask_words(sensor: Sensor) -> int:
    return -(-sensor.pixels // MASK_BITS)


def _mask_full(sensor: Sensor) -> int:
    return (1 << min(MASK_BITS, sensor.pixels)) - 1


_CONSTANTS: tuple[tuple[str, str, Value], ...] = (
    ("rows", "SPAD rows of the sensor.", lambda s: s.rows),
    ("cols", "SPAD columns of the sensor.", lambda s: s.cols),
    ("phases", "Ticks (TDC LSBs) per clock cycle.", lambda s: s.phases),
    ("coarse_bits", "Width of the TDC's coarse counter.", lambda s: s.coarse_bits),
    ("window_max", "Longest coincidence window in ticks.", lambda s: s.window_max),
    ("rearm", "Re-arm gap R in cycles.", lambda s: s.rearm),
    ("fifo_depth", "Events that a subgroup's FIFO holds.", lambda s: s.fifo_depth),
    ("streams", "AXI4-Streams.", lambda s: s.streams),
    ("subgroup_rows", "SPAD rows of a subgroup.", lambda s: s.subgroup[0]),
    ("subgroup_cols", "SPAD columns of a subgroup.", lambda s: s.subgroup[1]),
    ("minigroup_rows", "SPAD rows of a minigroup.", lambda s: s.minigroup[0]),
    ("minigroup_cols", "SPAD columns of a minigroup.", lambda s: s.minigroup[1]),
    ("offset_phases", "Steps per clock cycle of the coarse offsets.", lambda s: s.offset_phases),
)

GLOBAL: tuple[Register, ...] = (
    Register(
        name="id", offset=0x00, access=Access.CONSTANT, doc="Identifies the sensor: COIN in ASCII.", reset=ID_VALUE
    ),
    Register(
        name="version",
        offset=0x04,
        access=Access.CONSTANT,
        doc="Version of this map: major << 16 | minor.",
        reset=VERSION_VALUE,
    ),
    *(
        Register(name=name, offset=0x08 + 4 * i, access=Access.CONSTANT, doc=doc, reset=value)
        for i, (name, doc, value) in enumerate(_CONSTANTS)
    ),
    Register(
        name="control",
        offset=0x40,
        access=Access.PULSE,
        high=3,
        doc="Starts and ends a frame. A start that the checks refuse is answered with SLVERR and has no effect.",
        bits=(Bits("start", 0, "Begins a frame."), Bits("abort", 1, "Makes the running period the last of the frame.")),
    ),
    Register(
        name="status",
        offset=0x44,
        access=Access.STATUS,
        high=0xFFFF_FFFF,
        doc="State and sticky errors.",
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
    Register(
        name="period",
        offset=0x48,
        access=Access.SETTING,
        doc="Laser period in cycles. Must be above the guard G at a start.",
        low=1,
        high=lambda s: s.period_max,
        reset=lambda s: min(250, s.period_max),
    ),
    Register(
        name="pulses",
        offset=0x4C,
        access=Access.SETTING,
        doc="Number of laser periods in a frame.",
        low=1,
        high=1 << 16,
        reset=100,
    ),
    Register(
        name="format",
        offset=0x50,
        access=Access.SETTING,
        high=2,
        reset=1,
        doc="Event words: 0 short, 1 id (map), 2 full (map and offsets).",
    ),
    Register(
        name="minigroup_records",
        offset=0x54,
        access=Access.SETTING,
        high=1,
        doc="1: minigroups have their own stamps, and a subgroup sends at most one record per period.",
    ),
    Register(
        name="mg_threshold",
        offset=0x58,
        access=Access.SETTING,
        doc="Number of distinct pixels at which a minigroup latches.",
        low=1,
        high=lambda s: s.minigroup_pixels,
        reset=lambda s: min(2, s.minigroup_pixels),
    ),
    Register(
        name="mg_window",
        offset=0x5C,
        access=Access.SETTING,
        doc="Cycles of a minigroup's collection.",
        low=1,
        high=4,
        reset=2,
    ),
    Register(
        name="gate_step",
        offset=0x60,
        access=Access.SETTING,
        doc="Progressive gating: shift per step, in cycles.",
        high=0xFFFF,
    ),
    Register(
        name="gate_every",
        offset=0x64,
        access=Access.SETTING,
        high=0xFFFF,
        doc="Progressive gating: pulses per step; 0 turns it off.",
    ),
    Register(
        name="gate_steps",
        offset=0x68,
        access=Access.SETTING,
        low=1,
        high=0xFFFF,
        reset=1,
        doc="Progressive gating: number of steps before it starts over.",
    ),
    Register(
        name="auto_bounds",
        offset=0x6C,
        access=Access.SETTING,
        count=AUTO_BOUNDS,
        high=0xFFFF_FFFF,
        doc="Threshold controller: the threshold is at most 1 + the number of bounds that `opened` of the previous frame reaches. Must not descend.",
    ),
    Register(
        name="dither_bits",
        offset=0x84,
        access=Access.SETTING,
        high=DITHER_BITS_MAX,
        doc="Number of LFSR bits that give the wait between two periods, in cycles; 0: no wait.",
    ),
    Register(
        name="dither_seed",
        offset=0x88,
        access=Access.SETTING,
        low=1,
        high=(1 << LFSR_BITS) - 1,
        reset=1,
        doc="State of that LFSR at the beginning of the frame.",
    ),
    Register(
        name="capacity",
        offset=0x8C,
        access=Access.SETTING,
        high=EVENTS_MAX,
        reset=EVENTS_MAX,
        doc="Threshold controller: events that a stream carries in a frame.",
    ),
    Register(
        name="threshold_floor",
        offset=0x90,
        access=Access.SETTING,
        high=THRESHOLD_MAX,
        reset=1,
        doc="Threshold controller: the lowest threshold; 0 has the effect of 1.",
    ),
    Register(
        name="share",
        offset=0x100,
        access=Access.SETTING,
        count=lambda s: s.streams,
        high=EVENTS_MAX,
        reset=EVENTS_MAX,
        doc="Threshold controller, stream i: capacity // number of its subgroups. First value and lower limit of the budget.",
    ),
    Register(
        name="budget",
        offset=0x200,
        access=Access.COUNTER,
        count=lambda s: s.streams,
        reset=EVENTS_MAX,
        doc="Threshold controller, stream i: events that each of its subgroups may send in a frame.",
    ),
)

COUNTERS: tuple[tuple[str, str], ...] = (  # in the order of the frame end packet
    ("opened", "Coincidence windows opened."),
    ("committed", "Windows that met the threshold."),
    ("rejected", "Windows that did not meet the threshold."),
    ("stored", "Events written to the FIFO."),
    ("dropped", "Events lost to a full FIFO."),
    ("blind", "Cycles with an edge while the tree was not armed."),
    ("photons", "Sum of the counts of all windows."),
    ("mg_stored", "Minigroup records written."),
    ("mg_dropped", "Minigroup records lost because the previous one was still waiting."),
    ("threshold_used", "Threshold of the frame: from the register or from the controller."),
    ("lower", "Windows that met the threshold minus one."),
)
COUNTER_NAMES = tuple(name for name, _ in COUNTERS)

SUBGROUP: tuple[Register, ...] = (
    Register(
        name="mode",
        offset=0x00,
        access=Access.SETTING,
        high=7,
        reset=1,
        doc="The four modes are coincidence x gating.",
        bits=(
            Bits("coincidence", 0, "0: winner takes all (window 1, threshold 1)."),
            Bits("gating", 1, "1: edges outside the gate are ignored."),
            Bits("auto", 2, "1: the controller sets the threshold."),
        ),
    ),
    Register(
        name="threshold",
        offset=0x04,
        access=Access.SETTING,
        doc="Number of distinct pixels that make a coincidence.",
        low=1,
        high=lambda s: s.pixels,
        reset=2,
    ),
    Register(
        name="window",
        offset=0x08,
        access=Access.SETTING,
        doc="Coincidence window in ticks.",
        low=1,
        high=lambda s: s.window_max,
        reset=lambda s: min(16, s.window_max),
    ),
    Register(name="gate_start", offset=0x0C, access=Access.SETTING, doc=_gate_doc("first cycle"), high=0xFFFF),
    Register(
        name="gate_len",
        offset=0x10,
        access=Access.SETTING,
        doc=_gate_doc("length"),
        high=0xFFFF,
        reset=lambda s: min(250, s.period_max),
    ),
    Register(
        name="mask",
        offset=0x14,
        access=Access.SETTING,
        count=_mask_words,
        high=_mask_full,
        reset=_mask_full,
        doc="Pixel mask: bit i of word w is pixel 32 w + i; 1 = on.",
    ),
    *(
        Register(name=name, offset=0x40 + 4 * i, access=Access.COUNTER, doc=doc)
        for i, (name, doc) in enumerate(COUNTERS)
    ),
)

BY_NAME = {register.name: register for register in (*GLOBAL, *SUBGROUP)}
WRITABLE = (Access.SETTING, Access.PULSE, Access.STATUS)
MODE = BY_NAME["mode"]


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
            if register.access is Access.SETTING:
                values |= {address(register.name, s, index): register.reset(sensor) for s in range(subgroups)}
    return values
