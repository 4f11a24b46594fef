# SPDX-License-Identifier: Apache-2.0
"""Shares of pulses whose gate is open, against a gate that goes through the frame pulse by pulse."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coincid.model.depth.gates import gate_turns, open_pulses, open_share

from ..random_cases import configured


@settings(max_examples=50)
@given(
    start=st.integers(0, 59),
    length=st.integers(0, 63),
    step=st.integers(0, 20),
    every=st.integers(0, 3),
    steps=st.integers(1, 4),
    pulses=st.integers(1, 12),
)
def test_the_share_of_a_cycle_is_that_of_its_pulses(start, length, step, every, steps, pulses):
    frame = {"period": 60, "pulses": pulses}
    frame |= {"gate_step": step, "gate_every": every, "gate_steps": steps}
    gate = {"gating": True, "gate_start": start, "gate_len": length}
    config = configured({"rows": 8, "cols": 8}, frame, gate)
    is_open = np.zeros((pulses, config.period))
    for pulse in range(pulses):
        first = start + step * ((pulse // every) % steps if every else 0)
        is_open[pulse, first : first + length] = 1
    assert open_share(config, 0, range(pulses)) == pytest.approx(is_open.mean(axis=0))
    for begin in range(pulses):
        ends = np.arange(begin, pulses + 1)
        number = [is_open[begin:end].sum(axis=0) for end in ends]
        np.testing.assert_array_equal(open_pulses(config, 0, begin, ends), number)
    turns = gate_turns(config, 0)
    before = np.pad(is_open, ((0, 0), (1, 0)))[:, :-1]
    np.testing.assert_array_equal(turns.opens, (is_open > before).sum(axis=0))
    np.testing.assert_array_equal(turns.closes, (is_open < before).sum(axis=0))
