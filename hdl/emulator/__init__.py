# SPDX-License-Identifier: Apache-2.0
"""The emulator: photon sources, frame buffer and host interface around the sensor. The paper has none; all is our choice."""
