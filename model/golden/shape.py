# SPDX-License-Identifier: Apache-2.0
"""The part of a configuration that the kernels of the golden model need, as plain numbers."""

from collections import namedtuple
from typing import Any

import numpy as np

from ..contract import latency
from ..contract.config import Config
from ..contract.counters import COUNTER_NAMES
from ..contract.groups import group_widths
from ..contract.packet import BEAT_BITS, FORMATS, FRAME_START, RECORD, Packet, layout, parts_of
from ..contract.parameters import Sensor, bits_for

_OF_SENSOR = (  # fields that are attributes of `Sensor`
    "subgroups pixels minigroups phases phase_bits rearm fifo_depth record_bits record_stamp_bits winner_bits offset_bits"
    " counter_max"
)
Shape = namedtuple(
    "Shape",
    "subgroups pixels minigroups phases phase_bits quarter_bits offset_tick_bits period open_cycles rearm fifo_depth "
    "minigroup_records mg_threshold mg_window record_bits record_stamp_bits "
    "event_code event_parts event_beats event_has_offsets grouped hits_words record_parts record_beats frame_parts "
    "subgroup_bits winner_bits offset_bits stamp_bits listed_max "
    "counter_max counter_beats longest_word output_depth",
)


def row_type(columns: str) -> np.dtype:
    """Return the type of rows with int64 `columns`, which kernels access by name: `row.column`."""
    return np.dtype((np.record, [(column, np.int64) for column in columns.split()]))


# A table names the fields.
COUNTER: Any = namedtuple("COUNTER", COUNTER_NAMES)(*range(len(COUNTER_NAMES)))


# A packet's values before it is formed, in words of 64 bits: the numbers of the header, then map and offsets, or entries.
NUMBERS = tuple(field.name for field in FRAME_START.fields)
NUMBER: Any = namedtuple("NUMBER", NUMBERS)(*range(len(NUMBERS)))
ARRAY = len(NUMBERS)  # where the map or the entries begin
_PART = row_type("word shift width beat lsb")


def _part_rows(sensor: Sensor, packet: Packet) -> np.ndarray:
    """Return where the fields of a packet stand, as rows: `width` bits of a word, from bit `shift` on, go to a beat."""
    first = NUMBER._asdict() | {"map": ARRAY, "offsets": ARRAY + _words(sensor.pixels), "entries": ARRAY}
    rows = [
        (first[part.field] + part.shift // BEAT_BITS, part.shift % BEAT_BITS, part.width, part.beat, part.lsb)
        for part in parts_of(sensor, packet)
    ]
    return np.array(rows, _PART)


def _words(bits: int) -> int:
    return -(-bits // BEAT_BITS)


def shape_of(config: Config) -> Shape:
    sensor, frame = config.sensor, config.frame
    lengths, packet, widths = layout(sensor), FORMATS[config.format], group_widths(sensor)
    of_sensor = {name: getattr(sensor, name) for name in _OF_SENSOR.split()}
    return Shape(
        **of_sensor,
        period=config.period,
        open_cycles=config.period - sensor.guard,
        quarter_bits=sensor.phase_bits - 2,
        offset_tick_bits=sensor.phase_bits - sensor.step_bits,
        minigroup_records=int(frame["minigroup_records"]),
        mg_threshold=frame["mg_threshold"],
        mg_window=frame["mg_window"],
        event_code=packet.code,
        event_parts=_part_rows(sensor, packet),
        event_beats=lengths.length(packet),
        event_has_offsets=packet.has("offsets"),
        grouped=packet.grouped,
        subgroup_bits=widths.subgroup_bits,
        stamp_bits=bits_for(config.period_ticks - 1),
        listed_max=widths.listed_max,
        hits_words=_words(sensor.pixels),
        record_parts=_part_rows(sensor, RECORD),
        record_beats=lengths.length(RECORD),
        frame_parts=_part_rows(sensor, FRAME_START),
        counter_beats=lengths.counter_beats,
        longest_word=lengths.longest_word,
        output_depth=latency.output_depth(lengths.longest),
    )
