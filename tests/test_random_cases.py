# SPDX-License-Identifier: Apache-2.0
"""The examples of a test depend on the seed alone, so that one command repeats a failure."""

import importlib

from hypothesis import strategies as st

from . import random_cases


def test_a_module_that_is_loaded_changes_no_example(tmp_path, monkeypatch):
    numbers = st.integers(0, 2**40)
    before = random_cases.drawn(numbers, 300, of=1)
    path = tmp_path / "with_constants.py"
    path.write_text("\n".join(f"CONSTANT_{k} = {10**9 + k}" for k in range(500)), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module(path.stem)
    assert random_cases.drawn(numbers, 300, of=1) == before
