# SPDX-License-Identifier: Apache-2.0
"""Whether the depth of a pixel is to be believed, and if not, why: one rule for all estimators.

All of this is our own choice. The rule looks at the events that hit a pixel: how many of them fit
its depth, how many fit another one, and how many are to be expected there by chance; and at the
depths around it. A logistic law weighs these signs against what the estimator itself says, so that
of all pixels with a confidence of 90 %, 90 % are right.
"""

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from scipy import special

from ..contract.config import Config
from ..contract.counts import CYCLES_MAX
from ..shared.compiled import njit
from ..shared.threads import Threads
from . import portable
from .gates import gate_moves
from .histograms import Events, by_subgroup, is_hit, pixel_image

BELIEVED_MIN = 0.5  # confidence
DOUBTFUL = (
    0.4  # confidence, at most, of a depth at the gate's edge or beyond the period, or with a rival
)
LIT = 8.0  # log likelihood ratio to background, from which on the hits at a distance are light
OTHER_SHARE = 0.2  # of the light: more makes a second surface,
RIVAL_SHARE = 0.4  # and of more, either surface may be the pixel's
LOST_SHARE = 0.5  # of the committed events of a subgroup
# Light from beyond the period: times the squared distance, it is so many times below this quantile.
FOLDED = 40.0
BRIGHT = 0.9
REACH_SIGMAS = 3.0  # from the centre of a pulse to its beginning and end
EDGE_SIGMAS = 2.0  # from the gate's edge to a surface that the gate may have cut
SURE_MIN = 2e-3
NOISE_M = 0.004  # added to distances before logarithms,
MIXED_MIN = 0.003  # and to shares
OFF_MAX_M = 1.0  # from the neighbours: what is more is no slant
SLOPE_MAX_M = 0.5  # from subgroup to subgroup: what is more is no slant
LAW = {  # method: weights of `features` and a constant, set by `python -m docs.studies.confidence`
    "maximum": (0.142, 0.301, -2.4, -0.229, 0.00601, 0.0606, -0.587, 0.214, -0.537, -3.83),
    "matched": (0.271, 0.112, -0.294, -0.302, 0.0318, -0.0309, -0.415, 0.0348, -0.688, -5.27),
    "background": (0.228, 0.215, 0.453, -0.307, 0.0528, -0.109, -0.321, -0.0449, -0.65, -5.1),
    "planes": (0.353, 1.62, -0.161, -0.329, 0.156, 0.088, 0.382, -0.994, -0.146, -5.71),
    # of `planes` in the format counts, set by `python -m docs.studies.count_confidence`
    "counts": (0.305, 1.39, -1.65, -0.513, 0.147, -0.528, 0.0821, -0.484, -0.0848, -2.99),
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
    Reason.NO_LIGHT: "no light: no hit of the pixel left the sensor",
    Reason.BACKGROUND: "background only: background alone explains its hits",
    Reason.TWO_SURFACES: "two surfaces: more than a fifth of its hits come from another distance",
    Reason.FOLDED: "range folded: its light is so weak that it seems to come from beyond the range",
    Reason.GATE_EDGE: "gate's edge: the gate opens or closes within the pulse",
    Reason.EVENTS_LOST: "events lost: the link dropped most events of its subgroup",
    Reason.FEW_PHOTONS: "few photons: its light fits several distances",
}


class Signs(NamedTuple):
    """What speaks for and against the depth of the pixels, [rows, cols]."""

    known: np.ndarray  # bool: there is a depth, and the estimator does not rule it out
    features: np.ndarray  # float64[rows, cols, n], what the law weighs; only where `known`
    total: np.ndarray  # int64, hits
    near: np.ndarray  # int64, hits that fit the depth
    other: np.ndarray  # int64, the most hits that fit another depth
    evidence: np.ndarray  # float64, log likelihood ratio of `near` to background
    elsewhere: np.ndarray  # float64, log likelihood ratio of `other` to background
    lost: np.ndarray  # float64, share of the subgroup's events that did not leave the sensor
    at_edge: np.ndarray  # bool: the gate opens or closes within the pulse
    folded: np.ndarray  # bool, of `_folded`
    # float64: probability that the sensor's words have light of the pixel's surface at all
    seen: np.ndarray


