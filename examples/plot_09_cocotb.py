# SPDX-License-Identifier: Apache-2.0
"""
Driving the RTL from your own cocotb bench
==========================================

Export the Verilog of a small sensor and drive it from your own cocotb bench, on Icarus Verilog.
The bench is `bench_events.py` in the same folder. It uses the AXI drivers of cocotbext-axi and
no code of this project.
"""

import json
import os
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
from cocotb_tools.check_results import get_results
from cocotb_tools.runner import get_runner

import coincid
from coincid.flow.release import write_release
from coincid.model.contract.registers import address

config = coincid.parse_config({"sensor": {"rows": 8, "cols": 8}})
folder = Path(tempfile.mkdtemp())
write_release(folder / "rtl", config)  # the same as `coincid verilog --config small.toml --out rtl`
sources = [
    folder / "rtl" / name
    for name in (folder / "rtl" / "coincid.f").read_text(encoding="utf-8").split()
]
print(
    f"{len(sources)} Verilog files, {sum(len(path.read_text(encoding='utf-8').splitlines()) for path in sources)} lines"
)

# %%
# Compile and run. The bench checks the event itself; a failed check makes the run fail.

seen = folder / "seen.json"
names = ("period", "pulses", "threshold", "control")
environment = {
    "COINCID_REGISTERS": json.dumps({name: address(name) for name in names}),
    "COINCID_SEEN": str(seen),
}
sys.path.insert(0, os.getcwd())  # where bench_events.py is
runner = get_runner("icarus")
runner.build(
    sources=sources,
    hdl_toplevel="coincid_sensor",
    build_dir=folder / "sim",
    timescale=("1ns", "1ps"),
    build_args=["-g2005"],
)
results = runner.test(
    test_module="bench_events",
    hdl_toplevel="coincid_sensor",
    extra_env=environment,
    results_xml=str(folder / "results.xml"),
    log_file=folder / "sim.log",
)
tests, failures = get_results(results)
assert (tests, failures) == (1, 0), (folder / "sim.log").read_text(encoding="utf-8")

# %%
# The record of the bench: photons arrive in cycles 5 and 6, and the event leaves the sensor
# after its window has closed.

told = json.loads(seen.read_text(encoding="utf-8"))
cycles, valid, photons = zip(*told["rows"], strict=True)
figure, axis = plt.subplots(figsize=(9, 2.6), layout="constrained")
axis.bar(cycles, photons, width=0.9, color="#c8501e", label="photons driven in this cycle")
axis.step(
    cycles, [-1.5 + one for one in valid], where="mid", color="#277f8e", label="m_axis_tvalid"
)
axis.set(xlabel="clock cycles since the laser trigger", yticks=[0, 1, 2, 3])
axis.set_title(
    f"stamp {told['stamp']} ticks, count {told['count']}: frame start packet, event and map, frame end packet"
)
axis.legend(loc="upper right")
plt.show()
