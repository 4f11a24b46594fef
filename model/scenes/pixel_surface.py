# SPDX-License-Identifier: Apache-2.0
"""Which samples of a depth picture stand for a pixel of the sensor. The rule is our choice.

The samples of a pixel are sorted by distance. Where two neighbours are more than `SURFACE_GAP_M`
or `GAP_SHARE` of the distance apart, another surface begins. The pixel takes the median of the
surface with most samples, the nearest one among equals. If most samples of a pixel hold no
depth, the pixel holds none.
"""

from typing import NamedTuple

import numpy as np

from .image_files import covered_samples
from .transient import SURFACE_GAP_M

GAP_SHARE = 0.03


class Chosen(NamedTuple):
    """The two middle samples of each pixel's surface, which are one if their number is odd.
    int64[rows, cols] each.

    In a hole they are any of the pixel's samples.
    """

    lower: np.ndarray  # flat index into the picture
    upper: np.ndarray
    hole: np.ndarray  # bool[rows, cols]

    def middle(self, samples: np.ndarray) -> np.ndarray:
        """float64[rows, cols]: the mean of both of `samples`, which has the picture's shape."""
        flat = samples.ravel()
        return (flat[self.lower] + flat[self.upper]) / 2


def choose_samples(sample_m: np.ndarray, rows: int, cols: int) -> Chosen:
    """Return the samples of a picture that stand for each of rows x cols pixels. sample_m: NaN =
    no depth.

    A picture with fewer samples than the sensor has pixels is repeated.
    """
    height, width = sample_m.shape
    row, col, cell = covered_samples(height, width, rows, cols)
    index = (row * width + col).ravel()
    pixel = cell.ravel()
    distance_m = sample_m.ravel()[index]
    order = np.lexsort((distance_m, pixel))  # NaN is last within its pixel
    index, pixel, distance_m = index[order], pixel[order], distance_m[order]
    known = ~np.isnan(distance_m)

    first_of_pixel = np.searchsorted(pixel, np.arange(rows * cols))
    covered = np.bincount(pixel, minlength=rows * cols)
    seen = np.bincount(pixel[known], minlength=rows * cols)
    hole = 2 * seen < covered

    index_known, pixel_known, known_m = index[known], pixel[known], distance_m[known]
    gap = np.diff(known_m) > np.maximum(SURFACE_GAP_M, GAP_SHARE * known_m[1:])
    begins = np.flatnonzero(np.r_[True, gap | (np.diff(pixel_known) > 0)])
    size = np.diff(np.r_[begins, len(known_m)])
    owner = pixel_known[begins]
    largest_first = np.lexsort((begins, -size, owner))
    _, best = np.unique(owner[largest_first], return_index=True)
    surface = largest_first[best]
    at = owner[surface]

    lower = index[first_of_pixel]
    upper = lower.copy()
    lower[at] = index_known[begins[surface] + (size[surface] - 1) // 2]
    upper[at] = index_known[begins[surface] + size[surface] // 2]
    return Chosen(lower.reshape(rows, cols), upper.reshape(rows, cols), hole.reshape(rows, cols))
