# SPDX-License-Identifier: Apache-2.0
"""cocotb benches of the regression: the tests beside this folder start a simulator, which imports these by name."""

from pathlib import Path

BENCHES = str(Path(__file__).parent)  # of the simulator's PYTHONPATH
