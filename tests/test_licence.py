# SPDX-License-Identifier: Apache-2.0
"""Every source file names the licence, and so does every source file that leaves the project."""

from coincid.model.shared.licence import SPDX

from .checkout import project_files
from .releases import small_releases

SOURCES = {".py", ".v", ".vh", ".cpp", ".c", ".h", ".js", ".css", ".html", ".xml", ".toml"}


def test_every_source_file_names_the_licence():
    sources = [path for path in project_files() if path.suffix in SOURCES]
    assert len(sources) > 100
    assert [
        path.name
        for path in sources
        if SPDX not in path.read_text(encoding="utf-8").split("\n\n")[0]
    ] == []


def test_every_exported_source_file_names_the_licence():
    sources = [path for path in small_releases().rglob("*") if path.suffix in {".v", ".vh", ".h"}]
    assert len(sources) > 30
    assert [
        path.name
        for path in sources
        if SPDX not in path.read_text(encoding="utf-8").partition("\n")[0]
    ] == []
