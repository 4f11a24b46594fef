# SPDX-License-Identifier: Apache-2.0
"""The part of a configuration that the kernels of the golden model need, as plain numbers."""

from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np

from ..contract import latency
from ..contract.config import Config
from ..contract.counters import COUNTER_NAMES
from ..contract.groups import group_widths
from ..contract.packet import (
    BEAT_BITS,
    EVENT_FORMATS,
    FRAME_START,
    RECORD,
    WITH_COUNTS,
    WITH_GROUPS,
    Packet,
    layout,
    parts_of,
)
from ..contract.parameters import Sensor, bits_for

_OF_SENSOR = (  # fields that are attributes of `Sensor`
    "subgroups",
    "pixels",
    "minigroups",
    "phases",
    "phase_bits",
    "rearm",
    "fifo_depth",
    "record_bits",
    "record_stamp_bits",
    "winner_bits",
    "offset_bits",
    "counter_max",
)


class Shape(NamedTuple):
    """A configuration as the kernels need it, in plain numbers. Times are in cycles, sizes in
    beats.
    """

    subgroups: int
    pixels: int  # of a subgroup
    minigroups: int  # of a subgroup
    phases: int  # ticks of a cycle
    phase_bits: int
    quarter_bits: int  # ticks of a quarter cycle, as a power of two
    offset_tick_bits: int  # ticks of a step of the offsets, as a power of two
    period: int
    open_cycles: int  # of a period, in which a window may open; 0 in a frame of counts
    rearm: int  # from the cycle after a window's last one until the tree is armed
    fifo_depth: int  # events
    minigroup_records: int  # 1: they are made
    mg_threshold: int  # pixels
    mg_window: int
    record_bits: int  # of a minigroup's entry
    record_stamp_bits: int  # of the coarse stamp in it
    event_code: int  # kind of the event packet
    event_parts: np.ndarray  # _PART[n], where its fields stand
    event_beats: int
    event_has_offsets: bool
    grouped: bool  # events leave in groups
    start_count: int  # `count` of the frame start
    hits_words: int  # words of an ID map
    record_parts: np.ndarray  # as `event_parts`
    record_beats: int
    frame_parts: np.ndarray  # of frame start and frame end
    subgroup_bits: int  # of a subgroup's number in a group
    winner_bits: int
    offset_bits: int
    stamp_bits: int
    listed_max: int  # most pixels that an event of a group lists
    counter_max: int
    counter_beats: int  # of a subgroup's counters
    longest_word: int  # of the packets
    output_depth: int  # of a stream's output buffer


def row_type(*columns: str) -> np.dtype:
    """Return the type of rows with int64 `columns`, which kernels access by name: `row.column`."""
    return np.dtype((np.record, [(column, np.int64) for column in columns]))


# A table names the fields.
COUNTER: Any = namedtuple("COUNTER", COUNTER_NAMES)(*range(len(COUNTER_NAMES)))


# A packet's values before it is formed, in words of 64 bits: the numbers of the header, then map
# and offsets, or entries.
NUMBERS = tuple(field.name for field in FRAME_START.fields)
NUMBER: Any = namedtuple("NUMBER", NUMBERS)(*range(len(NUMBERS)))
ARRAY = len(NUMBERS)  # where the map or the entries begin
_PART = row_type(
    "word",  # of `NUMBERS` and the array behind them
    "shift",  # lowest bit in the word
    "width",
    "beat",  # of the packet
    "lsb",  # lowest bit in the beat
)


def _part_rows(sensor: Sensor, packet: Packet) -> np.ndarray:
    """Return where the fields of a packet stand, as rows: `width` bits of a word, from bit
    `shift` on, go to a beat.
    """
    first = NUMBER._asdict() | {
        "map": ARRAY,
        "offsets": ARRAY + _words(sensor.pixels),
        "entries": ARRAY,
    }
    rows = [
        (
            first[part.field] + part.shift // BEAT_BITS,
            part.shift % BEAT_BITS,
            part.width,
            part.beat,
            part.lsb,
        )
        for part in parts_of(sensor, packet)
    ]
    return np.array(rows, _PART)


def _words(bits: int) -> int:
    return -(-bits // BEAT_BITS)


def shape_of(config: Config) -> Shape:
    sensor = config.sensor
    frame = config.frame
    lengths = layout(sensor)
    # a frame of counts has no events
    packet = EVENT_FORMATS["short" if config.counting else config.format]
    widths = group_widths(sensor)
    of_sensor = {name: getattr(sensor, name) for name in _OF_SENSOR}
    return Shape(
        **of_sensor,
        period=config.period,
        open_cycles=0 if config.counting else config.period - sensor.guard,
        quarter_bits=sensor.phase_bits - 2,
        offset_tick_bits=sensor.phase_bits - sensor.step_bits,
        minigroup_records=int(frame.minigroup_records),
        mg_threshold=frame.mg_threshold,
        mg_window=frame.mg_window,
        event_code=packet.code,
        event_parts=_part_rows(sensor, packet),
        event_beats=lengths.length(packet),
        event_has_offsets=packet.has("offsets"),
        grouped=packet.grouped,
        start_count=WITH_COUNTS if config.counting else WITH_GROUPS * packet.grouped,
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
