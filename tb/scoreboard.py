# SPDX-License-Identifier: Apache-2.0
"""Scoreboard: compares the RTL with the golden model's prediction, and reports the first
difference in a designer's terms.
"""

import numpy as np

from ..model.contract.counters import COUNTER_BITS, COUNTER_NAMES
from ..model.contract.packet import (
    FRAME_END,
    FRAME_START,
    GROUP_KIND,
    KIND_BITS,
    KIND_LSB,
    PACKETS,
    header_field,
    layout,
    packet_fields,
    parts_of,
)
from ..model.contract.parameters import Sensor
from ..model.golden.frame import Trace
from .frame_record import Recorded
from .rtl_errors import Mismatch

NO_COUNTER = "what follows the last counter"  # half a beat, if their number is odd


def locate(beats: np.ndarray, index: int, sensor: Sensor) -> tuple[int, int]:
    """Return (first beat of the packet with beat `index` of a frame, its kind); counters belong
    to the frame end.
    """
    lengths, at = layout(sensor).lengths(sensor.subgroups), 0
    while True:
        kind = int(header_field(beats[at], "kind"))
        if index < at + lengths[kind] or kind == FRAME_END.code:
            return at, kind
        at += int(lengths[kind])


def check(sensor: Sensor, expected: Trace, record: Recorded, frame: int = 0) -> int:
    """Check a whole frame's record and return the number of beats and commits compared.

    Raises `Mismatch` at the first difference in time.
    """
    streams = range(sensor.streams)
    if (
        all(np.array_equal(record.beats[k], expected.beats[k]) for k in streams)
        and all(np.array_equal(record.beat_cycle[k], expected.beat_cycle[k]) for k in streams)
        and np.array_equal(record.commit_subgroup, expected.commit_subgroup)
        and np.array_equal(record.commit_cycle, expected.commit_cycle)
    ):
        return sum(map(len, expected.beats)) + len(expected.commit_cycle)
    board = Scoreboard(sensor, expected, frame)
    shown = [
        (cycle, 0, s, 0, 0)
        for s, cycle in zip(
            record.commit_subgroup.tolist(), record.commit_cycle.tolist(), strict=True
        )
    ]
    for k in streams:
        ends = len(record.beats[k]) - 1
        shown += [
            (cycle, 1, k, data, i == ends)
            for i, (cycle, data) in enumerate(
                zip(record.beat_cycle[k].tolist(), record.beats[k].tolist(), strict=True)
            )
        ]
    for cycle, is_beat, which, data, last in sorted(shown):
        if is_beat:
            board.beat(which, cycle, data, bool(last))
        else:
            board.commit(which, cycle)
    board.finish()
    return board.checked


