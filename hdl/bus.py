# SPDX-License-Identifier: Apache-2.0
"""Layouts of the signals between the blocks: timing, settings, events. `model/contract/latency.py`
gives their timing.
"""

from enum import unique

from amaranth.hdl import Mux, Value
from amaranth.lib import data, enum

from ..model.contract import counts
from ..model.contract.packet import BEAT_BITS, COUNTS, FORMAT_NAMES, HEADER
from ..model.contract.parameters import Sensor, bits_for
from ..model.contract.registers import BY_NAME, DATA_BITS, SUBGROUP_STRIDE
from ..model.contract.settings import SUBGROUP
from ..model.contract.table import Kind

SUBGROUP_BITS = HEADER["subgroup"][1]
PULSE_BITS = HEADER["pulse"][1]
# Width of a word's number within a subgroup's register block.
WORD_BITS = bits_for(SUBGROUP_STRIDE // 4 - 1)
FRAME_SETTINGS = ("format", "minigroup_records", "mg_threshold", "mg_window")
PLAN_SETTINGS = (
    "period",
    "pulses",
    "gate_step",
    "gate_every",
    "gate_steps",
    "gap",
    "dither_bits",
    "dither_seed",
)


# Amaranth's enumeration, with a shape.
@unique
class Operation(enum.Enum, shape=4):  # type: ignore[call-arg]
    """Commands of the configuration bus to every subgroup.

    All codes have even parity, so an upset code does nothing.
    """

    IDLE = 0b0000
    WRITE = 0b0011  # write data to a word of one subgroup
    TAKE = 0b0101  # the programmed settings take effect for the frame
    # Data is the budget of the stream that begins with this subgroup; earlier streams ignore it.
    BUDGET = 0b0110
    LIMIT = 0b1111  # likewise, data is its limit
    COMPARE = 0b1001  # data is a bound of the threshold controller
    # The registers are accessed: wake up, and show the word if it is this subgroup's.
    ACCESS = 0b1100
    # Begin the frame: clear the counters, set the threshold; data is the controller's lowest one.
    BEGIN = 0b1010


@unique
class Send(enum.Enum, shape=2):  # type: ignore[call-arg]
    """Kinds of packet that the readout grants."""

    EVENT = 0
    RECORD = 1
    COUNTERS = 2
    COUNTS = 3  # of the subgroup's next minigroup


@unique
class Step(enum.Enum, shape=2):  # type: ignore[call-arg]
    """Steps of a frame of counts."""

    NONE = 0  # the frame has events
    WIDE = 1  # hits fill wide bins
    NARROW = 2  # hits fill narrow bins in the regions
    GATED = 3  # pixels count their hits in the gates


def step_after(step: Value) -> Value:
    """Return the step of a frame of counts that follows step 1 or 2."""
    return Mux(step == Step.WIDE, Step.NARROW, Step.GATED)


def is_counts(form: Value) -> Value:
    """Return whether the format register selects counts."""
    return form == FORMAT_NAMES.index(COUNTS.name)


# parity: of a write's data when they arrived at the register port.
CONFIG_BUS = data.StructLayout(
    {
        "operation": Operation,
        "subgroup": SUBGROUP_BITS,
        "word": WORD_BITS,
        "data": DATA_BITS,
        "parity": 1,
    }
)
# A beat of counters on its way out. `controlled`: the threshold controller sets the threshold of
# its subgroup.
COUNTED = data.StructLayout({"valid": 1, "beat": BEAT_BITS, "controlled": 1})

# Of the time layout; the shift changes with `start`.
_STROBES = (
    "running",
    "start",
    "wrap",
    "may_open",
)


def strobes(sensor: Sensor) -> tuple[str, ...]:
    """Return the strobes of the time layout."""
    return (*_STROBES, "search") if sensor.counts else _STROBES


def time_layout(sensor: Sensor) -> data.StructLayout:
    """The sequencer's word for one cycle, three cycles ahead of the ports.

    running: the cycle belongs to a frame. start: it is the first of a period. wrap: the previous
    cycle was the last of a period. may_open: windows may open. search: the previous cycle was the
    last of step 1 or 2 of a frame of counts. shift: shift of the progressive gate in cycles,
    saturated at 2^coarse_bits.
    """
    bits = dict.fromkeys(strobes(sensor), 1)
    return data.StructLayout(bits | {"shift": sensor.coarse_bits + 1})


def frame_layout(sensor: Sensor) -> data.StructLayout:
    """Frame settings that subgroups and readout use."""
    return _registers_layout(sensor, FRAME_SETTINGS)


def plan_layout(sensor: Sensor) -> data.StructLayout:
    """Frame settings that the sequencer uses."""
    of_counts = ("format", "search_pulses") if sensor.counts else ()
    return _registers_layout(sensor, PLAN_SETTINGS + of_counts)


def _registers_layout(sensor: Sensor, names: tuple[str, ...]) -> data.StructLayout:
    """Global registers, each as wide as its highest legal value."""
    return data.StructLayout({name: bits_for(BY_NAME[name].high(sensor)) for name in names})


def settings_layout(sensor: Sensor) -> data.StructLayout:
    """The settings of a subgroup; the switch of a block that is not built has no bit."""
    return data.StructLayout(
        {
            name: sensor.pixels
            if setting.kind is Kind.MASK
            else setting.limits(sensor)[1].bit_length()
            for name, setting in SUBGROUP.items()
        }
    )


def window_layout(sensor: Sensor) -> data.StructLayout:
    """A closed coincidence window."""
    return data.StructLayout(
        {
            "stamp": sensor.stamp_bits,
            "count": sensor.count_bits,
            "winner": sensor.winner_bits,
            "hits": sensor.pixels,
        }
    )


def offsets_layout(sensor: Sensor) -> data.ArrayLayout:
    """Coarse offsets of a window's minigroups; undefined for minigroups that are not in its map."""
    return data.ArrayLayout(sensor.offset_bits, sensor.minigroups)


def event_layout(sensor: Sensor) -> data.StructLayout:
    """An event as the FIFO stores it; it has offsets only if they are built."""
    offsets = {"offsets": offsets_layout(sensor)} if sensor.offsets else {}
    return data.StructLayout(
        {"window": window_layout(sensor), **offsets, "pulse": PULSE_BITS, "overrun": 1}
    )


def minigroup_counts_layout(sensor: Sensor) -> data.StructLayout:
    """The counts of a minigroup as they leave: first cycles of its gates, numbers of pulses of its
    pixels, and a row of its memory.
    """
    return data.StructLayout(
        {
            "gates": counts.GATES * counts.GATE_BITS,
            "pulses": sensor.minigroup_pixels * PULSE_BITS,
            "row": counts.ROW_BITS,
        }
    )


def entry_layout(sensor: Sensor) -> data.StructLayout:
    """A minigroup's entry in a record; a map of 0 means that it has not latched."""
    return data.StructLayout({"stamp": sensor.record_stamp_bits, "map": sensor.minigroup_pixels})


def record_layout(sensor: Sensor) -> data.StructLayout:
    """A minigroup record."""
    return data.StructLayout(
        {"entries": data.ArrayLayout(entry_layout(sensor), sensor.minigroups), "pulse": PULSE_BITS}
    )
