# SPDX-License-Identifier: Apache-2.0
"""The latencies that RTL and golden model share: the number of cycles that each block takes.

They are our choice; the paper gives none. Cycles are counted at the sensor's ports: an edge word
that is at the ports in cycle c belongs to cycle c, and all latencies count from there. The
functions for the end of a window accept numbers and arrays, and kernels compile their own versions.
"""

from typing import TypeVar

import numpy as np

_Number = TypeVar("_Number", int, np.ndarray)

# L: close cycle of a window -> cycle of its commit (the FIFO is written at the end of that cycle)
COMMIT = 8
RECORD = (
    3  # first cycle after a period -> cycle in which the minigroup record of the period is written
)
STORE_TO_GRANT = 3  # an event or record is stored -> earliest grant of the readout
# Grant -> the subgroup forms the packet's first beat; the last beat frees the event's or
# record's place.
GRANT_TO_READ = 2
GRANT_TO_BEAT = 4  # grant -> the packet's first beat is written to the stream's output buffer
BEAT_TO_PORT = 2  # written to the output buffer -> earliest transfer at the stream's port
FRAME_START = 1  # cycle of a frame in which the frame start packet is granted
FINISH = 12  # first cycle after the last period -> earliest grant of the frame end packet


def output_depth(longest_packet: int) -> int:
    """Return the depth of a stream's output buffer in beats: enough to keep the stream busy
    while a grant takes effect.
    """
    round_trip = GRANT_TO_BEAT + BEAT_TO_PORT + 2
    return 1 << (2 * longest_packet + round_trip - 1).bit_length()


def close_cycle(opening_tick: _Number, window_ticks: _Number | int, phases: int) -> _Number:
    """Return c, the cycle of the period with the window's last tick, from which its commit is
    counted (`COMMIT`).
    """
    return (opening_tick + window_ticks - 1) // phases


def armed_cycle(close: _Number, rearm_cycles: int) -> _Number:
    """Return c + 1 + R, the first cycle in which the tree may open a window again."""
    return close + 1 + rearm_cycles
