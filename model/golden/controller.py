# SPDX-License-Identifier: Apache-2.0
"""Threshold controller of the golden model ("fill the stream"): it shares the capacity of a stream among its subgroups.

A threshold can only discard events, so it is raised only if a stream cannot carry them all. The inputs are the counters
of the previous frame. They are taken before the FIFOs, so stalls do not change them. The rule is our choice; the paper
has thresholds that differ by subgroup and does not say how they are found.
"""

import numpy as np

from ..contract.config import Config
from ..contract.parameters import Sensor
from .shape import COUNTER

STEP = 16  # in one frame, a budget changes by 1/16 of itself


class Controller:
    """Controller from reset on. budget: int64[streams], events for each subgroup of a stream; None before the first frame."""

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        self.budget: np.ndarray | None = None
        self._controlled = np.zeros(sensor.subgroups, bool)  # in the previous frame
        self._counters = np.empty((0, len(COUNTER)), np.int64)
        self._stream = np.array([sensor.stream_of(s) for s in range(sensor.subgroups)])

    def begin(self, config: Config) -> np.ndarray:
        """int64[subgroups]: thresholds of the frame that begins. A newly controlled subgroup starts at its programmed one."""
        if self.budget is None:
            self.budget = config.shares
        stays = config.controlled & self._controlled
        return np.where(stays, self._next(config), config.threshold) if stays.any() else config.threshold

    def _next(self, config: Config) -> np.ndarray:
        """int64[subgroups]: thresholds one step from the previous frame's, by its counters and the budget after it."""
        assert self.budget is not None
        column = self._counters.T
        threshold, opened = column[COUNTER.threshold_used], column[COUNTER.opened]
        committed, lower = column[COUNTER.committed], column[COUNTER.lower]
        budget = self.budget[self._stream]
        rises = committed > budget
        falls = ~rises & (lower <= budget)
        ceiling = 1 + np.searchsorted(config.auto_bounds, opened, side="right")  # at most THRESHOLD_MAX
        floor = max(1, config.frame["threshold_floor"])
        return np.maximum(floor, np.minimum(threshold + rises - falls, ceiling))

    def end(self, config: Config, counters: np.ndarray) -> np.ndarray:
        """Take the counters of a frame, int64[subgroups, counters], and return the budgets after it."""
        assert self.budget is not None
        self._controlled, self._counters = config.controlled, counters.copy()
        self.budget = np.array(
            [self._budget(config, stream, int(budget)) for stream, budget in enumerate(self.budget)], np.int64
        )
        return self.budget

    def _budget(self, config: Config, stream: int, budget: int) -> int:
        """Return a stream's next budget: less if too much was sent, more if the stream can carry what would then be sent."""
        capacity, span = config.capacity, self.sensor.stream_subgroups(stream)
        of_stream = slice(span.start, span.stop)
        column = self._counters[of_stream].T
        committed, lower = column[COUNTER.committed], column[COUNTER.lower]  # equal at a threshold of 1
        wide = min(budget + budget // STEP + 1, capacity)
        would_fall = config.controlled[of_stream] & (lower <= wide)
        if committed.sum() > capacity:
            return max(budget - budget // STEP, int(config.shares[stream]))
        return wide if np.where(would_fall, lower, committed).sum() <= capacity else budget
