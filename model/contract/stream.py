# SPDX-License-Identifier: Apache-2.0
"""Decoder of the stream: from the beats of a frame to events, minigroup records and counters, by
`packet.py`'s tables.

Groups of events are decoded by `ungroup.py`.
"""

from typing import Any

import numpy as np
from attrs import frozen

from ..shared.compiled import njit
from .counters import COUNTER_NAMES
from .counts import GATES, NO_GATE
from .gate_counts import Counts, counts_of_fields
from .packet import (
    BEAT_BITS,
    COUNTS,
    EVENT_FORMATS,
    FRAME_END,
    FRAME_START,
    GROUP_KIND,
    HEADER,
    KIND_LSB,
    RECORD,
    UNUSED,
    WITH_COUNTS,
    WITH_GROUPS,
    header_field,
    layout,
    packet_fields,
)
from .parameters import OFFSET_NONE, Sensor
from .ungroup import ungroup

NO_HEADER = "not a packet header where one is due"
_RECORD, _DAMAGED = RECORD.code, GROUP_KIND
_EVENTS_OR_RECORD = frozenset(packet.code for packet in (*EVENT_FORMATS.values(), RECORD))
_UNUSED_IN_RECORD = np.uint64(UNUSED[RECORD.code])
COLUMN = {name: column for column, name in enumerate(HEADER)}  # of `ReceivedFrame.events`


class StreamError(Exception):
    """Beats that are not a frame; the message gives the place."""


@frozen(eq=False)
class ReceivedFrame:
    """One frame of one stream, decoded; whole or not."""

    number: int  # frame number in its packets
    events: np.ndarray  # int64[n, 7], columns in the order of `HEADER`
    hits: np.ndarray  # uint64[n, map beats]
    offsets: np.ndarray  # uint8[n, minigroups]
    records: np.ndarray  # int64[k, 2]: subgroup and pulse
    entries: np.ndarray  # int64[k, minigroups, 2]: stamp and map
    counters: np.ndarray  # int64[subgroups of the stream, 11]
    # int64[m]: beats at which a group of events is missing or wrong; all other events are right
    damaged: np.ndarray
    missing: int  # number of events that were left out, because their group is damaged
    counts: Counts | None = None  # of the stream's subgroups, in the format counts

    def check(self) -> "ReceivedFrame":
        """Return the frame. Raises `StreamError` if events are missing."""
        if len(self.damaged) or self.missing:
            places = (
                f", near beats {', '.join(map(str, self.damaged))}" if len(self.damaged) else ""
            )
            raise StreamError(
                f"{self.missing} events of the frame were damaged on their way{places}"
            )
        return self


def decode_frame(beats: np.ndarray, sensor: Sensor, subgroups: int) -> ReceivedFrame:
    """Decode the beats (uint64[n]) of one frame of a stream that carries `subgroups` subgroups.

    Raises `StreamError` if the beats are not exactly a frame start, packets, and a frame end
    with its counters, or if a frame with counts lacks a minigroup's. Damaged groups of events do
    not count as an error: the frame tells of them.
    """
    kinds, starts = packet_starts(beats, sensor, subgroups)
    tail = layout(sensor).length(FRAME_END, subgroups)
    head, end = beats[0], beats[len(beats) - tail]
    if (
        header_field(head, "kind") != FRAME_START.code
        or header_field(end, "kind") != FRAME_END.code
    ):
        raise StreamError("the frame does not begin with a frame start and end with a frame end")
    if header_field(head, "pulse") != header_field(end, "pulse"):
        raise StreamError("frame start and frame end have different numbers")

    counters = _split(beats[len(beats) - tail + 1 :].reshape(subgroups, -1), np.uint32)[
        :, : len(COUNTER_NAMES)
    ].astype(np.int64)
    is_record = kinds == RECORD.code
    is_event = ~is_record
    counts = None
    if is_counting(head):
        counts = _counts(beats, starts, sensor, subgroups)
        is_event[:] = False
    records, entries = _records(beats, starts[is_record], sensor)
    if is_grouped(head):
        events, hits, offsets, damaged = ungroup(beats, starts[is_event], sensor)
        stored = int(counters[:, COUNTER_NAMES.index("stored")].sum())
        missing = max(0, stored - len(events))  # saturated counters tell of fewer than were stored
    else:
        events, hits, offsets = _events(beats, starts[is_event], kinds[is_event], sensor)
        damaged = np.zeros(0, np.int64)
        missing = 0
    number = int(header_field(head, "pulse"))
    return ReceivedFrame(
        number=number,
        events=events,
        hits=hits,
        offsets=offsets,
        records=records,
        entries=entries,
        counters=counters,
        damaged=damaged,
        missing=missing,
        counts=counts,
    )


def is_grouped(frame_start: np.uint64) -> bool:
    """Return whether the events of a frame come in groups."""
    return bool(header_field(frame_start, "count") == WITH_GROUPS)


def is_counting(frame_start: np.uint64) -> bool:
    """Return whether a frame has counts in place of events."""
    return bool(header_field(frame_start, "count") == WITH_COUNTS)


def _kinds_after(frame_start: np.uint64) -> frozenset[int]:
    """Return the kinds of the packets between a frame's start and its end."""
    if is_counting(frame_start):
        return frozenset({COUNTS.code})
    if is_grouped(frame_start):
        return frozenset({GROUP_KIND, RECORD.code})
    return _EVENTS_OR_RECORD


