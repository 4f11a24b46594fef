# SPDX-License-Identifier: Apache-2.0
"""Whole sensors in the lanes of a slice, and the hosts in C++ that use them (`lanes.cpp`).

Either every lane has a host and an upset of its own (`run`), or every lane has a fault of its own,
and one host plays all of them (`together`).
"""

import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from attrs import define

from coincid.model.contract import registers
from coincid.model.contract.config import Config
from coincid.model.contract.edges import Edges
from coincid.model.contract.parameters import Sensor
from coincid.model.contract.pixels import port_bits
from coincid.slices.library import LANES, library
from coincid.slices.synthesis import Design
from coincid.tb.frame_record import cycle_limit
from coincid.tools.libraries import Functions, array_at, load

SOURCE = Path(__file__).with_suffix(".cpp")
OUTCOMES = (  # of a frame, by number
    "fine",
    "the bus waits",
    "never done",
    "start refused",
    "no laser",
    "no tlast",
    "error told",
)
FRAMES = ("upset", "first", "second")  # of a trial
AFTER = len(FRAMES)  # in the place of a frame: the settings as they read at the end
GAP = 30  # idle cycles between frames
WHOLE = 15  # strobe of a word
RESET = 16  # in the place of a strobe: no access, but a reset of the sensor
FLIPS = -1  # source of a flip-flop that flips


class Access(NamedTuple):
    """What a host does on the register bus."""

    address: int
    value: int
    strobe: int  # of the bytes to write; 0 is a read, `RESET` a reset
    skew: int  # cycles by which the data come after the address, or before it if negative
    hold: int  # cycles until the answer is taken


class Upset(NamedTuple):
    """A flip-flop that gets another value."""

    word: int  # of the flip-flop
    cycle: int  # after whose edge; from the write of the start on, or in the first frame of a trial
    source: int  # word of the flip-flop whose value it takes; `FLIPS`: it flips


# As structures of `lanes.cpp`.
ACCESS = np.dtype(
    [
        ("address", np.uint32),
        ("value", np.uint32),
        ("strobe", np.uint32),
        ("skew", np.int32),
        ("hold", np.int32),
    ]
)
UPSET = np.dtype([("word", np.int32), ("cycle", np.int64), ("source", np.int32)], align=True)
BEAT = np.dtype([("data", np.uint64), ("cycle", np.int64)])
ROW = np.dtype(
    [
        ("trial", np.int32),
        ("frame", np.int32),  # index in `FRAMES`, or `AFTER`
        ("outcome", np.int32),  # index in `OUTCOMES`
        ("shown", np.int32),  # number of the record
        ("write", np.int32),  # whether an access was under way at the upset
        ("cycles", np.int32),  # of the frame, with the gap
    ]
)


@define
class Shown:
    """Record of a frame."""

    beats: list[np.ndarray]  # of each stream, uint64[n]
    cycles: list[np.ndarray]  # of the beats, int64[n] of each stream
    lasers: np.ndarray  # int64[n], cycles in which the laser fires
    gates: int  # digest of the SPADs' gates


