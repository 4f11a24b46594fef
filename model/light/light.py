# SPDX-License-Identifier: Apache-2.0
"""Inputs of the photon model: light per pixel and its presets.

Ref: paper II (SPAD, laser), IV (pulse of 500 to 520 ps FWHM). Effects that the paper leaves out
are off by default.
"""

import math
from types import NoneType
from typing import Any

import numpy as np
from attrs import NOTHING, field, frozen
from numpy.typing import ArrayLike

from ..shared.arguments import check_kind
from ..shared.errors import InputError
from ..shared.pulse import Pulse, pulse_of
from ..shared.quantities import (
    Numbers,
    check_choice,
    given,
    integer,
    real,
    real_array,
    shape_of,
    switch,
)

# detected, per pixel; our preset: a level at which thresholds are selective
BACKGROUND_CPS_PER_KLUX = 1.226e6 / 50
SIGNAL_REFERENCE = (
    0.613  # detected photons per pulse and pixel by equation (1) at the two values below
)
REFERENCE_DISTANCE_M = 4.0
REFERENCE_REFLECTIVITY = 0.4
NEAREST_M = 0.05  # nearest surface of a scene: the signal grows without bound towards 0
# photons per pixel and pulse: a pixel fires in nearly every pulse, and more light only adds pile-up
MUCH_SIGNAL = 2.0
SIGNAL_MAX = 1e4  # photons per pixel and pulse
RATE_MAX_CPS = 1e12
BACKGROUNDS = ("reflected", "even")  # by equation (2); the same for every surface


def background_cps(klux: Numbers, reflectivity: ArrayLike = REFERENCE_REFLECTIVITY) -> Numbers:
    """Detected background of a pixel in counts per second under `klux` of ambient light
    (float64, shapes broadcast).

    Equation (2) of the paper: proportional to the light and to the reflectivity of the surface,
    independent of its distance. The level is our preset. Raises `InputError`.
    """
    checked_klux = real_array("klux", klux, shape_of("klux", klux), 0)
    relative = np.asarray(reflectivity) / REFERENCE_REFLECTIVITY
    with np.errstate(over="ignore"):  # `Light` refuses an infinite rate
        rate_cps = BACKGROUND_CPS_PER_KLUX * checked_klux * relative
    return rate_cps if rate_cps.ndim else float(rate_cps)


def ambient_reflectivity(reflectivity: np.ndarray, background: str) -> np.ndarray:
    """float64[pixels]: the reflectivity to which the background of each pixel is proportional.
    Raises `InputError`.

    reflectivity: float64[pixels], of the pixel's surface; NaN = unknown, for which
    `REFERENCE_REFLECTIVITY` is used.
    background: one of `BACKGROUNDS`; with `even`, every pixel has the reference reflectivity.
    """
    even = check_choice("background", background, BACKGROUNDS) == "even"
    return np.where(even | np.isnan(reflectivity), REFERENCE_REFLECTIVITY, reflectivity)


def signal_per_pulse(distance_m: ArrayLike, reflectivity: ArrayLike) -> np.ndarray:
    """Detected signal photons per pulse and pixel (float64, shapes broadcast); 0 where the
    distance is NaN.

    Equation (1) of the paper: proportional to reflectivity / distance^2.
    """
    scaled = (
        np.asarray(reflectivity)
        / REFERENCE_REFLECTIVITY
        * (REFERENCE_DISTANCE_M / np.asarray(distance_m)) ** 2
    )
    return np.nan_to_num(SIGNAL_REFERENCE * scaled, nan=0.0)


@frozen(kw_only=True, eq=False)
class Interferer:
    """Another LiDAR whose pulses reach the sensor.

    photons_per_pulse: detected photons of each of its pulses, a number or float64[pixels].
    period_s: its own laser period. phase_s: from our first trigger to the arrival of its first
    pulse; it has sent pulses before that, too.
    delay_s: added for each pixel, a number or float64[pixels]. fwhm_s: width of its pulse.
    """

    photons_per_pulse: Numbers
    period_s: float = real(500e-9, 1e-9)
    phase_s: float = real(0.0, 0)
    delay_s: Numbers = 0.0
    fwhm_s: float = real(490e-12, 0)


