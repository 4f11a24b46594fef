# SPDX-License-Identifier: Apache-2.0
"""cocotb benches of the regression: the tests in the folders beside it start a simulator, which imports them by name."""

import json
from collections.abc import Sequence
from pathlib import Path

from ..upsets import registers_of

BENCHES = str(Path(__file__).parent)  # of the simulator's PYTHONPATH


def bench_environment(sensor: dict, sources: Sequence[Path] = ()) -> dict[str, str]:
    """Return what a bench reads from its environment.

    sensor: table of a configuration; sources: the design's files, for `fault_bench.py`, which flips its flip-flops."""
    found = registers_of(sources) if sources else {}
    # Neither rows of memories nor registers without a name of their own.
    named = {register: bits for register, bits in found.items() if "[" not in register and ".$" not in register}
    registers = [(*register.rpartition(".")[::2], bits) for register, bits in named.items()]
    return {
        "PYTHONPATH": BENCHES,
        "COINCID_BENCH_SENSOR": json.dumps(sensor),
        "COINCID_BENCH_FLOPS": json.dumps(registers),
    }
