# SPDX-License-Identifier: Apache-2.0
"""Records which files of the project a program reads, in this process and in all that it starts.

`docs/pages.py` puts this folder into the search path of the program. Python then imports this
file in each process before anything else. The file names go into $COINCID_READ, one per line, as
soon as a file is opened.
"""

import os
import sys

ROOT = os.path.realpath(os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", ".."))
# Functions that read whole packages to name a build; they do not use the contents.
DIGESTS = {"packages_digest"}
SKIPPED = ("build", ".venv", ".git")


def watch() -> None:
    handle = os.open(os.environ["COINCID_READ"], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    seen: set[str] = set()

    def look(event: str, arguments: tuple[object, ...]) -> None:
        if event != "open" or not isinstance(arguments[0], str) or arguments[0] in seen:
            return
        name, mode, flags = arguments
        if isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR):
            return
        path = os.path.realpath(name)
        inner = os.path.relpath(path, ROOT)
        if inner.startswith(("..", *SKIPPED)) or not os.path.isfile(path) or _for_a_digest():
            return  # no folder, and no name in a folder elsewhere, as `shutil.rmtree` opens it
        seen.add(name)
        os.write(handle, f"{inner}\n".encode())

    sys.addaudithook(look)


def _for_a_digest() -> bool:
    frame = sys._getframe()
    while frame is not None:
        if frame.f_code.co_name in DIGESTS:
            return True
        frame = frame.f_back
    return False


if "COINCID_READ" in os.environ:
    watch()
