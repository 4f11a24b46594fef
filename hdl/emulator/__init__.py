# SPDX-License-Identifier: Apache-2.0
"""The emulator: photon source, frame buffer, and the way in and out, around the sensor. The paper has no such thing; all is our choice."""
