# SPDX-License-Identifier: Apache-2.0
"""Ambient light that differs across the picture: from the user's text to klux for every pixel.

Ref: paper II, equation (2): the background is proportional to the light. The forms, and the
rules of the resampling, are our choice.
"""

import os
from typing import TypeAlias

import numpy as np

from ..shared.errors import InputError
from ..shared.files import FilePath
from ..shared.quantities import Numbers, check_real, real_array, shape_of
from .image_files import centre_crop, check_picture_array, covered_samples, open_picture, read_array

Ambient: TypeAlias = str | float | np.ndarray
AMBIENT_FORMS = (
    "a number, LOW|HIGH (right half in the sun), FILE.npy in klux, or PICTURE,WHITE_KLUX (grey)"
)
WHITE = {"L": 255, "I;16": 65535, "I;16B": 65535, "I": 65535}  # value of white, by a picture's mode


def ambient_klux(source: Ambient, rows: int, cols: int) -> Numbers:
    """Return klux of ambient light: a number, or float64[rows, cols]. Raises `InputError`.

    source: a number or an array that broadcasts to rows x cols; or a text of `AMBIENT_FORMS`.
    With LOW|HIGH, the columns from the middle on have HIGH. A file is cropped around its centre
    to the sensor's aspect ratio, and a pixel takes the mean of the samples that it covers. The
    samples of a picture are linear, with 0 = dark.
    """
    if not isinstance(source, str):
        return (
            real_array("klux", source, (rows, cols), 0)
            if shape_of("klux", source)
            else check_real("klux", source, 0)
        )
    if (number := _number(source)) is not None:
        return check_real("klux", number, 0)
    if source.count("|") == 1 and not os.path.exists(source):
        low, high = (_klux(source, part) for part in source.split("|"))
        return np.broadcast_to(np.where(np.arange(cols) < cols // 2, low, high), (rows, cols))
    return _resampled(_read_klux(source), rows, cols)


def picture_share(path: FilePath, rows: int, cols: int) -> np.ndarray:
    """float64[rows, cols]: 0 (black) to 1 (white) of a grey picture, resampled as the light of
    `ambient_klux`. Raises `InputError`.
    """
    return _resampled(_read_share(path), rows, cols)


def told_klux(source: Ambient) -> float | str:
    """Return a description of the light for reports: the number, the text of another form, or an
    array's range.
    """
    if isinstance(source, str):
        number = _number(source)
        return source if number is None else number
    return f"{np.min(source):g} to {np.max(source):g}" if np.ndim(source) else float(source)


def _klux(source: str, part: str) -> float:
    if (number := _number(part)) is None:
        raise InputError(f"klux = {source!r}: must be {AMBIENT_FORMS}")
    return check_real("klux", number, 0)


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _read_klux(source: str) -> np.ndarray:
    """float64[height, width]: the samples of a file, in klux."""
    if source.lower().endswith(".npy"):
        samples = check_picture_array(source, read_array(source))
        return real_array(f"{source}: klux", samples, samples.shape, 0)
    path, comma, white = source.rpartition(",")
    if not comma:
        what = (
            f"{source}: a picture needs its white level in klux"
            if os.path.exists(source)
            else f"klux = {source!r}"
        )
        raise InputError(f"{what}: must be {AMBIENT_FORMS}")
    return _klux(source, white) * _read_share(path)


def _read_share(path: FilePath) -> np.ndarray:
    """float64[height, width]: 0 (black) to 1 (white), the samples of a grey picture."""
    with open_picture(path) as picture:
        if picture.mode not in WHITE:
            raise InputError(
                f"{path}: is a picture of mode {picture.mode}, must be grey of 8 or 16 bits"
            )
        return np.asarray(picture, np.float64) / WHITE[picture.mode]


def _resampled(samples: np.ndarray, rows: int, cols: int) -> np.ndarray:
    """float64[rows, cols]: the mean of the samples that each pixel covers."""
    full_height, full_width = samples.shape
    top, left, height, width = centre_crop(full_height, full_width, rows, cols)
    row, col, pixel = covered_samples(height, width, rows, cols)
    sums = np.bincount(
        pixel.ravel(), weights=samples[top + row, left + col].ravel(), minlength=rows * cols
    )
    return (sums / np.bincount(pixel.ravel(), minlength=rows * cols)).reshape(rows, cols)
