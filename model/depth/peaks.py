"""Peaks of pixels' histograms: the paper's estimator (IV), and filtered ones, which are our choice."""

import numpy as np
from scipy import ndimage, special

from ..contract.config import Config
from ..contract.windows import armed_cycle, close_cycle
from .histograms import Events

FILTER_SIGMAS = 4.0  # where the matched filter ends
NEAR_SIGMAS = 1.5  # bins around a peak that its centre is taken from
APART_SIGMAS = 4.0  # between returns of a pixel
ACCIDENT_MAX = 0.01  # probability that a second or further return is background
LIVE_MIN = 0.05  # share of periods; below it, pile-up is beyond correction


def pixel_peaks(
    histogram: np.ndarray, method: str, live: np.ndarray | None, sigma_ticks: float, returns: int
) -> tuple[np.ndarray, np.ndarray]:
    """(ticks, confidence), each float64[pixels, returns], from int32[pixels, bins]. live: float64[bins], `live_share`."""
    pixels, bins = histogram.shape
    width = 1.0 if method == "maximum" else np.sqrt(2 * np.pi) * sigma_ticks  # a hit in the filter's middle counts 1
    seen = histogram.astype(np.float64) if method == "maximum" else _filtered(histogram, sigma_ticks) * width
    per_bin = (histogram.sum(axis=1) - seen.max(axis=1)).clip(
        0.5
    ) / bins  # the peak is no background; half a hit at least
    shape = np.ones(bins) if live is None else _filtered(live / live.mean(), sigma_ticks)
    expected = np.outer(per_bin * width, shape)
    evidence = np.where(
        seen > expected, special.kl_div(seen, expected), 0
    )  # Poisson log likelihood ratio to background alone
    score = evidence if method == "background" else seen.copy()
    ticks, confidence = np.full((pixels, returns), np.nan), np.zeros((pixels, returns))
    near, apart = round(NEAR_SIGMAS * sigma_ticks), round(APART_SIGMAS * sigma_ticks)
    top = evidence.max(axis=1)
    anywhere = top + np.log(np.exp(evidence - top[:, None]).sum(axis=1) / width)
    for i in range(pixels):
        for k in range(returns):
            at = int(score[i].argmax())
            accident = 1 - special.pdtr(max(0, np.ceil(seen[i, at]) - 1), expected[i, at]) ** (bins / width)
            if score[i, at] <= 0 or k and accident > ACCIDENT_MAX:
                break
            here = slice(at, at + 1) if method == "maximum" else slice(max(0, at - near), at + near + 1)
            hits = histogram[i, here] / (1 if live is None else live[here])
            ticks[i, k] = np.average(np.arange(bins)[here] + 0.5, weights=hits) if hits.any() else at + 0.5
            confidence[i, k] = 1 - accident if k else min(1.0, np.exp(evidence[i, at] - anywhere[i]))
            score[i, max(0, at - apart) : at + apart + 1] = 0
    return ticks, confidence


def _filtered(values: np.ndarray, sigma_ticks: float) -> np.ndarray:
    """`values` along the last axis, filtered with a Gaussian of sum 1."""
    return ndimage.gaussian_filter1d(
        values.astype(np.float64), sigma_ticks, axis=-1, mode="constant", truncate=FILTER_SIGMAS
    )


def live_share(arrays: dict[str, np.ndarray], events: Events, config: Config, frame: int | None) -> np.ndarray:
    """float64[subgroups, period_ticks]: share of the periods in which the tree could have opened a window at each tick.

    A window keeps it from doing so until it is armed again: pile-up, and R's blind time. Committed windows are taken where
    they were, at each tick where coincidence is off (the stamps are single photons: Coates' correction), else by the cycle
    before (the arrival lies within the event's own window); rejected ones are spread over the period, unknown as they are.
    """
    sensor, ticks = config.sensor, config.period_ticks
    frames = slice(None) if frame is None else slice(frame, frame + 1)
    opened, committed, stored = (arrays[name][frames].sum(axis=0) for name in ("opened", "committed", "stored"))
    periods = config.pulses * len(arrays["opened"][frames])
    live = np.empty((sensor.subgroups, ticks))
    for s in range(sensor.subgroups):
        stamp = events.stamp[events.bounds[s] : events.bounds[s + 1]]
        close = close_cycle(stamp, events.window[s], sensor.phases)
        armed = armed_cycle(close, sensor.rearm) * sensor.phases
        start = stamp + 1 if not config.coincidence[s] else armed - sensor.phases
        change = (
            np.bincount(start, minlength=ticks + 1)
            - np.bincount(np.minimum(armed, ticks), minlength=ticks + 1)[: ticks + 1]
        )
        blocked = np.cumsum(change)[:ticks] * committed[s] / max(1, stored[s])
        rejected = (opened[s] - committed[s]) * (events.window[s] + sensor.phases / 2) / ticks
        live[s] = 1 - (blocked + rejected) / periods
    return np.maximum(live, LIVE_MIN)
