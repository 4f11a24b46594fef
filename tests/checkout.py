# SPDX-License-Identifier: Apache-2.0
"""The files of the checkout."""

from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "coincid"  # its rooms are links
OUTSIDE = {".venv", "build", ".git"}  # large folders that are no part of the project


def project_files() -> Iterator[Path]:
    """Yield every file of the project, without a look into other folders."""
    for path in ROOT.iterdir():
        if path.is_file():
            yield path
        elif path.name not in OUTSIDE:
            yield from (inner for inner in path.rglob("*") if inner.is_file())


def package_sources() -> Iterator[tuple[str, str]]:
    """Yield every Python file of the package: its name within the package, and its text."""
    for inside in sorted(PACKAGE.iterdir()):
        for path in sorted(inside.rglob("*.py")) if inside.is_dir() else [inside]:
            if path.suffix == ".py":
                yield str(path.relative_to(PACKAGE)), path.read_text(encoding="utf-8")
