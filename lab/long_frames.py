# SPDX-License-Identifier: Apache-2.0
"""Frames whose edges do not fit into memory: photons and golden model go through them together, in
pieces of whole periods.

The edges of the first pulses are kept for the views of laser periods; all others are forgotten.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Self

import numpy as np
from attrs import evolve, frozen

from ..model.contract.config import Config
from ..model.contract.edges import Edges
from ..model.golden.frame import Golden, OpenFrame, Trace
from ..model.shared.threads import Threads
from .setup import PhotonInputs
from .stored_frames import StoredFrames

EDGES_MAX = 1 << 24  # that a run keeps, about 400 MiB
EDGES_SHOWN_MAX = 1 << 21  # that it keeps for views, if it has more
Pieces = Iterator[tuple[int, Edges]]
Progress = Callable[[float, int], None]  # is told the finished share, and the edges so far


@frozen(eq=False)
class SeenEdges:
    """The edges of a frame, as far as they are kept: those of its first pulses.

    edges: pulses count from the frame's start. pulses: whose edges these are. total: number of the
    frame's edges.
    """

    edges: Edges
    pulses: int
    total: int


@frozen(eq=False)
class PlayedFrames:
    """Frames of the golden model, and what is kept of their edges; the fates in `traces` are those
    of the kept ones.

    counters: int64[subgroups, 11] of each frame. seen: empty if the run keeps all edges.
    """

    traces: Sequence[Trace]
    counters: list[np.ndarray]
    seen: list[SeenEdges]

    @classmethod
    def whole(cls, traces: Sequence[Trace]) -> Self:
        """Return frames of which all edges are kept."""
        return cls(traces, [trace.counters for trace in traces], [])


def is_long(photons: PhotonInputs) -> bool:
    """Return whether the edges of all frames may be more than `EDGES_MAX`."""
    return photons.edges_at_most > EDGES_MAX


def frame_pieces(chunks: Iterator[Edges], pulses: int) -> Pieces:
    """Yield each chunk's part of each frame with the frame's number; its pulses count from the
    frame's start.

    chunks: of whole pulses, in their order. pulses: of a frame.
    """
    for chunk in chunks:
        if not len(chunk):
            continue
        first = int(chunk.pulse[0]) // pulses
        last = int(chunk.pulse[-1]) // pulses
        borders = np.arange(first, last + 2) * pulses
        bounds = np.searchsorted(chunk.pulse, borders)
        for number in range(first, last + 1):
            own = chunk.take(slice(bounds[number - first], bounds[number - first + 1]))
            yield number, evolve(own, pulse=own.pulse - number * pulses)


def _told_pieces(chunks: Iterator[Edges], pulses: int, frames: int, progress: Progress) -> Pieces:
    """Yield what `frame_pieces` yields, and tell the progress after each piece."""
    done = 0
    for number, edges in frame_pieces(chunks, pulses):
        yield number, edges
        done += len(edges)
        progress((number + (edges.pulse.max(initial=0) + 1) / pulses) / frames, done)


def play_long_frames(
    golden: Golden,
    config: Config,
    chunks: Iterator[Edges],
    progress: Progress = lambda share, edges: None,
) -> PlayedFrames:
    """Play the frames of a configuration through the golden model.

    chunks: the edges of all frames, as `PhotonInputs.chunks` makes them. progress: is told the
    finished share, and the edges so far.
    """
    pieces = _told_pieces(chunks, config.pulses, config.frames, progress)
    upcoming = next(pieces, None)
    stored = StoredFrames()
    seen = []
    kept_max = EDGES_SHOWN_MAX // config.frames
    for number in range(config.frames):
        frame = _LongFrame(golden.begin(config), config.pulses, kept_max, stored)
        while upcoming is not None and upcoming[0] == number:
            frame.take(upcoming[1])
            upcoming = next(pieces, None)
        seen.append(frame.end())
    return PlayedFrames(stored, stored.counters, seen)


def play_last_frame(
    players: Sequence[tuple[Golden, Config]],
    frames: int,
    chunks: Iterator[Edges],
    workers: int = 1,
    progress: Progress = lambda share, edges: None,
) -> list[PlayedFrames]:
    """Play the last one of so many frames through several golden models, each with its
    configuration.

    workers: number of threads; chunks, progress: as in `play_long_frames`.
    """
    pulses = players[0][1].pulses
    kept_max = EDGES_SHOWN_MAX // len(players)
    opened = [
        _LongFrame(golden.begin(config), pulses, kept_max, StoredFrames())
        for golden, config in players
    ]
    with Threads(workers) as threads:
        for number, edges in _told_pieces(chunks, pulses, frames, progress):
            if number == frames - 1:
                threads.map(partial(_LongFrame.take, edges=edges), opened)
    seen = [frame.end() for frame in opened]
    return [
        PlayedFrames(frame.stored, frame.stored.counters, [of_frame])
        for frame, of_frame in zip(opened, seen, strict=True)
    ]


class _LongFrame:
    """A frame of the golden model that keeps the edges of its first pulses, and their fates.

    pulses: of the frame. kept_max: edges; a pulse is kept whole or not at all. stored: where its
    trace goes.
    """

    def __init__(self, opened: OpenFrame, pulses: int, kept_max: int, stored: StoredFrames) -> None:
        self.stored = stored
        self._opened = opened
        self._all_pulses = pulses
        self._kept_max = kept_max
        self._kept: list[Edges] = []
        self._fates: list[np.ndarray] = [np.empty(0, np.uint8)]
        self._total = 0
        self._pulses = pulses  # whose edges are kept

    def take(self, edges: Edges) -> None:
        fate = self._opened.take(edges)
        self.stored.take(self._opened)
        room = self._kept_max - self._total
        self._total += len(edges)
        if room < 0 or self._pulses < self._all_pulses:
            return
        kept = len(edges)
        if kept > room:
            self._pulses = int(edges.pulse[room])
            kept = int(np.searchsorted(edges.pulse, self._pulses))
        self._kept.append(edges.take(slice(kept)))
        self._fates.append(fate[:kept])

    def end(self) -> SeenEdges:
        """End the frame, and return what is kept of its edges."""
        self.stored.end(self._opened, np.concatenate(self._fates))
        return SeenEdges(Edges.joined(self._kept), self._pulses, self._total)
