# SPDX-License-Identifier: Apache-2.0
"""Simulators, cocotb test benches, scoreboards and the batch engine (may import `model` and `hdl`)."""
