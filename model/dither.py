"""Dither of the laser period: after each period the next trigger waits for a pseudo-random number of cycles.

A light that repeats with the laser's own period, another LiDAR's above all, then comes at another time of flight in every period.
The paper has no such register; all of it is our choice.
"""

import numpy as np
from numba import njit

LFSR_BITS, LFSR_TAPS = 16, 0xB400  # x^16 + x^14 + x^13 + x^11 + 1, shifting towards bit 0
DITHER_BITS_MAX = 8


def start_cycles(pulses: int, period_cycles: int, bits: int = 0, seed: int = 1) -> np.ndarray:
    """int64[pulses + 1]: when each period of a frame begins, in cycles from the first one's on, and when one more would.

    The wait after a period is the low `bits` of the LFSR at its end. The LFSR begins at `seed` with the frame and steps once a cycle
    of the periods, not while waiting.
    """
    waits = _waits(pulses, period_cycles, (1 << bits) - 1, seed) if bits else np.zeros(pulses, np.int64)
    return np.concatenate([[0], np.cumsum(period_cycles + waits)])


@njit(cache=True)
def _waits(pulses, period_cycles, mask, state):
    waits = np.empty(pulses, np.int64)
    for pulse in range(pulses):
        for _ in range(period_cycles):
            state = state >> 1 ^ (LFSR_TAPS if state & 1 else 0)
        waits[pulse] = state & mask
    return waits
