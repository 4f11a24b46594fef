# SPDX-License-Identifier: Apache-2.0
"""The sensor's ports under cocotb: the tests of `sensor_bench.py`, on both simulators."""

import json

import pytest

from coincid.model.contract.config import parse_config
from coincid.tb.play import build_sensor
from coincid.tb.toolchain import SIMULATORS

from ..benches import BENCHES
from ..cases import SMALL

BENCH_SENSORS = {"icarus": SMALL, "verilator": {"rows": 8, "cols": 16}}  # the mutants are small sensors on Icarus


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_ports(simulator, tmp_path):
    sensor = BENCH_SENSORS[simulator]
    env = {"PYTHONPATH": BENCHES, "COINCID_BENCH_SENSOR": json.dumps(sensor)}
    build_sensor(parse_config({"sensor": sensor}).sensor, simulator).run(
        "sensor_bench", env=env, out_dir=tmp_path, seed=1
    )
