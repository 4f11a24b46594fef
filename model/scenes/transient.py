# SPDX-License-Identifier: Apache-2.0
"""Transients: how the light that returns to each pixel of a rendered scene is spread over the time
of flight.

The unit is that of equation (1): a Lambertian surface of reflectivity r that fills the pixel at
distance d sends back r / (pi d^2). So a transient is independent of laser, lens and detector,
and the link budget turns it into photons.
"""

import math
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from attrs import frozen

from ..light.light import (
    BACKGROUNDS,
    SIGNAL_MAX,
    Arrivals,
    Light,
    ambient_reflectivity,
    background_cps,
)
from ..light.link_budget import Laser, Optics, link_budget
from ..shared.constants import SPEED_OF_LIGHT_M_S
from ..shared.files import FilePath, read_npz, write_npz
from ..shared.quantities import Numbers, real_array

BIN_S = 15.625e-12  # a quarter of the preset's tick
# Surfaces farther apart are distinct: the way of light, there and back, in a coincidence window
# of 1 ns.
SURFACE_GAP_M = 0.15
_ARRAYS = ("first", "index", "strength_per_m2", "ambient", "surface_m", "lost_per_m2")


@frozen(kw_only=True, eq=False)
class Transient:
    """Transients of rows x cols pixels. Only bins with light are stored: those of pixel p are
    first[p] to first[p + 1].

    first: int64[pixels + 1]. index: int64[n], ascending in a pixel; bin i holds flights of [i, i
    + 1) x `BIN_S`, there and back. strength_per_m2: float64[n], returned light in the bin, in
    units of r / (pi d^2). ambient: float64[rows, cols], reflectivity of the pixel under even
    light (1 = open sky). surface_m: float64[rows, cols], distance of the surface that fills most
    of the pixel, from the geometry alone; infinite if there is none. lost_per_m2: of flights
    beyond the last bin, all pixels.
    """

    first: np.ndarray
    index: np.ndarray
    strength_per_m2: np.ndarray
    ambient: np.ndarray
    surface_m: np.ndarray
    lost_per_m2: float = 0.0

    def save(self, path: FilePath) -> None:
        write_npz(path, {name: np.asarray(getattr(self, name)) for name in _ARRAYS})

    @classmethod
    def load(cls, path: FilePath) -> "Transient":
        arrays = read_npz(path, _ARRAYS)
        return cls(lost_per_m2=float(arrays.pop("lost_per_m2")), **arrays)

    @property
    def total_per_m2(self) -> np.ndarray:
        """float64[rows, cols]: all light that returns to each pixel."""
        sums = np.diff(np.r_[0, np.cumsum(self.strength_per_m2)][self.first])
        return sums.reshape(self.surface_m.shape)

    def depth_m(self) -> np.ndarray:
        """float64[rows, cols]: distance of each pixel's strongest return.

        It is the mean flight around the brightest bin, or NaN if no light returns.
        """
        near = round(SURFACE_GAP_M / (BIN_S * SPEED_OF_LIGHT_M_S / 2) / 2)
        depth_m = np.full(self.surface_m.size, np.nan)
        for pixel, (begin, end) in enumerate(pairwise(self.first)):
            if end > begin:
                index, strength = self.index[begin:end], self.strength_per_m2[begin:end]
                here = np.abs(index - index[strength.argmax()]) <= near
                depth_m[pixel] = (
                    np.average(index[here] + 0.5, weights=strength[here])
                    * BIN_S
                    * SPEED_OF_LIGHT_M_S
                    / 2
                )
        return depth_m.reshape(self.surface_m.shape)

    def light(
        self,
        klux: Numbers,
        *,
        background: str = BACKGROUNDS[0],
        optics: Optics | None = None,
        laser: Laser | None = None,
        **others: Any,
    ) -> Light:
        """Return the detected light: signal by the link budget, background by the preset, with
        `ambient` as reflectivity.

        klux: ambient light, a number or float64[rows, cols]; background: one of `BACKGROUNDS`;
        others: fields of `Light`.
        """
        photons = self.strength_per_m2 * photons_per_strength(optics, laser)
        arrivals = Arrivals(
            first=self.first,
            start_s=self.index * BIN_S,
            photons=np.minimum(photons, SIGNAL_MAX),
            width_s=BIN_S,
        )
        return arriving_light(arrivals, self.ambient, klux, background, **others)


def arriving_light(
    arrivals: Arrivals, ambient: np.ndarray, klux: Numbers, background: str, **others: Any
) -> Light:
    """Return the light of arrivals, with the background of the preset.

    ambient: float64[rows, cols], reflectivity of the pixels under even light, NaN = the usual one;
    the others are those of `Transient.light`.
    """
    rows, cols = ambient.shape
    reflectivity = ambient_reflectivity(ambient.ravel(), background)
    noise_cps = background_cps(real_array("klux", klux, (rows, cols), 0).ravel(), reflectivity)
    light = {"arrivals": arrivals, "background_cps": noise_cps} | others
    return Light(rows=rows, cols=cols, distance_m=np.nan, signal_per_pulse=0.0, **light)


@cache
def photons_per_strength(optics: Optics | None, laser: Laser | None) -> float:
    """Return the detected photons per pixel and pulse for a returned light of 1 / m2.

    The link budget at 1 m with r = 1 gives them, because such a surface returns 1 / pi.

    As everywhere in the project, a pixel has the light of one of `optics.pixels` pixels,
    whatever the size of the array. None: the paper's. Raises `InputError`.
    """
    budget = link_budget(1.0, 1.0, 0.0, optics=optics, laser=laser, form="corrected")
    return float(budget.signal_per_pulse) * math.pi


def sparse(table: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (bins of each pixel, index, value) of the nonzero entries of table[pixels, bins];
    int64, int64, its type.
    """
    pixel, index = np.nonzero(table)
    return np.bincount(pixel, minlength=len(table)), index, table[pixel, index]


def dominant_surface_m(samples_m: np.ndarray) -> np.ndarray:
    """float64[pixels] of float[pixels, samples]: mean distance of the surface that most samples
    of a pixel see.

    Samples more than `SURFACE_GAP_M` apart, without others between them, belong to different
    surfaces; among equals the nearest one is taken. Infinite samples (the sky) are a surface of
    their own.
    """
    ordered = np.sort(samples_m.astype(np.float64), axis=1)
    surface_m = np.empty(len(ordered))
    for pixel, row in enumerate(ordered):
        known = row[np.isfinite(row)]
        pieces = np.split(known, np.flatnonzero(np.diff(known) > SURFACE_GAP_M) + 1)
        largest = max(pieces, key=len)
        surface_m[pixel] = (
            largest.mean() if len(largest) and len(largest) >= len(row) - len(known) else np.inf
        )
    return surface_m
