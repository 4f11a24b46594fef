# SPDX-License-Identifier: Apache-2.0
"""The depth pictures of a source, as they are stored: one, or a sequence.

A sequence is a folder, a pattern of names (`depth_%04d.png`, `depth_*.png`), or an array with
the frames as its first axis (in MATLAB files the last one, as is usual there). Files are in the
order of the numbers in their names.
"""

import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from attrs import frozen

from ..shared.errors import InputError
from ..shared.files import FilePath
from .archives import is_in_archive, is_matlab, read_from_archive
from .conventions import ARRAYS, DEPTH_FILES, convention
from .image_files import (
    check_picture_array,
    depth_channel,
    open_picture,
    read_array,
    read_channels,
    read_pgm,
    read_tags,
)
from .meaning import Meaning

ARRAY = "array"  # name of distances that are no file
COLOURS_MAX = 4  # length of a last axis that holds colours
NUMBER = re.compile(r"%\d*d")  # of a picture, in a pattern of names
WILD = re.compile(r"[*?\[]")
HIDDEN = (
    "."  # begins the name of a file that is none of the user's, as macOS puts them beside files
)


@frozen(eq=False, kw_only=True)
class Stored:
    """A depth picture as it is stored."""

    path: str  # for messages; a calib.txt stands beside it
    numbers: np.ndarray  # number[height, width]
    hidden: np.ndarray | bool = False  # bool[height, width]: no depth, by the mask of an array
    unit: str  # of the numbers, unless the user names another one
    missing: tuple[float, ...] = ()  # numbers that mean "no depth", by the file
    notes: tuple[str, ...] = ()
    is_file: bool = True


@frozen(eq=False, kw_only=True)
class Pictures:
    """The pictures of a source. read: returns one of them, from 0 on."""

    name: str
    count: int
    read: Callable[[int], Stored]
    moves: bool  # whether they are a sequence, which may have a single picture


def pictures_of(source: FilePath | np.ndarray, meaning: Meaning) -> Pictures:
    """Return the depth pictures of a file, a sequence or an array. Raises `InputError`."""
    if isinstance(source, np.ndarray):
        _check_no_channel(meaning)
        return _in_array(ARRAY, source, is_file=False)
    path = str(source)
    files = picture_files(path, DEPTH_FILES)
    if files is not None:

        def read(number: int) -> Stored:
            in_file = pictures_of(files[number], meaning)
            if in_file.count > 1:
                raise InputError(
                    f"{files[number]}: holds {in_file.count} pictures, must hold one, because {path}"
                    " names several files"
                )
            return in_file.read(0)

        return Pictures(name=Path(path).name, count=len(files), read=read, moves=True)
    samples = array_in_file(path)
    if samples is not None:
        _check_no_channel(meaning)
        _check_bits(path, samples, meaning)
        return _in_array(path, samples, is_file=True)

    def read_alone(number: int) -> Stored:
        return _stored_picture(path, meaning)

    return Pictures(name=Path(path).name, count=1, read=read_alone, moves=False)


def picture_files(source: str, suffixes: tuple[str, ...]) -> list[Path] | None:
    """Return the files of a folder or a pattern in order, without hidden ones; None if `source` is
    neither.

    suffixes: of the files of a folder. Raises `InputError` if there is none.
    """
    if not source:  # a path without a name is the present folder
        return None
    path = Path(source)
    if os.path.isdir(path):
        found = [one for one in path.iterdir() if one.suffix.lower() in suffixes]
        wanted = f"files that end with {', '.join(suffixes)}"
    elif os.path.exists(path) or not os.path.isdir(path.parent):
        return None
    elif NUMBER.search(path.name):
        parts = NUMBER.split(path.name)
        name = re.compile(r"\d+".join(re.escape(part) for part in parts))
        found = [one for one in path.parent.iterdir() if name.fullmatch(one.name)]
        wanted = "files with a number in place of the %d"
    elif WILD.search(path.name):
        found = list(path.parent.glob(path.name))
        wanted = "files that the pattern fits"
    else:
        return None
    if os.path.isdir(path) or not path.name.startswith(HIDDEN):
        found = [one for one in found if not one.name.startswith(HIDDEN)]
    if not found:
        raise InputError(f"{source}: has no pictures, must have {wanted}")
    return sorted(found, key=_in_order)


def _in_order(path: Path) -> list[str | int]:
    """Return the name with its numbers as numbers."""
    parts = re.split(r"(\d+)", path.name)
    return [int(part) if part.isdecimal() else part for part in parts]


