# SPDX-License-Identifier: Apache-2.0
"""Histograms of a sensor's events, for each pixel from the ID map, the minigroup stamps, or the
subgroup's stamp alone.

Ref: paper III-A (stamp, ID map, minigroup stamps), IV (a histogram per pixel). Bins are ticks of
the arrival time (`arrivals.py`).
"""

from collections.abc import Callable, Iterator
from functools import partial
from types import NoneType
from typing import NamedTuple

import numpy as np
from attrs import frozen

from ..contract.config import Config
from ..contract.packet import BEAT_BITS
from ..contract.parameters import OFFSET_NONE, Sensor
from ..contract.pixels import Pixels, pixel_table
from ..contract.result import check_arrays, check_frame, checked_events, known_counters
from ..shared.arguments import check_kind
from ..shared.compiled import njit, part
from ..shared.errors import InputError, check_integer
from ..shared.pulse import Pulse
from ..shared.quantities import check_choice
from .arrivals import SYSTEM_FWHM_S, arrival_ticks, photons_of
from .gates import open_share
from .pulse_ticks import PulseTicks, pulse_ticks

EVENT_ARRAYS = (  # of a result with events; it may have others
    "opened",
    "pulse",
    "subgroup",
    "stamp",
    "count",
    "winner",
    "threshold_used",
)
SOURCES = {
    "map": "the subgroup's stamp, for the pixels of the ID map",
    "minigroup": "each minigroup's own coarse stamp, for its pixels: "
    "minigroup records or the offsets of full events",
    "subgroup": "the subgroup's stamp, for all its pixels",
}

GOLDEN = (5**0.5 - 1) / 2  # its multiples fill the fractions evenly


@frozen(eq=False)
class Events:
    """Events of one frame or of all frames, by subgroup."""

    bounds: np.ndarray  # int64[subgroups + 1]: subgroup s has the rows bounds[s] to bounds[s + 1]
    pulse: np.ndarray  # int64[n]
    stamp: np.ndarray  # int64[n], ticks
    count: np.ndarray  # int64[n]
    winner: np.ndarray  # int64[n]
    overrun: np.ndarray  # bool[n]
    arrival: np.ndarray  # float64[n], ticks
    mapped: bool  # events have ID maps; if not, `hits` has only the winners
    hits: np.ndarray  # uint64[n, words], maps
    offset: np.ndarray  # uint8[n, minigroups], without columns if the format has no offsets
    threshold: np.ndarray  # int64[subgroups], pixels; 1 if coincidence is off
    window: np.ndarray  # int64[subgroups], ticks; 1 if coincidence is off
    photon_rate: np.ndarray  # float64[subgroups], photons per tick while the tree is armed
    opened: np.ndarray  # int64[subgroups], windows
    committed: np.ndarray  # int64[subgroups], windows that met the threshold

    def maps(self, subgroup: int, pixels: int) -> np.ndarray:
        """Return the ID maps of a subgroup's events as bool[n, pixels]."""
        rows = slice(self.bounds[subgroup], self.bounds[subgroup + 1])
        hits = np.ascontiguousarray(self.hits[rows], "<u8")
        bits = np.unpackbits(hits.view(np.uint8), axis=1, bitorder="little")
        return bits[:, :pixels].astype(bool)


