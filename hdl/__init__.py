# SPDX-License-Identifier: Apache-2.0
"""The sensor in Amaranth, one block a file, and its emission as Verilog."""
