"""Depth from a sensor's events, and how much of it is wrong.

Ref: paper IV: a histogram per pixel and its peak; Fig. 7 for what counts as right. The other methods are our choice.
"""

import numpy as np
from attrs import frozen

from ..contract.config import Config
from ..shared.constants import SPEED_OF_LIGHT_M_S
from ..shared.errors import check_integer
from ..shared.quantities import check_choice
from .arrivals import SYSTEM_FWHM_S, pulse_sigma_ticks
from .histograms import Events, frame_events, pixel_image, subgroup_histograms
from .joint import joint_choice
from .peaks import ACCIDENT_MAX, live_share, pixel_peaks

RETURNS_MAX = 8

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


def estimate_depth(
    arrays: dict[str, np.ndarray],
    config: Config,
    *,
    method: str = "joint",
    source: str = "map",
    frame: int | None = None,
    returns: int = 1,
    system_fwhm_s: float = SYSTEM_FWHM_S,
) -> Depth:
    """Depth from the arrays of a result (`result.py`), by one of `METHODS`.

    frame: events of that frame only (None: all). source: of `histograms.SOURCES`, what a pixel's histogram is made from
    (joint always takes the map). system_fwhm_s: of pulse and jitter together. Raises `InputError`.
    """
    check_choice("method", method, tuple(METHODS))
    check_integer("returns", returns, 1, RETURNS_MAX)
    sigma_ticks = pulse_sigma_ticks(config, system_fwhm_s)
    events = frame_events(arrays, config, sigma_ticks, frame)
    if method == "joint":
        ticks, confidence = _joint(events, config, sigma_ticks, returns)
    else:
        live = live_share(arrays, events, config, frame) if method == "background" else None
        histograms = subgroup_histograms(arrays, config, sigma_ticks, source=source, frame=frame)
        found = [
            pixel_peaks(histogram, method, None if live is None else live[s], sigma_ticks, returns)
            for s, histogram in enumerate(histograms)
        ]
        ticks, confidence = (pixel_image(np.stack(part), config.sensor) for part in zip(*found))
    return Depth(ticks * config.tick_s * SPEED_OF_LIGHT_M_S / 2, np.where(np.isnan(ticks), 0.0, confidence))


def _joint(events: Events, config: Config, sigma_ticks: float, returns: int) -> tuple[np.ndarray, np.ndarray]:
    """(ticks, confidence) [rows, cols, returns]; further returns are candidates with significant hits of the pixel."""
    ticks, probability, significance = joint_choice(events, config, sigma_ticks)
    ticks[:, :, 1:][significance[:, :, 1:] < 1 - ACCIDENT_MAX] = np.nan
    confidence = np.concatenate([probability[:, :, :1], significance[:, :, 1:]], axis=2)
    order = np.argsort(np.isnan(ticks), axis=2, kind="stable")
    ticks, confidence = (np.take_along_axis(array, order, 2)[:, :, :returns] for array in (ticks, confidence))
    missing = ((0, 0), (0, 0), (0, returns - ticks.shape[2]))
    return np.pad(ticks, missing, constant_values=np.nan), np.pad(confidence, missing)
