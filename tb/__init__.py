"""Simulators, cocotb test benches, scoreboards and the batch engine (may import `model` and `hdl`)."""
