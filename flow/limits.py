# SPDX-License-Identifier: Apache-2.0
"""Limits that software and receivers of a sensor may rely on: cycles of an access, beats of a
frame.
"""

from ..model.contract import groups, latency
from ..model.contract.config import Config
from ..model.contract.packet import COUNTS, RECORD, layout
from ..model.contract.parameters import Sensor

# Cycles in which events may still be stored and beats leave, besides those of the periods.
BEFORE_AND_AFTER = latency.FRAME_START + latency.FINISH + latency.GRANT_TO_BEAT


def beats_beside_cycles(sensor: Sensor, stream: int) -> int:
    """Return the largest number of beats in a frame of a stream beyond one per cycle of the frame.

    A stream moves one beat per cycle. What is left when the last period has ended is in FIFOs, in
    record buffers, and on its way, or in the counters of a frame of counts; then come the counters
    of the subgroups.
    """
    subgroups = len(sensor.stream_subgroups(stream))
    lengths = layout(sensor)
    event = max(lengths.longest_word, _alone_in_a_group(sensor))
    record = lengths.length(RECORD) if sensor.records else 0
    left = sensor.fifo_depth * event + record
    if sensor.counts:
        left = max(left, sensor.minigroups * lengths.length(COUNTS))
    on_the_way = latency.output_depth(lengths.longest) * event
    end = 1 + lengths.counter_beats * subgroups
    return BEFORE_AND_AFTER + subgroups * left + on_the_way + end


def largest_frame(config: Config, stream: int = 0) -> int:
    """Return a number of beats that no frame of a configuration exceeds on a stream."""
    return config.frame_cycles + beats_beside_cycles(config.sensor, stream)


def _alone_in_a_group(sensor: Sensor) -> int:
    """Return the beats of the longest event, if it has a group for itself."""
    widths = groups.group_widths(sensor)
    offsets = sensor.minigroups * sensor.offset_bits if sensor.offsets else 0
    bits = groups.HEAD_BITS + widths.fixed_bits + groups.AGE_BITS
    bits += sensor.stamp_bits + sensor.winner_bits + sensor.pixels + offsets
    full = -(-bits // groups.PAYLOAD_BITS)
    return full + 1  # the check may need another beat
