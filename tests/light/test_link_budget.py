# SPDX-License-Identifier: Apache-2.0
"""The link budget against numbers checked by hand, to four digits."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import constants
from scipy.optimize import brentq

from coincid.model.light.link_budget import JSON_KEYS, SBR_READINGS, Laser, Optics, link_budget
from coincid.model.light.spad import Spad
from coincid.model.light.spectrum import illuminance_lux, irradiance_w_m2, photopic
from coincid.model.shared.errors import InputError


def four_digits(value):
    return pytest.approx(value, rel=5e-4)


def test_constants():
    budget = link_budget(4.0, 0.4, 50)
    assert budget.aperture_m2 == four_digits(3.4636e-4)
    assert budget.photon_energy_j == pytest.approx(2.19497e-19, rel=3e-6)
    assert budget.focal_length_m == four_digits(29.4e-3)
    assert budget.pde == pytest.approx(0.025)
    assert budget.target_area_m2 == four_digits(0.68629 * 16)


@pytest.mark.parametrize(
    "distance_m, rate_cps, per_pulse",
    [(1, 1.962e7, 9.81), (4, 1.226e6, 0.613), (10, 1.962e5, 0.0981), (50, 7848, 3.924e-3)],
)
def test_signal_of_equation_1(distance_m, rate_cps, per_pulse):
    literal, corrected = (
        link_budget(distance_m, 0.4, 50, form=form) for form in ("literal", "corrected")
    )
    assert literal.signal_rate_cps == four_digits(rate_cps)
    assert literal.signal_per_pulse == four_digits(per_pulse)
    assert corrected.signal_rate_cps == pytest.approx(2 * literal.signal_rate_cps)


@pytest.mark.parametrize(
    "spectrum, filter_shape, w_m2",
    [
        ("am15g", "box", 4.73),
        ("am15g", "gaussian", 5.13),
        ("am15d", "box", 4.99),
        ("am15d", "gaussian", 5.41),
        ("am0", "box", 5.10),
        ("am0", "gaussian", 5.44),
        ("planck", "box", 5.413),
    ],
)
def test_irradiance_of_50_klux(spectrum, filter_shape, w_m2):
    assert irradiance_w_m2(50, filter_shape=filter_shape, spectrum=spectrum) == pytest.approx(
        w_m2, rel=1.1e-3
    )
    assert irradiance_w_m2(5, filter_shape=filter_shape, spectrum=spectrum) == pytest.approx(
        w_m2 / 10, rel=1.1e-3
    )


@pytest.mark.parametrize("spectrum, lux", [("am15g", 109_574), ("am15d", 97_217), ("am0", 133_184)])
def test_illuminance_of_the_unscaled_spectra(spectrum, lux):
    assert illuminance_lux(spectrum) == pytest.approx(lux, rel=1e-4)


def test_illuminance_of_the_black_body_is_that_of_plancks_law():
    """Of its own exitance: both polarizations, over the half space."""
    wavelength_m = np.linspace(380e-9, 780e-9, 4001)
    exponent = constants.h * constants.c / (wavelength_m * constants.k * 5778)
    radiance = 2 * constants.h * constants.c**2 / wavelength_m**5 / np.expm1(exponent)
    lux = 683 * np.trapezoid(np.pi * radiance * photopic(wavelength_m * 1e9), wavelength_m)
    assert illuminance_lux("planck") == pytest.approx(lux, rel=1e-3)


@pytest.mark.parametrize(
    "spectrum, rate_cps, live_cps", [("am15g", 6.37e9, 1.2259e8), ("planck", 7.29e9, 1.2289e8)]
)
def test_background_of_equation_2(spectrum, rate_cps, live_cps):
    budgets = [link_budget(distance_m, 0.4, 50, spectrum=spectrum) for distance_m in (1, 50)]
    assert budgets[0].background_rate_cps == pytest.approx(rate_cps, rel=1e-3)
    assert budgets[0].background_live_cps == four_digits(live_cps)
    assert budgets[0].background_rate_cps == pytest.approx(budgets[1].background_rate_cps)


@pytest.mark.parametrize(
    "reading, spectrum, distance_m",
    [
        ("A", "am15g", 0.0555),
        ("A", "planck", 0.0519),
        ("E", "am15g", 3.92),
        ("E", "planck", 3.67),
        ("F", "am15g", 4.0),
        ("F", "planck", 3.99),
    ],
)
def test_distance_of_0_db(reading, spectrum, distance_m):
    def sbr_db(d, form="literal"):
        return link_budget(d, 0.4, 50, spectrum=spectrum, form=form, sbr_reading=reading).sbr_db

    assert brentq(sbr_db, 0.01, 50) == pytest.approx(distance_m, rel=3e-3)
    # elsewhere, the factor between the forms cancels
    more_of_dead_time_db = 10 * np.log10(2) if reading == "F" else 0
    assert sbr_db(4.0, "corrected") == pytest.approx(sbr_db(4.0) + more_of_dead_time_db, abs=0.05)


@pytest.mark.parametrize("reading", ["E", "F"])
def test_background_of_a_ratio_is_that_of_its_window(reading):
    """Ten times as long a window: 10 dB less."""
    ratios_db = [
        link_budget(4.0, 0.4, 50, sbr_reading=reading, sbr_window_s=window_s).sbr_db
        for window_s in (0.2e-9, 2e-9)
    ]
    assert ratios_db[0] - ratios_db[1] == pytest.approx(10)
    none = link_budget(4.0, 0.4, 50, sbr_reading=reading, sbr_window_s=0)
    assert (none.sbr_window_s, none.sbr_db) == (0.0, np.inf)


@given(st.floats(0.5, 50), st.floats(0.01, 1), st.floats(0.1, 120))
def test_laws(distance_m, reflectivity, klux):
    """The signal follows the inverse square law and is linear in reflectivity and power, the
    background is linear in the ambient light, and an array of distances gives the same numbers as
    its elements.
    """
    budget = link_budget(distance_m, reflectivity, klux)
    farther, darker = (
        link_budget(2 * distance_m, reflectivity, klux),
        link_budget(distance_m, reflectivity / 2, klux),
    )
    brighter = link_budget(distance_m, reflectivity, 2 * klux)
    assert farther.signal_rate_cps == pytest.approx(budget.signal_rate_cps / 4)
    assert darker.background_rate_cps == pytest.approx(budget.background_rate_cps / 2)
    assert brighter.background_rate_cps == pytest.approx(2 * budget.background_rate_cps)
    stronger = link_budget(distance_m, reflectivity, klux, laser=Laser(average_power_w=20e-3))
    assert stronger.sbr_db == pytest.approx(budget.sbr_db + 10 * np.log10(2))
    both = link_budget(np.array([distance_m, 1.0]), reflectivity, klux)
    assert both.signal_rate_cps[0] == pytest.approx(
        budget.signal_rate_cps
    ) and both.sbr_db.shape == (2,)


@given(st.floats(1, 170), st.floats(1, 170))
def test_a_receiver_on_its_side_has_the_same_budget(h_deg, v_deg):
    """Both angles of the view count, and neither more than the other."""
    upright = link_budget(4.0, 0.4, 50, optics=Optics(fov_h_deg=h_deg, fov_v_deg=v_deg))
    turned = link_budget(4.0, 0.4, 50, optics=Optics(fov_h_deg=v_deg, fov_v_deg=h_deg))
    assert upright.target_area_m2 == pytest.approx(turned.target_area_m2)
    assert upright.background_rate_cps == pytest.approx(turned.background_rate_cps)
    half_h, half_v = np.tan(np.deg2rad([h_deg / 2, v_deg / 2]))
    assert upright.target_area_m2 == pytest.approx(4 * 16 * half_h * half_v)


OTHER_PARTS = {
    "optics": [
        Optics(lens_diameter_m=20e-3),
        Optics(f_number=1.5),
        Optics(transmission=0.7),
        Optics(filter_fwhm_nm=14.0),
        Optics(filter_shape="gaussian"),
        Optics(fov_h_deg=44.0),
        Optics(fov_v_deg=43.0),
        Optics(pixels=1000),
    ],
    "laser": [
        Laser(average_power_w=9e-3),
        Laser(repetition_hz=1e6),
        Laser(wavelength_nm=910.0),
    ],
    "spad": [
        Spad(pdp=0.06),
        Spad(fill_factor=0.4),
        Spad(dead_time_s=9e-9),
        Spad(jitter_fwhm_s=90e-12),
        Spad(dark_cps=100.0),
    ],
}


@pytest.mark.parametrize("part", OTHER_PARTS)
def test_every_property_of_a_part_changes_the_budget(part):
    budgets = [link_budget(4.0, 0.4, 50)]
    budgets += [link_budget(4.0, 0.4, 50, **{part: one}) for one in OTHER_PARTS[part]]
    assert len({repr(one.rows()) for one in budgets}) == 1 + len(OTHER_PARTS[part])
    if part != "spad":  # of which the budget needs these only
        assert len(OTHER_PARTS[part]) == len(type(OTHER_PARTS[part][0]).__attrs_attrs__)


UNITS = {
    "distance_m": "m",
    "klux": "klux",
    "aperture_m2": "m2",
    "focal_length_m": "m",
    "photon_energy_j": "J",
    "target_area_m2": "m2",
    "irradiance_w_m2": "W/m2",
    "signal_rate_cps": "1/s",
    "background_rate_cps": "1/s",
    "background_live_cps": "1/s",
    "sbr_window_s": "s",
    "sbr_db": "dB",
}


@pytest.mark.parametrize("reading", ["A", "E", "F"])
def test_each_line_has_its_unit_and_what_was_given(reading):
    """Names end with the unit if there is one; the others are numbers and texts without."""
    budget = link_budget(4.0, 0.3, 70, sbr_reading=reading, form="corrected", spectrum="planck")
    lines = {name: (value, unit) for name, value, unit, _ in budget.rows()}
    assert {name: unit for name, (_, unit) in lines.items() if unit} == UNITS
    given = {"distance_m": 4.0, "reflectivity": 0.3, "klux": 70.0, "sbr_reading": reading}
    given |= {"form": "corrected", "spectrum": "planck"}
    given["sbr_window_s"] = 5e-9 if reading == "F" else 100e-12
    assert {name: lines[name][0] for name in given} == given


def test_lines_and_json():
    budget = link_budget(4.0, 0.4, 50, sbr_reading="F")
    assert tuple(budget.json()) == JSON_KEYS
    assert {name: value for name, value, _, _ in budget.rows()}.items() >= budget.json().items()
    assert all(source for *_, source in budget.rows())
    for reflectivity, klux in ((0.4, 0), (0, 50), (0, 0)):  # infinite, minus infinite, no number
        dark = Spad(dark_cps=100.0 * (klux > 0))
        assert link_budget(4.0, reflectivity, klux, spad=dark).json()["sbr_db"] is None
    assert set(SBR_READINGS) == {"A", "E", "F"}


def test_dark_counts_are_background():
    dark = link_budget(4.0, 0.4, 0, spad=Spad(dark_cps=np.array([100.0, 300.0])))
    assert dark.background_rate_cps == pytest.approx(200)


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: link_budget(0, 0.4, 50), r"distance_m = 0.0: must be from 0.001"),
        (lambda: link_budget(4, 1.4, 50), r"reflectivity = 1.4: must be a number from 0 to 1"),
        (lambda: link_budget(4, 0.4, -1), r"klux = -1: must be a number from 0"),
        (
            lambda: link_budget(4, 0.4, 50, spectrum="moon"),
            r"spectrum = 'moon': must be one of am15g, am15d, am0, planck",
        ),
        (
            lambda: link_budget(4, 0.4, 50, form="x"),
            r"form = 'x': must be one of literal, corrected",
        ),
        (
            lambda: link_budget(4, 0.4, 50, sbr_reading="B"),
            r"sbr_reading = 'B': must be one of A, E, F",
        ),
        (
            lambda: Optics(filter_shape="round"),
            r"filter_shape = 'round': must be one of box, gaussian",
        ),
        (lambda: Optics(transmission=1.2), r"transmission = 1.2: must be a number from 0 to 1"),
        (
            lambda: irradiance_w_m2(50, 3999.0),
            r"wavelength_nm = 3999.0: must be a number from 287.5 to 3992.5",
        ),
        (lambda: illuminance_lux("moon"), r"spectrum = 'moon': must be one of am15g, am15d, am0"),
        (
            lambda: link_budget(1.1e9, 0.4, 50),
            r"distance_m = 1100000000.0: must be from .* to 1e\+09",
        ),
        (
            lambda: link_budget(4, 0.4, 1.1e9),
            r"klux = 1100000000.0: must be a number from 0 to 1e\+09",
        ),
        (lambda: link_budget(4, 0.4, 5, sbr_window_s=1.1), r"sbr_window_s = 1.1: .* from 0 to 1$"),
        (
            lambda: link_budget(4, 0.4, 5, spad=Spad(dark_cps=-1)),
            r"dark_cps = -1.0: must be at least 0",
        ),
        (
            lambda: link_budget(4, 0.4, 5, spad=Spad(dark_cps=np.array([1.0, np.nan]))),
            r"dark_cps\[1\] = nan: must be at least 0",
        ),
        (lambda: link_budget(4, 0.4, 5, spad=Spad(dark_cps="few")), r"dark_cps: must hold numbers"),
        (lambda: link_budget([], 0.4, 5), r"distance_m: is empty, must hold at least one distance"),
        (
            lambda: link_budget(4, 0.4, 5, spad=Spad(dark_cps=[])),
            r"dark_cps: is empty, must hold at least one rate",
        ),
    ],
)
def test_bad_input_names_field_and_range(make, message):
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.parametrize(("filter_shape", "reach_nm"), [("box", 10.0), ("gaussian", 67.946)])
def test_a_band_lies_within_the_spectra(filter_shape, reach_nm):
    """Also that of a Gaussian filter, which passes light eight deviations from its middle."""
    band = {"fwhm_nm": 20.0, "filter_shape": filter_shape}
    for end_nm, inwards in ((280, 1), (4000, -1)):
        assert irradiance_w_m2(50, end_nm + 1.001 * inwards * reach_nm, **band) > 0
        with pytest.raises(InputError, match="wavelength_nm = .* must be a number from"):
            irradiance_w_m2(50, end_nm + 0.999 * inwards * reach_nm, **band)


@pytest.mark.parametrize("reading", SBR_READINGS)
def test_numbers_of_a_budget_are_finite_up_to_its_limits(reading):
    for distance_m, klux, window_s in itertools.product((1e-3, 1e9), (1e-9, 1e9), (1e-12, 1.0)):
        options = {"sbr_reading": reading, "sbr_window_s": window_s}
        budget = link_budget(distance_m, 1.0, klux, **options)
        numbers = [value for _, value, _, _ in budget.rows() if isinstance(value, float)]
        assert np.isfinite(numbers).all()
