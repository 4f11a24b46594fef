# SPDX-License-Identifier: Apache-2.0
"""Files that appear whole or not at all, CSV, and checked reading of NPZ archives."""

import csv
import os
import stat
import tempfile
import textwrap
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np

from .errors import InputError, wrong_value
from .spool import Block, Spool

FilePath: TypeAlias = str | os.PathLike[str]
NPY_START = b"\x93NUMPY"  # first bytes of a file with a single array
SAID_MAX = 200  # letters of what a library says of a damaged file, which may contain parts of it
BESIDE_MAX = (
    40  # letters of a file's name in that of the file beside it, which must not be too long
)


def check_path(path: Any) -> Path:
    """Return the path of a text or a path; bytes are none. Raises `InputError`."""
    if not isinstance(path, str | os.PathLike):
        raise wrong_value("path", path, "the name of a file: a str or a Path")
    return Path(path)


@contextmanager
def whole_file(path: FilePath, mode: str = "wb") -> Iterator[IO[Any]]:
    """Open a file beside `path`, and rename it to `path` if the block ends well; after an
    exception nothing is left. A link stays, and what it leads to is replaced.

    Raises `InputError` if the folder cannot be written to, or the name is that of no file.
    """
    path = check_path(path)
    check_replaceable(path)
    try:
        target = Path(os.path.realpath(path))
        target.parent.mkdir(parents=True, exist_ok=True)
        prefix = f".{path.name[:BESIDE_MAX]}."
        handle, beside = tempfile.mkstemp(prefix=prefix, dir=target.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    except ValueError:  # a NUL byte
        raise InputError(f"{str(path)!r}: is no name of a file") from None
    try:
        with os.fdopen(handle, mode, encoding=None if "b" in mode else "utf-8") as file:
            yield file
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(beside, 0o666 & ~umask)
        os.replace(beside, target)
    except BaseException as error:
        Path(beside).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise InputError(f"{path}: cannot be written: {error.strerror}") from None
        raise


def check_replaceable(path: Path) -> None:
    """Raise `InputError` if there is something under this name that is no file, such as a device or
    a pipe: to replace it would break other programs.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):  # there is nothing, or no name
        return
    if not stat.S_ISREG(mode):
        what = "a folder" if stat.S_ISDIR(mode) else "a device or a pipe"
        raise InputError(f"{path}: cannot be written: is {what}, must be a file", field="path")


@contextmanager
def reading(path: FilePath, what: str) -> Iterator[None]:
    """Make an `InputError` of whatever a missing or damaged file causes in the libraries that
    read it. What they say becomes one line of at most `SAID_MAX` letters.
    """
    try:
        yield
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except Exception as error:
        said = textwrap.shorten(str(error), SAID_MAX, placeholder=" ...")
        raise InputError(f"{path}: is not a readable {what} ({said})") from None


def write_csv(path: FilePath, rows: Iterable[Iterable[object]]) -> None:
    """Write rows as CSV, with floats to six digits."""
    with whole_file(path, "w") as file:
        csv.writer(file, lineterminator="\n").writerows(
            [f"{value:.6g}" if isinstance(value, float) else str(value) for value in row]
            for row in rows
        )


def check_suffix(path: FilePath, suffix: str) -> None:
    """Raise `InputError` if the name of a file to be written promises another format than that of
    `suffix`.
    """
    if check_path(path).suffix.lower() != suffix:
        raise InputError(f"{path}: must end with {suffix}", field="path")


def write_npz(path: FilePath, arrays: dict[str, np.ndarray]) -> None:
    """Write `arrays` as a compressed NPZ whose bytes depend only on the arrays (`np.savez`
    writes no time stamp). Raises `InputError` if the file's name does not end with .npz.
    """
    check_suffix(path, ".npz")
    with whole_file(path) as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]  # no array is called allow_pickle


class GrowingNpz:
    """Arrays whose rows come one after the other, for an NPZ file that does not fit into memory."""

    def __init__(self) -> None:
        self._spool = Spool()
        self._blocks: dict[str, list[Block]] = {}

    def append(self, arrays: dict[str, np.ndarray]) -> None:
        """Append rows to the arrays of these names."""
        for name, rows in arrays.items():
            self._blocks.setdefault(name, []).append(self._spool.put(rows))

    def write(self, path: FilePath, others: dict[str, np.ndarray]) -> None:
        """Write the file that `write_npz` would write of the arrays, and then of others.

        Raises `InputError` if the file's name does not end with .npz.
        """
        check_suffix(path, ".npz")
        with whole_file(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, blocks in self._blocks.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    self._write_array(member, blocks)
            for name, array in others.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, array, allow_pickle=False)

    def _write_array(self, member: IO[bytes], blocks: list[Block]) -> None:
        rows = sum(block.shape[0] for block in blocks)
        header = {
            "descr": np.lib.format.dtype_to_descr(blocks[0].dtype),
            "fortran_order": False,
            "shape": (rows, *blocks[0].shape[1:]),
        }
        np.lib.format.write_array_header_1_0(member, header)
        for block in blocks:
            for piece in self._spool.pieces(block):
                member.write(piece.data)


def read_npz(
    path: FilePath, names: tuple[str, ...], optional: tuple[str, ...] = ()
) -> dict[str, np.ndarray]:
    """Return the arrays `names` of an NPZ file, and those of `optional` that it has.

    Raises `InputError` if the file is missing, damaged, not an NPZ, or lacks one of `names`.
    """
    path = check_path(path)
    with reading(path, "NPZ file"):
        with path.open("rb") as file:
            start = file.read(len(NPY_START))
        if start != NPY_START and not zipfile.is_zipfile(path):
            raise InputError(f"{path}: is not an NPZ file, must hold the arrays {', '.join(names)}")
        archive = np.load(path, allow_pickle=False)
        if not isinstance(archive, np.lib.npyio.NpzFile):
            raise InputError(
                f"{path}: is a single array, must be an NPZ file with the arrays {', '.join(names)}"
            )
        with archive:
            missing = [name for name in names if name not in archive.files]
            if missing:
                raise InputError(
                    f"{path}: has no array {missing[0]!r}, must have {', '.join(names)}"
                )
            arrays = {
                name: archive[name]
                for name in (*names, *(name for name in optional if name in archive.files))
            }
        for name, array in arrays.items():
            if not isinstance(array, np.ndarray):  # a member without NumPy's header comes as bytes
                raise InputError(f"{path}: {name} is no array")
        return arrays
