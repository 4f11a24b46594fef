# SPDX-License-Identifier: Apache-2.0
"""
From parameters to Verilog, area and timing
===========================================

Change parameters of a small sensor, export its Verilog, and synthesize it: gates and flip-flops
of every block, and the number of two-input gates on its longest path, which limits the clock.
"""

import matplotlib.pyplot as plt
import numpy as np

import coincid
from coincid.flow.release import release_files
from coincid.flow.synth import GATES, synthesize

SIZES = {
    "4 phases, FIFO of 1": {"phases": 4, "fifo_depth": 1},
    "8 phases, FIFO of 4": {"phases": 8, "fifo_depth": 4},
}
base = {"rows": 4, "cols": 4, "subgroup": [4, 4], "window_max": 8, "coarse_bits": 6}
configs = {
    name: coincid.parse_config({"sensor": base | changed}) for name, changed in SIZES.items()
}
name, config = next(iter(configs.items()))
verilog = [text for file, text in release_files(config).items() if file.endswith(".v")]
print(f"{name}: {len(verilog)} Verilog files, {sum(text.count(chr(10)) for text in verilog)} lines")
netlists = {name: synthesize(config.sensor, GATES) for name, config in configs.items()}

# %%
# `synthesize` maps to two-input gates with Yosys. `coincid synth` writes the same table for
# standard cells and an ECP5 FPGA.

blocks = sorted(
    {name for netlist in netlists.values() for name, block in netlist.blocks.items() if block.total}
)
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 5), sharey=True, layout="constrained")
for i, (name, netlist) in enumerate(netlists.items()):
    of = [netlist.blocks.get(block) for block in blocks]
    at = np.arange(len(blocks)) + 0.4 * i
    left.barh(at, [block.instances * block.total if block else 0 for block in of], 0.4, label=name)
    right.barh(at, [(block.levels or 0) if block else 0 for block in of], 0.4, label=name)
    flops = netlist.total(lambda block: block.flops)
    print(
        f"{name}: {netlist.total(lambda block: block.total):.0f} gates and flip-flops, {flops:.0f} of them flip-flops"
    )
left.set_yticks(
    np.arange(len(blocks)) + 0.2,
    [block.removeprefix("coincid_") for block in blocks],
    fontsize="small",
)
left.set(xlabel="gates and flip-flops in the sensor", xscale="log")
right.set(xlabel="two-input gates on the longest path")
figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=2)
plt.show()
