# SPDX-License-Identifier: Apache-2.0
"""Whole sensors in the lanes of a slice, each with a fault of its own, and the hosts in C++ that use them (`lanes.cpp`)."""

import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

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
OUTCOMES = (
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
Access: TypeAlias = tuple[
    int, int, int, int, int
]  # address, value, strobe (0: a read; RESET), skew, hold: as in `lanes.cpp`
RESET = 16
ACCESS = np.dtype(
    [(name, np.uint32) for name in ("address", "value", "strobe")]
    + [(name, np.int32) for name in ("skew", "hold")]
)
UPSET = np.dtype([("word", np.int32), ("cycle", np.int64), ("source", np.int32)], align=True)
FLIPS = -1  # the source of an upset flip-flop that takes no other's value
ROW = np.dtype(
    [(name, np.int32) for name in ("trial", "frame", "outcome", "shown", "write", "cycles")]
)
BEAT = np.dtype([("data", np.uint64), ("cycle", np.int64)])


@define
class Shown:
    """Record of a frame: per stream its beats and their cycles, the laser's cycles, and a digest of the gates."""

    beats: list[np.ndarray]
    cycles: list[np.ndarray]
    lasers: np.ndarray
    gates: int


class Lanes:
    """Lanes of a sensor's design, `width` of them. A context manager."""

    def __init__(self, sensor: Sensor, design: Design, width: int = LANES[-1]):
        self._sensor, self._width = sensor, width
        pointer, i64 = ctypes.c_void_p, ctypes.c_int64
        lists = ctypes.POINTER(pointer)
        functions: Functions = {
            "new": (pointer, []),
            "delete": (None, [pointer]),
            "recipe": (
                None,
                [pointer, *5 * [i64, pointer], *[i64, *3 * [pointer]], *[i64, pointer], i64, i64],
            ),
            "warm_up": (None, [pointer]),
            "run": (None, [pointer, pointer, ctypes.c_int]),
            "together": (None, [pointer, i64, pointer, pointer]),
            "word": (pointer, [pointer, ctypes.c_int]),
            "rows": (i64, [pointer, lists]),
            "forget": (None, [pointer]),
            "beats": (i64, [pointer, ctypes.c_int, ctypes.c_int, lists]),
            "lasers": (i64, [pointer, ctypes.c_int, lists]),
            "gates": (ctypes.c_uint64, [pointer, ctypes.c_int]),
        }
        self._library = load(
            library(design, width, SOURCE, _wiring_header(sensor)), "lanes", functions
        )
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
        upsets: Sequence[tuple[int, int, int]] = (),
        patient: bool = True,
    ) -> None:
        """Add a frame that every host plays. patient: it waits for frames that an upset makes as long as counters go.

        Of `together` only: accesses during the frame and after it, and others beside the latter; upsets (word of a flip-flop,
        cycle from the start's write on, word of the flip-flop whose value it takes, or `FLIPS`).
        """
        settings = [(address, value, 15, 0, 0) for address, value in config.register_writes()]
        columns = port_bits(config, edges)
        order = np.argsort(columns[0], kind="stable")
        # A period or a frame that an upset makes longer lasts until the end of its counter.
        limit = cycle_limit(config, len(ready))
        if patient:
            limit = 2 * limit + 2 * config.pulses * 2 * self._sensor.period_max
        lists = [
            *(
                (np.array(list(accesses), ACCESS),)
                for accesses in (settings, during, after, beside)
            ),
            (np.array(sorted(upsets, key=lambda upset: upset[1]), UPSET),),
            tuple(np.ascontiguousarray(column[order], np.int64) for column in columns),
            (np.ascontiguousarray(ready, np.uint8),),
        ]
        arguments = [
            x
            for arrays in lists
            for x in (len(arrays[0]), *(array.ctypes.data for array in arrays))
        ]
        self._library.lanes_recipe(self._lanes, *arguments, config.frame_cycles, limit)

    def warm_up(self) -> np.ndarray:
        """Reset a sensor, program it, play every frame and the first one again; return the rows. Trials begin here."""
        self._library.lanes_warm_up(self._lanes)
        return self._rows()

    def run(self, upsets: Sequence[tuple[int, int]]) -> np.ndarray:
        """Play trials, and return the rows of every one in turn. upsets: word of the flip-flop, cycle of the first frame."""
        table = np.array([(word, cycle, FLIPS) for word, cycle in upsets], UPSET)
        self._library.lanes_run(self._lanes, table.ctypes.data, len(table))
        rows = self._rows()
        return rows[np.argsort(rows["trial"], kind="stable")]

    def together(
        self, faults: Sequence[int], watched: Sequence[int] = ()
    ) -> tuple[np.ndarray, np.ndarray]:
        """Let one host play all lanes from power-up; return its rows, and at which frame each lane begins to differ from lane 0.

        faults: of each lane except lane 0, the word of an input that turns its fault on. watched: words of registers that
        are compared, too. A lane that never differs has -1.
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
        beats = [
            self._list("beats", BEAT, ctypes.c_int(number), ctypes.c_int(stream))
            for stream in range(self._sensor.streams)
        ]
        lasers = self._list("lasers", np.dtype(np.int64), ctypes.c_int(number))
        gates = self._library.lanes_gates(self._lanes, number)
        return Shown(
            [beat["data"] for beat in beats], [beat["cycle"] for beat in beats], lasers, gates
        )

    def _rows(self) -> np.ndarray:
        """Return the rows since the last call: trial, frame, outcome, number of the record, cycles with the gap."""
        rows = self._list("rows", ROW)
        self._library.lanes_forget(self._lanes)
        return rows

    def _list(self, name: str, kind: np.dtype, *which: ctypes.c_int) -> np.ndarray:
        first = ctypes.c_void_p()
        n = getattr(self._library, f"lanes_{name}")(self._lanes, *which, ctypes.byref(first))
        return array_at(first.value, (n,), kind).copy()


def _wiring_header(sensor: Sensor) -> str:
    """Return the C++ header that describes a sensor to `lanes.cpp`."""
    control = registers.BY_NAME["control"]
    streams = [sensor.stream_name(k) for k in range(sensor.streams)]
    spads = ", ".join(f"IN_spad_{s}" for s in range(sensor.subgroups))
    bits = {
        "TREADY": [f"IN_{name}_tready[0]" for name in streams],
        "TVALID": [f"OUT_{name}_tvalid[0]" for name in streams],
        "TLAST": [f"OUT_{name}_tlast[0]" for name in streams],
    }
    return "\n".join(
        [
            "#pragma once",
            f"constexpr int STREAMS = {sensor.streams}, GAP = {GAP};",
            f"constexpr uint32_t CONTROL = {registers.address('control')}, START = {1 << control.bit('start')};",
            f"constexpr uint32_t STATUS = {registers.address('status')};",
            *(f"constexpr int {name}[] = {{{', '.join(words)}}};" for name, words in bits.items()),
            f"constexpr const int* TDATA[] = {{{', '.join(f'OUT_{name}_tdata' for name in streams)}}};",
            f"constexpr const int* SPADS[] = {{{spads}}};",
            "",
        ]
    )