def believe(signs: Signs, method: str) -> tuple[np.ndarray, np.ndarray]:
    """Return (confidence, reason), [rows, cols].

    confidence: float64, the probability that a depth is right. reason: uint8, its `Reason`.
    """
    right = signs.seen * chance_of_right(signs.features, LAW[method])
    confidence = np.where(signs.known, right, 0.0)
    other_share = signs.other / np.maximum(signs.near + signs.other, 1)
    lit_share = np.where(signs.elsewhere > LIT, other_share, 0)
    doubtful = signs.at_edge | signs.folded | (lit_share > RIVAL_SHARE)
    confidence = np.where(doubtful, np.minimum(confidence, DOUBTFUL), confidence)
    # The last one that is set holds.
    reason = np.full(confidence.shape, Reason.FEW_PHOTONS, np.uint8)
    reason[signs.evidence < LIT] = Reason.BACKGROUND
    reason[signs.total == 0] = Reason.NO_LIGHT
    reason[signs.lost > LOST_SHARE] = Reason.EVENTS_LOST
    reason[lit_share > OTHER_SHARE] = Reason.TWO_SURFACES
    reason[signs.folded] = Reason.FOLDED
    reason[signs.at_edge] = Reason.GATE_EDGE
    reason[signs.known & (confidence >= BELIEVED_MIN)] = Reason.BELIEVED
    return confidence, reason


def chance_of_right(features: np.ndarray, weights: Sequence[float]) -> np.ndarray:
    """float64[...]: the law's probability for `features`, float64[..., n].

    weights: theirs, and the constant.
    """
    *of_features, constant = weights
    return special.expit((features * np.array(of_features)).sum(axis=-1) + constant)


class Hits(NamedTuple):
    """Hits of the pixels, int64[subgroups, pixels]."""

    total: np.ndarray  # all of them
    near: np.ndarray  # those that fit the pixel's depth
    other: np.ndarray  # the most that fit another depth


class Lit(NamedTuple):
    """How bright the pixels look, [subgroups, pixels]."""

    near: np.ndarray  # hits that fit the pixel's depth, of all pulses
    fired: np.ndarray  # float64, share of the pulses in which such a hit is, or prevents one
    pulses: int


class ByChance(NamedTuple):
    """Hits of background to be expected, float64[subgroups, pixels]."""

    near: np.ndarray
    other: np.ndarray


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
    """Return the signs of first returns in events.

    pulses: number of pulses in which the events came. ticks, sure: float64[rows, cols], NaN = none;
    how sure the estimator is. everywhere: it takes all events of a subgroup for each of its pixels.
    The number of threads does not change the result.
    """
    sensor = config.sensor
    reach = REACH_SIGMAS * sigma_ticks
    time = by_subgroup(ticks, sensor)
    hits = Hits(
        total=np.zeros(time.shape, np.int64),
        near=np.zeros(time.shape, np.int64),
        other=np.zeros(time.shape, np.int64),
    )
    threads.map(
        lambda s: _count_hits(events, s, time[s], reach, everywhere, hits), range(sensor.subgroups)
    )
    gate_from, gate_to = _gates(config)
    # Share of the hits of background that fit a depth.
    share = (events.window + 2 * reach) / np.maximum(gate_to - gate_from, 1)
    not_near = hits.total - hits.near
    by_chance = ByChance(not_near * share[:, None], (not_near - hits.other) * share[:, None])
    lost = (events.committed - np.diff(events.bounds)) / np.maximum(events.committed, 1)
    near = hits.near
    alone = (events.window == 1)[
        :, None
    ]  # an event holds one pixel: a bright one takes the others'
    fired = np.where(alone, near.sum(axis=1, keepdims=True), near) / pulses
    lit = Lit(near, fired, pulses)
    return signs_of(hits, by_chance, lit, lost, config, sigma_ticks, ticks, sure)