class Scoreboard:
    """Checks one frame against its `Trace`, beat by beat and commit by commit, as they arrive."""

    def __init__(self, sensor: Sensor, expected: Trace, frame: int = 0):
        self.sensor, self.expected, self.frame = sensor, expected, frame
        self.beats = [0] * sensor.streams
        self.checked = 0
        per_subgroup = np.bincount(expected.commit_subgroup, minlength=sensor.subgroups)
        self._commits = np.split(expected.commit_cycle, np.cumsum(per_subgroup)[:-1])
        self._commit_index = [0] * sensor.subgroups

    def beat(self, stream: int, cycle: int, data: int, last: bool) -> None:
        """Check a beat that was transferred. Raises `Mismatch` at the first difference."""
        index, beats = self.beats[stream], self.expected.beats[stream]
        if index >= len(beats):
            raise Mismatch(
                f"frame {self.frame}, stream {stream}, cycle {cycle}: beat {index} after the frame's end: {data:#018x}"
            )
        expected, due = int(beats[index]), int(self.expected.beat_cycle[stream][index])
        if data != expected:
            self._explain(stream, index, cycle, data)
        if cycle != due:
            raise Mismatch(
                f"{self._where(stream, index, cycle)}: transferred in cycle {cycle}, golden model {due}"
            )
        if last != (index == len(beats) - 1):
            raise Mismatch(
                f"{self._where(stream, index, cycle)}: tlast is {int(last)}, golden model {int(not last)}"
            )
        self.beats[stream] += 1
        self.checked += 1

    def commit(self, subgroup: int, cycle: int) -> None:
        """Check an event that was stored."""
        index, due = self._commit_index[subgroup], self._commits[subgroup]
        if index >= len(due) or due[index] != cycle:
            expected = (
                f"golden model in cycle {due[index]}"
                if index < len(due)
                else "golden model stores none"
            )
            raise Mismatch(
                f"frame {self.frame}, subgroup {subgroup}, event {index}: stored in cycle {cycle}, {expected}"
            )
        self._commit_index[subgroup] += 1
        self.checked += 1

    def finish(self) -> None:
        """End the frame. Raises `Mismatch` if something is missing."""
        for stream, beats in enumerate(self.expected.beats):
            if self.beats[stream] != len(beats):
                raise Mismatch(
                    f"frame {self.frame}, stream {stream}: {self.beats[stream]} beats, golden model {len(beats)}"
                )
        for subgroup, due in enumerate(self._commits):
            if self._commit_index[subgroup] != len(due):
                raise Mismatch(
                    f"frame {self.frame}, subgroup {subgroup}: {self._commit_index[subgroup]} events stored, golden model {len(due)}"
                )

    def _where(self, stream: int, index: int, cycle: int) -> str:
        beats = self.expected.beats[stream]
        start, kind = locate(beats, index, self.sensor)
        of = "all subgroups"
        if kind == GROUP_KIND:
            return f"frame {self.frame}, stream {stream}, cycle {cycle}, beat {index} of the frame, in a group of events"
        if PACKETS[kind] not in (FRAME_START, FRAME_END):
            fields = packet_fields(beats, np.array([start]), self.sensor, PACKETS[kind])
            of = ", ".join(
                f"{name} {fields[name][0, 0]}"
                for name in ("subgroup", "minigroup", "pulse")
                if name in fields
            )
        packet = f"{PACKETS[kind].name} packet, beat {index - start} of it"
        return f"frame {self.frame}, stream {stream}, {of}, cycle {cycle}, {packet}"

    def _explain(self, stream: int, index: int, cycle: int, data: int) -> None:
        beats, counter_beats = self.expected.beats[stream], layout(self.sensor).counter_beats
        expected = int(beats[index])
        start, kind = locate(beats, index, self.sensor)
        where, beat = self._where(stream, index, cycle), index - start
        if beat and kind == FRAME_END.code:
            word, high = divmod(beat - 1, counter_beats)
            low_part = (data ^ expected) & ((1 << COUNTER_BITS) - 1)
            shift = 0 if low_part else COUNTER_BITS
            number = 2 * high + (shift > 0)
            name = f"counter {COUNTER_NAMES[number]}" if number < len(COUNTER_NAMES) else NO_COUNTER
            subgroup = self.sensor.stream_subgroups(stream)[word]
            got, want = (value >> shift & ((1 << COUNTER_BITS) - 1) for value in (data, expected))
            differing = f"{name} of subgroup {subgroup} is {got}, golden model {want}"
        elif kind == GROUP_KIND:
            differing = f"{data:#018x}, golden model {expected:#018x}"
        else:
            parts = [part for part in parts_of(self.sensor, PACKETS[kind]) if part.beat == beat]
            fields = [(part.field, part.lsb, part.width) for part in reversed(parts)]
            differing = f"{data:#018x}, golden model {expected:#018x}"
            told = []
            for name, lsb, width in [("kind", KIND_LSB, KIND_BITS)] * (beat == 0) + fields:
                got, want = (value >> lsb & ((1 << width) - 1) for value in (data, expected))
                if got != want:
                    told.append(
                        f"{name} is {got}, golden model {want}"
                        if beat == 0
                        else f"{name} is {differing}"
                    )
            differing = "; ".join(told) or differing
        raise Mismatch(f"{where}: {differing}")
