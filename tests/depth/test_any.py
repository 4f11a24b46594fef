# SPDX-License-Identifier: Apache-2.0
"""Any sensor, settings and light give a depth, or a sentence that says why not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.depth.belief import Reason
from coincid.model.depth.histograms import SOURCES
from coincid.model.depth.methods import METHODS
from coincid.model.light.light import Light
from coincid.model.shared.errors import InputError

from ..random_cases import SENSORS, configurations

EXAMPLES = 20
PULSES = (1, 2, 7, 100, 1000, 10_000)
PHOTONS = (0.0, 1e-4, 0.01, 0.3, 3.0, 100.0)  # per pulse and pixel
BACKGROUND_CPS = (0.0, 1e3, 1e6, 1e8)


@st.composite
def lights(draw, config):
    """Draw up to three surfaces for each of a few kinds of pixels, some beyond the period or
    without light.
    """
    sensor = config.sensor
    kinds, surfaces = draw(st.integers(1, 4)), draw(st.integers(1, 3))
    far_m = 1.2 * config.period_ticks * config.tick_m
    table = st.lists(
        st.tuples(st.one_of(st.just(np.nan), st.floats(0.05, far_m)), st.sampled_from(PHOTONS)),
        min_size=surfaces,
        max_size=surfaces,
    )
    values = np.array([draw(table) for _ in range(kinds)])
    kind = np.random.default_rng(draw(st.integers(0, 99))).integers(0, kinds, sensor.array_pixels)
    return Light(
        rows=sensor.rows,
        cols=sensor.cols,
        distance_m=values[kind, :, 0],
        signal_per_pulse=values[kind, :, 1],
        background_cps=draw(st.sampled_from(BACKGROUND_CPS)),
        range_ambiguity=draw(st.booleans()),
    )


@pytest.mark.parametrize("sensor", ("one", "tiny", "odd"))
@settings(max_examples=EXAMPLES)
@given(data=st.data())
def test_a_depth_or_a_sentence(sensor, data):
    config = data.draw(configurations(SENSORS[sensor], frames_max=1))
    config = config.with_frame(pulses=data.draw(st.sampled_from(PULSES)))
    run = Run(
        Setup(
            config=config,
            light=data.draw(lights(config)),
            spad_gate=data.draw(st.booleans()),
            estimators=(),
        )
    )
    method, source = (
        data.draw(st.sampled_from(tuple(METHODS))),
        data.draw(st.sampled_from(tuple(SOURCES))),
    )
    with np.errstate(divide="raise", invalid="raise"):
        try:
            depth = run.depth(f"{method}/{source}", returns=data.draw(st.integers(1, 3)))
        except InputError as error:
            # of a SPAD gate
            assert str(error).count(":") and (method != "planes" or "step_cycles" in str(error))
            return
    assert np.all((0 <= depth.confidence) & (depth.confidence <= 1))
    assert not depth.confidence[np.isnan(depth.depth_m)].any()
    believed = depth.reason == Reason.BELIEVED
    assert depth.reason.dtype == np.uint8 and set(depth.reason.ravel()) <= set(Reason)
    assert not believed[np.isnan(depth.depth_m[:, :, 0])].any()
    seen = depth.depth_m[~np.isnan(depth.depth_m)]
    assert np.all((seen >= 0) & (seen <= config.period_ticks * config.tick_m))
