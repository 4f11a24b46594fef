# SPDX-License-Identifier: Apache-2.0
"""Files that are uploaded in the browser. Each is kept in a folder of its own, and its size is
checked before it is decoded.
"""

import shutil
import tempfile
import warnings
from pathlib import Path

import numpy as np
from attrs import evolve, frozen
from PIL import Image

from ...model.scenes.ambient import picture_share
from ...model.scenes.archives import shapes_in_archive
from ...model.scenes.conventions import ARCHIVES, ARRAYS, DEPTH_FILES
from ...model.scenes.image_files import COLOUR_FILES, picture_shape, read_channels
from ...model.shared.errors import InputError
from ...model.shared.pulse import PULSE_FILES, Pulse
from ...model.shared.quantities import check_choice

BYTES_MAX = 32 << 20
SAMPLES_MAX = 16_000_000  # in a picture
NAME_MAX = 60  # characters; every file system accepts such names
FORMATS = ("PNG", "TIFF", "JPEG")  # accepted formats; the file's name does not matter
HEADED = (".pfm", ".exr", ".pgm", ".tif", ".tiff")  # Pillow reads only some of them
KINDS = {
    "depth": DEPTH_FILES,
    "colour": COLOUR_FILES,
    "sun": COLOUR_FILES,
    "pulse": PULSE_FILES,
}
# control that uses a file of a kind, and its value that does so
USED_BY = {
    "depth": ("scene", "upload"),
    "colour": ("scene", "upload"),
    "sun": ("sun", "picture"),
    "pulse": ("pulse", "file"),
}
TOLD = {"depth": "depth file", "pulse": "table of a pulse"}  # kinds that are no pictures


@frozen
class Uploads:
    """Paths of the depth picture, its colour picture, the picture of sun and shade, and the
    measured pulse; None = not uploaded.
    """

    depth: Path | None = None
    colour: Path | None = None
    sun: Path | None = None
    pulse: Path | None = None

    def files(self) -> dict[str, Path]:
        """Return the files that exist, by kind."""
        return {kind: getattr(self, kind) for kind in KINDS if getattr(self, kind) is not None}

    def named(self, text: str) -> str:
        """Return `text` with the names of the files in place of their internal paths."""
        for path in self.files().values():
            text = text.replace(str(path), path.name)
        return text

    def with_file(self, kind: str, name: str, content: bytes, folder: Path) -> "Uploads":
        """Return a copy with `content`, written to `folder` under the last part of `name`. Raises
        `InputError`.
        """
        check_choice("upload", kind, tuple(KINDS))
        name = "".join(c for c in Path(name.replace("\\", "/")).name if c.isprintable())[-NAME_MAX:]
        suffix = Path(name).suffix.lower()
        if suffix not in KINDS[kind]:
            raise InputError(
                f"{name}: must be a {TOLD.get(kind, 'picture')} ({', '.join(KINDS[kind])})"
            )
        if not 0 < len(content) <= BYTES_MAX:
            raise InputError(f"{name}: holds {len(content)} bytes, must hold 1 to {BYTES_MAX}")
        path = _written(folder, name, content)
        try:
            return self.with_path(kind, path)
        except InputError:  # nobody asks for it again
            shutil.rmtree(path.parent)
            raise

    def with_path(self, kind: str, path: Path) -> "Uploads":
        """Return a copy with the file at `path`. Raises `InputError` if it is missing, too large,
        or not what its kind says.
        """
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        if kind == "pulse":
            _check_pulse(path)
        else:
            _check_samples(path)
        return evolve(self, **{kind: path})

    def sun_share(self, rows: int, cols: int) -> np.ndarray:
        """float64[rows, cols]: 0 (shade) to 1 (sun). Raises `InputError`."""
        assert self.sun is not None
        try:
            return picture_share(self.sun, rows, cols)
        except InputError as error:
            raise InputError(self.named(str(error)), field="sun") from None


def _written(folder: Path, name: str, content: bytes) -> Path:
    """Write a file to a folder of its own, because results are cached by path, and return its path.
    Raises `InputError` if it cannot be written, as on a full disk; then nothing of it is left.
    """
    try:
        own = Path(tempfile.mkdtemp(dir=folder))
        try:
            (own / name).write_bytes(content)
        except OSError:
            shutil.rmtree(own, ignore_errors=True)
            raise
    except OSError as error:
        raise InputError(f"{name}: cannot be kept: {error.strerror}") from None
    return own / name


def parts_of(path: Path | None) -> list[str]:
    """Return the names of the arrays or channels of a depth file among which one is chosen; none
    if there is only one.
    """
    if path is None or path.suffix.lower() in ARRAYS:
        return []
    try:
        archive = path.suffix.lower() in ARCHIVES
        names = list(shapes_in_archive(path) if archive else read_channels(path))
    except InputError:  # told when the file is read for its depth
        return []
    return names if len(names) > 1 else []


class Kept:
    """The uploads of all pages of a server, by number, so that a page that is loaded again finds
    its own; their files go when the server ends.
    """

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="coincid-explore-")
        self._sets = [Uploads()]  # the number of a set is its place

    @property
    def folder(self) -> Path:
        """Folder for the files."""
        return Path(self._folder.name)

    def number_of(self, uploads: Uploads) -> int:
        """Return the number under which `uploads` are kept from now on."""
        if uploads not in self._sets:
            self._sets.append(uploads)
        return self._sets.index(uploads)

    def get(self, number: int) -> Uploads:
        """Return the uploads of a number; none for an unknown one, as after a new start of the
        server.
        """
        return self._sets[number] if 0 <= number < len(self._sets) else self._sets[0]


def _check_samples(path: Path) -> None:
    """Raise `InputError` for a file that is no picture, or too large when decoded; pictures are not
    decoded here.
    """
    try:
        if path.suffix.lower() in ARCHIVES:
            shapes = list(shapes_in_archive(path).values())
            shape = max(shapes, key=lambda one: np.prod(one, dtype=np.float64), default=(1,))
        elif path.suffix.lower() in ARRAYS:
            shape = np.lib.format.open_memmap(path, mode="r").shape
        elif path.suffix.lower() in HEADED:
            shape = picture_shape(path)
        else:
            with warnings.catch_warnings():
                # the size is checked here
                warnings.simplefilter("ignore", Image.DecompressionBombWarning)
                with Image.open(path, formats=FORMATS) as picture:
                    shape = picture.size
    except Image.DecompressionBombError:
        raise _of_size(path, "far too many") from None
    except InputError:
        raise
    except Exception as error:
        raise _unreadable(path, error) from None
    if not 0 < np.prod(shape, dtype=np.float64) <= SAMPLES_MAX:
        raise _of_size(path, " x ".join(map(str, shape)))


def _check_pulse(path: Path) -> None:
    """Raise `InputError` for a file that holds no pulse."""
    try:
        Pulse.load(path)
    except InputError as error:
        raise InputError(str(error).replace(str(path), path.name), field="pulse") from None


def _of_size(path: Path, size: str) -> InputError:
    return InputError(
        f"{path.name}: has {size} samples, must have 1 to {SAMPLES_MAX / 1e6:.0f} million"
    )


def _unreadable(path: Path, error: Exception) -> InputError:
    """Return the error for a file that a library cannot read."""
    kind = "NPY file" if path.suffix.lower() == ".npy" else "picture (PNG, TIFF, JPEG)"
    return InputError(
        f"{path.name}: is not a readable {kind} ({error})".replace(str(path), path.name)
    )
