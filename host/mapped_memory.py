# SPDX-License-Identifier: Apache-2.0
"""Memory-mapped transport: the sensor's address range in a file that can be mapped, such as
/dev/uio0 or /dev/mem.
"""

import ctypes
import mmap

import numpy as np

from ..model.contract import registers
from ..model.contract.registers import ADDRESS_BITS
from ..model.shared.errors import InputError
from ..model.shared.files import FilePath, check_path
from .transport import ERRORS, STATUS, RefusedError, errors_in

STATUS_ADDRESS = registers.address("status")
ERROR_BITS = sum(1 << STATUS.bit(name) for name in ERRORS)


class MemoryTransport:
    """Transport by plain loads and stores. A context manager.

    path: of the file; base: byte offset of the sensor in it, a multiple of the page size; size:
    number of bytes to map.

    A processor's load or store does not get the answer of the bus. So the sensor's sticky error
    bits are read after each access, and they show a refusal. Those from before are cleared in the
    sensor, because they would hide it, and kept here: reading the status gives them, and writing
    it clears them. This transport has no stream, and `receive` returns nothing. A design with a
    DMA engine overrides it; a design may also have a buffer that is read through registers.
    """

    def __init__(self, path: FilePath, base: int = 0, size: int = 1 << ADDRESS_BITS):
        path = check_path(path)
        try:
            with path.open("r+b", buffering=0) as file:
                self._map = mmap.mmap(file.fileno(), size, mmap.MAP_SHARED, offset=base)
        except (OSError, OverflowError, ValueError) as error:
            raise InputError(
                f"{path}: {size} bytes from {base:#x} on cannot be mapped ({error})"
            ) from None
        self._words = (ctypes.c_uint32 * (size // 4)).from_buffer(self._map)
        self._errors = 0  # sticky error bits that were cleared in the sensor, but not by the user

    def __enter__(self) -> "MemoryTransport":
        return self

    def __exit__(self, *_: object) -> None:
        del self._words
        self._map.close()

    def read(self, address: int) -> int:
        """Return the word at `address`. Raises `RefusedError`."""
        self._keep_errors()
        value = self._words[address // 4]
        self._check(f"read of {address:#07x}")
        return value | self._errors if address == STATUS_ADDRESS else value

    def write(self, address: int, value: int) -> None:
        """Write `value` to `address`. Raises `RefusedError`."""
        self._keep_errors()
        if address == STATUS_ADDRESS:
            self._errors &= ~value
        self._words[address // 4] = value
        self._check(f"write of {value:#x} to {address:#07x}")

    def _check(self, access: str) -> None:
        """Raise `RefusedError` if the access has set error bits."""
        if reasons := errors_in(self._keep_errors()):
            raise RefusedError(access, reasons)

    def _keep_errors(self) -> int:
        """Move the sensor's error bits here, and return them, as in the status."""
        errors = self._words[STATUS_ADDRESS // 4] & ERROR_BITS
        if errors:
            self._words[STATUS_ADDRESS // 4] = errors
        self._errors |= errors
        return errors

    def receive(self, stream: int) -> np.ndarray:
        """Return no beats; see the class."""
        return np.zeros(0, np.uint64)
