# SPDX-License-Identifier: Apache-2.0
"""Threads that share short pieces of work, of which the caller's own is one."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class Threads:
    """A number of threads (None: one per core), the caller's included: each takes the next item
    as soon as it is free.

    A pool would pass every item on and back, which takes as long as some items do.
    """

    def __init__(self, number: int | None = None):
        self._others = (number or os.cpu_count() or 1) - 1
        self._pool = ThreadPoolExecutor(max(1, self._others))

    def __enter__(self) -> "Threads":
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown()

    def map(self, function: Callable[[_Item], _Result], items: Iterable[_Item]) -> list[_Result]:
        """Return what the function returns for each item."""
        every = list(items)
        results: list[Any] = [None] * len(every)
        left = iter(enumerate(every))

        def work() -> None:
            for k, item in left:
                results[k] = function(item)

        started = [self._pool.submit(work) for _ in range(self._others)]
        try:
            work()
        finally:
            list(left)  # after an error, the other threads begin nothing new
        for future in started:
            if not future.cancel():  # it had no time to begin
                future.result()
        return results
