# SPDX-License-Identifier: Apache-2.0
"""How likely a photon of a surface makes an event, for each time and light of a grid.

`unheard.py` has this chance by the tick of the photon. It differs within a pulse: an early photon has
most of the light of other pixels before it, and a late one may find the tree armed again with hardly
any light left. So what a silence tells of a surface follows from the part of the pulse that falls into
it.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..contract.config import Config
from ..shared.compiled import njit, part
from .clusters import NEVER, quiet_ticks
from .law import RARE, Heard, Law, by_tick, reached

EVER = -NEVER  # a tick long after any other
# A silence begins and ends at most so many reaches of the pulse from a surface of which it tells.
FAR_REACHES = 3
KEPT = 8  # lists of cuts, at most: one for each window


def nothing_heard() -> Heard:
    """Return chances for a law of which they are not known yet."""
    chances = np.empty((0, 0), np.float32)
    numbers = np.empty(0, np.int64)
    return Heard(mean=chances, before=chances, first=numbers, cut_at=numbers, lowest=0)


def heard_in(law: Law, missed: np.ndarray, every: int, span: int, config: Config) -> Heard:
    """Return the chances for so many times of a grid.

    missed: float32[kinds, points], of `Unheard`, a point for every `every` ticks. law: without these
    chances.
    """
    sensor = config.sensor
    kinds, points = missed.shape
    cuts = _cuts(law.window, sensor.phases, sensor.rearm, config.period, points, every)
    far = FAR_REACHES * law.reach
    wanted = law.origin * law.step - far, (law.origin + span) * law.step + far
    low, high = np.searchsorted(cuts.ticks, wanted)
    low = max(0, int(low) - 1)
    ticks = cuts.ticks[low : high + 1]
    columns = 2 * (far // law.step + 1)
    heard = Heard(
        mean=np.zeros((kinds, span * law.lights), np.float32),
        before=np.zeros((len(ticks), columns * law.lights), np.float32),
        first=(ticks - far) // law.step - law.origin,
        cut_at=cuts.at,
        lowest=low,
    )
    _fill_heard(law, missed, every, cuts.parts, ticks, heard)
    return heard


class _Cuts(NamedTuple):
    """Ticks at which a silence may begin or end; see `SubgroupEvents`."""

    ticks: np.ndarray  # int64[n]
    at: np.ndarray  # int64[period ticks], index of the last one up to a tick
    parts: np.ndarray  # int64[m + 1], of `_fill_heard`


@lru_cache(KEPT)
def _cuts(window: int, phases: int, rearm: int, period: int, points: int, every: int) -> _Cuts:
    """Return the cuts of a subgroup with a window. points, every: of `missed` of `heard_in`."""
    begins = np.arange(period + 1) * phases
    quiet = quiet_ticks(begins, window, phases, rearm)
    ticks = np.union1d(begins, quiet[quiet > 0])
    end = points * every
    return _Cuts(
        ticks=ticks,
        at=np.searchsorted(ticks, np.arange(end), "right") - 1,
        parts=np.union1d(ticks[ticks < end], np.arange(points + 1) * every),
    )


@njit(error_model="numpy")
def _fill_heard(
    law: Law, missed: np.ndarray, every: int, parts: np.ndarray, cuts: np.ndarray, heard: Heard
) -> None:
    """Compute `mean` and `before` of `heard`, which are 0.

    parts: int64[n + 1], ticks at which a part of the period begins, and the end of the last one. A
    part has no cut and no two points of `missed` within it.
    """
    lights = law.lights
    length = heard.mean.shape[1]
    span = length // lights
    fired = np.zeros(length, np.float32)
    cut = 0
    last = len(parts) - 2
    for n in range(last + 1):
        begin = parts[n]
        end = parts[n + 1]
        while cut < len(cuts) and cuts[cut] <= begin:
            _copy(heard.mean[0], heard.first[cut] * lights, heard.before[cut])
            cut += 1
        k0, k1 = reached(law, begin, end, span)
        if k0 >= k1:
            continue
        by_begin = law.fired[by_tick(law, begin if n else NEVER, k0, k1)]
        by_end = law.fired[by_tick(law, end if n < last else EVER, k0, k1)]
        here = slice(k0 * lights, k1 * lights)
        reaches = fired[here]
        for j in range(len(reaches)):
            reaches[j] += by_end[j] - by_begin[j]
        for kind in range(len(missed)):
            chance = law.alive * (np.float32(1) - missed[kind, begin // every])
            line = heard.mean[kind, here]
            for j in range(len(line)):
                line[j] += chance * (by_end[j] - by_begin[j])
    for rest in range(cut, len(cuts)):
        _copy(heard.mean[0], heard.first[rest] * lights, heard.before[rest])
    for kind in range(len(missed)):
        for j in range(length):
            heard.mean[kind, j] /= max(fired[j], np.float32(RARE))


@part
def _copy(values: np.ndarray, first: int, row: np.ndarray) -> None:
    """Copy those values to a row that there are, from one on."""
    low = max(0, -first)
    high = min(len(row), len(values) - first)
    for j in range(low, high):
        row[j] = values[first + j]


@part
def add_heard(law: Law, begin: int, end: int, chance: np.ndarray, k0: int, k1: int) -> None:
    """Add the chance that a photon between two ticks makes an event, for times k0 to k1.

    chance: float32[times * lights]. begin may be `NEVER`, and end may be `EVER`.
    """
    low, high = reached(law, begin, end, k1)
    low = max(low, k0)
    if low >= high:
        return
    if end == EVER:
        here = slice(low * law.lights, high * law.lights)
        ever = law.fired[by_tick(law, EVER, low, high)]
        mean = law.heard.mean[0, here]
        total = chance[here]
        for j in range(len(total)):
            total[j] += mean[j] * ever[j]
    else:
        _add_before(law, end, np.float32(1), chance, low, high)
    if begin != NEVER:
        _add_before(law, begin, np.float32(-1), chance, low, high)


@part
def _add_before(
    law: Law, tick: int, sign: np.float32, chance: np.ndarray, k0: int, k1: int
) -> None:
    """Add or subtract the chance that a photon before a tick makes an event."""
    heard = law.heard
    cut = heard.cut_at[min(tick, len(heard.cut_at) - 1)] - heard.lowest
    cut = min(len(heard.first) - 1, max(0, cut))
    first = heard.first[cut]
    row = heard.before[cut]
    low = max(k0, first) * law.lights
    high = min(k1 * law.lights, first * law.lights + len(row))
    if low < high:
        total = chance[low:high]
        own = row[low - first * law.lights : high - first * law.lights]
        for j in range(len(total)):
            total[j] += sign * own[j]
