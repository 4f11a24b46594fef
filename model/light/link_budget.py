# SPDX-License-Identifier: Apache-2.0
"""Link budget: detected signal and background of a flash LiDAR pixel, and their ratio.

Ref: paper II, equations (1) and (2), Fig. 2. Equation (2) is missing in print; we take it as (1)
with the sunlight on the target's area in place of the laser's power. Forms: "literal" scatters
evenly into the half-space, 1/(2 pi d^2), as printed; "corrected" assumes the Lambertian target
of the text, 1/(pi d^2) on the axis. The factor of 2 between them cancels in the ratio of signal
to background, unless dead time limits the background (reading F).
"""

import math
from typing import Any

import numpy as np
from attrs import field, fields, frozen
from numpy.typing import ArrayLike

from ..shared.arguments import given_or_new
from ..shared.constants import PLANCK_J_S, SPEED_OF_LIGHT_M_S
from ..shared.errors import InputError
from ..shared.quantities import Numbers, check_choice, check_real, real, real_array, shape_of
from .spad import Spad
from .spectrum import FILTERS, SPECTRA, irradiance_w_m2

FORMS = ("literal", "corrected")
SBR_READINGS = {  # possible meanings of SBR in Fig. 2; the paper only says that it is 0 dB at 4 m
    "A": "ratio of the mean rates",
    "E": "photons of a laser pulse to background in the SPAD's jitter (FWHM)",
    "F": "photons of a laser pulse to background after dead time in a coincidence window",
}
COINCIDENCE_WINDOW_S = 5e-9  # for reading F: the window that gives 0 dB at 4 m
DISTANCE_MIN_M = 1e-3  # limit of the equations; scenes end at `light.NEAREST_M`
DISTANCE_MAX_M = 1e9
KLUX_MAX = 1e9  # limits within which all numbers of the budget are finite
WINDOW_MAX_S = 1.0


@frozen(kw_only=True)
class Optics:
    """Receiver lens, filter and field of view (paper II); `pixels` share the field of view."""

    lens_diameter_m: float = real(21e-3, 1e-6)
    f_number: float = real(1.4, 0.1)
    transmission: float = real(0.8, 0, 1)
    filter_fwhm_nm: float = real(15.0, 1e-3, 1000)
    filter_shape: str = FILTERS[0]
    fov_h_deg: float = real(45.0, 1e-3, 179)
    fov_v_deg: float = real(45.0, 1e-3, 179)
    pixels: float = real(32 * 32, 1)

    def __attrs_post_init__(self) -> None:
        check_choice("filter_shape", self.filter_shape, FILTERS)


@frozen(kw_only=True)
class Laser:
    """Pulsed laser that floods the field of view (paper II)."""

    average_power_w: float = real(10e-3, 0)
    repetition_hz: float = real(2e6, 1)
    wavelength_nm: float = real(905.0, 300, 3900)


def _line(unit: str, source: str) -> Any:
    """Return a field that is a line of the budget."""
    return field(metadata={"unit": unit, "source": source})


@frozen(kw_only=True, eq=False)
class LinkBudget:
    """A link budget. Values that depend on the distance are floats or, for an array of
    distances, float64 of its shape.

    Rates: detected events per pixel and second before dead time (background_live_cps: after it).
    sbr_db: 10 log10 of the ratio that `sbr_reading` names. Units and sources are in `rows`.
    """

    distance_m: Numbers = _line("m", "given")
    reflectivity: float = _line("", "given")
    klux: float = _line("klux", "given")
    form: str = _line("", "1/(2 pi d^2) literal, 1/(pi d^2) corrected")
    spectrum: str = _line("", "ASTM G173 or Planck, scaled to klux")
    aperture_m2: float = _line("m2", "pi (D/2)^2")
    focal_length_m: float = _line("m", "D x f-number")
    photon_energy_j: float = _line("J", "h c / wavelength")
    pde: float = _line("", "PDP x fill factor")
    target_area_m2: Numbers = _line("m2", "4 d^2 tan(H/2) tan(V/2)")
    irradiance_w_m2: float = _line("W/m2", "spectrum through the filter")
    signal_rate_cps: Numbers = _line("1/s", "equation (1), per pixel, before dead time")
    background_rate_cps: float = _line(
        "1/s", "equation (2) and dark counts, per pixel, before dead time"
    )
    background_live_cps: float = _line("1/s", "the same after a non-paralyzable dead time")
    signal_per_pulse: Numbers = _line("", "signal rate / laser rate")
    sbr_reading: str = _line("", "; ".join(f"{key}: {text}" for key, text in SBR_READINGS.items()))
    sbr_window_s: float = _line("s", "of readings E and F")
    sbr_db: Numbers = _line("dB", "10 log10 signal / background")

    def rows(self) -> list[tuple[str, object, str, str]]:
        """Return the budget line by line: (name, value, unit, source)."""
        return [
            (a.name, getattr(self, a.name), a.metadata["unit"], a.metadata["source"])
            for a in fields(type(self))
        ]

    def json(self) -> dict[str, object]:
        """Return flat keys for a file; a ratio without background is None."""
        values = {name: getattr(self, name) for name in JSON_KEYS}
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in values.items()
        }


