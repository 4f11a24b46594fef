# SPDX-License-Identifier: Apache-2.0
"""Waits between the periods of a frame: a gap of constant length, then dither, a pseudo-random
number of cycles.

A gap spreads the pulses over the time that a frame may take. With dither, light that repeats with
the period of our laser, above all the light of another LiDAR, arrives at a different time of flight
in every period. The paper has neither; all of this is our own choice.
"""

from functools import cache

import numpy as np

GAP_BITS = 28
GAP_MAX = (1 << GAP_BITS) - 1  # in cycles; half a second at 500 MHz
LFSR_BITS, LFSR_TAPS = 16, 0xB400  # x^16 + x^14 + x^13 + x^11 + 1, shifting towards bit 0
DITHER_BITS_MAX = 8


def start_cycles(
    pulses: int, period_cycles: int, bits: int = 0, seed: int = 1, gap_cycles: int = 0
) -> np.ndarray:
    """int64[pulses + 1]: cycle at which each period of a frame begins, starting at 0.

    The last element is the cycle in which one more period would begin. After each period come
    `gap_cycles`, and then as many cycles as the low `bits` of the LFSR say. The LFSR starts each
    frame at `seed`. It steps once in each cycle of a period, and not in a cycle of waiting.
    """
    spacing_cycles = period_cycles + gap_cycles
    if not bits:
        return np.arange(pulses + 1, dtype=np.int64) * spacing_cycles
    waits = np.zeros(pulses, np.int64)
    after_period = _after(period_cycles)
    state = seed
    for pulse in range(pulses):
        state = int(after_period[state])
        waits[pulse] = state & ((1 << bits) - 1)
    return np.concatenate([[0], np.cumsum(spacing_cycles + waits)])


@cache
def _after(steps: int) -> np.ndarray:
    """int64[2^16]: for each state of the LFSR, the state `steps` steps later, by repeated
    squaring of a single step.
    """
    state = np.arange(1 << LFSR_BITS)
    jump, result = state >> 1 ^ np.where(state & 1, LFSR_TAPS, 0), state
    while steps:
        if steps & 1:
            result = jump[result]
        jump, steps = jump[jump], steps >> 1
    return result
