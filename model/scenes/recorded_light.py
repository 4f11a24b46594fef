# SPDX-License-Identifier: Apache-2.0
"""Histograms that another SPAD sensor has recorded, as the light of a scene.

A histogram counts a pixel's photons by their time since the laser trigger. The sensor sees photons
with the same times, laser pulse and background included. The counts of a pixel are means of
Poisson numbers here, so the noise of the recording is seen as light, too. The rule for the truth is
our choice.
"""

from pathlib import Path
from typing import Any

import numpy as np
from attrs import frozen

from ..light.light import (
    BACKGROUNDS,
    NEAREST_M,
    RATE_MAX_CPS,
    SIGNAL_MAX,
    SIGNAL_REFERENCE,
    Arrivals,
    Light,
)
from ..shared.constants import SPEED_OF_LIGHT_M_S
from ..shared.errors import InputError, check_integer
from ..shared.quantities import Numbers, check_real, real_array
from .meaning import Meaning
from .scene import REFLECTIVITY, Scene
from .transient import SURFACE_GAP_M, arriving_light, sparse

PS_PER_S = 1e12
BIN_PS_MAX = 1e6
PULSES_MAX = 1 << 53
PEAK_SIGMAS = 5.0  # of its background's Poisson noise, above which a peak counts as a surface


@frozen(kw_only=True, eq=False)
class RecordedLight:
    """Histograms of rows x cols pixels, as `Scene.transient`.

    photons: float64[rows, cols, bins], mean photons per laser pulse; bin i holds times of [i, i +
    1) x `bin_s`. background: float64[rows, cols], those of a bin that are no signal. surface_m:
    float64[rows, cols], distance of each histogram's peak, NaN = none.
    """

    photons: np.ndarray
    bin_s: float
    background: np.ndarray
    surface_m: np.ndarray

    def depth_m(self) -> np.ndarray:
        """float64[rows, cols]: distance of each pixel's peak, NaN = none."""
        return self.surface_m

    def light(self, klux: Numbers, *, background: str = BACKGROUNDS[0], **others: Any) -> Light:
        """Return the detected light: that of the histograms, and background of `klux` in addition.

        klux: ambient light, a number or float64[rows, cols]; background: one of `BACKGROUNDS`;
        others: fields of `Light`.
        """
        rows, cols, bins = self.photons.shape
        per_pixel, index, photons = sparse(self.photons.reshape(rows * cols, bins))
        arrivals = Arrivals(
            first=np.concatenate([[0], np.cumsum(per_pixel)]),
            start_s=index * self.bin_s,
            photons=np.minimum(photons, SIGNAL_MAX),
            width_s=self.bin_s,
            background_cps=np.minimum(self.background.ravel() / self.bin_s, RATE_MAX_CPS),
            span_s=bins * self.bin_s,
        )
        ambient = np.full((rows, cols), np.nan)
        return arriving_light(arrivals, ambient, klux, background, **others)


def histogram_scene(
    path: str, counts: np.ndarray, rows: int, cols: int, meaning: Meaning, range_m: float
) -> Scene:
    """Return the scene whose light are histograms. Raises `InputError`.

    counts: number[rows, cols, bins]. meaning: its `bin_ps` is the width of a bin, and its
    `recorded_pulses` the number of laser pulses that they count; None: unknown, so they are scaled
    to the light for which the sensor is made.
    """
    bin_s = check_real("bin_ps", meaning.bin_ps, 1e-3, BIN_PS_MAX) / PS_PER_S
    counts = _checked(path, counts, rows, cols)
    surface_m, peak, background = _peaks(counts, bin_s)
    surface_m[~((surface_m >= NEAREST_M) & (surface_m < range_m))] = np.nan
    found = ~np.isnan(surface_m)
    if not found.any():
        raise InputError(
            f"{path}: no histogram has a peak from {NEAREST_M:g} m to the laser period's range of"
            f" {range_m:.4g} m;"
            f" a bin is {meaning.bin_ps:g} ps (bin_ps)"
        )
    notes = [
        f"{path}: {rows} x {cols} histograms of {counts.shape[2]} bins of {meaning.bin_ps:g} ps,"
        f" {counts.shape[2] * bin_s * 1e9:.4g} ns; the truth is the distance of each one's peak",
        f"{path}: the histograms' own background is part of the light; --klux adds more",
    ]
    if meaning.recorded_pulses is None:
        per_pulse = float(np.median(peak[found])) / SIGNAL_REFERENCE
        notes.append(
            f"{path}: counts are divided by {per_pulse:.4g}, so that the middle one of the peaks has"
            f" {SIGNAL_REFERENCE:g} photons per pulse; --recorded-pulses N takes them as counts of N pulses"
        )
    else:
        per_pulse = check_integer("recorded_pulses", meaning.recorded_pulses, 1, PULSES_MAX)
    if not found.all():
        notes.append(
            f"{path}: {np.sum(~found)} of {found.size} histograms have no peak in this range"
        )
    light = RecordedLight(
        photons=counts / per_pulse,
        bin_s=bin_s,
        background=background / per_pulse,
        surface_m=surface_m,
    )
    return Scene(
        name=Path(path).name,
        distance_m=surface_m,
        reflectivity=np.full((rows, cols), REFLECTIVITY),
        transient=light,
        notes=tuple(notes),
    )


