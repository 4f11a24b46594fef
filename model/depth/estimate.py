# SPDX-License-Identifier: Apache-2.0
"""Estimation of depth from a sensor's events.

Ref: paper IV (a histogram per pixel, and its peak), Fig. 7 (tolerance of a right pixel). The other methods are our own
choice.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from attrs import asdict, frozen

from ..contract.config import Config
from ..contract.pixels import pixel_table
from ..shared.constants import SPEED_OF_LIGHT_M_S, SUCCESS_TOLERANCE_S
from ..shared.errors import check_integer
from ..shared.files import FilePath, write_npz
from ..shared.quantities import check_choice
from ..shared.threads import Threads
from .arrivals import SYSTEM_FWHM_S, pulse_sigma_ticks
from .belief import SENTENCES, Reason, Signs, believe, find_signs
from .histograms import (
    Events,
    frame_events,
    frame_records,
    minigroup_step_ticks,
    pixel_image,
    subgroup_histograms,
)
from .methods import DEFAULT_METHOD, METHODS
from .peaks import live_share, pixel_peaks, record_live
from .planes import find_surfaces

RETURNS_MAX = 8


@frozen(eq=False)
class Depth:
    """Estimated depth of rows x cols pixels.

    Attributes
    ----------
    depth_m : numpy.ndarray
        float64[rows, cols, returns], in metres, the most likely return first; NaN = none.
    confidence : numpy.ndarray
        float64[rows, cols, returns], from 0 to 1. For the first return, the probability that it is right by the paper's criterion;
        for the others, that they are not accidental background.
    reason : numpy.ndarray
        uint8[rows, cols], `belief.Reason`: whether the first return is to be believed (0), and if not, why.
    error_m : numpy.ndarray or None
        float64[rows, cols, returns], standard error in metres; only with `planes`.
    slope_m : numpy.ndarray or None
        float64[rows, cols, 2], increase of the distance from row to row and from column to column, in metres; only with `planes`.
    """

    depth_m: np.ndarray
    confidence: np.ndarray
    reason: np.ndarray
    error_m: np.ndarray | None = None
    slope_m: np.ndarray | None = None

    def save(self, path: FilePath) -> None:
        """Write the arrays that there are as NPZ, whole or not at all; `sentences` are those of the reasons."""
        arrays = {name: part for name, part in asdict(self).items() if part is not None}
        write_npz(path, arrays | {"sentences": np.array([SENTENCES[reason] for reason in Reason])})


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
        Threads; None is one per core. The number does not change the result.
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
    with Threads(workers) as threads:
        found = find_returns(
            arrays, config, method, source, frame, returns=returns, threads=threads, system_fwhm_s=system_fwhm_s
        )
        signs = found.signs(config, threads)
    tick_m, confidence = config.tick_s * SPEED_OF_LIGHT_M_S / 2, found.sure.copy()
    confidence[:, :, 0], reason = believe(signs, config, method)
    error_m, slope_m = (None if part is None else part * tick_m for part in (found.error, found.slope))
    return Depth(found.ticks * tick_m, confidence, reason, error_m, slope_m)


class Found(NamedTuple):
    """What an estimator finds, in ticks: [rows, cols, returns], error and slope as in `Depth`; and the events it looked at.

    sure: as `confidence` of `Depth`, but as the estimator itself sees the first return. everywhere: all events of a
    subgroup count for each of its pixels.
    """

    ticks: np.ndarray
    sure: np.ndarray
    error: np.ndarray | None
    slope: np.ndarray | None
    events: Events
    pulses: int
    sigma_ticks: float
    everywhere: bool

    def signs(self, config: Config, threads: Threads) -> Signs:
        """Return what speaks for and against the first returns."""
        ticks, sure = self.ticks[:, :, 0], self.sure[:, :, 0]
        return find_signs(self.events, config, self.sigma_ticks, self.pulses, ticks, sure, self.everywhere, threads)


def find_returns(
    arrays: dict[str, np.ndarray],
    config: Config,
    method: str,
    source: str,
    frame: int | None,
    *,
    returns: int,
    threads: Threads,
    system_fwhm_s: float,
) -> Found:
    """Find the returns of every pixel; the other arguments and errors as in `estimate_depth`."""
    check_choice("method", method, tuple(METHODS))
    check_integer("returns", returns, 1, RETURNS_MAX)
    sigma_ticks = pulse_sigma_ticks(config, system_fwhm_s)
    events = frame_events(arrays, config, sigma_ticks, frame)
    pulses = config.pulses * (len(arrays["opened"]) if frame is None else 1)
    if method == "planes":
        parts = find_surfaces(
            events,
            config,
            sigma_ticks,
            pulses,
            tolerance_ticks=SUCCESS_TOLERANCE_S / config.tick_s,
            returns=returns,
            threads=threads,
        )
        return Found(*parts, events, pulses, sigma_ticks, everywhere=False)
    live, group = _live(arrays, events, config, source, frame) if method == "background" else (None, None)
    step_ticks = 1 if source != "minigroup" else minigroup_step_ticks(config)
    histograms = subgroup_histograms(arrays, config, sigma_ticks, source=source, frame=frame)
    peaks = [
        pixel_peaks(
            histogram, method, live(s) if live else None, sigma_ticks, returns, group=group, step_ticks=step_ticks
        )
        for s, histogram in enumerate(histograms)
    ]
    ticks, sure = (pixel_image(np.stack(part), config.sensor) for part in zip(*peaks, strict=True))
    sure = np.where(np.isnan(ticks), 0.0, sure)
    return Found(ticks, sure, None, None, events, pulses, sigma_ticks, everywhere=source == "subgroup")


def _live(
    arrays: dict[str, np.ndarray], events: Events, config: Config, source: str, frame: int | None
) -> tuple[Callable[[int], np.ndarray], np.ndarray | None]:
    """Return the shares of the periods in which a subgroup's histograms could grow (`pixel_peaks`), and the groups of them."""
    sensor = config.sensor
    if source != "minigroup" or not config.frame.minigroup_records:
        return live_share(arrays, events, config, frame).__getitem__, None
    stamp, maps, bounds = frame_records(arrays, config, frame)
    stored, dropped = (
        arrays[name][slice(frame, frame + 1) if frame is not None else slice(None)]
        for name in ("mg_stored", "mg_dropped")
    )
    lost = (stored + dropped).sum(axis=0) / np.maximum(stored.sum(axis=0), 1)
    periods = config.pulses * len(stored)

    def of_records(s: int) -> np.ndarray:
        here = slice(bounds[s], bounds[s + 1])
        return record_live((stamp[here], maps[here]), lost[s], sensor, config.period_ticks, periods)

    return of_records, pixel_table(sensor).minigroup
