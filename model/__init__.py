# SPDX-License-Identifier: Apache-2.0
"""The sensor in numbers: parameters, registers, packets, golden model, light, scenes, depth. No
HDL is imported here.
"""