def frame_events(
    arrays: dict[str, np.ndarray], config: Config, pulse: PulseTicks, frame: int | None = None
) -> Events:
    """Return the events of a result (`result.py`) in one frame, or in all frames (None).

    Without an ID map (format short), the map of an event holds only its winner. Raises `InputError`
    if the result has no such frame, or no events.
    """
    _check_events(config)
    check_arrays(arrays, *EVENT_ARRAYS)
    columns = checked_events(arrays, config)
    frame = check_frame(frame, len(columns["opened"]))
    row = _rows_by_subgroup(columns["pulse"], columns["subgroup"], config.pulses, frame)
    subgroup = columns["subgroup"][row]
    stamp = columns["stamp"][row]
    count = columns["count"][row]
    winner = columns["winner"][row]
    mapped = "hits" in columns
    hits = columns["hits"][row] if mapped else winner_map(winner, config.sensor)
    offset = np.empty((len(row), 0), np.uint8)
    if "mg_offset" in arrays:
        offset = arrays["mg_offset"][row]
    counted = slice(None) if frame is None else slice(frame, frame + 1)
    counters = known_counters(arrays, config).least
    opened = counters["opened"][counted]
    threshold = arrays["threshold_used"][counted].min(axis=0)
    window = np.where(config.coincidence, config.window, 1)
    return Events(
        bounds=np.searchsorted(subgroup, np.arange(config.sensor.subgroups + 1)),
        pulse=columns["pulse"][row],
        stamp=stamp,
        count=count,
        winner=winner,
        overrun=arrays["overrun"][row].astype(bool),
        arrival=arrival_ticks(subgroup, stamp, count, config, pulse.lead),
        mapped=mapped,
        hits=hits,
        offset=offset,
        threshold=np.where(config.coincidence, threshold, 1),
        window=window,
        photon_rate=_photon_rate(opened.mean(axis=0) / config.pulses, window, config),
        opened=opened.sum(axis=0),
        committed=counters["committed"][counted].sum(axis=0),
    )


def _check_events(config: Config) -> None:
    """Raise `InputError` if frames have counts in place of events."""
    if config.counting:
        raise InputError(
            "frame.format = 'counts': must be one of the formats of events here; the counts are in"
            " the arrays gate_cycle, gate_hits and count_pulses of the result",
            field="frame.format",
        )