def kind_of(beat: np.uint64, grouped: bool) -> int:
    """Return the kind of a beat where a packet begins; in a frame with groups, a damaged one
    counts as part of a group.
    """
    kind = int(header_field(beat, "kind"))
    damaged = grouped and (kind not in UNUSED or beat & np.uint64(UNUSED[kind]))
    return GROUP_KIND if damaged else kind


def _events(
    beats: np.ndarray, event_at: np.ndarray, event_kinds: np.ndarray, sensor: Sensor
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return columns, maps and offsets of the events that begin at the beats `event_at`."""
    events = np.zeros((len(event_at), len(HEADER)), np.int64)
    events[:, COLUMN["kind"]] = event_kinds
    hits = np.zeros((len(event_at), -(-sensor.pixels // BEAT_BITS)), np.uint64)
    offsets = np.full((len(event_at), sensor.minigroups), OFFSET_NONE, np.uint8)
    for packet in EVENT_FORMATS.values():
        if packet.grouped:
            continue
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
    return events, hits, offsets


def _counts(beats: np.ndarray, at: np.ndarray, sensor: Sensor, subgroups: int) -> Counts:
    """Return the counts of the minigroups, whose packets begin at the beats `at`. Raises
    `StreamError` if they are not those of a stream's subgroups, in their order.
    """
    due = subgroups * sensor.minigroups
    if len(at) != due:
        raise StreamError(f"the frame has counts of {len(at)} minigroups, not of {due}")
    fields = packet_fields(beats, at, sensor, COUNTS)
    number = np.arange(due)
    subgroup = fields["subgroup"][0, 0].astype(np.int64) + number // sensor.minigroups
    minigroup = number % sensor.minigroups
    right = (fields["subgroup"][:, 0] == subgroup) & (fields["minigroup"][:, 0] == minigroup)
    if not right.all():
        first = np.argmin(right)
        raise StreamError(
            f"beat {at[first]} of {len(beats)}: counts of minigroup {fields['minigroup'][first, 0]} of"
            f" subgroup {fields['subgroup'][first, 0]} where those of minigroup {minigroup[first]} of"
            f" subgroup {subgroup[first]} are due"
        )
    counts = counts_of_fields(fields, sensor)
    if fields["rows"].reshape(due, GATES, -1)[counts.gate_cycle.reshape(due, -1) == NO_GATE].any():
        raise StreamError("the frame has hits in a gate that it does not have")
    return counts


def _records(beats: np.ndarray, at: np.ndarray, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """Return subgroup and pulse, and the entries, of the minigroup records that begin at the
    beats `at`.
    """
    values = packet_fields(beats, at, sensor, RECORD)
    records = np.concatenate([values["subgroup"], values["pulse"]], axis=1).astype(np.int64)
    raw = _split(values["entries"], np.uint16 if sensor.record_bits == 16 else np.uint32)
    raw = raw[:, : sensor.minigroups].astype(np.int64)
    return records, np.stack(
        [raw & ((1 << sensor.record_stamp_bits) - 1), raw >> sensor.record_stamp_bits], axis=2
    )


def packet_starts(
    beats: np.ndarray, sensor: Sensor, subgroups: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return kind and first beat of each packet between a frame's start and end, int64[n] each.
    Raises `StreamError`.

    In a frame with groups, a beat that can neither be of a group nor begin a record is damaged,
    and counts as a packet.
    """
    lengths = layout(sensor).lengths(subgroups)
    end = len(beats) - lengths[FRAME_END.code]
    expected = _kinds_after(beats[0]) if len(beats) else _EVENTS_OR_RECORD
    lengths[[kind for kind in range(len(lengths)) if kind not in expected]] = 0
    grouped = GROUP_KIND in expected
    kinds, starts, bad = _packets(beats, lengths, end, grouped)
    if bad >= 0 or end <= 0:
        place = bad if end > 0 else 0  # beats that are too few for a frame end have no start
        raise StreamError(f"beat {place} of {len(beats)}: {NO_HEADER}")
    return kinds, starts


def _split(beats: np.ndarray, dtype: type[np.unsignedinteger]) -> np.ndarray:
    """Return beats [n, m] (or [n, 0]) as little-endian items [n, m * items per beat]."""
    return np.ascontiguousarray(beats).astype("<u8").view(np.dtype(dtype).newbyteorder("<"))


@njit
def _packets(
    beats: np.ndarray, lengths: np.ndarray, end: int, grouped: bool
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return kinds and first beats of the packets from the frame start to `end`, and the first
    beat that is no header (or -1).
    """
    kinds, starts = np.empty(max(end, 0), np.int64), np.empty(max(end, 0), np.int64)
    n, at = 0, 1
    while at < end:
        kind = np.int64(beats[at] >> np.uint64(KIND_LSB))
        if grouped and (
            lengths[kind] == 0 or (kind == _RECORD and beats[at] & _UNUSED_IN_RECORD != 0)
        ):
            kind = np.int64(_DAMAGED)
        if lengths[kind] == 0:
            return kinds[:n], starts[:n], at
        kinds[n], starts[n] = kind, at
        n += 1
        at += lengths[kind]
    return kinds[:n], starts[:n], -1 if at == end else at
