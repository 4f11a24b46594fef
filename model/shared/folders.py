# SPDX-License-Identifier: Apache-2.0
"""Folders of generated files."""

import os
import re
import tempfile
from pathlib import Path

from .errors import InputError


def checkout() -> Path | None:
    """Return the folder of pyproject.toml if the project runs from a checkout, otherwise None."""
    folder = Path(__file__).resolve().parents[2]
    return folder if (folder / "pyproject.toml").exists() else None


def is_plain(path: Path) -> bool:
    """Return whether a path has only characters that make and a shell take as they are; they do
    not take spaces, brackets, or letters outside ASCII.
    """
    return re.fullmatch(r"[\w./+@,-]+", str(path), re.ASCII) is not None


def build_root() -> Path:
    """Return the folder of everything generated. Raises `InputError` if it cannot be written.

    It is `$COINCID_BUILD` if that is set; otherwise `build` beside pyproject.toml in a checkout,
    or `coincid` in the user's cache folder if the project was installed without one, or if the
    checkout's path is not plain.
    """
    if (chosen := os.environ.get("COINCID_BUILD")) is not None:
        root = Path(chosen).absolute()
    elif (folder := checkout()) is not None and is_plain(folder):
        root = folder / "build"
    else:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "coincid"
    try:
        root.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=root).close()
    except OSError as error:
        raise InputError(
            f"build directory {root}: not writable ({error.strerror}); set COINCID_BUILD to one that is"
        ) from None
    return root
