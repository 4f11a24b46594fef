# SPDX-License-Identifier: Apache-2.0
"""Bit slices: plays a netlist of one clock in C++. Each net is one SIMD word, and each bit of
the word is a copy of the design.
"""
