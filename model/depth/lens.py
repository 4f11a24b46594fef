# SPDX-License-Identifier: Apache-2.0
"""How straight lines of pixels see planes in space, learned from a frame.

Behind a lens, the distances on a plane do not change evenly from pixel to pixel: even a wall that
faces the sensor is farther away at the edges of the view. With the distance d of a pixel that is
(x, y) pixels from the centre of the view,

    sqrt(1 + right x^2 + down y^2) / d

changes evenly, where `right` and `down` are the squares of the tangents of a pixel's angles. Pixels may
be square, or the view may be as wide as it is high, whatever the array is. A depth picture may
have been made in another way, so that d itself changes evenly on its planes. So all these laws are
tried on three peaks in a line, with several views, and that one is taken that they fit best.
"""

import math
from typing import NamedTuple

import numpy as np

from ..shared.compiled import njit, part

HALF_VIEWS = 2.0 ** np.arange(-8, 1)  # squared tangents of half the view that are tried first
CLOSER = 4  # further trials around the best of them, each with half the change of the one before
APART = 1, 2, 4  # pixels between three peaks in a line
OFF_MAX = 9.0  # squared errors per variance, at most: the three are on different surfaces
GAIN_MIN = 20.0  # by which a lens must lower the sum of these
LOWEST = 0.3  # of the inverse distance: a plane is followed no farther


class Lens(NamedTuple):
    """A lens in front of the pixels."""

    there: bool  # False: distances change evenly on planes
    down: float  # squared tangent of a pixel's angle from row to row
    right: float  # and from column to column
    row: float  # centre of the view
    col: float


def no_lens(rows: int, cols: int) -> Lens:
    """Return that an array has none."""
    return Lens(there=False, down=0.0, right=0.0, row=(rows - 1) / 2, col=(cols - 1) / 2)


def find_lens(time: np.ndarray, weight: np.ndarray) -> Lens:
    """Find the lens that the peaks of the pixels fit best.

    time: float64[rows, cols], ticks. weight: float64[rows, cols], inverse of the variance; 0: none.
    """
    rows, cols = time.shape
    none = no_lens(rows, cols)
    longer = max(rows, cols)
    sides = dict.fromkeys(((longer, longer), (rows, cols)))  # in pixels, that have the same view
    tried = [_closest(time, weight, none, *pixels) for pixels in sides]
    lens, cost = min(tried, key=lambda one: one[1])
    if _misses(time, weight, none) - cost < GAIN_MIN:
        return none
    return lens


def _closest(
    time: np.ndarray, weight: np.ndarray, none: Lens, high: int, wide: int
) -> tuple[Lens, float]:
    """Return the lens that peaks fit best, of those that see so many rows and columns under the same
    angle, and its sum of squared errors.
    """

    def with_view(half: float) -> Lens:
        down, right = (half / (side / 2) ** 2 for side in (high, wide))
        return none._replace(there=True, down=down, right=right)

    def cost_of(half: float) -> float:
        return float(_misses(time, weight, with_view(half)))

    costs = [cost_of(half) for half in HALF_VIEWS.tolist()]
    lowest = min(costs)
    best = float(HALF_VIEWS[costs.index(lowest)])
    factor = 2.0
    for _ in range(CLOSER):
        factor = math.sqrt(factor)
        for half in (best / factor, best * factor):
            cost = cost_of(half)
            if cost < lowest:
                lowest = cost
                best = half
    return with_view(best), lowest


@njit
def _misses(time: np.ndarray, weight: np.ndarray, lens: Lens) -> float:
    """Return the sum over three peaks in a line of the squared errors of the middle one, in
    variances.
    """
    rows, cols = time.shape
    total = 0.0
    for apart in APART:
        for r in range(rows):
            for c in range(cols):
                if weight[r, c] <= 0 or time[r, c] <= 0:
                    continue
                if apart <= r < rows - apart:
                    total += _miss(time, weight, lens, r, c, apart, 0)
                if apart <= c < cols - apart:
                    total += _miss(time, weight, lens, r, c, 0, apart)
    return total


@part
def _miss(
    time: np.ndarray, weight: np.ndarray, lens: Lens, r: int, c: int, down: int, right: int
) -> float:
    """Return the squared error of a peak between two others, in variances."""
    before = time[r - down, c - right]
    after = time[r + down, c + right]
    of_before = weight[r - down, c - right]
    of_after = weight[r + down, c + right]
    if of_before <= 0 or of_after <= 0 or before <= 0 or after <= 0:
        return 0.0
    here = time[r, c]
    middle = (before + after) / 2
    if lens.there:
        inverse = _stretch(lens, r - down, c - right) / before
        inverse += _stretch(lens, r + down, c + right) / after
        middle = 2 * _stretch(lens, r, c) / inverse
    variance = 1 / weight[r, c] + (1 / of_before + 1 / of_after) / 4
    return min(OFF_MAX, (here - middle) ** 2 / variance)


@part
def _stretch(lens: Lens, r: int, c: int) -> float:
    """Return the distance of a pixel's point of a wall that faces the sensor, over its lowest."""
    y = r - lens.row
    x = c - lens.col
    return np.sqrt(1 + (lens.right * x * x + lens.down * y * y))


@part
def seen_at(
    lens: Lens,
    time: float,
    slope_down: float,
    slope_right: float,
    r: int,
    c: int,
    down: int,
    right: int,
) -> float:
    """Return the time of a plane of pixel (r, c) so many pixels down and right, behind a lens.

    time: ticks at the pixel. slope_down, slope_right: ticks per pixel there.
    """
    stretch = _stretch(lens, r, c)
    by_view = lens.down * (r - lens.row) * down + lens.right * (c - lens.col) * right
    inverse = stretch / time
    change = by_view / stretch / time - inverse / time * (slope_down * down + slope_right * right)
    return _stretch(lens, r + down, c + right) / max(LOWEST * inverse, inverse + change)
