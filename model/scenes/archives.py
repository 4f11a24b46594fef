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

ARCHIVES = (".npz", ".h5", ".hdf5", ".mat")


def is_in_archive(source: FilePath) -> bool:
    """Return whether a text is an archive, or one of its arrays."""
    path, _ = _divided(source)
    return path.suffix.lower() in ARCHIVES and os.path.exists(path)


def read_from_archive(source: FilePath) -> np.ndarray:
    """Return an array of an archive, rows first. Raises `InputError`, which lists the arrays of
    two dimensions.
    """
    path, name = _divided(source)
    with reading(path, "archive"):
        names, read = _archive(path)
        wanted = [name] if name else names
        if len(wanted) != 1 or wanted[0] not in names:
            has = f"has the arrays of two dimensions {', '.join(names) or 'none'}"
            raise InputError(f"{path}: {has}; must name one of them, as {path}:NAME")
        return read(wanted[0])


def _divided(source: FilePath) -> tuple[Path, str]:
    """Return the file and the name of FILE:NAME; the name is empty if there is none."""
    text = str(source)
    if os.path.exists(text):
        return Path(text), ""
    path, _, name = text.rpartition(":")
    return Path(path), name


def _archive(path: Path) -> tuple[list[str], Callable[[str], np.ndarray]]:
    """Return the names of an archive's arrays of two dimensions, and a function that reads one."""
    if path.suffix.lower() == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return [name for name, array in arrays.items() if array.ndim == 2], arrays.__getitem__
    if h5py.is_hdf5(path):
        return _hdf5(path)
    from scipy.io import loadmat, whosmat

    names = [name for name, shape, kind in whosmat(path) if len(shape) == 2 and kind != "char"]
    return names, lambda name: np.asarray(loadmat(path, variable_names=[name])[name])


def _hdf5(path: Path) -> tuple[list[str], Callable[[str], np.ndarray]]:
    """As `_archive`, for HDF5; MATLAB writes columns first."""
    names: list[str] = []

    def note(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and item.ndim == 2:
            names.append(name)

    with h5py.File(path, "r") as archive:
        archive.visititems(note)

    def read(name: str) -> np.ndarray:
        with h5py.File(path, "r") as archive:
            samples = np.asarray(archive[name][()])
        return samples.T if path.suffix.lower() == ".mat" else samples

    return names, read
