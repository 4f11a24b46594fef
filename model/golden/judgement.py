# SPDX-License-Identifier: Apache-2.0
"""Events by a rule of coincidence of a user's own, from all windows that have enough pixels for
it.
"""

import numpy as np

from ..contract.coincidence import Rule
from ..contract.parameters import Sensor
from .front_end import Events
from .shape import COUNTER


def thresholds_of_candidates(rule: Rule, threshold: np.ndarray) -> np.ndarray:
    """int64[subgroups]: pixels of the smallest window that may become an event, at the threshold
    or one below it.
    """
    least = [rule.least(int(value) - 1) if value > 2 else 1 for value in threshold]
    return np.array(least, np.int64)


def judged(
    candidates: Events, sensor: Sensor, threshold: np.ndarray, counters: np.ndarray
) -> Events:
    """Return the candidates that the sensor's rule makes events, and correct the counters of
    windows.

    threshold: int64[subgroups], in force; counters: int64[subgroups, counters].
    """
    bounds = candidates.bounds
    kept = np.zeros(bounds[-1], bool)
    for s in range(sensor.subgroups):
        span = slice(bounds[s], bounds[s + 1])
        maps = _maps(candidates.hits[span], sensor)
        kept[span] = sensor.rule.judged(maps, int(threshold[s]))
        committed = np.count_nonzero(kept[span])
        counters[s, COUNTER.committed] = committed
        counters[s, COUNTER.rejected] = counters[s, COUNTER.opened] - committed
        counters[s, COUNTER.lower] = np.count_nonzero(
            sensor.rule.judged(maps, int(threshold[s]) - 1)
        )
    kept_before = np.concatenate([[0], np.cumsum(kept)])
    return Events(
        bounds=kept_before[bounds],
        row=candidates.row[: len(kept)][kept],
        hits=candidates.hits[: len(kept)][kept],
        offsets=candidates.offsets[: len(kept)][kept],
    )


def _maps(hits: np.ndarray, sensor: Sensor) -> np.ndarray:
    """bool[n, rows, cols]: the pixels of a subgroup that are in each window. hits: uint64[n,
    words].
    """
    bits = np.unpackbits(hits.view(np.uint8), axis=1, bitorder="little", count=sensor.pixels)
    return bits.astype(bool).reshape(-1, *sensor.subgroup)
