# SPDX-License-Identifier: Apache-2.0
"""The packets of the stream: one table of their fields, from which golden model, RTL, decoders,
C header and documents are made.

The kind of a packet stands in the highest bits of its first beat. Its fields fill the other
bits, lowest first, in the order of the table.
"""

from functools import cache
from itertools import groupby

import numpy as np
from attrs import frozen
from numpy.typing import ArrayLike

from .counters import COUNTER_BITS, COUNTER_NAMES
from .counts import GATE_BITS, GATES, NO_GATE, ROW_BITS, ROWS
from .parameters import STAMP_FIELD_BITS, SUBGROUPS_MAX, Sensor, bits_for
from .table import Limit, number

BEAT_BITS = 64
KIND_BITS = 3
KIND_LSB = BEAT_BITS - KIND_BITS
GROUP_KIND = 5  # of every beat of a group of events, which `groups.py` describes


@frozen
class Field:
    """A field of a packet: `items` numbers of `width` bits each. aligned: it begins with a new
    beat.
    """

    name: str
    width: Limit
    doc: str = ""
    items: Limit = 1
    aligned: bool = False

    def bits(self, sensor: Sensor) -> int:
        """Return the width of all items together."""
        return int(number(self.width, sensor) * number(self.items, sensor))


@frozen(eq=False)
class Packet:
    """A packet: its kind, its name, and its fields. doc: what an event format holds besides the
    header.

    grouped: subgroups send it, but it leaves the stream in groups (`groups.py`).
    """

    code: int
    name: str
    fields: tuple[Field, ...]
    doc: str = ""
    grouped: bool = False

    def has(self, name: str) -> bool:
        """Return whether it has a field of this name."""
        return any(field.name == name for field in self.fields)


@frozen
class Part:
    """Bits of a field that stand in one beat: `width` bits of its value, from bit `shift` on, at
    bit `lsb` of `beat`.

    A part never crosses a multiple of 64 bits in the value.
    """

    field: str
    width: int
    shift: int
    beat: int
    lsb: int


_STAMP = Field("stamp", STAMP_FIELD_BITS, "opening tick")
_WINNER = Field("winner", 8, "pixel in the subgroup")
# `count` of a frame start, if the frame has other packets than events
WITH_GROUPS = 1
WITH_COUNTS = 2
_COUNT = Field(
    "count",
    9,
    f"distinct pixels; frame start: {WITH_GROUPS} if the events of the frame come in groups,"
    f" {WITH_COUNTS} if it has counts",
)
_PULSE = Field("pulse", 16, "in the frame; frame start and end: frame number")
_SUBGROUP = Field("subgroup", bits_for(SUBGROUPS_MAX - 1))
_OVERRUN = Field("overrun", 1, "events were dropped before this one")
_COUNT_GATES = Field(
    "gates", GATE_BITS, f"first cycle of each gate; {NO_GATE}: there is no gate", GATES
)
_MINIGROUP = Field("minigroup", 32, "number of the minigroup in its subgroup")
_PULSES = Field(
    "pulses",
    16,
    "number of pulses of each pixel, in the minigroup's order",
    "minigroup_pixels",
    aligned=True,
)
_ROWS = Field("rows", ROW_BITS, "rows of the minigroup's memory", ROWS, aligned=True)
_HEADER = _STAMP, _WINNER, _COUNT, _PULSE, _SUBGROUP, _OVERRUN
MAP = Field("map", 1, "", "pixels", aligned=True)
OFFSETS = Field("offsets", 8, "", "minigroups", aligned=True)
ENTRIES = Field("entries", "record_bits", "", "minigroups", aligned=True)
# Once for every subgroup of the stream.
_COUNTERS = Field("counters", COUNTER_BITS, "", len(COUNTER_NAMES), aligned=True)

EVENT_FORMATS = {  # packets of events, in the order of the format register's values
    "short": Packet(1, "event_short", _HEADER),
    "id": Packet(2, "event_id", (*_HEADER, MAP), "map"),
    "full": Packet(3, "event_full", (*_HEADER, MAP, OFFSETS), "map and offsets"),
    "compact": Packet(2, "event_id", (*_HEADER, MAP), "id in groups", grouped=True),
    "compact-full": Packet(
        3, "event_full", (*_HEADER, MAP, OFFSETS), "full in groups", grouped=True
    ),
}
# Of a minigroup; a frame of this format has no events.
COUNTS = Packet(
    0, "counts", (_COUNT_GATES, _MINIGROUP, _SUBGROUP, _PULSES, _ROWS), "counts in gates, no events"
)
FORMATS = EVENT_FORMATS | {"counts": COUNTS}  # in the order of the format register's values
FORMAT_NAMES = tuple(FORMATS)
# without `Sensor.offsets`
UNBUILT = tuple(name for name, packet in EVENT_FORMATS.items() if packet.has("offsets"))
# formats from which depth can be made
WITH_MAP = tuple(name for name, packet in FORMATS.items() if packet.has("map"))
RECORD = Packet(4, "record", (*_HEADER, ENTRIES))
FRAME_START = Packet(6, "frame_start", _HEADER)
FRAME_END = Packet(7, "frame_end", (*_HEADER, _COUNTERS))


