# SPDX-License-Identifier: Apache-2.0
"""The end of a window: when it closes, and when the tree is armed again.

These functions are plain integer arithmetic. They accept numbers and arrays, and kernels compile their own versions. A
window opens at a tick of a laser period and lasts `window_ticks`; cycles and ticks are counted from the start of the
period.
"""

from typing import TypeVar

import numpy as np

_Number = TypeVar("_Number", int, np.ndarray)


def close_cycle(opening_tick: _Number, window_ticks: _Number | int, phases: int) -> _Number:
    """Return c, the cycle of the window's last tick, from which its commit is counted (`latency.COMMIT`)."""
    return (opening_tick + window_ticks - 1) // phases


def armed_cycle(close: _Number, rearm_cycles: int) -> _Number:
    """Return c + 1 + R, the first cycle in which the tree may open a window again."""
    return close + 1 + rearm_cycles
