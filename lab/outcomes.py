# SPDX-License-Identifier: Apache-2.0
"""Outcomes of a setup: a run computes each stage on its first use, and its frames give the
measures.
"""

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from functools import cached_property, partial
from threading import Lock
from typing import Any, Self

import numpy as np
from attrs import evolve

from ..model.contract.config import Config
from ..model.contract.counters import COUNTER_NAMES
from ..model.contract.edges import Edges
from ..model.contract.gate_counts import Counts
from ..model.contract.packet import FORMATS
from ..model.contract.result import (
    ResultBuilder,
    at_end,
    counter_arrays,
    frame_rows,
    known_counters,
)
from ..model.depth.depth import Depth
from ..model.depth.estimate import estimate_depth
from ..model.depth.methods import DEFAULT_METHOD, DEFAULT_SOURCE, Estimator, Method
from ..model.depth.quality import wrong_pixels
from ..model.golden.frame import Golden, Trace
from ..model.light.light import Light
from ..model.scenes.scene import Scene
from ..model.shared.errors import InputError, check_integer, told_value, wrong_value
from ..model.shared.latest import Latest
from ..model.shared.pulse import Pulse, with_pulse
from ..model.shared.quantities import check_choice
from ..tb.replay import checked_for, replay
from .compile_ahead import compile_ahead
from .long_frames import PlayedFrames, SeenEdges, is_long, play_long_frames
from .measures import MEASURES, Number, stream_beats
from .setup import Setup, Watch, fingerprint, unwatched


class StageCache:
    """The latest results of each stage, so that runs can share them. The key is a digest of
    everything that a result depends on.

    decoded: the latest frame of a long run, alone.
    """

    def __init__(self, size: int = 1) -> None:
        self.size = size
        self.decoded: Latest[dict[str, np.ndarray]] = Latest()
        self._stages: dict[str, OrderedDict[Hashable, Any]] = {}
        self._lock = Lock()

    def get(self, stage: str, key: Hashable, make: Callable[[], Any]) -> Any:
        """Return the result under `key`, and make it first if it is missing."""
        with self._lock:
            results = self._stages.setdefault(stage, OrderedDict())
            if key in results:
                results.move_to_end(key)
                return results[key]
        made = make()  # without the lock, so that other runs do not wait
        with self._lock:
            results[key] = made
            while len(results) > self.size:
                results.popitem(last=False)
        return made


