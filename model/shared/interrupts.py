# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C and SIGTERM as exceptions, wherever a program was started from, and worker processes that do not outlive one."""

import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children, get_context

INTERRUPTED, TERMINATED = 130, 143  # exit codes: 128 and the signal's number


class Terminated(KeyboardInterrupt):
    """SIGTERM: everything that cleans up behind Ctrl-C does so behind this."""


def interruptible() -> None:
    """Makes SIGINT and SIGTERM raise in this process, even where its parent ignored them, as `nohup` and shells in the background do.

    Programs that it starts get the signals' defaults. A second SIGTERM changes nothing: the first one's cleaning up goes on.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, _terminate)


def _terminate(number: int, frame: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise Terminated


@contextmanager
def worker_processes(
    workers: int, initializer: Callable[..., None] | None = None, *arguments: object
) -> Iterator[ProcessPoolExecutor]:
    """A pool of new processes, each begun with `initializer`; where the block ends with an exception they are killed at their work."""
    before = set(active_children())
    with ProcessPoolExecutor(workers, get_context("spawn"), partial(_begin, initializer, *arguments)) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in set(active_children()) - before:
                child.kill()
            raise


def _begin(initializer: Callable[..., None] | None, *arguments: object) -> None:
    """In a worker: Ctrl-C of a terminal is for the process that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if initializer is not None:
        initializer(*arguments)
