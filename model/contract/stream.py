# SPDX-License-Identifier: Apache-2.0
"""Decoder of the stream: from the beats of a frame to events, minigroup records and counters, by `packet.py`'s tables."""

from itertools import groupby
from typing import Any

import numpy as np
from attrs import frozen

from ..shared.compiled import njit
from .counters import COUNTER_NAMES
from .packet import (
    BEAT_BITS,
    FORMATS,
    FRAME_END,
    FRAME_START,
    HEADER,
    KIND_LSB,
    RECORD,
    Packet,
    header_field,
    layout,
    parts_of,
)
from .parameters import OFFSET_NONE, Sensor

NO_HEADER = "not a packet header where one is due"
COLUMN = {name: column for column, name in enumerate(HEADER)}  # of `Frame.events`


class StreamError(Exception):
    """Beats that are not a frame; the message gives the place."""


@frozen(eq=False)
class Frame:
    """One frame of one stream, decoded.

    number: frame number in its packets. events: int64[n, 7], columns in the order of `HEADER`. hits: uint64[n, map
    beats]; offsets: uint8[n, minigroups]. records: int64[k, 2], subgroup and pulse. entries: int64[k, minigroups, 2],
    stamp and map. counters: int64[subgroups of the stream, 11].
    """

    number: int
    events: np.ndarray
    hits: np.ndarray
    offsets: np.ndarray
    records: np.ndarray
    entries: np.ndarray
    counters: np.ndarray


def decode_frame(beats: np.ndarray, sensor: Sensor, subgroups: int) -> Frame:
    """Decode the beats (uint64[n]) of one frame of a stream that carries `subgroups` subgroups.

    Raises `StreamError` if the beats are not exactly a frame start, packets, and a frame end with its counters.
    """
    kinds, starts = packet_starts(beats, sensor, subgroups)
    tail = layout(sensor).length(FRAME_END, subgroups)
    head, end = beats[0], beats[len(beats) - tail]
    if header_field(head, "kind") != FRAME_START.code or header_field(end, "kind") != FRAME_END.code:
        raise StreamError("the frame does not begin with a frame start and end with a frame end")
    if header_field(head, "pulse") != header_field(end, "pulse"):
        raise StreamError("frame start and frame end have different numbers")

    is_record = kinds == RECORD.code
    event_at, event_kinds = starts[~is_record], kinds[~is_record]
    events = np.zeros((len(event_at), len(HEADER)), np.int64)
    events[:, COLUMN["kind"]] = event_kinds
    hits = np.zeros((len(event_at), -(-sensor.pixels // BEAT_BITS)), np.uint64)
    offsets = np.full((len(event_at), sensor.minigroups), OFFSET_NONE, np.uint8)
    for packet in FORMATS.values():
        chosen: Any = event_kinds == packet.code
        if not chosen.any():
            continue
        chosen = slice(None) if chosen.all() else chosen
        values = packet_fields(beats, event_at[chosen], sensor, packet)
        if "map" in values:
            hits[chosen] = values.pop("map")
        if "offsets" in values:
            offsets[chosen] = _split(values.pop("offsets"), np.uint8)[:, : sensor.minigroups]
        for name, value in values.items():
            events[chosen, COLUMN[name]] = value[:, 0]

    values = packet_fields(beats, starts[is_record], sensor, RECORD)
    records = np.concatenate([values["subgroup"], values["pulse"]], axis=1).astype(np.int64)
    raw = _split(values["entries"], np.uint16 if sensor.record_bits == 16 else np.uint32)
    raw = raw[:, : sensor.minigroups].astype(np.int64)
    entries = np.stack([raw & ((1 << sensor.record_stamp_bits) - 1), raw >> sensor.record_stamp_bits], axis=2)

    counters = _split(beats[len(beats) - tail + 1 :].reshape(subgroups, -1), np.uint32)[:, : len(COUNTER_NAMES)].astype(
        np.int64
    )
    return Frame(int(header_field(head, "pulse")), events, hits, offsets, records, entries, counters)


def packet_fields(beats: np.ndarray, at: np.ndarray, sensor: Sensor, packet: Packet) -> dict[str, np.ndarray]:
    """Return the fields of the packets that begin at the beats `at`, as uint64[packets, words], lowest bits first."""
    words = {field.name: -(-field.bits(sensor) // BEAT_BITS) for field in packet.fields}
    values = {name: np.zeros((len(at), n), np.uint64) for name, n in words.items()}
    for beat, parts in groupby(parts_of(sensor, packet), lambda part: part.beat):
        column = beats[at + beat]
        for part in parts:
            word, shift = divmod(part.shift, BEAT_BITS)
            bits = column >> np.uint64(part.lsb) & np.uint64((1 << part.width) - 1)
            values[part.field][:, word] |= bits << np.uint64(shift)
    return values


def packet_starts(beats: np.ndarray, sensor: Sensor, subgroups: int) -> tuple[np.ndarray, np.ndarray]:
    """Return kind and first beat of each packet between a frame's start and end, int64[n] each. Raises `StreamError`."""
    lengths = layout(sensor).lengths(subgroups)
    end = len(beats) - lengths[FRAME_END.code]
    lengths[[FRAME_START.code, FRAME_END.code]] = 0
    kinds, starts, bad = _packets(beats, lengths, end)
    if bad >= 0 or end <= 0:
        raise StreamError(f"beat {max(bad, 0)} of {len(beats)}: {NO_HEADER}")
    return kinds, starts


def _split(beats: np.ndarray, dtype: type[np.unsignedinteger]) -> np.ndarray:
    """Return beats [n, m] (or [n, 0]) as little-endian items [n, m * items per beat]."""
    return np.ascontiguousarray(beats).astype("<u8").view(np.dtype(dtype).newbyteorder("<"))


@njit
def _packets(beats: np.ndarray, lengths: np.ndarray, end: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Return kinds and first beats of the packets from the frame start to `end`, and the first beat that is no header (or -1)."""
    kinds, starts = np.empty(max(end, 0), np.int64), np.empty(max(end, 0), np.int64)
    n, at = 0, 1
    while at < end:
        kind = np.int64(beats[at] >> np.uint64(KIND_LSB))
        if lengths[kind] == 0:
            return kinds[:n], starts[:n], at
        kinds[n], starts[n] = kind, at
        n += 1
        at += lengths[kind]
    return kinds[:n], starts[:n], -1 if at == end else at
