"""Depth from a sensor's events, and how much of it is wrong.

Ref: paper IV: a histogram per pixel and its peak; Fig. 7 for what counts as right. The other methods are our choice.
"""

import numpy as np
from attrs import frozen
from scipy import ndimage, special

from .config import Config
from .errors import check_integer
from .histograms import Events, frame_events, pixel_image, subgroup_histograms
from .joint import joint_choice
from .light import SIGMA_PER_FWHM, SPEED_OF_LIGHT_M_S
from .quantities import check_choice, check_real

SYSTEM_FWHM_S = 500e-12     # laser pulse and jitter together (paper IV)
TOLERANCE_S = 230e-12       # paper IV, Fig. 7: what counts as right
TOLERANCE_M = TOLERANCE_S * SPEED_OF_LIGHT_M_S / 2
RETURNS_MAX = 8
FILTER_SIGMAS = 4.0         # where the matched filter ends
NEAR_SIGMAS = 1.5           # bins around a peak that its centre is taken from
APART_SIGMAS = 4.0          # between returns of a pixel
ACCIDENT_MAX = 0.01         # probability that a second or further return is background
LIVE_MIN = 0.05             # share of periods; below it, pile-up is beyond correction

METHODS = {
    "maximum": "highest bin of the pixel's histogram",
    "matched": "highest point of the histogram filtered with the pulse",
    "background": "where hits exceed most what background explains, given when the tree could be armed at all",
    "joint": "surfaces of the subgroup, among which each pixel and its neighbours choose",
}


@frozen(eq=False)
class Depth:
    """Estimated depth of rows x cols pixels.

    depth_m: float64[rows, cols, returns], the most likely first, NaN = none. confidence: the same shape, 0 to 1; of the
    first return the probability that the pixel's light came from there and not from anywhere else (joint: from another of
    the surfaces), of the others that they are no accident of the background.
    """

    depth_m: np.ndarray
    confidence: np.ndarray


def estimate_depth(arrays: dict[str, np.ndarray], config: Config, tick_s: float, *, method: str = "joint", source: str = "map",
                   frame: int | None = None, returns: int = 1, system_fwhm_s: float = SYSTEM_FWHM_S) -> Depth:
    """Depth from the arrays of a result (`result.py`), by one of `METHODS`.

    frame: events of that frame only (None: all). source: of `histograms.SOURCES`, what a pixel's histogram is made from
    (joint always takes the map). system_fwhm_s: of pulse and jitter together. Raises `InputError`.
    """
    check_choice("method", method, tuple(METHODS))
    check_integer("returns", returns, 1, RETURNS_MAX)
    sigma_ticks = check_real("system_fwhm_s", system_fwhm_s, 1e-15, 1.0) * SIGMA_PER_FWHM / check_real("tick_s", tick_s, 1e-15, 1.0)
    events = frame_events(arrays, config, sigma_ticks, frame)
    if method == "joint":
        ticks, confidence = _joint(events, config, sigma_ticks, returns)
    else:
        live = _live_share(arrays, events, config, frame) if method == "background" else None
        histograms = subgroup_histograms(arrays, config, sigma_ticks, source=source, frame=frame)
        found = [pixel_peaks(histogram, method, None if live is None else live[s], sigma_ticks, returns)
                 for s, histogram in enumerate(histograms)]
        ticks, confidence = (pixel_image(np.stack(part), config.sensor) for part in zip(*found))
    return Depth(ticks * tick_s * SPEED_OF_LIGHT_M_S / 2, np.where(np.isnan(ticks), 0.0, confidence))


def wrong_pixels(depth_m: np.ndarray, truth_m: np.ndarray, tolerance_m: float = TOLERANCE_M) -> np.ndarray:
    """bool[rows, cols]: where |depth - truth| is above `tolerance_m` (230 ps, one way), or there is no depth.

    depth_m, truth_m: float64[rows, cols]; a pixel without truth (NaN) is not wrong.
    """
    return ~np.isnan(truth_m) & ~(np.abs(depth_m - truth_m) <= tolerance_m)


