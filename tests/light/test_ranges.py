# SPDX-License-Identifier: Apache-2.0
"""Every number of light, detector, clock and link budget has its default and its range, whose ends are
legal and beyond which nothing is.
"""

import math

import numpy as np
import pytest
from attrs import fields

from coincid.model.light.light import Arrivals, Interferer, Light
from coincid.model.light.link_budget import Laser, Optics
from coincid.model.light.photons import edges_at_most
from coincid.model.light.spad import Spad, SpadGate, dark_count_map
from coincid.model.light.timing import Timing
from coincid.model.scenes.meaning import Meaning
from coincid.model.scenes.view import View
from coincid.model.shared.errors import InputError

ARRIVALS = {"first": [0, 1], "start_s": [0.0], "photons": [1.0]}
LIGHT = {"rows": 1, "cols": 1, "distance_m": 5.0, "signal_per_pulse": 1.0}
GIVEN = {  # what has no default
    Light: LIGHT,
    Interferer: {"photons_per_pulse": 1.0},
    Arrivals: ARRIVALS,
    SpadGate: {"start_cycles": 0, "len_cycles": 1},
}
NUMBERS = {  # of the paper where it has them: default, lowest, highest
    Spad: {
        "pdp": (0.05, 0.0, 1.0),
        "fill_factor": (0.5, 0.0, 1.0),
        "dead_time_s": (8e-9, 0.0, math.inf),
        "jitter_fwhm_s": (100e-12, 0.0, math.inf),
        "jitter_tail_fraction": (0.0, 0.0, 1.0),
        "jitter_tail_s": (0.0, 0.0, math.inf),
        "afterpulse_probability": (0.0, 0.0, 0.5),
        "afterpulse_s": (30e-9, 1e-12, math.inf),
        "crosstalk_probability": (0.0, 0.0, 0.25),
    },
    SpadGate: {
        "every_pulses": (0, 0, 1 << 62),
        "steps": (1, 1, 1 << 62),
        "frame_pulses": (1 << 62, 1, 1 << 62),
    },
    Timing: {
        "clock_hz": (500e6, 1.0, math.inf),
        "phases": (32, 1, 1024),
        "period_cycles": (250, 1, 1 << 20),
        "gap_cycles": (0, 0, (1 << 28) - 1),
        "dither_bits": (0, 0, 8),
        "dither_seed": (1, 1, 65535),
        "frame_pulses": (0, 0, 65536),
        "search_pulses": (0, 0, 65536),
        "search_minigroups": (0, 0, 65536),
    },
    Interferer: {
        "period_s": (500e-9, 1e-9, math.inf),
        "phase_s": (0.0, 0.0, math.inf),
        "fwhm_s": (490e-12, 0.0, math.inf),
    },
    Light: {"rows": (1, 1, 4096), "cols": (1, 1, 4096)},
    Arrivals: {"width_s": (0.0, 0.0, 1.0), "span_s": (0.0, 0.0, 1.0)},
    Optics: {
        "lens_diameter_m": (21e-3, 1e-6, math.inf),
        "f_number": (1.4, 0.1, math.inf),
        "transmission": (0.8, 0.0, 1.0),
        "filter_fwhm_nm": (15.0, 1e-3, 1000.0),
        "fov_h_deg": (45.0, 1e-3, 179.0),
        "fov_v_deg": (45.0, 1e-3, 179.0),
        "pixels": (1024.0, 1.0, math.inf),
    },
    Laser: {
        "average_power_w": (10e-3, 0.0, math.inf),
        "repetition_hz": (2e6, 1.0, math.inf),
        "wavelength_nm": (905.0, 300.0, 3900.0),
    },
    Meaning: {
        "scale": (1.0, 1e-3, 1e3),
        "sky_m": (None, 0.05, math.inf),
        "fov_deg": (None, 1e-3, 179.0),
    },
    View: {"h_deg": (45.0, 1e-3, 179.0), "v_deg": (45.0, 1e-3, 179.0)},
}
CASES = [(of, name) for of, numbers in NUMBERS.items() for name in numbers]
WITHOUT_RANGE = {  # arrays, switches, texts and parts with checks of their own
    Spad: {"paralyzable", "dark_cps"},
    SpadGate: {"start_cycles", "len_cycles", "step_cycles"},
    Timing: {"tap_width_lsb"},
    Interferer: {"photons_per_pulse", "delay_s"},
    Light: {
        "distance_m",
        "signal_per_pulse",
        "background_cps",
        "system_fwhm_s",
        "range_ambiguity",
        "arrivals",
        "interferer",
        "pulse",
    },
    Arrivals: {*ARRIVALS, "background_cps"},
    Optics: {"filter_shape"},
    Laser: set(),
    Meaning: {"unit", "missing", "z", "channel", "bin_ps", "recorded_pulses"},
    View: set(),
}


