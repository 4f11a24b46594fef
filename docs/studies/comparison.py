# SPDX-License-Identifier: Apache-2.0
"""Compares this sensor with its rivals (`other_schemes.py`) on the same photons: their depth, and
the bits that they send.

All schemes share the edges and the macro-pixels. All schemes with a window and a threshold use the
same window and the same threshold. Schemes that send words have the same FIFOs and stream. Schemes
that store a histogram per macro-pixel have the same memory (`MEMORY_BITS`). Schemes that compress a
histogram per pixel send everything that they store. The estimator is a matched filter on every
pixel's histogram. Compressed histograms have an estimator of their own. Schemes that send words
which the estimator of planes can read use it, too.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from coincid.lab.outcomes import Run
from coincid.lab.setup import SETTLING, Setup
from coincid.model.contract.packet import BEAT_BITS, EVENT_FORMATS, layout
from coincid.model.contract.parameters import bits_for
from coincid.model.depth.histograms import pixel_image
from coincid.model.depth.peaks import APART_SIGMAS, pixel_peaks
from coincid.model.depth.pulse_ticks import NEAR_SIGMAS, pulse_ticks
from coincid.model.light.light import Light
from coincid.model.scenes.scene import Scene

from . import other_schemes

THRESHOLD, PULSES, RETURNS = 3, 100, 2
FRAMES = SETTLING + 1  # the last one counts; before it, the controller settles
ADDER_S = 1e-9  # clock period of the adder
MEMORY_BITS = 32_000  # per macro-pixel, for its histogram
PULSE_SIGMAS = 4.0  # margin that a zoom adds on either side of a bin
FINE_SIGMAS = 3.0  # widest bin that needs no further zoom
# Candidates for equi-depth histograms.
OFFSETS_SIGMAS, SIGNAL_SHARES = np.linspace(-1.8, 1.8, 9), (0.05, 0.1, 0.2, 0.4, 0.7)
NEAR_BINS = 1  # bins on either side of a coarse peak that its centre is computed from


class Shot:
    """Input of all schemes. run: all frames of this sensor; photons: those of the last frame, by
    macro-pixel.
    """

    def __init__(self, run: Run) -> None:
        self.run, self.config = run, run.config
        self.photons = other_schemes.macro_pixels(
            run.frame_edges(-1), run.config.sensor, run.config.pulses
        )
        self.window, self.threshold = int(self.config.window[0]), int(self.config.threshold[0])
        self.pulse = pulse_ticks(self.config)


class Found(NamedTuple):
    """Result of a scheme. depth_m: float64[rows, cols, RETURNS], the most likely first. bits: sent
    off the chip per frame.
    """

    depth_m: np.ndarray
    bits: int


def compared(
    seen: Scene | Light,
    threshold: int = THRESHOLD,
    frame: dict[str, Any] | None = None,
    **fields: Any,
) -> Setup:
    """Return the setup of `FRAMES` frames: the preset `silicon` with as many pixels as `seen`.
    fields: of `Setup`.
    """
    return Setup.of(
        sensor={"rows": seen.rows, "cols": seen.cols},
        frame={"pulses": PULSES, "frames": FRAMES} | (frame or {}),
        subgroup={"threshold": threshold},
        **{"scene" if isinstance(seen, Scene) else "light": seen} | fields,
    )


def _winner_takes_all(shot: Shot) -> Found:
    # the paper's scheme 1
    words = other_schemes.windows(shot.photons, 1, shot.config.sensor.phases)
    return _by_words(shot, words, words.stamp + 0.5, "short")


def _sliding_window(shot: Shot) -> Found:
    words = other_schemes.sliding_window(shot.photons, shot.window, shot.threshold)
    return _by_words(shot, words, words.stamp + 0.5, "id")


def _photon_counts(shot: Shot) -> Found:
    clock = round(ADDER_S / shot.config.tick_s)
    return _by_memory(
        shot,
        other_schemes.photon_counts(shot.photons, clock, -(-shot.config.period_ticks // clock)),
        clock,
    )


def _time_stamps(shot: Shot, most: int) -> Found:
    words = other_schemes.first_stamps(shot.photons, most)
    bits = len(words.stamp) * _stamp_bits(shot) + shot.config.sensor.array_pixels * bits_for(most)
    return _by_stamps(shot, words, words.stamp + 0.5, bits)


def _zoomed(shot: Shot, bins: int) -> Found:
    """Fill histograms in turn, each from a part of the pulses: first over the period, then around
    the highest bin.
    """
    period, pulses, pixels = (
        shot.config.period_ticks,
        shot.photons.pulses,
        shot.config.sensor.array_pixels,
    )
    margin = math.ceil(PULSE_SIGMAS * shot.pulse.sigma)
    widths = [-(-period // bins)]
    while widths[-1] > FINE_SIGMAS * shot.pulse.sigma:
        widths.append(-(-(widths[-1] + 2 * margin) // bins))
    begin = [number * pulses // len(widths) for number in range(len(widths) + 1)]
    start, counts = np.zeros(pixels, np.int64), np.empty(0)
    for number, width in enumerate(widths):
        if number:
            start += counts.argmax(axis=1) * widths[number - 1] - margin
            start = np.clip(start, 0, period - bins * width)
        counts = other_schemes.zoomed_counts(
            shot.photons, range(begin[number], begin[number + 1]), start, width, bins
        )
    # the last histogram, and its first tick
    bits = bins * bits_for(pulses - begin[-2]) + _stamp_bits(shot)
    return _of_pixels(
        shot, start[:, None] + coarse_peaks(counts, widths[-1], shot.pulse.sigma), bits
    )


def _fourier(shot: Shot, codes: int) -> Found:
    """Return the time at which a pulse, coded at the same frequencies, correlates best with the
    sums.
    """
    period, photons = shot.config.period_ticks, shot.photons
    sums = other_schemes.fourier_sums(photons, codes, period)
    pulse = np.exp(-0.5 * (2 * np.pi / period * np.arange(sums.shape[1]) * shot.pulse.sigma) ** 2)
    ticks = np.full((len(sums), RETURNS), np.nan)
    for part in (
        slice(first, first + photons.pixels) for first in range(0, len(sums), photons.pixels)
    ):
        ticks[part, 0] = np.fft.irfft(sums[part] * pulse, period).argmax(axis=1) + 0.5
    # with signs
    return _of_pixels(shot, ticks, codes * (1 + bits_for(other_schemes.CODE_MAX * photons.pulses)))


def _equi_depth(shot: Shot, bins: int) -> Found:
    """Return the most likely time of a pulse in uniform background. It is near one of the
    boundaries.
    """
    edges = other_schemes.equi_depth(shot.photons, bins, shot.config.period_ticks)
    background = np.maximum(np.diff(edges), 1) / shot.config.period_ticks
    best, ticks = np.full(len(edges), -np.inf), np.full((len(edges), RETURNS), np.nan)
    for boundary, offset, signal in product(range(1, bins), OFFSETS_SIGMAS, SIGNAL_SHARES):
        time = edges[:, boundary] + offset * shot.pulse.sigma
        pulse = np.diff(special.ndtr((edges - time[:, None]) / shot.pulse.sigma), axis=1)
        likelihood = np.log(signal * pulse + (1 - signal) * background).sum(axis=1)
        better = likelihood > best
        best[better], ticks[better, 0] = likelihood[better], time[better] + 0.5
    return _of_pixels(shot, ticks, (bins - 1) * _stamp_bits(shot))


def _this(shot: Shot, subgroup: dict[str, Any], estimator: str = "matched", **frame: Any) -> Found:
    run = shot.run.but(subgroup=subgroup, frame=frame)
    if not run.config.auto.any():  # then frames do not depend on earlier ones
        run = run.alone(-1)
    last = run.frame(estimator=estimator)
    return Found(last.depth(RETURNS).depth_m, int(last["bits"] or 0))


SCHEMES: dict[str, Callable[[Shot], Found]] = {
    "winner takes all": _winner_takes_all,
    "sliding window": _sliding_window,
    "photon counts": _photon_counts,
    "this: fixed": lambda shot: _this(shot, {}),
    "this: controller": lambda shot: _this(shot, {"auto": True}),
    "this: pooled": lambda shot: _this(shot, {}, "matched/subgroup"),
    "this: minigroups": lambda shot: _this(shot, {}, "matched/minigroup", minigroup_records=True),
    "winner: planes": lambda shot: _this(shot, {"coincidence": False}, "planes", format="short"),
    "this: fixed planes": lambda shot: _this(shot, {}, "planes"),
    "this: controller planes": lambda shot: _this(shot, {"auto": True}, "planes"),
    "this: fixed compact planes": lambda shot: _this(shot, {}, "planes", format="compact"),
    "this: controller compact planes": lambda shot: _this(
        shot, {"auto": True}, "planes", format="compact"
    ),
    **{f"zoomed: {bins} bins": partial(_zoomed, bins=bins) for bins in (16, 32, 64)},
    **{f"Fourier: {codes} codes": partial(_fourier, codes=codes) for codes in (8, 16, 32)},
    **{f"equi-depth: {bins} bins": partial(_equi_depth, bins=bins) for bins in (8, 16, 32)},
    **{f"time stamps: {most}": partial(_time_stamps, most=most) for most in (8, 16, 32, 64, 128)},
}


def schemes(run: Run, names: Sequence[str] = tuple(SCHEMES)) -> dict[str, Found]:
    """Return the result of each scheme on the same photons."""
    shot = Shot(run)
    return {name: SCHEMES[name](shot) for name in names}


def _by_words(shot: Shot, words: other_schemes.Words, arrival: np.ndarray, form: str) -> Found:
    """Return depth from the words that the stream carries. form: a format of this sensor with
    packets of the same length.
    """
    config, sensor = shot.config, shot.config.sensor
    beats = layout(sensor).length(EVENT_FORMATS[form])
    sent = other_schemes.read_out(shot.photons, words, sensor, sensor.phases, config.period, beats)
    return _by_stamps(shot, words.chosen(sent), arrival[sent], int(sent.sum()) * beats * BEAT_BITS)


def _by_stamps(shot: Shot, words: other_schemes.Words, arrival: np.ndarray, bits: int) -> Found:
    """Return depth from a histogram of every pixel's words."""
    histograms = other_schemes.pixel_histograms(
        shot.photons, words, arrival, shot.config.sensor, shot.config.period_ticks
    )
    peaks = [
        pixel_peaks(histogram, "matched", None, shot.pulse, RETURNS)[0] for histogram in histograms
    ]
    return Found(_pixel_metres(shot, np.concatenate(peaks)), bits)


