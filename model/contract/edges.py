# SPDX-License-Identifier: Apache-2.0
"""Edges: SPAD avalanches as the digital logic sees them, and their file format."""

import enum
import os
from collections.abc import Sequence

import numpy as np
from attrs import evolve, frozen

from ..shared.errors import InputError, check_integer
from ..shared.files import FilePath, check_path, read_npz, write_npz


class Fate(enum.IntEnum):
    """Fate of an edge in the sensor."""

    OPENING = 0
    COUNTED = 1
    DUPLICATE = 2
    MASKED = 3
    GATED = 4
    BLIND = 5


@frozen(eq=False)
class Edges:
    """SPAD edges, one per element, in any order.

    pulse: int64[n], laser pulse, counted through the frames (frame = pulse // pulses). pixel:
    int64[n], row * cols + col. tick: int64[n], TDC ticks since the laser trigger of that pulse.
    offset_ps: float64[n], position of the edge in its tick, from the tick's start; None: in the
    middle. It only matters to the asynchronous view.
    """

    pulse: np.ndarray
    pixel: np.ndarray
    tick: np.ndarray
    offset_ps: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.tick)

    def __repr__(self) -> str:
        """Return one line: how many edges there are, and of which pulses."""
        if not len(self):
            return "<Edges: none>"
        return f"<Edges: {len(self):,}, pulses {self.pulse.min()} to {self.pulse.max()}>"

    def save(self, path: FilePath) -> None:
        """Write the edges as NPZ, whole or not at all. Raises `InputError` for another suffix.

        `coincid edges` converts the file to other formats.
        """
        offset = {} if self.offset_ps is None else {"offset_ps": self.offset_ps}
        write_npz(path, {name: getattr(self, name) for name in NAMES} | offset)

    def take(self, chosen: np.ndarray | slice) -> "Edges":
        """Return the edges that an array of indices, or of bool, or a slice chooses."""
        offset = None if self.offset_ps is None else self.offset_ps[chosen]
        return Edges(self.pulse[chosen], self.pixel[chosen], self.tick[chosen], offset)

    @classmethod
    def joined(cls, parts: Sequence["Edges"]) -> "Edges":
        """Return the edges of all parts, one part behind the other, without their offsets."""
        nothing = np.empty(0, np.int64)
        return cls(
            *(np.concatenate([nothing, *(getattr(part, name) for part in parts)]) for name in NAMES)
        )

    def frame(self, number: int, pulses: int) -> tuple["Edges", np.ndarray]:
        """Return the edges of one frame, with pulses counted from the frame's start, and their
        indices here.
        """
        index = np.flatnonzero(self.pulse // pulses == number)
        own = self.take(index)
        return evolve(own, pulse=own.pulse - number * pulses), index


NAMES = ("pulse", "pixel", "tick")
LIMIT_MAX = (1 << 63) - 1  # pulses, pixels and ticks are int64
OTHER_SUFFIXES = (".csv", ".h5", ".hdf5", ".ptu")  # of edges in formats of other programs


def load_edges(path: FilePath, *, pixels: int, pulses: int, period_ticks: int) -> Edges:
    """Read and check an edge file.

    Limits: pixel below `pixels`, tick below `period_ticks`, pulse below `pulses` (of all
    frames). An array `offset_ps` may give the position of each edge in its tick. Raises
    `InputError` with the array, its first bad element and the legal range.
    """
    suffix = check_path(path).suffix.lower()
    if suffix in OTHER_SUFFIXES and os.path.exists(path):
        raise InputError(f"{path}: is read as NPZ; coincid edges makes one of a {suffix} file")
    pixels = check_integer("pixels", pixels, 1, LIMIT_MAX)
    pulses = check_integer("pulses", pulses, 1, LIMIT_MAX)
    period_ticks = check_integer("period_ticks", period_ticks, 1, LIMIT_MAX)
    arrays = read_npz(path, NAMES, optional=("offset_ps",))
    return checked_edges(
        arrays, pixels=pixels, pulses=pulses, period_ticks=period_ticks, source=f"{path}: "
    )


def checked_edges(
    arrays: dict[str, np.ndarray], *, pixels: int, pulses: int, period_ticks: int, source: str = ""
) -> Edges:
    """Return `Edges` made from integer arrays of equal length and inside their ranges. Raises
    `InputError`.
    """
    for name in NAMES:
        array = arrays[name]
        if np.ma.is_masked(array):
            raise InputError(f"{source}{name}: has masked elements, must have none", field=name)
        if array.ndim != 1:
            raise InputError(
                f"{source}{name}: has {array.ndim} dimensions, must have 1", field=name
            )
        if array.dtype.kind not in "iu" and len(array):
            raise InputError(f"{source}{name}: holds {array.dtype}, must hold integers", field=name)
    lengths = {name: len(arrays[name]) for name in NAMES}
    if len(set(lengths.values())) > 1:
        raise InputError(
            f"{source}lengths differ: " + ", ".join(f"{name} {n}" for name, n in lengths.items())
        )
    for name, bound in zip(NAMES, (pulses, pixels, period_ticks), strict=True):
        bad = np.flatnonzero((arrays[name] < 0) | (arrays[name] >= bound))
        if len(bad):
            raise InputError(
                f"{source}{name}[{bad[0]}] = {arrays[name][bad[0]]}: must be an integer from 0 to {bound - 1}",
                field=name,
                low=0,
                high=bound - 1,
            )
    offset = arrays.get("offset_ps")
    if offset is not None:
        if offset.shape != arrays["tick"].shape or offset.dtype.kind not in "iuf":
            raise InputError(
                f"{source}offset_ps: holds {offset.dtype}{list(offset.shape)}, must hold {lengths['tick']} numbers",
                field="offset_ps",
            )
        bad = np.flatnonzero(~((offset >= 0) & np.isfinite(offset)))
        if len(bad):
            raise InputError(
                f"{source}offset_ps[{bad[0]}] = {offset[bad[0]]}: must be a number from 0 to a tick's length",
                field="offset_ps",
            )
        offset = offset.astype(float)
    pulse, pixel, tick = (np.ascontiguousarray(arrays[name], dtype=np.int64) for name in NAMES)
    return Edges(pulse, pixel, tick, offset)
