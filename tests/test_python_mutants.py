# SPDX-License-Identifier: Apache-2.0
"""Mutants of Python: their excuses are of lines that exist, and the report counts them apart."""

import pytest

from .fates import EQUAL, Fate
from .python_mutants import (
    ROOMS,
    ROOT,
    Fates,
    excuse_of,
    excuses,
    files_of,
    judge_room,
    mutants_of,
    report,
    sample_of,
)


def room_of(file):
    return file.rpartition("/")[0]


@pytest.mark.parametrize("excuse", excuses(), ids=str)
def test_every_excuse_is_of_a_mutant(excuse):
    mutants = mutants_of(room_of(excuse.file))
    assert any(excuse_of(mutant, [excuse]) for mutant in mutants)
    assert excuse.reason


def test_an_excused_mutant_is_not_judged(tmp_path):
    excuse = excuses()[0]
    room = room_of(excuse.file)
    mutants = [mutant for mutant in mutants_of(room) if excuse_of(mutant, [excuse])]
    fates = judge_room(room, mutants, Fates(tmp_path / "fates.json"))
    assert len(fates) == len(mutants) and all(fate.is_equal for fate in fates)
    assert not (tmp_path / "fates.json").exists()


def test_a_rate_leaves_out_what_is_excused():
    fates = [
        Fate("host", "a", "tests"),
        Fate("host", "b", ""),
        Fate("host", "c", f"{EQUAL}: the same"),
        Fate("lab", "d", f"{EQUAL}: the same"),
    ]
    lines = report(fates, 1).splitlines()
    assert "| `host` | 3 | 1 | 1 | 1 | 50% |" in lines
    assert "| `lab` | 1 | 0 | 1 | 0 |  |" in lines
    assert "* b" in lines and f"* c ({EQUAL}: the same)" in lines


@pytest.mark.parametrize("room", ROOMS)
def test_every_room_has_mutants_and_tests(room):
    chosen = sample_of(room, 5, seed=1)
    assert chosen == sample_of(room, 5, seed=1) and len(chosen) == 5
    for mutant in chosen:
        files = files_of(room, mutant.file)
        assert sorted(files) == sorted(files_of(room))
        assert all((ROOT / file).is_file() for file in files)
