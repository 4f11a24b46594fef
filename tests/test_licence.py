# SPDX-License-Identifier: Apache-2.0
"""Every source file names the licence, and so does every source file that leaves the project."""

from pathlib import Path

import pytest

from coincid.flow.release import release_files
from coincid.model.contract.config import load_config
from coincid.model.shared.licence import SPDX

ROOT = Path(__file__).parents[1]
OUTSIDE = {".venv", "build", ".git"}
SOURCES = {".py", ".v", ".vh", ".cpp", ".c", ".h", ".js", ".css", ".html", ".xml", ".toml"}


def test_every_source_file_names_the_licence():
    sources = [
        path
        for path in ROOT.rglob("*")
        if path.suffix in SOURCES and not OUTSIDE & set(path.relative_to(ROOT).parts) and path.is_file()
    ]
    assert len(sources) > 100
    assert [path.name for path in sources if SPDX not in path.read_text().split("\n\n")[0]] == []


@pytest.mark.parametrize(("preset", "view"), [("silicon", "polyphase"), ("silicon", "async"), ("fpga", "polyphase")])
def test_every_exported_source_file_names_the_licence(preset, view):
    files = release_files(load_config(preset), view)
    sources = {name: text for name, text in files.items() if Path(name).suffix in {".v", ".vh", ".h"}}
    assert len(sources) > 10
    assert [name for name, text in sources.items() if SPDX not in text.partition("\n")[0]] == []
