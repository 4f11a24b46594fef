# SPDX-License-Identifier: Apache-2.0
"""Whether the depth of a pixel is to be believed, and if not, why: one rule for all estimators.

All of this is our own choice. The rule looks at the events that hit a pixel: how many of them fit its depth, how many fit
another one, and how many are to be expected there by chance; and at the depths around it. A logistic law weighs these
signs against what the estimator itself says, so that of all pixels with a confidence of 90 %, 90 % are right.
"""

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from scipy import special

from ..contract.config import Config
from ..shared.compiled import njit
from ..shared.constants import SPEED_OF_LIGHT_M_S
from ..shared.threads import Threads
from . import portable
from .histograms import Events, by_subgroup, is_hit, pixel_image

BELIEVED_MIN = 0.5  # confidence
DOUBTFUL = 0.4  # confidence, at most, of a depth at the gate's edge or beyond the period, or with a rival
LIT = 8.0  # log likelihood ratio to background, from which on the hits at a distance are light: there are hundreds of distances
# Share of the light that makes a second surface, and one from which each of two surfaces may be the pixel's.
OTHER_SHARE, RIVAL_SHARE = 0.2, 0.4
LOST_SHARE = 0.5  # of the committed events of a subgroup
FOLDED, BRIGHT = 40.0, 0.9  # light times squared distance, by which light from beyond the period is below this quantile
REACH_SIGMAS = 3.0  # from the centre of a pulse to its beginning and end
EDGE_SIGMAS = 2.0  # from the gate's edge to a surface that the gate may have cut
SURE_MIN = 2e-3
NOISE_M, MIXED_MIN = 0.004, 0.003  # added before logarithms
OFF_MAX_M, SLOPE_MAX_M = 1.0, 0.5  # from the neighbours, and from subgroup to subgroup: what is more is no slant
LAW = {  # method: weights of `features` and a constant, set by `python -m docs.studies.confidence`
    "maximum": (0.142, 0.301, -2.4, -0.229, 0.00601, 0.0606, -0.587, 0.214, -0.537, -3.83),
    "matched": (0.271, 0.112, -0.294, -0.302, 0.0318, -0.0309, -0.415, 0.0348, -0.688, -5.27),
    "background": (0.228, 0.215, 0.453, -0.307, 0.0528, -0.109, -0.321, -0.0449, -0.65, -5.1),
    "planes": (0.39, 0.865, -1.15, -0.338, 0.137, -0.472, 0.2, -0.871, -0.181, -4.86),
}


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
    Reason.BACKGROUND: "background only: background alone explains its hits",
    Reason.TWO_SURFACES: "two surfaces: more than a fifth of its hits come from another distance",
    Reason.FOLDED: "range folded: its light is so weak that it seems to come from beyond the range",
    Reason.GATE_EDGE: "gate's edge: the gate opens or closes within the pulse",
    Reason.EVENTS_LOST: "events lost: the link dropped most events of its subgroup",
    Reason.FEW_PHOTONS: "few photons: its light fits several distances",
}


class Signs(NamedTuple):
    """What speaks for and against the depth of the pixels, [rows, cols].

    known: there is a depth, and the estimator does not rule it out. features: float64[rows, cols, n], what the law weighs; only
    where `known`. total, near, other: hits: all, those that fit the depth, the most that fit another one. evidence, elsewhere:
    log likelihood ratio to background of `near` and `other`. lost: share of the committed events of the subgroup that did not
    leave the sensor. at_edge: the gate opens or closes within the pulse. folded: see `_folded`.
    """

    known: np.ndarray
    features: np.ndarray
    total: np.ndarray
    near: np.ndarray
    other: np.ndarray
    evidence: np.ndarray
    elsewhere: np.ndarray
    lost: np.ndarray
    at_edge: np.ndarray
    folded: np.ndarray


