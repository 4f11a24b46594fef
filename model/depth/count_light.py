# SPDX-License-Identifier: Apache-2.0
"""How bright background and returns are, from counts in gates.

All of this is our own choice. Most bins of the gates have background only, but which ones is not
known before the surfaces are. So the background of a subgroup is first the mean of the bins that
have no more hits than such a mean explains. When the surfaces are known roughly, it is that of the
bins beside them, without those that have too many hits still: they have another surface. A pixel
with many or few of these hits has a background of its own.
"""

from typing import NamedTuple

import numpy as np

from ..contract.config import Config
from ..contract.pixels import pixel_table
from ..shared.compiled import njit, part
from .count_likelihood import NO_TICK, Seen
from .pulse_ticks import PulseTicks

LEAST_RATE = 1e-7  # photons per tick and pixel: some background is everywhere
ROUNDS = 12  # in which the first background settles
TURNS = 4  # the same, of the second one
DARK_SHARE = 1e-4  # of a pulse: a bin with less has no light of the surface
EXCESS_SIGMAS = 3.0  # of the hits of a minigroup's bin: more is another surface,
EXCESS_HITS = 2.0  # if it is also so many more
PRIOR_HITS = 5.0  # weight of the array's mean in the background of a subgroup, in hits,
OWN_HITS = 10.0  # and of the subgroup's in that of a pixel
FAINTEST = 1e-7  # photons per pulse
BRIGHTEST = 20.0  # photons per pulse: more cannot be told apart
ERROR_MAX = 1e6  # nothing is known
STEPS = 60  # of Newton's method, at most
ENOUGH = 1e-6  # relative change of a light that ends them


class Trials(NamedTuple):
    """What is known of the bins before their background is, as in `Seen`."""

    first: np.ndarray  # int64[subgroups, pixels, gates], ticks
    hits: np.ndarray  # int64[subgroups, pixels, gates, bins]
    misses: np.ndarray  # float64[subgroups, pixels, gates, bins]
    width: int  # ticks of a bin

    def of_minigroups(self, values: np.ndarray, config: Config) -> np.ndarray:
        """Sum values of the pixels, [subgroups, pixels, ...], over their minigroups."""
        table = pixel_table(config.sensor)
        order = np.argsort(table.minigroup, kind="stable")
        grouped = values[:, order].reshape(
            len(values), config.sensor.minigroups, -1, *values.shape[2:]
        )
        return grouped.sum(axis=2)


def first_background(trials: Trials, config: Config) -> np.ndarray:
    """float64[subgroups, pixels]: photons per tick, the same for all pixels of a subgroup, before
    any surface is known.
    """
    live = config.mask[:, :, None, None]
    number = trials.of_minigroups(np.where(live, trials.hits, 0), config)
    tried = np.where(live, trials.hits + trials.misses, 0.0) * trials.width
    exposed = trials.of_minigroups(tried, config)
    explained = exposed > 0
    rate = _mean_rate(number, exposed, explained)
    for _ in range(ROUNDS):
        expected = exposed * rate[:, None, None, None]
        explained = (exposed > 0) & ~_exceeds(number, expected)
        rate = _mean_rate(number, exposed, explained)
    return np.repeat(rate[:, None], config.sensor.pixels, axis=1)


def better_background(
    trials: Trials, config: Config, pulse: PulseTicks, time: np.ndarray, rate: np.ndarray
) -> np.ndarray:
    """float64[subgroups, pixels]: photons per tick, when the surfaces are known roughly.

    time: float64[subgroups, pixels], of the surfaces, ticks; NaN: none. rate: `first_background`.
    """
    share = pulse_shares(trials.first, trials.width, trials.hits.shape[3], pulse, time)
    apart = config.mask[:, :, None, None] & (share < DARK_SHARE)
    hits = np.where(apart, trials.hits, 0)
    exposed = np.where(apart, trials.hits + trials.misses, 0.0) * trials.width
    number = trials.of_minigroups(hits, config)
    minigroup = pixel_table(config.sensor).minigroup
    for _ in range(TURNS):
        expected = trials.of_minigroups(exposed * rate[:, :, None, None], config)
        explained = ~_exceeds(number, expected)[:, minigroup]
        of_pixels = np.where(explained, hits, 0).sum(axis=(2, 3))
        ticks = np.where(explained, exposed, 0.0).sum(axis=(2, 3))
        mean = _mean_rate(of_pixels, ticks, ticks > 0)
        expected_of_pixel = ticks * mean[:, None]
        rate = mean[:, None] * (of_pixels + OWN_HITS) / (expected_of_pixel + OWN_HITS)
    return np.maximum(rate, LEAST_RATE)


