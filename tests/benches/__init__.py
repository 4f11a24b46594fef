# SPDX-License-Identifier: Apache-2.0
"""cocotb benches of the regression: the tests in the folders beside it start a simulator, which
imports them by name.
"""

import json
from pathlib import Path

BENCHES = str(Path(__file__).parent)  # of the simulator's PYTHONPATH


def bench_environment(sensor: dict) -> dict[str, str]:
    """Return what a bench reads from its environment. sensor: table of a configuration."""
    return {"PYTHONPATH": BENCHES, "COINCID_BENCH_SENSOR": json.dumps(sensor)}
