# SPDX-License-Identifier: Apache-2.0
"""The measures of a frame: type, meaning and formula of each number, defined once.

The selection is our choice; `wrong_share` is that of the paper's Fig. 7.
"""

import math
from collections.abc import Callable
from typing import Protocol, TypeAlias

import numpy as np
from attrs import frozen

from ..model.contract.config import Config
from ..model.contract.groups import FIRST_PIXELS, PAYLOAD_BITS, group_widths
from ..model.contract.packet import BEAT_BITS, COUNTS, FORMATS, RECORD, layout
from ..model.depth.pulse_ticks import pulse_ticks
from ..model.depth.quality import (
    OTHER_SURFACE_M,
    TOLERANCE_M,
    off_surfaces,
    range_error,
    wrong_pixels,
    wrong_share,
)
from ..model.light.light import Light
from ..model.scenes.scene import Scene
from ..model.shared.constants import SUCCESS_TOLERANCE_S
from ..model.shared.pulse import Pulse
from .bound import median_light, usual_open_share, with_usual_threshold, word_bounds_mm
from .pace import LASER_MEAN_W, frame_s, frames_per_s, pulse_energy_j

Number: TypeAlias = int | float | None


class MeasuredRun(Protocol):
    """What measures read of the run of a frame (`outcomes.Run`)."""

    @property
    def result(self) -> dict[str, np.ndarray]: ...
    @property
    def pulse(self) -> Pulse | None: ...


class MeasuredFrame(Protocol):
    """What measures read of a frame (`outcomes.Frame`)."""

    @property
    def run(self) -> MeasuredRun: ...
    @property
    def scene(self) -> Scene: ...
    @property
    def config(self) -> Config: ...
    @property
    def edge_count(self) -> int: ...
    @property
    def result(self) -> dict[str, np.ndarray]: ...
    @property
    def events(self) -> np.ndarray: ...
    @property
    def beats(self) -> np.ndarray: ...
    @property
    def light(self) -> Light: ...
    @property
    def threshold(self) -> np.ndarray: ...
    @property
    def depth_m(self) -> np.ndarray: ...
    @property
    def truth_m(self) -> np.ndarray: ...
    def counter(self, name: str) -> np.ndarray: ...
    def knows(self, name: str) -> bool: ...
    def __getitem__(self, measure: str) -> Number: ...


@frozen
class Measure:
    """A number of one frame. kind: int or float. of: its formula, which returns None where it would
    divide by 0, or needs a counter that is at its end.
    """

    kind: type
    meaning: str
    of: Callable[[MeasuredFrame], Number]


def _total(frame: MeasuredFrame, counter: str) -> int | None:
    """Return the sum of a counter over all subgroups; None if it is not known."""
    return int(frame.counter(counter).sum()) if frame.knows(counter) else None


def _sum(counter: str) -> Callable[[MeasuredFrame], int | None]:
    return lambda frame: _total(frame, counter)


def _per(
    counter: str, whole: Callable[[MeasuredFrame], Number]
) -> Callable[[MeasuredFrame], Number]:
    """Return the formula of a counter per something of the frame; None if either is not known or
    there is nothing.
    """

    def share(frame: MeasuredFrame) -> Number:
        total, per = _total(frame, counter), whole(frame)
        return total / per if total is not None and per else None

    return share


def _wrong(tolerance_m: float) -> Callable[[MeasuredFrame], float | None]:
    return lambda frame: (
        wrong_share(frame.depth_m, frame.truth_m, tolerance_m) if _known(frame).any() else None
    )


def _off_surface(frame: MeasuredFrame) -> float | None:
    known = _known(frame)
    off = off_surfaces(frame.depth_m[known], frame.scene.surfaces_m[known])
    return float(off.mean()) if len(off) else None


def _known(frame: MeasuredFrame) -> np.ndarray:
    return ~np.isnan(frame.truth_m)


def _not(share: str) -> Callable[[MeasuredFrame], float | None]:
    def rest(frame: MeasuredFrame) -> float | None:
        value = frame[share]
        return None if value is None else 1 - value

    return rest


