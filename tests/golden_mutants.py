# SPDX-License-Identifier: Apache-2.0
"""Mutants of the golden model: what they are, which are known to be equivalent, and how they fare.

The model's syntax tree is mutated here. mutmut and cosmic-ray would start a test run for every
mutant, and Numba would compile all functions again. Without Numba, and compared with recorded beats
and fates of the same frames, a mutant takes a second; survivors go through the tests of the golden
model.

A mutant that no test can notice has an excuse in the source: a comment alone on the line before,

    # equivalent: room for more edges
    # equivalent (1: one more): a bound that nobody reads

The first form excuses all mutants of the next line, the second those whose description has the text
in parentheses. Several such comments may follow each other. An excuse counts only if the mutant
passes all frames.
"""

import ast
import copy
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from attrs import frozen

from coincid.model.shared.sources import room_files

from .fates import EQUAL, Fate

SECONDS_MAX = 240  # for a mutant: one that hangs is also noticed
COMPUTING = ("pixels", "windows")  # files of the contract with which the golden model computes
UNUSED = ("pixel_number", "subgroup_image")  # functions in them that it does not use
EXCUSE = re.compile(r"# equivalent(?: \((?P<part>[^()]+)\))?: (?P<reason>\S.*)")

COMPARE = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
}
ARITHMETIC = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Add,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
    ast.And: ast.Or,
    ast.Or: ast.And,
}


def _golden_sources() -> dict[str, Path]:
    """Return module -> file, for everything that the golden model uses for its computation."""
    sources = {}
    for path in room_files("model.golden", "model.contract"):
        computes = path.parent.name == "golden" or path.stem in COMPUTING
        if path.suffix == ".py" and computes:
            sources[f"coincid.model.{path.parent.name}.{path.stem}"] = path
    return sources


GOLDEN_SOURCES = _golden_sources()


@frozen
class Excuse:
    """A comment that excuses mutants. line: its own; part: of their descriptions, '' for all."""

    module: str
    line: int
    part: str
    reason: str


@frozen
class GoldenMutant:
    """A mutant of a module. number: of the mutation; line, code: where it is; what: it does."""

    module: str
    number: int
    line: int
    code: str
    what: str

    def __str__(self) -> str:
        name = GOLDEN_SOURCES[self.module].stem
        return f"{name}: `{self.code}`: {self.what} (line {self.line})"


