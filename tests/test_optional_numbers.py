# SPDX-License-Identifier: Apache-2.0
"""Numbers that may be None: 0 is a number, too, and must not be taken for none."""

import ast
import re
from collections.abc import Iterator

from .checkout import package_sources

OPTIONAL = re.compile(r"(Annotated\[)?(int|float) \| None\b")  # an annotation
ALIKE = {  # (file, name): why 0 may be the same as None there
    ("flow/synth.py", "levels"): "a block without levels adds none",
    ("hdl/silicon/circuit.py", "banks"): "is 1 or 2",
    ("lab/campaign.py", "workers"): "is checked before",
    ("model/shared/threads.py", "number"): "is checked before",
    ("study/show/notebook.py", "frame"): "the first frame is drawn for all",
    ("study/simulate.py", "settling"): "is checked before",
    ("tb/sliced.py", "threads"): "is checked before",
}


def conditions(tree: ast.AST) -> Iterator[ast.expr]:
    """Yield the expressions of which only the truth counts."""
    for node in ast.walk(tree):
        match node:
            case ast.If(test) | ast.While(test) | ast.IfExp(test) | ast.Assert(test):
                yield test
            case ast.BoolOp(_, [*but_last, _]):
                yield from but_last
            case ast.UnaryOp(ast.Not(), operand):
                yield operand
            case ast.comprehension(ifs=tests):
                yield from tests


def optional_fields(tree: ast.Module) -> set[str]:
    """Return the names of a module's fields of classes that are numbers or None."""
    return {
        part.target.id
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        for part in node.body
        if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name)
        if OPTIONAL.match(ast.unparse(part.annotation))
    }


def optional_arguments(function: ast.FunctionDef) -> set[str]:
    """Return the names of a function's arguments that are numbers or None."""
    arguments = [*function.args.args, *function.args.kwonlyargs]
    return {
        one.arg
        for one in arguments
        if one.annotation and OPTIONAL.match(ast.unparse(one.annotation))
    }


def taken_for_none(text: str) -> set[str]:
    """Return the names of a module's numbers that may be None and of which only the truth is
    looked at, at one place at least.
    """
    if not OPTIONAL.search(text):
        return set()
    tree = ast.parse(text)
    fields = optional_fields(tree)
    found = {each.attr for each in conditions(tree) if isinstance(each, ast.Attribute)} & fields
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef):
            names = {each.id for each in conditions(function) if isinstance(each, ast.Name)}
            found |= names & optional_arguments(function)
    return found


def test_a_number_that_may_be_none_is_held_against_none():
    found = {(file, name) for file, text in package_sources() for name in taken_for_none(text)}
    assert found == ALIKE.keys()


def test_a_number_whose_truth_is_looked_at_is_found():
    text = """
class One:
    field: float | None = None
    flag: bool = False

    def ask(self, seed: Annotated[int | None, "seed"], name: str | None, frame: int | None):
        return [self.field or 1.0, not self.flag, seed and 2, name or "", frame is None]
"""
    assert taken_for_none(text) == {"field", "seed"}
