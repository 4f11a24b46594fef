# SPDX-License-Identifier: Apache-2.0
"""Histograms of a sensor's events, for each pixel from the ID map, the minigroup stamps, or the subgroup's stamp alone.

Ref: paper III-A (stamp, ID map, minigroup stamps), IV (a histogram per pixel). Bins are ticks of the arrival time
(`arrivals.py`).
"""

from collections.abc import Callable, Iterator

import numpy as np
from attrs import frozen

from ..contract.config import Config
from ..contract.packet import BEAT_BITS
from ..contract.parameters import OFFSET_NONE, Sensor
from ..contract.pixels import Pixels, pixel_table
from ..shared.compiled import njit, part
from ..shared.errors import InputError, check_integer
from ..shared.quantities import check_choice
from .arrivals import SYSTEM_FWHM_S, arrival_ticks, lead_sigmas, photons_of, pulse_sigma_ticks

SOURCES = {
    "map": "the subgroup's stamp, for the pixels of the ID map",
    "minigroup": "each minigroup's own coarse stamp, for its pixels: minigroup records or the offsets of full events",
    "subgroup": "the subgroup's stamp, for all its pixels",
}


@frozen(eq=False)
class Events:
    """Events of one frame or of all frames, ordered by subgroup; rows of subgroup s: bounds[s] to bounds[s + 1].

    stamp, count: int64[n]. arrival: float64[n], ticks. hits: uint64[n, words]. offset: uint8[n, minigroups], without
    columns if the format has no offsets. Per subgroup: threshold, window (ticks; both 1 if coincidence is off), int64;
    photon_rate: float64, photons per tick while the tree is armed, mostly background.
    """

    bounds: np.ndarray
    pulse: np.ndarray
    stamp: np.ndarray
    count: np.ndarray
    winner: np.ndarray
    overrun: np.ndarray
    arrival: np.ndarray
    mapped: bool
    hits: np.ndarray
    offset: np.ndarray
    threshold: np.ndarray
    window: np.ndarray
    photon_rate: np.ndarray
    opened: np.ndarray
    committed: np.ndarray

    def maps(self, subgroup: int, pixels: int) -> np.ndarray:
        """Return the ID maps of a subgroup's events as bool[n, pixels]."""
        hits = np.ascontiguousarray(self.hits[self.bounds[subgroup] : self.bounds[subgroup + 1]], "<u8")
        return np.unpackbits(hits.view(np.uint8), axis=1, bitorder="little")[:, :pixels].astype(bool)


def frame_events(arrays: dict[str, np.ndarray], config: Config, sigma_ticks: float, frame: int | None = None) -> Events:
    """Return the events of a result (`result.py`) in one frame, or in all frames (None).

    Without an ID map (format short), the map of an event holds only its winner. Raises `InputError` if the result has no
    such frame.
    """
    frames = len(arrays["opened"])
    if frame is not None and not 0 <= frame < frames:
        raise InputError(f"frame = {frame}: must be an integer from 0 to {frames - 1}")
    chosen = np.ones(len(arrays["pulse"]), bool) if frame is None else arrays["pulse"] // config.pulses == frame
    row = np.flatnonzero(chosen)
    row = row[np.argsort(arrays["subgroup"][row], kind="stable")]
    subgroup, stamp, count = (arrays[name][row] for name in ("subgroup", "stamp", "count"))
    counted = slice(None) if frame is None else slice(frame, frame + 1)
    window = np.where(config.coincidence, config.window, 1)
    return Events(
        bounds=np.searchsorted(subgroup, np.arange(config.sensor.subgroups + 1)),
        pulse=arrays["pulse"][row],
        stamp=stamp,
        count=count,
        winner=arrays["winner"][row],
        overrun=arrays["overrun"][row].astype(bool),
        arrival=arrival_ticks(subgroup, stamp, count, config, sigma_ticks),
        mapped="hits" in arrays,
        hits=arrays["hits"][row] if "hits" in arrays else _winner_map(arrays["winner"][row], config.sensor),
        offset=arrays["mg_offset"][row] if "mg_offset" in arrays else np.empty((len(row), 0), np.uint8),
        threshold=np.where(config.coincidence, arrays["threshold_used"][counted].min(axis=0), 1),
        window=window,
        opened=arrays["opened"][counted].sum(axis=0),
        committed=arrays["committed"][counted].sum(axis=0),
        photon_rate=_photon_rate(arrays["opened"][counted].mean(axis=0) / config.pulses, window, config),
    )


