# SPDX-License-Identifier: Apache-2.0
"""Memory-mapped transport: the sensor's address range in a file that can be mapped, such as
/dev/uio0 or /dev/mem.
"""

import ctypes
import mmap
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..model.contract import registers
from ..model.contract.registers import ADDRESS_BITS
from ..model.shared.errors import InputError
from ..model.shared.files import FilePath
from .transport import RefusedError, errors_in


class MemoryTransport:
    """Transport by plain loads and stores. A context manager.

    path: of the file; base: byte offset of the sensor in it, a multiple of the page size; size:
    number of bytes to map.

    A processor's store does not wait for the answer of the bus. So the sensor's sticky status
    bits are read after each write or run of writes, and they show a refusal. This transport has
    no stream, and `receive` returns nothing. A design with a DMA engine overrides it; a design
    may also have a buffer that is read through registers.
    """

    def __init__(self, path: FilePath, base: int = 0, size: int = 1 << ADDRESS_BITS):
        try:
            with Path(path).open("r+b", buffering=0) as file:
                self._map = mmap.mmap(file.fileno(), size, mmap.MAP_SHARED, offset=base)
        except (OSError, ValueError) as error:
            raise InputError(
                f"{os.fspath(path)}: {size} bytes from {base:#x} on cannot be mapped ({error})"
            ) from None
        self._words = (ctypes.c_uint32 * (size // 4)).from_buffer(self._map)

    def __enter__(self) -> "MemoryTransport":
        return self

    def __exit__(self, *_: object) -> None:
        del self._words
        self._map.close()

    def read(self, address: int) -> int:
        """Return the word at `address`."""
        return self._words[address // 4]

    def write(self, address: int, value: int) -> None:
        """Write `value` to `address`. Raises `RefusedError` if the status shows a refusal."""
        self.write_block(address, [value])

    def write_block(self, address: int, values: Sequence[int]) -> None:
        """Write several words from `address` on. Raises the same error."""
        for i, value in enumerate(values):
            self._words[address // 4 + i] = value
        if reasons := errors_in(self._words[registers.address("status") // 4]):
            raise RefusedError(f"write of {len(values)} words from {address:#07x} on", reasons)

    def receive(self, stream: int) -> np.ndarray:
        """Return no beats; see the class."""
        return np.zeros(0, np.uint64)
