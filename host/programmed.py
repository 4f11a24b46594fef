# SPDX-License-Identifier: Apache-2.0
"""Record of the values in the sensor's registers, so that only changes are written."""

from collections.abc import Iterable, Mapping


class Programmed:
    """Byte address -> value, for the settings whose values are known. It has no transport; the caller records its writes."""

    def __init__(self, known: Mapping[int, int] | None = None):
        self._known = dict(known or {})

    def pending(self, writes: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
        """Return the (address, value) of `writes` that change something, or may do so, in order."""
        return [(address, value) for address, value in writes if self._known.get(address) != value]

    def note(self, address: int, value: int) -> None:
        """Record that `value` was written to `address`."""
        self._known[address] = value

    def forget(self, known: Mapping[int, int] | None = None) -> None:
        """Forget everything except `known`, because the sensor was reset, or another program has written to it."""
        self._known = dict(known or {})


def runs(writes: Iterable[tuple[int, int]]) -> list[tuple[int, list[int]]]:
    """Group writes into runs of consecutive words, in order: (first address, values)."""
    found: list[tuple[int, list[int]]] = []
    for address, value in writes:
        if found and address == found[-1][0] + 4 * len(found[-1][1]):
            found[-1][1].append(value)
        else:
            found.append((address, [value]))
    return found
