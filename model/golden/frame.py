# SPDX-License-Identifier: Apache-2.0
"""Golden model: predicts every beat, commit cycle, drop, counter and edge fate of the sensor,
exact to the cycle.

It works event by event, and takes a frame in pieces of whole periods, so that its memory does not
depend on the length of the frame. Each piece goes through two steps. `front_end` goes through each
subgroup's edges in the order of time and produces the windows that met their threshold, the
minigroup records, and the fates. `readout` plays one stream's FIFOs, round robin and output buffer
on them and produces the beats. In a frame of counts there are no windows, and `counts` counts the
accepted edges. Latencies are those of `latency.py`; everything else is section III-A of the paper as
docs/contract.md defines it.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from attrs import frozen

from ..contract.coincidence import AT_LEAST
from ..contract.config import Config
from ..contract.counters import COUNTER_NAMES
from ..contract.edges import Edges
from ..contract.gate_counts import fields_of_counts
from ..contract.latency import close_cycle
from ..contract.packet import COUNTS, packet_beats
from ..contract.parameters import SENSOR, Sensor
from ..contract.pixels import pixel_table
from ..contract.result import ResultBuilder
from ..shared.arrays import joined
from ..shared.errors import check_integer, wrong_value
from ..shared.threads import Threads
from .controller import Controller
from .counts import GateCounts, Hits
from .front_end import Events, Records, Rules, Settings, Timeline, front_end, time_order
from .judgement import judged, thresholds_of_candidates
from .readout import Readout, Sent, Stream
from .receiver import Receiver, receiver_of
from .shape import COUNTER, Shape, shape_of

PIECE_EDGES = 1 << 18  # that a piece of a frame has at least, if there are so many


@frozen(eq=False)
class Trace:
    """One frame as the ports show it.

    beats: per stream, uint64[n]; beat_cycle: per stream, int64[n], the cycle in which each beat
    is transferred (the last one has `tlast`). commit_subgroup, commit_cycle: int64[k], stored
    events, ordered by subgroup and then by time;
    freed_cycle: int64[k], the cycle from which on their places in the FIFOs are free again.
    fate: uint8 per edge. counters: int64[subgroups, 11]. budget: int64[streams], of the
    threshold controller after the frame.
    """

    beats: list[np.ndarray]
    beat_cycle: list[np.ndarray]
    commit_subgroup: np.ndarray
    commit_cycle: np.ndarray
    freed_cycle: np.ndarray
    fate: np.ndarray
    counters: np.ndarray
    budget: np.ndarray


class Ending(NamedTuple):
    """What is known when a frame ends."""

    counters: np.ndarray  # int64[subgroups, 11]
    budget: np.ndarray  # int64[streams], of the threshold controller after the frame


class Golden:
    """Sensor from reset on. It plays frames in turn and keeps the state of the threshold
    controller between them.
    """

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        self.reset()

    def reset(self) -> None:
        """Reset the sensor, by its pin or by its register: the next frame is like the first one."""
        self.frames = 0
        self.controller = Controller(self.sensor)

    def frame(
        self,
        config: Config,
        edges: Edges,
        ready: np.ndarray | None = None,
        pulses: int | None = None,
        into_gap: int = 0,
    ) -> Trace:
        """Run one frame; the pulses of `edges` count from the frame's start.

        ready: uint8[n] or None; the receiver behind the streams' links (`contract/link.py`)
        takes a beat in cycle c if ready[c] is 1, and always from cycle n on. pulses: fewer than
        the configuration has means an aborted frame. into_gap: cycles of the gap after these
        pulses (or of the pause between two steps of counts), up to the one of the abort; 0: the
        frame is not aborted in a gap.
        """
        opened = self.begin(config, ready, pulses, into_gap)
        return opened.end(opened.take_all(edges))

    def begin(
        self,
        config: Config,
        ready: np.ndarray | None = None,
        pulses: int | None = None,
        into_gap: int = 0,
    ) -> "OpenFrame":
        """Begin a frame, which takes its edges in pieces. It must end before the next one begins.

        ready, pulses, into_gap: as in `frame`. Raises `InputError` for a configuration of another
        sensor, or pulses that it does not have.
        """
        for name in SENSOR if config.sensor is not self.sensor else ():
            given, own = (getattr(sensor, name) for sensor in (config.sensor, self.sensor))
            if given != own:
                raise wrong_value(f"sensor.{name}", given, f"{own}, as in the model")
        if pulses is not None:
            pulses = check_integer("pulses", pulses, 1, config.pulses)
        plan = _plan(config, self.controller.begin(config), ready, pulses, into_gap)
        opened = OpenFrame(self, config, plan, self.frames)
        self.frames += 1
        return opened

    def follow(self, config: Config, counters: np.ndarray) -> None:
        """Go on as if this model had played a frame, whose counters these are."""
        self.controller.begin(config)
        self.controller.end(config, counters)
        self.frames += 1

    def frames_of(
        self, config: Config, edges: Sequence[Edges], workers: int | None = None
    ) -> list[Trace]:
        """Run one frame after the other, those that do not depend on each other side by side.

        A frame depends on the one before if the controller sets a threshold. workers: threads;
        None: one per core. Their number does not change the result.
        """
        if config.controlled.any():
            return [self.frame(config, of_frame) for of_frame in edges]
        opened = [self.begin(config) for _ in edges]
        with Threads(workers) as threads:
            fates = threads.map(
                lambda frame: frame[0].take_all(frame[1]), list(zip(opened, edges, strict=True))
            )
        return [frame.end(fate) for frame, fate in zip(opened, fates, strict=True)]


class OpenFrame:
    """A frame that takes its edges in pieces, in the order of pulses. `Golden.begin` makes it."""

    def __init__(self, golden: Golden, config: Config, plan: "_Plan", number: int) -> None:
        sensor = golden.sensor
        self._golden = golden
        self._config = config
        self._plan = plan
        self._pixel = pixel_table(sensor)
        self._counters = np.zeros((sensor.subgroups, len(COUNTER_NAMES)), np.int64)
        self._counts = GateCounts(config, plan.pulses) if config.counting else None
        self._taken = 0  # pulses; those of the next piece are not below
        self._readouts = [
            Readout(Stream(span.start, len(span), number & 0xFFFF), plan.shape, plan.receiver)
            for span in map(sensor.stream_subgroups, range(sensor.streams))
        ]

    def take_all(self, edges: Edges) -> np.ndarray:
        """Take all edges of the frame, in any order; return their fates, uint8[n]."""
        fate = np.empty(len(edges), np.uint8)
        order = None
        if np.any(edges.pulse[1:] < edges.pulse[:-1]):
            order = np.argsort(edges.pulse, kind="stable")
            edges = edges.take(order)
        for piece in _pieces(edges.pulse):
            fate[piece] = self.take(edges.take(piece))
        if order is None:
            return fate
        in_order = fate
        fate = np.empty_like(fate)
        fate[order] = in_order
        return fate

    def take(self, edges: Edges) -> np.ndarray:
        """Take a piece of the frame: all edges of some pulses, in any order, and none of a pulse
        before those of the last piece. Return their fates, uint8[n]. Raises `InputError`.
        """
        if not len(edges):
            return np.empty(0, np.uint8)
        earliest = int(edges.pulse.min())
        if earliest < self._taken:
            legal = f"from {self._taken} on, behind the last piece"
            raise wrong_value("pulse", earliest, legal, low=self._taken)
        self._taken = int(edges.pulse.max()) + 1
        sensor = self._config.sensor
        plan = self._plan
        key, order, bounds = time_order(edges, self._pixel, plan.shape)
        counters = np.zeros_like(self._counters)
        fate = np.empty(len(edges), np.uint8)
        settings = plan.settings
        if sensor.rule != AT_LEAST:
            settings = settings._replace(
                threshold=thresholds_of_candidates(sensor.rule, settings.threshold)
            )
        rules = Rules(plan.shape, settings, plan.timeline, self._pixel)
        in_time, events, records = front_end(key, bounds, rules, counters)
        fate[order] = in_time
        if self._counts is not None:
            self._counts.take(Hits(key, bounds, in_time), self._taken)
        if sensor.rule != AT_LEAST:
            events = judged(events, sensor, plan.settings.threshold, counters)
        self._counters += counters
        known_until = int(plan.timeline.start[self._taken])
        for stream, of_stream in enumerate(self._readouts):
            span = sensor.stream_subgroups(stream)
            of_stream.take(
                Events(*_of_stream(events, span)), Records(*_of_stream(records, span)), known_until
            )
        return fate

    def sent(self) -> list[Sent]:
        """Take out what has left each stream since the last call, and does not change any more.

        Without a call, a frame keeps it for `end`.
        """
        return [readout.sent() for readout in self._readouts]

    def close(self) -> Ending:
        """End the frame; the controller sets the next budget. `sent` has the rest of the frame."""
        sensor = self._config.sensor
        counters = self._counters
        counters[:, COUNTER.threshold_used] = self._plan.threshold
        np.minimum(counters, sensor.counter_max, out=counters)
        if not sensor.controller:
            counters[:, COUNTER.lower] = 0
        for readout, counts in zip(self._readouts, self._counts_of_streams(), strict=True):
            readout.end(self._plan.end, counters, counts)
        return Ending(counters, self._golden.controller.end(self._config, counters))

    def _counts_of_streams(self) -> list[np.ndarray]:
        """Return the beats of each stream's packets with counts."""
        sensor = self._config.sensor
        if self._counts is None:
            return [np.empty(0, np.uint64)] * sensor.streams
        beats = packet_beats(fields_of_counts(self._counts.end(), sensor, 0), sensor, COUNTS)
        of_subgroups = beats.reshape(sensor.subgroups, -1)
        return [of_subgroups[sensor.stream_subgroups(k)].ravel() for k in range(sensor.streams)]

    def end(self, fate: np.ndarray) -> Trace:
        """End a frame from which nothing was taken out. fate: of the trace."""
        ending = self.close()
        return trace_of([[sent] for sent in self.sent()], ending, fate)


