"""What a timing tool must be told of the asynchronous front end: SDC, for a flow that keeps the hierarchy."""

from ..model.parameters import QUARTERS, Sensor
from .async_circuit import CLOCK_FS, lag_fs

SYSTEM = "clk"
FS_PER_NS = 1_000_000


def constraints(sensor: Sensor, spads: str = "spad_*") -> str:
    """Constraints of the front ends, behind the system clock's. spads: pattern of the ports of SPAD lines."""
    cycle, lag, tick = CLOCK_FS / FS_PER_NS, lag_fs(sensor) / FS_PER_NS, CLOCK_FS / sensor.phases / FS_PER_NS
    return f"""# Asynchronous front end: what a timing tool must be told. Times in ns; a tick is {tick:g}.
# Events are clocks of their own. Each comes at most once a cycle (a SPAD's dead time is no shorter).
create_clock -name spads -period {cycle:g} [get_ports {{{spads}}}]
create_clock -name roots -period {cycle:g} [get_pins -hierarchical *or_tree_*/y]
create_clock -name minigroups -period {cycle:g} [get_pins -hierarchical *delay_event_*/y]
create_clock -name ends -period {cycle:g} [get_pins -hierarchical *window_*/ended]
create_generated_clock -name taps -source [get_ports {SYSTEM}] -divide_by 1 [get_pins -hierarchical *generator/phases*]
create_generated_clock -name mark -source [get_ports {SYSTEM}] -divide_by 1 [get_pins -hierarchical *generator/mark]
set_clock_groups -asynchronous -group {{{SYSTEM} taps mark}} -group spads -group roots -group minigroups -group ends

# What an event has left is read half a cycle after its own cycle, by falling edges: it must be at rest by then.
set_max_delay {cycle / 2 - lag:g} -from [get_clocks roots] -to [get_clocks {SYSTEM}]
set_max_delay {cycle / 2 - lag - cycle / QUARTERS:g} -from [get_clocks ends] -to [get_clocks {SYSTEM}]

# Arms and clears reach the hit flops around the cycle's border, half a tick either way; the clear ends before.
set_max_delay {tick / 2:g} -through [get_nets -hierarchical listens_*] -to [get_clocks spads]
set_multicycle_path 1 -hold -through [get_nets -hierarchical listens_*] -to [get_clocks spads]

# Matched paths, to a quarter of a tick: SPAD to sampling flop through each tree, hit to picture.
set_data_check {tick / 4:g} -setup -from [get_pins -hierarchical *window_*/ended] -to [get_pins -hierarchical *sample_picture_*/d*]
set_data_check {tick / 4:g} -hold -from [get_pins -hierarchical *window_*/ended] -to [get_pins -hierarchical *sample_picture_*/d*]

# Asynchronous clears are strobes, not data: recovery is met by the strobes' timing (wipe ends a sixteenth of a cycle before the border).
set_false_path -through [get_nets -hierarchical clear_*]
set_dont_touch [get_cells -hierarchical {{flop_* sample_* or_* mutex_* delay_* window_* generator}}]
"""
