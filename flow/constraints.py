# SPDX-License-Identifier: Apache-2.0
"""What a timing tool must be told of the asynchronous front end: SDC, for a flow that keeps the hierarchy."""

from ..hdl.silicon.circuit import Circuit, lag_fs
from ..model.contract.parameters import QUARTERS, Sensor

SYSTEM = "clk"
FS_PER_NS = 1_000_000


def constraints(sensor: Sensor, circuit: Circuit, spads: str = "spad_*") -> str:
    """Constraints of the front ends, behind the system clock's. spads: pattern of the ports of SPAD lines."""
    cycle, lag = circuit.clock_fs / FS_PER_NS, lag_fs(sensor) / FS_PER_NS
    tick = cycle / sensor.phases
    return f"""# Asynchronous front end: what a timing tool must be told. Times in ns; a tick is {tick:g}.
# Events are clocks of their own. Each comes at most once a cycle (a SPAD's dead time is no shorter).
create_clock -name spads -period {cycle:g} [get_ports {{{spads}}}]
create_clock -name roots -period {cycle:g} [get_pins -hierarchical *or_tree_*/y]
create_clock -name minigroups -period {cycle:g} [get_pins -hierarchical *delay_event_*/y]
create_clock -name ends -period {cycle:g} [get_pins -hierarchical *window_*/ended]
create_generated_clock -name taps -source [get_ports {SYSTEM}] -divide_by 1 [get_pins -hierarchical *generator/phases*]
create_generated_clock -name mark -source [get_ports {SYSTEM}] -divide_by 1 [get_pins -hierarchical *generator/mark]
set_clock_groups -asynchronous -group spads -group roots -group minigroups -group ends -group {{taps mark}}

# What an event has left is read half a cycle after its own cycle, by falling edges: it must be at rest by then.
set_max_delay {cycle / 2:g} -from [get_clocks spads] -to [get_clocks {SYSTEM}]
set_max_delay {cycle / 2 - lag:g} -from [get_clocks {{roots minigroups}}] -to [get_clocks {SYSTEM}]
set_max_delay {cycle / 2 - lag - cycle / QUARTERS:g} -from [get_clocks ends] -to [get_clocks {SYSTEM}]
set_false_path -hold -from [get_clocks {{spads roots minigroups ends}}] -to [get_clocks {SYSTEM}]

# Arms reach the flops that events set within half a tick of each other. What they take alike adds to the generator's lag.
set arm_delay {lag:g}
set_max_delay [expr $arm_delay + {tick / 2:g}] -from [get_clocks {SYSTEM}] -to [get_clocks {{spads roots}}]
set_min_delay [expr $arm_delay - {tick / 2:g}] -from [get_clocks {SYSTEM}] -to [get_clocks {{spads roots}}]

# Clears are strobes, not data: recovery is met by their timing (wipe ends a sixteenth of a cycle before the border).
set_false_path -through [get_pins -hierarchical *flop_*/clear]

# Cells and macros stay as they are. Their matched delays are contracts (docs/async.md) that no constraint of this language can say.
if {{[llength [info commands set_dont_touch]]}} {{
  set_dont_touch [get_cells -hierarchical {{flop_* sample_* or_* mutex_* delay_* window_* generator}}]
}}
"""
