"""Joint estimator: surfaces are found in a subgroup's events, and each pixel chooses among them. What the ID map is for.

Our choice throughout; the paper (IV) takes the peak of every pixel's histogram. Steps:

1. Candidates: bins of a subgroup's arrivals with more events than background explains, also if only events of a higher
   count are taken (a threshold raised afterwards).
2. Fit of each candidate's time and light to stamps and counts: the law of a Gaussian pulse's first photon, with what the
   window then counts. It undoes the pile-up of first photons for any window and threshold, coincidence off included.
3. Evidence: each event belongs to the candidates and to background by its stamp and count; a pixel's hits in a
   candidate's events speak for it. A pixel without hits speaks for the darkest.
4. Choice: hits of a pixel are Poisson around the candidate's mean, which varies over the surface (gamma), or
   accidental. Neighbours see the same surface more often than not (mean field). Subgroups lend their candidates to the
   eight around them: a surface may be too small in one to show by itself.
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from attrs import frozen
from scipy import special, stats

from ..contract.config import Config
from ..contract.parameters import Sensor
from ..shared.compiled import njit
from .histograms import Events, pixel_image

SEARCH_SIGMAS = 1.5  # half width of the bins in which candidates are sought
APART_SIGMAS = 3.0  # candidates of a subgroup are at least this far apart
FALSE_CANDIDATES = 0.02  # expected of a subgroup
CANDIDATES_MAX = 8  # of a subgroup, the strongest
QUIET_SHARE = 0.98  # of the bins make up the background
EVENTS_MIN = 0.5  # of the background in a frame: one event is no surface
COUNTS_TRIED = 6  # thresholds tried afterwards: the sensor's own and the next higher ones
FIT_EARLY, FIT_LATE = 6, 4  # sigmas around a candidate within which events take part in its fit
SHIFT_EARLY, SHIFT_LATE = 1.5, 4  # sigmas by which the fit may move it: short windows leave stamps early
LIGHT = np.geomspace(0.1, 1000, 20)  # photons of a pulse in a subgroup that the fit tries
SIGNAL_LIMITS = 0.05, 0.95  # of a pulse's share in the events around it
OUTLIER = 1e-3  # least probability of a count in the background: events that neither law knows
SURFACE_SPREAD = 0.25  # variance / mean^2 of the light over a surface's pixels, before any is seen,
SURFACE_PIXELS = 8.0  # and as how many seen pixels that counts
ACCIDENTAL_MIN = 0.02  # hits; keeps a single one from deciding
NEIGHBOUR_WEIGHT = 1.0  # log odds that a neighbour on the same surface gives
FLAT_SIGMAS = 0.1  # least standard error of a fit: how much a surface may differ between subgroups and count as flat
POOL_ERRORS = 4.0  # fits of neighbouring subgroups that differ by no more standard errors are pooled
SAME_SIGMAS = 1.5  # surfaces nearer than this are one
ROUNDS = 12  # of mean field


class Candidates(NamedTuple):
    """Candidates of all subgroups, padded to the largest number J.

    time: float64[subgroups, J] in ticks, NaN = none. hits, accidental: float64[subgroups, pixels, J], hits of each pixel
    in a candidate's events, and how many of them a pixel elsewhere would have.
    """

    time: np.ndarray
    hits: np.ndarray
    accidental: np.ndarray


def joint_choice(events: Events, config: Config, sigma_ticks: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(time, probability, significance), each float64[rows, cols, J], the pixel's choice first, then by hits.

    time: candidates in ticks, NaN where a pixel has fewer. probability: that the pixel sees this one. significance:
    probability that the pixel's hits are more than accidental.
    """
    candidates = _candidates(events, config, sigma_ticks)
    time = pixel_image(np.broadcast_to(candidates.time[:, None], candidates.hits.shape), config.sensor)
    hits, accidental = (pixel_image(array, config.sensor) for array in candidates[1:])
    subgroup = pixel_image(
        np.broadcast_to(np.arange(config.sensor.subgroups)[:, None], candidates.hits.shape[:2]), config.sensor
    )
    masked = ~pixel_image(config.mask, config.sensor)
    probability = _mean_field(time, hits, accidental, subgroup, masked, SAME_SIGMAS * sigma_ticks)
    significance = stats.poisson.cdf(np.ceil(hits) - 1, accidental)
    chosen = np.arange(probability.shape[2]) == probability.argmax(axis=2)[:, :, None]
    order = np.argsort(-np.where(chosen, np.inf, hits), axis=2, kind="stable")
    time, probability, significance = (
        np.take_along_axis(array, order, 2) for array in (time, probability, significance)
    )
    return time, probability, significance


