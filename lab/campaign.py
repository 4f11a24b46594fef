# SPDX-License-Identifier: Apache-2.0
"""Campaigns play many setups: in this process, in others or on a Dask cluster. A campaign can
continue an interrupted one.
"""

import json
import os
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Protocol, TypeAlias, TypeVar

import numpy as np

from ..model.contract.edges import Edges
from ..model.contract.parameters import Sensor
from ..model.shared.files import whole_file
from ..model.shared.interrupts import worker_processes
from ..tb.engines import sensors_together
from ..tb.replay import replay_together
from .measures import Number
from .outcomes import Run, StageCache
from .setup import Setup

# gets the number done and the total, which grows with each campaign
Progress: TypeAlias = Callable[[int, int], None]
# a function of a module, or a partial of one, that returns something small
Read: TypeAlias = Callable[[Run], Any]
# index of the setup, what was read from its run, its error
Played: TypeAlias = tuple[int, Any, BaseException | None]
_Key = TypeVar("_Key", bound=Hashable)
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
TOGETHER_MAX = 8  # setups in a batch: the edges of all of them are in memory at the same time
# one in each process, because successive setups of a campaign often have the same photons
_cache = StageCache()


class Workers(Protocol):
    """Where setups are played."""

    def play(self, read: Read, setups: Sequence[Setup]) -> Iterator[Played]:
        """Play all setups; yield them in the order in which they are done."""
        ...


def batches(setups: Sequence[Setup], workers: int) -> list[list[int]]:
    """Return the setups of each batch, by number. The sliced engine plays a batch in its lanes;
    others get one setup per batch.
    """
    found: list[list[int]] = []
    by_sensor: dict[Sensor, list[int]] = {}
    for number, setup in enumerate(setups):
        if setup.engine == "sliced":
            by_sensor.setdefault(setup.config.sensor, []).append(number)
        else:
            found.append([number])
    for sensor, numbers in by_sensor.items():
        size = min(TOGETHER_MAX, sensors_together(sensor.subgroups), -(-len(numbers) // workers))
        found += [numbers[k : k + size] for k in range(0, len(numbers), size)]
    return found


def read_batch(read: Read, setups: Sequence[Setup]) -> list[tuple[Any, BaseException | None]]:
    """Play the setups of a batch on a worker; return what was read from each run, or its error."""
    played: list[tuple[Edges | None, dict[str, np.ndarray] | None]] = [(None, None)] * len(setups)
    if len(setups) > 1:
        # After an error, each setup is played again alone below, which shows the setup that fails.
        with suppress(Exception):
            drawn = [Run(setup).edges for setup in setups]
            together = replay_together(
                [(setup.config, edges) for setup, edges in zip(setups, drawn, strict=True)]
            )
            played = list(zip(drawn, together, strict=True))
    outcomes: list[tuple[Any, BaseException | None]] = []
    for setup, (edges, result) in zip(setups, played, strict=True):
        try:
            run = Run(setup, cache=_cache, edges=edges, result=result)
            outcomes.append((read(run), None))
        except Exception as error:
            outcomes.append((None, error))
    return outcomes


class Processes:
    """This process (`workers` = 1) or new ones (None: one per core), for several campaigns in turn;
    a context manager.
    """

    def __init__(
        self, workers: int | None = None, progress: Progress = lambda done, total: None
    ) -> None:
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
        """As `Workers.play`."""
        self.total += len(setups)
        todo = batches(setups, self.workers)
        if self._pool is None:
            for batch in todo:
                yield from self._counted(batch, read_batch(read, [setups[k] for k in batch]))
            return
        running: dict[Future[Any], list[int]] = {
            self._pool.submit(read_batch, read, [setups[k] for k in batch]): batch for batch in todo
        }
        for task in as_completed(running):
            batch, error = running[task], task.exception()
            yield from self._counted(
                batch, [(None, error)] * len(batch) if error else task.result()
            )

    def _counted(
        self, batch: Sequence[int], outcomes: Sequence[tuple[Any, BaseException | None]]
    ) -> Iterator[Played]:
        for number, (outcome, error) in zip(batch, outcomes, strict=True):
            yield number, outcome, error
            self._count()

    def map(self, function: Callable[[_Item], _Result], items: Iterable[_Item]) -> list[_Result]:
        """Return the results of a module's `function` for all items, in order. This is for tasks
        that are not setups.
        """
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


class FinishedFiles:
    """A folder with one flat JSON file per finished setup: what was read from its run. The setup's
    key names the file.
    """

    def __init__(self, folder: Path, names: Sequence[str]) -> None:
        self.folder = folder
        self.names = list(names)

    def load(self, key: str) -> dict[str, Number] | None:
        """Return what the file of `key` holds; None if no readable file with these names exists."""
        try:
            found = json.loads((self.folder / f"{key}.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return found if isinstance(found, dict) and list(found) == self.names else None

    def store(self, key: str, found: dict[str, Number]) -> None:
        with whole_file(self.folder / f"{key}.json", "w") as file:
            file.write(json.dumps(found, indent=1) + "\n")


def campaign(
    setups: Mapping[_Key, Setup],
    read: Read,
    workers: Workers,
    *,
    finished: FinishedFiles | None = None,
    failed: dict[_Key, BaseException] | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> dict[_Key, Any]:
    """Return the result of `read` for the run of each setup, by key and in order; the workers do
    not change it.

    finished: setups of an earlier campaign, which are not played again; setups with equal content
    are then played once.
    failed: receives the error of each setup that fails; None: the first error is raised. progress:
    is called with the number of different setups that are done, first with the number of those that
    were finished before.
    """
    digests = {
        key: setup.key if finished else str(number)
        for number, (key, setup) in enumerate(setups.items())
    }
    found: dict[str, Any] = {}
    if finished is not None:
        for name in digests.values():
            before = finished.load(name)
            if before is not None:
                found[name] = before
    todo = {digests[key]: setup for key, setup in setups.items() if digests[key] not in found}
    names = list(todo)
    errors: dict[str, BaseException] = {}
    progress(len(found))
    for number, outcome, error in workers.play(read, list(todo.values())):
        name = names[number]
        if error is None:
            found[name] = outcome
            if finished:
                finished.store(name, outcome)
        elif failed is None:
            raise error
        else:
            errors[name] = error
        progress(len(found) + len(errors))
    if failed is not None:
        failed |= {key: errors[name] for key, name in digests.items() if name in errors}
    return {key: found[name] for key, name in digests.items() if name in found}


def grouped(
    groups: Mapping[_Key, Sequence[Setup]], read: Read, workers: Workers
) -> dict[_Key, list[Any]]:
    """Return the outcomes of a campaign of groups of setups, such as the seeds of one case."""
    flat = {
        (key, number): setup for key, group in groups.items() for number, setup in enumerate(group)
    }
    outcomes = iter(campaign(flat, read, workers).values())
    return {key: [next(outcomes) for _ in group] for key, group in groups.items()}


def read_measures(run: Run, names: Sequence[str]) -> dict[str, Number]:
    """Return measures of a run's last frame. Campaigns use a `partial` of this function."""
    return {name: run[name] for name in names}