def trace_of(pieces: Sequence[Sequence[Sent]], ending: Ending, fate: np.ndarray) -> Trace:
    """Return the trace of a frame from the pieces of each stream, in their order.

    fate: uint8 per edge.
    """
    subgroup, cycle, freed_cycle = (
        joined([getattr(sent, name) for of_stream in pieces for sent in of_stream])
        for name in ("subgroup", "committed_at", "freed_at")
    )
    order = np.argsort(subgroup, kind="stable")
    return Trace(
        beats=[joined([sent.beats for sent in of_stream]) for of_stream in pieces],
        beat_cycle=[joined([sent.sent_at for sent in of_stream]) for of_stream in pieces],
        commit_subgroup=subgroup[order],
        commit_cycle=cycle[order],
        freed_cycle=freed_cycle[order],
        fate=fate,
        counters=ending.counters,
        budget=ending.budget,
    )


def _pieces(pulse: np.ndarray) -> Iterator[slice]:
    """Yield slices of about `PIECE_EDGES` edges, each with all edges of its pulses.

    pulse: int64[n], ascending.
    """
    begin = 0
    while begin < len(pulse):
        last = pulse[min(begin + PIECE_EDGES, len(pulse)) - 1]
        end = int(np.searchsorted(pulse, last, side="right"))
        yield slice(begin, end)
        begin = end


