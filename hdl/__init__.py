# SPDX-License-Identifier: Apache-2.0
"""The sensor in Amaranth, with one block per file, and its export as Verilog."""