def _candidates(events: Events, config: Config, sigma_ticks: float) -> Candidates:
    """Candidates of every subgroup: its own, and those of the eight around it that it has not."""
    sensor = config.sensor
    parts = _parts(events, config, sigma_ticks)
    own = [
        _distinct([_fit(part, peak, True) for peak in _peaks(part)], [], SEARCH_SIGMAS * sigma_ticks) for part in parts
    ]
    around = [_around(s, sensor) for s in range(sensor.subgroups)]
    pooled = [
        [_pooled(fit, [other for k in around[s] for other in own[k]]) for fit in own[s]]
        for s in range(sensor.subgroups)
    ]
    fits = []
    for s, part in enumerate(parts):
        offered = sorted((fit for k in around[s] for fit in pooled[k]), key=lambda fit: fit.error)
        lent = _distinct(offered, pooled[s], SEARCH_SIGMAS * sigma_ticks)
        fits.append(pooled[s] + [_fit(part, fit.time, False) for fit in lent])
    most = max(1, max(map(len, fits)))
    time = np.full((sensor.subgroups, most), np.nan)
    hits, accidental = (np.zeros((sensor.subgroups, sensor.pixels, most)) for _ in range(2))
    for s, part in enumerate(parts):
        n = len(fits[s])
        time[s, :n] = [fit.time for fit in fits[s]]
        share, maps = _shares(part, fits[s]), events.maps(s, sensor.pixels)
        hits[s, :, :n] = maps.T @ share
        noise = maps.T @ (1 - share.sum(axis=1))  # hits in background events: how active a pixel is by itself
        activity = (noise + 1) / (noise.mean() + 1)
        chance = part.noise / sensor.pixels
        accidental[s, :, :n] = np.maximum(ACCIDENTAL_MIN, activity[:, None] * chance * share.sum(axis=0))
    return Candidates(time, hits, accidental)


def _parts(events: Events, config: Config, sigma_ticks: float) -> list["_Part"]:
    """The events of each subgroup, with the law of its window; subgroups of one kind share it."""
    law = cache(lambda window, pixels: FirstPhotonLaw.of(window, pixels, sigma_ticks))
    parts = []
    for s in range(config.sensor.subgroups):
        window, pixels = int(events.window[s]), int(max(1, config.mask[s].sum()))
        span = slice(events.bounds[s], events.bounds[s + 1])
        parts.append(
            _Part(
                events.stamp[span],
                events.count[span],
                events.arrival[span],
                int(events.threshold[s]),
                events.photon_rate[s] * window,
                config.period_ticks,
                sigma_ticks,
                law(window, pixels),
            )
        )
    return parts


def _around(subgroup: int, sensor: Sensor) -> list[int]:
    """The subgroups beside and diagonal to `subgroup`."""
    rows, cols = sensor.rows // sensor.subgroup[0], sensor.cols // sensor.subgroup[1]
    row, col = divmod(subgroup, cols)
    near = [
        (r, c) for r in range(max(0, row - 1), min(rows, row + 2)) for c in range(max(0, col - 1), min(cols, col + 2))
    ]
    return [r * cols + c for r, c in near if (r, c) != (row, col)]


class FirstPhotonLaw(NamedTuple):
    """Probability of (stamp, count) for a Gaussian pulse alone, by light and by the stamp's distance from the pulse's centre.

    table: float64[lights, distances, pixels + 1]; `per_tick` distances a tick, from `first` ticks on.
    least: float64[lights, pixels + 2], probability of a count of at least k.
    """

    table: np.ndarray
    least: np.ndarray
    first: float
    per_tick: int

    @classmethod
    def of(cls, window: int, pixels: int, sigma_ticks: float) -> "FirstPhotonLaw":
        """The law for a window in ticks and a subgroup of `pixels` that all see the light alike."""
        per_tick = max(2, math.ceil(8 / sigma_ticks))
        first = -math.ceil((FIT_EARLY + SHIFT_LATE) * sigma_ticks) - 1
        last = math.ceil((FIT_LATE + SHIFT_EARLY) * sigma_ticks) + 1
        start = np.arange((last - first) * per_tick + 1) / per_tick + first
        before, middle, after, end = (special.ndtr((start + d) / sigma_ticks) for d in (0, 0.5, 1, window))
        light = LIGHT[:, None]
        stamp = np.exp(-light * before) - np.exp(-light * after)
        fires = -np.expm1(-light / pixels * np.maximum(end - middle, 0))
        count = stats.binom.pmf(np.arange(pixels), pixels - 1, fires[:, :, None])
        table = np.zeros((len(LIGHT), len(start), pixels + 1))
        table[:, :, 1:] = stamp[:, :, None] * count
        of_count = table.sum(axis=1) / per_tick
        least = np.concatenate([of_count[:, ::-1].cumsum(axis=1)[:, ::-1], np.zeros((len(LIGHT), 1))], axis=1)
        return cls(table, np.maximum(least, 1e-12), float(first), per_tick)


