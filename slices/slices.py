# SPDX-License-Identifier: Apache-2.0
"""Slices of any netlist, from Python: every lane is a copy of the design with inputs and
registers of its own.
"""

import ctypes
from collections.abc import Sequence

import numpy as np

from ..model.shared.errors import InputError, check_integer
from ..model.shared.quantities import check_choice
from ..tools.libraries import Functions, array_at, load
from .library import LANES, PROCESSOR, library
from .probe import Probe, numbers
from .synthesis import Design


class Slices:
    """Lanes of a design, from power-up. Registers have their initial values, inputs are 0. A
    context manager.

    lanes: 64, 128, 256 or 512. flag: g++'s choice of a processor. Raises `InputError` for another
    number of lanes, a port that the design does not have, and a number that does not fit.
    """

    def __init__(self, design: Design, lanes: int = 64, flag: str = PROCESSOR):
        self.lanes = check_choice("lanes", lanes, LANES)
        self.probe = Probe(design.emission())
        self._layout = self.probe.layout
        pointer, i64 = ctypes.c_void_p, ctypes.c_int64
        functions: Functions = {
            "new": (pointer, []),
            "delete": (None, [pointer]),
            "words": (pointer, [pointer]),
            "flags": (pointer, [pointer]),
            "step": (None, [pointer, i64]),
            "record": (None, [pointer, ctypes.c_int, i64, pointer]),
        }
        self._library = load(library(design, lanes, flag=flag), "slice", functions)
        self._slice = self._library.slice_new()
        self.words = array_at(
            self._library.slice_words(self._slice), (self._layout.words, lanes // 64)
        )
        self._flags = array_at(
            self._library.slice_flags(self._slice), (max(1, self._layout.flags),), np.uint8
        )
        self.step(0)

    def __enter__(self) -> "Slices":
        return self

    def __exit__(self, *_: object) -> None:
        del self.words, self._flags
        self._library.slice_delete(self._slice)

    def set(self, port: str, values: Sequence[int] | int) -> None:
        """Set an input. values: a number for every lane, or one for all of them."""
        check_choice("port", port, tuple(self._layout.inputs))
        self._put(port, self._layout.inputs[port], values)
        for word, flags in zip(
            self._layout.inputs[port], self._layout.flags_of.get(port, ()), strict=False
        ):
            self._flags[flags] |= self.words[word].any()

    def get(self, port: str) -> list[int]:
        """Return an output's number in every lane."""
        check_choice("port", port, tuple(self._layout.outputs))
        return numbers(self.words[self._layout.outputs[port]])

    def peek(self, name: str) -> list[int]:
        """Return a signal's number in every lane, for any signal of `probe.signals`."""
        return numbers(self.probe.values(self.words, [name])[name])

    def poke(self, name: str, values: Sequence[int] | int) -> None:
        """Set a register. values: a number for every lane, or one for all of them."""
        self._put(name, self.probe.words(name), values)

    def step(self, edges: int = 1) -> None:
        """Run some clock edges. Afterwards the outputs follow from registers and inputs."""
        self._library.slice_step(self._slice, edges)

    def record(self, lane: int, edges: int = 1) -> np.ndarray:
        """Run some clock edges, and return the lane's sample before each of them, uint64[edges,
        m], for `waves`. Raises `InputError` for a lane that is not there.
        """
        lane = check_integer("lane", lane, 0, self.lanes - 1)
        samples = np.zeros((edges, -(-self._layout.words // 64)), np.uint64)
        self._library.slice_record(self._slice, lane, edges, samples.ctypes.data)
        return samples

    def _put(self, name: str, words: Sequence[int], values: Sequence[int] | int) -> None:
        if isinstance(values, Sequence | np.ndarray):
            each = list(values)
        else:
            each = [values] * self.lanes
        if len(each) != self.lanes:
            raise InputError(f"{name}: has {len(each)} numbers, must have one, or {self.lanes}")
        most = (1 << len(words)) - 1
        size = -(-len(words) // 8)
        data = np.frombuffer(
            b"".join(
                check_integer(name, value, 0, most).to_bytes(size, "little") for value in each
            ),
            np.uint8,
        )
        bits = np.unpackbits(data.reshape(self.lanes, size), axis=1, bitorder="little")[
            :, : len(words)
        ]
        packed = np.packbits(np.ascontiguousarray(bits.T), axis=1, bitorder="little")
        self.words[list(words)] = packed.view(np.uint64)
