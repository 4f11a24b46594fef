# SPDX-License-Identifier: Apache-2.0
"""The latest result of a function, for results of which two do not fit into memory."""

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Result = TypeVar("Result")


class Latest(Generic[Result]):
    """Keeps one result, and forgets it before another is made."""

    def __init__(self) -> None:
        self._kept: dict[Hashable, Result] = {}

    def get(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """Return the result under `key`; make it if it is not the one that is kept."""
        kept = self._kept.get(key)
        if kept is not None:
            return kept
        self._kept = {}
        made = make()
        self._kept = {key: made}
        return made

    def forget(self) -> None:
        """Keep nothing."""
        self._kept = {}
