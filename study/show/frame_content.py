# SPDX-License-Identifier: Apache-2.0
"""The content of the views of a frame: maps, histograms, laser periods, numbers. Nothing is drawn
here.
"""

from functools import cached_property

import numpy as np
from attrs import frozen

from ...lab.bound import pixel_bounds_mm, with_usual_threshold
from ...lab.measures import SWEPT
from ...lab.outcomes import Frame
from ...model.contract.config import Config
from ...model.contract.pixels import pixel_table
from ...model.depth.counts import hits_as_events
from ...model.depth.histograms import Events, frame_events, pixel_image
from ...model.depth.pulse_ticks import PulseTicks, pulse_ticks
from ...model.depth.quality import wrong_pixels
from ...model.light.light import Light
from ...model.scenes.scene import Scene
from ...model.shared.errors import check_integer
from .timeline import Period, Timeline, frame_timeline, one_period

HISTOGRAM_BIN_M = 0.15  # for display; estimators work on ticks
LIGHT_SIGMAS = 4  # an event that is farther from every surface's arrival contains only background
# measures
SHOWN = (*SWEPT, "bits", "link_load", "wrong_share_15cm", "frames_per_s", "mean_gbps")
CANDIDATES = 4  # number of returns shown per pixel, the chosen one first


@frozen(kw_only=True)
class ObjectView:
    """Results of an object. distance_m, reflectivity: medians. signal: median of the photons per
    pixel and pulse.

    middle: (row, column) of the pixel that is nearest to its centre.
    """

    name: str
    pixels: int
    middle: tuple[int, int]
    distance_m: float
    reflectivity: float
    signal: float
    wrong_share: float


