# SPDX-License-Identifier: Apache-2.0
"""This sensor and its rivals (`rivals.py`) on the same photons: the depth, and the bits that it takes.

All schemes share the edges, the macro-pixels, and the estimator, a matched filter on every pixel's histogram. Schemes with
a window and threshold use the same ones; those that send words have the same FIFOs and stream; those that keep histograms
have the same memory (`MEMORY_BITS`). The estimator of planes is also shown for schemes whose words it can model.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..lab.run import Run
from ..lab.setup import SETTLING, Setup
from ..model.contract.packet import BEAT_BITS, FORMATS, layout
from ..model.depth.arrivals import pulse_sigma_ticks
from ..model.depth.histograms import pixel_image
from ..model.depth.peaks import APART_SIGMAS, NEAR_SIGMAS, pixel_peaks
from ..model.light.light import Light
from ..model.scenes.scene import Scene
from ..model.shared.constants import SPEED_OF_LIGHT_M_S
from . import rivals

THRESHOLD, PULSES, RETURNS = 3, 100, 2
FRAMES = SETTLING + 1  # the controller settles in the others; the last one counts
ADDER_S = 1e-9  # clock of the adder
FINE_S = 250e-12  # bins of the count-weighted histogram
MEMORY_BITS = 32_000  # per macro-pixel, for its histogram
NEAR_BINS = 1  # around the peak of a coarse histogram, from which its centre is computed


class Shot:
    """Photons for all schemes. run: this sensor's, of all frames; photons: of the last one, by macro-pixel."""

    def __init__(self, run: Run) -> None:
        self.run, self.config = run, run.config
        self.photons = rivals.macro_pixels(run.frame_edges(-1), run.config.sensor, run.config.pulses)
        self.window, self.threshold = int(self.config.window[0]), int(self.config.threshold[0])
        self.sigma_ticks = pulse_sigma_ticks(self.config)


class Found(NamedTuple):
    """Result of a scheme. depth_m: float64[rows, cols, RETURNS], the likeliest first. bits: sent off the chip per frame."""

    depth_m: np.ndarray
    bits: int


def compared(
    seen: Scene | Light, threshold: int = THRESHOLD, frame: dict[str, Any] | None = None, **fields: Any
) -> Setup:
    """Return `FRAMES` frames on a sensor of the size of `seen`; otherwise the silicon preset. fields: of `Setup`."""
    return Setup.of(
        sensor={"rows": seen.rows, "cols": seen.cols},
        frame={"pulses": PULSES, "frames": FRAMES} | (frame or {}),
        subgroup={"threshold": threshold},
        **{"scene" if isinstance(seen, Scene) else "light": seen} | fields,
    )


def _winner_takes_all(shot: Shot) -> Found:
    words = rivals.winner_takes_all(shot.photons, shot.config.sensor.phases)
    return _by_words(shot, words, words.stamp + 0.5, "short")


def _sliding_window(shot: Shot) -> Found:
    words = rivals.sliding_window(shot.photons, shot.window, shot.threshold)
    return _by_words(shot, words, words.stamp + 0.5, "id")


def _fixed_windows(shot: Shot) -> Found:
    words = rivals.fixed_windows(shot.photons, shot.window, shot.threshold)
    return _by_words(shot, words, rivals.counted_arrival(shot.photons, words, shot.sigma_ticks), "id")


def _last_hit(shot: Shot) -> Found:
    words = rivals.last_hit(shot.photons)
    return _by_words(shot, words, words.stamp + 0.5, "short")


