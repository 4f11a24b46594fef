# SPDX-License-Identifier: Apache-2.0
"""Progress of long work."""

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn


class Bar:
    """Progress in stages: a bar on a terminal, otherwise one line per stage if `lines`; a context manager."""

    def __init__(self, console: Console, lines: bool = False) -> None:
        percent = TextColumn("{task.percentage:>3.0f} %")
        columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), percent, TimeElapsedColumn())
        self._progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._lines = lines and not console.is_terminal
        self._task: TaskID | None = None

    def __enter__(self) -> "Bar":
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def stage(self, name: str, total: int | None = None) -> None:
        """Begin a stage; total: of the amounts that `done` gets, None if it is unknown."""
        if self._task is not None:
            self._progress.remove_task(self._task)
        self._task = self._progress.add_task(name, total=total)
        if self._lines:
            self._progress.console.print(name)

    def done(self, amount: int, total: int | None = None) -> None:
        """Tell the amount that is done, and a total that has changed."""
        if self._task is not None:
            self._progress.update(self._task, completed=amount, total=total)
