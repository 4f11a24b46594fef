# SPDX-License-Identifier: Apache-2.0
"""Decoder of the stream: from the beats of a frame to events, minigroup records and counters, by `packet.py`'s tables."""

import numpy as np
from attrs import frozen

from ..shared.compiled import njit
from .counters import COUNTER_NAMES
from .packet import HEADER, Kind, header_field, layout
from .parameters import OFFSET_NONE, Sensor


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
    parts = layout(sensor)
    kinds, starts = packet_starts(beats, sensor, subgroups)
    tail = 1 + parts.counter_beats * subgroups
    head, end = beats[0], beats[len(beats) - tail]
    if header_field(head, "kind") != Kind.FRAME_START or header_field(end, "kind") != Kind.FRAME_END:
        raise StreamError("the frame does not begin with a frame start and end with a frame end")
    if header_field(head, "pulse") != header_field(end, "pulse"):
        raise StreamError("frame start and frame end have different numbers")

    at = starts[kinds != Kind.RECORD]
    has_hits = kinds[kinds != Kind.RECORD] >= Kind.EVENT_ID
    has_offsets = kinds[kinds != Kind.RECORD] == Kind.EVENT_FULL
    events = np.stack([header_field(beats[at], name) for name in HEADER], axis=1)
    hits = np.zeros((len(at), parts.hits_beats), np.uint64)
    hits[has_hits] = beats[at[has_hits, None] + 1 + np.arange(parts.hits_beats)]
    offsets = np.full((len(at), sensor.minigroups), OFFSET_NONE, np.uint8)
    where = at[has_offsets, None] + 1 + parts.hits_beats + np.arange(parts.offset_beats)
    offsets[has_offsets] = _split(beats[where], np.uint8)[:, : sensor.minigroups]

    at = starts[kinds == Kind.RECORD]
    records = np.stack([header_field(beats[at], name) for name in ("subgroup", "pulse")], axis=1)
    raw = _split(
        beats[at[:, None] + 1 + np.arange(parts.record_beats)], np.uint16 if sensor.record_bits == 16 else np.uint32
    )
    raw = raw[:, : sensor.minigroups].astype(np.int64)
    entries = np.stack([raw & ((1 << sensor.record_stamp_bits) - 1), raw >> sensor.record_stamp_bits], axis=2)

    counters = _split(beats[len(beats) - tail + 1 :].reshape(subgroups, -1), np.uint32)[:, : len(COUNTER_NAMES)].astype(
        np.int64
    )
    return Frame(int(header_field(head, "pulse")), events, hits, offsets, records, entries, counters)


def packet_starts(beats: np.ndarray, sensor: Sensor, subgroups: int) -> tuple[np.ndarray, np.ndarray]:
    """Return kind and first beat of each packet between a frame's start and end, int64[n] each. Raises `StreamError`."""
    parts = layout(sensor)
    lengths = np.zeros(8, np.int64)
    for kind in (Kind.EVENT_SHORT, Kind.EVENT_ID, Kind.EVENT_FULL, Kind.RECORD):
        lengths[kind] = parts.length(kind)
    end = len(beats) - 1 - parts.counter_beats * subgroups
    kinds, starts, bad = _packets(beats, lengths, end)
    if bad >= 0 or end <= 0:
        raise StreamError(f"beat {max(bad, 0)} of {len(beats)}: not a packet header where one is due")
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
        kind = np.int64(beats[at] >> np.uint64(61))
        if lengths[kind] == 0:
            return kinds[:n], starts[:n], at
        kinds[n], starts[n] = kind, at
        n += 1
        at += lengths[kind]
    return kinds[:n], starts[:n], -1 if at == end else at
