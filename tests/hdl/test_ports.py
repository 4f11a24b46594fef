# SPDX-License-Identifier: Apache-2.0
"""The sensor under cocotb: its ports on both simulators (`sensor_bench.py`), faults on Icarus,
where a bench sees inside.
"""

import pytest

from coincid.model.contract.config import parse_config
from coincid.tb.play import build_sensor

from ..benches import bench_environment
from ..random_cases import LEAN, SMALL

# whose masks end within a word, and have an odd number of ones there
PART_OF_A_WORD = dict(rows=5, cols=14, subgroup=[5, 7], minigroup=[5, 1], phases=4, window_max=8)


@pytest.mark.parametrize(
    ("bench", "simulator", "table", "only"),
    [
        ("sensor_bench", "icarus", SMALL, ""),
        ("sensor_bench", "verilator", {"rows": 8, "cols": 16}, ""),
        ("sensor_bench", "icarus", LEAN, "only_what_is_built"),
        ("sensor_bench", "icarus", PART_OF_A_WORD, "what_is_written|values_of_a_reset"),
        ("fault_bench", "icarus", SMALL, ""),
    ],
    ids=("icarus", "verilator", "lean", "masks", "faults"),
)
def test_ports(bench, simulator, table, only, tmp_path):
    sensor = parse_config({"sensor": table}).sensor
    environment = bench_environment(table) | ({"COCOTB_TEST_FILTER": only} if only else {})
    build_sensor(sensor, simulator).run(bench, env=environment, out_dir=tmp_path)
