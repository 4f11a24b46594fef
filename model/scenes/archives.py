# SPDX-License-Identifier: Apache-2.0
"""Depth in files that hold several arrays: NPZ, HDF5 and MATLAB. `FILE:NAME` names one of them,
FILE alone the only one.
"""

import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import h5py
import numpy as np

from ..shared.errors import InputError
from ..shared.files import FilePath, reading
from .conventions import ARCHIVES

MATLAB = ".mat"  # of which only later versions are HDF5
# kinds of MATLAB's variables
NO_NUMBERS = ("char", "cell", "struct", "object", "function", "function_handle")
# in its HDF5: attribute with the kind of a variable, and how groups of its own begin
MATLAB_KIND = "MATLAB_class"
MATLAB_OWN = "#"
PICTURE = 2  # dimensions of an array: rows, cols
SEQUENCE = 3  # frames, rows, cols
# by the version of the NPY format, of which later ones hold no plain numbers
HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
Shapes: TypeAlias = dict[str, tuple[int, ...]]


def is_in_archive(source: FilePath) -> bool:
    """Return whether a text is an archive, or one of its arrays."""
    path, _ = _divided(source)
    return path.suffix.lower() in ARCHIVES and os.path.exists(path)


def is_matlab(source: FilePath) -> bool:
    """Return whether a text is a MATLAB file, or one of its arrays."""
    path, _ = _divided(source)
    return path.suffix.lower() == MATLAB


def read_from_archive(source: FilePath) -> np.ndarray:
    """Return an array of an archive, rows first. Raises `InputError`, which lists the arrays of
    two and three dimensions.

    Without a name, it is the only array of two dimensions, or else the only one of three.
    """
    path, name = _divided(source)
    with reading(path, "archive"):
        shapes, read = _archive(path)
        flat = [one for one, shape in shapes.items() if len(shape) == PICTURE]
        deep = [one for one, shape in shapes.items() if len(shape) == SEQUENCE]
        wanted = [name] if name else flat or deep
        if len(wanted) != 1 or wanted[0] not in (*flat, *deep):
            has = f"has the arrays of two dimensions {', '.join(flat) or 'none'}"
            if deep:
                has += f", of three dimensions {', '.join(deep)}"
            raise InputError(f"{path}: {has}; must name one of them, as {path}:NAME")
        return read(wanted[0])


def shapes_in_archive(path: FilePath) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the arrays that may hold depth, by name; no array is read. Raises
    `InputError`.
    """
    with reading(path, "archive"):
        shapes, _ = _archive(Path(path))
    return {one: shape for one, shape in shapes.items() if len(shape) in (PICTURE, SEQUENCE)}


def _divided(source: FilePath) -> tuple[Path, str]:
    """Return the file and the name of FILE:NAME; the name is empty if there is none."""
    text = str(source)
    if os.path.exists(text):
        return Path(text), ""
    path, _, name = text.rpartition(":")
    return Path(path), name


def _archive(path: Path) -> tuple[Shapes, Callable[[str], np.ndarray]]:
    """Return the shapes of an archive's arrays by name, and a function that reads one."""
    if path.suffix.lower() == ".npz":
        return _npz(path)
    if path.suffix.lower() != MATLAB or h5py.is_hdf5(path):
        return _hdf5(path)
    from scipy.io import loadmat, whosmat

    shapes = {name: shape for name, shape, kind in whosmat(path) if kind not in NO_NUMBERS}
    return shapes, lambda name: np.asarray(loadmat(path, variable_names=[name])[name])


def _npz(path: Path) -> tuple[Shapes, Callable[[str], np.ndarray]]:
    """As `_archive`, for NPZ."""
    shapes: Shapes = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.namelist():
            with archive.open(member) as file:
                version = np.lib.format.read_magic(file)
                read_header = HEADERS.get(version)
                if read_header is not None:
                    shapes[member.removesuffix(".npy")] = read_header(file)[0]

    def read(name: str) -> np.ndarray:
        with np.load(path, allow_pickle=False) as archive:
            return np.asarray(archive[name])

    return shapes, read


def _hdf5(path: Path) -> tuple[Shapes, Callable[[str], np.ndarray]]:
    """As `_archive`, for HDF5; MATLAB writes columns first."""
    shapes: Shapes = {}

    def note(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and _is_array(name, item):
            shapes[name] = item.shape

    with h5py.File(path, "r") as archive:
        archive.visititems(note)

    def read(name: str) -> np.ndarray:
        with h5py.File(path, "r") as archive:
            samples = np.asarray(archive[name][()])
        return samples.T if path.suffix.lower() == MATLAB else samples

    return shapes, read


def _is_array(name: str, dataset: h5py.Dataset) -> bool:
    """Return whether a dataset is no text, cell or other variable of MATLAB, and no part of one."""
    kind = dataset.attrs.get(MATLAB_KIND, "")
    told = kind.decode() if isinstance(kind, bytes) else kind
    return not name.startswith(MATLAB_OWN) and told not in NO_NUMBERS
