# SPDX-License-Identifier: Apache-2.0
"""Results as arrays: built from the beats of any engine, compared, written and read."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..shared import pulse
from ..shared.arguments import check_kind
from ..shared.arrays import joined
from ..shared.errors import InputError, check_integer
from ..shared.files import FilePath, GrowingNpz, read_npz, write_npz
from .config import Config
from .counters import COUNTER_NAMES
from .gate_counts import Counts
from .packet import BEAT_BITS, COUNTS, FORMATS, GROUP_KIND, packet_fields
from .parameters import OFFSET_NONE, Sensor
from .stream import COLUMN, ReceivedFrame, StreamError, decode_frame, is_counting, is_grouped

EVENT_FIELDS = ("subgroup", "pulse", "stamp", "count", "winner", "overrun")
EVENT_COLUMNS = (*EVENT_FIELDS, "commit_cycle")  # arrays with one value per event
RECORD_COLUMNS = ("mg_subgroup", "mg_pulse", "mg_stamp", "mg_map")
FIRST_WORD = np.array([1])  # the beat behind the frame start
COMMIT_UNKNOWN = np.int64(-1)  # commit cycle of an event that was received from a chip
# present only in some formats, engines or lights
OPTIONAL = ("hits", "mg_offset", *Counts._fields, "fate", *pulse.ARRAYS)
NOT_SENT = {"fate", *pulse.ARRAYS}  # known of a simulation, not sent by the sensor


class FrameRows(NamedTuple):
    """Rows that a frame adds to a result file."""

    # events, records, and counts (one row of all subgroups), in the order of the file
    columns: dict[str, np.ndarray]
    counters: np.ndarray  # int64[subgroups, 11]


def frame_rows(
    config: Config,
    beats: list[np.ndarray],
    commit_subgroup: np.ndarray | None = None,
    commit_cycle: np.ndarray | None = None,
    first_pulse: int = 0,
) -> FrameRows:
    """Return the rows of a frame: from its beats per stream, and subgroups and commit cycles of its
    stored events (by time in a subgroup).

    first_pulse: number of the frame's first pulse in the file. Without commit cycles, these are
    `COMMIT_UNKNOWN`, because they cannot be seen outside the chip. Raises `StreamError` if the
    beats are not a whole frame of this configuration, stream by stream, and `ValueError` if more
    or fewer events left than were stored.
    """
    sensor = config.sensor
    counters = np.zeros((sensor.subgroups, len(COUNTER_NAMES)), np.int64)
    if len(beats) != sensor.streams:
        raise StreamError(f"there are beats of {len(beats)} streams, not of {sensor.streams}")
    frames = []
    for k, stream in enumerate(beats):
        subgroups = sensor.stream_subgroups(k)
        frame = decode_frame(stream, sensor, len(subgroups)).check()
        _check_format(config, stream, frame)
        _check_stream(config, k, stream, frame)
        counters[subgroups] = frame.counters
        frames.append(frame)
    numbers = [frame.number for frame in frames]
    if len(set(numbers)) > 1:
        raise StreamError(f"the streams have frames of different numbers: {numbers}")

    columns = {
        name: joined([frame.events[:, COLUMN[name]] for frame in frames]) for name in EVENT_FIELDS
    }
    columns["pulse"] += first_pulse
    columns["overrun"] = columns["overrun"].astype(bool)
    columns["commit_cycle"] = _commit_cycles(columns["subgroup"], commit_subgroup, commit_cycle)
    packet = FORMATS[config.format]
    if packet.has("map"):
        columns["hits"] = joined([frame.hits for frame in frames])
    if packet.has("offsets"):
        columns["mg_offset"] = joined([frame.offsets for frame in frames])
    records = joined([frame.records for frame in frames])
    entries = joined([frame.entries for frame in frames])
    columns["mg_subgroup"] = records[:, 0]
    columns["mg_pulse"] = records[:, 1] + first_pulse
    columns["mg_stamp"] = entries[:, :, 0].astype(np.uint16)
    columns["mg_map"] = entries[:, :, 1].astype(np.uint16)
    if config.counting:
        columns |= _counts(frames)
    return FrameRows(columns, counters)


def _check_format(config: Config, stream: np.ndarray, frame: ReceivedFrame) -> None:
    """Raise `StreamError` if a frame of a stream has other packets than the configuration says."""
    packet = FORMATS[config.format]
    counting = is_counting(stream[0])
    if counting != config.counting:
        first, second = ("counts", "events") if counting else ("events", "counts")
        raise StreamError(f"the frame has {first} in place of {second}")
    code = GROUP_KIND if packet.grouped else packet.code
    with_offsets = (frame.offsets != OFFSET_NONE).any(axis=1)
    if (
        is_grouped(stream[0]) != packet.grouped
        or np.any(frame.events[:, COLUMN["kind"]] != code)
        or np.any(with_offsets != packet.has("offsets"))
    ):
        raise StreamError(f"the frame has events of another format than {config.format}")
    if len(frame.records) and not config.frame.minigroup_records:
        raise StreamError("the frame has minigroup records, which are off in the configuration")


def _check_stream(config: Config, number: int, stream: np.ndarray, frame: ReceivedFrame) -> None:
    """Raise `StreamError` if a frame of a stream has words of subgroups of another stream."""
    if config.counting:
        first = packet_fields(stream, FIRST_WORD, config.sensor, COUNTS)
        found = first["subgroup"][:, 0].astype(np.int64)
    else:
        found = np.concatenate([frame.events[:, COLUMN["subgroup"]], frame.records[:, 0]])
    strange = found[~np.isin(found, config.sensor.stream_subgroups(number))]
    if len(strange):
        raise StreamError(f"stream {number} has words of subgroup {strange[0]} of another stream")


def _counts(streams: list[ReceivedFrame]) -> dict[str, np.ndarray]:
    """Return the counts of a frame's streams as arrays of a result file, with one frame."""
    columns = {}
    for name in Counts._fields:
        of_streams = [getattr(stream.counts, name) for stream in streams]
        columns[name] = joined(of_streams)[None]
    return columns


