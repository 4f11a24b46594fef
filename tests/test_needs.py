# SPDX-License-Identifier: Apache-2.0
"""Tests say what they need beside `make test` in one way, and without it they are skipped with the
command that installs it.
"""

import ast
import sys
from pathlib import Path

import pytest
from packaging.utils import canonicalize_name

from . import needs
from .imports import distributions_of, others_behind, packages_of

pytest_plugins = ["pytester"]  # runs of pytest inside a test

TESTS = Path(__file__).parent
OTHER_WAYS = {"importorskip", "skipif", "skip"}
BY_THE_MARKER = {TESTS / "conftest.py"}

MARKED = """
import pytest

@pytest.mark.needs("{name}")
def test_marked():
    pass

def test_plain():
    pass
"""


def test_the_marker_is_the_only_way_to_skip():
    found = []
    for path in TESTS.rglob("*.py"):
        if path in BY_THE_MARKER:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if (
                isinstance(node, ast.Attribute)
                and node.attr in OTHER_WAYS
                and _is_of_pytest(node.value)
            ):
                found.append(f"{path.relative_to(TESTS)}:{node.lineno}: {node.attr}")
    assert not found, f"use @pytest.mark.needs (tests/needs.py): {found}"


def _is_of_pytest(node: ast.expr) -> bool:
    """Return whether the expression is `pytest` or `pytest.mark`."""
    return ast.unparse(node) in {"pytest", "pytest.mark"}


def test_a_file_of_tests_is_imported_with_nothing_beside_make_test():
    """A file that cannot be imported is an error of the whole run, not a test that is skipped."""
    brought = packages_of("test")
    found = []
    for path in [TESTS / "conftest.py", *TESTS.rglob("test_*.py")]:
        module = ".".join(("coincid", *path.relative_to(TESTS.parent).with_suffix("").parts))
        for other in sorted(others_behind([module]) - sys.stdlib_module_names):
            # a module that is one compiled file has the name of its distribution
            names = distributions_of(other) or {canonicalize_name(other)}
            if not names & brought:
                found.append(f"{path.relative_to(TESTS)}: {other}")
    assert not found, f"use imported() of tests/needs.py, or import inside the test: {found}"


@pytest.fixture
def project(pytester, monkeypatch):
    """A folder with two tests, of which one needs something that is not installed until `installed`
    is called.
    """
    lacking = needs.Need("a thing", "make a-thing", lambda: False)
    monkeypatch.setitem(needs.NEEDS, "thing", lacking)
    pytester.makeconftest("from tests.conftest import *")
    pytester.makepyfile(MARKED.format(name="thing"))
    return pytester


def test_what_is_missing_is_said_and_played_later(project, monkeypatch):
    result = project.inline_run("-p", "no:randomly")
    passed, skipped, failed = result.listoutcomes()
    assert (len(passed), len(skipped), len(failed)) == (1, 1, 0)
    assert "make a-thing" in str(skipped[0].longrepr)
    monkeypatch.setitem(needs.NEEDS, "thing", needs.Need("a thing", "make a-thing", lambda: True))
    passed, skipped, failed = project.inline_run(
        "-p", "no:randomly", "--skipped-before"
    ).listoutcomes()
    assert [report.nodeid.partition("::")[2] for report in passed] == ["test_marked"]
    assert (skipped, failed) == ([], [])


def test_without_skips_a_skipped_test_fails(project):
    result = project.inline_run("-p", "no:randomly", "--no-skips")
    _, _, failed = result.listoutcomes()
    assert len(failed) == 1
