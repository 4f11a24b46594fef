# SPDX-License-Identifier: Apache-2.0
"""Layout of a block: placed, with a clock tree, routed, checked, and timed with its wires."""
