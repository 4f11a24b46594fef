# SPDX-License-Identifier: Apache-2.0
"""The counters of a subgroup, which registers and frame end packets hold."""

COUNTER_BITS = 32  # bits of a register, and the most that a counter has
COUNTER_BITS_MIN = 9  # fewest bits of a counter: it must hold a threshold
EVENTS_MAX = (1 << COUNTER_BITS) - 1  # highest value of a counter

COUNTERS: tuple[tuple[str, str], ...] = (  # in the order of the frame end packet
    ("opened", "Coincidence windows opened."),
    ("committed", "Windows that met the threshold."),
    ("rejected", "Windows that did not meet the threshold."),
    ("stored", "Events written to the FIFO."),
    ("dropped", "Events lost to a full FIFO."),
    ("blind", "Cycles with an edge while the tree was not armed."),
    ("photons", "Sum of the counts of all windows."),
    ("mg_stored", "Minigroup records written."),
    ("mg_dropped", "Minigroup records lost because the previous one was still waiting."),
    ("threshold_used", "Threshold of the frame: from the register or from the controller."),
    ("lower", "Windows that met the threshold minus one."),
)
COUNTER_NAMES = tuple(name for name, _ in COUNTERS)
