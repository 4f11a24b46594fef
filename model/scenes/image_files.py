# SPDX-License-Identifier: Apache-2.0
"""Pictures and arrays as inputs of scenes: checked reading, and cropping to the sensor's aspect
ratio.
"""

import re
from pathlib import Path

import numpy as np
from PIL import Image

from ..shared.errors import InputError
from ..shared.files import FilePath, reading


def open_picture(path: FilePath) -> Image.Image:
    """Return an opened and decoded picture. Raises `InputError`."""
    with reading(path, "picture"):
        picture = Image.open(path)
        picture.load()
        return picture


def read_array(path: FilePath) -> np.ndarray:
    """Return the array of an NPY file. Raises `InputError`."""
    with reading(path, "NPY file"):
        samples = np.load(path, allow_pickle=False)
    if not isinstance(samples, np.ndarray):
        raise InputError(f"{path}: is an NPZ archive, must be a single array (NPY)")
    return samples


def read_pfm(path: FilePath) -> np.ndarray:
    """float32[rows, cols]: the samples of a grey PFM file, top row first. Raises `InputError`."""
    with reading(path, "PFM file"):
        content = Path(path).read_bytes()
    head = re.match(rb"Pf\s+(\d+)\s+(\d+)\s+(-?[\d.]+(?:[eE][-+]?\d+)?)\s", content)
    if head is None:
        raise InputError(f"{path}: is not a grey PFM file")
    cols, rows = int(head[1]), int(head[2])
    if len(content) - head.end() < 4 * rows * cols:
        raise InputError(f"{path}: ends before its {rows} x {cols} samples")
    samples = np.frombuffer(
        content, "<f4" if float(head[3]) < 0 else ">f4", rows * cols, head.end()
    )
    return samples.reshape(rows, cols)[::-1].astype(np.float32)


def read_exr(path: FilePath) -> np.ndarray:
    """float32[rows, cols]: the depth channel of an OpenEXR file. Raises `InputError`.

    That is `Z`, or a channel that ends with `.Z`, or that has `depth` in its name; else the only
    channel, or `R`.
    """
    import OpenEXR

    with reading(path, "EXR file"):
        open(path, "rb").close()  # the library does not tell a missing file
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {
                name: np.asarray(one.pixels, np.float32) for name, one in file.channels().items()
            }
    names = sorted(channels)
    wanted = (
        *(name for name in names if name == "Z" or name.endswith(".Z")),
        *(name for name in names if "depth" in name.lower()),
        *(names if len(names) == 1 else [name for name in names if name in ("R", "Y")]),
    )
    if not wanted:
        raise InputError(
            f"{path}: has the channels {', '.join(names)}, must have Z, or one channel alone"
        )
    return channels[wanted[0]]


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
