# SPDX-License-Identifier: Apache-2.0
"""Compilers and other programs: found, installed, run; what they make is made once."""
