# SPDX-License-Identifier: Apache-2.0
"""Other schemes on the same edges, each in its simplest form, and the FIFOs and stream that their
words share.

A macro-pixel is a subgroup, and every scheme sees only the edges of its pixels. Some schemes send
words, with one stamp for a group of photons, through FIFOs and a stream like those of this sensor.
Others keep a histogram for each macro-pixel on the chip, or compress one for each pixel, and send
it at the end of the frame. The literature has these ideas in many forms (docs/rivals.md has the
sources); the forms here are our choice.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from coincid.model.contract.edges import Edges
from coincid.model.contract.latency import armed_cycle, close_cycle
from coincid.model.contract.parameters import Sensor
from coincid.model.contract.pixels import pixel_table
from coincid.model.shared.compiled import njit

REARM_CYCLES = 0  # the tree of a rival is armed again in the cycle after its window
CODE_MAX = 127  # largest value of a Fourier code
_close_cycle, _armed_cycle = njit(close_cycle), njit(armed_cycle)


class MacroPixelEdges(NamedTuple):
    """One frame's edges by subgroup, then pulse, tick and pixel; int64[n].

    pulse: subgroup * pulses + the laser pulse of the frame. inside: the pixel in the subgroup.
    pulses: number in the frame. subgroups; pixels: number in each.
    """

    pulse: np.ndarray
    tick: np.ndarray
    inside: np.ndarray
    pulses: int
    subgroups: int
    pixels: int

    @property
    def subgroup(self) -> np.ndarray:
        return self.pulse // self.pulses

    @property
    def pixel(self) -> np.ndarray:
        """Number of the pixel in the array, by subgroup."""
        return self.subgroup * self.pixels + self.inside


class Words(NamedTuple):
    """Words that a scheme sends, int64[n].

    Each word stands for the photons [start, stop), and has the stamp of one of them (tick) and
    their pixels. The order is
    that of the photons: by subgroup, then time.
    """

    start: np.ndarray
    stop: np.ndarray
    stamp: np.ndarray

    def chosen(self, which: np.ndarray) -> "Words":
        return Words(*(column[which] for column in self))


def macro_pixels(edges: Edges, sensor: Sensor, pulses: int) -> MacroPixelEdges:
    """Return the edges of one frame (pulses counted from its start) as the subgroups see them."""
    pixel = pixel_table(sensor)
    pulse, inside = pixel.subgroup[edges.pixel] * pulses + edges.pulse, pixel.inside[edges.pixel]
    order = np.lexsort((inside, edges.tick, pulse))
    return MacroPixelEdges(
        pulse[order], edges.tick[order], inside[order], pulses, sensor.subgroups, sensor.pixels
    )


def windows(photons: MacroPixelEdges, window: int, phases: int) -> Words:
    """Take this sensor's windows without a threshold: each lasts `window` ticks, and the tree is
    armed again in the next cycle.
    """
    return Words(*_windows(photons.pulse, photons.tick, window, phases))


@njit
def _windows(
    pulse: np.ndarray, tick: np.ndarray, window: int, phases: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    start, stop = np.empty_like(tick), np.empty_like(tick)
    n, e = 0, 0
    while e < len(tick):
        begin, end = e, tick[e] + window
        armed = _armed_cycle(_close_cycle(tick[e], window, phases), REARM_CYCLES) * phases
        while e < len(tick) and pulse[e] == pulse[begin] and tick[e] < end:
            e += 1
        start[n], stop[n] = begin, e
        n += 1
        while e < len(tick) and pulse[e] == pulse[begin] and tick[e] < armed:
            e += 1
    return start[:n], stop[:n], tick[start[:n]]


def sliding_window(photons: MacroPixelEdges, window: int, threshold: int) -> Words:
    """Make a word from `threshold` photons within `window` ticks, with the stamp of the last one;
    each photon counts once.
    """
    return Words(*_sliding(photons.pulse, photons.tick, window, threshold))


@njit
def _sliding(
    pulse: np.ndarray, tick: np.ndarray, window: int, threshold: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    start, stop = np.empty_like(tick), np.empty_like(tick)
    n = oldest = 0
    for e in range(len(tick)):
        while pulse[oldest] != pulse[e] or tick[oldest] <= tick[e] - window:
            oldest += 1
        if e - oldest + 1 >= threshold:
            start[n], stop[n] = oldest, e + 1
            n += 1
            oldest = e + 1
    return start[:n], stop[:n], tick[stop[:n] - 1]


def first_stamps(photons: MacroPixelEdges, most: int) -> Words:
    """Take the first `most` photons of every pixel in the frame, each with its stamp."""
    order, number = np.argsort(photons.pixel, kind="stable"), np.bincount(photons.pixel)
    rank = np.arange(len(order)) - np.repeat(np.cumsum(number) - number, number)
    chosen = np.sort(order[rank < most])
    return Words(chosen, chosen + 1, photons.tick[chosen])


def zoomed_counts(
    photons: MacroPixelEdges, stage: range, start: np.ndarray, width: int, bins: int
) -> np.ndarray:
    """int64[all pixels, bins]: photons in bins of `width` ticks that begin at the pixel's `start`,
    in the pulses of `stage`.
    """
    pulse, pixel = photons.pulse % photons.pulses, photons.pixel
    at = (photons.tick - start[pixel]) // width
    inside = (pulse >= stage.start) & (pulse < stage.stop) & (at >= 0) & (at < bins)
    counts = np.bincount(pixel[inside] * bins + at[inside], minlength=len(start) * bins)
    return np.minimum(counts.reshape(-1, bins), len(stage))  # a counter holds one photon per pulse


def fourier_sums(photons: MacroPixelEdges, codes: int, period_ticks: int) -> np.ndarray:
    """complex128[all pixels, codes / 2 + 1]: spectrum of the stamps, from sums of codes; frequency
    0 is not sent.

    Codes are the cosine and the sine of the lowest frequencies, in 8 bits.
    """
    n, phase = (
        photons.subgroups * photons.pixels,
        -2j * np.pi * np.arange(period_ticks) / period_ticks,
    )
    sums = np.zeros((n, codes // 2 + 1), np.complex128)
    for frequency in range(1, codes // 2 + 1):
        code = CODE_MAX * np.exp(frequency * phase)
        for part, factor in ((code.real, 1), (code.imag, 1j)):
            sums[:, frequency] += factor * np.bincount(
                photons.pixel, np.rint(part)[photons.tick], n
            )
    return sums


def equi_depth(photons: MacroPixelEdges, bins: int, period_ticks: int) -> np.ndarray:
    """int64[all pixels, bins + 1]: boundaries in ticks of bins that hold equal shares of a pixel's
    stamps.

    The first is 0, and the last is the end of the period.
    """
    tick = np.append(photons.tick[np.lexsort((photons.tick, photons.pixel))], period_ticks)
    number = np.bincount(photons.pixel, minlength=photons.subgroups * photons.pixels)
    inner = tick[
        (np.cumsum(number) - number)[:, None] + number[:, None] * np.arange(1, bins) // bins
    ]
    inner[number == 0] = period_ticks
    return np.pad(inner, ((0, 0), (1, 1)), constant_values=((0, 0), (0, period_ticks)))


def photon_counts(photons: MacroPixelEdges, clock: int, bins: int) -> np.ndarray:
    """int64[subgroups, bins]: number of photons of each macro-pixel in bins of `clock` ticks, as an
    adder counts them.
    """
    at = photons.subgroup * bins + photons.tick // clock
    return np.bincount(at, minlength=photons.subgroups * bins).reshape(-1, bins)


def read_out(
    photons: MacroPixelEdges, words: Words, sensor: Sensor, phases: int, period: int, beats: int
) -> np.ndarray:
    """bool[n]: whether a word finds a free place in the FIFO of its subgroup.

    The stream empties the FIFOs round robin, with `beats` cycles per word. This is as in this
    sensor, except for latencies of a few cycles. period: in cycles.
    """
    subgroup = photons.subgroup[words.start]
    cycle = photons.pulse[words.start] % photons.pulses * period + words.stamp // phases
    bounds = np.searchsorted(subgroup, np.arange(photons.subgroups + 1))
    stored = np.zeros(len(cycle), np.bool_)
    for stream in range(sensor.streams):
        part = sensor.stream_subgroups(stream)
        _serve(cycle, bounds[part.start : part.stop + 1], sensor.fifo_depth, beats, stored)
    return stored


@njit
def _serve(
    cycle: np.ndarray, bounds: np.ndarray, depth: int, beats: int, stored: np.ndarray
) -> None:
    n = len(bounds) - 1
    arrived, level = bounds[:-1].copy(), np.zeros(n, np.int64)
    now, pointer = np.int64(0), 0
    while True:
        upcoming = np.int64(-1)
        for s in range(n):  # each word up to now enters its FIFO or is lost
            while arrived[s] < bounds[s + 1] and cycle[arrived[s]] <= now:
                if level[s] < depth:
                    stored[arrived[s]] = True
                    level[s] += 1
                arrived[s] += 1
            if arrived[s] < bounds[s + 1] and (upcoming < 0 or cycle[arrived[s]] < upcoming):
                upcoming = cycle[arrived[s]]
        served = -1
        for k in range(n):
            if level[(pointer + k) % n]:
                served = (pointer + k) % n
                break
        if served >= 0:
            level[served] -= 1
            pointer = (served + 1) % n
            now += beats
        elif upcoming >= 0:
            now = upcoming
        else:
            return


def pixel_histograms(
    photons: MacroPixelEdges, words: Words, arrival: np.ndarray, sensor: Sensor, period_ticks: int
) -> Iterator[np.ndarray]:
    """Yield the histograms of each subgroup's pixels, int32[pixels, period_ticks]. A word counts at
    its arrival for its pixels.
    """
    size = words.stop - words.start
    of_word = np.repeat(np.arange(len(size)), size)
    photon = np.arange(len(of_word)) + np.repeat(words.start - np.cumsum(size) + size, size)
    at = photons.inside[photon] * period_ticks + np.clip(
        arrival[of_word].astype(np.int64), 0, period_ticks - 1
    )
    bounds = np.searchsorted(photons.subgroup[photon], np.arange(sensor.subgroups + 1))
    for s in range(sensor.subgroups):
        counts = np.bincount(at[bounds[s] : bounds[s + 1]], minlength=sensor.pixels * period_ticks)
        yield counts.astype(np.int32).reshape(sensor.pixels, period_ticks)