@frozen(kw_only=True, eq=False)
class Arrivals:
    """Signal of any shape in time, in bins. Pixel p has the bins first[p] to first[p + 1].

    The laser pulse's own shape is added to this. first: int64[pixels + 1]. start_s: float64[n],
    beginning of each bin since the laser trigger, ascending in a pixel (beyond the laser period:
    light of an earlier pulse). photons: float64[n], mean detected photons per pulse. width_s:
    width of a bin, which is filled evenly. background_cps: a number or float64[pixels], detected
    counts per second that are among these photons, and that are no signal; span_s: how long they
    last from the trigger on.
    """

    first: np.ndarray
    start_s: np.ndarray
    photons: np.ndarray
    width_s: float = real(0.0, 0, 1)
    background_cps: Numbers = 0.0
    span_s: float = real(0.0, 0, 1)

    def __attrs_post_init__(self) -> None:
        own = shape_of("photons", self.photons)
        photons = real_array("photons", self.photons, own, 0, SIGNAL_MAX)
        first = real_array("first", self.first, shape_of("first", self.first), 0, 2.0**53)
        if photons.ndim != 1:
            raise InputError(f"photons: has shape {photons.shape}, must have a number per bin")
        n = len(photons)
        first = first.astype(np.int64)
        if (
            first.ndim != 1
            or len(first) < 2
            or first[0] != 0
            or first[-1] != n
            or np.any(np.diff(first) < 0)
        ):
            raise InputError(f"first: must ascend from 0 to the {n} bins")
        object.__setattr__(self, "first", first)
        object.__setattr__(self, "start_s", real_array("start_s", self.start_s, (n,), 0))
        object.__setattr__(self, "photons", photons)
        noise_cps = real_array(
            "background_cps", self.background_cps, (len(first) - 1,), 0, RATE_MAX_CPS
        )
        object.__setattr__(self, "background_cps", noise_cps)
        inner = np.delete(
            np.diff(self.start_s), first[1:-1][(first[1:-1] > 0) & (first[1:-1] < n)] - 1
        )
        if np.any(inner < 0):
            raise InputError("start_s: must ascend in every pixel")

    @property
    def signal(self) -> np.ndarray:
        """float64[pixels]: photons per pulse, without those of the background."""
        until = np.concatenate([[0.0], np.cumsum(self.photons)])
        of_pixels = np.diff(until[self.first])
        return np.maximum(of_pixels - self.background_cps * self.span_s, 0.0)


