# SPDX-License-Identifier: Apache-2.0
"""Flows after the RTL: synthesis, gate-level simulation, place and route. Only the command line
imports this package.
"""
