# SPDX-License-Identifier: Apache-2.0
"""Times between the ticks, and their standard errors: a plane by least squares through the peaks of
the pixels around each pixel.

Near its peak, the log likelihood of a pixel is a parabola. A plane through the peaks of neighbours
on the same surface, each weighted by how sharp it is, has the error that their photons allow. The
more neighbours, the smaller this error, until the surface is no plane any more. So the
neighbourhood grows as long as its estimate agrees with those of the smaller ones (Goldenshluger and
Nemirovski 1997: the intervals of all of them must intersect).
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from ..shared.compiled import njit, part
from .patchmatch import HALF, Field, Planes, own_level, plane_at
from .seeds import Blocks

CLIMB = 2  # steps from the plane's time to a pixel's own peak, at most
PEAK_STEPS = 1.5  # from the highest of these to the peak of the parabola, at most
BESIDE_TICKS = 4.0  # from the plane to that of a neighbour on the same surface, at most
OFF_SIGMAS = 3.5  # from the plane to the peak of such a neighbour, at most
SLOPE_TICKS = 1.0  # per pixel: standard deviation of the slopes of `fit_planes`
AGREE_SIGMAS = 1.6  # half width of the intervals that must intersect
GROWTH = 1.25  # of the standard error, because the neighbourhood is chosen by the same peaks
ERROR_TICKS = 0.06  # what the likelihood leaves out, at any number of photons
MOVE_TICKS = 3.0  # by which a time changes, at most
DISCS = (0, 1, 2, 5, 10, 17, 26, 37, 50, 68)  # squared radii of the neighbourhoods, pixels


class Refined(NamedTuple):
    """Planes and the standard errors of their times, [rows, cols]."""

    planes: Planes
    error: np.ndarray  # float64, ticks; NaN: no peak is near


class _Peaks(NamedTuple):
    """Peak of each pixel's log likelihood near its plane, float64[rows, cols]."""

    time: np.ndarray  # ticks
    bend: np.ndarray  # of the parabola, per squared tick: inverse of the variance; 0: no peak


class _Sums(NamedTuple):
    """Sums over the pixels of a neighbourhood."""

    weight: float
    down: float
    right: float
    down_down: float
    down_right: float
    right_right: float
    off: float
    off_down: float
    off_right: float


def refine(field: Field, planes: Planes, blocks: Blocks) -> Refined:
    """Return planes with times and slopes between the steps of `fit_planes`."""
    shape = planes.time.shape
    peaks = _Peaks(np.empty(shape), np.empty(shape))
    blocks(partial(_find_peaks, field, planes, peaks))
    steps, bounds = _discs()
    refined = Refined(
        Planes(
            time=np.empty(shape),
            down=np.empty(shape),
            right=np.empty(shape),
            score=planes.score,
            new=planes.new,
        ),
        np.empty(shape),
    )
    blocks(partial(_fit, field, planes, peaks, steps, bounds, refined))
    return refined


def _discs() -> tuple[np.ndarray, np.ndarray]:
    """Return the steps to neighbours, int64[n, 2], the nearest first, and how many of them each of
    `DISCS` has, int64[discs].
    """
    reach = np.arange(-HALF, HALF + 1)
    down = np.repeat(reach, len(reach))
    right = np.tile(reach, len(reach))
    square = down**2 + right**2
    order = np.argsort(square, kind="stable")
    bounds = np.searchsorted(square[order], DISCS, side="right")
    return np.stack([down[order], right[order]], axis=1), bounds


@njit(allocates=False)
def _find_peaks(field: Field, planes: Planes, peaks: _Peaks, begin: int, end: int) -> None:
    """Find the peaks of the pixels of some rows."""
    for r in range(begin, end):
        for c in range(planes.time.shape[1]):
            step, middle, here = own_level(field, planes, r, c, 0)
            before = own_level(field, planes, r, c, -1)[2]
            after = own_level(field, planes, r, c, 1)[2]
            at = 0
            for _ in range(CLIMB):
                if after > here and after >= before:
                    at += 1
                    before = here
                    here = after
                    after = own_level(field, planes, r, c, at + 1)[2]
                elif before > here:
                    at -= 1
                    after = here
                    here = before
                    before = own_level(field, planes, r, c, at - 1)[2]
            bend = 2 * here - before - after
            peaks.time[r, c] = middle + at * step
            peaks.bend[r, c] = 0.0
            if bend > 0:
                off = float((after - before) / 2 / bend)
                peaks.time[r, c] += step * min(PEAK_STEPS, max(-PEAK_STEPS, off))
                peaks.bend[r, c] = bend / step**2