def beyond(low, high):
    """Return the nearest numbers that are not legal."""
    if isinstance(low, int):
        return low - 1, high + 1, low + 0.5
    return np.nextafter(low, -math.inf), np.nextafter(high, math.inf), math.inf, math.nan


@pytest.mark.parametrize("of", NUMBERS)
def test_no_number_is_missing_here(of):
    assert {field.name for field in fields(of)} == NUMBERS[of].keys() | WITHOUT_RANGE[of]


@pytest.mark.parametrize(("of", "name"), CASES)
def test_a_number_has_its_default_and_its_range(of, name):
    default, low, high = NUMBERS[of][name]
    given = GIVEN.get(of, {})
    assert getattr(of(**given), name) == default
    for legal in (low, high):
        if legal < math.inf:
            assert getattr(of(**given | {name: legal}), name) == legal
    for value in beyond(low, high):
        with pytest.raises(InputError, match=f"^{name} = .*: must be "):
            of(**given | {name: value})


def of_light(**arrays):
    return Light(**LIGHT | {"cols": 2} | arrays)


def of_interferer(**arrays):
    other = Interferer(**{"photons_per_pulse": 1.0} | arrays)
    return edges_at_most(of_light(interferer=other), Spad(), Timing())


def of_gate(**arrays):
    gate = SpadGate(**{"start_cycles": 0, "len_cycles": 1} | arrays)
    return edges_at_most(of_light(), Spad(), Timing(period_cycles=100), gate)


ARRAYS = {  # what makes or reads it, its lowest and its highest number
    "distance_m": (of_light, 0.0, math.inf),
    "signal_per_pulse": (of_light, 0.0, 1e4),
    "background_cps": (of_light, 0.0, 1e12),
    "system_fwhm_s": (of_light, 0.0, 1.0),
    "start_s": (lambda start_s: Arrivals(**ARRIVALS | _two(start_s=start_s)), 0.0, math.inf),
    "photons": (lambda photons: Arrivals(**ARRIVALS | _two(photons=photons)), 0.0, 1e4),
    "photons_per_pulse": (of_interferer, 0.0, 1e4),
    "delay_s": (of_interferer, 0.0, math.inf),
    "start_cycles": (of_gate, 0.0, 100.0),
    "len_cycles": (of_gate, 0.0, 100.0),
    "step_cycles": (of_gate, 0.0, 65535.0),
    "dark_cps": (
        lambda dark_cps: edges_at_most(of_light(), Spad(dark_cps=dark_cps), Timing()),
        0.0,
        math.inf,
    ),
}


def _two(**arrays):
    """Return arrivals in two bins, the second of which has these numbers."""
    return {"first": [0, 2], "start_s": [0.0, 1e-9], "photons": [1.0, 1.0]} | arrays


@pytest.mark.parametrize("name", ARRAYS)
def test_an_array_has_its_range_for_every_pixel(name):
    """The ends are legal; what lies beyond them is told with its place."""
    make, low, high = ARRAYS[name]
    for legal in (low, min(high, 1e9)):
        make(**{name: np.array([low, legal])})
    for wrong in (np.nextafter(low, -math.inf), np.nextafter(high, math.inf), math.inf):
        with pytest.raises(InputError, match=rf"^{name}\[1(, 0)?\] = .*: must be "):
            make(**{name: np.array([low, wrong])})


def test_a_map_of_dark_counts_has_up_to_as_many_pixels_as_a_sensor():
    counts = {"median_cps": 1.0, "hot_fraction": 0.5, "hot_cps": 2.0, "seed": 1}
    assert dark_count_map(1, **counts).tolist() in ([1.0], [2.0])
    for pixels in (0, 4096 * 4096 + 1):
        told = f"^pixels = {pixels}: must be an integer from 1 to {4096 * 4096}$"
        with pytest.raises(InputError, match=told):
            dark_count_map(pixels, **counts)