JSON_KEYS = tuple(
    "aperture_m2 photon_energy_j irradiance_w_m2 signal_rate_cps background_rate_cps signal_per_pulse sbr_db sbr_reading".split()
)


def link_budget(
    distance_m: ArrayLike,
    reflectivity: float,
    klux: float,
    *,
    optics: Optics | None = None,
    laser: Laser | None = None,
    spad: Spad | None = None,
    spectrum: str = SPECTRA[0],
    form: str = FORMS[0],
    sbr_reading: str = "E",
    sbr_window_s: float | None = None,
) -> LinkBudget:
    """Return the budget at `distance_m` (a number or an array), for a target of `reflectivity`
    under `klux` of sunlight.

    sbr_window_s: window of readings E (default: the SPAD's jitter FWHM) and F (default:
    `COINCIDENCE_WINDOW_S`). Raises `InputError` for values out of range and unknown names.
    """
    optics = given_or_new("optics", optics, Optics)
    laser = given_or_new("laser", laser, Laser)
    spad = given_or_new("spad", spad, Spad)
    check_choice("form", form, FORMS)
    check_choice("sbr_reading", sbr_reading, tuple(SBR_READINGS))
    reflectivity = check_real("reflectivity", reflectivity, 0, 1)
    if sbr_window_s is None:
        sbr_window_s = COINCIDENCE_WINDOW_S if sbr_reading == "F" else spad.jitter_fwhm_s
    sbr_window_s = check_real("sbr_window_s", sbr_window_s, 0, WINDOW_MAX_S)
    klux = check_real("klux", klux, 0, KLUX_MAX)
    shape = shape_of("distance_m", distance_m)
    distance_m = real_array("distance_m", distance_m, shape, DISTANCE_MIN_M, DISTANCE_MAX_M)
    if not distance_m.size:
        raise InputError(
            "distance_m: is empty, must hold at least one distance", field="distance_m"
        )

    aperture_m2 = math.pi * (optics.lens_diameter_m / 2) ** 2
    photon_energy_j = PLANCK_J_S * SPEED_OF_LIGHT_M_S / (laser.wavelength_nm * 1e-9)
    pde = spad.pdp * spad.fill_factor
    half_h, half_v = (math.radians(angle / 2) for angle in (optics.fov_h_deg, optics.fov_v_deg))
    target_area_m2 = 4 * distance_m**2 * math.tan(half_h) * math.tan(half_v)
    irradiance = irradiance_w_m2(
        klux,
        laser.wavelength_nm,
        optics.filter_fwhm_nm,
        filter_shape=optics.filter_shape,
        spectrum=spectrum,
    )
    solid_angle = (2 if form == "literal" else 1) * math.pi
    cps_per_watt = (
        reflectivity
        * optics.transmission
        / (solid_angle * distance_m**2)
        / optics.pixels
        * pde
        * aperture_m2
        / photon_energy_j
    )
    signal_rate_cps = laser.average_power_w * cps_per_watt
    # the same at every distance, up to rounding
    on_target = irradiance * target_area_m2 * cps_per_watt
    dark_cps = real_array("dark_cps", spad.dark_cps, shape_of("dark_cps", spad.dark_cps), 0)
    if not dark_cps.size:
        raise InputError("dark_cps: is empty, must hold at least one rate", field="dark_cps")
    background_rate_cps = float(np.mean(on_target) + np.mean(dark_cps))
    background_live_cps = background_rate_cps / (1 + background_rate_cps * spad.dead_time_s)
    signal_per_pulse = signal_rate_cps / laser.repetition_hz
    signal, background = {
        "A": (signal_rate_cps, background_rate_cps),
        "E": (signal_per_pulse, background_rate_cps * sbr_window_s),
        "F": (signal_per_pulse, background_live_cps * sbr_window_s),
    }[sbr_reading]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        sbr_db = 10 * np.log10(np.divide(signal, background))
    return LinkBudget(
        distance_m=_plain(distance_m),
        reflectivity=float(reflectivity),
        klux=float(klux),
        form=form,
        spectrum=spectrum,
        aperture_m2=aperture_m2,
        focal_length_m=optics.lens_diameter_m * optics.f_number,
        photon_energy_j=photon_energy_j,
        pde=pde,
        target_area_m2=_plain(target_area_m2),
        irradiance_w_m2=irradiance,
        signal_rate_cps=_plain(signal_rate_cps),
        background_rate_cps=background_rate_cps,
        background_live_cps=background_live_cps,
        signal_per_pulse=_plain(signal_per_pulse),
        sbr_reading=sbr_reading,
        sbr_window_s=float(sbr_window_s),
        sbr_db=_plain(sbr_db),
    )


def _plain(value: Numbers) -> Numbers:
    """Return a float if the value has no dimensions, otherwise the array."""
    return float(value) if np.ndim(value) == 0 else value
