# SPDX-License-Identifier: Apache-2.0
"""Sunlight in the receiver's band: a solar spectrum scaled to an illuminance, through a bandpass
filter.

Ref: paper II ("solar spectral irradiance", 50 klux, 15 nm FWHM around 905 nm; Planck's law in
the caption of Fig. 2).
Spectra: ASTM G173-03 as shipped with pvlib, and a black body. Photopic curve: the fit of Wyman,
Sloan and Shirley (2013) to CIE 1931, accurate to 1 %.
"""

from functools import cache

import numpy as np

from ..shared.constants import PLANCK_J_S, SIGMA_PER_FWHM, SPEED_OF_LIGHT_M_S
from ..shared.quantities import check_choice, check_real

BOLTZMANN_J_K = 1.380_649e-23
LUMENS_PER_WATT = 683.002
SUN_K = 5778.0

TABLE_COLUMNS = {"am15g": "global", "am15d": "direct", "am0": "extraterrestrial"}  # of ASTM G173
SPECTRA = (*TABLE_COLUMNS, "planck")
FILTERS = ("box", "gaussian")

_GRID_NM = np.arange(280.0, 4000.5, 0.5)  # range of the table, at its finest step
_BAND_POINTS = 20_001
_GAUSSIAN_REACH_SIGMA = 8.0


def irradiance_w_m2(
    klux: float,
    wavelength_nm: float = 905.0,
    fwhm_nm: float = 15.0,
    *,
    filter_shape: str = "box",
    spectrum: str = "am15g",
) -> float:
    """Irradiance behind a bandpass filter of peak transmission 1, under sunlight of `klux`.

    Raises `InputError` for an unknown name, a negative illuminance or a band outside 280...4000 nm.
    """
    check_choice("filter_shape", filter_shape, FILTERS)
    check_choice("spectrum", spectrum, SPECTRA)
    klux = check_real("klux", klux, 0)
    fwhm_nm = check_real("fwhm_nm", fwhm_nm, 1e-3, 1000)
    sigma_nm = fwhm_nm * SIGMA_PER_FWHM
    reach_nm = fwhm_nm / 2 if filter_shape == "box" else _GAUSSIAN_REACH_SIGMA * sigma_nm
    wavelength_nm = check_real(
        "wavelength_nm", wavelength_nm, _GRID_NM[0] + reach_nm, _GRID_NM[-1] - reach_nm
    )
    band_nm = np.linspace(wavelength_nm - reach_nm, wavelength_nm + reach_nm, _BAND_POINTS)
    density, lux = _spectrum(spectrum)
    passed = np.interp(band_nm, _GRID_NM, density)
    if filter_shape == "gaussian":
        passed = passed * np.exp(-0.5 * ((band_nm - wavelength_nm) / sigma_nm) ** 2)
    return float(np.trapezoid(passed, band_nm) * klux * 1e3 / lux)


def illuminance_lux(spectrum: str) -> float:
    """Illuminance of the unscaled spectrum ("planck": of the black body's own exitance)."""
    return _spectrum(spectrum)[1]


def photopic(wavelength_nm: np.ndarray) -> np.ndarray:
    """CIE 1931 luminous efficiency V(wavelength), as the sum of two lobes with unequal flanks."""
    lobes = ((0.821, 568.8, 0.0213, 0.0247), (0.286, 530.9, 0.0613, 0.0322))
    return np.sum(
        [
            height
            * np.exp(
                -0.5 * ((wavelength_nm - peak) * np.where(wavelength_nm < peak, left, right)) ** 2
            )
            for height, peak, left, right in lobes
        ],
        axis=0,
    )


@cache
def _spectrum(name: str) -> tuple[np.ndarray, float]:
    """Spectral irradiance in W/m2/nm on the grid, and its illuminance in lux."""
    check_choice("spectrum", name, SPECTRA)
    if name == "planck":
        wavelength_m = _GRID_NM * 1e-9
        exponent = PLANCK_J_S * SPEED_OF_LIGHT_M_S / (wavelength_m * BOLTZMANN_J_K * SUN_K)
        density = (
            1e-9
            * 2
            * np.pi
            * PLANCK_J_S
            * SPEED_OF_LIGHT_M_S**2
            / wavelength_m**5
            / np.expm1(exponent)
        )
    else:
        # here, because importing pvlib takes a second
        from pvlib.spectrum import get_reference_spectra

        table = get_reference_spectra()
        density = np.interp(_GRID_NM, table.index.to_numpy(), table[TABLE_COLUMNS[name]].to_numpy())
    density.flags.writeable = False
    return density, float(LUMENS_PER_WATT * np.trapezoid(density * photopic(_GRID_NM), _GRID_NM))
