# SPDX-License-Identifier: Apache-2.0
"""The emulator: the sensor with a photon source on the same chip, on an FPGA board or simulated.

No other room imports this one. `rtl/` is the circuit, `source_model.py` the golden model of its light, `driver.py` and
`serial_transport.py` the host software, `simulated.py` the same pins without a board, and `run.py` the command
`coincid emulate`. The paper has no emulator; all of it is our choice.
"""
