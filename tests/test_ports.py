"""The sensor's ports under cocotb: the tests of `sensor_bench.py`, on both simulators."""

from pathlib import Path

import pytest

from coincid.model.parameters import Sensor
from coincid.tb.replay import build_sensor
from coincid.tb.toolchain import SIMULATORS


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_ports(simulator, tmp_path):
    build = build_sensor(Sensor(rows=8, cols=16), simulator)
    build.run("sensor_bench", env={"PYTHONPATH": str(Path(__file__).parent)}, out_dir=tmp_path, seed=1)
