# SPDX-License-Identifier: Apache-2.0
"""Optional dependencies: what is missing is told with the command that brings it."""

from collections.abc import Iterator
from contextlib import contextmanager

from .errors import InputError


@contextmanager
def extra(name: str) -> Iterator[None]:
    """For imports of what the extra `name` of pyproject.toml brings. Raises `InputError` where a package is missing."""
    try:
        yield
    except ModuleNotFoundError as missing:
        if str(missing.name).partition(".")[0] == "coincid":  # a mistake of ours
            raise
        raise InputError(f"{missing.name} is not installed; run: pip install 'coincid[{name}]'") from None
