# SPDX-License-Identifier: Apache-2.0
"""Interface of a connection to a sensor: reading and writing words, and the errors that may
occur.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Protocol

import numpy as np

from ..model.contract.registers import BY_NAME

STATUS = BY_NAME["status"]
ERRORS = tuple(bits.name for bits in STATUS.bits if bits.clears and bits.name != "done")


class HostError(RuntimeError):
    """An error between this program and the sensor; the message describes it."""


class RefusedError(HostError):
    """The sensor refused an access (SLVERR). message: without the reasons. reasons: sticky bits of
    `status` that give the reason, if they were read.
    """

    def __init__(self, message: str, reasons: tuple[str, ...] = ()):
        super().__init__(f"{message}{f' ({chr(44).join(reasons)})' if reasons else ''}")
        self.message, self.reasons = message, reasons


class LinkError(HostError):
    """The link gave no right answer, despite all repetitions."""


class DeviceResetError(HostError):
    """The device was reset since the connection began, so its settings are lost."""


class Transport(Protocol):
    """Words at byte addresses, and beats. A refused access raises `RefusedError`.

    The refused word, and all words after it, stay unchanged. A transport that moves runs of
    words faster than single ones also has the methods `read_block(address, words)` and
    `write_block(address, values)`.
    """

    def read(self, address: int) -> int:
        """Return the word at `address`."""

    def write(self, address: int, value: int) -> None:
        """Write `value` to `address`."""

    def receive(self, stream: int) -> np.ndarray:
        """Return the beats (uint64) of a stream since the last call, in order; there may be
        none. Does not wait.
        """


def errors_in(status: int) -> tuple[str, ...]:
    """Return the names of the sticky error bits that are set in a status word."""
    return tuple(name for name in ERRORS if status >> STATUS.bit(name) & 1)


def changes(
    writes: Iterable[tuple[int, int]], programmed: Mapping[int, int]
) -> list[tuple[int, int]]:
    """Return the (address, value) of `writes` that differ from the values known to be
    programmed, or written before them, in order.
    """
    known = dict(programmed)
    found = []
    for address, value in writes:
        if known.get(address) != value:
            found.append((address, value))
            known[address] = value
    return found


def runs(writes: Iterable[tuple[int, int]]) -> list[tuple[int, list[int]]]:
    """Group writes into runs of consecutive words, in order: (first address, values)."""
    found: list[tuple[int, list[int]]] = []
    for address, value in writes:
        if found and address == found[-1][0] + 4 * len(found[-1][1]):
            found[-1][1].append(value)
        else:
            found.append((address, [value]))
    return found


def read_block(transport: Transport, address: int, words: int) -> list[int]:
    """Return `words` words from `address` on, by the fastest way that the transport has."""
    whole: Callable[[int, int], list[int]] | None = getattr(transport, "read_block", None)
    return (
        whole(address, words) if whole else [transport.read(address + 4 * i) for i in range(words)]
    )


def write_block(transport: Transport, address: int, values: Sequence[int]) -> None:
    """Write `values` from `address` on, by the fastest way that the transport has."""
    whole: Callable[[int, Sequence[int]], None] | None = getattr(transport, "write_block", None)
    if whole:
        whole(address, values)
    else:
        for i, value in enumerate(values):
            transport.write(address + 4 * i, value)
