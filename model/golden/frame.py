"""Golden model: every beat, commit cycle, drop, counter and edge's fate of the sensor, cycle-accurate, event by event.

A frame is two steps. `front_end` walks through each subgroup's edges in time order and yields the windows that met their threshold, the
minigroup records, and the fates. `readout` plays one stream's FIFOs, round robin and output buffer on them and yields the beats.
Latencies are those of `latency.py`; everything else is the contract of section III-A of the paper as the design documentation fixes it.
"""

from collections.abc import Callable

import numpy as np
from attrs import frozen

from ..contract.config import Config
from ..contract.edges import Edges
from ..contract.parameters import Sensor
from ..contract.pixels import pixel_table
from ..contract.registers import COUNTER_NAMES
from ..contract.result import ResultBuilder
from .front_end import Settings, Timeline, front_end, time_order
from .readout import readout, ready_times
from .shape import COUNTER, shape_of


@frozen(eq=False)
class Trace:
    """One frame as the ports show it.

    beats: per stream uint64[n]; beat_cycle: per stream int64[n], the cycle each beat is transferred in (the last one has `tlast`).
    commit_subgroup, commit_cycle: int64[k], stored events by subgroup, then time. fate: uint8 per edge. counters: int64[subgroups, 10].
    """

    beats: list[np.ndarray]
    beat_cycle: list[np.ndarray]
    commit_subgroup: np.ndarray
    commit_cycle: np.ndarray
    fate: np.ndarray
    counters: np.ndarray


class Golden:
    """The sensor from reset on: frames in turn, the threshold controller's memory between them."""

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        self.frames = 0
        self._photons: np.ndarray | None = None
        self._pixel = pixel_table(sensor)

    def frame(self, config: Config, edges: Edges, ready: np.ndarray | None = None, pulses: int | None = None) -> Trace:
        """Runs one frame; `edges` counts pulses from the frame's start.

        ready: uint8[n] or None; `tready` of all streams in cycle c is ready[c], and 1 from cycle n on. pulses below the configuration's: an
        aborted frame.
        """
        sensor, shape = self.sensor, shape_of(config)
        timeline = _timeline(config)
        key, order, bounds = time_order(edges, self._pixel, shape)
        threshold = self._thresholds(config)
        counters = np.zeros((sensor.subgroups, len(COUNTER_NAMES)), np.int64)
        counters[:, COUNTER.threshold_used] = threshold
        settings = Settings(
            np.where(config.coincidence, threshold, 1),
            np.where(config.coincidence, config.window, 1),
            config.mask,
            config.gating,
            config.gate_start,
            config.gate_len,
        )
        fate = np.empty(len(edges), np.uint8)
        fate[order], events, records = front_end(key, bounds, shape, settings, timeline, self._pixel, counters)
        end = timeline.start[(config.pulses if pulses is None else pulses) - 1] + config.period
        next_ready = ready_times(np.asarray(ready if ready is not None else [], np.uint8))
        beats, cycles = [], []
        for stream in range(sensor.streams):
            span = sensor.stream_subgroups(stream)
            of_stream = readout(
                span.start, len(span), shape, end, self.frames & 0xFFFF, events, records, counters, next_ready
            )
            beats.append(of_stream[0])
            cycles.append(of_stream[1])
        self.frames += 1
        self._photons = counters[:, COUNTER.photons].copy()
        commit_subgroup = np.repeat(np.arange(sensor.subgroups), np.diff(events.bounds))
        row = events.row[: len(commit_subgroup)]
        stored = row["stored"] != 0
        return Trace(beats, cycles, commit_subgroup[stored], row["cycle"][stored], fate, counters)

    def _thresholds(self, config: Config) -> np.ndarray:
        """int64[subgroups]: the programmed thresholds, or what the controller makes of the frame before."""
        if self._photons is None:
            return config.threshold
        controlled = 1 + np.searchsorted(config.auto_bounds, self._photons, side="right")
        return np.where(config.auto, controlled, config.threshold)


def _timeline(config: Config) -> Timeline:
    """When a frame's periods begin, and how far progressive gating has shifted the gates by then."""
    start, frame = config.start_cycles(), config.frame
    every = frame["gate_every"]
    steps = np.arange(len(start)) // every % frame["gate_steps"] if every else np.zeros(len(start), np.int64)
    return Timeline(start, frame["gate_step"] * steps)


def golden_result(
    config: Config, edges: Edges, ready: np.ndarray | None = None, progress: Callable[[int], None] = lambda frames: None
) -> dict[str, np.ndarray]:
    """All frames of `config` through the golden model: the result file's arrays with `fate`. `progress` is called after each frame."""
    model, result = Golden(config.sensor), ResultBuilder(config)
    fate = np.empty(len(edges), np.uint8)
    for number in range(config.frames):
        of_frame, index = edges.frame(number, config.pulses)
        trace: Trace = model.frame(config, of_frame, ready)
        fate[index] = trace.fate
        result.add(trace.beats, trace.commit_subgroup, trace.commit_cycle)
        progress(number + 1)
    return result.arrays() | {"fate": fate}
