# SPDX-License-Identifier: Apache-2.0
"""Estimation of depth from a sensor's events, or from its counts.

Ref: paper IV (a histogram per pixel, and its peak), Fig. 7 (tolerance of a right pixel). The
other methods are our own choice.
"""

from collections.abc import Callable
from functools import partial
from types import NoneType
from typing import NamedTuple, Protocol

import numpy as np
from attrs import evolve

from ..contract.config import Config
from ..contract.pixels import pixel_table
from ..contract.result import check_arrays, check_frame, known_counters
from ..shared.arguments import check_kind, check_workers
from ..shared.constants import SUCCESS_TOLERANCE_S
from ..shared.errors import InputError, check_integer
from ..shared.pulse import Pulse
from ..shared.quantities import check_choice
from ..shared.threads import Threads
from .arrivals import SYSTEM_FWHM_S, pulse_sigma_ticks
from .belief import Signs, believe, find_signs
from .clusters import forget_clusters
from .count_likelihood import Seen
from .counts import GateCounts, count_intensity, count_signs, gate_counts, seen_behind
from .counts import find_surfaces as find_in_counts
from .depth import Depth
from .gates import open_share_by_tick
from .histograms import (
    Events,
    frame_events,
    frame_records,
    minigroup_step_ticks,
    pixel_image,
    subgroup_histograms,
)
from .intensity import Intensity, find_intensity
from .methods import (
    DEFAULT_METHOD,
    DEFAULT_SOURCE,
    Estimator,
    Method,
    Reading,
    check_counting,
    check_no_source,
    chosen_method,
)
from .peaks import hit_shares, live_share, pixel_peaks, record_live
from .planes import find_surfaces
from .pulse_ticks import PulseTicks, pulse_ticks

RETURNS_MAX = 8
PLANES = "planes"
PEAKS = ("maximum", "matched", "background")  # methods of `pixel_peaks`


def estimate_depth(
    arrays: dict[str, np.ndarray],
    config: Config,
    *,
    method: Method = DEFAULT_METHOD,
    source: str = DEFAULT_SOURCE,
    frame: int | None = None,
    returns: int = 1,
    workers: int | None = None,
    system_fwhm_s: float = SYSTEM_FWHM_S,
    pulse: Pulse | None = None,
) -> Depth:
    """Estimate the distance of every pixel from the sensor's output.

    Parameters
    ----------
    arrays : dict of str to numpy.ndarray
        The arrays of a result, as `Run.result` or `read_result` has them.
    config : Config
        The configuration of the run.
    method : str or Estimator
        `planes` (default), `maximum` (the paper's highest bin), `matched` or `background`; see
        docs/depth.md. With the format `counts`, there is only `planes`. Or an estimator of your own, or the name under which it is registered; see
        docs/extend.md.
    source : str
        Origin of a pixel's histogram: `map`, `minigroup` or `subgroup`. `planes` always uses all
        parts of an event.
    frame : int or None
        Use the events of this frame only; None uses all of them.
    returns : int
        Number of surfaces per pixel, 1 to 8.
    workers : int or None
        Threads; None is one per core. The number does not change the result.
    system_fwhm_s : float
        FWHM of laser pulse and jitter combined, in seconds, of a Gaussian.
    pulse : Pulse or None
        Measured shape of laser pulse and jitter combined, instead of that Gaussian. None: that of
        the result (docs/files.md), if it has one. `Pulse.gaussian` stands for a Gaussian in spite
        of it.

    Returns
    -------
    Depth

    Raises
    ------
    InputError
        If an argument is out of range.
    """
    check_arrays(arrays)
    check_kind("config", config, Config)
    check_kind("pulse", pulse, Pulse, NoneType)
    if workers is not None:
        check_workers(workers)
    chosen = chosen_method(method)
    if pulse is None:
        pulse = Pulse.of_result(arrays)
    if not isinstance(chosen, str):
        check_no_source(chosen.name, source)
        returns = check_integer("returns", returns, 1, RETURNS_MAX)
        check_arrays(arrays, "opened")
        frame = check_frame(frame, len(arrays["opened"]))
        pulse_sigma_ticks(config, system_fwhm_s)
        reading = Reading(
            arrays=_read(chosen, arrays),
            config=config,
            frame=frame,
            returns=returns,
            system_fwhm_s=system_fwhm_s,
            workers=workers,
            pulse=pulse,
        )
        own = _filled(chosen.name, chosen.estimate(reading), config, returns)
        if own.light is not None:
            return own
        return evolve(own, light=partial(_light_at, own.depth_m, reading, arrays))
    with Threads(workers) as threads:
        found = find_returns(
            arrays,
            config,
            chosen,
            source,
            frame,
            returns=returns,
            threads=threads,
            system_fwhm_s=system_fwhm_s,
            pulse=pulse,
        )
        signs = found.signs(config, threads)
    tick_m, confidence = config.tick_m, found.sure.copy()
    confidence[:, :, 0], reason = believe(signs, found.law)
    error_m, slope_m = (
        None if part is None else part * tick_m for part in (found.error, found.slope)
    )
    return Depth(
        depth_m=found.ticks * tick_m,
        confidence=confidence,
        reason=reason,
        error_m=error_m,
        slope_m=slope_m,
        light=partial(found.light, config, workers),
    )


