# SPDX-License-Identifier: Apache-2.0
"""Runs settings through scene, photons and golden model, in stages that are kept: a new threshold needs no new photons.

Runs happen in a thread. Each has a number, and only the newest one's outcome is delivered, so that a late answer is never
shown for other settings.
"""

import os
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeAlias

import numpy as np
from attrs import astuple, field, frozen

from ...model.contract.edges import Edges
from ...model.contract.result import ResultBuilder, differences
from ...model.golden.frame import Golden, Trace
from ...model.light.light import Light
from ...model.light.photons import edge_chunks
from ...model.scenes.scene import Scene
from ...model.shared.errors import InputError
from ..show.frame import FrameView, frame_view
from .controls import CONTROLS
from .settings import Settings

KEPT = 3  # of each stage: for the present settings, the previous ones, and A's
EDGES_MAX = 30_000_000  # of all frames: about a gigabyte
PHOTON_GROUPS = ("Scene", "Light", "SPAD")  # groups of controls that change the photons, in addition to time and gate
Progress: TypeAlias = Callable[[str, float], None]
Deliver: TypeAlias = Callable[[int, str, Any], None]


class CancelledError(Exception):
    """A run whose outcome is no longer needed."""


@frozen(eq=False)
class Explored:
    """Result of the settings. edges: of all frames; traces: of each frame, from the golden model; arrays: as in a result file.

    seconds: from settings to result.
    """

    settings: Settings
    scene: Scene
    light: Light
    edges: Edges
    traces: list[Trace]
    arrays: dict[str, np.ndarray]
    seconds: float
    _views: dict[tuple[int, str], FrameView] = field(factory=dict)

    def view(self, frame: int = 0) -> FrameView:
        """Return the views of a frame with the settings' estimator."""
        config, method = self.settings.config, self.settings.values["method"]
        if (frame, method) not in self._views:
            self._views[frame, method] = frame_view(
                f"frame {frame}",
                config,
                self.scene,
                self.light,
                self.edges.frame(frame, config.pulses)[0],
                self.traces[frame],
                self.arrays,
                frame=frame,
                method=method,
            )
        return self._views[frame, method]


class Explorer:
    """Computes `Explored` from `Settings` and keeps the results of the stages."""

    def __init__(self) -> None:
        self._kept: dict[str, OrderedDict[Hashable, Any]] = {}

    def run(self, settings: Settings, progress: Progress = lambda stage, share: None) -> Explored:
        """Run all frames of `settings`, and compute the views of the last one. Raises `InputError`.

        progress(stage, share from 0 to 1) may raise an exception to stop the run.
        """
        began = time.perf_counter()
        photons = _photon_key(settings)
        scene, light, edges = self._stage("photons", photons, lambda: _photons(settings, progress))
        chosen = tuple((c.name, settings.values[c.name]) for c in CONTROLS if c.where)
        traces, arrays = self._stage("frames", (photons, chosen), lambda: _frames(settings, edges, progress))
        progress("depth", 0.0)
        explored = Explored(settings, scene, light, edges, traces, arrays, 0.0)
        explored.view(settings.config.frames - 1)
        object.__setattr__(explored, "seconds", time.perf_counter() - began)
        return explored

    def _stage(self, name: str, key: Hashable, make: Callable[[], Any]) -> Any:
        kept = self._kept.setdefault(name, OrderedDict())
        if key not in kept:
            kept[key] = make()
            while len(kept) > KEPT:
                kept.popitem(last=False)
        kept.move_to_end(key)
        return kept[key]


def _photon_key(settings: Settings) -> Hashable:
    """Return everything that the edges depend on."""
    values, sensor = settings.values, settings.config.sensor
    light = tuple(values[c.name] for c in CONTROLS if c.group in PHOTON_GROUPS)
    gate = tuple((c.name, values[c.name]) for c in CONTROLS if c.group == "Gate") if values["spad_gate"] else ()
    return sensor.rows, sensor.cols, astuple(settings.timing), light, gate, settings.uploads


