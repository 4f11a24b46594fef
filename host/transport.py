# SPDX-License-Identifier: Apache-2.0
"""The way to a sensor: reading and writing words, and the errors that this may end with."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np


class HostError(RuntimeError):
    """Something between this program and the sensor went wrong; the message says what."""


class RefusedError(HostError):
    """The sensor refused an access (SLVERR). reasons: the sticky bits of `status` that tell why, where they were read."""

    def __init__(self, message: str, reasons: tuple[str, ...] = ()):
        super().__init__(f"{message}{f' ({chr(44).join(reasons)})' if reasons else ''}")
        self.reasons = reasons


class LinkError(HostError):
    """The link gave no right answer, however often it was asked."""


class DeviceResetError(HostError):
    """The device was reset since it was greeted: what was programmed is lost."""


class Transport(Protocol):
    """Words at byte addresses, and beats. A refused access raises `RefusedError`, and changes nothing from the refused word on.

    A transport that moves runs of words faster than one by one also has the methods `read_block(address, words)` and
    `write_block(address, values)`.
    """

    def read(self, address: int) -> int:
        """The word at `address`."""

    def write(self, address: int, value: int) -> None:
        """Makes the word at `address` be `value`."""

    def receive(self, stream: int) -> np.ndarray:
        """Beats (uint64) of a stream that have come since the last call, in order; maybe none. Waits for nothing."""


def read_block(transport: Transport, address: int, words: int) -> list[int]:
    """Words from `address` on, by the fastest way that the transport has."""
    whole: Callable[[int, int], list[int]] | None = getattr(transport, "read_block", None)
    return whole(address, words) if whole else [transport.read(address + 4 * i) for i in range(words)]


def write_block(transport: Transport, address: int, values: Sequence[int]) -> None:
    """Writes `values` from `address` on, by the fastest way that the transport has."""
    whole: Callable[[int, Sequence[int]], None] | None = getattr(transport, "write_block", None)
    if whole:
        whole(address, values)
    else:
        for i, value in enumerate(values):
            transport.write(address + 4 * i, value)
