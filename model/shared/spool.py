# SPDX-License-Identifier: Apache-2.0
"""Arrays in a temporary file, for what does not fit into memory."""

import tempfile
import weakref
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

PIECE_ROWS = 1 << 18  # that `Spool.pieces` reads at a time


class Block(NamedTuple):
    """Where an array stands in the file."""

    begin: int  # bytes
    shape: tuple[int, ...]
    dtype: np.dtype


class Spool:
    """Arrays in a temporary file that has no name, and is gone with this object.

    One thread at a time may use it.
    """

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115  # open as long as this object lives
        weakref.finalize(self, self._file.close)  # Python warns of files that nobody closes

    def put(self, array: np.ndarray) -> Block:
        """Append an array."""
        begin = self._file.seek(0, 2)
        array = np.ascontiguousarray(array)
        self._file.write(array.data)
        return Block(begin, array.shape, array.dtype)

    def joined(self, blocks: Sequence[Block]) -> np.ndarray:
        """Return the rows of several arrays in one array. blocks: at least one."""
        rows = sum(block.shape[0] for block in blocks)
        array = np.empty((rows, *blocks[0].shape[1:]), blocks[0].dtype)
        row = 0
        for block in blocks:
            self._read(block, array[row : row + block.shape[0]])
            row += block.shape[0]
        return array

    def pieces(self, block: Block) -> Iterator[np.ndarray]:
        """Yield the rows of an array in pieces."""
        row_bytes = int(np.prod(block.shape[1:], dtype=np.int64)) * block.dtype.itemsize
        for row in range(0, block.shape[0], PIECE_ROWS):
            rows = min(PIECE_ROWS, block.shape[0] - row)
            shape = rows, *block.shape[1:]
            piece = np.empty(shape, block.dtype)
            self._read(Block(block.begin + row * row_bytes, shape, block.dtype), piece)
            yield piece

    def _read(self, block: Block, array: np.ndarray) -> None:
        self._file.seek(block.begin)
        if array.size:
            self._file.readinto(array.data)
