# SPDX-License-Identifier: Apache-2.0
"""Formal proofs of the RTL: unbounded, by k-induction, each with traces that show that it is not
vacuous.
"""