def _read(estimator: Estimator, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the arrays that an estimator of a user's own reads. Raises `InputError` if the
    result lacks one.
    """
    for name in estimator.reads:
        check_choice(f"{estimator.name}.reads", name, tuple(arrays))
    return {name: arrays[name] for name in estimator.reads}


def _filled(name: str, found: Depth, config: Config, returns: int) -> Depth:
    """Return what an estimator of a user's own found, with NaN for the returns that it did not
    find.

    Raises `InputError` if it is no depth of the sensor's pixels.
    """
    if not isinstance(found, Depth):
        raise InputError(f"{name}.estimate: returned {type(found).__name__}, must be a Depth")
    pixels = (config.sensor.rows, config.sensor.cols)
    has = np.shape(found.depth_m)[2:]
    if len(has) != 1 or not 1 <= has[0] <= returns:
        shape = np.shape(found.depth_m)
        raise InputError(
            f"{name}.estimate: depth_m has shape {shape}, must be {pixels} and 1 to {returns} returns"
        )
    images = {"depth_m": (*pixels, *has), "confidence": (*pixels, *has), "reason": pixels}
    optional = {"slope_m": (*pixels, 2)}
    optional |= dict.fromkeys(("error_m", "signal_per_pulse", "signal_error"), (*pixels, *has))
    images |= {part: shape for part, shape in optional.items() if getattr(found, part) is not None}
    for part, shape in images.items():
        if np.shape(getattr(found, part)) != shape:
            raise InputError(
                f"{name}.estimate: {part} has shape {np.shape(getattr(found, part))}, must be {shape}"
            )
    missing = ((0, 0), (0, 0), (0, returns - has[0]))
    padded = partial(np.pad, pad_width=missing, constant_values=np.nan)
    error_m, signal, signal_error = found.error_m, found.signal_per_pulse, found.signal_error
    light = None
    if signal is not None and signal_error is not None:
        light = Intensity(signal=padded(signal), error=padded(signal_error))
    return Depth(
        depth_m=padded(found.depth_m),
        confidence=np.pad(found.confidence, missing),
        reason=found.reason,
        error_m=None if error_m is None else padded(error_m),
        slope_m=found.slope_m,
        light=light,
    )


def _light_at(depth_m: np.ndarray, reading: Reading, arrays: dict[str, np.ndarray]) -> Intensity:
    """Return the light at the distances that an estimator of a user's own found."""
    config = reading.config
    pulse = pulse_ticks(config, reading.system_fwhm_s, reading.pulse)
    ticks = depth_m / config.tick_m
    if config.counting:
        counts = gate_counts(arrays, config, reading.frame)
        return count_intensity(seen_behind(counts, config, pulse, ticks), config, pulse, ticks)
    events = frame_events(arrays, config, pulse, reading.frame)
    pulses = _pulses(arrays, config, reading.frame)
    with Threads(reading.workers) as threads:
        return find_intensity(events, config, pulse, pulses, ticks, threads)


def _pulses(arrays: dict[str, np.ndarray], config: Config, frame: int | None) -> int:
    """Return the number of pulses in which the events of a frame came, or of all frames (None)."""
    return config.pulses * (len(arrays["opened"]) if frame is None else 1)


class Found(Protocol):
    """What an estimator finds, in ticks: [rows, cols, returns], error and slope as in `Depth`.

    sure: as `confidence` of `Depth`, but as the estimator itself sees the first return. law: name of
    the law of confidence.
    """

    @property
    def ticks(self) -> np.ndarray: ...
    @property
    def sure(self) -> np.ndarray: ...
    @property
    def error(self) -> np.ndarray | None: ...
    @property
    def slope(self) -> np.ndarray | None: ...
    @property
    def law(self) -> str: ...

    def signs(self, config: Config, threads: Threads) -> Signs:
        """Return what speaks for and against the first returns."""
        ...

    def light(self, config: Config, workers: int | None) -> Intensity:
        """Return the light of the returns."""
        ...


class FoundInEvents(NamedTuple):
    """What an estimator finds in events.

    everywhere: all events of a subgroup count for each of its pixels.
    """

    ticks: np.ndarray
    sure: np.ndarray
    error: np.ndarray | None
    slope: np.ndarray | None
    events: Events
    pulses: int
    pulse: PulseTicks
    everywhere: bool
    law: str

    def signs(self, config: Config, threads: Threads) -> Signs:
        """Return what speaks for and against the first returns."""
        ticks, sure = self.ticks[:, :, 0], self.sure[:, :, 0]
        return find_signs(
            self.events,
            config,
            self.pulse.sigma,
            self.pulses,
            ticks,
            sure,
            self.everywhere,
            threads,
        )

    def light(self, config: Config, workers: int | None) -> Intensity:
        """Return the light of the returns."""
        with Threads(workers) as threads:
            return find_intensity(self.events, config, self.pulse, self.pulses, self.ticks, threads)


class FoundInCounts(NamedTuple):
    """What `planes` finds in counts."""

    ticks: np.ndarray
    sure: np.ndarray
    error: np.ndarray | None
    slope: np.ndarray | None
    light_there: np.ndarray  # float64[rows, cols], probability that gates have the surface's light
    counts: GateCounts
    seen: Seen
    pulse: PulseTicks
    law: str = "counts"

    def signs(self, config: Config, threads: Threads) -> Signs:  # noqa: ARG002 as of events
        """Return what speaks for and against the first returns."""
        ticks, sure = self.ticks[:, :, 0], self.sure[:, :, 0]
        return count_signs(
            self.counts, self.seen, config, self.pulse.sigma, ticks, sure, self.light_there
        )

    def light(self, config: Config, workers: int | None) -> Intensity:  # noqa: ARG002 as of events
        """Return the light of the returns."""
        return count_intensity(self.seen, config, self.pulse, self.ticks)


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
    pulse: Pulse | None = None,
) -> Found:
    """Find the returns of every pixel; the other arguments and errors as in `estimate_depth`."""
    check_choice("method", method, (PLANES, *PEAKS))
    returns = check_integer("returns", returns, 1, RETURNS_MAX)
    shape = pulse_ticks(config, system_fwhm_s, pulse)
    if config.counting:
        check_counting(method)
        counts = gate_counts(arrays, config, frame)
        found = find_in_counts(
            counts,
            config,
            shape,
            tolerance_ticks=SUCCESS_TOLERANCE_S / config.tick_s,
            returns=returns,
            threads=threads,
        )
        return FoundInCounts(*found[:5], counts, found.seen, shape)
    events = frame_events(arrays, config, shape, frame)
    pulses = _pulses(arrays, config, frame)
    if method == PLANES:
        parts = find_surfaces(
            events,
            config,
            shape,
            pulses,
            tolerance_ticks=SUCCESS_TOLERANCE_S / config.tick_s,
            returns=returns,
            threads=threads,
        )
        forget_clusters()  # another frame has others
        return FoundInEvents(*parts, events, pulses, shape, everywhere=False, law=method)
    live, group = (
        _live(arrays, events, config, source, frame) if method == "background" else (None, None)
    )
    hit_share = None
    if source == "minigroup":
        # The hits of an event's offsets come while its window is open, so nothing prevents them.
        hit_share = live if config.frame.minigroup_records else None
    elif method != "maximum":
        hit_share = hit_shares(arrays, events, config, shape, frame).__getitem__
    step_ticks = 1 if source != "minigroup" else minigroup_step_ticks(config)
    histograms = subgroup_histograms(
        arrays, config, shape, source=source, frame=frame, events=events
    )
    peaks = [
        pixel_peaks(
            histogram,
            method,
            live(s) if live else None,
            shape,
            returns,
            hit_share=hit_share(s) if hit_share else None,
            is_open=open_share_by_tick(config, s),
            group=group,
            step_ticks=step_ticks,
        )
        for s, histogram in enumerate(histograms)
    ]
    ticks, sure = (pixel_image(np.stack(part), config.sensor) for part in zip(*peaks, strict=True))
    sure = np.where(np.isnan(ticks), 0.0, sure)
    everywhere = source == "subgroup"
    return FoundInEvents(ticks, sure, None, None, events, pulses, shape, everywhere, law=method)


def _live(
    arrays: dict[str, np.ndarray], events: Events, config: Config, source: str, frame: int | None
) -> tuple[Callable[[int], np.ndarray], np.ndarray | None]:
    """Return the shares of the periods in which a subgroup's histograms could grow
    (`pixel_peaks`), and the groups of them.
    """
    sensor = config.sensor
    if source != "minigroup" or not config.frame.minigroup_records:
        return live_share(arrays, events, config, frame).__getitem__, None
    stamp, maps, bounds = frame_records(arrays, config, frame)
    counters = known_counters(arrays, config).least
    stored, dropped = (
        counters[name][slice(frame, frame + 1) if frame is not None else slice(None)]
        for name in ("mg_stored", "mg_dropped")
    )
    lost = (stored + dropped).sum(axis=0) / np.maximum(stored.sum(axis=0), 1)
    periods = config.pulses * len(stored)

    def of_records(s: int) -> np.ndarray:
        here = slice(bounds[s], bounds[s + 1])
        return record_live((stamp[here], maps[here]), lost[s], sensor, config.period_ticks, periods)

    return of_records, pixel_table(sensor).minigroup
