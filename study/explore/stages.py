# SPDX-License-Identifier: Apache-2.0
"""Runs settings through scene, photons and golden model. Stages are kept, so a new threshold needs
no new photons.

Each run happens in a thread and has a number. Only the outcome of the newest run is delivered, so a
late answer is never shown beside other settings.
"""

import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeAlias

from attrs import evolve, field, frozen

from ...lab.outcomes import Run, StageCache
from ...model.contract.result import differences
from ...model.shared.errors import InputError
from ..show.frame_content import FrameView
from .control_values import Settings

CACHED = 3  # results per stage: of the present settings, the previous ones, and those of A
THREADS = 4  # for the newest job, and for cancelled jobs that are still ending
TOLD_EVERY_S = 0.1  # time between two reports of progress
EDGES_MAX = 30_000_000  # in all frames; they take about a gigabyte
Progress: TypeAlias = Callable[[str, float], None]
Deliver: TypeAlias = Callable[[int, str, Any], None]


class CancelledError(Exception):
    """Ends a run whose outcome is no longer needed."""


@frozen(eq=False)
class Explored:
    """The result of settings. seconds: time from settings to result."""

    settings: Settings
    run: Run
    seconds: float = 0.0
    _views: dict[int, FrameView] = field(factory=dict)

    def view(self, frame: int = 0) -> FrameView:
        """Return the view of a frame with the estimator of the settings."""
        if frame not in self._views:
            self._views[frame] = FrameView(f"frame {frame}", self.run.frame(frame))
        return self._views[frame]


class Explorer:
    """Computes `Explored` from `Settings` and keeps photons and frames of the golden model."""

    def __init__(self) -> None:
        self._cache = StageCache(CACHED)

    def run(self, settings: Settings, progress: Progress = lambda stage, share: None) -> Explored:
        """Run all frames of `settings`, and compute the view of the last one. Raises `InputError`.

        progress: gets the stage and its finished share, 0 to 1; it may raise an exception to stop
        the run.
        """

        def watch(stage: str, share: float, edges: int) -> None:
            progress(stage, share)
            if edges > EDGES_MAX:
                raise InputError(
                    f"edges: more than {EDGES_MAX:,} in so much light; must be fewer here (fewer pulses, or coincid sim)"
                )

        began = time.perf_counter()
        progress("scene", 0.0)
        run = Run(settings.setup(), cache=self._cache, workers=os.cpu_count() or 1, watch=watch)
        _ = run.result
        progress("depth", 0.0)
        explored = Explored(settings, run)
        explored.view(settings.config.frames - 1)
        return evolve(explored, seconds=time.perf_counter() - began)


def check_on_rtl(explored: Explored, progress: Progress = lambda stage, share: None) -> str:
    """Play the same edges on the RTL; return a sentence: all words agree, or the differences.
    Raises the errors of `replay`.
    """
    # here, because it loads simulators that only this function needs
    from ...tb.replay import replay

    run, config = explored.run, explored.settings.config
    progress("RTL: emitted and compiled once", 0.0)
    cycles = config.frame_cycles * config.frames
    found = replay(
        "sliced", config, run.edges, progress=lambda done: progress("RTL", min(1.0, done / cycles))
    )
    lines = differences(found, run.result)
    if lines:
        return "The RTL and the golden model differ: " + "; ".join(lines)
    words = sum(len(beats) for trace in run.traces for beats in trace.beats)
    events = len(run.result["pulse"])
    frames = "frame" if config.frames == 1 else f"{config.frames} frames"
    return f"Every word agrees: the RTL sent the same {frames}, {words:,} words with {events:,} events, each in the same cycle of commit."


class Runner:
    """Runs jobs in threads. A new job begins immediately and cancels earlier ones, which end at
    their next progress report.

    deliver(number, kind, outcome) is called from the thread. kind is "progress" with (stage,
    share), "done" with the return value, or "failed" with the exception. The number is always that
    of the newest job.
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
        told = "", 0.0  # the last reported stage, and the time of the report

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