def _mean_rate(number: np.ndarray, exposed: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """float64[subgroups]: hits per tick in which they are possible, drawn to the array's mean.

    number, exposed: [subgroups, ...], hits and such ticks; only where `counted`.
    """
    axes = tuple(range(1, number.ndim))
    hits = np.where(counted, number, 0).sum(axis=axes)
    ticks = np.where(counted, exposed, 0).sum(axis=axes)
    mean = max(LEAST_RATE, float(hits.sum() / max(1.0, ticks.sum())))
    return np.maximum((hits + PRIOR_HITS) / (ticks + PRIOR_HITS / mean), LEAST_RATE)


def _exceeds(number: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """bool: there are more hits than chance explains."""
    return number > expected + EXCESS_SIGMAS * np.sqrt(expected) + EXCESS_HITS


def pulse_shares(
    first: np.ndarray, width: int, bins: int, pulse: PulseTicks, time: np.ndarray
) -> np.ndarray:
    """float64[subgroups, pixels, gates, bins]: share of a pixel's pulse in its bins.

    time: float64[subgroups, pixels], ticks; NaN: no pulse.
    """
    edges = first[..., None] + width * np.arange(bins + 1) - time[:, :, None, None]
    before = pulse.share_before(np.nan_to_num(edges))
    share = before[..., 1:] - before[..., :-1]
    there = (first > NO_TICK) & ~np.isnan(time)[:, :, None]
    return np.where(there[..., None], share, 0.0)


def fit_lights(seen: Seen, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """float64[subgroups, pixels] twice: the lights that make the counts likeliest, in photons per
    pulse, and their standard errors.

    share: of `pulse_shares`.
    """
    bins = seen.hits.shape[2] * seen.hits.shape[3]
    shape = seen.hits.shape[:2]
    light = np.empty(shape[0] * shape[1])
    error = np.empty(shape[0] * shape[1])
    _fit_lights(
        seen.hits.reshape(-1, bins),
        seen.misses.reshape(-1, bins),
        share.reshape(-1, bins),
        (seen.background * seen.width).ravel(),
        light,
        error,
    )
    return light.reshape(shape), error.reshape(shape)


@njit
def _fit_lights(
    hits: np.ndarray,
    misses: np.ndarray,
    share: np.ndarray,
    back: np.ndarray,
    light: np.ndarray,
    error: np.ndarray,
) -> None:
    """Compute the lights of pixels by Newton's method.

    The slope of the log likelihood falls and is convex in the light, so from below the steps lead
    to its root without passing it.
    """
    for i in range(len(light)):
        here = 0.0
        for _ in range(STEPS):
            slope, bend = _slope(hits[i], misses[i], share[i], back[i], here)
            if slope <= 0 or bend <= 0:
                break
            here += slope / bend
            if slope < ENOUGH * here * bend:
                break
        light[i] = min(BRIGHTEST, max(FAINTEST, here))
        known = _information(hits[i], misses[i], share[i], back[i], light[i])
        error[i] = ERROR_MAX if known * ERROR_MAX**2 <= 1 else 1 / np.sqrt(known)


@part
def _slope(
    hits: np.ndarray, misses: np.ndarray, share: np.ndarray, back: float, light: float
) -> tuple[float, float]:
    """Return the slope of a pixel's log likelihood, and how fast it falls."""
    slope = 0.0
    bend = 0.0
    for b in range(len(hits)):
        if share[b] <= 0:
            continue
        slope -= misses[b] * share[b]
        if hits[b]:
            grow = np.exp(light * share[b]) * (1 + back)
            gain = hits[b] * share[b] / (grow - 1)
            slope += gain
            bend += gain * share[b] * grow / (grow - 1)
    return slope, bend


@part
def _information(
    hits: np.ndarray, misses: np.ndarray, share: np.ndarray, back: float, light: float
) -> float:
    """Return Fisher's information of a pixel's counts about its light."""
    known = 0.0
    for b in range(len(hits)):
        silent = np.exp(-light * share[b])
        chance = min(0.5 + 0.5 * (1 - silent), 1 - silent + back)
        rise = share[b] * silent
        known += (hits[b] + misses[b]) * rise * rise / (chance * (1 - chance))
    return known