def _bound_mm(frame: MeasuredFrame) -> float | None:
    """Return the bound of a wall with the median light of the pixels that have some; None if there
    are no events of it, or its pulse is too short.
    """
    usual = median_light(frame.light)
    if usual is None or frame.config.counting:
        return None
    config = with_usual_threshold(frame.config, frame.threshold)
    pulse = pulse_ticks(config, pulse=frame.run.pulse)
    lit_share = usual_open_share(config, frame.light)
    lowest_mm = word_bounds_mm(config, *usual, pulse, lit_share).pixel_mm
    return lowest_mm if math.isfinite(lowest_mm) else None


def _per_s(words: str) -> Callable[[MeasuredFrame], float]:
    """Return the formula of words per second. Their number is always known."""
    return lambda frame: (
        int(frame.counter(words).sum()) * frame.config.clock_mhz * 1e6 / frame.config.frame_cycles
    )


def _depth_share(frame: MeasuredFrame) -> float | None:
    known = _known(frame)
    return int(np.sum(known & ~np.isnan(frame.depth_m))) / int(known.sum()) if known.any() else None


def _error(which: int, tolerance_m: float = np.inf) -> Callable[[MeasuredFrame], float | None]:
    """Return bias (0) or RMS (1) of the pixels that are not off by more than `tolerance_m`."""

    def error(frame: MeasuredFrame) -> float | None:
        near = _known(frame) & ~wrong_pixels(frame.depth_m, frame.truth_m, tolerance_m)
        value = range_error(frame.depth_m[near], frame.truth_m[near])[which]
        return None if np.isnan(value) else value

    return error


