# SPDX-License-Identifier: Apache-2.0
"""cocotb benches of the regression: the tests in the folders beside it start a simulator, which imports them by name."""

from pathlib import Path

BENCHES = str(Path(__file__).parent)  # of the simulator's PYTHONPATH
