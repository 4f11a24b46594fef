# SPDX-License-Identifier: Apache-2.0
"""What a test leaves behind in its process: threads and open files.

What the program starts or opens, it must end and close itself, also where something fails. So every
test is checked for what it leaves. Files are known on Linux only. Child processes are not looked at:
those that compile kernels ahead outlive the test that began them.
"""

import gc
import os
import threading
import time
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
            frozenset(_files()),
        )

    def beyond(self, before: "Held") -> list[str]:
        """Return in words what is held that was not before."""
        return [
            *(f"thread {thread.name}" for thread in self.threads - before.threads),
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
