# SPDX-License-Identifier: Apache-2.0
"""Digests of the files that leave the project as hardware: releases of the sensor and of the emulator
for a board, without their version.

`python -m tests.file_digests` writes them again; a change that means to change such a file says so in
CHANGELOG.md.
"""

import hashlib
import io
import json
import zipfile
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path

from coincid.board.release import TOPS, emulator_release

from .board.sensors import config
from .releases import SMALL, small_releases

DIGESTS = Path(__file__).with_suffix(".json")
MANIFEST = "manifest.json"  # has the digests of the other files
BUFFER_BEATS = 64

Digests = dict[str, str]  # file -> digest


def of_release(name: str) -> Digests:
    """Return the digests of the release of a preset."""
    folder = small_releases() / name
    paths = [path for path in folder.rglob("*") if path.is_file() and path.name != MANIFEST]
    return digests_of_files(
        (path.relative_to(folder).as_posix(), path.read_bytes()) for path in paths
    )


def smallest_emulator(kind: str) -> dict[str, str]:
    """Return the files of an emulator of the smallest sensor, by name."""
    return emulator_release(config(), kind, BUFFER_BEATS)


def of_emulator(files: Mapping[str, str]) -> Digests:
    """Return the digests of the files of an emulator, by name."""
    return digests_of_files((name, text.encode()) for name, text in files.items())


def digests_of_files(files: Iterable[tuple[str, bytes]]) -> Digests:
    """Return the digests of files, by name."""
    number = version("coincid").encode()
    return {
        name: hashlib.sha256(_plain(name, content).replace(number, b"VERSION")).hexdigest()[:16]
        for name, content in sorted(files)
    }


def _plain(name: str, content: bytes) -> bytes:
    """Return the content of a file; that of an archive is unpacked, because libraries pack it in
    different ways.
    """
    if not name.endswith(".npz"):
        return content
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return b"".join(one.encode() + archive.read(one) for one in archive.namelist())


def expected() -> dict[str, dict[str, Digests]]:
    """Return the digests that are written down: of releases and of emulators, by name."""
    return json.loads(DIGESTS.read_text(encoding="utf-8"))


if __name__ == "__main__":
    table = {
        "releases": {name: of_release(name) for name in SMALL},
        "emulators": {kind: of_emulator(smallest_emulator(kind)) for kind in TOPS},
    }
    DIGESTS.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
