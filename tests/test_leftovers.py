# SPDX-License-Identifier: Apache-2.0
"""The check that every test ends and closes what it begins and opens."""

from threading import Event, Thread

import pytest

from . import leftovers
from .leftovers import Held

KNOWN = leftovers.PROCESS.exists()  # files are, on Linux


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(leftovers, "PATIENCE_S", 0.05)


def test_a_thread_that_is_left_is_told():
    ended = Event()
    before = Held.now()
    thread = Thread(target=ended.wait, name="left alone")
    thread.start()
    told = leftovers.leftovers(before)
    ended.set()
    thread.join()
    assert told == ["thread left alone"]
    assert not leftovers.leftovers(before)


def test_a_file_that_is_left_open_is_told(tmp_path):
    before = Held.now()
    path = tmp_path / "open"
    with path.open("w", encoding="utf-8"):
        told = leftovers.leftovers(before)
    assert told == [f"file {path}"] * KNOWN
    assert not leftovers.leftovers(before)
