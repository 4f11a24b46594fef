# SPDX-License-Identifier: Apache-2.0
"""The emulator: the sensor with a photon source on the same chip, on an FPGA board or simulated.

No other room imports this one. `rtl/` is the circuit, and `source_model.py` the golden model of its
light. `driver.py` and `serial_transport.py` are the host software. `simulated.py` and `netlist.py`
simulate the pins without a board. `run.py` does what `coincid emulate` does. The paper has no
emulator; all of it is our choice.
"""
