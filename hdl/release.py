"""The folder of RTL that leaves the project: Verilog, file list, lint waivers, and the register map."""

import shutil
import tempfile
from pathlib import Path

from ..model.errors import InputError
from ..model.parameters import Sensor
from .export import FILE_LIST, verilog_files
from .register_files import register_files
from .waivers import CONTROL_FILE, control_file


def release_files(sensor: Sensor) -> dict[str, str]:
    """File name -> text. Equal parameters give equal bytes."""
    return verilog_files(sensor) | {CONTROL_FILE: control_file()} | register_files(sensor)


def write_release(folder: Path, sensor: Sensor) -> list[Path]:
    """Writes the files of `sensor` to `folder`, which appears whole and replaces the release that stood there.

    Raises `InputError` where the folder cannot be written, or holds anything but an earlier release.
    """
    given, folder = folder, Path(folder).resolve()
    if folder.exists() and not (folder.is_dir() and ((folder / FILE_LIST).exists() or not any(folder.iterdir()))):
        raise InputError(f"{given}: holds other things, must be a new or empty folder, or one with an earlier export")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        beside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    except OSError as error:
        raise InputError(f"{given}: cannot be written: {error.strerror}") from None
    try:
        fresh, stale = beside / "fresh", beside / "stale"
        fresh.mkdir()
        for name, text in release_files(sensor).items():
            (fresh / name).write_text(text)
        if folder.exists():
            folder.rename(stale)
        fresh.rename(folder)
    except OSError as error:
        if stale.exists() and not folder.exists():
            stale.rename(folder)
        raise InputError(f"{given}: cannot be written: {error.strerror}") from None
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return sorted(folder.iterdir())
