# SPDX-License-Identifier: Apache-2.0
"""The check that every test ends, closes, removes and restores what it begins, opens, makes and
changes.
"""

import gc
import logging
import os
import tempfile
from threading import Event, Thread

import numpy as np
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


def test_a_temporary_file_that_is_left_is_told():
    before = Held.now()
    with tempfile.NamedTemporaryFile() as file:
        told = leftovers.leftovers(before)
    assert f"temporary {os.path.basename(file.name)}" in told
    assert not leftovers.leftovers(before)


def test_a_changed_process_is_told(tmp_path):
    before = Held.now()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        patch.setenv("COINCID_NEW", "1")
        patch.delenv("PATH")
        patch.syspath_prepend("modules")
        gc.disable()
        logging.disable(logging.CRITICAL)
        with np.errstate(divide="raise"):
            told = leftovers.leftovers(before)
        logging.disable(logging.NOTSET)
        gc.enable()
    assert told == [
        "another variable PATH",
        "another set of variables",
        "another working directory",
        "another path of modules",
        "another errors of NumPy",
        "another level up to which nothing is logged",
        "another collection of garbage",
    ]
    assert not leftovers.leftovers(before)