def _photons(settings: Settings, progress: Progress) -> tuple[Scene, Light, Edges]:
    progress("scene", 0.0)
    scene = settings.scene()
    light = settings.light(scene)
    pulses = settings.config.pulses * settings.config.frames
    chunks, made = [], 0
    for chunk in edge_chunks(
        light,
        settings.spad,
        settings.timing,
        pulses=pulses,
        seed=settings.values["seed"],
        gate=settings.spad_gate,
        workers=os.cpu_count() or 1,
    ):
        chunks.append(chunk)
        made += len(chunk)
        if made > EDGES_MAX:
            raise InputError(
                f"edges: more than {EDGES_MAX:,} in so much light; must be fewer here (fewer pulses, or coincid sim)"
            )
        progress("photons", float(chunk.pulse[-1] + 1) / pulses if len(chunk) else 0.0)
    names = ("pulse", "pixel", "tick")
    return scene, light, Edges(*(np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in names))


def _frames(settings: Settings, edges: Edges, progress: Progress) -> tuple[list[Trace], dict[str, np.ndarray]]:
    """Do the same as `golden_result`, but keep the traces."""
    config = settings.config
    model, result, traces = Golden(config.sensor), ResultBuilder(config), []
    for number in range(config.frames):
        progress("golden model", number / config.frames)
        trace = model.frame(config, edges.frame(number, config.pulses)[0])
        result.add(trace.beats, trace.commit_subgroup, trace.commit_cycle)
        traces.append(trace)
    return traces, result.arrays()


def check_on_rtl(explored: Explored, progress: Progress = lambda stage, share: None) -> str:
    """Play the same edges through the Verilated RTL; return that all words agree, or the differences. Raises as `replay`."""
    from ...tb.replay import replay  # it may load the simulators, which only this function needs

    config = explored.settings.config
    progress("RTL: emitted and compiled once", 0.0)
    cycles = config.frame_cycles * config.frames
    found = replay("verilator", config, explored.edges, progress=lambda done: progress("RTL", min(1.0, done / cycles)))
    lines = differences(found, explored.arrays)
    if lines:
        return "The RTL and the golden model differ: " + "; ".join(lines)
    words = sum(len(beats) for trace in explored.traces for beats in trace.beats)
    events = len(explored.arrays["pulse"])
    frames = "frame" if config.frames == 1 else f"{config.frames} frames"
    return f"Every word agrees: the RTL sent the same {frames}, {words:,} words with {events:,} events, each in the same cycle of commit."


class Runner:
    """Runs jobs in one thread, one after the other; a new job cancels the earlier ones.

    deliver(number, kind, outcome) is called from the thread: kind "progress" with (stage, share), "done" with the return
    value, or "failed" with the exception. It is never called for a number that is no longer the newest.
    """

    def __init__(self, deliver: Deliver) -> None:
        self._deliver = deliver
        self._lock = threading.Lock()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="explorer")
        self.newest = 0

    def start(self, work: Callable[[Progress], object]) -> int:
        """Start `work(progress)` and return its number."""
        with self._lock:
            self.newest += 1
            number = self.newest
        self._pool.submit(self._run, number, work)
        return number

    def cancel(self) -> None:
        """Cancel the current job."""
        with self._lock:
            self.newest += 1

    def close(self) -> None:
        self.cancel()
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _run(self, number: int, work: Callable[[Progress], object]) -> None:
        def say(kind: str, outcome: object) -> None:
            if number != self.newest:
                raise CancelledError
            self._deliver(number, kind, outcome)

        try:
            say("progress", ("begins", 0.0))
            say("done", work(lambda stage, share: say("progress", (stage, share))))
        except CancelledError:
            pass
        except Exception as error:  # the page shows any exception
            if number == self.newest:
                self._deliver(number, "failed", error)
