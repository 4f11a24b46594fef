# SPDX-License-Identifier: Apache-2.0
"""Runs settings through scene, photons and golden model, in stages that are kept: a new threshold needs no new photons.

Runs happen in a thread. Each has a number, and only the newest one's outcome is delivered, so that a late answer is never
shown for other settings.
"""

import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeAlias

from attrs import evolve, field, frozen

from ...lab.outcomes import Kept, Run
from ...model.contract.result import differences
from ...model.shared.errors import InputError
from ..show.frame_content import FrameView
from .control_values import Settings

KEPT = 3  # of each stage: for the present settings, the previous ones, and A's
THREADS = 4  # of jobs: the newest, and cancelled ones that have not noticed yet
TOLD_EVERY_S = 0.1  # progress
EDGES_MAX = 30_000_000  # of all frames: about a gigabyte
Progress: TypeAlias = Callable[[str, float], None]
Deliver: TypeAlias = Callable[[int, str, Any], None]


class CancelledError(Exception):
    """A run whose outcome is no longer needed."""


@frozen(eq=False)
class Explored:
    """Result of the settings. seconds: from settings to result."""

    settings: Settings
    run: Run
    seconds: float = 0.0
    _views: dict[int, FrameView] = field(factory=dict)

    def view(self, frame: int = 0) -> FrameView:
        """Return the views of a frame with the settings' estimator."""
        if frame not in self._views:
            self._views[frame] = FrameView(f"frame {frame}", self.run.frame(frame))
        return self._views[frame]


class Explorer:
    """Computes `Explored` from `Settings` and keeps photons and frames of the golden model."""

    def __init__(self) -> None:
        self._kept = Kept(KEPT)

    def run(self, settings: Settings, progress: Progress = lambda stage, share: None) -> Explored:
        """Run all frames of `settings`, and compute the views of the last one. Raises `InputError`.

        progress(stage, share from 0 to 1) may raise an exception to stop the run.
        """

        def watch(stage: str, share: float, edges: int) -> None:
            progress(stage, share)
            if edges > EDGES_MAX:
                raise InputError(
                    f"edges: more than {EDGES_MAX:,} in so much light; must be fewer here (fewer pulses, or coincid sim)"
                )

        began = time.perf_counter()
        progress("scene", 0.0)
        run = Run(settings.setup(), kept=self._kept, workers=os.cpu_count() or 1, watch=watch)
        _ = run.result
        progress("depth", 0.0)
        explored = Explored(settings, run)
        explored.view(settings.config.frames - 1)
        return evolve(explored, seconds=time.perf_counter() - began)


def check_on_rtl(explored: Explored, progress: Progress = lambda stage, share: None) -> str:
    """Play the same edges through the Verilated RTL; return that all words agree, or the differences. Raises as `replay`."""
    from ...tb.replay import replay  # it may load the simulators, which only this function needs

    run, config = explored.run, explored.settings.config
    progress("RTL: emitted and compiled once", 0.0)
    cycles = config.frame_cycles * config.frames
    found = replay("sliced", config, run.edges, progress=lambda done: progress("RTL", min(1.0, done / cycles)))
    lines = differences(found, run.result)
    if lines:
        return "The RTL and the golden model differ: " + "; ".join(lines)
    words = sum(len(beats) for trace in run.traces for beats in trace.beats)
    events = len(run.result["pulse"])
    frames = "frame" if config.frames == 1 else f"{config.frames} frames"
    return f"Every word agrees: the RTL sent the same {frames}, {words:,} words with {events:,} events, each in the same cycle of commit."


class Runner:
    """Runs jobs in threads; a new job begins at once and cancels the earlier ones, which end at their next progress.

    deliver(number, kind, outcome) is called from the thread: kind "progress" with (stage, share), "done" with the return
    value, or "failed" with the exception. It is never called for a number that is no longer the newest.
    """

    def __init__(self, deliver: Deliver) -> None:
        self._deliver = deliver
        self._lock = threading.Lock()
        self._pool = ThreadPoolExecutor(THREADS, thread_name_prefix="explorer")
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
        told = "", 0.0  # the last stage that was told, and when

        def say(kind: str, outcome: object) -> None:
            if number != self.newest:
                raise CancelledError
            self._deliver(number, kind, outcome)

        def tell(stage: str, share: float) -> None:
            nonlocal told
            if number != self.newest:
                raise CancelledError
            if stage != told[0] or time.monotonic() - told[1] > TOLD_EVERY_S:
                told = stage, time.monotonic()
                say("progress", (stage, share))

        try:
            say("progress", ("begins", 0.0))
            say("done", work(tell))
        except CancelledError:
            pass
        except Exception as error:  # the page shows any exception
            if number == self.newest:
                self._deliver(number, "failed", error)