@frozen(kw_only=True, eq=False)
class Light:
    """Light that each of rows x cols pixels detects: with the PDE, without the dead time. Arrays
    broadcast.

    distance_m: float64[pixels, targets], NaN = no target; a one-dimensional array has one target
    per pixel.
    signal_per_pulse: float64[pixels, targets], mean detected photons per laser pulse.
    background_cps: float64[pixels], detected counts per second. system_fwhm_s: float64[pixels,
    targets], FWHM of the signal at the TDC's input: laser pulse and SPAD jitter, added as
    squares, so the laser pulse is sqrt(system_fwhm_s^2 - jitter_fwhm_s^2).
    range_ambiguity: light from beyond the laser period falls into a later period, as if the
    laser had been running before; False: it is lost. arrivals: additional signal of any shape in
    time; its laser pulse has the width of the pixel's first target. interferer: another LiDAR.
    pulse: measured shape of the signal at the TDC's input (what `pulse_of` takes), instead of a
    Gaussian of `system_fwhm_s`; the SPAD's jitter is in it, so no further jitter is drawn.
    """

    rows: int = integer(NOTHING, 1, 4096)
    cols: int = integer(NOTHING, 1, 4096)
    distance_m: np.ndarray = field(converter=given)
    signal_per_pulse: np.ndarray = field(converter=given)
    background_cps: np.ndarray = field(default=0.0, converter=given)
    system_fwhm_s: np.ndarray = field(default=500e-12, converter=given)
    range_ambiguity: bool = switch(True)
    arrivals: Arrivals | None = None
    interferer: Interferer | None = None
    pulse: Pulse | None = field(default=None, converter=pulse_of)

    def __attrs_post_init__(self) -> None:
        check_kind("arrivals", self.arrivals, Arrivals, NoneType)
        check_kind("interferer", self.interferer, Interferer, NoneType)
        for name in ("distance_m", "signal_per_pulse", "system_fwhm_s"):
            shape_of(name, getattr(self, name))
            array = np.asanyarray(getattr(self, name))  # with its mask
            object.__setattr__(self, name, array[:, None] if array.ndim == 1 else array)
        targets = max(self.distance_m.shape[-1:] + self.signal_per_pulse.shape[-1:], default=1)
        per_target = (self.pixels, targets)
        for name, shape, highest in (
            ("distance_m", per_target, math.inf),
            ("signal_per_pulse", per_target, SIGNAL_MAX),
            ("system_fwhm_s", per_target, 1.0),
            ("background_cps", (self.pixels,), RATE_MAX_CPS),
        ):
            checked = real_array(
                name, getattr(self, name), shape, 0, highest, nan=name == "distance_m"
            )
            object.__setattr__(self, name, checked)
        if self.arrivals is not None and len(self.arrivals.first) != self.pixels + 1:
            raise InputError(
                f"arrivals: has {len(self.arrivals.first) - 1} pixels, must have {self.pixels}"
            )

    @property
    def pixels(self) -> int:
        return self.rows * self.cols

    @property
    def total_signal(self) -> np.ndarray:
        """float64[pixels]: detected signal photons per pulse, of targets and `arrivals`
        together.
        """
        total = self.signal_per_pulse.sum(axis=1)
        if self.arrivals is None:
            return total
        return total + self.arrivals.signal

    @property
    def total_background_cps(self) -> np.ndarray:
        """float64[pixels]: detected counts per second of all background, also of that among the
        `arrivals`.
        """
        if self.arrivals is None:
            return self.background_cps
        return self.background_cps + self.arrivals.background_cps

    def notes(self) -> tuple[str, ...]:
        """Notes for the user: whether the signal is far above the level for which the sensor is
        made.
        """
        lit = self.total_signal[self.total_signal > 0]
        if not len(lit) or np.median(lit) <= MUCH_SIGNAL:
            return ()
        farther = math.sqrt(np.median(lit) / SIGNAL_REFERENCE)
        return (
            f"signal: half of the pixels detect more than {np.median(lit):.1f} photons per pulse, and the sensor is made for about "
            f"{SIGNAL_REFERENCE:.1f}: its stamps are those of first photons. For depth files, SCALE={farther:.1g} (--scale) puts "
            "the scene farther away",
        )

    @classmethod
    def from_scene(
        cls,
        distance_m: ArrayLike,
        reflectivity: ArrayLike,
        klux: Numbers,
        *,
        background: str = BACKGROUNDS[0],
        **others: Any,
    ) -> "Light":
        """Return the light of the presets. Raises `InputError`.

        distance_m: float64[rows, cols] or [rows, cols, targets], NaN = no target; reflectivity:
        broadcast to it. klux: ambient light, a number or float64[rows, cols]. background: one of
        `BACKGROUNDS`. others: fields of `Light`.
        """
        shape = shape_of("distance_m", distance_m)
        if len(shape) not in (2, 3):
            raise InputError(
                f"distance_m: has {len(shape)} dimensions, must have 2 or 3: rows, cols, targets"
            )
        rows, cols = shape[:2]
        targets = math.prod(shape[2:])
        distance_m = real_array("distance_m", distance_m, shape, NEAREST_M, nan=True)
        reflectivity = real_array("reflectivity", reflectivity, distance_m.shape, 0, 1)
        signal = signal_per_pulse(distance_m, reflectivity)
        flat = (rows * cols, targets)
        has_target = ~np.isnan(distance_m).reshape(flat)
        seen = np.where(
            has_target.any(axis=1),
            np.where(has_target, reflectivity.reshape(flat), 0).sum(axis=1),
            np.nan,
        )
        ambient = ambient_reflectivity(seen, background)
        return cls(
            rows=rows,
            cols=cols,
            distance_m=distance_m.reshape(flat),
            signal_per_pulse=signal.reshape(flat),
            background_cps=background_cps(
                real_array("klux", klux, (rows, cols), 0).ravel(), ambient
            ),
            **others,
        )