def wrong_share(depth_m: np.ndarray, truth_m: np.ndarray, tolerance_m: float = TOLERANCE_M) -> float:
    """Share of wrong pixels among those with a truth."""
    return float(wrong_pixels(depth_m, truth_m, tolerance_m).sum() / max(1, np.sum(~np.isnan(truth_m))))


def range_error(depth_m: np.ndarray, truth_m: np.ndarray) -> tuple[float, float]:
    """(bias, RMS) in metres of depth - truth (float64, any shape), over what has both; NaN where nothing has."""
    error_m = (depth_m - truth_m)[~np.isnan(depth_m - truth_m)]
    if not len(error_m):
        return np.nan, np.nan
    return float(error_m.mean()), float(np.sqrt(np.mean(error_m**2)))


def _joint(events: Events, config: Config, sigma_ticks: float, returns: int) -> tuple[np.ndarray, np.ndarray]:
    """(ticks, confidence) [rows, cols, returns]; further returns are candidates with significant hits of the pixel."""
    ticks, probability, significance = joint_choice(events, config, sigma_ticks)
    ticks[:, :, 1:][significance[:, :, 1:] < 1 - ACCIDENT_MAX] = np.nan
    confidence = np.concatenate([probability[:, :, :1], significance[:, :, 1:]], axis=2)
    order = np.argsort(np.isnan(ticks), axis=2, kind="stable")
    ticks, confidence = (np.take_along_axis(array, order, 2)[:, :, :returns] for array in (ticks, confidence))
    missing = ((0, 0), (0, 0), (0, returns - ticks.shape[2]))
    return np.pad(ticks, missing, constant_values=np.nan), np.pad(confidence, missing)


def pixel_peaks(histogram: np.ndarray, method: str, live: np.ndarray | None, sigma_ticks: float, returns: int):
    """(ticks, confidence), each float64[pixels, returns], from int32[pixels, bins]. live: float64[bins], `_live_share`."""
    pixels, bins = histogram.shape
    width = 1.0 if method == "maximum" else np.sqrt(2 * np.pi) * sigma_ticks  # a hit in the filter's middle counts 1
    seen = histogram.astype(np.float64) if method == "maximum" else _filtered(histogram, sigma_ticks) * width
    per_bin = (histogram.sum(axis=1) - seen.max(axis=1)).clip(0.5) / bins  # the peak is no background; half a hit at least
    shape = np.ones(bins) if live is None else _filtered(live / live.mean(), sigma_ticks)
    expected = np.outer(per_bin * width, shape)
    evidence = np.where(seen > expected, special.kl_div(seen, expected), 0)  # Poisson log likelihood ratio to background alone
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
            score[i, max(0, at - apart):at + apart + 1] = 0
    return ticks, confidence


def _filtered(values: np.ndarray, sigma_ticks: float) -> np.ndarray:
    """`values` along the last axis, filtered with a Gaussian of sum 1."""
    return ndimage.gaussian_filter1d(values.astype(np.float64), sigma_ticks, axis=-1, mode="constant", truncate=FILTER_SIGMAS)


def _live_share(arrays: dict[str, np.ndarray], events: Events, config: Config, frame: int | None) -> np.ndarray:
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
        stamp = events.stamp[events.bounds[s]:events.bounds[s + 1]]
        armed = ((stamp + events.window[s] - 1) // sensor.phases + 1 + sensor.rearm) * sensor.phases
        start = stamp + 1 if not config.coincidence[s] else armed - sensor.phases
        change = np.bincount(start, minlength=ticks + 1) - np.bincount(np.minimum(armed, ticks), minlength=ticks + 1)[:ticks + 1]
        blocked = np.cumsum(change)[:ticks] * committed[s] / max(1, stored[s])
        rejected = (opened[s] - committed[s]) * (events.window[s] + sensor.phases / 2) / ticks
        live[s] = 1 - (blocked + rejected) / periods
    return np.maximum(live, LIVE_MIN)
