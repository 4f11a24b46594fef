# SPDX-License-Identifier: Apache-2.0
"""Default upper limits of the threshold controller. This is our own choice.

No threshold is higher than is necessary to make commits from noise alone rare. Evenly spread
noise opens windows and fills them by the Poisson law. If a window opens in any phase of a cycle
with equal probability, it occupies the tree for `window_ticks + (phases - 1) / 2` ticks and the
re-arm gap on average. It holds as many further photons as arrive during its length.
"""

from functools import cache

import numpy as np

from .coincidence import event_share, rises
from .counters import EVENTS_MAX
from .parameters import Sensor, guard_cycles
from .settings import AUTO_BOUNDS

# A link that is somewhat overfull drops events evenly, which costs fewer pixels than a threshold that
# leaves out signal: docs/controller.md has both, over rooms.
NOISE_COMMITS_PER_PULSE = 4
# photons per tick of a subgroup: lowest, highest, number of values tried
PHOTONS_PER_TICK = (1e-7, 10.0, 100_000)


@cache
def noise_bounds(
    sensor: Sensor, *, window_ticks: int, period_cycles: int, pulses: int
) -> tuple[int, ...]:
    """Return `auto_bounds`. Bound k, from 1, is a number of opened windows per frame.

    If noise alone opens so many windows, it commits `NOISE_COMMITS_PER_PULSE` at threshold k.
    With more windows, threshold k + 1 may be needed.
    """
    phases = sensor.phases
    laws = [
        rises(sensor.rule, sensor.subgroup, threshold) for threshold in range(1, AUTO_BOUNDS + 1)
    ]
    per_tick = np.geomspace(*PHOTONS_PER_TICK)
    open_ticks = phases * (period_cycles - guard_cycles(window_ticks, phases, sensor.rearm))
    busy_ticks = window_ticks + (phases - 1) / 2 + phases * sensor.rearm
    opened = pulses * open_ticks / (1 / per_tick + busy_ticks)
    most = max(law[-1].pixels for law in laws)
    further = _further(per_tick, window_ticks, most)
    bounds = []
    for law in laws:
        too_many = (
            opened * event_share(law, lambda pixels: further[pixels - 1])
            > NOISE_COMMITS_PER_PULSE * pulses
        )
        bounds.append(int(np.ceil(opened[too_many.argmax()])) if too_many.any() else EVENTS_MAX)
    return tuple(bounds)


def _further(per_tick: np.ndarray, window_ticks: int, most: int) -> list[np.ndarray]:
    """Return the probabilities of at least 0, 1 ... `most` - 1 further photons in a window."""
    exactly = np.exp(-per_tick * window_ticks)  # probability of exactly `others` further photons
    at_least = np.ones_like(per_tick)
    found = []
    for others in range(most):
        found.append(at_least)
        at_least = at_least - exactly
        exactly = exactly * per_tick * window_ticks / (others + 1)
    return found
