# SPDX-License-Identifier: Apache-2.0
"""The part of a configuration that the kernels of the golden model need, as plain numbers."""

from collections import namedtuple
from typing import Any

import numpy as np

from ..contract import latency
from ..contract.config import Config
from ..contract.counters import COUNTER_NAMES
from ..contract.packet import FORMATS, layout

Shape = namedtuple(
    "Shape",
    "subgroups pixels minigroups phases phase_bits quarter_bits offset_tick_bits period open_cycles rearm fifo_depth "
    "minigroup_records mg_threshold mg_window record_bits record_stamp_bits "
    "event_kind event_beats hits_beats record_beats counter_beats longest_word output_depth",
)


def row_type(columns: str) -> np.dtype:
    """Return the type of rows with int64 `columns`, which kernels access by name: `row.column`."""
    return np.dtype((np.record, [(column, np.int64) for column in columns.split()]))


# A table names the fields.
COUNTER: Any = namedtuple("COUNTER", COUNTER_NAMES)(*range(len(COUNTER_NAMES)))


def shape_of(config: Config) -> Shape:
    sensor, frame = config.sensor, config.frame
    parts, kind = layout(sensor), FORMATS[config.format]
    return Shape(
        subgroups=sensor.subgroups,
        pixels=sensor.pixels,
        minigroups=sensor.minigroups,
        phases=sensor.phases,
        phase_bits=sensor.phase_bits,
        period=config.period,
        open_cycles=config.period - sensor.guard,
        rearm=sensor.rearm,
        fifo_depth=sensor.fifo_depth,
        quarter_bits=sensor.phase_bits - 2,
        offset_tick_bits=sensor.phase_bits - sensor.step_bits,
        minigroup_records=int(frame["minigroup_records"]),
        mg_threshold=frame["mg_threshold"],
        mg_window=frame["mg_window"],
        event_kind=int(kind),
        event_beats=parts.length(kind),
        hits_beats=parts.hits_beats,
        record_beats=parts.record_beats,
        counter_beats=parts.counter_beats,
        longest_word=parts.longest_word,
        record_bits=sensor.record_bits,
        record_stamp_bits=sensor.record_stamp_bits,
        output_depth=latency.output_depth(parts.longest),
    )
