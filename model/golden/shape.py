"""What the golden model's kernels need of a configuration, as plain numbers."""

from collections import namedtuple

import numpy as np

from ..contract import latency
from ..contract.config import Config
from ..contract.packet import FORMATS, layout
from ..contract.registers import COUNTER_NAMES

Shape = namedtuple(
    "Shape",
    (
        "subgroups pixels minigroups phases phase_bits period open_cycles rearm fifo_depth quarter_bits minigroup_records mg_threshold mg_window "
        "event_kind event_beats hits_beats record_beats counter_beats longest "
        "record_bits record_stamp_bits output_depth"
    ),
)


def row_type(**columns: type) -> np.dtype:
    """Rows of a table that kernels handle by name: `row.column`."""
    return np.dtype((np.record, list(columns.items())))


COUNTER = namedtuple("COUNTER", COUNTER_NAMES)(*range(len(COUNTER_NAMES)))


def shape_of(config: Config) -> Shape:
    sensor, frame = config.sensor, config.frame
    parts, kind = layout(sensor), FORMATS[config.format]
    return Shape(
        sensor.subgroups,
        sensor.pixels,
        sensor.minigroups,
        sensor.phases,
        sensor.phase_bits,
        config.period,
        config.period - sensor.guard,
        sensor.rearm,
        sensor.fifo_depth,
        sensor.phase_bits - 2,
        frame["minigroup_records"],
        frame["mg_threshold"],
        frame["mg_window"],
        int(kind),
        parts.length(kind),
        parts.map_beats,
        parts.record_beats,
        parts.counter_beats,
        parts.longest,
        sensor.record_bits,
        sensor.record_stamp_bits,
        latency.output_depth(parts.longest),
    )
