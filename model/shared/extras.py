# SPDX-License-Identifier: Apache-2.0
"""Optional dependencies: if one is missing, the error names the command that installs it."""

from collections.abc import Iterator
from contextlib import contextmanager

from .errors import InputError


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Context for importing the packages of the extra `name` of pyproject.toml. Raises `InputError` if one is missing."""
    try:
        yield
    except ModuleNotFoundError as missing:
        if str(missing.name).partition(".")[0] == "coincid":  # our own mistake
            raise
        raise InputError(f"{missing.name} is not installed; run: pip install 'coincid[{name}]'") from None
