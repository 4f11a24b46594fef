# SPDX-License-Identifier: Apache-2.0
"""Names of the engines that play frames. This file imports no RTL tool, because the golden model
needs none.
"""

# play the whole RTL under cocotb, also with a waveform or with delays
SIMULATORS = ("verilator", "icarus")
ENGINES = ("golden", "sliced", *SIMULATORS)
LANES_MAX = 512  # bits of the sliced engine's widest word: subgroups that it plays at once


def sensors_together(subgroups: int) -> int:
    """Return how many sensors of so many subgroups the sliced engine plays at once."""
    return max(1, LANES_MAX // subgroups)
