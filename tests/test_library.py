# SPDX-License-Identifier: Apache-2.0
"""Any legal call of the library gives a result, or a sentence that says why not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import coincid
from coincid.lab.measures import MEASURES
from coincid.lab.pace import gap_for
from coincid.model.depth.methods import METHODS
from coincid.model.light.code_density import code_density
from coincid.model.light.link_budget import link_budget
from coincid.model.light.spad import dark_count_map

from .random_cases import SENSORS, configurations

EXAMPLES = 12
SCENES = ("flat:5", "flat:0.1", "two-returns:3,9", "sun-and-shade", "tunnel", "returns")
KLUX = (0.0, 1e-6, 50.0, "5|100")

SMALL = {"rows": 8, "cols": 12, "subgroup": (4, 4), "minigroup": (2, 2), "phases": 8}
# Calls of few photons, few ticks or short ranges, in which something is 0 or empty.
RARE = {
    "no light in short gates": (
        SMALL
        | {"period": 100, "clock_mhz": 10, "pulses": 20, "threshold": 1, "window": 16}
        | {"gating": True, "gate_start": 5, "gate_len": 8, "coincidence": False},
        "sun-and-shade",
        0.0,
    ),
    "a slow clock with 4 phases": (
        {"rows": 8, "cols": 8, "phases": 4, "clock_mhz": 30, "frames": 2},
        "flat:5",
        50.0,
    ),
    "a controller without capacity": (
        {"rows": 12, "cols": 6, "subgroup": (6, 3), "minigroup": (1, 1), "phases": 8}
        | {"pulses": 1, "period": 60, "link_gbps": 0.5, "clock_mhz": 100},
        "tunnel",
        50.0,
    ),
    "more columns than rows": (
        SMALL | {"rows": 20, "cols": 40, "pulses": 10},
        "five-objects",
        20.0,
    ),
    "a wall within one tick": (
        {"rows": 12, "cols": 8, "subgroup": (4, 4), "phases": 32, "period": 20, "pulses": 1}
        | {"clock_mhz": 30, "coincidence": False},
        "flat:0.1",
        1.0,
    ),
}


def look_at(run, method):
    """Take from a run everything that the library offers without a file."""
    with np.errstate(divide="raise", invalid="raise"):
        for name in MEASURES:
            run[name]
        for frame in (None, 0):
            depth = run.depth(method=method, frame=frame, returns=2)
            assert depth.depth_m.shape[:2] == run.scene.truth_m.shape
        points = run.point_cloud(method=method, normals=depth.slope_m is not None)
        assert len(points) <= depth.depth_m[:, :, 0].size
        assert len(run.events()) == run["events"] or run.config.frames > 1
        assert run.histogram(0).sum() >= 0


@pytest.mark.parametrize("method", sorted(METHODS))
@pytest.mark.parametrize("name", RARE)
def test_rare_calls_have_a_result(name, method):
    changes, scene, klux = RARE[name]
    look_at(coincid.simulate(None, scene, klux=klux, **changes), method)


@pytest.mark.parametrize("sensor", ("one", "tiny"))
@settings(max_examples=EXAMPLES)
@given(data=st.data())
def test_any_call_has_a_result_or_a_sentence(sensor, data):
    config = data.draw(configurations(SENSORS[sensor], frames_max=2))
    scene = data.draw(st.sampled_from(SCENES))
    method = data.draw(st.sampled_from(sorted(METHODS)))
    try:
        run = coincid.simulate(config, scene, klux=data.draw(st.sampled_from(KLUX)))
        look_at(run, method)
    except coincid.InputError as error:
        assert str(error)


ODD = (
    b"x",
    1 + 2j,
    2**2000,
    float("nan"),
    "five",
    (1, 2),
    np.array([]),
    np.array([1.0, 2.0]),
    np.array(1 + 2j),
    {},
)
# A call by its argument that is odd.
CALLS = {
    "klux": lambda value: coincid.simulate(None, "flat:5", klux=value, **SMALL),
    "scale": lambda value: coincid.simulate(None, "flat:5", scale=value, **SMALL),
    "unit": lambda value: coincid.simulate(None, np.full((8, 12), 5.0), unit=value, **SMALL),
    "missing": lambda value: coincid.simulate(None, "flat:5", missing=value, **SMALL),
    "spad": lambda value: coincid.simulate(None, "flat:5", spad=value, **SMALL),
    "pulse of a light": lambda value: coincid.Light(
        rows=2, cols=3, distance_m=5.0, signal_per_pulse=1.0, pulse=value
    ),
    "seed": lambda value: coincid.simulate(None, "flat:5", seed=value, **SMALL),
    "background": lambda value: coincid.simulate(None, "flat:5", background=value, **SMALL),
    "window_max": lambda value: coincid.parse_config({"sensor": {"window_max": value}}),
    "clock_mhz": lambda value: coincid.parse_config({"frame": {"clock_mhz": value}}),
    "format": lambda value: coincid.parse_config({"frame": {"format": value}}),
    "dark_cps": lambda value: coincid.generate_edges(
        coincid.Light(rows=2, cols=3, distance_m=5.0, signal_per_pulse=1.0),
        coincid.Spad(dark_cps=value),
        coincid.Timing(),
        pulses=2,
        seed=1,
    ),
    "distance_m": lambda value: link_budget(value, 0.4, 50.0),
    "budget's klux": lambda value: link_budget(5.0, 0.4, value),
    "bound's width": lambda value: coincid.bound(system_fwhm_s=value, trials=0),
    "rate_per_s": lambda value: gap_for(coincid.parse_config({}), value),
    "tick": lambda value: code_density(value, 8),
    "spectrum": lambda value: link_budget(5.0, 0.4, 50.0, spectrum=value),
    "pulse": lambda value: coincid.bound(pulse=value, trials=0),
    "seed of a map": lambda value: dark_count_map(
        16, median_cps=100.0, hot_fraction=0.1, hot_cps=1e5, seed=value
    ),
}


@pytest.mark.parametrize("name", CALLS)
def test_an_argument_of_another_kind_is_refused_in_a_sentence(name):
    """A call may take what it can read as a number, but no other error comes out of it."""
    for value in ODD:
        try:
            CALLS[name](value)
        except coincid.InputError as error:
            assert str(error)
