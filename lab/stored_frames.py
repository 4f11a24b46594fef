# SPDX-License-Identifier: Apache-2.0
"""Frames of the golden model in a temporary file, one of which is in memory at a time."""

from collections.abc import Sequence
from typing import NamedTuple, overload

import numpy as np

from ..model.golden.frame import Ending, OpenFrame, Trace, trace_of
from ..model.golden.readout import Sent
from ..model.shared.spool import Block, Spool


class StoredFrames(Sequence[Trace]):
    """The traces of frames, each of which is read when somebody asks for it.

    counters: int64[subgroups, 11] of each frame.
    """

    def __init__(self) -> None:
        self.counters: list[np.ndarray] = []
        self._spool = Spool()
        self._frames: list[_StoredFrame] = []
        self._pieces: list[list[list[Block]]] = []  # of the open frame, [piece][stream][field]

    def take(self, opened: OpenFrame) -> None:
        """Store what has left the open frame."""
        self._pieces.append([[self._spool.put(part) for part in sent] for sent in opened.sent()])

    def end(self, opened: OpenFrame, fate: np.ndarray) -> None:
        """End the open frame. fate: uint8[n], of the trace."""
        ending = opened.close()
        self.take(opened)
        self._frames.append(_StoredFrame(self._pieces, ending, fate))
        self.counters.append(ending.counters)
        self._pieces = []

    def __len__(self) -> int:
        return len(self._frames)

    @overload
    def __getitem__(self, number: int) -> Trace: ...

    @overload
    def __getitem__(self, number: slice) -> list[Trace]: ...

    def __getitem__(self, number: int | slice) -> Trace | list[Trace]:
        """Read the trace of a frame."""
        if isinstance(number, slice):
            return [self[k] for k in range(len(self))[number]]
        frame = self._frames[number]
        streams = [
            [Sent(*(self._spool.joined(blocks) for blocks in zip(*of_stream, strict=True)))]
            for of_stream in zip(*frame.pieces, strict=True)
        ]
        return trace_of(streams, frame.ending, frame.fate)


class _StoredFrame(NamedTuple):
    """Where a frame stands, and what of it is in memory."""

    pieces: list[list[list[Block]]]  # [piece][stream][field of `Sent`]
    ending: Ending
    fate: np.ndarray  # uint8[n], of the trace
