# SPDX-License-Identifier: Apache-2.0
"""Files that come through the browser: kept in a folder of their own, checked for size before anything decodes them."""

import tempfile
import warnings
from pathlib import Path

import numpy as np
from attrs import evolve, frozen
from PIL import Image

from ...model.shared.errors import InputError
from ...model.shared.quantities import check_choice

BYTES_MAX = 32 << 20
SAMPLES_MAX = 16_000_000  # of a picture
NAME_MAX = 60  # characters that any file system takes
FORMATS = ("PNG", "TIFF", "JPEG")  # that are looked into, whatever the name says
PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
KINDS = {"depth": (".png", ".tif", ".tiff", ".npy"), "colour": PICTURES, "sun": PICTURES}


@frozen
class Uploads:
    """Paths of the depth picture, the colour picture beside it, and the picture of sun and shade; None = none."""

    depth: Path | None = None
    colour: Path | None = None
    sun: Path | None = None

    def files(self) -> dict[str, Path]:
        """Those that are there."""
        return {kind: getattr(self, kind) for kind in KINDS if getattr(self, kind) is not None}

    def named(self, text: str) -> str:
        """`text` with the files' names in place of their paths, which are none of the user's."""
        for path in self.files().values():
            text = text.replace(str(path), path.name)
        return text

    def with_file(self, kind: str, name: str, content: bytes, folder: Path) -> "Uploads":
        """These and `content`, written to `folder` under the last part of `name`. Raises `InputError`, also for what is no picture."""
        check_choice("upload", kind, tuple(KINDS))
        name = "".join(c for c in Path(name.replace("\\", "/")).name if c.isprintable())[-NAME_MAX:]
        suffix = Path(name).suffix.lower()
        if suffix not in KINDS[kind]:
            raise InputError(f"{name}: must be a picture ({', '.join(KINDS[kind])})")
        if not 0 < len(content) <= BYTES_MAX:
            raise InputError(f"{name}: holds {len(content)} bytes, must hold 1 to {BYTES_MAX}")
        path = Path(tempfile.mkdtemp(dir=folder)) / name  # a path of its own: results are kept by it
        path.write_bytes(content)
        return self.with_path(kind, path)

    def with_path(self, kind: str, path: Path) -> "Uploads":
        """These and the file at `path`. Raises `InputError` if it is missing, too large, or no picture."""
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        _check_samples(path)
        return evolve(self, **{kind: path})

    def sun_share(self, rows: int, cols: int) -> np.ndarray:
        """float64[rows, cols]: 0 (shade) to 1 (sun), the picture's brightness over each pixel."""
        assert self.sun is not None
        try:
            with Image.open(self.sun, formats=FORMATS) as picture:
                grey = picture.convert("L").resize((cols, rows), Image.Resampling.BOX)
        except Exception as error:
            raise _unreadable(self.sun, error) from None
        return np.asarray(grey, np.float64) / 255


def _check_samples(path: Path) -> None:
    """Refuses what is no picture, and what would be too large decoded; neither is decoded here."""
    try:
        if path.suffix.lower() == ".npy":
            shape = np.lib.format.open_memmap(path, mode="r").shape
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the size is judged here
                with Image.open(path, formats=FORMATS) as picture:
                    shape = picture.size
    except Image.DecompressionBombError:
        raise _of_size(path, "far too many") from None
    except Exception as error:
        raise _unreadable(path, error) from None
    if not 0 < np.prod(shape, dtype=np.float64) <= SAMPLES_MAX:
        raise _of_size(path, " x ".join(map(str, shape)))


def _of_size(path: Path, size: str) -> InputError:
    return InputError(f"{path.name}: has {size} samples, must have 1 to {SAMPLES_MAX / 1e6:.0f} million")


def _unreadable(path: Path, error: Exception) -> InputError:
    """For whatever a library finds wrong with a file that anybody may have made."""
    kind = "NPY file" if path.suffix.lower() == ".npy" else "picture (PNG, TIFF, JPEG)"
    return InputError(f"{path.name}: is not a readable {kind} ({error})".replace(str(path), path.name))
