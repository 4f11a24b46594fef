# SPDX-License-Identifier: Apache-2.0
"""Where generated files go."""

import os
import tempfile
from pathlib import Path

from .errors import InputError


def checkout() -> Path | None:
    """The folder of pyproject.toml where the project runs from a checkout, None where it was installed without one."""
    folder = Path(__file__).resolve().parents[2]
    return folder if (folder / "pyproject.toml").exists() else None


def build_root() -> Path:
    """The directory of everything generated: `$COINCID_BUILD`, else `build` beside pyproject.toml in a checkout, else
    (the project was installed without a checkout) `coincid` in the user's cache directory.

    Raises `InputError` where it cannot be written.
    """
    if (chosen := os.environ.get("COINCID_BUILD")) is not None:
        root = Path(chosen).absolute()
    elif (folder := checkout()) is not None:
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
