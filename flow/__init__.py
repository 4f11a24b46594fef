# SPDX-License-Identifier: Apache-2.0
"""What becomes of the RTL: synthesis, gate-level simulation, place and route, and what they cost. Only the command line imports it."""