def built_formats(sensor: Sensor) -> tuple[str, ...]:
    """Return the formats that a sensor has."""
    missing = () if sensor.offsets else UNBUILT
    names = FORMATS if sensor.counts else EVENT_FORMATS
    return tuple(name for name in names if name not in missing)


PACKETS = {
    packet.code: packet
    for packet in (*FORMATS.values(), RECORD, FRAME_START, FRAME_END)
    if not packet.grouped
}


@cache
def parts_of(sensor: Sensor, packet: Packet) -> tuple[Part, ...]:
    """Return where the fields of a packet stand, in the order of its bits."""
    parts, bit = [], 0  # bits are counted without those of the kind
    for field in packet.fields:
        shift, bits = 0, field.bits(sensor)
        if field.aligned:
            bit = -(-(bit + KIND_BITS) // BEAT_BITS) * BEAT_BITS - KIND_BITS
        while shift < bits:
            at = bit if bit < KIND_LSB else bit + KIND_BITS
            room = KIND_LSB - at if at < KIND_LSB else BEAT_BITS - at % BEAT_BITS
            width = min(room, bits - shift, BEAT_BITS - shift % BEAT_BITS)
            parts.append(Part(field.name, width, shift, *divmod(at, BEAT_BITS)))
            bit, shift = bit + width, shift + width
    return tuple(parts)


HEADER = {"kind": (KIND_LSB, KIND_BITS)} | {  # field of the usual header: (lowest bit, width)
    part.field: (part.lsb, part.width) for part in reversed(parts_of(Sensor(), FRAME_START))
}


@frozen
class Layout:
    """Lengths of a sensor's packets in beats."""

    sensor: Sensor

    def length(self, packet: Packet, subgroups: int = 1) -> int:
        """Beats of a packet with its header. subgroups: of the stream."""
        after_header = max(part.beat for part in parts_of(self.sensor, packet))
        return 1 + after_header * (subgroups if packet is FRAME_END else 1)

    @property
    def counter_beats(self) -> int:
        """Beats of the counters of a subgroup."""
        return self.length(FRAME_END) - 1

    @property
    def longest_word(self) -> int:
        """Beats of the longest word: an event, a record, or the counts of a minigroup."""
        counts = (COUNTS,) if self.sensor.counts else ()
        return max(self.length(packet) for packet in (*EVENT_FORMATS.values(), RECORD, *counts))

    @property
    def longest(self) -> int:
        """Beats of the longest packet that a subgroup sends."""
        return max(self.longest_word, self.counter_beats)

    def lengths(self, subgroups: int) -> np.ndarray:
        """int64[kinds]: beats of the packets of a stream with `subgroups` subgroups; 0: there is
        no such kind.

        The beats of a group count as packets of one beat, because each of them has the kind.
        """
        lengths = np.zeros(1 << KIND_BITS, np.int64)
        lengths[GROUP_KIND] = 1
        for code, packet in PACKETS.items():
            if packet is not COUNTS or self.sensor.counts:
                lengths[code] = self.length(packet, subgroups)
        return lengths


@cache
def layout(sensor: Sensor) -> Layout:
    """Return the packet lengths of `sensor`."""
    return Layout(sensor)


UNUSED = {  # bits of a packet's first beat that are 0, by kind
    packet.code: sum(
        ((1 << width) - 1) << lsb
        for name, (lsb, width) in HEADER.items()
        if name not in ("kind", "pulse", *more)
    )
    for packet, more in ((RECORD, ("subgroup",)), (FRAME_START, ("count",)), (FRAME_END, ()))
}


def header_field(beats: ArrayLike, name: str) -> np.ndarray:
    """Return a field of the usual header, from the first beats of some packets, as int64."""
    lsb, width = HEADER[name]
    return ((np.asarray(beats, np.uint64) >> np.uint64(lsb)) & np.uint64((1 << width) - 1)).astype(
        np.int64
    )


def packet_fields(
    beats: np.ndarray, at: np.ndarray, sensor: Sensor, packet: Packet
) -> dict[str, np.ndarray]:
    """Return the fields of the packets that begin at the beats `at`, as uint64[packets, words],
    lowest bits first.
    """
    words = {field.name: -(-field.bits(sensor) // BEAT_BITS) for field in packet.fields}
    values = {name: np.zeros((len(at), n), np.uint64) for name, n in words.items()}
    for beat, parts in groupby(parts_of(sensor, packet), lambda part: part.beat):
        column = beats[at + beat]
        for part in parts:
            word, shift = divmod(part.shift, BEAT_BITS)
            bits = column >> np.uint64(part.lsb) & np.uint64((1 << part.width) - 1)
            values[part.field][:, word] |= bits << np.uint64(shift)
    return values


def packet_beats(fields: dict[str, np.ndarray], sensor: Sensor, packet: Packet) -> np.ndarray:
    """Return the beats of packets with these fields, uint64[packets, beats].

    fields: uint64[packets, words], lowest bits first, as those of `packet_fields`.
    """
    number = len(next(iter(fields.values())))
    beats = np.zeros((number, layout(sensor).length(packet)), np.uint64)
    beats[:, 0] = packet.code << KIND_LSB
    for part in parts_of(sensor, packet):
        word, shift = divmod(part.shift, BEAT_BITS)
        bits = fields[part.field][:, word] >> np.uint64(shift) & np.uint64((1 << part.width) - 1)
        beats[:, part.beat] |= bits << np.uint64(part.lsb)
    return beats
