# SPDX-License-Identifier: Apache-2.0
"""Bit slices: plays a netlist of one clock in C++ where each net is one SIMD word, and each bit of it another copy."""
