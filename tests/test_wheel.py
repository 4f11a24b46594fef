# SPDX-License-Identifier: Apache-2.0
"""The built wheel contains everything that the program reads, and runs where it is unpacked, away
from the checkout.
"""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import attrs
import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("model", "tools", "host", "hdl", "slices", "tb", "flow", "formal", "lab", "study", "board")
CACHES = {"__pycache__", ".ruff_cache"}  # folders in a room that are no part of it
PRESETS_AND_SCENES = """
import coincid
from coincid.hdl.front_end_views import view_at

assert {here!r} in coincid.__file__, coincid.__file__
config = coincid.load_config("fpga")
assert config.clock_mhz == 125 and coincid.load_scene("five-objects", 32, 32).valid.all()
assert all(path.exists() for path in view_at("async", 500).macros)
"""


def copy_of_the_project(source):
    """Copy what is built, so that the checkout stays unchanged."""
    for name in (*ROOMS, "src"):
        shutil.copytree(
            ROOT / name, source / name, symlinks=True, ignore=shutil.ignore_patterns(*CACHES)
        )
    for name in ("pyproject.toml", "README.md", "LICENSE", "NOTICE"):
        shutil.copy(ROOT / name, source / name)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Build the wheel from a copy."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    copy_of_the_project(source)
    words = "-m pip wheel . --no-deps --no-build-isolation --quiet -w"
    done = subprocess.run(
        [sys.executable, *words.split(), folder],
        cwd=source,
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr
    (built,) = folder.glob("*.whl")
    return built


def test_every_file_of_the_rooms_is_in_the_wheel(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    files = [path for room in ROOMS for path in (ROOT / room).rglob("*") if path.is_file()]
    inside = {f"coincid/{path.relative_to(ROOT)}" for path in files if not CACHES & set(path.parts)}
    assert len(inside) > 150 and inside <= set(names), inside - set(names)
    assert {name.partition("/")[0] for name in names if ".dist-info/" not in name} == {"coincid"}
    for part in ("licenses/LICENSE", "licenses/NOTICE", "entry_points.txt"):
        assert any(name.endswith(f".dist-info/{part}") for name in names), part


def test_the_wheel_runs_by_itself(wheel, tmp_path):
    site = tmp_path / "site"
    zipfile.ZipFile(wheel).extractall(site)
    environment = os.environ | {"PYTHONPATH": str(site), "COINCID_BUILD": str(tmp_path / "build")}
    for words in (("-c", PRESETS_AND_SCENES.format(here=str(site))), ("-m", "coincid", "--help")):
        command = [sys.executable, *words]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, encoding="utf-8"
        )
        assert done.returncode == 0, done.stderr
    assert "explore" in done.stdout


def test_a_script_beside_the_clone_finds_the_package(tmp_path):
    """The clone's folder has the package's name, and lies where the script does."""
    clone, python = tmp_path / "coincid", tmp_path / "env" / "bin" / "python"
    copy_of_the_project(clone)
    subprocess.run(
        [sys.executable, "-m", "venv", "--system-site-packages", tmp_path / "env"], check=True
    )
    # setuptools, for the build alone
    own = os.environ | {"PYTHONPATH": str(Path(attrs.__path__[0]).parent)}
    words = "-m pip install --no-deps --no-build-isolation --quiet --editable"
    subprocess.run([python, *words.split(), clone], check=True, env=own)
    (tmp_path / "script.py").write_text(
        "import coincid; print(coincid.__file__, coincid.__version__)", encoding="utf-8"
    )
    done = subprocess.run(
        [python, "script.py"], cwd=tmp_path, capture_output=True, text=True, encoding="utf-8"
    )
    assert done.stdout.startswith(str(clone / "src" / "coincid" / "__init__.py")), (
        done.stdout + done.stderr
    )
    for room in (*ROOMS, "docs", "tests"):
        alone = subprocess.run(
            [python, "-c", f"import {room}"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            encoding="utf-8",
        )
        assert "ModuleNotFoundError" in alone.stderr, f"`import {room}` works in anybody's project"


def test_a_clone_without_links_says_so(tmp_path):
    """A ZIP file, or Git on Windows, has small text files in the place of the links."""
    package = tmp_path / "coincid"
    shutil.copytree(ROOT / "src" / "coincid", package, symlinks=True)
    for room in ROOMS:
        (package / room).unlink()
        (package / room).write_text(f"../../{room}", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", "import coincid"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    assert "git config --global core.symlinks true" in done.stderr, done.stderr
