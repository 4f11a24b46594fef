# SPDX-License-Identifier: Apache-2.0
"""Whether the depth of a pixel is to be believed, and if not, why: one rule for all estimators.

All of this is our own choice. The rule looks at the events that hit a pixel: how many of them fit its depth, how many fit
another one, and how many are to be expected there by chance.
"""

from enum import IntEnum

import numpy as np

from ..contract.config import Config
from ..contract.packet import BEAT_BITS
from ..shared.compiled import njit
from .histograms import Events, by_subgroup, pixel_image

BELIEVED_MIN = 0.5  # confidence
LIT = 3.0  # log likelihood ratio to background, from which on a pixel's hits at its depth are light
OTHER, OTHER_SHARE = 8.0, 0.2  # the same for hits elsewhere, and their share of the light, that make a second surface
LOST_SHARE = 0.5  # of the committed events of a subgroup
FOLDED = 40.0  # light times squared distance, by which a pixel must be below the median to come from beyond the period
REACH_SIGMAS = 3.0  # from the centre of a pulse to its beginning and end


class Reason(IntEnum):
    """Why a depth is not to be believed; `BELIEVED`: it is."""

    BELIEVED = 0
    NO_LIGHT = 1
    BACKGROUND = 2
    TWO_SURFACES = 3
    FOLDED = 4
    GATE_EDGE = 5
    EVENTS_LOST = 6
    FEW_PHOTONS = 7


SENTENCES = {
    Reason.BELIEVED: "more likely right than wrong",
    Reason.NO_LIGHT: "no light: the pixel is in no event",
    Reason.BACKGROUND: "background only: its hits are no more than chance brings together",
    Reason.TWO_SURFACES: "two surfaces: a good part of its light comes from another distance",
    Reason.FOLDED: "range folded: so dark that its light seems to come from beyond the laser period",
    Reason.GATE_EDGE: "gate's edge: the gate opens or closes within the pulse",
    Reason.EVENTS_LOST: "events lost: the link dropped most events of its subgroup",
    Reason.FEW_PHOTONS: "few photons: its light fits several distances",
}


def reasons(
    events: Events,
    config: Config,
    sigma_ticks: float,
    pulses: int,
    ticks: np.ndarray,
    confidence: np.ndarray,
    everywhere: bool = False,
) -> np.ndarray:
    """Return the `Reason` of each pixel, uint8[rows, cols].

    pulses: number of pulses in which the events came. ticks, confidence: float64[rows, cols], first return; NaN = no depth.
    everywhere: the estimator takes all events of a subgroup for each of its pixels.
    """
    sensor = config.sensor
    time, sure = by_subgroup(ticks, sensor), by_subgroup(confidence, sensor)
    reach = REACH_SIGMAS * sigma_ticks
    total, near, other = (np.zeros(time.shape, np.int64) for _ in range(3))
    for s in range(sensor.subgroups):
        rows = slice(events.bounds[s], events.bounds[s + 1])
        order = np.argsort(events.stamp[rows], kind="stable")
        first, until = time[s] - reach - events.window[s], time[s] + reach
        span = int(events.window[s] + 2 * reach)
        stamp, hits = events.stamp[rows][order], events.hits[rows][order]
        _count(stamp, hits, everywhere, first, until, span, total[s], near[s], other[s])
    span_ticks = (events.window + 2 * reach)[:, None]
    start, end = _gates(config)
    rest = np.maximum(end - start, 1)[:, None]
    evidence = _evidence(near, (total - near) * span_ticks / rest)
    elsewhere = _evidence(other, (total - near - other) * span_ticks / rest)
    stored = np.diff(events.bounds)
    lost = stored < (1 - LOST_SHARE) * events.committed
    gating = config.gating[:, None]
    at_edge = np.minimum(np.abs(time - start[:, None]), np.abs(time - end[:, None])) <= reach
    conditions = (
        (~np.isnan(time) & (sure >= BELIEVED_MIN), Reason.BELIEVED),
        (gating & at_edge, Reason.GATE_EDGE),
        (_folded(near, time, pulses), Reason.FOLDED),
        ((elsewhere > OTHER) & (other > OTHER_SHARE * (near + other)), Reason.TWO_SURFACES),
        (np.broadcast_to(lost[:, None], time.shape), Reason.EVENTS_LOST),
        (total == 0, Reason.NO_LIGHT),
        (np.isnan(time) | (evidence < LIT), Reason.BACKGROUND),
    )
    chosen = np.select([met for met, _ in conditions], [reason for _, reason in conditions], Reason.FEW_PHOTONS)
    return pixel_image(chosen.astype(np.uint8), sensor)


def _gates(config: Config) -> tuple[np.ndarray, np.ndarray]:
    """float64[subgroups] each: first tick in which a window may open in any pulse, and the one after the last."""
    sensor, frame = config.sensor, config.frame
    last = config.period - sensor.guard
    moved = frame["gate_step"] * (frame["gate_steps"] - 1) if frame["gate_every"] else 0
    start = np.where(config.gating, config.gate_start, 0)
    end = np.where(config.gating, config.gate_start + config.gate_len + moved, last)
    return np.minimum(start, last) * float(sensor.phases), np.minimum(end, last) * float(sensor.phases)


def _evidence(seen: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """float64: Poisson log likelihood ratio of more than `expected` hits, 0 if there are no more."""
    expected = np.maximum(expected, 1e-3)
    more = np.maximum(seen, expected)
    return more * np.log(more / expected) - more + expected


def _folded(near: np.ndarray, time: np.ndarray, pulses: int) -> np.ndarray:
    """bool[subgroups, pixels]: much darker than the picture's surfaces would be at the pixel's distance.

    Light that comes from beyond the laser period's range is as weak as its true distance makes it.
    """
    brightest = (near + 2 * np.sqrt(near) + 2) / pulses
    known = ~np.isnan(time) & (near > 0)
    if not known.any():
        return np.zeros(time.shape, bool)
    usual, usual_hits = np.median((near / pulses * time**2)[known]), np.median(near[known])
    return known & (near < usual_hits) & (brightest * np.nan_to_num(time) ** 2 * FOLDED < usual)


@njit
def _count(stamp, hits, everywhere, first, until, span, total, near, other):
    """Count each pixel's hits: all, those with `first` < stamp <= `until`, and the most of the others within `span` ticks.

    stamp: ascending.
    """
    outside = np.empty(len(stamp), np.int64)
    for i in range(len(total)):
        word, bit = i // BEAT_BITS, np.uint64(i % BEAT_BITS)
        number = begin = 0
        for e in range(len(stamp)):
            if not (everywhere or hits[e, word] >> bit & np.uint64(1)):
                continue
            total[i] += 1
            if first[i] < stamp[e] <= until[i]:
                near[i] += 1
                continue
            outside[number] = stamp[e]
            number += 1
            while outside[begin] <= stamp[e] - span:
                begin += 1
            other[i] = max(other[i], number - begin)