def believe(signs: Signs, config: Config, method: str) -> tuple[np.ndarray, np.ndarray]:
    """Return (confidence, reason), [rows, cols]: the probability that a depth is right, float64, and its `Reason`, uint8."""
    confidence = np.where(signs.known, chance_of_right(signs.features, LAW[method]), 0.0)
    lit_share = np.where(signs.elsewhere > LIT, signs.other / np.maximum(signs.near + signs.other, 1), 0)
    doubtful = signs.at_edge | signs.folded | (lit_share > RIVAL_SHARE)
    confidence = np.where(doubtful, np.minimum(confidence, DOUBTFUL), confidence)
    conditions = (
        (signs.known & (confidence >= BELIEVED_MIN), Reason.BELIEVED),
        (signs.at_edge, Reason.GATE_EDGE),
        (signs.folded, Reason.FOLDED),
        (lit_share > OTHER_SHARE, Reason.TWO_SURFACES),
        (signs.lost > LOST_SHARE, Reason.EVENTS_LOST),
        (signs.total == 0, Reason.NO_LIGHT),
        (signs.evidence < LIT, Reason.BACKGROUND),
    )
    chosen = np.select([met for met, _ in conditions], [reason for _, reason in conditions], Reason.FEW_PHOTONS)
    return confidence, chosen.astype(np.uint8)


def chance_of_right(features: np.ndarray, weights: Sequence[float]) -> np.ndarray:
    """float64[...]: what the law says of `features`, float64[..., n]. weights: of them, and the constant."""
    *of_features, constant = weights
    return special.expit((features * np.array(of_features)).sum(axis=-1) + constant)


def find_signs(
    events: Events,
    config: Config,
    sigma_ticks: float,
    pulses: int,
    ticks: np.ndarray,
    sure: np.ndarray,
    everywhere: bool,
    threads: Threads,
) -> Signs:
    """Return the signs of first returns.

    pulses: number of pulses in which the events came. ticks, sure: float64[rows, cols], NaN = none; how sure the estimator
    is. everywhere: it takes all events of a subgroup for each of its pixels. The number of threads does not change the
    result.
    """
    sensor, reach = config.sensor, REACH_SIGMAS * sigma_ticks
    time = by_subgroup(ticks, sensor)
    total, near, other = (np.zeros(time.shape, np.int64) for _ in range(3))

    def count(s: int) -> None:
        rows = slice(events.bounds[s], events.bounds[s + 1])
        order = np.argsort(events.stamp[rows], kind="stable")
        first, until = time[s] - reach - events.window[s], time[s] + reach
        span = int(events.window[s] + 2 * reach)
        stamp, hits = events.stamp[rows][order], events.hits[rows][order]
        _count(stamp, hits, everywhere, first, until, span, total[s], near[s], other[s])

    threads.map(count, range(sensor.subgroups))
    start, end = (edge[:, None] for edge in _gates(config))
    by_chance = (events.window[:, None] + 2 * reach) / np.maximum(end - start, 1)  # share of the hits of background
    lost = (events.committed - np.diff(events.bounds)) / np.maximum(events.committed, 1)
    edge_ticks = np.minimum(np.abs(time - start), np.abs(time - end))
    evidence = _evidence(near, (total - near) * by_chance)
    parts = (
        total,
        near,
        other,
        evidence,
        _evidence(other, (total - near - other) * by_chance),
        np.broadcast_to(lost[:, None], time.shape),
        config.gating[:, None] & (edge_ticks <= EDGE_SIGMAS * sigma_ticks),
        _folded(near, time, events.window == 1, pulses) & (evidence >= LIT),
    )
    images = [pixel_image(part, sensor) for part in parts]
    tick_m = config.tick_s * SPEED_OF_LIGHT_M_S / 2
    known = ~np.isnan(ticks) & (sure > 0)
    return Signs(known, _features(ticks * tick_m, sure, images[1], images[2], sensor.subgroup), *images)