class Lanes:
    """Lanes of a sensor's design, `width` of them. A context manager."""

    def __init__(self, sensor: Sensor, design: Design, width: int = LANES[-1]):
        self._sensor = sensor
        self._width = width
        file = library(design, width, SOURCE, _wiring_header(sensor))
        self._library = load(file, "lanes", _functions())
        self._lanes = self._library.lanes_new()

    def __enter__(self) -> "Lanes":
        return self

    def __exit__(self, *_: object) -> None:
        self._library.lanes_delete(self._lanes)

    def recipe(
        self,
        config: Config,
        edges: Edges,
        ready: np.ndarray,
        *,
        during: Sequence[Access] = (),
        after: Sequence[Access] = (),
        beside: Sequence[Access] = (),
        upsets: Sequence[Upset] = (),
        patient: bool = True,
    ) -> None:
        """Add a frame that every host plays.

        edges: of the frame; ready: of the receiver, uint8[cycles]; patient: it waits for frames
        that an upset makes as long as counters go. Of `together` only: accesses during the frame
        and after it; beside: others at the same time as the latter; upsets.
        """
        settings = [Access(*pair, WHOLE, 0, 0) for pair in config.register_writes()]
        by_cycle = sorted(upsets, key=lambda upset: upset[1])
        columns = port_bits(config, edges)
        order = np.argsort(columns[0], kind="stable")
        ports = [np.ascontiguousarray(column[order], np.int64) for column in columns]
        limit = cycle_limit(config, len(ready))
        if patient:
            # A period or a frame that an upset makes longer lasts until the end of its counter.
            limit = 2 * limit + 2 * config.pulses * 2 * self._sensor.period_max
        lists = [
            [np.array(settings, ACCESS)],
            [np.array(list(during), ACCESS)],
            [np.array(list(after), ACCESS)],
            [np.array(list(beside), ACCESS)],
            [np.array(by_cycle, UPSET)],
            ports,
            [np.ascontiguousarray(ready, np.uint8)],
        ]
        arguments: list[Any] = []
        for arrays in lists:
            arguments.append(len(arrays[0]))
            arguments += [array.ctypes.data for array in arrays]
        self._library.lanes_recipe(self._lanes, *arguments, config.frame_cycles, limit)

    def warm_up(self) -> np.ndarray:
        """Reset a sensor, program it, play every frame and the first one again; return the rows.

        Trials begin here.
        """
        self._library.lanes_warm_up(self._lanes)
        return self._rows()

    def run(self, upsets: Sequence[tuple[int, int]]) -> np.ndarray:
        """Play trials, and return the rows of every one in turn.

        upsets: of each trial, the word of a flip-flop that flips, and a cycle of the first frame.
        """
        table = np.array([Upset(word, cycle, FLIPS) for word, cycle in upsets], UPSET)
        self._library.lanes_run(self._lanes, table.ctypes.data, len(table))
        rows = self._rows()
        return rows[np.argsort(rows["trial"], kind="stable")]

    def together(
        self, faults: Sequence[int], watched: Sequence[int] = ()
    ) -> tuple[np.ndarray, np.ndarray]:
        """Let one host play all lanes from power-up.

        Return its rows, and int32[lanes]: at which frame each lane begins to differ from lane 0. A
        lane that never differs has -1. faults: of each lane except lane 0, the word of an input
        that turns its fault on; watched: words of registers that are compared, too.
        """
        for lane, word in enumerate(faults, 1):
            chunks = array_at(self._library.lanes_word(self._lanes, word), (self._width // 64,))
            chunks[lane // 64] |= np.uint64(1 << lane % 64)
        differs = np.zeros(self._width, np.int32)
        words = np.array(watched, np.int32)
        self._library.lanes_together(
            self._lanes, len(words), words.ctypes.data, differs.ctypes.data
        )
        return self._rows(), differs

    def shown(self, number: int) -> Shown:
        """Return the record with this number, the same one for equal frames."""
        record = ctypes.c_int(number)
        beats = []
        cycles = []
        for stream in range(self._sensor.streams):
            of_stream = self._list("beats", BEAT, record, ctypes.c_int(stream))
            beats.append(of_stream["data"])
            cycles.append(of_stream["cycle"])
        lasers = self._list("lasers", np.dtype(np.int64), record)
        return Shown(beats, cycles, lasers, self._library.lanes_gates(self._lanes, number))

    def _rows(self) -> np.ndarray:
        """Return the rows since the last call, ROW[n]."""
        rows = self._list("rows", ROW)
        self._library.lanes_forget(self._lanes)
        return rows

    def _list(self, name: str, kind: np.dtype, *which: ctypes.c_int) -> np.ndarray:
        """Return a copy of a list of the library, kind[n]; which: the function's arguments."""
        first = ctypes.c_void_p()
        n = getattr(self._library, f"lanes_{name}")(self._lanes, *which, ctypes.byref(first))
        return array_at(first.value, (n,), kind).copy()


def _functions() -> Functions:
    """Return result and arguments of the library's functions; `lanes.cpp` has their names."""
    lanes = ctypes.c_void_p
    pointer = ctypes.c_void_p
    pointers = ctypes.POINTER(ctypes.c_void_p)  # where the first element is
    number = ctypes.c_int
    i64 = ctypes.c_int64
    one_list = [i64, pointer]
    edges = [i64, pointer, pointer, pointer]
    return {
        "new": (lanes, []),
        "delete": (None, [lanes]),
        "recipe": (None, [lanes, *5 * one_list, *edges, *one_list, i64, i64]),
        "warm_up": (None, [lanes]),
        "run": (None, [lanes, pointer, number]),
        "together": (None, [lanes, i64, pointer, pointer]),
        "word": (pointer, [lanes, number]),
        "rows": (i64, [lanes, pointers]),
        "forget": (None, [lanes]),
        "beats": (i64, [lanes, number, number, pointers]),
        "lasers": (i64, [lanes, number, pointers]),
        "gates": (ctypes.c_uint64, [lanes, number]),
    }


def _wiring_header(sensor: Sensor) -> str:
    """Return the C++ header that describes a sensor to `lanes.cpp`."""
    names = [sensor.stream_name(k) for k in range(sensor.streams)]
    ready = ", ".join(f"IN_{name}_tready[0]" for name in names)
    valid = ", ".join(f"OUT_{name}_tvalid[0]" for name in names)
    last = ", ".join(f"OUT_{name}_tlast[0]" for name in names)
    data = ", ".join(f"OUT_{name}_tdata" for name in names)
    spads = ", ".join(f"IN_spad_{s}" for s in range(sensor.subgroups))
    control, start = registers.control("start")
    return f"""\
#pragma once
constexpr int STREAMS = {sensor.streams}, GAP = {GAP};
constexpr uint32_t CONTROL = {control}, START = {start};
constexpr uint32_t STATUS = {registers.address("status")};
constexpr int TREADY[] = {{{ready}}};
constexpr int TVALID[] = {{{valid}}};
constexpr int TLAST[] = {{{last}}};
constexpr const int* TDATA[] = {{{data}}};
constexpr const int* SPADS[] = {{{spads}}};
"""
