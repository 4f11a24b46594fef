# SPDX-License-Identifier: Apache-2.0
"""The sensor's ports under cocotb: the tests of `sensor_bench.py`, on both simulators."""

import pytest

from coincid.model.contract.parameters import Sensor
from coincid.tb.play import build_sensor
from coincid.tb.toolchain import SIMULATORS

from ..benches import BENCHES


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_ports(simulator, tmp_path):
    build = build_sensor(Sensor(rows=8, cols=16), simulator)
    build.run("sensor_bench", env={"PYTHONPATH": BENCHES}, out_dir=tmp_path, seed=1)
