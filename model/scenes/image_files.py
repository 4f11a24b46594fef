# SPDX-License-Identifier: Apache-2.0
"""Pictures and arrays as inputs of scenes: checked reading, and cropping to the sensor's aspect
ratio.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO
from attrs import frozen
from PIL import Image, ImageOps

from ..shared.errors import InputError
from ..shared.files import FilePath, reading

_GAP = rb"(?:\s+|#[^\n]*\n)+"
PGM_HEAD = re.compile(rb"P([25])" + 3 * (_GAP + rb"(\d+)") + rb"\s")
PFM_HEAD = re.compile(rb"P[Ff]" + 2 * (_GAP + rb"\d+") + _GAP + rb"([-+.\deE]+)\s")
GDAL_NO_DATA = 42113  # tag of TIFF
LOSSY = ("JPEG", "MPO")
ALPHA = ("a", "alpha")


def _transposed(samples: np.ndarray) -> np.ndarray:
    return np.swapaxes(samples, 0, 1)


def _transverse(samples: np.ndarray) -> np.ndarray:
    return _transposed(np.rot90(samples, k=2))


# orientation of TIFF and EXIF -> what puts the top row first
UPRIGHT: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    2: np.fliplr,
    3: partial(np.rot90, k=2),
    4: np.flipud,
    5: _transposed,
    6: partial(np.rot90, k=-1),
    7: _transverse,
    8: np.rot90,
}
# of colour pictures, and of the sun's in the explorer
COLOUR_FILES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")


@frozen(kw_only=True)
class Tags:
    """What a picture says about itself, besides its samples."""

    pages: int = 1  # or frames of an animation
    no_data: float | None = None  # number that means "no depth" (tag of GDAL)
    is_lossy: bool = False


def open_picture(path: FilePath) -> Image.Image:
    """Return an opened and decoded picture, turned as its orientation says. Raises
    `InputError`.
    """
    with reading(path, "picture"):
        picture = Image.open(path)
        picture.load()
        ImageOps.exif_transpose(picture, in_place=True)
        return picture


def read_tags(path: FilePath) -> Tags:
    """Return what a picture says about itself, as far as Pillow knows its format."""
    try:
        with Image.open(path) as picture:
            tags = getattr(picture, "tag_v2", {})
            told = str(tags.get(GDAL_NO_DATA, "")).strip("\0 ")
            return Tags(
                pages=getattr(picture, "n_frames", 1),
                no_data=float(told) if told else None,
                is_lossy=picture.format in LOSSY,
            )
    except Exception:  # Pillow raises any of a damaged file
        return Tags()  # the reader of the samples knows more formats, and tells what is wrong


def read_array(path: FilePath) -> np.ndarray:
    """Return the array of an NPY file. Raises `InputError`."""
    with reading(path, "NPY file"):
        samples = np.load(path, allow_pickle=False)
    if not isinstance(samples, np.ndarray):
        raise InputError(f"{path}: is an NPZ archive, must be a single array (NPY)")
    return samples


def read_pgm(path: FilePath) -> np.ndarray:
    """uint8 or uint16[rows, cols]: the numbers of a grey PGM file as they are. Raises `InputError`.

    Libraries multiply them so that the file's largest number becomes white.
    """
    with reading(path, "PGM file"):
        content = Path(path).read_bytes()
    head = PGM_HEAD.match(content)
    if head is None:
        raise InputError(f"{path}: is not a grey PGM file")
    cols, rows, white = (int(number) for number in head.groups()[1:])
    stored = np.dtype(">u2" if white > 0xFF else "u1")
    with reading(path, "PGM file"):
        if head[1] == b"2":
            samples = np.array(content[head.end() :].split()[: rows * cols], np.uint16)
        else:
            samples = np.frombuffer(content, stored, rows * cols, head.end())
        return samples.reshape(rows, cols).astype(stored.newbyteorder("="))


def read_channels(path: FilePath) -> dict[str, np.ndarray]:
    """Return the channels of a picture by their names, each [rows, cols], top row first. Raises
    `InputError`.

    The names of further parts of an EXR file begin with that of their part. An EXR file may
    store a part of its picture only; the rest is NaN.
    """
    channels: dict[str, np.ndarray] = {}
    with reading(path, "picture"), _opened(path) as file:
        part = 0
        while file.seek_subimage(part, 0):
            spec = file.spec()
            if spec.deep:
                raise InputError(f"{path}: is a deep picture, must have one sample per pixel")
            samples = file.read_image(part, 0, 0, spec.nchannels, OpenImageIO.UNKNOWN)
            if samples is None:
                raise ValueError(file.geterror())
            if file.format_name() == "openexr":
                samples = _in_display(samples, spec)
            elif part:
                break  # further pages
            turn = UPRIGHT.get(spec.getattribute("Orientation"))
            if turn is not None:
                samples = turn(samples)
            scale = _pfm_scale(path)
            if scale != 1:
                samples = samples / scale
            for name, plane in zip(spec.channelnames, np.moveaxis(samples, 2, 0), strict=True):
                title = (
                    name if name not in channels else f"{spec.getattribute('name') or part}.{name}"
                )
                channels[title] = plane
            part += 1
    return channels


def picture_shape(path: FilePath) -> tuple[int, int]:
    """Return (rows, cols) of a picture, from its header. Raises `InputError`."""
    with reading(path, "picture"), _opened(path) as file:
        spec = file.spec()
        return max(spec.height, spec.full_height), max(spec.width, spec.full_width)


def _pfm_scale(path: FilePath) -> float:
    """Return the factor by which the library has multiplied the numbers of a PFM file; 1 for
    others.

    Middlebury writes 1/255 there, and means its numbers as they are.
    """
    with open(path, "rb") as file:
        head = PFM_HEAD.match(file.read(4096))
    return abs(float(head[1])) or 1.0 if head else 1.0


@contextmanager
def _opened(path: FilePath) -> Iterator[Any]:
    """Open a picture without any change of its numbers."""
    open(path, "rb").close()  # the library does not tell a missing file
    as_stored = OpenImageIO.ImageSpec()
    as_stored.attribute("oiio:UnassociatedAlpha", 1)
    file = OpenImageIO.ImageInput.open(str(path), as_stored)
    if file is None:
        raise ValueError(OpenImageIO.geterror())
    try:
        yield file
    finally:
        file.close()


def _in_display(samples: np.ndarray, spec: Any) -> np.ndarray:
    """Return the samples of an EXR file at their places in the whole picture, with NaN in the
    rest.
    """
    stored = spec.x, spec.y, spec.width, spec.height
    shown = spec.full_x, spec.full_y, spec.full_width, spec.full_height
    if stored == shown:
        return samples
    whole = np.full((spec.full_height, spec.full_width, spec.nchannels), np.nan, np.float32)
    top, left = spec.y - spec.full_y, spec.x - spec.full_x
    bottom, right = top + spec.height, left + spec.width
    inside = samples[
        max(0, -top) : max(0, spec.full_height - top),
        max(0, -left) : max(0, spec.full_width - left),
    ]
    whole[max(0, top) : max(0, bottom), max(0, left) : max(0, right)] = inside
    return whole


def depth_channel(path: FilePath, channels: dict[str, np.ndarray], wanted: str) -> str:
    """Return the name of the channel that holds depth. Raises `InputError` if none does, and
    names all.

    That is, in this order: the only channel, except for alpha; `wanted`, as the whole name or
    its last part; Z or depth, as the whole name or its last part; a channel of a layer called
    depth; any of red, green and blue if they are the same. Z of a layer that also has X or Y is
    part of a vector, such as a normal.
    """
    names = [name for name in channels if _parts(name)[-1] not in ALPHA]
    told = f"{path}: has the channels {', '.join(channels)}"
    if wanted:
        found = [name for name in channels if wanted == name] or [
            name for name in channels if wanted.lower() == _parts(name)[-1]
        ]
        if not found:
            raise InputError(f"{told}; must have {wanted} (--channel)")
        return found[0]
    if len(names) == 1:
        return names[0]
    layers = {
        (*_parts(name)[:-1], axis) for name in names for axis in "xy" if _parts(name)[-1] == axis
    }
    scalars = [name for name in names if not layers & {(*_parts(name)[:-1], axis) for axis in "xy"}]
    scalars = [name for name in scalars if not _is_colour(name, channels)]
    ranked = (
        *(name for name in scalars if len(_parts(name)) == 1 and _is_depth(_parts(name)[0])),
        *(name for name in scalars if _is_depth(_parts(name)[-1])),
        *(name for name in scalars if any("depth" in _words(part) for part in _parts(name)[:-1])),
    )
    if ranked:
        return ranked[0]
    first = channels[names[0]] if names else np.empty(0)
    if sorted(names) == ["B", "G", "R"] and all(
        np.array_equal(first, channels[name], equal_nan=first.dtype.kind == "f") for name in names
    ):
        return "R"
    raise InputError(f"{told}, none of which is called depth or Z; --channel NAME chooses one")


def _is_colour(name: str, channels: dict[str, np.ndarray]) -> bool:
    """Return whether a channel is one of three colours of a layer that differ."""
    layer, dot, last = name.rpartition(".")
    others = [f"{layer}{dot}{colour}" for colour in "RGB"]
    if last not in ("R", "G", "B") or not dot or not all(one in channels for one in others):
        return False
    own = channels[name]
    is_float = own.dtype.kind == "f"
    return not all(np.array_equal(own, channels[one], equal_nan=is_float) for one in others)


def _parts(name: str) -> list[str]:
    """Return the layers of a channel's name and the channel, in lower case."""
    return name.lower().split(".")


