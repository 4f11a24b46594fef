# SPDX-License-Identifier: Apache-2.0
"""Figures from the equations, from Monte Carlo through the golden model, and from the RTL."""
