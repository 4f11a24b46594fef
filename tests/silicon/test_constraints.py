# SPDX-License-Identifier: Apache-2.0
"""Times in the constraints of the asynchronous front end, by hand for several clocks."""

import re

import pytest
from attrs import evolve

from coincid.flow.async_constraints import async_constraints
from coincid.hdl.silicon.circuit import Circuit, lag_fs
from coincid.model.contract.parameters import Sensor

SENSOR = Sensor(rows=8, cols=8)


@pytest.mark.parametrize("clock_mhz", [100.0, 125.0, 250.0])
@pytest.mark.parametrize("phases", [8, 16, 32])
def test_each_event_has_the_rest_of_half_a_cycle(clock_mhz, phases):
    """Half a cycle after an edge, what it sampled is taken. A root comes later than its edge by the
    lag of the tree, and a window's end by another quarter of a cycle.
    """
    sensor = evolve(SENSOR, phases=phases, offset_phases=min(16, phases))
    text = async_constraints(sensor, evolve(Circuit(), clock_mhz=clock_mhz))
    half_ns = 500 / clock_mhz
    lag_ns = lag_fs(sensor) * 1e-6
    at_most = dict(
        re.findall(r"set_max_delay ([-\d.e]+) -from \[get_clocks \{?([\w ]+)\}?\] -to", text)
    )
    allowed = {names: float(ns) for ns, names in at_most.items()}
    assert allowed == {
        "spads": pytest.approx(half_ns, rel=1e-4),
        "roots minigroups": pytest.approx(half_ns - lag_ns, rel=1e-4),
        "ends": pytest.approx(half_ns - lag_ns - half_ns / 2, rel=1e-4),
    }
    assert min(allowed.values()) > 0
    around = re.findall(r"set_(max|min)_delay \[expr \$arm_delay ([+-]) ([\d.e-]+)\]", text)
    assert [(bound, sign) for bound, sign, _ in around] == [("max", "+"), ("min", "-")]
    half_tick_ns = half_ns / phases
    assert all(float(ns) == pytest.approx(half_tick_ns, rel=1e-4) for *_, ns in around)
    periods = re.findall(r"create_clock -name \w+ -period ([\d.e-]+)", text)
    assert [float(ns) for ns in periods] == [pytest.approx(2 * half_ns, rel=1e-4)] * 4
