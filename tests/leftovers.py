# SPDX-License-Identifier: Apache-2.0
"""What a test leaves behind in its process: threads, children, open files.

What the program starts or opens, it must end and close itself, also where something fails. So every
test is checked for what it leaves. Files and children are known on Linux only.
"""

import gc
import os
import threading
import time
from multiprocessing import forkserver, resource_tracker
from pathlib import Path
from typing import NamedTuple

PATIENCE_S = 60.0  # that what ends has for it
PROCESS = Path("/proc/self")
# Dask keeps threads for the whole process.
THREADS_OF_LIBRARIES = "Dask-"
# Matplotlib keeps fonts open, libraries that are loaded stay so, and Asyncio closes the
# files of a loop when nobody refers to it.
FILES_OF_LIBRARIES = (".ttf", ".so", "anon_inode:", "socket:", "pipe:", "/dev/")


class Held(NamedTuple):
    """What a process holds."""

    threads: frozenset[threading.Thread]
    children: frozenset[int]
    files: frozenset[str]  # links that name them

    @classmethod
    def now(cls) -> "Held":
        """Return what this process holds now."""
        return cls(
            frozenset(
                thread
                for thread in threading.enumerate()
                if THREADS_OF_LIBRARIES not in thread.name
            ),
            frozenset(_children() - _of_multiprocessing()),
            frozenset(_files()),
        )

    def beyond(self, before: "Held") -> list[str]:
        """Return in words what is held that was not before."""
        return [
            *(f"thread {thread.name}" for thread in self.threads - before.threads),
            *(f"child process {child}" for child in self.children - before.children),
            *(f"file {name}" for name in self.files - before.files),
        ]


def leftovers(before: Held) -> list[str]:
    """Return in words what is still held after a while, and was not before."""
    end = time.monotonic() + PATIENCE_S
    left = Held.now().beyond(before)
    while left and time.monotonic() < end:
        gc.collect()  # closes files that only circles of objects refer to
        time.sleep(0.01)
        left = Held.now().beyond(before)
    return left


def _children() -> set[int]:
    """Return the numbers of this process's children, of all its threads."""
    found: set[int] = set()
    for of_thread in PROCESS.glob("task/*/children"):
        try:
            found.update(map(int, of_thread.read_text(encoding="ascii").split()))
        except OSError:  # the thread has ended
            continue
    return found


def _of_multiprocessing() -> set[int]:
    """Return the numbers of the processes that `multiprocessing` keeps for others."""
    keepers = resource_tracker._resource_tracker, forkserver._forkserver
    numbers = {getattr(one, "_pid", None) for one in keepers}
    numbers |= {getattr(one, "_forkserver_pid", None) for one in keepers}
    return {number for number in numbers if number is not None}


def _files() -> set[str]:
    """Return the names of the files that are open, except those of libraries."""
    found = set()
    for descriptor in PROCESS.glob("fd/*"):
        try:
            name = os.readlink(descriptor)
        except OSError:  # closed meanwhile
            continue
        if not any(part in name for part in FILES_OF_LIBRARIES):
            found.add(name)
    return found
