# SPDX-License-Identifier: Apache-2.0
"""The emulator: photon sources, frame buffer and host interface around the sensor. The paper has no
emulator; all of this is our choice.
"""
