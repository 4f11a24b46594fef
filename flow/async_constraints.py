# SPDX-License-Identifier: Apache-2.0
"""Timing constraints of the asynchronous front end, as SDC for a flow that keeps the hierarchy."""

from pathlib import Path

from ..hdl.silicon.circuit import Circuit, lag_fs
from ..model.contract.parameters import QUARTERS, Sensor

TEXT = Path(__file__).with_suffix(".sdc")
SYSTEM = "clk"
FS_PER_NS = 1_000_000


def async_constraints(sensor: Sensor, circuit: Circuit, spads: str = "") -> str:
    """Return the constraints of the front ends, which follow the system clock's. spads: patterns
    of the SPAD line ports, default: those of the top. No pattern fits `spad_gate`, an output.
    """
    spads = spads or " ".join(f"spad_{s}[*]" for s in range(sensor.subgroups))
    cycle, lag = circuit.clock_fs / FS_PER_NS, lag_fs(sensor) / FS_PER_NS
    tick, half = cycle / sensor.phases, cycle / 2
    times = {"cycle": cycle, "lag": lag, "tick": tick, "half": half, "half_tick": tick / 2}
    times |= {"roots": half - lag, "ends": half - lag - cycle / QUARTERS}
    _, _, text = TEXT.read_text(encoding="utf-8").partition("\n")  # without the licence
    return text.format(system=SYSTEM, spads=spads, **times)
