# SPDX-License-Identifier: Apache-2.0
"""The sensor under faults: the tests of `fault_bench.py`, on Icarus, where a bench can see inside."""

import json

from coincid.model.contract.parameters import Sensor
from coincid.tb.play import build_sensor
from coincid.tb.rtl import rtl

from ..benches import BENCHES
from ..cases import SMALL


def test_faults(tmp_path):
    sensor = Sensor(**{name: tuple(value) if isinstance(value, list) else value for name, value in SMALL.items()})
    build = build_sensor(sensor, "icarus")
    env = {
        "PYTHONPATH": BENCHES,
        "COINCID_BENCH_SENSOR": json.dumps(SMALL),
        "COINCID_FAULT_SOURCES": json.dumps([str(path) for path in rtl(sensor)]),
    }
    build.run("fault_bench", env=env, out_dir=tmp_path, seed=1)