def _commit_cycles(
    subgroup: np.ndarray, commit_subgroup: np.ndarray | None, commit_cycle: np.ndarray | None
) -> np.ndarray:
    """int64[n]: commit cycles of events, which left the sensor in this order of their subgroups."""
    if commit_subgroup is None or commit_cycle is None:
        return np.full(len(subgroup), COMMIT_UNKNOWN)
    order = np.argsort(commit_subgroup, kind="stable")
    left = np.argsort(subgroup, kind="stable")
    if not np.array_equal(subgroup[left], commit_subgroup[order]):
        raise ValueError("the events that left the sensor are not the ones that its FIFOs stored")
    commit = np.empty(len(subgroup), np.int64)
    commit[left] = commit_cycle[order]
    return commit


def counter_arrays(counters: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """Return the counters of all frames as arrays of a result file, int64[frames, subgroups].

    counters: int64[subgroups, 11] of each frame.
    """
    return {
        name: np.stack([of_frame[:, i] for of_frame in counters])
        for i, name in enumerate(COUNTER_NAMES)
    }


class _Collector:
    """Collector of frames; `_append` keeps the columns of one."""

    def __init__(self, config: Config):
        self.config = config
        self.counters: list[np.ndarray] = []  # int64[subgroups, 11] of each frame

    def add(
        self,
        beats: list[np.ndarray],
        commit_subgroup: np.ndarray | None = None,
        commit_cycle: np.ndarray | None = None,
    ) -> None:
        """Add a frame. Parameters and errors are those of `frame_rows`."""
        first_pulse = len(self.counters) * self.config.pulses
        rows = frame_rows(self.config, beats, commit_subgroup, commit_cycle, first_pulse)
        self._append(rows.columns)
        self.counters.append(rows.counters)

    def _append(self, columns: dict[str, np.ndarray]) -> None:
        raise NotImplementedError


class ResultBuilder(_Collector):
    """Collector of frames for the arrays of a result file."""

    def __init__(self, config: Config):
        super().__init__(config)
        self._columns: list[dict[str, np.ndarray]] = []

    def _append(self, columns: dict[str, np.ndarray]) -> None:
        self._columns.append(columns)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of the result file, with rows frame by frame, and stream by stream
        within a frame.
        """
        columns = {
            name: joined([of_frame[name] for of_frame in self._columns])
            for name in self._columns[0]
        }
        return columns | counter_arrays(self.counters)


class ResultFile(_Collector):
    """Collector of frames for a result file; the frames may be larger than the memory."""

    def __init__(self, config: Config):
        super().__init__(config)
        self.events = 0
        self._columns = GrowingNpz()

    def _append(self, columns: dict[str, np.ndarray]) -> None:
        self._columns.append(columns)
        self.events += len(columns["pulse"])

    def write(self, path: FilePath, others: dict[str, np.ndarray]) -> None:
        """Write the file that `write_result` writes of these frames, with other arrays behind
        theirs. Raises `InputError` for another suffix.
        """
        self._columns.write(path, counter_arrays(self.counters) | others)


def check_arrays(arrays: Mapping[str, np.ndarray], *names: str) -> None:
    """Raise `InputError` if a result lacks one of these arrays, or is none."""
    check_kind("arrays", arrays, Mapping)
    for name in names:
        if name not in arrays:
            raise InputError(f"arrays: {name} is missing, which a result has", field="arrays")


def check_frame(frame: int | None, frames: int) -> int | None:
    """Return the number of one of so many frames, or None for all of them. Raises `InputError`."""
    return None if frame is None else check_integer("frame", frame, 0, frames - 1)


def checked_events(arrays: Mapping[str, np.ndarray], config: Config) -> dict[str, np.ndarray]:
    """Return the columns of a result's events, int64, its maps if it has some, and `opened`.

    Raises `InputError` if they cannot come from a run of this configuration.
    """
    sensor = config.sensor
    opened = np.asarray(arrays["opened"])
    if opened.ndim != 2 or opened.shape[1] != sensor.subgroups:
        raise _no_run_of(
            "opened", f"has shape {opened.shape}", f"[frames, {sensor.subgroups} subgroups]"
        )
    ends = {
        "pulse": len(opened) * config.pulses,
        "subgroup": sensor.subgroups,
        "stamp": config.period_ticks,
        "count": sensor.pixels + 1,
        "winner": sensor.pixels,
    }
    length = len(arrays["pulse"])
    columns = {name: _column(arrays, name, length, end) for name, end in ends.items()}
    if "hits" in arrays:
        words = -(-sensor.pixels // BEAT_BITS)
        hits = np.asarray(arrays["hits"])
        if hits.shape != (length, words) or hits.dtype.kind != "u":
            raise _no_run_of(
                "hits", f"is {hits.dtype}{list(hits.shape)}", f"uint64[{length}, {words}]"
            )
        columns["hits"] = hits.astype(np.uint64, copy=False)
    return columns | {"opened": opened}


def _column(arrays: Mapping[str, np.ndarray], name: str, length: int, end: int) -> np.ndarray:
    """Return a column of integers from 0 on, below `end`, as int64. Raises `InputError`."""
    values = np.asarray(arrays[name])
    if values.shape != (length,) or values.dtype.kind not in "iu":
        raise _no_run_of(
            name,
            f"is {values.dtype}{list(values.shape)}",
            f"integers, one for each of {length} events",
        )
    if length and not (values.min() >= 0 and values.max() < end):
        raise _no_run_of(name, f"is {values.min()} to {values.max()}", f"0 to {end - 1}")
    return values.astype(np.int64, copy=False)


def _no_run_of(name: str, found: str, due: str) -> InputError:
    """Return that an array cannot come from a run of a configuration."""
    return InputError(
        f"arrays: {name} {found}, must be {due}; the configuration must be that of the run",
        field="arrays",
    )


class KnownCounters(NamedTuple):
    """Counters of a result, also where a counter of the sensor is at its end.

    least: int64[frames, subgroups] by name, at least so many; known: bool[frames, subgroups] by
    name, exactly so many.
    """

    least: dict[str, np.ndarray]
    known: dict[str, np.ndarray]


def at_end(name: str, counted: np.ndarray, sensor: Sensor) -> np.ndarray:
    """Return where a counter is at its end, so that it may have counted more; bool, shape of
    `counted`.
    """
    if name == "threshold_used":  # it has its own width
        return np.zeros(counted.shape, bool)
    return counted >= sensor.counter_max


def known_counters(arrays: Mapping[str, np.ndarray], config: Config) -> KnownCounters:
    """Return the counters of a result's frames, as far as they are known.

    A counter stays at its end, 2^`counter_bits` - 1 (docs/contract.md). Words that left the sensor
    can be counted, and the sums of the contract's *Losses* tell others. arrays: with all events and
    records of the frames for which counters at their end are to be known.
    """
    least = {name: arrays[name] for name in COUNTER_NAMES}
    known = {name: ~at_end(name, arrays[name], config.sensor) for name in COUNTER_NAMES}
    if all(one.all() for one in known.values()):
        return KnownCounters(least, known)
    for name, of_word in (("stored", ""), ("mg_stored", "mg_")):
        frame = arrays[f"{of_word}pulse"] // config.pulses
        words = np.zeros_like(least[name])
        np.add.at(words, (frame, arrays[f"{of_word}subgroup"]), 1)
        least[name] = np.maximum(least[name], words)
        known[name] = np.ones_like(known[name])
    for whole, parts in (
        ("committed", ("stored", "dropped")),
        ("opened", ("committed", "rejected")),
    ):
        sum_of_parts = sum(least[part] for part in parts)
        least[whole] = np.maximum(least[whole], sum_of_parts)
        known[whole] = known[whole] | np.logical_and.reduce([known[part] for part in parts])
    return KnownCounters(least, known)


def events_table(arrays: dict[str, np.ndarray]) -> Any:
    """Return one row per event, as a pandas DataFrame if pandas is installed, otherwise as a
    structured array.

    The columns are those of `EVENT_COLUMNS`, and `hits` (`map_numbers`) unless the format has no
    map. Row i belongs to row i of the array `mg_offset`, which holds several values per event.
    Raises `InputError` if an array is missing.
    """
    check_arrays(arrays, *EVENT_COLUMNS)
    columns = {name: arrays[name] for name in EVENT_COLUMNS}
    if "hits" in arrays:
        columns["hits"] = map_numbers(arrays["hits"])
    try:
        from pandas import DataFrame
    except ImportError:
        return np.rec.fromarrays(
            columns.values(), dtype=[(name, column.dtype) for name, column in columns.items()]
        )
    return DataFrame(columns)


def map_numbers(hits: np.ndarray) -> np.ndarray:
    """Return the ID map of each event as one number: bit i is pixel i of the subgroup.

    hits: uint64[n, words]. Returns uint64[n] for maps of one word, otherwise Python's integers,
    object[n].
    """
    if hits.shape[1] == 1:
        return hits[:, 0]
    numbers = np.zeros(len(hits), object)
    for word in reversed(range(hits.shape[1])):
        numbers = (numbers << 64) | hits[:, word].astype(object)
    return numbers


def stall(cycles: int) -> np.ndarray:
    """Return a `tready` that is low for the first `cycles` cycles of every frame."""
    return np.zeros(cycles, np.uint8)


def write_result(path: FilePath, arrays: dict[str, np.ndarray]) -> None:
    """Write a result file (NPZ), whole or not at all. Raises `InputError` for another suffix, or if
    an array is missing.
    """
    check_arrays(arrays, *EVENT_COLUMNS, *RECORD_COLUMNS, *COUNTER_NAMES)
    write_npz(path, arrays)


def read_result(path: FilePath) -> dict[str, np.ndarray]:
    """Return the arrays of a result file. Raises `InputError` if the file is not a result."""
    return read_npz(path, (*EVENT_COLUMNS, *RECORD_COLUMNS, *COUNTER_NAMES), OPTIONAL)


def differences(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> list[str]:
    """Return the differences of two results, one line per array, without `NOT_SENT`."""
    lines = []
    for name in sorted((first.keys() | second.keys()) - NOT_SENT):
        a, b = first.get(name), second.get(name)
        if a is None or b is None:
            lines.append(f"{name}: only in one")
        elif a.shape != b.shape or a.dtype != b.dtype:
            lines.append(f"{name}: {a.dtype}{list(a.shape)} and {b.dtype}{list(b.shape)}")
        elif not np.array_equal(a, b):
            at = np.unravel_index(np.flatnonzero((a != b).ravel())[0], a.shape)
            lines.append(f"{name}{list(map(int, at))}: {a[at]} and {b[at]}")
    return lines