def _of_stream(rows: Events | Records, span: range) -> list[np.ndarray]:
    """Return bounds and columns of the subgroups of a stream."""
    bounds = rows.bounds[span.start : span.stop + 1]
    own = slice(bounds[0], bounds[-1])
    return [bounds - bounds[0], *(column[own] for column in rows[1:])]


class _Plan(NamedTuple):
    """What the frames of a configuration share, as the kernels need it.

    threshold: as programmed or controlled, with coincidence or without. pulses: that begin. end: of
    the last period or of the gap in which the frame is aborted, in cycles.
    """

    shape: Shape
    threshold: np.ndarray
    settings: Settings
    timeline: Timeline
    pulses: int
    end: int
    receiver: Receiver


def _plan(
    config: Config,
    threshold: np.ndarray,
    ready: np.ndarray | None = None,
    pulses: int | None = None,
    into_gap: int = 0,
) -> _Plan:
    frame = config.frame
    start = config.start_cycles()
    phases = config.sensor.phases
    steps = np.zeros(len(start), np.int64)
    if frame.gate_every:
        steps = np.arange(len(start)) // frame.gate_every % frame.gate_steps
    window = np.where(config.coincidence, config.window, 1)
    settings = Settings(
        threshold=np.where(config.coincidence, threshold, 1),
        window=window,
        close=close_cycle(np.arange(phases), window[:, None], phases),
        mask=config.mask,
        gating=config.gating,
        gate_start=config.gate_start,
        gate_len=config.gate_len,
    )
    played = config.pulses if pulses is None else pulses
    return _Plan(
        shape=shape_of(config),
        threshold=threshold,
        settings=settings,
        timeline=Timeline(start=start, gate_shift=frame.gate_step * steps),
        pulses=played,
        end=int(start[played - 1]) + config.period + into_gap,
        receiver=receiver_of(config, ready),
    )


def golden_result(
    config: Config,
    edges: Edges,
    ready: np.ndarray | None = None,
    progress: Callable[[int], None] = lambda frames: None,
) -> dict[str, np.ndarray]:
    """Play all frames of `config` through the golden model and return the arrays of the result
    file, with `fate`.

    `progress` is called after each frame.
    """
    model, result = Golden(config.sensor), ResultBuilder(config)
    fate = np.empty(len(edges), np.uint8)
    for number in range(config.frames):
        of_frame, index = edges.frame(number, config.pulses)
        trace: Trace = model.frame(config, of_frame, ready)
        fate[index] = trace.fate
        result.add(trace.beats, trace.commit_subgroup, trace.commit_cycle)
        progress(number + 1)
    return result.arrays() | {"fate": fate}
