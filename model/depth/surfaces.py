# SPDX-License-Identifier: Apache-2.0
"""Surfaces from the likelihoods of the pixels' times, on planes that neighbours share: the steps
that are the same for events (`planes.py`) and counts (`counts.py`).

All of this is our own choice. The steps are:

1. the likelihood of every time in coarse steps; from it and the neighbours' likelihoods, the
   pixel's seed (`seeds.py`);
2. the likelihood in single ticks around the seeds;
3. planes through this likelihood (`patchmatch.py`);
4. if many of them slant: likelihoods for the wider pulses that slanted surfaces send back, and
   planes through these. They are taken if they make the words likelier. So a scene that has one
   distance per pixel keeps its narrow pulses;
5. times between the ticks, and their standard errors (`refine.py`).

Likelihoods themselves are given by functions of type `Around`.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np

from ..shared.threads import Threads
from . import portable
from .curves import bend_at, slope_at, through_five, through_three
from .likelihood import Levels
from .patchmatch import Field, Planes, fit_planes, level_on, posterior, widened
from .portable import geometric_steps
from .refine import refine
from .seeds import LEAST, Blocks, Seeds, find_seeds, seed_scores

COARSE_SIGMAS = 1.4  # step of the first grid
COARSE_LIGHTS = geometric_steps(0.02, 40, 7).astype(np.float32)  # photons per pulse
BRIGHT_PHOTONS = 1.383  # photons per pulse: such a pixel fires in three of four pulses
FAINT_LIGHTS = geometric_steps(0.015, BRIGHT_PHOTONS, 11)
BRIGHT_LIGHTS = geometric_steps(BRIGHT_PHOTONS, 60, 11)  # finer steps
LIGHTS = np.concatenate([FAINT_LIGHTS, BRIGHT_LIGHTS[1:]]).astype(np.float32)
COARSE_HITS = 2.0  # of the faintest light in all pulses, at most: of the first grid,
HITS = 1.5  # and of the second
BINS_SIGMAS = 16.0  # width of the bins around a seed
BINS_LEAST = 16  # where a pulse is shorter than a tick
WIDTHS = (
    4  # of pulses: the laser's, and those of slanted surfaces, each twice as wide as the one before
)
SLANTED = 0.25  # doublings of the pulse's width,
SLANTED_SHARE = (
    0.05  # and share of the pixels with more of them, that make these widths worth a try
)
SPREAD_GAIN = (
    0.1  # mean log likelihood of a pixel by which slopes that spread the pulse must be likelier
)
BLOCK_ROWS = 4
PEAK_CLIMBS = 4  # steps of Newton's method to a peak between the bins
BEND_MIN = 0.1  # of a log likelihood at a peak, per squared bin: less has no peak
RETURN_SCORE = (
    12.0  # score of a further return with its neighbours: reached by accident once in a hundred,
)
RETURN_LEVEL = 2.0  # and without them
APART_SIGMAS = 4.0  # distance between returns, in addition to what the words cannot tell apart

# Returns the likelihoods for pulses so many times as wide as the laser's, in steps of as many
# ticks, from given first steps on, int64[rows, cols].
Around: TypeAlias = Callable[[int, np.ndarray], Levels]


class Coarse(NamedTuple):
    """What is known after the first grid, [rows, cols, ...]."""

    step: int  # ticks of that grid
    level: np.ndarray  # float32[rows, cols, times], log likelihood ratio
    light: np.ndarray  # uint8[rows, cols, times], likeliest light
    found: Seeds

    @property
    def middle(self) -> np.ndarray:
        """float64[rows, cols]: time of the seed in ticks; without a seed, 0."""
        return np.nan_to_num(self.found.time(self.step))


class Fit(NamedTuple):
    """Planes, and the likelihoods that they go through."""

    field: Field
    planes: Planes


class Surfaces(NamedTuple):
    """What is found of some returns, float64[rows, cols, returns]."""

    time: np.ndarray  # ticks; NaN: none
    confidence: np.ndarray
    error: np.ndarray  # standard error of the time, ticks


class Fitter(NamedTuple):
    """The steps, for a frame."""

    sigma_ticks: float  # of the laser's pulse
    period_ticks: int
    pulses: int
    blocks: Blocks

    @classmethod
    def of(
        cls, sigma_ticks: float, period_ticks: int, pulses: int, rows: int, threads: Threads
    ) -> "Fitter":
        """Return the steps for an array of so many rows, whose blocks share the threads."""

        def blocks(function: Callable[[int, int], None]) -> None:
            begins = range(0, rows, BLOCK_ROWS)
            threads.map(lambda begin: function(begin, min(rows, begin + BLOCK_ROWS)), begins)

        return cls(sigma_ticks, period_ticks, pulses, blocks)

    @property
    def step(self) -> int:
        """Ticks of the first grid."""
        return max(1, round(COARSE_SIGMAS * self.sigma_ticks))

    @property
    def coarse_times(self) -> int:
        """Number of times of the first grid."""
        return -(-self.period_ticks // self.step)

    @property
    def coarse_lights(self) -> np.ndarray:
        """float32: lights of the first grid."""
        return down_to(COARSE_LIGHTS, COARSE_HITS / self.pulses)

    @property
    def lights(self) -> np.ndarray:
        """float32: lights of the grid in single ticks."""
        return down_to(LIGHTS, HITS / self.pulses)

    @property
    def bins(self) -> int:
        """Number of ticks around a seed."""
        return max(BINS_LEAST, round(BINS_SIGMAS * self.sigma_ticks))

    def first(self, middle: np.ndarray, width: int = 1) -> np.ndarray:
        """int64[rows, cols]: the first of the bins around a time in ticks, as the number of bins of
        `width` ticks before it.
        """
        return np.floor(middle / width).astype(np.int64) - self.bins // 2

    def coarse(self, level: np.ndarray, light: np.ndarray) -> Coarse:
        """Find the seeds of the pixels.

        level: float32[rows, cols, times], light: uint8 of the same shape, of the first grid.
        """
        return Coarse(self.step, level, light, find_seeds(level, light, self.blocks))

    def fit(self, levels: Levels, first: np.ndarray) -> Fit:
        """Fit planes to likelihoods in single ticks. first: int64[rows, cols], first tick."""
        field = Field.of([levels.level], [first], self.sigma_ticks, self.blocks)
        return Fit(field, fit_planes(field, self.blocks))

    def refined(self, fit: Fit) -> Planes:
        """Return the planes with times between the ticks."""
        return refine(fit.field, fit.planes, self.blocks).planes

    def with_slants(self, fit: Fit, level: np.ndarray, middle: np.ndarray, around: Around) -> Fit:
        """Return a better fit, where slopes that spread the pulse make the words likelier.

        level: float32[rows, cols, bins], in single ticks. middle: float64[rows, cols], ticks.
        """
        slanted = widened(fit.planes.down, fit.planes.right, self.sigma_ticks) > 4**SLANTED
        if np.mean(slanted) <= SLANTED_SHARE:
            return fit
        wide = self._in_perspective(level, middle, around)
        in_space = fit_planes(wide, self.blocks)
        if np.mean(level_on(wide, in_space) - level_on(*fit)) > SPREAD_GAIN:
            return Fit(wide, in_space)
        return fit

    def _in_perspective(self, level: np.ndarray, middle: np.ndarray, around: Around) -> Field:
        """Return the field of all widths of pulses."""
        levels = [level]
        first_ticks = [self.first(middle)]
        for k in range(1, WIDTHS):
            width = 2**k
            first = self.first(middle, width)
            levels.append(around(width, first).level)
            first_ticks.append(width * first)
        return Field.of(levels, first_ticks, self.sigma_ticks, self.blocks)

    def surfaces(
        self,
        fit: Fit,
        coarse: Coarse,
        around: Around,
        *,
        tolerance_ticks: float,
        returns: int,
        apart_ticks: float,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return (time, confidence, error), [rows, cols, returns], and slope, [rows, cols, 2], down
        and right; in ticks.

        confidence: probability that the first return is within `tolerance_ticks`, and that the
        others are not accidental. apart_ticks: within this distance, words do not tell returns apart.
        """
        refined = refine(fit.field, fit.planes, self.blocks)
        planes = refined.planes
        confidence, error = posterior(fit.field, planes, tolerance_ticks, self.blocks)
        error = np.where(np.isnan(refined.error), error, refined.error)
        found = coarse.found
        seen = found.bin >= 0
        time = np.where(seen, np.clip(planes.time, 0, self.period_ticks), np.nan)
        confidence = np.where(seen, confidence * found.chance(self.bins // 2 // coarse.step), 0.0)
        error = np.where(seen, error, np.nan)
        slope = np.where(seen[:, :, None], np.stack([planes.down, planes.right], axis=2), np.nan)
        surfaces = Surfaces(time[:, :, None], confidence[:, :, None], error[:, :, None])
        if returns > 1:
            apart = apart_ticks + APART_SIGMAS * self.sigma_ticks
            further = self._further(coarse, partial(around, 1), planes.time, apart, returns - 1)
            surfaces = Surfaces(
                time=np.concatenate([surfaces.time, further.time], axis=2),
                confidence=np.concatenate([surfaces.confidence, further.confidence], axis=2),
                error=np.concatenate([surfaces.error, further.error], axis=2),
            )
        return *surfaces, slope

    def _further(
        self,
        coarse: Coarse,
        around: Callable[[np.ndarray], Levels],
        time: np.ndarray,
        apart: float,
        most: int,
    ) -> Surfaces:
        """Return at most so many returns after the first, `apart` ticks from each other.

        time: of the first.
        """
        step = coarse.step
        rows, cols, times = coarse.level.shape
        found = Surfaces(
            time=np.full((rows, cols, most), np.nan),
            confidence=np.zeros((rows, cols, most)),
            error=np.full((rows, cols, most), np.nan),
        )
        middle = (np.arange(times) + 0.5) * step
        left = coarse.level.copy()
        taken = time
        for k in range(most):
            for of_row, taken_in_row in zip(left, taken, strict=True):  # little memory
                of_row[np.abs(middle - taken_in_row[:, None]) <= apart] = LEAST
            seeds = find_seeds(left, coarse.light, self.blocks)
            score = seed_scores(left, coarse.light, seeds, self.blocks)
            own = np.take_along_axis(left, np.maximum(seeds.bin, 0)[:, :, None], 2)[:, :, 0]
            there = (seeds.bin >= 0) & (score > RETURN_SCORE) & (own > RETURN_LEVEL)
            if not there.any():
                break
            first = self.first(np.where(there, seeds.time(step), 0.0))
            fit = self.fit(around(first), first)
            _, error = posterior(*fit, 0.0, self.blocks)
            accident = np.minimum(1, times * portable.exp(-score))
            taken = np.where(there, np.clip(fit.planes.time, 0, times * step), np.nan)
            found.time[:, :, k] = taken
            found.error[:, :, k] = np.where(there, error, np.nan)
            found.confidence[:, :, k] = np.where(there, 1 - accident, 0.0)
        return found


def down_to(lights: np.ndarray, faintest: float) -> np.ndarray:
    """Return geometric steps of lights, float32, continued downwards until one is at most
    `faintest`.
    """
    ratio = lights[1] / lights[0]
    more = max(0, math.ceil(math.log(lights[0] / faintest) / math.log(ratio)))
    fainter = [float(lights[0]) * float(ratio) ** k for k in range(-more, 0)]
    return np.concatenate([fainter, lights]).astype(np.float32)


def peak_offset(level: np.ndarray, chosen: np.ndarray, *, smooth: bool) -> np.ndarray:
    """float64[rows, cols]: from the middle of the chosen bin to the peak of the polynomial through
    the bins around it, in bins; at most half a bin.

    level: float32[rows, cols, bins]. chosen: int64[rows, cols]. smooth: whether the levels have so
    little noise that five bins tell the peak better than three do.
    """
    reach = 2 if smooth else 1
    bins = np.clip(chosen[:, :, None] + np.arange(-reach, reach + 1), 0, level.shape[2] - 1)
    levels = np.moveaxis(np.take_along_axis(level, bins, 2).astype(np.float64), 2, 0)
    curve = through_five(*levels) if smooth else through_three(*levels)
    offset = np.zeros(chosen.shape)
    for _ in range(PEAK_CLIMBS):
        bend = np.maximum(BEND_MIN, -bend_at(curve, offset))
        offset = np.clip(offset + slope_at(curve, offset) / bend, -0.5, 0.5)
    return offset