def signs_of(
    hits: Hits,
    by_chance: ByChance,
    lit: Lit,
    lost: np.ndarray,
    config: Config,
    sigma_ticks: float,
    ticks: np.ndarray,
    sure: np.ndarray,
) -> Signs:
    """Return the signs of first returns with these hits.

    lost: float64[subgroups], share of the events that did not leave the sensor. ticks, sure: as in
    `find_signs`.
    """
    sensor = config.sensor
    time = by_subgroup(ticks, sensor)
    gate_from, gate_to = _gates(config)
    evidence = _evidence(hits.near, by_chance.near)
    elsewhere = _evidence(hits.other, by_chance.other)
    edge_ticks = np.minimum(np.abs(time - gate_from[:, None]), np.abs(time - gate_to[:, None]))
    at_edge = config.gating[:, None] & (edge_ticks <= EDGE_SIGMAS * sigma_ticks)
    folded = _folded(lit, time) & (evidence >= LIT)
    near = pixel_image(hits.near, sensor)
    other = pixel_image(hits.other, sensor)
    depth_m = ticks * config.tick_m
    return Signs(
        known=~np.isnan(ticks) & (sure > 0),
        features=_features(depth_m, sure, near, other, sensor.subgroup),
        total=pixel_image(hits.total, sensor),
        near=near,
        other=other,
        evidence=pixel_image(evidence, sensor),
        elsewhere=pixel_image(elsewhere, sensor),
        lost=pixel_image(np.broadcast_to(lost[:, None], time.shape), sensor),
        at_edge=pixel_image(at_edge, sensor),
        folded=pixel_image(folded, sensor),
        seen=np.ones(ticks.shape),
    )


class _Sought(NamedTuple):
    """Which hits of a subgroup's pixels fit their depths, and how many fit another one; ticks."""

    everywhere: bool  # each event hits each pixel
    first: np.ndarray  # float64[pixels]: stamps after it
    until: np.ndarray  # float64[pixels]: and not after it fit the pixel's depth
    span: int  # stamps within so many ticks fit one depth


def _count_hits(
    events: Events, s: int, time: np.ndarray, reach: float, everywhere: bool, hits: Hits
) -> None:
    """Count the hits of the pixels of subgroup s.

    time: float64[pixels], ticks; reach: of a pulse.
    """
    rows = slice(events.bounds[s], events.bounds[s + 1])
    order = np.argsort(events.stamp[rows], kind="stable")
    window = events.window[s]
    sought = _Sought(
        everywhere=everywhere,
        first=time - reach - window,
        until=time + reach,
        span=int(window + 2 * reach),
    )
    own = Hits(hits.total[s], hits.near[s], hits.other[s])
    _count(events.stamp[rows][order], events.hits[rows][order], sought, own)


def _features(
    depth_m: np.ndarray,
    sure: np.ndarray,
    near: np.ndarray,
    other: np.ndarray,
    subgroup: tuple[int, int],
) -> np.ndarray:
    """float64[rows, cols, 9]: what the law weighs.

    Of the pixel: how sure the estimator is, its hits, the share of those at another distance, how
    far it is from its neighbours' median, and the slope from subgroup to subgroup. Of the picture:
    the means of the last four.
    """
    known = ~np.isnan(depth_m)
    if not known.any():
        return np.zeros((*depth_m.shape, len(LAW["planes"]) - 1))
    chance = special.logit(np.clip(sure, SURE_MIN, 1 - SURE_MIN))
    hits = portable.log1p(near)
    share = other / (near + other + 1)
    off = portable.log(NOISE_M + np.fmin(_off_neighbours_m(depth_m), OFF_MAX_M))
    slope = portable.log(NOISE_M + _slope_m(depth_m, subgroup))
    mean_hits = hits[known].mean()
    mixed = portable.log(MIXED_MIN + (share[known] > OTHER_SHARE).mean())
    mean_off = off[known].mean()
    mean_slope = slope[known].mean()
    of_pixel = [chance, hits, share, off, slope]
    of_picture = [np.full(depth_m.shape, mean) for mean in (mean_hits, mixed, mean_off, mean_slope)]
    return np.nan_to_num(np.stack(of_pixel + of_picture, axis=2))


def _off_neighbours_m(depth_m: np.ndarray) -> np.ndarray:
    """float64[rows, cols]: distance from the median of the eight neighbours."""
    steps = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)]
    around_m = _around(depth_m, steps)
    around_m = np.sort(np.where(np.isnan(around_m), depth_m, around_m), axis=0)
    return np.abs(depth_m - (around_m[3] + around_m[4]) / 2)


