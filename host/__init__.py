# SPDX-License-Identifier: Apache-2.0
"""Host software: programs the sensor and reads its frames, in simulation and on a board."""
