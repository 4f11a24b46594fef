# SPDX-License-Identifier: Apache-2.0
"""Estimation of depth from a sensor's events.

Ref: paper IV (a histogram per pixel, and its peak), Fig. 7 (tolerance of a right pixel). The other methods are our own
choice.
"""

import numpy as np
from attrs import frozen

from ..contract.config import Config
from ..shared.constants import SPEED_OF_LIGHT_M_S, SUCCESS_TOLERANCE_S
from ..shared.errors import check_integer
from ..shared.quantities import check_choice
from .arrivals import SYSTEM_FWHM_S, pulse_sigma_ticks
from .histograms import frame_events, pixel_image, subgroup_histograms
from .peaks import live_share, pixel_peaks
from .planes import find_surfaces

RETURNS_MAX = 8

METHODS = {
    "maximum": "highest bin of the pixel's histogram",
    "matched": "highest point of the histogram after filtering with the pulse",
    "background": "largest excess of hits over the expected background, corrected for the times when the tree is not armed",
    "planes": "likelihood of all events, fitted by planes that neighbouring pixels share",
}
DEFAULT_METHOD = "planes"


@frozen(eq=False)
class Depth:
    """Estimated depth of rows x cols pixels.

    Attributes
    ----------
    depth_m : numpy.ndarray
        float64[rows, cols, returns], in metres, the most likely return first; NaN = none.
    confidence : numpy.ndarray
        float64[rows, cols, returns], from 0 to 1. For the first return, the probability that the pixel's light came from there
        (`planes`: that it is right by the paper's criterion); for the others, that they are not accidental background.
    error_m : numpy.ndarray or None
        float64[rows, cols, returns], standard error in metres; only with `planes`.
    slope_m : numpy.ndarray or None
        float64[rows, cols, 2], increase of the distance from row to row and from column to column, in metres; only with `planes`.
    """

    depth_m: np.ndarray
    confidence: np.ndarray
    error_m: np.ndarray | None = None
    slope_m: np.ndarray | None = None


def estimate_depth(
    arrays: dict[str, np.ndarray],
    config: Config,
    *,
    method: str = DEFAULT_METHOD,
    source: str = "map",
    frame: int | None = None,
    returns: int = 1,
    workers: int | None = None,
    system_fwhm_s: float = SYSTEM_FWHM_S,
) -> Depth:
    """Estimate the distance of every pixel from the sensor's output.

    Parameters
    ----------
    arrays : dict of str to numpy.ndarray
        The arrays of a result, as `Run.result` or `read_result` has them.
    config : Config
        The configuration of the run.
    method : str
        `planes` (default), `maximum` (the paper's highest bin), `matched` or `background`; see docs/depth.md.
    source : str
        Origin of a pixel's histogram: `map`, `minigroup` or `subgroup`. `planes` always uses all parts of an event.
    frame : int or None
        Use the events of this frame only; None uses all of them.
    returns : int
        Number of surfaces per pixel, 1 to 8.
    workers : int or None
        Threads of `planes`; None is one per core. The number does not change the result.
    system_fwhm_s : float
        FWHM of laser pulse and jitter combined, in seconds.

    Returns
    -------
    Depth

    Raises
    ------
    InputError
        If an argument is out of range.
    """
    check_choice("method", method, tuple(METHODS))
    check_integer("returns", returns, 1, RETURNS_MAX)
    sigma_ticks = pulse_sigma_ticks(config, system_fwhm_s)
    events = frame_events(arrays, config, sigma_ticks, frame)
    if method == "planes":
        tick_m = config.tick_s * SPEED_OF_LIGHT_M_S / 2
        pulses = config.pulses * (len(arrays["opened"]) if frame is None else 1)
        surfaces = find_surfaces(
            events,
            config,
            sigma_ticks,
            pulses,
            tolerance_ticks=SUCCESS_TOLERANCE_S / config.tick_s,
            returns=returns,
            workers=workers,
        )
        return Depth(surfaces.time * tick_m, surfaces.confidence, surfaces.error * tick_m, surfaces.slope * tick_m)
    live = live_share(arrays, events, config, frame) if method == "background" else None
    histograms = subgroup_histograms(arrays, config, sigma_ticks, source=source, frame=frame)
    found = [
        pixel_peaks(histogram, method, None if live is None else live[s], sigma_ticks, returns)
        for s, histogram in enumerate(histograms)
    ]
    ticks, confidence = (pixel_image(np.stack(part), config.sensor) for part in zip(*found))
    return Depth(ticks * config.tick_s * SPEED_OF_LIGHT_M_S / 2, np.where(np.isnan(ticks), 0.0, confidence))
