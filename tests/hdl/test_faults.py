# SPDX-License-Identifier: Apache-2.0
"""The sensor under faults: the tests of `fault_bench.py`, on Icarus, where a bench can see inside."""

from coincid.model.contract.config import parse_config
from coincid.tb.play import build_sensor
from coincid.tb.rtl import rtl

from ..benches import bench_environment
from ..random_cases import SMALL


def test_faults(tmp_path):
    sensor = parse_config({"sensor": SMALL}).sensor
    env = bench_environment(SMALL, rtl(sensor))
    build_sensor(sensor, "icarus").run("fault_bench", env=env, out_dir=tmp_path, seed=1)
