"""What the golden model's kernels need of a configuration, as plain numbers."""

from collections import namedtuple

from ..contract import latency
from ..contract.config import Config
from ..contract.packet import FORMATS, layout
from ..contract.registers import COUNTER_NAMES

Shape = namedtuple(
    "Shape",
    (
        "subgroups pixels minigroups phase_bits period guard rearm fifo_depth quarter_bits mg_records mg_threshold mg_window "
        "gate_step gate_every gate_steps event_kind event_beats map_beats record_beats counter_beats longest "
        "record_bits record_stamp_bits output_depth"
    ),
)
COUNTER = namedtuple("COUNTER", COUNTER_NAMES)(*range(len(COUNTER_NAMES)))


def shape_of(config: Config) -> Shape:
    sensor, frame = config.sensor, config.frame
    parts, kind = layout(sensor), FORMATS[config.format]
    return Shape(
        sensor.subgroups,
        sensor.pixels,
        sensor.minigroups,
        sensor.phase_bits,
        config.period,
        sensor.guard,
        sensor.rearm,
        sensor.fifo_depth,
        sensor.phase_bits - 2,
        frame["minigroup_records"],
        frame["mg_threshold"],
        frame["mg_window"],
        frame["gate_step"],
        frame["gate_every"],
        frame["gate_steps"],
        int(kind),
        parts.length(kind),
        parts.hits_beats,
        parts.record_beats,
        parts.counter_beats,
        parts.longest,
        sensor.record_bits,
        sensor.record_stamp_bits,
        latency.output_depth(parts.longest),
    )
