# SPDX-License-Identifier: Apache-2.0
"""Errors of a run of the RTL."""

from pathlib import Path


class Mismatch(AssertionError):
    """RTL and golden model differ."""


class SimulationError(RuntimeError):
    """A cocotb test failed, none ran, or the simulator ended abnormally. The message ends with
    the end of the log.

    `log` is the simulator's log, `wave` the waveform; None if there is none.
    """

    def __init__(self, message: str, log: Path | None = None, wave: Path | None = None):
        super().__init__(message)
        self.log = log
        self.wave = wave
