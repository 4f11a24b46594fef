# SPDX-License-Identifier: Apache-2.0
"""Results as arrays: built from the beats of any engine, compared, written and read."""

from typing import Any

import numpy as np

from ..shared import pulse
from ..shared.files import FilePath, read_npz, write_npz
from .config import Config
from .counters import COUNTER_NAMES
from .packet import FORMATS, HEADER
from .stream import decode_frame

EVENT_FIELDS = ("subgroup", "pulse", "stamp", "count", "winner", "overrun")
EVENT_COLUMNS = (*EVENT_FIELDS, "commit_cycle")  # arrays with one value per event
RECORD_COLUMNS = ("mg_subgroup", "mg_pulse", "mg_stamp", "mg_map")
COMMIT_UNKNOWN = np.int64(-1)  # commit cycle of an event that was received from a chip
# present only in some formats, engines or lights
OPTIONAL = ("hits", "mg_offset", "fate", *pulse.ARRAYS)
NOT_SENT = {"fate", *pulse.ARRAYS}  # known of a simulation, not sent by the sensor


class ResultBuilder:
    """Collector of frames for the arrays of a result file."""

    def __init__(self, config: Config):
        self.config = config
        self._events: list[tuple[np.ndarray, ...]] = []
        self._records: list[tuple[np.ndarray, ...]] = []
        self._counters: list[np.ndarray] = []

    def add(
        self,
        beats: list[np.ndarray],
        commit_subgroup: np.ndarray | None = None,
        commit_cycle: np.ndarray | None = None,
    ) -> None:
        """Add a frame: its beats per stream, and subgroups and commit cycles of its stored
        events (by time in a subgroup).

        Without the latter, the commit cycles are `COMMIT_UNKNOWN`, because they cannot be seen
        outside the chip. Raises `StreamError` if the beats are not a whole frame, and
        `ValueError` if more or fewer events left than were stored.
        """
        sensor = self.config.sensor
        base = len(self._counters) * self.config.pulses
        counters = np.zeros((sensor.subgroups, len(COUNTER_NAMES)), np.int64)
        subgroups = [len(sensor.stream_subgroups(k)) for k in range(sensor.streams)]
        frames = [
            decode_frame(stream, sensor, n).check()
            for stream, n in zip(beats, subgroups, strict=True)
        ]
        for k, frame in enumerate(frames):
            counters[sensor.stream_subgroups(k)] = frame.counters
        columns = dict(
            zip(HEADER, np.concatenate([frame.events for frame in frames]).T, strict=True)
        )
        commit = np.full(len(columns["subgroup"]), COMMIT_UNKNOWN)
        if commit_subgroup is not None and commit_cycle is not None:
            order = np.argsort(commit_subgroup, kind="stable")
            left = np.argsort(columns["subgroup"], kind="stable")
            if not np.array_equal(columns["subgroup"][left], commit_subgroup[order]):
                raise ValueError(
                    "the events that left the sensor are not the ones that its FIFOs stored"
                )
            commit[left] = commit_cycle[order]
        columns["pulse"] = columns["pulse"] + base
        hits, offsets, records, entries = (
            np.concatenate([getattr(frame, name) for frame in frames])
            for name in ("hits", "offsets", "records", "entries")
        )
        self._events.append((*(columns[name] for name in EVENT_FIELDS), commit, hits, offsets))
        self._records.append((records[:, 0], records[:, 1] + base, entries))
        self._counters.append(counters)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of the result file, with rows frame by frame, and stream by stream
        within a frame.
        """
        *fields, commit, hits, offsets = (
            np.concatenate(column) for column in zip(*self._events, strict=True)
        )
        result = dict(zip(EVENT_FIELDS, fields, strict=True))
        result["overrun"] = result["overrun"].astype(bool)
        result["commit_cycle"] = commit
        packet = FORMATS[self.config.format]
        if packet.has("map"):
            result["hits"] = hits
        if packet.has("offsets"):
            result["mg_offset"] = offsets
        subgroup, pulse, entries = (
            np.concatenate(column) for column in zip(*self._records, strict=True)
        )
        result |= {"mg_subgroup": subgroup, "mg_pulse": pulse}
        result |= {
            "mg_stamp": entries[:, :, 0].astype(np.uint16),
            "mg_map": entries[:, :, 1].astype(np.uint16),
        }
        return result | {
            name: np.stack([frame[:, i] for frame in self._counters])
            for i, name in enumerate(COUNTER_NAMES)
        }


def events_table(arrays: dict[str, np.ndarray]) -> Any:
    """Return one row per event, as a pandas DataFrame if pandas is installed, otherwise as a
    structured array.

    The columns are those of `EVENT_COLUMNS`, and `hits` (`map_numbers`) unless the format has no
    map. Row i belongs to row i of the array `mg_offset`, which holds several values per event.
    """
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
    """Write a result file (NPZ), whole or not at all. Raises `InputError` for another suffix."""
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
