# SPDX-License-Identifier: Apache-2.0
"""cocotb benches of the regression: the tests in the folders beside it start a simulator, which imports them by name."""

import json
from collections.abc import Sequence
from pathlib import Path

from ..upsets import flops

BENCHES = str(Path(__file__).parent)  # of the simulator's PYTHONPATH


def bench_environment(sensor: dict, sources: Sequence[Path] = ()) -> dict[str, str]:
    """Return what a bench reads from its environment.

    sensor: table of a configuration; sources: the design's files, for `fault_bench.py`, which flips its flip-flops."""
    registers = [(flop.path, flop.name, flop.bits) for flop in flops(sources) if not flop.memory] if sources else []
    return {
        "PYTHONPATH": BENCHES,
        "COINCID_BENCH_SENSOR": json.dumps(sensor),
        "COINCID_BENCH_FLOPS": json.dumps(registers),
    }