def mutations(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Yield what can become of a part of a syntax tree: a description, and what takes its place."""
    match node:
        case ast.Compare(left, ops, others):
            for k, op in enumerate(ops):
                if type(op) in COMPARE:
                    new = [*ops[:k], COMPARE[type(op)](), *ops[k + 1 :]]
                    mutant = ast.Compare(left, new, others)
                    yield f"{ast.unparse(node)}: {type(op).__name__}", mutant
        case ast.BinOp() | ast.AugAssign() | ast.BoolOp() if type(node.op) in ARITHMETIC:
            new = copy.copy(node)
            new.op = ARITHMETIC[type(node.op)]()
            yield f"{ast.unparse(node)}: {type(node.op).__name__}", new
        case ast.UnaryOp(ast.Not(), operand):
            yield f"{ast.unparse(node)}: no not", operand
        case ast.Constant(bool(value)):
            yield f"{value}: not", ast.Constant(not value)
        case ast.Constant(int(value)):
            yield f"{value}: one more", ast.Constant(value + 1)
        case ast.Assign() if node.col_offset > 4:
            # Where a forgotten reset of a loop's variables would do harm.
            yield f"{ast.unparse(node)}: left out", ast.Pass()
        case ast.Continue():
            yield "continue: left out", ast.Pass()


Mutations = Callable[[ast.AST], Iterator[tuple[str, ast.AST]]]


class Mutator(ast.NodeTransformer):
    """Lists the mutations of a syntax tree, and applies the one with the number `apply`.

    of: returns what can become of a part. found: line and description of each.
    """

    def __init__(self, apply: int | None = None, of: Mutations = mutations):
        self.apply = apply
        self.of = of
        self.found: list[tuple[int, str]] = []

    def visit(self, node):
        self.generic_visit(node)
        for what, new in self.of(node):
            number = len(self.found)
            self.found.append((node.lineno, what))
            if number == self.apply:
                return ast.copy_location(new, node)
        return node

    def generic_visit(self, node):
        """Visit what is computed when a function is called.

        These are neither its defaults and decorators, nor annotations.
        """
        if isinstance(node, ast.FunctionDef):
            node.body = [self.visit(statement) for statement in node.body]
        elif isinstance(node, ast.AnnAssign):
            node.value = node.value and self.visit(node.value)
        else:
            super().generic_visit(node)


def _mutated(module: str, number: int | None = None) -> tuple[ast.Module, Mutator]:
    """Return a module's syntax tree with one mutation (default: none), and its mutator."""
    tree = ast.parse(GOLDEN_SOURCES[module].read_text(encoding="utf-8"))
    mutator = Mutator(number)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and node.name not in UNUSED:
            mutator.visit(node)
    return tree, mutator


def golden_mutants() -> list[GoldenMutant]:
    """Return every mutant of the golden model."""
    mutants = []
    for module, path in GOLDEN_SOURCES.items():
        lines = path.read_text(encoding="utf-8").splitlines()
        _, mutator = _mutated(module)
        for number, (line, what) in enumerate(mutator.found):
            mutants.append(GoldenMutant(module, number, line, lines[line - 1].strip(), what))
    return mutants


def source_of(mutant: GoldenMutant) -> str:
    """Return the module with the mutation."""
    tree, _ = _mutated(mutant.module, mutant.number)
    return ast.unparse(ast.fix_missing_locations(tree))


def excuses() -> dict[tuple[str, int], list[Excuse]]:
    """Return (module, line) -> the excuses of the mutants on that line.

    Raises `ValueError` for a comment that begins like an excuse, and is none.
    """
    found = {}
    for module, path in GOLDEN_SOURCES.items():
        pending: list[Excuse] = []
        for number, text in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            line = text.strip()
            form = EXCUSE.fullmatch(line)
            if form:
                pending.append(Excuse(module, number, form["part"] or "", form["reason"]))
            elif "# equivalent" in line:
                raise ValueError(f"{path.name}, line {number}: no form of an excuse: {line}")
            elif pending:
                found[module, number] = pending
                pending = []
    return found


def excuse_of(mutant: GoldenMutant, known: dict[tuple[str, int], list[Excuse]]) -> Excuse | None:
    """Return the excuse of a mutant that is known to be equivalent."""
    for excuse in known.get((mutant.module, mutant.line), []):
        if excuse.part in mutant.what:
            return excuse
    return None


def passes(module: str, source: Path, jobs: Path, only_frames: bool = False) -> bool:
    """Return whether frames and, if wanted, tests pass with `source` in the place of a module."""
    command = [sys.executable, "-m", "tests.judge", module, str(source), str(jobs)]
    if only_frames:
        command.append("frames")
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONWARNINGS": "ignore"}
    try:
        done = subprocess.run(
            command, env=environment, timeout=SECONDS_MAX, capture_output=True, check=False
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def judge_golden(
    mutants: list[GoldenMutant], folder: Path, jobs: Path, tell: Callable[[Fate], None]
) -> list[Fate]:
    """Return the fates of mutants; `tell` gets each as it comes.

    folder: for their sources; jobs: frames with their records. Raises `SystemExit` if the golden
    model without mutation does not pass.
    """
    module, path = next(iter(GOLDEN_SOURCES.items()))
    if not passes(module, path, jobs):
        raise SystemExit("the golden model without mutation fails")
    known = excuses()

    def judge(number: int, mutant: GoldenMutant, text: str) -> Fate:
        source = folder / f"golden_{number}.py"
        source.write_text(text, encoding="utf-8")
        excuse = excuse_of(mutant, known)
        if not passes(mutant.module, source, jobs, only_frames=excuse is not None):
            by = "tests"
        elif excuse:
            by = f"{EQUAL}: {excuse.reason}"
        else:
            by = ""
        fate = Fate("golden", str(mutant), by)
        tell(fate)
        return fate

    # Threads must not parse, so the mutants are made here.
    texts = [source_of(mutant) for mutant in mutants]
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        return list(pool.map(judge, range(len(mutants)), mutants, texts))


def unneeded_excuses(mutants: list[GoldenMutant], fates: list[Fate]) -> list[Excuse]:
    """Return the excuses of which mutants were tried, and none survived."""
    known = excuses()
    tried: dict[Excuse, bool] = {}
    for mutant, fate in zip(mutants, fates, strict=True):
        excuse = excuse_of(mutant, known)
        if excuse:
            tried[excuse] = tried.get(excuse, False) or fate.is_equal
    return [excuse for excuse, needed in tried.items() if not needed]
