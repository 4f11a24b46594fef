# SPDX-License-Identifier: Apache-2.0
"""Threshold controller of the golden model ("fill the stream"): it shares the capacity of a
stream among its subgroups.

A threshold can only discard events, so it is raised only if a stream cannot carry them all. The
inputs are the counters of the previous frame. They are taken before the FIFOs, so stalls do not
change them. The rule is our choice; the paper has thresholds that differ by subgroup and does
not say how they are found.
"""

import numpy as np

from ..contract.config import Config
from ..contract.parameters import Sensor
from ..contract.settings import BUDGET_GROWTHS, LIMIT_DROP
from .shape import COUNTER


class Controller:
    """Controller from reset on.

    budget: int64[streams], events up to which a subgroup of a stream lowers its threshold;
    limit: int64[streams], events beyond which it raises it. Both are None before the first frame.
    """

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        self.budget: np.ndarray | None = None
        self.limit: np.ndarray | None = None
        self._controlled = np.zeros(sensor.subgroups, bool)  # in the previous frame
        # equivalent (0: one more): a frame ends before anything reads it
        self._counters = np.empty((0, len(COUNTER)), np.int64)
        self._stream = np.array([sensor.stream_of(s) for s in range(sensor.subgroups)])

    def begin(self, config: Config) -> np.ndarray:
        """int64[subgroups]: thresholds of the frame that begins. A newly controlled subgroup
        starts at its programmed one.
        """
        if self.budget is None:
            self.budget = self.limit = config.shares
        stays = config.controlled & self._controlled
        return (
            np.where(stays, self._next(config), config.threshold)
            if stays.any()
            else config.threshold
        )

    def _next(self, config: Config) -> np.ndarray:
        """int64[subgroups]: thresholds one step from the previous frame's, by its counters, the
        budget and the limit after it.
        """
        assert self.budget is not None and self.limit is not None
        column = self._counters.T
        threshold, opened = column[COUNTER.threshold_used], column[COUNTER.opened]
        committed, lower = column[COUNTER.committed], column[COUNTER.lower]
        rises = committed > self.limit[self._stream]
        falls = ~rises & (lower <= self.budget[self._stream])
        # at most THRESHOLD_MAX
        ceiling = 1 + np.searchsorted(config.auto_bounds, opened, side="right")
        floor = max(1, config.frame.threshold_floor)
        return np.maximum(floor, np.minimum(threshold + rises - falls, ceiling))

    def end(self, config: Config, counters: np.ndarray) -> np.ndarray:
        """Take the counters of a frame, int64[subgroups, counters], and return the budgets after
        it.
        """
        assert self.budget is not None and self.limit is not None
        self._controlled, self._counters = config.controlled, counters.copy()
        after = [
            self._after(config, stream, int(budget), int(limit))
            for stream, (budget, limit) in enumerate(zip(self.budget, self.limit, strict=True))
        ]
        self.budget, self.limit = np.array(after, np.int64).T
        return self.budget

    def _after(self, config: Config, stream: int, budget: int, limit: int) -> tuple[int, int]:
        """Return a stream's next budget and limit.

        The budget is the highest of some candidates with which the stream can carry what would
        then be sent. The limit falls only if too much was sent.
        """
        capacity, share = config.capacity, int(config.shares[stream])
        span = self.sensor.stream_subgroups(stream)
        of_stream = slice(span.start, span.stop)
        column, controlled = self._counters[of_stream].T, config.controlled[of_stream]
        # equal at a threshold of 1
        committed, lower = (column[COUNTER.committed], column[COUNTER.lower])
        total, top = (
            int(committed.sum()),
            min(limit, int(committed.max(where=controlled, initial=0))),
        )
        if total > capacity:
            return share, share if total > 2 * capacity else max(share, top - (top >> LIMIT_DROP))
        candidates = [budget, *(budget + (budget >> growth) + 1 for growth in BUDGET_GROWTHS)]
        fitting = share
        for candidate in (max(share, min(candidate, capacity)) for candidate in candidates):
            if np.where(controlled & (lower <= candidate), lower, committed).sum() <= capacity:
                fitting = candidate
        return fitting, max(fitting, top)
