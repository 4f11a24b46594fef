# SPDX-License-Identifier: Apache-2.0
"""CPU time of the stages of a long test."""

import os


class Stopwatch:
    """CPU time of this process and of all that it has waited for."""

    def __init__(self):
        self._last = self._now()

    @staticmethod
    def _now() -> float:
        return sum(os.times()[:4])

    def lap(self, name: str) -> None:
        """Print the CPU time since the last lap."""
        now = self._now()
        print(f"CPU time of {name}: {now - self._last:.0f} s", flush=True)
        self._last = now