def _slope_m(depth_m: np.ndarray, subgroup: tuple[int, int]) -> np.ndarray:
    """float64[rows, cols]: change of the depth from subgroup to subgroup, 0 across an edge."""
    rows, cols = subgroup
    beside_m = _around(depth_m, [(-rows, 0), (rows, 0), (0, -cols), (0, cols)])
    up_m, down_m, left_m, right_m = np.abs(beside_m - depth_m)
    vertical_m = np.fmin(up_m, down_m)  # across an edge, only one side is far
    horizontal_m = np.fmin(left_m, right_m)
    sides_m = np.stack([vertical_m, horizontal_m])
    return np.where(sides_m < SLOPE_MAX_M, sides_m, 0).max(axis=0)


def _around(image: np.ndarray, steps: Sequence[tuple[int, int]]) -> np.ndarray:
    """float64[steps, rows, cols]: `image` as it is a step of (rows, cols) away; NaN outside."""
    rows, cols = image.shape
    high = max(abs(r) for r, _ in steps)
    wide = max(abs(c) for _, c in steps)
    padded = np.pad(image, ((high, high), (wide, wide)), constant_values=np.nan)
    moved = []
    for r, c in steps:
        moved.append(padded[high + r : high + r + rows, wide + c : wide + c + cols])
    return np.stack(moved)


def _gates(config: Config) -> tuple[np.ndarray, np.ndarray]:
    """float64[subgroups] each: first tick in which a window may open or a hit may count in any
    pulse, and the one after the last.
    """
    ticks = float(config.sensor.phases)  # per cycle
    last = config.period - config.sensor.guard
    if config.counting:  # no window opens, and no guard ends the period
        last = min(config.period, CYCLES_MAX)
    moved = gate_moves(config)[-1]
    start = np.where(config.gating, config.gate_start, 0)
    end = np.where(config.gating, config.gate_start + config.gate_len + moved, last)
    return np.minimum(start, last) * ticks, np.minimum(end, last) * ticks


def _evidence(seen: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """float64: Poisson log likelihood ratio of more hits than `expected`, 0 if there are none."""
    expected = np.maximum(expected, 1e-3)
    more = np.maximum(seen, expected)
    return more * portable.log(more / expected) - more + expected


def _folded(lit: Lit, time: np.ndarray) -> np.ndarray:
    """bool[subgroups, pixels]: much darker than the picture's bright surfaces would be at the
    pixel's distance.

    Light that comes from beyond the laser period's range is as weak as its true distance makes it.
    """
    near = lit.near
    pulses = lit.pulses
    known = ~np.isnan(time) & (near > 0)
    if not known.any():
        return known
    fired = np.clip(lit.fired, 0.5 / pulses, 1 - 0.5 / pulses)
    pile_up = -portable.log1p(-fired) / fired
    squared = np.nan_to_num(time) ** 2
    most_hits = near + 2 * np.sqrt(near) + 2  # the true mean is hardly above it
    light = near / pulses * pile_up * squared
    most_light = most_hits / pulses * pile_up * squared
    few = near < np.quantile(near[known], BRIGHT)
    dark = most_light * FOLDED < np.quantile(light[known], BRIGHT)
    return known & few & dark


@njit
def _count(stamp: np.ndarray, hits: np.ndarray, sought: _Sought, own: Hits) -> None:
    """Count each pixel's hits, `own`, in a subgroup's events.

    stamp: ascending; hits: uint64[n, words].
    """
    outside = np.empty(len(stamp), np.int64)  # stamps of a pixel's hits that do not fit its depth
    for i in range(len(own.total)):
        number = 0
        begin = 0
        for e in range(len(stamp)):
            if not (sought.everywhere or is_hit(hits, e, i)):
                continue
            own.total[i] += 1
            if sought.first[i] < stamp[e] <= sought.until[i]:
                own.near[i] += 1
                continue
            outside[number] = stamp[e]
            number += 1
            while outside[begin] <= stamp[e] - sought.span:
                begin += 1
            own.other[i] = max(own.other[i], number - begin)
