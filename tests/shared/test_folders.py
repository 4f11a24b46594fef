# SPDX-License-Identifier: Apache-2.0
"""Where generated files go: the folder that is chosen, that of the checkout, or the user's cache."""

import re
from pathlib import Path

import pytest

from coincid.model.shared import folders
from coincid.model.shared.errors import InputError
from coincid.model.shared.folders import build_root, checkout, is_plain


@pytest.fixture
def without_a_checkout(tmp_path, monkeypatch):
    """As if the project were installed, for a user whose home is `tmp_path`."""
    monkeypatch.setattr(folders, "checkout", lambda: None)
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("COINCID_BUILD", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)


def test_a_chosen_folder_counts_before_all_others(tmp_path, monkeypatch):
    """Also if it is told from where one is; it stays the same in another folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("COINCID_BUILD", "mine/build")
    monkeypatch.chdir(tmp_path)
    root = build_root()
    assert root == tmp_path / "mine" / "build"
    assert root.is_dir() and not list(root.iterdir())


def test_a_checkout_has_its_own_folder(tmp_path, monkeypatch):
    monkeypatch.delenv("COINCID_BUILD", raising=False)
    monkeypatch.setattr(folders, "checkout", lambda: tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert build_root() == tmp_path / "build"
    found = checkout()
    assert found is None or (found / "model" / "shared" / "folders.py").exists()


@pytest.mark.parametrize("name", ["my clone", "Jörg", "copy (1)", "o'brien", "a#b", "a$b", "a:b"])
def test_a_checkout_that_make_cannot_name_uses_the_users_cache(name, tmp_path, monkeypatch):
    monkeypatch.delenv("COINCID_BUILD", raising=False)
    monkeypatch.setattr(folders, "checkout", lambda: tmp_path / name)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert build_root() == tmp_path / "cache" / "coincid"
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize("name", ["clone", "A-1_2.3", "a+b", "@work", "a,b"])
def test_a_plain_path_is_one_that_make_takes(name):
    assert is_plain(Path("/a/folder") / name)


@pytest.mark.parametrize(("cache", "place"), [(None, ".cache"), ("", ".cache"), ("other", "other")])
def test_an_installation_uses_the_users_cache(
    cache, place, without_a_checkout, tmp_path, monkeypatch
):
    """Its place has a default, which an empty variable does not change."""
    if cache is not None:
        monkeypatch.setenv("XDG_CACHE_HOME", cache and str(tmp_path / cache))
    monkeypatch.chdir(tmp_path)
    assert build_root() == tmp_path / place / "coincid"


def test_a_folder_that_cannot_be_written_is_told(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    root: Path = tmp_path / "file" / "build"
    monkeypatch.setenv("COINCID_BUILD", str(root))
    told = rf"^build directory {re.escape(str(root))}: not writable \(Not a directory\); set COINCID_BUILD"
    with pytest.raises(InputError, match=told):
        build_root()
