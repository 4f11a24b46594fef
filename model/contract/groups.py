# SPDX-License-Identifier: Apache-2.0
"""Groups: the compact form of events. The events of one laser pulse leave together, packed to
the bit.

`docs/contract.md` has the rule, `docs/compact.md` the reasons. Here are the widths that golden
model, RTL, decoders and documents share.
"""

from functools import cache
from typing import NamedTuple

from attrs import frozen

from .packet import KIND_LSB, Packet
from .parameters import Sensor, bits_for


class Head(NamedTuple):
    """Something for each field before the first event, in their order."""

    pulse: int  # number of the laser pulse in the frame
    number: int  # of groups before this one in the frame and stream, modulo 256
    stamp_bits: int  # width of the stamps
    with_offsets: int  # 1: the events have coarse offsets


HEAD = Head(pulse=16, number=8, stamp_bits=4, with_offsets=1)  # widths in bits
FIRST_LSB, LAST_LSB = KIND_LSB - 1, KIND_LSB - 2  # marks of a group's first and last beat
PAYLOAD_BITS = LAST_LSB  # of a beat
CHECK_BITS = 32  # in the highest bits of the last beat's payload
CHECK_POLYNOMIAL = (
    0xEDB88320  # of CRC-32 (IEEE 802.3), reversed: the lowest bit of a beat comes first
)
CHECK_LSB = PAYLOAD_BITS - CHECK_BITS
HEAD_BITS = sum(HEAD)
LISTED_BITS = 3
MAPPED = (1 << LISTED_BITS) - 1  # in place of the number of listed pixels: a map follows the winner
AGE_BITS = 4
AGE_MAX = (1 << AGE_BITS) - 1
MAP_PART_BITS = 64  # a map is packed in parts of this size
FIRST_PIXELS = 3  # pixels that are packed with the fields of their event; then come two at a time
PER_PART = 2
# of an event in the controller's capacity; with fewer, the streams of near scenes are overfull
LARGE_PIXELS = 6


@frozen
class Groups:
    """Widths in the groups of a sensor."""

    sensor: Sensor

    @property
    def subgroup_bits(self) -> int:
        return bits_for(self.sensor.subgroups - 1)

    @property
    def listed_max(self) -> int:
        """Most pixels that an event lists, including the winner: a longer list would take more
        bits or cycles than a map.
        """
        parts = -(-self.sensor.pixels // MAP_PART_BITS)
        return min(
            MAPPED - 1,
            1 + self.sensor.pixels // self.sensor.winner_bits,
            FIRST_PIXELS + PER_PART * parts,
        )

    @property
    def fixed_bits(self) -> int:
        """Bits of an event's fields whose width depends on nothing else: listed, overrun,
        subgroup, same.
        """
        return LISTED_BITS + 1 + self.subgroup_bits + 1

    @property
    def part_bits(self) -> int:
        """Most bits that are packed in one step: an event up to `FIRST_PIXELS` pixels, a part of
        a map, or a group's head.
        """
        sensor = self.sensor
        first = self.fixed_bits + AGE_BITS + sensor.stamp_bits + FIRST_PIXELS * sensor.winner_bits
        return max(first, min(MAP_PART_BITS, sensor.pixels), HEAD_BITS)

    def listed_bits(self, packet: Packet, period_ticks: int, pixels: int) -> int:
        """Bits of an event that lists so many pixels, in as many minigroups, and has the pulse
        of the event before it.
        """
        sensor = self.sensor
        pixel_bits = sensor.winner_bits + (sensor.offset_bits if packet.has("offsets") else 0)
        return self.fixed_bits + bits_for(period_ticks - 1) + pixels * pixel_bits


@cache
def group_widths(sensor: Sensor) -> Groups:
    """Return the widths in the groups of `sensor`."""
    return Groups(sensor)
