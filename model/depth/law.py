# SPDX-License-Identifier: Apache-2.0
"""What holds for all events of a subgroup, and when its pixels fire.

A pixel that sees a surface at time t with `light` photons per pulse fires at the first of them and
is dead from then on. So the probability that it has fired by time u is

    F(u) = 1 - exp(-light * S(u - t)),

where S is the share of the pulse before a time (`pulse_ticks.py`).
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ..shared.compiled import part
from . import portable
from .pulse_ticks import PulseTicks

RARE = 1e-6  # lowest probability: effects that the law does not include happen, too
KEPT = 32  # tables of F, at most: those of the next frame are mostly the same


class Heard(NamedTuple):
    """Chances that a photon of a surface makes an event, by time and light of a grid (`heard.py`).

    A cut is a tick at which a silence may begin or end.
    """

    mean: np.ndarray  # float32[kinds, times * lights], of any photon; kind 1 is while dropping
    before: np.ndarray  # float32[cuts, columns * lights], it comes before a cut and makes an event
    first: np.ndarray  # int64[cuts], number of the first time in a row of `before`
    cut_at: np.ndarray  # int64[ticks], number of the last cut up to a tick
    lowest: int  # number of the first cut of `before`


class Law(NamedTuple):
    """What holds for all events of a subgroup; times in ticks.

    The times of the grid are numbered from `origin`. In kernels, k0 and k1 are such numbers: the
    first time, and the one after the last. Arrays over times and lights are flat, by time.
    """

    window: int
    mapped: bool  # events have maps; if not, only their winners are known
    phases: int  # ticks per cycle
    offset: int  # ticks per step of an offset
    reach: int  # from the centre of a pulse to its beginning and end
    step: int  # between times of the grid
    origin: int  # number of the first time that some pixel wants
    lights: int  # number of lights
    noise: float  # background photons per tick and pixel
    alive: np.float32  # share of the pulses in which background has not fired the pixel yet
    pulses: int
    heard: Heard
    # float32[kinds, 2, cycles], kind 1 is while dropping: chances that a photon of the cycle before,
    # or before that one, would make the stamp of an event earlier
    sharp: np.ndarray
    margin: int  # of `fired_table`
    fired: np.ndarray  # of `fired_table`


@lru_cache(KEPT)
def fired_table(
    pulse: PulseTicks, reach: int, step: int, span: int, lights: tuple[float, ...]
) -> tuple[int, np.ndarray]:
    """Return a margin, and F for ticks u and times t of a grid: float32[step * columns * lights].

    It is ordered by row and column. Row r is for ticks u with (u + reach) % step = r. Then F for
    consecutive times is a contiguous part of the row: its column is `margin`, less the number of
    steps from t to u + reach. `margin` columns to both sides are enough for `span` times.
    """
    distance = np.arange(-2 * reach, 2 * reach + 1) / 2
    reached_by = pulse.share_before(distance)[:, None]
    fired = -portable.expm1(-reached_by * np.array(lights)).astype(np.float32)
    margin = span + 2 * reach // step + 2
    columns = margin - np.arange(2 * margin + span)
    half_ticks = 2 * np.arange(step)[:, None] + step * (2 * columns - 1)
    return margin, fired[np.clip(half_ticks, 0, 4 * reach)].ravel()


@part
def reached(law: Law, begin: int, end: int, times: int) -> tuple[Any, Any]:
    """Return the times, of so many, of surfaces whose photons come between two ticks: k0 and k1."""
    k0 = (begin - law.reach) // law.step - law.origin
    k1 = (end + law.reach) // law.step + 1 - law.origin
    return min(times, max(0, k0)), min(times, max(0, k1))


@part
def by_tick(law: Law, tick: int, k0: int, k1: int) -> slice:
    """Return where `law.fired` has F at a tick, for surfaces at times k0 to k1 and all lights."""
    steps = (tick + law.reach) // law.step
    column = min(max(law.margin - steps + law.origin + k0, 0), 2 * law.margin)
    row = tick + law.reach - steps * law.step
    begin = row * (len(law.fired) // law.step) + column * law.lights
    return slice(begin, begin + (k1 - k0) * law.lights)
