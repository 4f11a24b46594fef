# SPDX-License-Identifier: Apache-2.0
"""Assembly of beats into whole frames, wherever a transport happens to cut the stream."""

import numpy as np

from ..model.contract.packet import FRAME_END, FRAME_START, layout
from ..model.contract.parameters import Sensor
from ..model.contract.stream import NO_HEADER, StreamError, is_grouped, kind_of


class FrameAssembler:
    """Cuts a stream into frames by its headers, because transports do not carry `tlast`.

    stream: its number in the sensor. frames: whole frames (uint64[n] each) that have not been taken yet.
    """

    def __init__(self, sensor: Sensor, stream: int = 0):
        self.stream = stream
        self.frames: list[np.ndarray] = []
        self._lengths = layout(sensor).lengths(len(sensor.stream_subgroups(stream)))
        self._beats = np.zeros(0, np.uint64)
        self._at = 0  # place of the next header in them

    def add(self, beats: np.ndarray) -> None:
        """Append beats (uint64[n]) to the stream. If they cannot be a frame, drop them and raise `StreamError`."""
        self._beats = np.concatenate([self._beats, np.asarray(beats, np.uint64)])
        while self._at < len(self._beats):
            kind = kind_of(self._beats[self._at], self._at > 0 and is_grouped(self._beats[0]))
            length = int(self._lengths[kind])
            if length == 0 or (kind == FRAME_START.code) != (self._at == 0):
                at = self._at
                self.forget()
                raise StreamError(f"beat {at} of a frame: {NO_HEADER}")
            if self._at + length > len(self._beats):
                return
            self._at += length
            if kind == FRAME_END.code:
                self.frames.append(self._beats[: self._at].copy())
                self._beats, self._at = self._beats[self._at :], 0

    def forget(self) -> None:
        """Drop an incomplete frame, because the stream begins anew."""
        self._beats, self._at = np.zeros(0, np.uint64), 0