def _by_memory(shot: Shot, histogram: np.ndarray, width: int) -> Found:
    """Return depth from one histogram per macro-pixel, in bins of `width` ticks. All pixels of a
    macro-pixel get the same depth.
    """
    sensor = shot.config.sensor
    bits = histogram.shape[1] * (shot.photons.pulses * sensor.pixels).bit_length()
    if bits > MEMORY_BITS:
        raise ValueError(f"a histogram of {bits} bits, the memory holds {MEMORY_BITS}")
    ticks = np.repeat(coarse_peaks(histogram, width, shot.pulse.sigma), sensor.pixels, axis=0)
    return Found(_pixel_metres(shot, ticks), bits * sensor.subgroups)


def coarse_peaks(histogram: np.ndarray, width: int, sigma_ticks: float) -> np.ndarray:
    """float64[n, RETURNS]: peaks in ticks, from histograms int64[n, bins] with bins of `width`
    ticks.

    Peaks are the highest bins above the median; the neighbours of a peak give its centre.
    Histograms with bins narrower than the pulse are first filtered with the pulse. Returns are as
    far apart as those of a pixel (`peaks.py`).
    """
    excess = histogram - np.median(histogram, axis=1, keepdims=True)
    near, apart = (
        max(NEAR_BINS, math.ceil(sigmas * sigma_ticks / width))
        for sigmas in (NEAR_SIGMAS, APART_SIGMAS)
    )
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


def _of_pixels(shot: Shot, ticks: np.ndarray, bits: int) -> Found:
    """Return the result of a scheme that sends the same number of bits for every pixel."""
    return Found(_pixel_metres(shot, ticks), bits * shot.config.sensor.array_pixels)


def _stamp_bits(shot: Shot) -> int:
    return bits_for(shot.config.period_ticks - 1)


def _pixel_metres(shot: Shot, ticks: np.ndarray) -> np.ndarray:
    """float64[rows, cols, RETURNS] from ticks of all pixels by subgroup, float64[pixels,
    RETURNS].
    """
    sensor = shot.config.sensor
    image = pixel_image(ticks.reshape(sensor.subgroups, sensor.pixels, RETURNS), sensor)
    return image * shot.config.tick_m
