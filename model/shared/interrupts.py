# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C and SIGTERM as exceptions, however a program was started, and threads and processes
that end with their parent.
"""

import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing import active_children, get_context
from subprocess import Popen
from threading import Timer
from typing import Any, TypeVar

_Result = TypeVar("_Result")

PROGRAMS: set[Popen[Any]] = set()  # programs that run at this moment
KILL_S = 0.1  # seconds between two looks for programs
AGAIN_S = 0.05  # seconds until a signal that was lost comes again
INTERRUPTED, TERMINATED = 130, 143  # exit codes: 128 plus the number of the signal


class Terminated(KeyboardInterrupt):
    """SIGTERM. Code that cleans up after Ctrl-C also cleans up after this."""


def exit_code(why: KeyboardInterrupt) -> int:
    """Return the exit code of a program that a signal ended."""
    return TERMINATED if isinstance(why, Terminated) else INTERRUPTED


def interruptible() -> None:
    """Make SIGINT and SIGTERM raise in this process, even if its parent ignored them, as `nohup`
    and background shells do.

    Programs that it starts get the default handling. A second SIGTERM changes nothing: the
    cleaning up goes on. Where nothing can be raised, as in a callback of the compiler, the signal
    comes again a little later.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, _terminate)
    sys.unraisablehook = _repeat_signal


def _terminate(number: int, frame: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise Terminated


def _repeat_signal(lost: Any) -> None:
    """Send a signal again whose exception was lost; show other lost exceptions. lost: as of
    `sys.unraisablehook`.
    """
    if not issubclass(lost.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
        return
    number = signal.SIGINT
    if issubclass(lost.exc_type, Terminated):
        number = signal.SIGTERM
        signal.signal(signal.SIGTERM, _terminate)
    again = Timer(AGAIN_S, os.kill, (os.getpid(), number))
    again.daemon = True
    again.start()


@contextmanager
def worker_processes(
    workers: int, initializer: Callable[..., None] | None = None, *arguments: object
) -> Iterator[ProcessPoolExecutor]:
    """A pool of new processes, each started with `initializer`. If the block ends with an
    exception, they are killed.
    """
    before = set(active_children())
    with ProcessPoolExecutor(
        workers, get_context("spawn"), partial(_begin, initializer, *arguments)
    ) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in set(active_children()) - before:
                child.kill()
            raise


@contextmanager
def in_background(function: Callable[[], _Result]) -> Iterator[Future[_Result]]:
    """Call `function` in a thread. If the block ends with an exception, `PROGRAMS` are killed
    until the thread has ended.
    """
    with ThreadPoolExecutor(1) as pool:
        called = pool.submit(function)
        try:
            yield called
        except BaseException:
            while wait([called], KILL_S).not_done:
                for running in set(PROGRAMS):
                    _kill(running)
            raise


@contextmanager
def program(command: Sequence[str], **options: Any) -> Iterator[Popen[Any]]:
    """A program, with the options of `Popen`. If the block ends with an exception, it is killed
    with all that it started.
    """
    running = Popen(command, start_new_session=True, **options)
    PROGRAMS.add(running)
    try:
        yield running
    except BaseException:
        _kill(running)
        running.wait()
        raise
    finally:
        PROGRAMS.discard(running)


def _kill(running: Popen[Any]) -> None:
    with suppress(ProcessLookupError):  # it ended at this very moment
        os.killpg(running.pid, signal.SIGKILL)


def _begin(initializer: Callable[..., None] | None, *arguments: object) -> None:
    """Ignore Ctrl-C in a worker: it is for the process that started the worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if initializer is not None:
        initializer(*arguments)
