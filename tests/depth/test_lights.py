# SPDX-License-Identifier: Apache-2.0
"""The lights that a pixel may have."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from coincid.model.depth.lights import LIGHT_SPAN, lights_near, prior_of_met

LIGHTS = np.geomspace(1e-3, 10.0, 20)


@given(prior=arrays(np.float32, 20, elements=st.floats(-20, 0, width=32)))
def test_no_light_counts_as_rarer_than_a_brighter_one(prior):
    met = prior_of_met(prior)
    assert np.all(np.diff(met) <= 0)
    for light in range(20):
        assert met[light] == prior[light:].max()


@given(known=arrays(np.float64, st.integers(1, 5), elements=st.floats(1e-3, 10.0)))
def test_the_lights_near_the_seeds_are_all_within_the_span_and_one_beyond(known):
    near = lights_near(known, LIGHTS)
    chosen = np.arange(20)[near]
    low = known.min() / LIGHT_SPAN
    high = known.max() * LIGHT_SPAN
    within = np.flatnonzero((LIGHTS >= low) & (LIGHTS <= high))
    assert set(within) <= set(chosen)
    assert len(chosen) <= len(within) + 2
    assert LIGHTS[chosen[0]] <= max(low, LIGHTS[0])
    assert LIGHTS[chosen[-1]] >= min(high, LIGHTS[-1])


def test_without_seeds_all_lights_are_possible():
    assert lights_near(np.empty(0), LIGHTS) == slice(0, 20)
