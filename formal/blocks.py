# SPDX-License-Identifier: Apache-2.0
"""All proofs, by block; importing this module registers them."""

from . import controller, dpcu, emulator, fifo, readout, registers, timing, tree  # noqa: F401
