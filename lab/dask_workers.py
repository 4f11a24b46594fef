# SPDX-License-Identifier: Apache-2.0
"""The workers of a Dask cluster, on this machine or elsewhere, for a campaign."""

import contextlib
import logging
from collections.abc import Iterator, Sequence
from typing import Any

import dask
from attrs import evolve
from distributed import Client, Future, LocalCluster, as_completed
from distributed.client import FutureCancelledError
from distributed.comm.addressing import parse_address, parse_host_port
from distributed.comm.registry import backends
from distributed.scheduler import KilledWorker

from ..model.scenes.scene import Scene
from ..model.shared.errors import InputError
from ..tb.rtl_errors import SimulationError
from .campaign import Played, Read, batches, read_batch
from .setup import Setup, versions

LOOPBACK = "127.0.0.1"
CONNECT_S = 10
# Workers run this, because the campaign ends them.
DEAF_TO_CTRL_C = "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)"
# workers that may be lost with a setup; after that, we assume that the setup kills them
LOST_WORKERS_MAX = 20


class SchedulerLost(SimulationError):
    """The scheduler was lost during a campaign."""


class Dask:
    """Workers of the scheduler at an address, or of a cluster of `workers` processes that lives as
    long as a campaign.
    """

    def __init__(self, workers: int, scheduler: str | None = None) -> None:
        self.workers, self.scheduler = workers, scheduler

    def play(self, read: Read, setups: Sequence[Setup]) -> Iterator[Played]:
        """As `Workers.play`. Raises `InputError` (no scheduler answers) and `SchedulerLost`."""
        if not setups:
            return
        with cluster(min(self.workers, len(setups)), self.scheduler) as client:
            scenes: dict[int, Future[Any]] = {}
            running: dict[Future[Any], list[int]] = {}
            for setup in setups:
                if id(setup.scene) not in scenes:
                    # The scene is a task of its own: it is sent once, and computed again if its
                    # worker is lost.
                    scenes[id(setup.scene)] = client.submit(_itself, setup.scene, pure=False)
            for batch in batches(setups, self.workers):
                chosen = [setups[k] for k in batch]
                bare = [evolve(setup, scene=None) for setup in chosen]
                given = (
                    read,
                    bare,
                    [scenes[id(setup.scene)] for setup in chosen],
                    versions(chosen[0].engine),
                )
                running[client.submit(_read_batch, *given, pure=False)] = batch
            for task in as_completed(list(running), loop=client.loop):
                batch = running.pop(task)
                try:
                    outcomes = task.result()  # runs again if the worker that held it is lost
                except FutureCancelledError:
                    raise SchedulerLost(
                        "the Dask scheduler is gone; finished points are kept: start the sweep again"
                    ) from None
                except Exception as why:
                    outcomes = [(None, why)] * len(batch)
                for number, (outcome, error) in zip(batch, outcomes, strict=True):
                    yield number, outcome, error


def _itself(scene: Scene | None) -> Scene | None:
    return scene


def _read_batch(
    read: Read, setups: list[Setup], scenes: list[Scene | None], expected: dict[str, str]
) -> list[tuple[Any, BaseException | None]]:
    """Play a batch. Raises `RuntimeError` if this worker has other versions, because its numbers
    could then differ.
    """
    if (own := versions(setups[0].engine)) != expected:
        raise RuntimeError(f"the worker's versions are not the sweep's: {own}, {expected}")
    return read_batch(
        read, [evolve(setup, scene=scene) for setup, scene in zip(setups, scenes, strict=True)]
    )


def reason(error: BaseException) -> str:
    """Return an error of a setup as one line."""
    if isinstance(error, KilledWorker):
        return "every worker that ran it was lost"
    text = " ".join(str(error).split())
    return text if isinstance(error, InputError) else f"{type(error).__name__}: {text}"


@contextlib.contextmanager
def cluster(workers: int, scheduler: str | None = None) -> Iterator[Client]:
    """Return a client of the scheduler at an address, or of a cluster of `workers` processes that
    ends with the block.
    """
    with contextlib.ExitStack() as stack:
        if scheduler is not None:
            _check_address(scheduler)
        else:
            stack.enter_context(
                dask.config.set({"distributed.scheduler.allowed-failures": LOST_WORKERS_MAX})
            )
            scheduler = stack.enter_context(_local_cluster(workers))
        # A lost scheduler is reported by `SchedulerLost`.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        try:
            client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)
        except OSError as error:
            raise InputError(
                f"scheduler = {scheduler!r}: no Dask scheduler answers ({error})"
            ) from None
        yield stack.enter_context(client)


def _local_cluster(workers: int) -> LocalCluster:
    """Start a cluster of processes. Raises `InputError` if the system does not let them start.

    Everything stays on loopback. Even without a dashboard, the scheduler serves its health page on
    a free port.
    """
    # what a process that cannot start says of itself
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)
    try:
        return LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            host=LOOPBACK,
            memory_limit=None,
            silence_logs="CRITICAL",
            preload=DEAF_TO_CTRL_C,
            dashboard_address=None,
            scheduler_kwargs={"dashboard": False, "dashboard_address": f"{LOOPBACK}:0"},
        )
    except (OSError, RuntimeError) as error:
        raise InputError(f"workers = {workers}: they do not start ({error})") from None


def _check_address(scheduler: str) -> None:
    """Check an address before a client is made, because a client with an invalid address would
    never end.
    """
    try:
        scheme, place = parse_address(scheduler, strict=True)
        parse_host_port(place)
        if scheme not in backends:
            raise ValueError(f"{scheme}: none of {', '.join(backends)}")
    except ValueError as error:
        raise InputError(
            f"scheduler = {scheduler!r}: must be an address such as tcp://HOST:8786 ({error})"
        ) from None