def _winner_map(winner: np.ndarray, sensor: Sensor) -> np.ndarray:
    """uint64[n, words]: maps that hold only the winner."""
    hits = np.zeros((len(winner), -(-sensor.pixels // BEAT_BITS)), np.uint64)
    hits[np.arange(len(winner)), winner // BEAT_BITS] = np.uint64(1) << (winner % BEAT_BITS).astype(np.uint64)
    return hits


def _photon_rate(opened: np.ndarray, window: np.ndarray, config: Config) -> np.ndarray:
    """Estimate the photons per tick of an armed tree, from the windows per period; it is not armed after each window."""
    sensor = config.sensor
    blocked = window + (sensor.phases - 1) / 2 + sensor.rearm * sensor.phases  # ticks until the tree is armed, a mean
    cycles = np.minimum(np.where(config.gating, config.gate_len, config.period), config.period - sensor.guard)
    armed = cycles * sensor.phases - opened * blocked
    return opened / np.maximum(armed, 1)


def subgroup_histograms(
    arrays: dict[str, np.ndarray], config: Config, sigma_ticks: float, *, source: str = "map", frame: int | None = None
) -> Iterator[np.ndarray]:
    """Yield the histograms of each subgroup's pixels, int32[pixels, period_ticks]; only one subgroup is held in memory."""
    return map(_histogram_maker(arrays, config, sigma_ticks, source, frame), range(config.sensor.subgroups))


def pixel_histogram(
    arrays: dict[str, np.ndarray],
    config: Config,
    pixel: int,
    *,
    source: str = "map",
    frame: int | None = None,
    system_fwhm_s: float = SYSTEM_FWHM_S,
) -> np.ndarray:
    """Return the histogram of one pixel.

    Parameters
    ----------
    arrays : dict of str to numpy.ndarray
        The arrays of a result.
    config : Config
        The configuration of the run.
    pixel : int
        row * cols + col.
    source, frame, system_fwhm_s
        As in `estimate_depth`.

    Returns
    -------
    numpy.ndarray
        int32[period_ticks], hits per tick.

    Raises
    ------
    InputError
        If the pixel or the frame does not exist.
    """
    table = pixel_table(config.sensor)
    check_integer("pixel", pixel, 0, config.sensor.array_pixels - 1)
    of_subgroup = _histogram_maker(arrays, config, pulse_sigma_ticks(config, system_fwhm_s), source, frame)
    return of_subgroup(table.subgroup[pixel])[table.inside[pixel]]


def _histogram_maker(
    arrays: dict[str, np.ndarray], config: Config, sigma_ticks: float, source: str, frame: int | None
) -> Callable[[int], np.ndarray]:
    """Return a function that makes the histograms of a subgroup's pixels, int32[pixels, period_ticks].

    Raises `InputError`.
    """
    check_choice("source", source, tuple(SOURCES))
    sensor, events = config.sensor, frame_events(arrays, config, sigma_ticks, frame)
    if not events.mapped:
        raise InputError("hits: the result has no ID map, its format must be id or full")
    use_records = source == "minigroup" and config.frame.minigroup_records
    if source == "minigroup" and not use_records and not events.offset.shape[1]:
        raise InputError("mg_offset: the result has no minigroup stamps, it must have format full or minigroup_records")
    record_stamp, maps, bounds = frame_records(arrays, config, frame) if use_records else (np.empty(0),) * 3
    pixel = pixel_table(sensor)
    seen = np.arange(sensor.minigroup_pixels + 1)
    lead = sigma_ticks * lead_sigmas(np.maximum(photons_of(seen, sensor.minigroup_pixels), 1))

    def histogram_of(s: int) -> np.ndarray:
        histogram = np.zeros((sensor.pixels, config.period_ticks), np.int32)
        span = slice(events.bounds[s], events.bounds[s + 1])
        stamp, hits = events.stamp[span], events.hits[span]
        if source != "minigroup":
            bins = np.minimum(events.arrival[span].astype(np.int64), config.period_ticks - 1)
            _add_events(histogram, bins, hits, source == "subgroup")
        elif use_records:
            records = slice(bounds[s], bounds[s + 1])
            _add_records(histogram, record_stamp[records], maps[records], pixel, sensor.quarter_ticks, lead)
        else:
            steps = sensor.phases, sensor.offset_ticks
            _add_offsets(histogram, stamp, hits, events.offset[span], pixel, *steps, lead)
        return histogram

    return histogram_of


def minigroup_step_ticks(config: Config) -> int:
    """Return the ticks between the stamps of minigroups: those of the records, or the offsets of full events."""
    return config.sensor.quarter_ticks if config.frame.minigroup_records else config.sensor.offset_ticks


def pixel_image(values: np.ndarray, sensor: Sensor) -> np.ndarray:
    """Return [subgroups, pixels, ...] rearranged to [rows, cols, ...]."""
    table = pixel_table(sensor)
    return values[table.subgroup, table.inside].reshape(sensor.rows, sensor.cols, *values.shape[2:])


def by_subgroup(image: np.ndarray, sensor: Sensor) -> np.ndarray:
    """Return [rows, cols] rearranged to [subgroups, pixels]; the inverse of `pixel_image`."""
    table = pixel_table(sensor)
    values = np.empty((sensor.subgroups, sensor.pixels), image.dtype)
    values[table.subgroup, table.inside] = image.ravel()
    return values


def frame_records(
    arrays: dict[str, np.ndarray], config: Config, frame: int | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a frame's minigroup records by subgroup: stamps and maps [n, minigroups], bounds [subgroups + 1]."""
    chosen = np.ones(len(arrays["mg_pulse"]), bool) if frame is None else arrays["mg_pulse"] // config.pulses == frame
    row = np.flatnonzero(chosen)
    row = row[np.argsort(arrays["mg_subgroup"][row], kind="stable")]
    bounds = np.searchsorted(arrays["mg_subgroup"][row], np.arange(config.sensor.subgroups + 1))
    return arrays["mg_stamp"][row], arrays["mg_map"][row], bounds


@part
def is_hit(hits, e, i):
    """Return whether pixel i of the subgroup is in the map of event e. hits: uint64[n, words]."""
    return hits[e, i // BEAT_BITS] >> np.uint64(i % BEAT_BITS) & np.uint64(1) != 0


@njit
def hits_away(stamp, hits, bounds, time, near):
    """int64[subgroups, pixels]: each pixel's hits in events whose stamp is not `near` the pixel's time, or whose time is NaN."""
    number = np.zeros(time.shape, np.int64)
    for s in range(len(time)):
        of_subgroup, times = number[s], time[s]
        for e in range(bounds[s], bounds[s + 1]):
            for i in range(len(times)):
                of_subgroup[i] += np.int64(is_hit(hits, e, i) and not abs(stamp[e] - times[i]) < near)
    return number


@njit
def _add_events(histogram: np.ndarray, bins: np.ndarray, hits: np.ndarray, everywhere: bool) -> None:
    """Count each event in its bin, for the pixels of its map or for all pixels."""
    for e in range(len(bins)):
        for i in range(len(histogram)):
            if everywhere or is_hit(hits, e, i):
                histogram[i, bins[e]] += 1


@njit
def _add_offsets(
    histogram: np.ndarray,
    stamp: np.ndarray,
    hits: np.ndarray,
    offset: np.ndarray,
    pixel: Pixels,
    phases: int,
    step: int,
    lead: np.ndarray,
) -> None:
    """Count each event at the first hit of the pixel's minigroup: the middle of the offset's step, moved later by `lead`."""
    pixels = len(histogram)
    seen = np.empty(offset.shape[1], np.int64)
    for e in range(len(stamp)):
        seen[:] = 0
        for i in range(pixels):
            seen[pixel.minigroup[i]] += np.int64(is_hit(hits, e, i))
        for i in range(pixels):
            g = pixel.minigroup[i]
            if is_hit(hits, e, i) and offset[e, g] != OFFSET_NONE:
                at = stamp[e] // phases * phases + step * (offset[e, g] + 0.5) + lead[seen[g]]
                histogram[i, min(np.int64(at), histogram.shape[1] - 1)] += 1


@njit
def _add_records(
    histogram: np.ndarray, stamp: np.ndarray, maps: np.ndarray, pixel: Pixels, quarter: int, lead: np.ndarray
) -> None:
    """Count each record's minigroups at the middle of their quarter cycle, moved later by `lead`, for their maps' pixels."""
    for k in range(len(stamp)):
        for i in range(len(histogram)):
            g = pixel.minigroup[i]
            seen = 0
            for bit in range(16):
                seen += maps[k, g] >> bit & 1
            if maps[k, g] >> pixel.bit[i] & 1:
                histogram[i, min(np.int64(quarter * (stamp[k, g] + 0.5) + lead[seen]), histogram.shape[1] - 1)] += 1
