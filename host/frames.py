# SPDX-License-Identifier: Apache-2.0
"""From beats to whole frames, wherever a transport happens to cut the stream."""

import numpy as np

from ..model.contract.packet import Kind, header_field, layout
from ..model.contract.parameters import Sensor
from ..model.contract.stream import StreamError

LENGTHLESS = "not a packet header where one is due"


class FrameAssembler:
    """Cuts a stream into frames by its headers, as no transport keeps `tlast`.

    stream: which of the sensor's. frames: whole frames (uint64[n] each) that nobody has taken yet.
    """

    def __init__(self, sensor: Sensor, stream: int = 0):
        self.stream = stream
        self.frames: list[np.ndarray] = []
        parts = layout(sensor)
        kinds = (Kind.EVENT_SHORT, Kind.EVENT_ID, Kind.EVENT_FULL, Kind.RECORD)
        self._lengths = {int(kind): parts.length(kind) for kind in kinds}
        self._lengths |= {
            int(Kind.FRAME_START): 1,
            int(Kind.FRAME_END): 1 + parts.counter_beats * len(sensor.stream_subgroups(stream)),
        }
        self._beats = np.zeros(0, np.uint64)
        self._at = 0  # the next header's place in them

    def add(self, beats: np.ndarray) -> None:
        """Takes beats (uint64[n]) that follow those before. Raises `StreamError` where they cannot be a frame, and forgets them."""
        self._beats = np.concatenate([self._beats, np.asarray(beats, np.uint64)])
        while self._at < len(self._beats):
            kind = int(header_field(self._beats[self._at], "kind"))
            length = self._lengths.get(kind)
            if length is None or (kind == Kind.FRAME_START) != (self._at == 0):
                at = self._at
                self.forget()
                raise StreamError(f"beat {at} of a frame: {LENGTHLESS}")
            if self._at + length > len(self._beats):
                return
            self._at += length
            if kind == Kind.FRAME_END:
                self.frames.append(self._beats[: self._at].copy())
                self._beats, self._at = self._beats[self._at :], 0

    def forget(self) -> None:
        """Drops what is not a whole frame yet: the stream begins anew."""
        self._beats, self._at = np.zeros(0, np.uint64), 0
