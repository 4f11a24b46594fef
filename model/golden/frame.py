# SPDX-License-Identifier: Apache-2.0
"""Golden model: predicts every beat, commit cycle, drop, counter and edge fate of the sensor,
exact to the cycle.

It works event by event, in two steps per frame. `front_end` goes through each subgroup's edges
in the order of time and produces the windows that met their threshold, the minigroup records,
and the fates. `readout` plays one stream's FIFOs, round robin and output buffer on them and
produces the beats. Latencies are those of `latency.py`; everything else is section III-A of the
paper as docs/contract.md defines it.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from attrs import frozen

from ..contract.coincidence import AT_LEAST
from ..contract.config import Config
from ..contract.counters import COUNTER_NAMES
from ..contract.edges import Edges
from ..contract.latency import close_cycle
from ..contract.parameters import Sensor
from ..contract.pixels import pixel_table
from ..contract.result import ResultBuilder
from ..shared.threads import Threads
from .controller import Controller
from .front_end import Rules, Settings, Timeline, front_end, time_order
from .judgement import judged, thresholds_of_candidates
from .readout import Stream, readout
from .receiver import Receiver, receiver_of
from .shape import COUNTER, Shape, shape_of


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


class Golden:
    """Sensor from reset on. It plays frames in turn and keeps the state of the threshold
    controller between them.
    """

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        self._pixel = pixel_table(sensor)
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
    ) -> Trace:
        """Run one frame; the pulses of `edges` count from the frame's start.

        ready: uint8[n] or None; the receiver behind the streams' links (`contract/link.py`)
        takes a beat in cycle c if ready[c] is 1, and always from cycle n on. pulses: fewer than
        the configuration has means an aborted frame.
        """
        threshold = self.controller.begin(config)
        played = self._play(self.frames, _plan(config, threshold, ready, pulses), edges)
        self.frames += 1
        return self._traced(config, played)

    def frames_of(
        self, config: Config, edges: Sequence[Edges], workers: int | None = None
    ) -> list[Trace]:
        """Run one frame after the other, those that do not depend on each other side by side.

        A frame depends on the one before if the controller sets a threshold. workers: threads;
        None: one per core. Their number does not change the result.
        """
        if config.controlled.any():
            return [self.frame(config, of_frame) for of_frame in edges]
        threshold = self.controller.begin(config)
        plan, numbers = _plan(config, threshold), range(self.frames, self.frames + len(edges))
        with Threads(workers) as threads:
            played = threads.map(
                lambda frame: self._play(frame[0], plan, frame[1]), zip(numbers, edges, strict=True)
            )
        self.frames += len(edges)
        return [self._traced(config, one) for one in played]

    def _traced(self, config: Config, played: dict[str, Any]) -> Trace:
        """Return the trace of a played frame, after which the controller sets the next budget."""
        return Trace(**played, budget=self.controller.end(config, played["counters"]))

    def _play(self, number: int, plan: "_Plan", edges: Edges) -> dict[str, Any]:
        """Run a frame, and return the trace's attributes except the budget."""
        sensor, shape = self.sensor, plan.shape
        key, order, bounds = time_order(edges, self._pixel, shape)
        counters = np.zeros((sensor.subgroups, len(COUNTER_NAMES)), np.int64)
        counters[:, COUNTER.threshold_used] = plan.threshold
        fate = np.empty(len(edges), np.uint8)
        settings = plan.settings
        if sensor.rule != AT_LEAST:
            settings = settings._replace(
                threshold=thresholds_of_candidates(sensor.rule, settings.threshold)
            )
        rules = Rules(shape, settings, plan.timeline, self._pixel)
        fate[order], events, records = front_end(key, bounds, rules, counters)
        if sensor.rule != AT_LEAST:
            events = judged(events, sensor, plan.settings.threshold, counters)
        np.minimum(counters, sensor.counter_max, out=counters)
        if not sensor.controller:
            counters[:, COUNTER.lower] = 0
        beats, cycles = [], []
        for stream in range(sensor.streams):
            span = sensor.stream_subgroups(stream)
            stream_beats, stream_cycles = readout(
                Stream(span.start, len(span), plan.end, number & 0xFFFF),
                shape,
                events,
                records,
                counters,
                plan.receiver,
            )
            beats.append(stream_beats)
            cycles.append(stream_cycles)
        commit_subgroup = np.repeat(np.arange(sensor.subgroups), np.diff(events.bounds))
        row = events.row[: len(commit_subgroup)]
        stored = row["stored"] != 0
        commits = {
            "commit_subgroup": commit_subgroup,
            "commit_cycle": row["cycle"],
            "freed_cycle": row["free_at"],
        }
        chosen = {name: column[stored] for name, column in commits.items()}
        return {"beats": beats, "beat_cycle": cycles, "fate": fate, "counters": counters} | chosen


class _Plan(NamedTuple):
    """What the frames of a configuration share, as the kernels need it.

    threshold: as programmed or controlled, with coincidence or without. end: of the last period,
    in cycles.
    """

    shape: Shape
    threshold: np.ndarray
    settings: Settings
    timeline: Timeline
    end: int
    receiver: Receiver


def _plan(
    config: Config,
    threshold: np.ndarray,
    ready: np.ndarray | None = None,
    pulses: int | None = None,
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
        end=int(start[played - 1]) + config.period,
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