def _rows_by_subgroup(
    pulse: np.ndarray, subgroup: np.ndarray, pulses: int, frame: int | None
) -> np.ndarray:
    """int64[n]: rows of a frame of so many pulses, or of all frames (None), by subgroup."""
    row = np.arange(len(pulse))
    if frame is not None:
        row = np.flatnonzero(pulse // pulses == frame)
    return row[np.argsort(subgroup[row], kind="stable")]


def winner_map(winner: np.ndarray, sensor: Sensor) -> np.ndarray:
    """uint64[n, words]: maps that hold only the winner."""
    hits = np.zeros((len(winner), -(-sensor.pixels // BEAT_BITS)), np.uint64)
    bit = (winner % BEAT_BITS).astype(np.uint64)
    hits[np.arange(len(winner)), winner // BEAT_BITS] = np.uint64(1) << bit
    return hits


def _photon_rate(opened: np.ndarray, window: np.ndarray, config: Config) -> np.ndarray:
    """Estimate the photons per tick of an armed tree, from the windows per period.

    It is not armed after each window.
    """
    sensor = config.sensor
    to_next_cycle = (sensor.phases - 1) / 2  # a mean
    blocked = window + to_next_cycle + sensor.rearm * sensor.phases  # ticks until the tree is armed
    usable = config.period - sensor.guard
    pulses = range(config.pulses)
    cycles = [open_share(config, s, pulses)[:usable].sum() for s in range(sensor.subgroups)]
    armed = np.array(cycles) * sensor.phases - opened * blocked
    return opened / np.maximum(armed, 1)


def subgroup_histograms(
    arrays: dict[str, np.ndarray],
    config: Config,
    pulse: PulseTicks,
    *,
    source: str = "map",
    frame: int | None = None,
    events: Events | None = None,
) -> Iterator[np.ndarray]:
    """Yield the histograms of each subgroup's pixels, int32[pixels, period_ticks].

    Only one subgroup is held in memory. events: `frame_events` of the same; None: not known yet.
    """
    of_subgroup = _histogram_maker(arrays, config, pulse, source, frame, events)
    return map(of_subgroup, range(config.sensor.subgroups))


def pixel_histogram(
    arrays: dict[str, np.ndarray],
    config: Config,
    pixel: int,
    *,
    source: str = "map",
    frame: int | None = None,
    system_fwhm_s: float = SYSTEM_FWHM_S,
    pulse: Pulse | None = None,
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
    source, frame, system_fwhm_s, pulse
        As in `estimate_depth`.

    Returns
    -------
    numpy.ndarray
        int32[period_ticks], hits per tick.

    Raises
    ------
    InputError
        If the pixel or the frame does not exist, or the format has no events.
    """
    check_arrays(arrays)
    check_kind("config", config, Config)
    check_kind("pulse", pulse, Pulse, NoneType)
    table = pixel_table(config.sensor)
    pixel = check_integer("pixel", pixel, 0, config.sensor.array_pixels - 1)
    shape = pulse_ticks(config, system_fwhm_s, pulse or Pulse.of_result(arrays))
    of_subgroup = _histogram_maker(arrays, config, shape, source, frame, None)
    return of_subgroup(table.subgroup[pixel])[table.inside[pixel]]


def _histogram_maker(
    arrays: dict[str, np.ndarray],
    config: Config,
    pulse: PulseTicks,
    source: str,
    frame: int | None,
    events: Events | None,
) -> Callable[[int], np.ndarray]:
    """Return a function that makes the histograms of a subgroup's pixels, int32[pixels,
    period_ticks].

    events: as in `subgroup_histograms`. Raises `InputError`.
    """
    _check_events(config)
    check_choice("source", source, tuple(SOURCES))
    if events is None:
        events = frame_events(arrays, config, pulse, frame)
    if not events.mapped:
        raise InputError("hits: the result has no ID map, its format must be id or full")
    if source == "minigroup" and pulse.times:
        raise InputError(
            "pulse: histograms of minigroup stamps (source minigroup) assume a Gaussian, the sources"
            " map and subgroup take a measured pulse",
            field="pulse",
        )
    if source != "minigroup":
        return partial(_of_events, events, config, source == "subgroup")
    pixels = config.sensor.minigroup_pixels
    photons = photons_of(np.arange(pixels + 1), pixels)
    lead = pulse.lead(np.maximum(photons, 1))
    if config.frame.minigroup_records:
        return partial(_of_records, frame_records(arrays, config, frame), config, lead)
    if events.offset.shape[1]:
        return partial(_of_offsets, events, config, lead)
    raise InputError(
        "mg_offset: the result has no minigroup stamps, "
        "it must have format full or minigroup_records"
    )


def _empty_histogram(config: Config) -> np.ndarray:
    """int32[pixels, period_ticks]: histograms of a subgroup's pixels without hits."""
    return np.zeros((config.sensor.pixels, config.period_ticks), np.int32)


def _of_events(events: Events, config: Config, everywhere: bool, s: int) -> np.ndarray:
    """Return the histograms of a subgroup by the events' arrival.

    Stamps are whole ticks, so most arrivals share a fraction of a tick. They are counted in the bins
    before and after them, in turn, as often as this fraction says, so that the mean is theirs.

    everywhere: each event hits each pixel.
    """
    histogram = _empty_histogram(config)
    span = slice(events.bounds[s], events.bounds[s + 1])
    turn = np.arange(span.stop - span.start) * GOLDEN % 1
    bins = np.floor(events.arrival[span] - 0.5 + turn).astype(np.int64)
    bins = np.clip(bins, 0, config.period_ticks - 1)
    _add_events(histogram, bins, events.hits[span], everywhere)
    return histogram


def _of_records(
    records: tuple[np.ndarray, np.ndarray, np.ndarray], config: Config, lead: np.ndarray, s: int
) -> np.ndarray:
    """Return the histograms of a subgroup by its minigroup records. lead: of `_add_offsets`."""
    histogram = _empty_histogram(config)
    stamp, maps, bounds = records
    span = slice(bounds[s], bounds[s + 1])
    pixel = pixel_table(config.sensor)
    _add_records(histogram, stamp[span], maps[span], pixel, config.sensor.quarter_ticks, lead)
    return histogram


def _of_offsets(events: Events, config: Config, lead: np.ndarray, s: int) -> np.ndarray:
    """Return the histograms of a subgroup by the offsets of its events. lead: of `_add_offsets`."""
    histogram = _empty_histogram(config)
    span = slice(events.bounds[s], events.bounds[s + 1])
    own = _OffsetEvents(events.stamp[span], events.hits[span], events.offset[span])
    sensor = config.sensor
    _add_offsets(histogram, own, pixel_table(sensor), sensor.phases, sensor.offset_ticks, lead)
    return histogram


def minigroup_step_ticks(config: Config) -> int:
    """Return the ticks between the stamps of minigroups: those of the records, or the offsets of
    full events.
    """
    if config.frame.minigroup_records:
        return config.sensor.quarter_ticks
    return config.sensor.offset_ticks


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
    """Return a frame's minigroup records by subgroup: stamps and maps [n, minigroups], bounds
    [subgroups + 1].
    """
    subgroup = arrays["mg_subgroup"]
    row = _rows_by_subgroup(arrays["mg_pulse"], subgroup, config.pulses, frame)
    bounds = np.searchsorted(subgroup[row], np.arange(config.sensor.subgroups + 1))
    return arrays["mg_stamp"][row], arrays["mg_map"][row], bounds


@part
def is_hit(hits: np.ndarray, e: int, i: int) -> bool:
    """Return whether pixel i of the subgroup is in the map of event e. hits: uint64[n, words]."""
    return hits[e, i // BEAT_BITS] >> np.uint64(i % BEAT_BITS) & np.uint64(1) != 0


@njit
def hits_away(
    stamp: np.ndarray, hits: np.ndarray, bounds: np.ndarray, time: np.ndarray, near: np.ndarray
) -> np.ndarray:
    """int64[subgroups, pixels]: each pixel's hits in events away from its time.

    stamp, hits, bounds: of `Events`. time: float64[subgroups, pixels], ticks; where it is NaN, all
    events count. near: float64[subgroups], ticks by which a stamp must differ.
    """
    number = np.zeros(time.shape, np.int64)
    for s in range(len(time)):
        of_subgroup = number[s]
        times = time[s]
        for e in range(bounds[s], bounds[s + 1]):
            for i in range(len(times)):
                away = not abs(stamp[e] - times[i]) < near[s]
                of_subgroup[i] += np.int64(is_hit(hits, e, i) and away)
    return number


@njit
def _add_events(
    histogram: np.ndarray, bins: np.ndarray, hits: np.ndarray, everywhere: bool
) -> None:
    """Count each event in its bin, for the pixels of its map or for all pixels."""
    for e in range(len(bins)):
        for i in range(len(histogram)):
            if everywhere or is_hit(hits, e, i):
                histogram[i, bins[e]] += 1


class _OffsetEvents(NamedTuple):
    """Events of a subgroup, with offsets."""

    stamp: np.ndarray  # int64[n], ticks
    hits: np.ndarray  # uint64[n, words]
    offset: np.ndarray  # uint8[n, minigroups]


@njit
def _add_offsets(
    histogram: np.ndarray,
    events: _OffsetEvents,
    pixel: Pixels,
    phases: int,
    step: int,
    lead: np.ndarray,
) -> None:
    """Count each event at the first hit of the pixel's minigroup, the middle of the offset's step.

    step: ticks per step. lead: float64[pixels of a minigroup + 1], ticks by which the hit is moved
    later, by the number of the minigroup's hits.
    """
    last_bin = histogram.shape[1] - 1
    seen = np.empty(events.offset.shape[1], np.int64)  # hits by minigroup
    for e in range(len(events.stamp)):
        cycle = events.stamp[e] // phases * phases
        seen[:] = 0
        for i in range(len(histogram)):
            seen[pixel.minigroup[i]] += np.int64(is_hit(events.hits, e, i))
        for i in range(len(histogram)):
            g = pixel.minigroup[i]
            offset = events.offset[e, g]
            if is_hit(events.hits, e, i) and offset != OFFSET_NONE:
                at = cycle + step * (offset + 0.5) + lead[seen[g]]
                histogram[i, min(np.int64(at), last_bin)] += 1


@njit
def _add_records(
    histogram: np.ndarray,
    stamp: np.ndarray,
    maps: np.ndarray,
    pixel: Pixels,
    quarter: int,
    lead: np.ndarray,
) -> None:
    """Count each record's minigroups at the middle of their quarter cycle, for their maps' pixels.

    stamp, maps: int64[n, minigroups]. quarter: its ticks. lead: as in `_add_offsets`.
    """
    last_bin = histogram.shape[1] - 1
    for k in range(len(stamp)):
        for i in range(len(histogram)):
            g = pixel.minigroup[i]
            seen = 0
            for bit in range(16):
                seen += maps[k, g] >> bit & 1
            if maps[k, g] >> pixel.bit[i] & 1:
                at = quarter * (stamp[k, g] + 0.5) + lead[seen]
                histogram[i, min(np.int64(at), last_bin)] += 1
