# SPDX-License-Identifier: Apache-2.0
"""
Sweeping a design space with Dask
=================================

`coincid sweep` runs a grid of settings in processes on this machine or on a cluster, and writes
one Parquet table and one plot. In Python, the function `sweep` does the same. Finished points
are kept, so a changed sweep runs only the new points.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import pyarrow.parquet

from coincid.study.sweep import sweep
from coincid.study.sweep_spec import read_spec

SPEC = """
klux = 50.0
method = "matched"

[sensor]
rows = 16
cols = 16

[frame]
pulses = 50

[[axis]]
subgroup.threshold = [1, 2, 3, 4, 5]

[[axis]]
sensor.fifo_depth = [1, 4, 16]
"""

if __name__ == "__main__":  # the workers are processes that import this file again
    folder = Path(tempfile.mkdtemp())
    (folder / "spec.toml").write_text(SPEC, encoding="utf-8")
    out = folder / "sweep.parquet"
    summary = sweep(
        read_spec(folder / "spec.toml"), out, workers=2, title="FIFO depth and threshold"
    )
    table = pyarrow.parquet.read_table(out)
    print(f"{summary.rows} points; columns: {', '.join(table.column_names[:8])}, ...")

    rows = table.to_pylist()
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for depth, colour in ((1, "#46327e"), (4, "#277f8e"), (16, "#4ac16d")):
        line = [row for row in rows if row["sensor.fifo_depth"] == depth]
        threshold = [row["subgroup.threshold"] for row in line]
        left.plot(
            threshold,
            [row["dropped_share"] for row in line],
            "o-",
            color=colour,
            label=f"FIFO of {depth}",
        )
        right.plot(
            threshold,
            [row["wrong_share"] for row in line],
            "o-",
            color=colour,
            label=f"FIFO of {depth}",
        )
    left.set(xlabel="threshold in pixels", ylabel="share of events dropped")
    right.set(xlabel="threshold in pixels", ylabel="share of wrong pixels", ylim=(0, 1))
    left.legend()
    plt.show()