def array_in_file(path: str) -> np.ndarray | None:
    """Return the array of an NPY file or an archive as it is stored; None for other files. Raises
    `InputError`.
    """
    if is_in_archive(path):
        return read_from_archive(path)
    if Path(path).suffix.lower() in ARRAYS:
        return read_array(path)
    return None


def _in_array(path: str, samples: np.ndarray, *, is_file: bool) -> Pictures:
    """Return the pictures of an array. is_file: it was read; the numbers of others are metres."""
    hidden = np.ma.getmaskarray(samples) if isinstance(samples, np.ma.MaskedArray) else None
    numbers = np.asarray(np.ma.getdata(samples))
    moves = numbers.ndim == 3 and numbers.shape[2] != 1
    if moves and is_file and is_matlab(path):
        numbers = np.moveaxis(numbers, 2, 0)
    if moves and (numbers.shape[2] <= COLOURS_MAX < min(numbers.shape[:2])):
        raise InputError(
            f"{path}: holds {numbers.dtype}{list(numbers.shape)}, must hold numbers in two dimensions"
            " (rows, cols), or in three (frames, rows, cols); the last axis looks like colours"
        )
    count = len(numbers) if moves else 1
    if not count:
        raise InputError(f"{path}: has no pictures, must have at least one")

    def read(number: int) -> Stored:
        name = f"{path}[{number}]" if moves else path
        picture = check_picture_array(name, numbers[number] if moves else numbers)
        below: np.ndarray | bool = False
        if hidden is not None:
            below = (hidden[number] if moves else hidden).reshape(picture.shape)
        return Stored(
            path=name,
            numbers=picture.astype(picture.dtype.newbyteorder("=")),
            hidden=below,
            unit=_usual_unit(picture) if is_file else "m",
            is_file=is_file,
        )

    return Pictures(name=Path(path).name, count=count, read=read, moves=moves)


def _check_no_channel(meaning: Meaning) -> None:
    """Raise `InputError` for a channel of something that is no picture."""
    if meaning.channel is not None:
        raise InputError(
            f"channel = {meaning.channel!r}: goes with pictures; FILE:NAME names an array of a file",
            field="channel",
        )


def _check_bits(path: str, numbers: np.ndarray, meaning: Meaning) -> None:
    """Raise `InputError` for numbers of 8 bits without a unit, which are hardly millimetres."""
    if numbers.dtype == np.uint8 and meaning.unit is None:
        raise InputError(
            f"{path}: is a colour or 8 bit picture, must be depth: 16 bits or floats in one channel, or grey of 8 bits with a unit"
        )


def _usual_unit(numbers: np.ndarray) -> str:
    return "m" if numbers.dtype.kind == "f" else "mm"


def _stored_picture(path: str, meaning: Meaning) -> Stored:
    """Return the depth of a picture. Raises `InputError`."""
    if Path(path).suffix.lower() not in DEPTH_FILES and not _is_picture(path):
        raise InputError(
            f"{path}: is no scene, must be a depth file ({', '.join(DEPTH_FILES)}), or a Mitsuba scene (.xml)"
        )
    if _is_pgm(path):
        channels = {"Y": read_pgm(path)}
    else:
        channels = read_channels(path)
    known = convention(meaning.unit)
    wanted = meaning.channel or (known.channel if known else "")
    name = depth_channel(path, channels, wanted)
    samples = check_picture_array(path, channels[name])
    _check_bits(path, samples, meaning)
    notes = []
    if len(channels) > 1 and not meaning.channel:
        others = ", ".join(other for other in channels if other != name)
        notes.append(
            f"{path}: depth is the channel {name}; --channel NAME takes another one ({others})"
        )
    tags = read_tags(path)
    if tags.pages > 1:
        notes.append(f"{path}: is the first of {tags.pages} pictures in the file")
    if tags.is_lossy:
        notes.append(f"{path}: is a JPEG, whose compression changes distances")
    return Stored(
        path=path,
        numbers=samples,
        unit=_usual_unit(samples),
        missing=() if tags.no_data is None else (tags.no_data,),
        notes=tuple(notes),
    )


def _is_pgm(path: FilePath) -> bool:
    try:
        with open(path, "rb") as file:
            return file.read(2) in (b"P2", b"P5")
    except OSError:
        return False  # reported by the reader


def _is_picture(path: FilePath) -> bool:
    """Return whether some format of pictures fits the content."""
    try:
        with open_picture(path):
            return True
    except InputError:
        return False
