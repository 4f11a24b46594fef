# SPDX-License-Identifier: Apache-2.0
"""What runs between the blocks: timing, settings, events. Layouts only; `latency.py` of the model says when."""

from amaranth.lib import data, enum

from ..model.contract.packet import BEAT_BITS, HEADER
from ..model.contract.parameters import Sensor, bits_for
from ..model.contract.registers import BY_NAME, DATA_BITS, SUBGROUP_STRIDE

SUBGROUP_BITS = HEADER["subgroup"][1]
PULSE_BITS = HEADER["pulse"][1]
KIND_BITS = HEADER["kind"][1]
WORD_BITS = bits_for(SUBGROUP_STRIDE // 4 - 1)  # of a word's number in a subgroup's register block
GATE_BITS = 16
FRAME_SETTINGS = ("format", "minigroup_records", "mg_threshold", "mg_window")
PLAN_SETTINGS = ("period", "pulses", "gate_step", "gate_every", "gate_steps", "dither_bits", "dither_seed")


class Operation(enum.Enum, shape=4):  # type: ignore[call-arg]  # Amaranth's enumeration, with a shape
    """What the configuration bus asks of every subgroup. Codes of even parity: one that is upset asks for nothing."""

    IDLE = 0b0000
    WRITE = 0b0011  # data to a word of one subgroup
    TAKE = 0b0101  # programmed settings become the frame's
    BUDGET = 0b0110  # data is the budget of the stream that begins with the subgroup, and of no stream before it
    COMPARE = 0b1001  # data is a bound of the threshold controller
    BEGIN = 0b1010  # the frame begins: threshold set, not below data where the controller sets it, and counters cleared


class Send(enum.Enum, shape=2):  # type: ignore[call-arg]
    """What the readout grants."""

    EVENT = 0
    RECORD = 1
    COUNTERS = 2


# parity: of the data of a write, as they stood at the register port.
CONFIG_BUS = data.StructLayout(
    {"operation": Operation, "subgroup": SUBGROUP_BITS, "word": WORD_BITS, "data": DATA_BITS, "parity": 1}
)
# A beat of counters on its way out, and whether they are of a subgroup whose thresholds the controller sets.
COUNTED = data.StructLayout({"valid": 1, "beat": BEAT_BITS, "controlled": 1})


def time_layout(sensor: Sensor) -> data.StructLayout:
    """The sequencer's word for a cycle, three cycles ahead of the ports.

    running: the cycle belongs to a frame. start: it is a period's first. wrap: the cycle before it was a period's last.
    may_open: windows may open. shift: progressive gating's shift in cycles, saturated at 2^coarse_bits.
    """
    return data.StructLayout({"running": 1, "start": 1, "wrap": 1, "may_open": 1, "shift": sensor.coarse_bits + 1})


def frame_layout(sensor: Sensor) -> data.StructLayout:
    """Frame settings that subgroups and readout use."""
    return _registers_layout(sensor, FRAME_SETTINGS)


def plan_layout(sensor: Sensor) -> data.StructLayout:
    """Frame settings that the sequencer uses."""
    return _registers_layout(sensor, PLAN_SETTINGS)


def _registers_layout(sensor: Sensor, names: tuple[str, ...]) -> data.StructLayout:
    """Global registers, as wide as their highest legal value."""
    return data.StructLayout({name: bits_for(BY_NAME[name].high(sensor)) for name in names})


def settings_layout(sensor: Sensor) -> data.StructLayout:
    """A subgroup's settings."""
    return data.StructLayout(
        {
            "coincidence": 1,
            "gating": 1,
            "auto": 1,
            "threshold": sensor.count_bits,
            "window": sensor.window_bits,
            "gate_start": GATE_BITS,
            "gate_len": GATE_BITS,
            "mask": sensor.pixels,
        }
    )


def window_layout(sensor: Sensor) -> data.StructLayout:
    """A closed coincidence window."""
    return data.StructLayout(
        {"stamp": sensor.stamp_bits, "count": sensor.count_bits, "winner": sensor.winner_bits, "hits": sensor.pixels}
    )


def offsets_layout(sensor: Sensor) -> data.ArrayLayout:
    """Coarse offsets of a window's minigroups; of those that are not in its map they are undefined."""
    return data.ArrayLayout(sensor.offset_bits, sensor.minigroups)


def event_layout(sensor: Sensor) -> data.StructLayout:
    """What the FIFO stores."""
    return data.StructLayout(
        {"window": window_layout(sensor), "offsets": offsets_layout(sensor), "pulse": PULSE_BITS, "overrun": 1}
    )


def entry_layout(sensor: Sensor) -> data.StructLayout:
    """A minigroup's entry in a record; map 0: not latched."""
    return data.StructLayout({"stamp": sensor.record_stamp_bits, "map": sensor.minigroup_pixels})


def record_layout(sensor: Sensor) -> data.StructLayout:
    """A minigroup record."""
    return data.StructLayout(
        {"entries": data.ArrayLayout(entry_layout(sensor), sensor.minigroups), "pulse": PULSE_BITS}
    )