def _checked(path: str, counts: np.ndarray, rows: int, cols: int) -> np.ndarray:
    """float64[rows, cols, bins]: counts of a file, 0 where masked. Raises `InputError`."""
    if counts.ndim != 3 or counts.dtype.kind not in "iuf" or not counts.size:
        raise InputError(
            f"{path}: holds {counts.dtype}{list(counts.shape)}, must hold numbers in three dimensions"
            " (rows, cols, bins), because bin_ps says that they are histograms"
        )
    high, wide, _ = counts.shape
    if (high, wide) != (rows, cols):
        raise InputError(
            f"{path}: has {high} x {wide} histograms, must have {rows} x {cols}, one for each pixel;"
            f" --set rows={high} --set cols={wide} makes the sensor fit"
        )
    return real_array(f"{path}: counts", np.ma.filled(counts, 0), counts.shape, 0)


def _peaks(counts: np.ndarray, bin_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return distance and counts of the highest peak of each histogram, NaN = no peak, and the
    counts of a bin that are background; float64[rows, cols] each.

    A peak is as wide as the gap between surfaces; its counts are those above the median bin.
    """
    bins = counts.shape[2]
    per_bin_m = bin_s * SPEED_OF_LIGHT_M_S / 2
    width = min(bins, max(1, round(SURFACE_GAP_M / per_bin_m)))
    background = np.median(counts, axis=2)
    until = np.concatenate([np.zeros((*counts.shape[:2], 1)), np.cumsum(counts, axis=2)], axis=2)
    in_window = until[:, :, width:] - until[:, :, :-width]
    begin = in_window.argmax(axis=2)
    above = np.take_along_axis(in_window, begin[:, :, None], 2)[:, :, 0] - width * background
    index = begin[:, :, None] + np.arange(width)
    weight = np.take_along_axis(counts, index, 2) - background[:, :, None]
    weight = np.maximum(weight, 0.0)
    total = weight.sum(axis=2)
    middle = (weight * (index + 0.5)).sum(axis=2) / np.where(total > 0, total, 1)
    noise = np.sqrt(np.maximum(width * background, 1.0))
    is_peak = (above > PEAK_SIGMAS * noise) & (total > 0)
    return (
        np.where(is_peak, middle * per_bin_m, np.nan),
        np.where(is_peak, above, np.nan),
        _background(counts, index),
    )


def _background(counts: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """float64[rows, cols]: mean of the bins beside the peak, without those that stand out, which
    have further surfaces. peak: int64[rows, cols, n], its bins.
    """
    beside = np.ones(counts.shape, bool)
    np.put_along_axis(beside, peak, False, 2)
    mean = _mean(counts, beside)
    deviation = np.sqrt(_mean((counts - mean[:, :, None]) ** 2, beside))
    most = mean + PEAK_SIGMAS * deviation
    return _mean(counts, beside & (counts <= most[:, :, None]))


def _mean(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """float64[rows, cols]: mean over the bins that are there, 0 without any."""
    return np.where(there, values, 0).sum(axis=2) / np.maximum(there.sum(axis=2), 1)
