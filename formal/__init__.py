# SPDX-License-Identifier: Apache-2.0
"""Formal proofs of the RTL: unbounded, by k-induction, each beside traces that show it is not vacuous."""
