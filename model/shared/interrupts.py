# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C and SIGTERM as exceptions, however a program was started, and worker processes that end with their parent."""

import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children, get_context

INTERRUPTED, TERMINATED = 130, 143  # exit codes: 128 plus the number of the signal


class Terminated(KeyboardInterrupt):
    """SIGTERM. Code that cleans up after Ctrl-C also cleans up after this."""


def interruptible() -> None:
    """Make SIGINT and SIGTERM raise in this process, even if its parent ignored them, as `nohup` and background shells do.

    Programs that it starts get the default handling. A second SIGTERM changes nothing: the cleaning up goes on.
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
    """A pool of new processes, each started with `initializer`. If the block ends with an exception, they are killed."""
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
    """Ignore Ctrl-C in a worker: it is for the process that started the worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if initializer is not None:
        initializer(*arguments)
