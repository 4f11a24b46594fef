# SPDX-License-Identifier: Apache-2.0
"""Any legal call of the library gives a result, or a sentence that says why not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import coincid
from coincid.lab.measures import MEASURES
from coincid.model.depth.methods import METHODS

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