def _words(part: str) -> list[str]:
    return re.split("[^a-z]+", part)


def _is_depth(part: str) -> bool:
    return part == "z" or "depth" in _words(part)


def check_picture_array(path: FilePath, samples: np.ndarray) -> np.ndarray:
    """Return `samples` as a numeric [rows, cols]; a third dimension of length 1 is dropped.
    Raises `InputError`.
    """
    if samples.ndim == 3 and samples.shape[2] == 1:
        samples = samples[:, :, 0]
    if samples.ndim != 2 or not samples.size or samples.dtype.kind not in "iuf":
        raise InputError(
            f"{path}: holds {samples.dtype}{list(samples.shape)}, must hold numbers in two dimensions (rows, cols)"
        )
    return samples


def centre_crop(height: int, width: int, rows: int, cols: int) -> tuple[int, int, int, int]:
    """Return (top, left, height, width) of the largest centred part with the aspect ratio of
    rows x cols.
    """
    crop_height = max(1, min(height, round(width * rows / cols)))
    crop_width = max(1, min(width, round(height * cols / rows)))
    return (height - crop_height) // 2, (width - crop_width) // 2, crop_height, crop_width


def covered_samples(
    height: int, width: int, rows: int, cols: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which samples of a picture of height x width each of rows x cols pixels covers, as
    (row, col, pixel).

    int64: row[n, 1] and col[m] of the samples, pixel[n, m]. If there are fewer samples than
    pixels, they are repeated.
    """
    n, m = max(height, rows), max(width, cols)
    pixel = np.arange(n)[:, None] * rows // n * cols + np.arange(m) * cols // m
    return np.arange(n)[:, None] * height // n, np.arange(m) * width // m, pixel
