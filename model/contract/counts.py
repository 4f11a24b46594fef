# SPDX-License-Identifier: Apache-2.0
"""Counts: what a sensor counts in gates that it finds itself, in place of events.

`docs/contract.md` has the rule, `docs/counts.md` the reasons. Here are the numbers that golden
model, RTL, decoders, estimator and documents share. All of this is our own choice.
"""

import numpy as np

MINIGROUP = (2, 2)  # pixels; the rows of the memory are for these
CYCLES_MAX = 256  # of a period, in which hits count
# The memory of a minigroup.
ROWS = 8
ROW_BITS = 64
# Step 1: wide bins.
WIDE_CYCLES = 4
WIDE_BITS = 8
WIDE_BINS = CYCLES_MAX // WIDE_CYCLES
WIDE_PER_ROW = ROW_BITS // WIDE_BITS
REGIONS = 10  # wide bins that step 2 divides
# Step 2: narrow bins.
NARROW_PER_CYCLE = 2
NARROW_BITS = 6
REGION_BITS = NARROW_PER_CYCLE * NARROW_BITS  # of a cycle of a region, in a row
REGIONS_PER_ROW = ROW_BITS // REGION_BITS
PEAK_BINS = 4  # narrow bins that are a peak together
# Step 3: counts in gates.
GATES = 2
GATE_CYCLES = 4
COUNT_BITS = 4
COUNT_MOST = (1 << COUNT_BITS) - 1  # hits of a bin, with which a pixel stops
GATE_BITS = 8  # of a gate's first cycle
NO_GATE = (1 << GATE_BITS) - 1  # in place of a gate's first cycle
SEARCH_SHARE = 5  # by default, the pulses of steps 1 and 2 are this part of all pulses, each
_PAUSE = 32  # cycles for what a search does once, and on both sides of it


def pause_cycles(minigroups: int) -> tuple[int, int]:
    """Return the shortest waits after steps 1 and 2, in cycles. minigroups: of a subgroup."""
    return 832 * minigroups + _PAUSE, 520 * minigroups + _PAUSE


def with_pauses(
    starts: np.ndarray, search_pulses: int, minigroups: int, gap_cycles: int
) -> np.ndarray:
    """int64[n]: cycles at which the periods of a frame begin, later by the pauses after steps 1
    and 2.

    starts: int64[n], those of a frame without counts. search_pulses: of a step. minigroups: of a
    subgroup. gap_cycles: of every wait, which is part of a pause.
    """
    later = starts.copy()
    for step, pause in enumerate(pause_cycles(minigroups), start=1):
        later[step * search_pulses :] += max(0, pause - gap_cycles)
    return later