@frozen(eq=False)
class _Part:
    """A subgroup's events (arrays [n]) and what is known of it."""

    stamp: np.ndarray
    count: np.ndarray
    arrival: np.ndarray
    threshold: int
    noise: float  # background photons in a window
    period_ticks: int
    sigma: float
    law: FirstPhotonLaw

    @property
    def least_index(self) -> int:
        """Where the law's `least` has the threshold; with pixels masked it may be beyond reach."""
        return min(self.threshold, self.law.least.shape[1] - 1)

    def background_counts(self) -> np.ndarray:
        """float64[pixels + 1]: probability of each count in a background event, at least `OUTLIER`."""
        pixels = self.law.table.shape[2] - 1
        law = stats.poisson.pmf(np.arange(pixels + 1) - 1, self.noise)
        law[: self.threshold] = 0
        return np.maximum(law / max(law.sum(), 1e-300), OUTLIER)


class Fit(NamedTuple):
    """A candidate: time in ticks and its standard error, index of its light in `LIGHT`, number of its events."""

    time: float
    error: float
    light: int
    events: float


def _peaks(part: _Part) -> list[float]:
    """Arrivals that background does not explain, strongest first."""
    half, apart = max(1, round(SEARCH_SIGMAS * part.sigma)), round(APART_SIGMAS * part.sigma)
    width, bins = 2 * half + 1, part.period_ticks
    arrival = np.minimum(part.arrival.astype(np.int64), bins - 1)
    strength = np.zeros(bins)
    for least in range(part.threshold, part.threshold + COUNTS_TRIED):
        histogram = np.bincount(arrival[part.count >= least], minlength=bins)
        until = np.concatenate([np.zeros(half + 1, np.int64), np.cumsum(histogram), np.full(half, histogram.sum())])
        inside = until[width:] - until[:-width]  # events within `half` bins of each
        quiet = inside <= np.quantile(inside, QUIET_SHARE)
        mean = max(histogram[quiet].mean(), EVENTS_MIN / bins) * width
        accident = stats.poisson.sf(np.arange(inside.max() + 1) - 1, mean)[inside]
        found = accident < FALSE_CANDIDATES * width / bins / COUNTS_TRIED
        strength = np.maximum(strength, np.where(found, inside - mean, 0))
    peaks: list[float] = []
    while len(peaks) < CANDIDATES_MAX and strength.max() > 0:
        top = np.flatnonzero(strength == strength.max())
        at = int(top[len(top) // 2])
        peaks.append(float(part.arrival[np.abs(arrival - at) <= half].mean()))
        strength[max(0, at - apart) : at + apart + 1] = 0
    return peaks


def _fit(part: _Part, peak: float, move: bool) -> Fit:
    """The candidate near `peak`: mean of its time over the posterior (flat in time and in log light); else its time stays.

    Events around it are a pulse's, by the law, or background's, uniform; their shares are known from the events elsewhere.
    """
    law = part.law
    chosen = (part.stamp > peak - FIT_EARLY * part.sigma) & (part.stamp < peak + FIT_LATE * part.sigma)
    length = (FIT_EARLY + FIT_LATE) * part.sigma
    others = (len(part.stamp) - chosen.sum()) / part.period_ticks * length
    signal = np.clip(1 - others / max(1, chosen.sum()), *SIGNAL_LIMITS)
    early, late = (math.floor(reach * part.sigma * law.per_tick) if move else 0 for reach in (SHIFT_EARLY, SHIFT_LATE))
    shift = np.arange(-early, late + 1) / law.per_tick
    alike, times = np.unique(np.stack([part.stamp[chosen], part.count[chosen]]), axis=1, return_counts=True)
    logs = _log_likelihood(
        alike[0] - peak,
        alike[1],
        times,
        shift,
        law.table,
        law.least[:, part.least_index],
        law.first,
        law.per_tick,
        part.background_counts() / length,
        signal,
    )
    weight = np.exp(logs - logs.max())
    of_shift = weight.sum(axis=0) / weight.sum()
    mean = float(of_shift @ shift)
    error = math.sqrt(float(of_shift @ (shift - mean) ** 2) + (FLAT_SIGMAS * part.sigma) ** 2)
    return Fit(peak + mean, error, int(weight.sum(axis=1).argmax()), max(1.0, signal * chosen.sum()))


def _distinct(fits: list[Fit], known: list[Fit], apart_ticks: float) -> list[Fit]:
    """Those of `fits` that lie `apart_ticks` from `known` and from each other, first come first served."""
    taken = list(known)
    for fit in fits:
        if all(abs(fit.time - other.time) > apart_ticks for other in taken):
            taken.append(fit)
    return taken[len(known) :]


def _pooled(fit: Fit, others: list[Fit]) -> Fit:
    """`fit` with its time averaged with those of `others` that it cannot be told from."""
    same = [fit] + [
        other for other in others if abs(other.time - fit.time) < POOL_ERRORS * math.hypot(other.error, fit.error)
    ]
    weight = np.array([one.error**-2 for one in same])
    return fit._replace(
        time=float(weight @ [one.time for one in same] / weight.sum()), error=float(weight.sum() ** -0.5)
    )


@njit
def _log_likelihood(
    stamp: np.ndarray,
    count: np.ndarray,
    times: np.ndarray,
    shift: np.ndarray,
    table: np.ndarray,
    least: np.ndarray,
    first: float,
    per_tick: int,
    background: np.ndarray,
    signal: float,
) -> np.ndarray:
    """float64[lights, shifts], of events of which `times` are alike."""
    logs = np.zeros((len(table), len(shift)))
    for a in range(len(table)):
        for b in range(len(shift)):
            for e in range(len(stamp)):
                at = int(round((stamp[e] - shift[b] - first) * per_tick))
                law = table[a, at, count[e]] / least[a] if 0 <= at < table.shape[1] else 0.0
                logs[a, b] += times[e] * np.log(signal * law + (1 - signal) * background[count[e]])
    return logs


def _shares(part: _Part, fits: list[Fit]) -> np.ndarray:
    """float64[n, J]: probability that each event is of each candidate; the rest is background."""
    law = part.law
    density = np.zeros((len(part.stamp), len(fits)))
    for j, fit in enumerate(fits):
        at = np.rint((part.stamp - fit.time - law.first) * law.per_tick).astype(np.int64)
        inside = (at >= 0) & (at < law.table.shape[1])
        density[inside, j] = (
            fit.events * law.table[fit.light, at[inside], part.count[inside]] / law.least[fit.light, part.least_index]
        )
    noise = (
        max(1.0, len(part.stamp) - sum(fit.events for fit in fits))
        / part.period_ticks
        * part.background_counts()[part.count]
    )
    return density / (density.sum(axis=1) + noise)[:, None]


def _mean_field(
    time: np.ndarray,
    hits: np.ndarray,
    accidental: np.ndarray,
    subgroup: np.ndarray,
    masked: np.ndarray,
    same_ticks: float,
) -> np.ndarray:
    """float64[rows, cols, J]: probability of each candidate, given hits and neighbours; means of the surfaces by the way."""
    rows, cols, most = time.shape
    exists = ~np.isnan(time)
    odds_accidental = np.where(exists, -stats.poisson.logpmf(np.round(hits), accidental), 0)
    probability = np.where(exists, hits + 0.1, 0)
    probability /= np.maximum(probability.sum(axis=2, keepdims=True), 1e-300)
    flat = subgroup.ravel()

    def within(values: np.ndarray) -> np.ndarray:
        """Sums over each subgroup, float64[subgroups, J]."""
        return np.stack([np.bincount(flat, values[:, :, j].ravel(), flat.max() + 1) for j in range(most)], axis=1)

    neighbours = [(dr, dc, 1 / math.hypot(dr, dc)) for dr in (-1, 0, 1) for dc in (-1, 0, 1) if (dr, dc) != (0, 0)]
    lit = np.where(masked, 0.0, 1.0)
    for _ in range(ROUNDS):
        weight = probability * lit[:, :, None]
        members, total = within(weight), within(weight * hits)
        mean = (total + 0.1) / (members + 0.1)
        excess = within(weight * (hits - mean[subgroup]) ** 2) - total  # variance beyond Poisson's
        spread = (SURFACE_PIXELS * SURFACE_SPREAD + (excess / mean**2).clip(0)) / (SURFACE_PIXELS + members)
        mean, shape = mean[subgroup] + accidental, 1 / spread[subgroup]
        law = stats.nbinom.logpmf(np.round(hits), shape, shape / (shape + mean))
        score = np.where(exists, (law + odds_accidental) * lit[:, :, None], -np.inf)
        around = np.zeros_like(probability)
        for dr, dc, near in neighbours:
            here = (slice(max(0, -dr), rows - max(0, dr)), slice(max(0, -dc), cols - max(0, dc)))
            there = (slice(max(0, dr), rows + min(0, dr)), slice(max(0, dc), cols + min(0, dc)))
            agree = np.abs(time[here][:, :, :, None] - time[there][:, :, None, :]) < same_ticks
            around[here] += near * np.einsum("rcij,rcj->rci", agree, probability[there])
        score = np.where(exists, score + NEIGHBOUR_WEIGHT * around, -np.inf)
        top = score.max(axis=2, keepdims=True)
        probability = np.where(exists, np.exp(score - np.where(np.isfinite(top), top, 0)), 0)
        probability /= np.maximum(probability.sum(axis=2, keepdims=True), 1e-300)
    return probability