_PAPERS = f"{SUCCESS_TOLERANCE_S * 1e12:.0f} ps ({TOLERANCE_M * 100:.1f} cm)"
_FAR = f"{OTHER_SURFACE_M * 100:.0f} cm"
_SWEPT: dict[str, tuple[type, str, Callable[[MeasuredFrame], Number]]] = {
    "edges": (int, "avalanches of all SPADs", lambda frame: frame.edge_count),
    "opened": (int, "coincidence windows", _sum("opened")),
    "committed": (int, "windows that met their threshold", _sum("committed")),
    "rejected": (int, "windows that did not meet their threshold", _sum("rejected")),
    "events": (int, "committed windows that were stored and left the sensor", _sum("stored")),
    "dropped": (int, "committed windows that found their FIFO full", _sum("dropped")),
    "overruns": (
        int,
        "events with the overrun flag: gaps in a subgroup's events",
        lambda frame: int(frame.result["overrun"][frame.events].sum()),
    ),
    "blind_cycles": (
        int,
        "cycles with an edge between a window's end and the re-arming, over all subgroups",
        _sum("blind"),
    ),
    "photons": (int, "sum of the counts of all windows", _sum("photons")),
    "mg_records": (int, "minigroup records that left the sensor", _sum("mg_stored")),
    "mg_dropped": (int, "minigroup records that were dropped", _sum("mg_dropped")),
    "threshold_mean": (
        float,
        "threshold in pixels, mean of the subgroups",
        lambda frame: None if frame.config.counting else float(frame.threshold.mean()),
    ),
    "commits_per_pulse": (
        float,
        "committed windows of the sensor per laser pulse",
        _per("committed", lambda frame: frame.config.pulses),
    ),
    "dropped_share": (
        float,
        "share of the committed windows that were dropped",
        _per("dropped", lambda frame: _total(frame, "committed")),
    ),
    "beats": (int, "beats of all streams", lambda frame: int(frame.beats.sum())),
    "stream_load": (
        float,
        "beats of the busiest stream per cycle of the frame",
        lambda frame: float(frame.beats.max()) / frame.config.frame_cycles,
    ),
    "wrong_share": (
        float,
        f"share of pixels without depth, or off by more than {_PAPERS}",
        _wrong(TOLERANCE_M),
    ),
    "off_surface_share": (
        float,
        f"share of pixels without depth, or off by more than {_PAPERS} from every surface that they see",
        _off_surface,
    ),
    "depth_share": (float, "share of pixels with depth", _depth_share),
    "bias_m": (float, "mean error of range, pixels with depth", _error(0)),
    "rms_m": (float, "RMS error of range, pixels with depth", _error(1)),
    "right_bias_m": (
        float,
        "mean error of range, pixels that are not wrong",
        _error(0, TOLERANCE_M),
    ),
    "right_rms_m": (float, "RMS error of range, pixels that are not wrong", _error(1, TOLERANCE_M)),
}
_OTHERS: dict[str, tuple[type, str, Callable[[MeasuredFrame], Number]]] = {
    "bits": (int, "bits of all streams", lambda frame: BEAT_BITS * int(frame.beats.sum())),
    "link_load": (
        float,
        "beats of the busiest stream, as a share of those that its link takes during the frame",
        lambda frame: float(
            frame.beats.max() / (frame.config.frame_cycles * frame.config.link_share)
        ),
    ),
    "frames_per_s": (
        float,
        "frames per second if one begins as soon as the periods of the last one end",
        lambda frame: frames_per_s(frame.config),
    ),
    "mean_gbps": (
        float,
        "mean rate of the busiest stream's link over the frame with all waits, in Gbit/s",
        lambda frame: BEAT_BITS * float(frame.beats.max()) / frame_s(frame.config) * 1e-9,
    ),
    "pulse_nj": (
        float,
        f"energy of a laser pulse at a mean power of {LASER_MEAN_W * 1e3:g} mW, in nJ",
        lambda frame: pulse_energy_j(frame.config) * 1e9,
    ),
    "capacity_share": (
        float,
        "committed windows as a share of the controller's capacity, all streams",
        _per("committed", lambda frame: frame.config.capacity * frame.config.sensor.streams),
    ),
    "events_per_s": (
        float,
        "events that left the sensor per second of the frame",
        _per_s("stored"),
    ),
    "records_per_s": (
        float,
        "minigroup records that left the sensor per second of the frame",
        _per_s("mg_stored"),
    ),
    "right_share": (
        float,
        f"share of pixels with depth, off by at most {_PAPERS}",
        _not("wrong_share"),
    ),
    "wrong_share_15cm": (
        float,
        f"share of pixels without depth, or off by more than {_FAR}",
        _wrong(OTHER_SURFACE_M),
    ),
    "found_share": (
        float,
        f"share of pixels with depth, off by at most {_FAR}",
        _not("wrong_share_15cm"),
    ),
    "bound_mm": (
        float,
        "lowest RMS error of a pixel's distance from its own events, in mm, at the median light",
        _bound_mm,
    ),
    "found_rms_m": (
        float,
        f"RMS error of range, pixels that are off by at most {_FAR}",
        _error(1, OTHER_SURFACE_M),
    ),
}
SWEPT = tuple(_SWEPT)  # the columns of a sweep
MEASURES = {name: Measure(*rest) for name, rest in (_SWEPT | _OTHERS).items()}


def stream_beats(config: Config, events: np.ndarray, records: np.ndarray) -> np.ndarray:
    """Number[streams]: beats of a frame, including its start, end, counters and counts. With groups
    it is a mean (`event_beats`).

    events, records: number[subgroups], events and minigroup records that leave the sensor.
    """
    sensor, packets = config.sensor, layout(config.sensor)
    payload = events * event_beats(config) + records * packets.length(RECORD)
    at_end = packets.counter_beats
    if config.counting:
        at_end += sensor.minigroups * packets.length(COUNTS)
    subgroups = [sensor.stream_subgroups(stream) for stream in range(sensor.streams)]
    return np.array(
        [2 + payload[of_stream].sum() + len(of_stream) * at_end for of_stream in subgroups]
    )


def event_beats(config: Config) -> float:
    """Return the beats of an event. In groups it is a fraction of a beat: that of an event with
    three pixels, usual at threshold 2.
    """
    packet = FORMATS[config.format]
    if packet.grouped:
        return (
            group_widths(config.sensor).listed_bits(packet, config.period_ticks, FIRST_PIXELS)
            / PAYLOAD_BITS
        )
    return layout(config.sensor).length(packet)
