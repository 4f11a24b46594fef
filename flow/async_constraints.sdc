# SPDX-License-Identifier: Apache-2.0
# Asynchronous front end: constraints for a timing tool. Times in ns; a tick is {tick:g}.
# Events are clocks of their own. Each comes at most once per cycle (a SPAD's dead time is at least a cycle).
create_clock -name spads -period {cycle:g} [get_ports {{{spads}}}]
create_clock -name roots -period {cycle:g} [get_pins -hierarchical *or_tree_*/y]
create_clock -name minigroups -period {cycle:g} [get_pins -hierarchical *delay_event_*/y]
create_clock -name ends -period {cycle:g} [get_pins -hierarchical *window_*/ended]
create_generated_clock -name taps -source [get_ports {system}] -divide_by 1 [get_pins -hierarchical *generator/phases*]
create_generated_clock -name mark -source [get_ports {system}] -divide_by 1 [get_pins -hierarchical *generator/mark]
set_clock_groups -asynchronous -group spads -group roots -group minigroups -group ends -group {{taps mark}}

# The trace of an event is read half a cycle after its own cycle, by falling edges: it must be stable by then.
set_max_delay {half:g} -from [get_clocks spads] -to [get_clocks {system}]
set_max_delay {roots:g} -from [get_clocks {{roots minigroups}}] -to [get_clocks {system}]
set_max_delay {ends:g} -from [get_clocks ends] -to [get_clocks {system}]
set_false_path -hold -from [get_clocks {{spads roots minigroups ends}}] -to [get_clocks {system}]

# Arms reach the flops that events set within half a tick of each other. Their common delay adds to the generator's lag.
set arm_delay {lag:g}
set_max_delay [expr $arm_delay + {half_tick:g}] -from [get_clocks {system}] -to [get_clocks {{spads roots}}]
set_min_delay [expr $arm_delay - {half_tick:g}] -from [get_clocks {system}] -to [get_clocks {{spads roots}}]

# Clears are strobes, not data: recovery is met by their timing (wipe ends a sixteenth of a cycle before the border).
set_false_path -through [get_pins -hierarchical *flop_*/clear]

# Cells and macros stay as they are. Their matched delays are requirements (docs/async.md) that SDC cannot express.
if {{[llength [info commands set_dont_touch]]}} {{
  set_dont_touch [get_cells -hierarchical {{flop_* sample_* or_* mutex_* delay_* window_* generator}}]
}}
