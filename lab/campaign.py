# SPDX-License-Identifier: Apache-2.0
"""Many setups: played here, on processes or on a Dask cluster, continued where an earlier start ended, and as one table."""

import json
import os
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Protocol, TypeAlias, TypeVar

from ..model.shared.files import whole_file
from ..model.shared.interrupts import worker_processes
from .measures import Number
from .run import Kept, Run
from .setup import Setup

Progress: TypeAlias = Callable[[int, int], None]  # done, in total; the total grows with each campaign
Read: TypeAlias = Callable[[Run], Any]  # a function of a module, or a partial of one; what it returns is small
Played: TypeAlias = tuple[int, Any, BaseException | None]  # index of the setup, what was read of its run, the error
_Key = TypeVar("_Key", bound=Hashable)
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
_kept = Kept()  # in each process: neighbours in a campaign often have the same photons


class Workers(Protocol):
    """Where setups are played."""

    def play(self, read: Read, setups: Sequence[Setup]) -> Iterator[Played]:
        """Play all setups; yield them in the order in which they are done."""
        ...


def read_one(read: Read, setup: Setup) -> Any:
    """Play one setup on a worker."""
    return read(Run(setup, kept=_kept))


class Processes:
    """This process (`workers` = 1) or new ones (None: one per core), for one campaign after the other; a context manager."""

    def __init__(self, workers: int | None = None, progress: Progress = lambda done, total: None) -> None:
        self.workers, self.progress = workers or os.cpu_count() or 1, progress
        self.done = self.total = 0
        self._pool: ProcessPoolExecutor | None = None
        self._stack = ExitStack()

    def __enter__(self) -> "Processes":
        if self.workers > 1:
            self._pool = self._stack.enter_context(worker_processes(self.workers))
        return self

    def __exit__(self, *raised: Any) -> None:
        self._stack.__exit__(*raised)

    def play(self, read: Read, setups: Sequence[Setup]) -> Iterator[Played]:
        """As `Workers.play`; here, the first error is raised."""
        self.total += len(setups)
        if self._pool is None:
            for number, setup in enumerate(setups):
                yield number, read_one(read, setup), None
                self._count()
            return
        running: dict[Future[Any], int] = {self._pool.submit(read_one, read, one): k for k, one in enumerate(setups)}
        for task in as_completed(running):
            error = task.exception()
            yield running[task], None if error else task.result(), error
            self._count()

    def map(self, function: Callable[[_Item], _Result], items: Iterable[_Item]) -> list[_Result]:
        """Return `function` (of a module) of each item, in order: for tasks that are no setups."""
        tasks = list(items)
        self.total += len(tasks)
        results = []
        for result in self._pool.map(function, tasks) if self._pool else map(function, tasks):
            results.append(result)
            self._count()
        return results

    def _count(self) -> None:
        self.done += 1
        self.progress(self.done, self.total)


class KeptFiles:
    """What was read of setups, as flat JSON in a folder, by the setups' keys."""

    def __init__(self, folder: Path, names: Sequence[str]) -> None:
        self.folder, self.names = folder, list(names)

    def load(self, key: str) -> dict[str, Number] | None:
        """Return what is kept under `key`; None if there is nothing that can be read and has these names."""
        try:
            kept = json.loads((self.folder / f"{key}.json").read_text())
        except (OSError, ValueError):
            return None
        return kept if isinstance(kept, dict) and list(kept) == self.names else None

    def keep(self, key: str, found: dict[str, Number]) -> None:
        with whole_file(self.folder / f"{key}.json", "w") as file:
            file.write(json.dumps(found, indent=1) + "\n")


def campaign(
    setups: Mapping[_Key, Setup],
    read: Read,
    workers: Workers,
    *,
    kept: KeptFiles | None = None,
    failed: dict[_Key, BaseException] | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> dict[_Key, Any]:
    """Return what `read` returns for the run of each setup, by key and in order; it does not depend on the workers.

    kept: setups that an earlier campaign finished are not played again, and setups of equal content are played once.
    failed: gets the error of each setup that has one; None: the first one is raised. progress: gets the number of different
    setups that are done, first of those that are kept.
    """
    digests = {key: setup.key if kept else str(number) for number, (key, setup) in enumerate(setups.items())}
    found = {name: before for name in digests.values() if kept and (before := kept.load(name)) is not None}
    todo = {digests[key]: setup for key, setup in setups.items() if digests[key] not in found}
    names, errors = list(todo), dict[str, BaseException]()
    progress(len(found))
    for number, outcome, error in workers.play(read, list(todo.values())):
        name = names[number]
        if error is None:
            found[name] = outcome
            if kept:
                kept.keep(name, outcome)
        elif failed is None:
            raise error
        else:
            errors[name] = error
        progress(len(found) + len(errors))
    if failed is not None:
        failed |= {key: errors[name] for key, name in digests.items() if name in errors}
    return {key: found[name] for key, name in digests.items() if name in found}


def grouped(groups: Mapping[_Key, Sequence[Setup]], read: Read, workers: Workers) -> dict[_Key, list[Any]]:
    """Return the outcomes of a campaign of groups of setups, such as the seeds of one case."""
    flat = {(key, number): setup for key, group in groups.items() for number, setup in enumerate(group)}
    outcomes = iter(campaign(flat, read, workers).values())
    return {key: [next(outcomes) for _ in group] for key, group in groups.items()}


def read_measures(run: Run, names: Sequence[str]) -> dict[str, Number]:
    """Return measures of a run's last frame; a campaign reads them with a `partial`."""
    return {name: run[name] for name in names}