def _photon_counts(shot: Shot) -> Found:
    clock = round(ADDER_S / shot.config.tick_s)
    return _by_memory(shot, rivals.photon_counts(shot.photons, clock, -(-shot.config.period_ticks // clock)), clock)


def _count_weighted(shot: Shot) -> Found:
    width = round(FINE_S / shot.config.tick_s)
    words = rivals.windows(shot.photons, shot.window, shot.config.sensor.phases)
    arrival = rivals.counted_arrival(shot.photons, words, shot.sigma_ticks)
    return _by_memory(
        shot, rivals.count_weighted(shot.photons, words, arrival, width, -(-shot.config.period_ticks // width)), width
    )


def _this(shot: Shot, subgroup: dict[str, Any], estimator: str = "matched", **frame: Any) -> Found:
    run = shot.run.but(subgroup=subgroup, frame=frame)
    if not run.config.auto.any():  # then frames do not depend on earlier ones
        run = run.alone(-1)
    last = run.frame(estimator=estimator)
    return Found(last.depth(RETURNS).depth_m, int(last["bits"] or 0))


SCHEMES: dict[str, Callable[[Shot], Found]] = {
    "winner takes all": _winner_takes_all,
    "sliding window": _sliding_window,
    "fixed windows": _fixed_windows,
    "last hit": _last_hit,
    "photon counts": _photon_counts,
    "count-weighted": _count_weighted,
    "this: fixed": lambda shot: _this(shot, {}),
    "this: controller": lambda shot: _this(shot, {"auto": True}),
    "this: pooled": lambda shot: _this(shot, {}, "matched/subgroup"),
    "this: minigroups": lambda shot: _this(shot, {}, "matched/minigroup", minigroup_records=True),
    "winner: planes": lambda shot: _this(shot, {"coincidence": False}, "planes", format="short"),
    "this: fixed planes": lambda shot: _this(shot, {}, "planes"),
    "this: controller planes": lambda shot: _this(shot, {"auto": True}, "planes"),
}


def schemes(run: Run, names: Sequence[str] = tuple(SCHEMES)) -> dict[str, Found]:
    """Return the result of each scheme on the same photons."""
    shot = Shot(run)
    return {name: SCHEMES[name](shot) for name in names}


def _by_words(shot: Shot, words: rivals.Words, arrival: np.ndarray, form: str) -> Found:
    """Return depth from the words that the stream carries; `form`: format of this sensor with packets of the same length."""
    config, sensor = shot.config, shot.config.sensor
    beats = layout(sensor).length(FORMATS[form])
    sent = rivals.read_out(shot.photons, words, sensor, sensor.phases, config.period, beats)
    histograms = rivals.pixel_histograms(shot.photons, words.chosen(sent), arrival[sent], sensor, config.period_ticks)
    ticks = np.stack(
        [pixel_peaks(histogram, "matched", None, shot.sigma_ticks, RETURNS)[0] for histogram in histograms]
    )
    return Found(_metres(shot, pixel_image(ticks, sensor)), int(sent.sum()) * beats * BEAT_BITS)


def _by_memory(shot: Shot, histogram: np.ndarray, width: int) -> Found:
    """Return depth from one histogram per macro-pixel, in bins of `width` ticks: all its pixels get the same depth."""
    sensor = shot.config.sensor
    bits = histogram.shape[1] * (shot.photons.pulses * sensor.pixels).bit_length()
    if bits > MEMORY_BITS:
        raise ValueError(f"a histogram of {bits} bits, the memory holds {MEMORY_BITS}")
    ticks = coarse_peaks(histogram, width, shot.sigma_ticks)
    return Found(
        _metres(shot, pixel_image(np.repeat(ticks[:, None], sensor.pixels, axis=1), sensor)), bits * sensor.subgroups
    )


def coarse_peaks(histogram: np.ndarray, width: int, sigma_ticks: float) -> np.ndarray:
    """float64[n, RETURNS]: peaks in ticks of int64[n, bins] of `width` ticks.

    Peaks are the highest bins above the median, with the centre computed over their neighbours. Bins narrower than the
    pulse are first filtered with it; returns are as far apart as those of a pixel (`peaks.py`).
    """
    excess = histogram - np.median(histogram, axis=1, keepdims=True)
    near, apart = (max(NEAR_BINS, math.ceil(sigmas * sigma_ticks / width)) for sigmas in (NEAR_SIGMAS, APART_SIGMAS))
    left = (
        np.apply_along_axis(np.convolve, 1, excess, _pulse_shape(sigma_ticks / width), "same")
        if sigma_ticks > width / 2
        else excess.copy()
    )
    ticks = np.full((len(histogram), RETURNS), np.nan)
    for row in range(len(histogram)):
        for k in range(RETURNS):
            at = int(left[row].argmax())
            here = slice(max(0, at - near), at + near + 1)
            weight = np.maximum(excess[row, here], 0)
            if left[row, at] <= 0:
                break
            bins = np.arange(len(left[row]))[here] + 0.5
            ticks[row, k] = width * (np.average(bins, weights=weight) if weight.any() else at + 0.5)
            left[row, max(0, at - apart) : at + apart + 1] = 0
    return ticks


def _pulse_shape(sigma: float) -> np.ndarray:
    at = np.arange(-round(4 * sigma), round(4 * sigma) + 1)
    return np.exp(-0.5 * (at / sigma) ** 2)


def _metres(shot: Shot, ticks: np.ndarray) -> np.ndarray:
    return ticks * shot.config.tick_s * SPEED_OF_LIGHT_M_S / 2
