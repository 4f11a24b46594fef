# SPDX-License-Identifier: Apache-2.0
"""Names of the engines that play frames. This file imports no RTL tool, because the golden model needs none."""

SIMULATORS = ("verilator", "icarus")  # play the whole RTL under cocotb, also with a waveform or with delays
ENGINES = ("golden", "sliced", *SIMULATORS)
