# SPDX-License-Identifier: Apache-2.0
"""Simulators, cocotb test benches, scoreboards and the sliced engine (may import `model` and
`hdl`).
"""