class Run:
    """The outcome of a setup: light, edges, traces, result, depth.

    Each stage is computed when it is first used, unless its outcome exists already and is given.

    Parameters
    ----------
    setup : Setup
        What is played.
    cache : StageCache or None
        Shares photons and golden frames with other runs.
    workers : int
        Number of threads for photons, golden frames and depth. It does not change the results.
    watch : callable
        Is told the progress, and may raise an exception to end the run.
    light, edges, played, result
        Outcomes of stages that exist already, such as the `result` of a file or of a board; None:
        not yet. `played` are the golden model's frames.
    """

    def __init__(
        self,
        setup: Setup,
        *,
        cache: StageCache | None = None,
        workers: int = 1,
        watch: Watch = unwatched,
        light: Light | None = None,
        edges: Edges | None = None,
        played: PlayedFrames | None = None,
        result: dict[str, np.ndarray] | None = None,
    ) -> None:
        self.setup = setup
        self.cache = cache or StageCache()
        self.workers = workers
        self.watch = watch
        self._light = light
        self._edges = edges
        self._played_frames = played
        self._result = result
        self._frames: dict[tuple[int, str | None], Frame] = {}
        self._key = object()  # of what the cache has of this run only

    def __repr__(self) -> str:
        """Return one line: scene, size, frames and engine; nothing is computed."""
        setup, config = self.setup, self.config
        seen = "edges" if setup.scene is None else setup.scene.name
        size = f"{config.sensor.rows} x {config.sensor.cols} pixels"
        frames = f"{config.frames} frame{'s' * (config.frames > 1)} of {config.pulses} pulses"
        return f"<Run of {seen}: {size}, {frames}, engine {setup.engine}>"

    def but(self, **changes: Any) -> Self:
        """Return the run of a changed setup (`Setup.but`). It keeps the photons if the change does
        not affect them.
        """
        return type(self)(
            self.setup.but(**changes), cache=self.cache, workers=self.workers, watch=self.watch
        )

    def alone(self, number: int, **changes: Any) -> Self:
        """Return a run that begins at reset with the photons of one frame, with a changed setup."""
        own: dict[str, Any] = {"edges": self.frame_edges(number)}
        if self.setup.scene is not None:
            own["scene"] = self.setup.scene.at(number % self.config.frames)
        setup = self.setup.but(frame={"frames": 1}, **own).but(**changes)
        return type(self)(setup, workers=self.workers, watch=self.watch)

    @property
    def config(self) -> Config:
        """The checked configuration."""
        return self.setup.config

    @property
    def scene(self) -> Scene:
        """What the pixels see; `Frame.scene` is that of one frame, if it moves."""
        return self.setup.seen

    @property
    def light(self) -> Light:
        """Detected signal and background of every pixel, in the first frame."""
        return self.light_of(0)

    @property
    def pulse(self) -> Pulse | None:
        """Measured shape of the pulse that the estimators are told; None: a Gaussian."""
        light = self.setup.light
        return self.setup.pulse if light is None else light.pulse

    def light_of(self, frame: int) -> Light:
        """Return the detected signal and background of every pixel in a frame (from the end, if
        negative). Raises `InputError`.
        """
        frame = self._in_range(frame)
        if self._light is not None:
            return self._light
        lights = self.setup.photons.lights
        return lights[min(frame, len(lights) - 1)]

    @property
    def edges(self) -> Edges:
        """All avalanches, of all frames."""
        if self._edges is None:
            self._edges = self._generated_edges()
        return self._edges

    def _generated_edges(self) -> Edges:
        if self.setup.edges is not None:
            return checked_for(self.config, self.setup.edges)
        if self.workers > 1 and DEFAULT_METHOD in self.setup.estimators:
            compile_ahead()  # uses a core that this run does not need yet
        photons = self.setup.photons
        edges: Edges = self.cache.get(
            "photons", photons.key, lambda: photons.edges(self.workers, self.watch)
        )
        return edges

    @cached_property
    def _of_frame(self) -> list[Any]:
        """Index of each frame's edges; slices if the edges are in order, as generated ones always
        are.
        """
        pulse, pulses, frames = self.edges.pulse, self.config.pulses, self.config.frames
        if np.all(pulse[1:] >= pulse[:-1]):
            bounds = np.searchsorted(pulse, np.arange(frames + 1) * pulses)
            return list(map(slice, bounds[:-1], bounds[1:]))
        return [np.flatnonzero(pulse // pulses == number) for number in range(frames)]

    @cached_property
    def is_long(self) -> bool:
        """Whether the run keeps the edges of the first pulses only, for lack of memory, unless
        somebody asks for `edges`.
        """
        if self._played_frames is not None:
            return bool(self._played_frames.seen)
        if self._edges is not None or self.setup.edges is not None:
            return False
        return is_long(self.setup.photons)

    def seen_edges(self, number: int) -> SeenEdges:
        """Return what the run keeps of the edges of a frame (from the end, if negative): all of
        them, unless it is long. Raises `InputError`.
        """
        number = self._in_range(number)
        if self.is_long:
            return self._frames_of_golden().seen[number]
        edges = self.frame_edges(number)
        return SeenEdges(edges, self.config.pulses, len(edges))

    @property
    def edge_count(self) -> int:
        """Number of all avalanches, of all frames."""
        if self.is_long:
            return sum(seen.total for seen in self._frames_of_golden().seen)
        return len(self.edges)

    def frame_edges(self, number: int) -> Edges:
        """Return the edges of one frame (from the end, if negative), with pulses counted from its
        start. Raises `InputError`.
        """
        number = self._in_range(number)
        own = self.edges.take(self._of_frame[number])
        return evolve(own, pulse=own.pulse - number * self.config.pulses) if number else own

    @property
    def traces(self) -> Sequence[Trace]:
        """The frames of the golden model, also if another engine plays the setup."""
        return self._frames_of_golden().traces

    def counters(self, number: int) -> np.ndarray:
        """int64[subgroups, 11]: the counters of a frame of the golden model (from the end, if
        negative). Raises `InputError`.
        """
        return self._frames_of_golden().counters[self._in_range(number)]

    def _in_range(self, frame: int) -> int:
        """Return the number of a frame, which is counted from the end if it is negative. Raises
        `InputError`.
        """
        frames = self.config.frames
        return check_integer("frame", frame, -frames, frames - 1) % frames

    def _frames_of_golden(self) -> PlayedFrames:
        if self._played_frames is None:
            if self.setup.edges is not None:
                self._played_frames = self._golden_frames()
            else:
                key = self.setup.photons.key, fingerprint(self.config)
                self._played_frames = self.cache.get("frames", key, self._golden_frames)
        return self._played_frames

    def _golden_frames(self) -> PlayedFrames:
        if self.is_long:
            stage = "photons and golden model"
            return play_long_frames(
                Golden(self.config.sensor),
                self.config,
                self.setup.photons.chunks(self.workers),
                lambda share, edges: self.watch(stage, share, edges),
            )
        model, frames = Golden(self.config.sensor), self.config.frames
        traces: list[Trace] = []
        for number in range(0, frames, self.workers):
            self.watch("golden model", number / frames, len(self.edges))
            together = [
                self.frame_edges(k) for k in range(number, min(frames, number + self.workers))
            ]
            traces += model.frames_of(self.config, together, self.workers)
        return PlayedFrames.whole(traces)

    @property
    def result(self) -> dict[str, np.ndarray]:
        """The arrays of the result file (docs/files.md) for all frames, from the setup's engine."""
        if self._result is None:
            self._result = with_pulse(self._played(), self.pulse)
        return self._result

    def result_of(self, number: int) -> dict[str, np.ndarray]:
        """Return the result with the events of one frame at least, and the counters of all frames.

        Of a long run, only one such result is in memory, also if several runs share a cache. A
        negative number counts from the end. Raises `InputError`.
        """
        number = self._in_range(number)
        if self.setup.engine != "golden" or not self.is_long or self.has_result:
            return self.result
        return self.cache.decoded.get((self._key, number), partial(self._decoded, number))

    def _decoded(self, number: int) -> dict[str, np.ndarray]:
        trace = self.traces[number]
        rows = frame_rows(
            self.config,
            trace.beats,
            trace.commit_subgroup,
            trace.commit_cycle,
            number * self.config.pulses,
        )
        counters = counter_arrays(self._frames_of_golden().counters)
        columns = rows.columns
        if self.config.counting:
            columns = columns | _at_frame(columns, number, self.config.frames)
        return with_pulse(columns | counters, self.pulse)

    @property
    def has_result(self) -> bool:
        """Whether the result exists already, so that reading it computes nothing."""
        return self._result is not None

    def _played(self) -> dict[str, np.ndarray]:
        if self.setup.engine != "golden":
            return replay(self.setup.engine, self.config, self.edges, view=self.setup.view)
        built = ResultBuilder(self.config)
        for trace in self.traces:
            built.add(trace.beats, trace.commit_subgroup, trace.commit_cycle)
        if self.is_long:
            return built.arrays()
        fate = np.empty(len(self.edges), np.uint8)
        for own, trace in zip(self._of_frame, self.traces, strict=True):
            fate[own] = trace.fate
        return built.arrays() | {"fate": fate}

    def depth(self, estimator: Method | None = None, **options: Any) -> Depth:
        """Estimate the distance of every pixel by METHOD, METHOD/SOURCE or an estimator of your own.

        options: those of `estimate_depth`. The estimator is told the measured pulse of the setup,
        unless `pulse` is given.
        """
        method = _check_estimator(estimator)
        named = _check_estimator(options.pop("method", None))
        if method is not None and named is not None:
            raise InputError("method: is the estimator, which is given already", field="method")
        method = method or named
        if method is None and not self.setup.estimators:
            raise InputError("estimators: is empty, so there is no depth", field="estimators")
        method = method or self.setup.estimators[0]
        source = DEFAULT_SOURCE
        if isinstance(method, str):
            method, _, named = method.partition("/")
            source = named or source
        given: dict[str, Any] = {
            "method": method,
            "source": source,
            "workers": self.workers,
            "pulse": self.pulse,
        } | options
        number = given.get("frame")
        if isinstance(number, int) and 0 <= number < self.config.frames:
            result = self.result_of(number)
        else:
            result = self.result
        return estimate_depth(result, self.config, **given)

    def frame(self, number: int = -1, estimator: Method | None = None) -> "Frame":
        """Return one frame (from the end, if negative) with an estimator; None: the first one of
        the setup. Raises `InputError`.
        """
        number = self._in_range(number)
        _check_estimator(estimator)
        chosen = estimator or next(iter(self.setup.estimators), None)
        name = chosen if chosen is None or isinstance(chosen, str) else fingerprint(chosen)
        return self._frames.setdefault((number, name), Frame(self, number, chosen))

    def __getitem__(self, measure: str) -> Number:
        """Return a measure of the last frame."""
        return self.frame()[measure]


def _check_estimator(estimator: Method | None) -> Method | None:
    """Return an estimator, or None. Raises `InputError`."""
    if estimator is not None and not isinstance(estimator, str | Estimator):
        legal = f"METHOD or METHOD/SOURCE; a frame is given as frame={told_value(estimator)}"
        raise wrong_value("estimator", estimator, legal)
    return estimator


def _at_frame(columns: dict[str, np.ndarray], number: int, frames: int) -> dict[str, np.ndarray]:
    """Return the counts of one frame at its place in arrays of all frames; the others have none."""
    placed = {}
    for name in Counts._fields:
        placed[name] = np.zeros((frames, *columns[name].shape[1:]), columns[name].dtype)
        placed[name][number] = columns[name][0]
    return placed


class Frame:
    """One frame of a run with one estimator. `frame["wrong_share"]` is a measure, by its name in
    `MEASURES`.
    """

    def __init__(self, run: Run, number: int, estimator: Method | None) -> None:
        self.run = run
        self.number = number
        self.estimator = estimator
        self.config = run.config
        self._first: Depth | None = None

    def __getitem__(self, measure: str) -> Number:
        """Return a measure by its name. Raises `InputError`."""
        return MEASURES[check_choice("measure", measure, tuple(MEASURES))].of(self)

    def by(self, estimator: Method) -> "Frame":
        """Return the same frame with another estimator."""
        return self.run.frame(self.number, estimator)

    @property
    def trace(self) -> Trace:
        """The golden model's frame."""
        return self.run.traces[self.number]

    @property
    def scene(self) -> Scene:
        """What the pixels see in this frame."""
        return self.run.scene.at(self.number)

    @property
    def light(self) -> Light:
        """Detected signal and background of every pixel in this frame."""
        return self.run.light_of(self.number)

    @cached_property
    def seen_edges(self) -> SeenEdges:
        """What the run keeps of the frame's edges."""
        return self.run.seen_edges(self.number)

    @property
    def edges(self) -> Edges:
        """The frame's edges, with pulses counted from its start; of a long run, those of the first
        pulses (`Run.is_long`).
        """
        return self.seen_edges.edges

    @property
    def edge_count(self) -> int:
        """Number of all edges of the frame."""
        return self.seen_edges.total

    @property
    def result(self) -> dict[str, np.ndarray]:
        """The result with this frame's events at least (`Run.result_of`)."""
        return self.run.result_of(self.number)

    @property
    def events(self) -> np.ndarray:
        """int64[n]: the rows of `result` that belong to this frame."""
        return np.flatnonzero(self.result["pulse"] // self.config.pulses == self.number)

    def counter(self, name: str) -> np.ndarray:
        """int64[subgroups]: a counter of the frame, or the least that it may be (`knows`). With the
        golden model it does not need the result, unless it is at its end.
        """
        return self._counter(name)[0]

    def knows(self, name: str) -> bool:
        """Return whether a counter is known in all subgroups (`known_counters`)."""
        return bool(self._counter(name)[1].all())

    def _counter(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return a counter of the frame, and where it is known."""
        if self.run.setup.engine == "golden" and not self.run.has_result:
            counted = self.run.counters(self.number)[:, COUNTER_NAMES.index(name)]
        else:
            counted = self.run.result[name][self.number]
        known = ~at_end(name, counted, self.config.sensor)
        if known.all():
            return counted, known
        counters = known_counters(self.result, self.config)
        return counters.least[name][self.number], counters.known[name][self.number]

    @cached_property
    def beats(self) -> np.ndarray:
        """int64[streams]: beats that left the sensor. With groups, only the golden model's frame
        has their number.
        """
        if FORMATS[self.config.format].grouped:
            return np.array([len(beats) for beats in self.trace.beats])
        return stream_beats(self.config, self.counter("stored"), self.counter("mg_stored"))

    @cached_property
    def threshold(self) -> np.ndarray:
        """int64[subgroups]: pixels that a window needed; 1 with coincidence off."""
        return np.where(self.config.coincidence, self.counter("threshold_used"), 1)

    def depth(self, returns: int = 1) -> Depth:
        """Return the frame's depth. The first return does not depend on the number of returns, so
        measures use it from here.
        """
        found = self.run.depth(self.estimator, frame=self.number, returns=returns)
        if self.run.is_long:
            found = found.with_light()
        if self._first is None:
            self._first = found
        return found

    @property
    def first(self) -> Depth:
        """The frame's depth; use only its first return, because the number of returns varies."""
        return self.depth() if self._first is None else self._first

    @property
    def depth_m(self) -> np.ndarray:
        """float64[rows, cols]: the most likely distance; NaN = none."""
        return self.first.depth_m[:, :, 0]

    @property
    def truth_m(self) -> np.ndarray:
        """float64[rows, cols]: the true distance; NaN = none."""
        return self.scene.truth_m

    @cached_property
    def wrong(self) -> np.ndarray:
        """bool[rows, cols]: the pixels that are wrong by the paper's criterion (`wrong_pixels`)."""
        return wrong_pixels(self.depth_m, self.truth_m)
