# SPDX-License-Identifier: Apache-2.0
"""The sensor as numbers: parameters, registers, packets, golden model, light, scenes, depth. No HDL is imported here."""
