# SPDX-License-Identifier: Apache-2.0
"""The sensor's ports under cocotb: the tests of `sensor_bench.py`, on both simulators."""

import pytest

from coincid.model.contract.config import parse_config
from coincid.tb.engines import SIMULATORS
from coincid.tb.play import build_sensor

from ..benches import bench_environment
from ..random_cases import LEAN, SMALL

BENCH_SENSORS = {"icarus": SMALL, "verilator": {"rows": 8, "cols": 16}}  # the mutants are small sensors on Icarus


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_ports(simulator, tmp_path):
    sensor = BENCH_SENSORS[simulator]
    build = build_sensor(parse_config({"sensor": sensor}).sensor, simulator)
    build.run("sensor_bench", env=bench_environment(sensor), out_dir=tmp_path, seed=1)


def test_a_lean_sensor_refuses_what_is_not_built(tmp_path):
    build = build_sensor(parse_config({"sensor": LEAN}).sensor, "icarus")
    env = bench_environment(LEAN) | {"COCOTB_TEST_FILTER": "only_what_is_built"}
    build.run("sensor_bench", env=env, out_dir=tmp_path, seed=1)
