# SPDX-License-Identifier: Apache-2.0
"""What a test leaves behind: threads, open files, temporary files, and changes of its process.

What the program starts, opens, makes or changes, it must end, close, remove or restore itself, also
where something fails. So every test is checked for what it leaves. Open files are known on Linux
only. Child processes are not looked at: those that compile kernels ahead outlive the test that began
them.
"""

import gc
import locale
import logging
import os
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

PATIENCE_S = 60.0  # that what ends has for it
PROCESS = Path("/proc/self")
# Dask keeps threads for the whole process.
THREADS_OF_LIBRARIES = "Dask-"
# Matplotlib keeps fonts open, libraries that are loaded stay so, and Asyncio closes the
# files of a loop when nobody refers to it.
FILES_OF_LIBRARIES = (".ttf", ".so", "anon_inode:", "socket:", "pipe:", "/dev/")
# How temporary files of the program begin; others' remain when they are killed.
TEMPORARY = ("coincid-", tempfile.gettempprefix())
# That of the explorer's uploads lives as long as a page of it, which pytest holds.
TEMPORARY_THAT_STAYS = "coincid-explore-"
VARIABLE_OF_PYTEST = "PYTEST_CURRENT_TEST"  # the test that runs
OWN = "COINCID"  # how variables of the program begin


class Held(NamedTuple):
    """What a process holds."""

    threads: frozenset[threading.Thread]
    files: frozenset[str]  # links that name the open ones
    temporary: frozenset[str]  # names in the folder of temporary files
    state: dict[str, object]  # what all code of the process shares

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
            frozenset(
                name
                for name in os.listdir(tempfile.gettempdir())
                if name.startswith(TEMPORARY) and not name.startswith(TEMPORARY_THAT_STAYS)
            ),
            _state(),
        )

    def beyond(self, before: "Held") -> list[str]:
        """Return in words what is held that was not before."""
        return [
            *(f"thread {thread.name}" for thread in self.threads - before.threads),
            *(f"file {name}" for name in self.files - before.files),
            *(f"temporary {name}" for name in self.temporary - before.temporary),
            *(
                f"another {name}"
                for name, value in before.state.items()
                if self.state.get(name) != value
            ),
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


def _state() -> dict[str, object]:
    """Return what all code of this process shares: the name of each part, and its value. Libraries
    add variables to the environment.
    """
    own = {name: value for name, value in os.environ.items() if name.startswith(OWN)}
    others = os.environ.keys() - own.keys() - {VARIABLE_OF_PYTEST}
    return {f"variable {name}": os.environ[name] for name in sorted(others)} | {
        "set of variables": own,
        "working directory": os.getcwd(),
        "path of modules": tuple(sys.path),
        "locale": locale.setlocale(locale.LC_ALL),
        "answer to an interrupt": signal.getsignal(signal.SIGINT),
        "answer to a termination": signal.getsignal(signal.SIGTERM),
        "errors of NumPy": np.geterr(),
        "print options of NumPy": np.get_printoptions(),
        "level up to which nothing is logged": logging.root.manager.disable,
        "collection of garbage": gc.isenabled(),
    }