def _features(
    depth_m: np.ndarray, sure: np.ndarray, near: np.ndarray, other: np.ndarray, subgroup: tuple[int, int]
) -> np.ndarray:
    """float64[rows, cols, 9]: what the law weighs.

    Of the pixel: how sure the estimator is, its hits, the share of those at another distance, how far it is from its
    neighbours' median, and the slope from subgroup to subgroup. Of the picture: the means of the last four.
    """
    known = ~np.isnan(depth_m)
    if not known.any():
        return np.zeros((*depth_m.shape, len(LAW["planes"]) - 1))
    share = other / (near + other + 1)
    around_m = _around(depth_m, [(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if r or c])
    around_m = np.sort(np.where(np.isnan(around_m), depth_m, around_m), axis=0)
    off_m = np.abs(depth_m - (around_m[3] + around_m[4]) / 2)
    high, wide = subgroup
    up_m, down_m, left_m, right_m = np.abs(_around(depth_m, [(-high, 0), (high, 0), (0, -wide), (0, wide)]) - depth_m)
    sides_m = np.stack([np.fmin(up_m, down_m), np.fmin(left_m, right_m)])  # across an edge only one side is far
    slope_m = np.where(sides_m < SLOPE_MAX_M, sides_m, 0).max(axis=0)
    hits = portable.log1p(near)
    off = portable.log(NOISE_M + np.fmin(off_m, OFF_MAX_M))
    slope = portable.log(NOISE_M + slope_m)
    means = (
        hits[known].mean(),
        portable.log(MIXED_MIN + (share[known] > OTHER_SHARE).mean()),
        off[known].mean(),
        slope[known].mean(),
    )
    own = [special.logit(np.clip(sure, SURE_MIN, 1 - SURE_MIN)), hits, share, off, slope]
    return np.nan_to_num(np.stack([*own, *(np.full(depth_m.shape, mean) for mean in means)], axis=2))


def _around(image: np.ndarray, steps: Sequence[tuple[int, int]]) -> np.ndarray:
    """float64[steps, rows, cols]: `image` as it is a step of (rows, cols) away; NaN outside."""
    rows, cols = image.shape
    high, wide = (max(abs(step[axis]) for step in steps) for axis in (0, 1))
    padded = np.pad(image, ((high, high), (wide, wide)), constant_values=np.nan)
    return np.stack([padded[high + r : high + r + rows, wide + c : wide + c + cols] for r, c in steps])


def _gates(config: Config) -> tuple[np.ndarray, np.ndarray]:
    """float64[subgroups] each: first tick in which a window may open in any pulse, and the one after the last."""
    sensor, frame = config.sensor, config.frame
    last = config.period - sensor.guard
    moved = frame.gate_step * (frame.gate_steps - 1) if frame.gate_every else 0
    start = np.where(config.gating, config.gate_start, 0)
    end = np.where(config.gating, config.gate_start + config.gate_len + moved, last)
    return np.minimum(start, last) * float(sensor.phases), np.minimum(end, last) * float(sensor.phases)


def _evidence(seen: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """float64: Poisson log likelihood ratio of more than `expected` hits, 0 if there are no more."""
    expected = np.maximum(expected, 1e-3)
    more = np.maximum(seen, expected)
    return more * portable.log(more / expected) - more + expected


def _folded(near: np.ndarray, time: np.ndarray, alone: np.ndarray, pulses: int) -> np.ndarray:
    """bool[subgroups, pixels]: much darker than the picture's bright surfaces would be at the pixel's distance.

    Light that comes from beyond the laser period's range is as weak as its true distance makes it. alone: bool[subgroups], an
    event holds one pixel, so that a bright pixel takes those of the others.
    """
    known = ~np.isnan(time) & (near > 0)
    if not known.any():
        return known
    fired = np.where(alone[:, None], near.sum(axis=1, keepdims=True), near) / pulses
    fired = np.clip(fired, 0.5 / pulses, 1 - 0.5 / pulses)
    pile_up = -portable.log1p(-fired) / fired
    light, most = (hits / pulses * pile_up * np.nan_to_num(time) ** 2 for hits in (near, near + 2 * np.sqrt(near) + 2))
    return known & (near < np.quantile(near[known], BRIGHT)) & (most * FOLDED < np.quantile(light[known], BRIGHT))


@njit
def _count(stamp, hits, everywhere, first, until, span, total, near, other):
    """Count each pixel's hits: all, those with `first` < stamp <= `until`, and the most of the others within `span` ticks.

    stamp: ascending.
    """
    outside = np.empty(len(stamp), np.int64)
    for i in range(len(total)):
        number = begin = 0
        for e in range(len(stamp)):
            if not (everywhere or is_hit(hits, e, i)):
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
