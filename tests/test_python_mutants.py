# SPDX-License-Identifier: Apache-2.0
"""Mutants of Python: what they are, which tests judge them, and how the report counts them."""

import ast

import pytest

from .fates import EQUAL, Fate
from .line_map import LineMap, collect, load, record, save
from .python_mutants import (
    FIRST_S,
    ROOMS,
    ROOT,
    TOGETHER_S,
    Fates,
    KeywordsLeftAlone,
    PythonMutant,
    all_mutations,
    batches_of,
    excuse_of,
    excuses,
    files_of,
    judge,
    key_of,
    mutants_of,
    report,
    sample_of,
    slips,
)

NO_LINES = LineMap([], [], {})


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
    fates = judge(mutants, Fates(tmp_path / "fates.json"), NO_LINES)
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


@pytest.mark.parametrize(
    "text, others",
    [
        ("a and b and c", ["b and c", "a and c", "a and b"]),
        ("a or b", ["b", "a"]),
        ("a if b else c", ["a", "c"]),
        ("f(a, b, c)", ["f(b, a, c)"]),
        ("f(*a, b)", []),
        ("max(a, b)", []),
        ("np.minimum(a, b)", []),
        ("f(a, b=1, strict=True)", ["f(a, strict=True)"]),
        ("f(b=1, c=2)", ["f(c=2)", "f(b=1)"]),
        ("a[0]", ["a[-1]"]),
        ("a[1]", []),
    ],
)
def test_slips_of_an_expression(text, others):
    node = ast.parse(text, mode="eval").body
    assert [ast.unparse(new) for _, new in slips(node)] == others


@pytest.mark.parametrize(
    ("text", "there"), [("f(a, strict=True)", False), ("f(a, on=True)", True), ("f(True)", True)]
)
def test_a_value_of_a_keyword_without_an_effect_is_no_place_for_a_mutation(text, there):
    mutator = KeywordsLeftAlone(None, all_mutations)
    mutator.visit(ast.parse(text, mode="eval").body)
    assert ("True: not" in [what for _, what in mutator.found]) == there


@pytest.mark.parametrize(
    "text, others",
    [
        ("if a:\n    b = 1", ["if False:\n    b = 1"]),
        ("if a:\n    b = 1\nelse:\n    b = 2", []),
        ("f()", ["pass"]),
        ("a = f()", []),
    ],
)
def test_slips_of_a_statement(text, others):
    [node] = ast.parse(text).body
    assert [ast.unparse(new) for _, new in slips(node)] == others


def mutant_of(file, line):
    return PythonMutant(file.rpartition("/")[0], file, 0, line, "x", "y")


def lines_of(tests):
    """Return a map in which one line is run by tests: name -> seconds."""
    return LineMap([*tests], [*tests.values()], {"lab/pace.py": {3: [*range(len(tests))]}})


def test_a_mutant_is_judged_by_the_tests_of_its_line_those_of_its_file_and_the_quick_ones_first():
    tests = {
        "tests/lab/test_batches.py::test_slow": 1.5,
        "tests/lab/test_batches.py::test_quick": 0.5,
        "tests/lab/test_pace.py::test_a": 1.0,
        "tests/lab/test_pace.py::test_b": 2.0,
        "tests/lab/test_pace.py::test_long": FIRST_S + 1,
        "tests/lab/test_pace.py::test_too_long": TOGETHER_S + 1,
    }
    batches = batches_of(mutant_of("lab/pace.py", 3), lines_of(tests))
    assert [[test.partition("::test_")[2] for test in names] for names, _ in batches] == [
        ["a", "quick", "b"],
        ["slow", "long"],
        [""],
    ]
    assert [seconds for _, seconds in batches] == [3.5, FIRST_S + 2.5, 0.0]
    assert batches[-1][0] == ["tests/lab/test_pace.py"]


def test_a_line_that_no_test_runs_is_judged_by_the_files_of_its_room():
    mutant = mutant_of("lab/pace.py", 4)
    batches = batches_of(mutant, lines_of({"tests/lab/test_pace.py::test_a": 1.0}))
    assert batches == [(files_of("lab", mutant.file), 0.0)]


def test_the_key_of_a_mutant_changes_with_its_tests():
    mutant = mutant_of("lab/pace.py", 3)
    one, other = (lines_of({f"tests/lab/test_pace.py::{name}": 1.0}) for name in ("a", "b"))
    assert key_of(mutant, one) == key_of(mutant, one) != key_of(mutant, other)


@pytest.mark.needs("mutants")
def test_the_map_knows_which_test_runs_a_line(tmp_path):
    test = "tests/shared/test_markdown.py"
    record(tmp_path, [test, "-p", "no:randomly", "-p", "no:cacheprovider"])
    save(collect(tmp_path), tmp_path / "lines.json")
    lines = load(tmp_path / "lines.json")
    assert lines.tests and all(name.startswith(test) for name in lines.tests)
    assert len(lines.seconds) == len(lines.tests)
    ran = {line for line, tests in lines.lines["model/shared/markdown.py"].items() if tests}
    code = (ROOT / "model/shared/markdown.py").read_text(encoding="utf-8").splitlines()
    assert any(code[line - 1].strip().startswith("return ") for line in ran)
    assert not lines.of("lab/pace.py", 3)
