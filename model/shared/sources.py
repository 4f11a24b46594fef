# SPDX-License-Identifier: Apache-2.0
"""The project's own sources: the folders of its rooms, and digests that change with them.

Results that are expensive to compute (compiled designs, emitted Verilog, points of a sweep) are kept on disk with such a
digest in their names. Files are found by walking the rooms, so a moved or new file cannot be missed.
"""

import hashlib
from functools import cache
from importlib.util import find_spec
from pathlib import Path

IGNORED = {"__pycache__"}


def digest(*parts: str | bytes) -> str:
    """Return twelve hex digits that change if one of `parts`, or a border between them, changes."""
    total = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        total.update(len(data).to_bytes(8, "little") + data)
    return total.hexdigest()[:12]


def room_files(*rooms: str) -> list[Path]:
    """Return all files of the packages `rooms` below `coincid` ("hdl", "model.contract") and of their packages; sorted."""
    files = set()
    for room in rooms:
        spec = find_spec(f"coincid.{room}")
        assert spec is not None and spec.submodule_search_locations, room
        folder = Path(next(iter(spec.submodule_search_locations)))
        files |= {path for path in folder.rglob("*") if path.is_file() and not IGNORED & set(path.parts)}
    return sorted(files)


@cache
def sources_digest(*rooms: str) -> str:
    """Return the digest of all files of some rooms, as they were when this process first asked."""
    return digest(*(part for path in room_files(*rooms) for part in (path.name, path.read_bytes())))
