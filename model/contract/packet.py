# SPDX-License-Identifier: Apache-2.0
"""The words of the stream: one table of header fields, which RTL and decoder share.

A packet is a header beat, followed by beats of map, offsets, minigroup entries or counters, lowest bits first.
"""

import enum
from functools import cache

import numpy as np
from attrs import frozen
from numpy.typing import ArrayLike

from .counters import COUNTER_BITS, COUNTER_NAMES
from .parameters import Sensor

BEAT_BITS = 64
OFFSET_BITS = 8


class Kind(enum.IntEnum):
    """Type of a packet."""

    EVENT_SHORT = 1
    EVENT_ID = 2
    EVENT_FULL = 3
    RECORD = 4
    FRAME_START = 6
    FRAME_END = 7


FORMATS = {"short": Kind.EVENT_SHORT, "id": Kind.EVENT_ID, "full": Kind.EVENT_FULL}
FORMAT_NAMES = tuple(FORMATS)  # in the order of the format register's values
FORMATS_TOLD = "0 short, 1 id (map), 2 full (map and offsets)"

HEADER = {  # field: (lowest bit, width); unused fields are 0
    "kind": (61, 3),
    "overrun": (60, 1),
    "subgroup": (48, 12),
    "pulse": (32, 16),
    "count": (23, 9),
    "winner": (15, 8),
    "stamp": (0, 15),
}


def beats_for(bits: int) -> int:
    """Return the number of beats that hold `bits`."""
    return -(-bits // BEAT_BITS)


@frozen
class Layout:
    """Beats of the parts of a packet for one sensor."""

    hits_beats: int
    offset_beats: int
    record_beats: int
    counter_beats: int

    @property
    def longest_word(self) -> int:
        """Beats of the longest event or record."""
        return max(self.length(Kind.EVENT_FULL), self.length(Kind.RECORD))

    @property
    def longest(self) -> int:
        """Beats of the longest packet that a subgroup sends."""
        return max(self.longest_word, self.counter_beats)

    def length(self, kind: int) -> int:
        """Beats of an event or record packet with its header."""
        return (
            1
            + {
                Kind.EVENT_SHORT: 0,
                Kind.EVENT_ID: self.hits_beats,
                Kind.EVENT_FULL: self.hits_beats + self.offset_beats,
                Kind.RECORD: self.record_beats,
            }[Kind(kind)]
        )


@cache
def layout(sensor: Sensor) -> Layout:
    """Return the packet layout of `sensor`."""
    return Layout(
        hits_beats=beats_for(sensor.pixels),
        offset_beats=beats_for(sensor.minigroups * OFFSET_BITS),
        record_beats=beats_for(sensor.minigroups * sensor.record_bits),
        counter_beats=beats_for(len(COUNTER_NAMES) * COUNTER_BITS),
    )


def header_field(beats: ArrayLike, name: str) -> np.ndarray:
    """Return a header field of some beats, as int64."""
    lsb, width = HEADER[name]
    return ((np.asarray(beats, np.uint64) >> np.uint64(lsb)) & np.uint64((1 << width) - 1)).astype(np.int64)
