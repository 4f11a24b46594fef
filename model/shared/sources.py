# SPDX-License-Identifier: Apache-2.0
"""The project's own sources: the folders of its rooms, and digests that change with them.

Results that are expensive to compute (compiled designs, emitted Verilog, points of a sweep) are
kept on disk with such a digest in their names. Files are found by walking the rooms, so a moved
or new file cannot be missed.
"""

import hashlib
from collections.abc import Iterable
from functools import cache
from importlib.util import find_spec
from pathlib import Path

PROJECT = "coincid"
IGNORED = {"__pycache__"}


def digest(*parts: str | bytes) -> str:
    """Return twelve hex digits that change if one of `parts`, or a border between them, changes."""
    total = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        total.update(len(data).to_bytes(8, "little") + data)
    return total.hexdigest()[:12]


def package_files(*packages: str) -> list[Path]:
    """Return all files of packages ("coincid.hdl", "coincid.model.contract") and of the packages
    in them; sorted.
    """
    files = set()
    for package in packages:
        spec = find_spec(package)
        assert spec is not None and spec.submodule_search_locations, package
        folder = Path(next(iter(spec.submodule_search_locations)))
        files |= {
            path for path in folder.rglob("*") if path.is_file() and not IGNORED & set(path.parts)
        }
    return sorted(files)


def room_files(*rooms: str) -> list[Path]:
    """Return all files of rooms ("hdl", "model.contract"); sorted."""
    return package_files(*_packages(rooms))


def _packages(rooms: Iterable[str]) -> list[str]:
    return [f"{PROJECT}.{room}" for room in rooms]


@cache
def packages_digest(*packages: str) -> str:
    """Return the digest of all files of some packages, as they were when this process first
    asked.
    """
    parts: list[str | bytes] = []
    for path in package_files(*packages):
        parts += [path.name, path.read_bytes()]
    return digest(*parts)


def sources_digest(*rooms: str) -> str:
    """Return the digest of all files of some rooms, as they were when this process first asked."""
    return packages_digest(*_packages(rooms))
