# SPDX-License-Identifier: Apache-2.0
"""When a pixel fires, by the time and the light of its surface, and how likely the sensor notices it.

A pixel that sees a surface at time t with `light` photons per pulse fires at the first of them and is dead from then on.
So the probability that it has fired by time u is

    F(u) = 1 - exp(-light * Phi((u - t) / sigma)).
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import special

from ..shared.compiled import njit

REACH_SIGMAS = 4.0  # from the centre of a pulse to its beginning and end
RARE = 1e-6  # lowest probability: effects that the law does not include happen, too
KEPT = 32  # tables of F, at most: those of the next frame are mostly the same


class Law(NamedTuple):
    """What holds for all events of a subgroup; times in ticks. Arrays over times and lights are flat, by time.

    The times of the grid are numbered from `origin`, the first one that some pixel wants.
    """

    window: int
    told: int  # ticks of the window whose hits are known: all of them, or the first (format short)
    phases: int
    offset: int  # ticks per step of an offset
    reach: int
    step: int
    origin: int
    lights: int
    noise: float  # background photons per tick and pixel
    alive: np.float32  # share of the pulses in which background has not fired the pixel yet
    pulses: int
    heard: np.ndarray  # float32[kinds, times * lights]: chance that a photon makes an event; also that while dropping
    sharp: np.ndarray  # the same: chance that it makes the stamp of an event earlier
    margin: int
    fired: np.ndarray  # of `fired_table`


@lru_cache(KEPT)
def fired_table(
    sigma_ticks: float, reach: int, step: int, span: int, lights: tuple[float, ...]
) -> tuple[int, np.ndarray]:
    """Return a margin, and F for ticks u and times t of a grid: float32[step * columns * lights], by row and column.

    Row r is for ticks u with (u + reach) % step = r. Then F for consecutive times is a contiguous part of the row: its
    column is `margin`, less the number of steps from t to u + reach. `margin` columns to both sides are enough for `span`
    times.
    """
    distance = np.arange(-2 * reach, 2 * reach + 1) / 2
    fired = -np.expm1(-special.ndtr(distance / sigma_ticks)[:, None] * np.array(lights)).astype(np.float32)
    margin = span + 2 * reach // step + 2
    half_ticks = 2 * np.arange(step)[:, None] + step * (2 * (margin - np.arange(2 * margin + span)) - 1)
    return margin, fired[np.clip(half_ticks, 0, 4 * reach)].ravel()


@njit
def chances_to_be_heard(silent, every, origin, span, step, lights, alive):
    """float32[kinds, span * lights]: `Law.heard` or `Law.sharp`; silent: float32[kinds, points], as in `Unheard`."""
    heard = np.empty((len(silent), span * lights), np.float32)
    last = silent.shape[1] - 1
    for k in range(span):
        place = min(max(((origin + k) * step + step // 2 + 0.5) / every - 0.5, 0.0), float(last))
        before = int(place)
        after, part = min(before + 1, last), np.float32(place - before)
        for kind in range(len(silent)):
            share = silent[kind, before] + part * (silent[kind, after] - silent[kind, before])
            for j in range(k * lights, (k + 1) * lights):
                heard[kind, j] = alive * (np.float32(1) - share)
    return heard


@njit(allocates=False)
def reached(law, begin, end, times):
    """Return the times of surfaces whose photons come between two ticks, the first one and the one after the last."""
    k0 = (begin - law.reach) // law.step - law.origin
    k1 = (end + law.reach) // law.step + 1 - law.origin
    return min(times, max(0, k0)), min(times, max(0, k1))


@njit(allocates=False)
def fired_by(law, tick, k0):
    """Return where `law.fired` has F at a tick for the surfaces from time k0 on, and all lights."""
    steps = (tick + law.reach) // law.step
    column = min(max(law.margin - steps + law.origin + k0, 0), 2 * law.margin)
    row = tick + law.reach - steps * law.step
    return row * (len(law.fired) // law.step) + column * law.lights
