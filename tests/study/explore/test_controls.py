# SPDX-License-Identifier: Apache-2.0
"""Which controls have an effect: whatever the table of needs disables changes nothing that the
sensor sends.
"""

import numpy as np
import pytest

from coincid.lab.outcomes import Run, StageCache
from coincid.study.explore.control_values import check_settings
from coincid.study.explore.controls import DEFAULTS, NEEDS

SMALL = {"rows": 8, "cols": 8, "pulses": 20, "frames": 2, "scene": "flat", "klux": 60.0}
GATED = {"gating": True, "gate_every": 2, "gate_steps": 4, "gate_start": 5}
SETTINGS = {
    "plain": {},
    "controller": {"auto": True},
    "off": {"coincidence": False, "auto": True},
    "counts": {"format": "counts", "auto": True, "minigroup_records": True},
    "gated counts": {"format": "counts"} | GATED,
    "records": {"minigroup_records": True},
    "full": {"format": "compact-full", "dither_bits": 3},
    "gated": GATED,
    "gate that stays": GATED | {"gate_every": 0},
    "gate of one step": GATED | {"gate_steps": 1},
    "shade": {"sun": "left half", "scene": "two-targets"},
}
OTHER = {
    "auto": (False, True),
    "coincidence": (False, True),
    "minigroup_records": (False, True),
    "gate_start": (30,),
    "gate_len": (5,),
    "spad_gate": (True,),
    "gate_step": (4,),
    "gate_every": (3,),
    "gate_steps": (3,),
    "threshold": (1, 5),
    "window": (3, 40),
    "threshold_floor": (4, 7),
    "capacity": (5,),
    "search_pulses": (1, 4),
    "mg_threshold": (1,),
    "mg_window": (1,),
    "offset_phases": (8,),
    "dither_seed": (5,),
    "near_m": (3.0,),
    "far_m": (12.0,),
    "reflectivity": (0.1,),
    "shade": (0.5,),
    "shade_klux": (30.0,),
    "unit": ("mm",),
    "channel": ("Z",),
    "missing": (5.0,),
    "fov_deg": (60.0,),
    "z": (True,),
    "sky_m": (3.0,),
}
# they have one only together, so those that are set first are not disabled
TOGETHER = {"gate_every", "gate_steps"}


def is_enabled(name, values):
    """As page.js decides it."""

    def met(other, legal):
        value = values[other]
        return value in legal if isinstance(legal, tuple) else (value or 0) > legal

    return any(all(met(*one) for one in need.items()) for need in NEEDS[name])


def sent(values, cache):
    """Return what the sensor sends; the thresholds in a result repeat the settings."""
    result = Run(check_settings(values).setup(), cache=cache).result
    return {key: np.asarray(result[key]).tobytes() for key in result if key != "threshold_used"}


@pytest.mark.parametrize("values", SETTINGS.values(), ids=SETTINGS)
def test_controls_with_an_effect_are_those_that_are_not_disabled(values):
    cache = StageCache(8)
    values = DEFAULTS | SMALL | values
    before = sent(values, cache)
    changing = {
        name
        for name in NEEDS
        for other in OTHER[name]
        if other != values[name] and sent(values | {name: other}, cache) != before
    }
    enabled = {name for name in NEEDS if is_enabled(name, values)}
    assert changing <= enabled
    assert enabled - changing <= TOGETHER
