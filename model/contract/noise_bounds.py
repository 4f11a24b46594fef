# SPDX-License-Identifier: Apache-2.0
"""Default upper limits of the threshold controller. This is our own choice.

No threshold is higher than is necessary to make commits from noise alone rare. Evenly spread noise opens windows and
fills them by the Poisson law. If a window opens in any phase of a cycle with equal probability, it occupies the tree for
`window_ticks + (phases - 1) / 2` ticks and the re-arm gap on average. It holds as many further photons as arrive during
its length.
"""

from functools import cache

import numpy as np

from .counters import EVENTS_MAX
from .parameters import guard_cycles
from .settings import AUTO_BOUNDS

NOISE_COMMITS_PER_PULSE = 0.25
PHOTONS_PER_TICK = (1e-7, 10.0, 100_000)  # photons per tick of a subgroup: lowest, highest, number of values tried


@cache
def noise_bounds(
    *, phases: int, window_ticks: int, rearm_cycles: int, period_cycles: int, pulses: int
) -> tuple[int, ...]:
    """Return `auto_bounds`. Bound k, from 1, is a number of opened windows per frame.

    If noise alone opens so many windows, it commits `NOISE_COMMITS_PER_PULSE` at threshold k. With more windows, threshold
    k + 1 may be needed.
    """
    per_tick = np.geomspace(*PHOTONS_PER_TICK)
    open_ticks = phases * (period_cycles - guard_cycles(window_ticks, phases, rearm_cycles))
    busy_ticks = window_ticks + (phases - 1) / 2 + phases * rearm_cycles
    opened = pulses * open_ticks / (1 / per_tick + busy_ticks)
    exactly = np.exp(-per_tick * window_ticks)  # probability of exactly `others` further photons in a window
    at_least = np.ones_like(per_tick)
    bounds = []
    for others in range(AUTO_BOUNDS):
        too_many = opened * at_least > NOISE_COMMITS_PER_PULSE * pulses
        bounds.append(int(np.ceil(opened[too_many.argmax()])) if too_many.any() else EVENTS_MAX)
        at_least, exactly = at_least - exactly, exactly * per_tick * window_ticks / (others + 1)
    return tuple(bounds)
