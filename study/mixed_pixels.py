# SPDX-License-Identifier: Apache-2.0
"""Which accuracy the light of mixed pixels allows, by rules that know more than an estimator (docs/two-surfaces.md).

`python -m coincid.study.mixed_pixels` prints the table. No rule uses neighbouring pixels. The rules of the exact light
take each pixel's transient from the ray tracer. The others take the time of the first laser photon of every pulse, without
windows and background.
"""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ..model.depth.quality import wrong_share
from ..model.light.link_budget import Laser, Optics
from ..model.scenes.catalogue import load_scene
from ..model.scenes.transient import BIN_S, SURFACE_GAP_M, photons_per_strength
from ..model.shared.constants import SIGMA_PER_FWHM, SPEED_OF_LIGHT_M_S
from ..model.shared.markdown import table

SCENE, ROWS, COLS = "ray:five-objects", 32, 32
PULSES, SEEDS = (100, 400), range(6)
METRES_PER_S = SPEED_OF_LIGHT_M_S / 2
SIGMA_M = 500e-12 * SIGMA_PER_FWHM * METRES_PER_S  # laser pulse and jitter
STEP_M, REACH_M = 0.01, 1.0
SMALL_GAP_M = 0.05
WIDE = 4  # filter of the photons' times, in widths of the pulse
FAINT = 1e-6  # of the brightest bin: less light leaves a gap
STRAY = 1e-4  # share of the photons that the shape of the light does not explain
EXACT = ("gaps of 5 cm, mean of the surface", "light times squared distance, gaps of 15 cm, median of the surface")
FROM_PHOTONS = (
    "median within 1 m of the densest time, each with its squared distance",
    "densest time, smoothed with four times the pulse's width",
    "most likely shift of the shape of the pixel's light",
)


def brightest_surface(distance_m: np.ndarray, light: np.ndarray, gap_m: float) -> np.ndarray:
    """Return the bins of the brightest surface, int64[n]. Two surfaces have a gap of more than `gap_m` between them."""
    seen = np.flatnonzero(light > FAINT * light.max())
    pieces = np.split(seen, np.flatnonzero(np.diff(distance_m[seen]) > gap_m) + 1)
    return max(pieces, key=lambda piece: float(light[piece].sum()))


def median_m(distance_m: np.ndarray, weight: np.ndarray) -> float:
    """Return the first of the ascending distances up to which half of the weight lies."""
    total = np.cumsum(weight)
    return float(distance_m[np.searchsorted(total, total[-1] / 2)])


def densest_m(photons_m: np.ndarray, sigma_m: float) -> float:
    """Return where photons at the distances float64[n] are densest after a Gaussian filter."""
    grid_m = np.arange(photons_m.min() - 0.1, photons_m.max() + 0.1, STEP_M)
    return float(grid_m[np.exp(-0.5 * ((grid_m[:, None] - photons_m) / sigma_m) ** 2).sum(1).argmax()])


def shift_m(photons_m: np.ndarray, distance_m: np.ndarray, light: np.ndarray) -> float:
    """Return the shift of the pixel's true light, float64[bins], that makes its photons most likely."""
    grid_m = np.arange(distance_m.min() - REACH_M, distance_m.max() + REACH_M, STEP_M)
    shape = np.histogram(distance_m, np.append(grid_m, grid_m[-1] + STEP_M) - STEP_M / 2, weights=light / light.sum())[
        0
    ]
    chance = np.log(gaussian_filter1d(shape, SIGMA_M / STEP_M) + STRAY / len(grid_m))
    shifts_m = np.arange(-REACH_M, REACH_M + STEP_M / 2, STEP_M)
    return float(max(shifts_m, key=lambda by_m: np.interp(photons_m - by_m, grid_m, chance).sum()))


def first_photons_m(rng: np.random.Generator, distance_m: np.ndarray, signal: np.ndarray, pulses: int) -> np.ndarray:
    """Return the distance of each pulse's first photon. signal: float64[bins], photons per pulse."""
    pulse = np.repeat(np.arange(pulses), rng.poisson(signal.sum(), pulses))
    times_m = rng.choice(distance_m, len(pulse), p=signal / signal.sum()) + rng.normal(0, SIGMA_M, len(pulse))
    first_m = np.full(pulses, np.inf)
    np.minimum.at(first_m, pulse, times_m)
    return np.sort(first_m[np.isfinite(first_m)])


def estimates_m(photons_m: np.ndarray, distance_m: np.ndarray, light: np.ndarray, truth_m: float) -> list[float]:
    """Return the distance by each of the rules `FROM_PHOTONS`; NaN without photons."""
    if not len(photons_m):
        return [np.nan] * len(FROM_PHOTONS)
    near_m = photons_m[np.abs(photons_m - densest_m(photons_m, 2 * SIGMA_M)) < REACH_M]
    shifted_m = truth_m + shift_m(photons_m, distance_m, light)
    return [median_m(near_m, near_m**2), densest_m(photons_m, WIDE * SIGMA_M), shifted_m]


def main() -> None:
    scene = load_scene(SCENE, ROWS, COLS)
    transient, truth_m = scene.transient, scene.truth_m.ravel()
    assert transient is not None
    signal = transient.strength_per_m2 * photons_per_strength(Optics(), Laser())
    exact_m = np.full((len(EXACT), truth_m.size), np.nan)
    found_m = np.full((len(PULSES), len(SEEDS), len(FROM_PHOTONS), truth_m.size), np.nan)
    rngs = {at: np.random.default_rng(at) for at in np.ndindex(len(PULSES), len(SEEDS))}
    for pixel, (begin, end) in enumerate(zip(transient.first, transient.first[1:])):
        if begin == end:
            continue
        distance_m, light = (transient.index[begin:end] + 0.5) * BIN_S * METRES_PER_S, signal[begin:end]
        here = brightest_surface(distance_m, light, SMALL_GAP_M)
        at_source = light * distance_m**2
        there = brightest_surface(distance_m, at_source, SURFACE_GAP_M)
        exact_m[:, pixel] = (
            np.average(distance_m[here], weights=light[here]),
            median_m(distance_m[there], at_source[there]),
        )
        for at, rng in rngs.items():
            photons_m = first_photons_m(rng, distance_m, light, PULSES[at[0]])
            found_m[(*at, slice(None), pixel)] = estimates_m(photons_m, distance_m, light, truth_m[pixel])
    rows: list[tuple[str, ...]] = [
        ("the exact light", rule, f"{wrong_share(m, truth_m):.1%}", "") for rule, m in zip(EXACT, exact_m)
    ]
    for k, rule in enumerate(FROM_PHOTONS):
        shares = [np.mean([wrong_share(m, truth_m) for m in of_seeds[:, k]]) for of_seeds in found_m]
        rows.append(("photons", rule, *(f"{share:.1%}" for share in shares)))
    print("\n".join(table(["information", "rule", *(f"{pulses} pulses" for pulses in PULSES)], rows, left=(0, 1))))


if __name__ == "__main__":
    main()
