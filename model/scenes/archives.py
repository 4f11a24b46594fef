# SPDX-License-Identifier: Apache-2.0
"""Depth in files that hold several arrays: NPZ, HDF5 and MATLAB. `FILE:NAME` names one of them,
FILE alone the only one.
"""

import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from ..shared.errors import InputError
from ..shared.files import FilePath, reading
from .conventions import ARCHIVES

PICTURE = 2  # dimensions of an array: rows, cols
SEQUENCE = 3  # frames, rows, cols


def is_in_archive(source: FilePath) -> bool:
    """Return whether a text is an archive, or one of its arrays."""
    path, _ = _divided(source)
    return path.suffix.lower() in ARCHIVES and os.path.exists(path)


def read_from_archive(source: FilePath) -> np.ndarray:
    """Return an array of an archive, rows first. Raises `InputError`, which lists the arrays of
    two and three dimensions.

    Without a name, it is the only array of two dimensions, or else the only one of three.
    """
    path, name = _divided(source)
    with reading(path, "archive"):
        dimensions, read = _archive(path)
        flat = [one for one, count in dimensions.items() if count == PICTURE]
        deep = [one for one, count in dimensions.items() if count == SEQUENCE]
        wanted = [name] if name else flat or deep
        if len(wanted) != 1 or wanted[0] not in (*flat, *deep):
            has = f"has the arrays of two dimensions {', '.join(flat) or 'none'}"
            if deep:
                has += f", of three dimensions {', '.join(deep)}"
            raise InputError(f"{path}: {has}; must name one of them, as {path}:NAME")
        return read(wanted[0])


def names_in_archive(path: FilePath) -> list[str]:
    """Return the names of the arrays that may hold depth. Raises `InputError`."""
    with reading(path, "archive"):
        dimensions, _ = _archive(Path(path))
    return [one for one, count in dimensions.items() if count in (PICTURE, SEQUENCE)]


def _divided(source: FilePath) -> tuple[Path, str]:
    """Return the file and the name of FILE:NAME; the name is empty if there is none."""
    text = str(source)
    if os.path.exists(text):
        return Path(text), ""
    path, _, name = text.rpartition(":")
    return Path(path), name


def _archive(path: Path) -> tuple[dict[str, int], Callable[[str], np.ndarray]]:
    """Return the number of dimensions of an archive's arrays by name, and a function that reads
    one.
    """
    if path.suffix.lower() == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return {name: array.ndim for name, array in arrays.items()}, arrays.__getitem__
    if h5py.is_hdf5(path):
        return _hdf5(path)
    from scipy.io import loadmat, whosmat

    dimensions = {name: len(shape) for name, shape, kind in whosmat(path) if kind != "char"}
    return dimensions, lambda name: np.asarray(loadmat(path, variable_names=[name])[name])


def _hdf5(path: Path) -> tuple[dict[str, int], Callable[[str], np.ndarray]]:
    """As `_archive`, for HDF5; MATLAB writes columns first."""
    dimensions: dict[str, int] = {}

    def note(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            dimensions[name] = item.ndim

    with h5py.File(path, "r") as archive:
        archive.visititems(note)

    def read(name: str) -> np.ndarray:
        with h5py.File(path, "r") as archive:
            samples = np.asarray(archive[name][()])
        return samples.T if path.suffix.lower() == ".mat" else samples

    return dimensions, read
