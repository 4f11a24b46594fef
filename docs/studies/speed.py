# SPDX-License-Identifier: Apache-2.0
"""Writes the table of `coincid bench` into docs/performance.md."""

from coincid.model.shared.folders import build_root
from coincid.study.bench import benchmark, table
from coincid.tools.pages import put

ROUNDS = 3


def make() -> None:
    """Measure, and write the table into its page."""
    put(
        "docs/performance.md",
        "bench",
        table(benchmark(build_root() / "bench.json", repeats=ROUNDS)),
    )