@njit(allocates=False)
def _fit(
    field: Field,
    planes: Planes,
    peaks: _Peaks,
    steps: np.ndarray,
    bounds: np.ndarray,
    refined: Refined,
    begin: int,
    end: int,
) -> None:
    """Compute the refined planes of some rows."""
    rows, cols = planes.time.shape
    for r in range(begin, end):
        for c in range(cols):
            sums = _Sums(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            low = -np.inf
            high = np.inf
            off = 0.0
            down = 0.0
            right = 0.0
            variance = np.inf
            done = 0
            for disc in range(len(bounds)):
                for k in range(done, bounds[disc]):
                    rr = r + steps[k, 0]
                    cc = c + steps[k, 1]
                    if 0 <= rr < rows and 0 <= cc < cols and peaks.bend[rr, cc] > 0:
                        sums = _with_pixel(field, planes, peaks, r, c, rr, cc, sums)
                done = bounds[disc]
                if sums.weight == 0:
                    continue
                here, here_down, here_right, here_variance = _solve(sums)
                reach = AGREE_SIGMAS * np.sqrt(here_variance)
                low = max(low, here - reach)
                high = min(high, here + reach)
                if low > high:
                    break
                if here_variance <= variance:
                    off = here
                    down = here_down
                    right = here_right
                    variance = here_variance
            moved = abs(off) <= MOVE_TICKS
            refined.planes.time[r, c] = planes.time[r, c] + (off if moved else 0.0)
            refined.planes.down[r, c] = planes.down[r, c] + (down if moved else 0.0)
            refined.planes.right[r, c] = planes.right[r, c] + (right if moved else 0.0)
            error = np.sqrt(GROWTH**2 * variance + ERROR_TICKS**2)
            refined.error[r, c] = error if variance < np.inf else np.nan


@part
def _with_pixel(
    field: Field, planes: Planes, peaks: _Peaks, r: int, c: int, rr: int, cc: int, sums: _Sums
) -> _Sums:
    """Return sums with pixel (rr, cc), if it is on the plane of pixel (r, c)."""
    down = float(rr - r)
    right = float(cc - c)
    there = plane_at(field, planes, r, c, down, right)
    if abs(planes.time[rr, cc] - there) > BESIDE_TICKS:
        return sums
    weight = peaks.bend[rr, cc]
    off = peaks.time[rr, cc] - there
    if off * off * weight > OFF_SIGMAS**2:
        return sums
    return _Sums(
        weight=sums.weight + weight,
        down=sums.down + weight * down,
        right=sums.right + weight * right,
        down_down=sums.down_down + weight * down * down,
        down_right=sums.down_right + weight * down * right,
        right_right=sums.right_right + weight * right * right,
        off=sums.off + weight * off,
        off_down=sums.off_down + weight * off * down,
        off_right=sums.off_right + weight * off * right,
    )


@part
def _solve(sums: _Sums) -> tuple[float, float, float, float]:
    """Return what is added to a plane's time, and to its slopes, and the variance of the time."""
    prior = 1 / SLOPE_TICKS**2
    a = sums.weight
    b = sums.down
    c = sums.right
    d = sums.down_down + prior
    e = sums.down_right
    f = sums.right_right + prior
    aa = d * f - e * e
    bb = c * e - b * f
    cc = b * e - c * d
    whole = a * aa + b * bb + c * cc
    off = (aa * sums.off + bb * sums.off_down + cc * sums.off_right) / whole
    left_down = sums.off_down - b * off
    left_right = sums.off_right - c * off
    down = (f * left_down - e * left_right) / aa
    right = (d * left_right - e * left_down) / aa
    return off, down, right, aa / whole