class FrameView:
    """One frame with the results of its estimator, ready for display.

    reason: uint8[rows, cols], `belief.Reason`. Maps, float64[rows, cols]: truth_m, depth_m, error_m
    (depth - truth) and confidence, NaN = none; threshold (pixels that a window of the subgroup
    needed) and drops (events that the subgroup's full FIFO dropped); reflectivity (NaN = no
    target); signal and background, mean photons that the pixel detects in a laser period; estimated
    and estimated_error, the signal of the first return as estimated, and its standard error;
    bound_mm, the lowest possible RMS error of the distance (`lab/bound.py`). events: in the format
    `counts`, each counted hit as an event of its pixel alone.
    candidate_m, candidate_confidence: float64[rows, cols, CANDIDATES]. numbers: measures
    (`lab/measures.py`), `sun_share`, and `counted`, the hits in gates. objects: see `seen_objects`.
    """

    def __init__(self, title: str, frame: Frame) -> None:
        run, config, scene = frame.run, frame.config, frame.scene
        found, light, shape = (
            frame.depth(CANDIDATES),
            frame.light,
            (config.sensor.rows, config.sensor.cols),
        )
        pulse = pulse_ticks(config, pulse=run.pulse)
        nearest = np.where(np.isnan(scene.distance_m), np.inf, scene.distance_m).argmin(axis=2)[
            :, :, None
        ]
        reflectivity = np.take_along_axis(scene.reflectivity, nearest, 2)[:, :, 0]
        self.title, self.config, self.edges, self.trace = title, config, frame.edges, frame.trace
        self.pulses_seen = frame.seen_edges.pulses  # the first pulses, whose edges are kept
        self.truth_m, self.depth_m, self.reason = (
            frame.truth_m,
            found.depth_m[:, :, 0],
            found.reason,
        )
        self.error_m = self.depth_m - self.truth_m
        self.candidate_m, self.candidate_confidence = found.depth_m, found.confidence
        self.confidence = np.where(np.isnan(self.depth_m), np.nan, found.confidence[:, :, 0])
        self.threshold = _of_subgroups(frame.threshold, config)
        self.drops = _of_subgroups(frame.counter("dropped"), config)
        self.reflectivity = np.where(scene.valid, reflectivity, np.nan)
        self.signal = light.total_signal.reshape(shape)
        self.estimated = _of_first(found.signal_per_pulse, shape)
        self.estimated_error = _of_first(found.signal_error, shape)
        self.bound_mm = np.full(shape, np.nan)  # it is that of events
        if not config.counting:
            usual = with_usual_threshold(config, frame.threshold)
            self.bound_mm = pixel_bounds_mm(usual, light, frame.run.pulse).reshape(shape)
        self.background = light.total_background_cps.reshape(shape) * (
            config.period_ticks * config.tick_s
        )
        if config.counting:
            self.events = hits_as_events(frame.result, config, frame.number)
        else:
            self.events = frame_events(frame.result, config, pulse, frame.number)
        self.numbers = {name: frame[name] for name in SHOWN}
        sun_share = None if config.counting else _sun_share(self.events, scene, config, pulse)
        self.numbers["sun_share"] = sun_share
        self.numbers["counted"] = len(self.events.stamp) if config.counting else None
        self.objects = seen_objects(scene, light, self.depth_m)

    @property
    def range_m(self) -> float:
        """Range of a laser period in metres."""
        return self.config.period_ticks * self.config.tick_m

    def subgroup_of(self, row: int, col: int) -> int:
        """Return the subgroup of a pixel. Raises `InputError`."""
        sensor = self.config.sensor
        row = check_integer("row", row, 0, sensor.rows - 1)
        col = check_integer("col", col, 0, sensor.cols - 1)
        return int(pixel_table(sensor).subgroup[row * sensor.cols + col])

    @cached_property
    def timeline(self) -> Timeline:
        """All periods of all subgroups; computed on first use, because this takes long in long
        frames.
        """
        return frame_timeline(self.config, self.edges, self.trace)

    def period(self, subgroup: int, pulse: int) -> Period:
        """Return one laser period of one subgroup. Raises `InputError`."""
        pulse = check_integer("pulse", pulse, 0, self.pulses_seen - 1)
        return one_period(self.config, self.edges, self.trace, subgroup, pulse)

    def event_bins(self) -> np.ndarray:
        """int64[events]: the histogram bin of each event's arrival."""
        return np.minimum(
            self.events.arrival * self.config.tick_m / HISTOGRAM_BIN_M,
            self.histogram_bins - 1,
        ).astype(np.int64)

    @property
    def histogram_bins(self) -> int:
        return int(np.ceil(self.range_m / HISTOGRAM_BIN_M))

    def histogram(self, row: int, col: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the events of the pixel and those of its subgroup, each int64[bins] of
        `HISTOGRAM_BIN_M`. Raises `InputError`.
        """
        subgroup = self.subgroup_of(row, col)
        inside = pixel_table(self.config.sensor).inside[row * self.config.sensor.cols + col]
        bins = self.event_bins()[self.events.bounds[subgroup] : self.events.bounds[subgroup + 1]]
        hit = self.events.maps(subgroup, self.config.sensor.pixels)[:, inside]
        return np.bincount(bins[hit], minlength=self.histogram_bins), np.bincount(
            bins, minlength=self.histogram_bins
        )


def _of_first(values: np.ndarray | None, shape: tuple[int, int]) -> np.ndarray:
    """float64[rows, cols]: values of the first returns, NaN if there are none."""
    return np.full(shape, np.nan) if values is None else values[:, :, 0]


def _of_subgroups(values: np.ndarray, config: Config) -> np.ndarray:
    """float64[rows, cols] from one value per subgroup."""
    sensor = config.sensor
    return pixel_image(
        np.broadcast_to(values[:, None], (sensor.subgroups, sensor.pixels)), sensor
    ).astype(np.float64)


def _sun_share(events: Events, scene: Scene, config: Config, pulse: PulseTicks) -> float | None:
    """Return the share of the events that arrived when no visible surface sends light back; None
    without events.
    """
    subgroup_of = pixel_table(config.sensor).subgroup
    arrival = scene.distance_m.reshape(config.sensor.array_pixels, -1) / config.tick_m
    reach = pulse.reach if pulse.times else LIGHT_SIGMAS * pulse.sigma
    alone = 0
    for s in range(config.sensor.subgroups):
        light = np.unique(arrival[subgroup_of == s])
        light = np.concatenate([[-np.inf], light[~np.isnan(light)], [np.inf]])
        at = events.arrival[events.bounds[s] : events.bounds[s + 1]]
        after = np.searchsorted(light, at)
        alone += int(np.sum(np.minimum(at - light[after - 1], light[after] - at) > reach))
    return alone / len(events.stamp) if len(events.stamp) and scene.transient is None else None


def _middle(here: np.ndarray) -> tuple[int, int]:
    """Return the (row, column) of the pixel in `here`, bool[rows, cols], that is nearest to the
    mean position.
    """
    at = np.argwhere(here)
    row, col = at[np.square(at - at.mean(axis=0)).sum(axis=1).argmin()]
    return int(row), int(col)


def seen_objects(scene: Scene, light: Light, depth_m: np.ndarray) -> list[ObjectView]:
    """Return the objects, the darkest first.

    A scene without objects is split in two: the pixels with at most the median signal, and those
    with more.
    """
    truth_m, valid = scene.truth_m, scene.valid
    signal = light.total_signal.reshape(valid.shape)
    labels = np.where(valid, scene.labels, -1)
    names = {label: f"object {label}" for label in np.unique(labels[valid])}
    if len(names) < 2 and valid.any() and np.ptp(signal[valid]) > 0:
        labels = np.where(valid, signal > np.median(signal[valid]), -1)
        names = {0: "darker half", 1: "brighter half"}
    wrong = wrong_pixels(depth_m, truth_m)
    reflectivity = np.nanmax(
        np.where(valid[:, :, None], scene.reflectivity, np.nan), axis=2, initial=0
    )
    found = []
    for label, name in names.items():
        here = labels == label
        if here.any():
            found.append(
                ObjectView(
                    name=name,
                    pixels=int(here.sum()),
                    middle=_middle(here),
                    distance_m=float(np.median(truth_m[here])),
                    reflectivity=float(np.median(reflectivity[here])),
                    signal=float(np.median(signal[here])),
                    wrong_share=float(wrong[here].mean()),
                )
            )
    return sorted(found, key=lambda one: one.signal)
