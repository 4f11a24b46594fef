# SPDX-License-Identifier: Apache-2.0
"""Shows the progress of long work on the terminal."""

import time
from contextlib import suppress
from threading import Event, Thread

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from ..model.shared.compiled import is_compiled

LINE_EVERY_S = 4.0
COMPILES = "compiling the models, first run only"


def first_time(stage: str, module: str) -> str:
    """Return the name of a stage, with a note if the kernels of a module's room are still to be
    compiled.
    """
    return stage if is_compiled(module) else f"{stage} ({COMPILES})"


class Bar:
    """Shows progress in stages, as a context manager: a bar on a terminal; elsewhere, if `lines`, a
    line at the start of each stage and every few seconds.
    """

    def __init__(self, console: Console, lines: bool = False) -> None:
        percent = TextColumn("{task.percentage:>3.0f} %")
        columns = (
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(),
            percent,
            TimeElapsedColumn(),
        )
        self._progress = Progress(
            *columns, console=console, transient=True, disable=not console.is_terminal
        )
        self._lines = lines and not console.is_terminal
        self._task: TaskID | None = None
        self._stage, self._began, self._ended = "", 0.0, Event()

    def __enter__(self) -> "Bar":
        self._progress.start()
        if self._lines:
            Thread(target=self._tell, name="progress", daemon=True).start()
        return self

    def _tell(self) -> None:
        """Print every few seconds which stage is running, for output without a bar.

        Where the output takes no more, the command says so by itself.
        """
        with suppress(OSError):
            while not self._ended.wait(LINE_EVERY_S):
                seconds = time.monotonic() - self._began
                if self._stage and seconds >= LINE_EVERY_S:
                    self._progress.console.print(f"{self._stage}: {seconds:.0f} s")

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._progress.stop()

    def stage(self, name: str, total: int | None = None) -> None:
        """Begin a stage. total: the amount at which it is done (`done`), None if that is
        unknown.
        """
        if self._task is not None:
            self._progress.remove_task(self._task)
        self._task = self._progress.add_task(name, total=total)
        self._stage, self._began = name, time.monotonic()
        if self._lines:
            self._progress.console.print(name)

    def at(self, stage: str, done: int, total: int) -> None:
        """Set the finished amount of a stage; begin this stage first if it is new."""
        if stage != self._stage:
            self.stage(stage, total)
        self.done(done)

    def done(self, amount: int, total: int | None = None) -> None:
        """Set the finished amount, and a total if it has changed."""
        if self._task is not None:
            self._progress.update(self._task, completed=amount, total=total)
