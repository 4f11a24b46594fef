# SPDX-License-Identifier: Apache-2.0
"""All proofs, by block; importing this module registers them."""

from . import async_front, clock_gate, controller, dpcu, emulator, fifo, groups, readout, registers, timing, tree  # noqa: F401
