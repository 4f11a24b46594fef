# SPDX-License-Identifier: Apache-2.0
"""The files of the checkout."""

from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
OUTSIDE = {".venv", "build", ".git"}  # large folders that are no part of the project


def project_files() -> Iterator[Path]:
    """Yield every file of the project, without a look into other folders."""
    for path in ROOT.iterdir():
        if path.is_file():
            yield path
        elif path.name not in OUTSIDE:
            yield from (inner for inner in path.rglob("*") if inner.is_file())
