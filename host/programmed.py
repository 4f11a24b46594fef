# SPDX-License-Identifier: Apache-2.0
"""What the sensor's registers hold, so that only what changes is written."""

from collections.abc import Iterable, Mapping


class Programmed:
    """Byte address -> value, of the settings that are known. Without transport: whoever writes notes what was written."""

    def __init__(self, known: Mapping[int, int] | None = None):
        self._known = dict(known or {})

    def pending(self, writes: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
        """Those of `writes` that change something, or may: (address, value), in order."""
        return [(address, value) for address, value in writes if self._known.get(address) != value]

    def note(self, address: int, value: int) -> None:
        """`value` was written to `address`."""
        self._known[address] = value

    def forget(self, known: Mapping[int, int] | None = None) -> None:
        """Nothing is known any more, except what is given: the sensor was reset, or somebody else wrote."""
        self._known = dict(known or {})


def runs(writes: Iterable[tuple[int, int]]) -> list[tuple[int, list[int]]]:
    """Writes as runs of consecutive words, in order: (first address, values)."""
    found: list[tuple[int, list[int]]] = []
    for address, value in writes:
        if found and address == found[-1][0] + 4 * len(found[-1][1]):
            found[-1][1].append(value)
        else:
            found.append((address, [value]))
    return found
