# SPDX-License-Identifier: Apache-2.0
"""Mutants of the rooms in Python: a sample of each room, judged by the tests that run its lines.

`python -m tests.python_mutants [--seed N] [--number N] [ROOM ...]` writes
build/mutation/python.md. The golden model has more of them (`golden_mutants.py`), so it is no room
here. `line_map.py` knows which tests run a mutated line: the first call makes this map, which takes
twice as long as the regression. The tests of the file's own name are played first, the quick ones
before the others, and at most for `TOGETHER_S`; then the whole file of that name. For a line that
no test runs, such as one that Numba compiles, the tests of the room and of its users are played.

A run that was stopped continues: fates are kept in build/mutation/python.json, as long as neither
the mutated file nor the names of the tests that judge it have changed.

A mutant that no test can notice has an excuse in `python_excuses.toml`. It is not judged.
"""

import argparse
import ast
import copy
import json
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from itertools import chain, zip_longest
from pathlib import Path
from queue import SimpleQueue
from threading import Lock

import numpy as np
import pytest
from attrs import frozen
from filelock import FileLock

from coincid.model.shared.interrupts import program
from coincid.tb.toolchain import build_root

from . import line_map
from .fates import EQUAL, Fate, count
from .golden_mutants import Mutator, mutations
from .line_map import LineMap
from .planted import ROOT

# Room -> its tests and those of its users, for lines that no test runs: the quickest first. The
# first that fails decides, and those behind it are not played.
ROOMS = {
    "model/shared": ["tests/shared", "tests/scenes/test_ambient.py"],
    "model/contract": [
        "tests/contract",
        "tests/golden/test_golden.py",
        "tests/host",
        "tests/lab/test_result_pairs.py",
    ],
    "model/recorded": ["tests/recorded"],
    "model/scenes": ["tests/scenes"],
    "model/light": ["tests/light", "tests/lab/test_result_pairs.py"],
    "model/depth": ["tests/lab/test_result_pairs.py", "tests/depth"],
    "lab": ["tests/lab", "tests/study/test_sweep.py"],
    "host": ["tests/host", "tests/board"],
    "board": ["tests/board"],
    "flow": ["tests/flow"],
    "study": ["tests/study"],
    "tb": ["tests/tb", "tests/silicon/test_async.py"],
    "slices": ["tests/slices", "tests/tb/test_sliced.py"],
    "tools": [
        "tests/tb/test_toolchain.py",
        "tests/test_setup.py",
        "tests/test_needs.py",
        "tests/test_pages.py",
    ],
    "src/coincid": [
        "tests/test_cli.py",
        "tests/test_commands.py",
        "tests/board/test_run.py",
        "tests/formal/test_formal.py",
    ],
}
NUMBER = 8  # mutants of a room
JOBS = 2  # mutants at once
FIRST_S = 4.0  # tests that are played first take so long, and those of a line
TOGETHER_S = 30.0  # at most so long, both as the map says
SLACK_S = 60.0  # a mutant may take so much longer than its tests without mutation,
SLOWER = 3  # and so many times as long
NO_TESTS = pytest.ExitCode.NO_TESTS_COLLECTED  # all tests of a file are `long`
TIME = "time"  # the killer of a mutant that takes too long
FAILED = re.compile(r"^(?:FAILED|ERROR) (?P<name>.+?)(?: - .*)?$", re.MULTILINE)
LEFT_OUT = {"__init__.py", "proofs.py"}  # `make formal` plays the proofs of a room
EXCUSES = Path(__file__).with_name("python_excuses.toml")
LARGE = shutil.ignore_patterns(".git", ".venv", "build", "__pycache__")  # of a checkout


@frozen
class PythonExcuse:
    """Why no test can notice a mutant. code: its line, without indentation; what: it does."""

    file: str
    code: str
    what: str
    reason: str


@frozen
class PythonMutant:
    """A mutant of a file of a room. number: of the mutation; line, code, what: where it is and what
    it does.
    """

    room: str
    file: str
    number: int
    line: int
    code: str
    what: str

    def __str__(self) -> str:
        return f"{self.file}, line {self.line}: {self.what}"


# Keywords whose absence changes nothing that a test could see on this machine.
SAME_WITHOUT = {"strict", "encoding", "check", "stacklevel", "help", "metavar", "description"}
# Functions whose arguments may come in any order.
SYMMETRIC = {"min", "max", "np.minimum", "np.maximum"}


def slips(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Yield what a person may write in place of a part of a syntax tree, beside `mutations`: a
    description, and what takes its place.
    """
    text = ast.unparse(node) if isinstance(node, ast.expr | ast.Expr) else ""
    match node:
        case ast.BoolOp(op, values):
            for k, value in enumerate(values):
                rest = [*values[:k], *values[k + 1 :]]
                without = ast.BoolOp(op, rest) if len(rest) > 1 else rest[0]
                yield f"{text}: without {ast.unparse(value)}", without
        case ast.IfExp(_, body, orelse):
            yield f"{text}: always", body
            yield f"{text}: never", orelse
        case ast.If(test, body, []):
            yield f"if {ast.unparse(test)}: never", ast.If(ast.Constant(False), body, [])
        case ast.Expr(ast.Call()):
            yield f"{text}: left out", ast.Pass()
        case ast.Subscript(value, ast.Constant(0)):
            yield f"{text}: the last", ast.Subscript(value, ast.Constant(-1), node.ctx)
        case ast.Call(function, [first, second, *rest], keywords):
            ordered = ast.unparse(function) not in SYMMETRIC
            if ordered and not {type(first), type(second)} & {ast.Starred}:
                yield f"{text}: swapped", ast.Call(function, [second, first, *rest], keywords)
    if isinstance(node, ast.Call):
        for k, keyword in enumerate(node.keywords):
            if keyword.arg and keyword.arg not in SAME_WITHOUT:
                new = copy.copy(node)
                new.keywords = [*node.keywords[:k], *node.keywords[k + 1 :]]
                yield f"{text}: without {keyword.arg}", new


def all_mutations(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Yield the mutations of a part of a syntax tree."""
    return chain(mutations(node), slips(node))


class KeywordsLeftAlone(Mutator):
    """Leaves keywords alone of which no test could see anything."""

    def visit(self, node: ast.AST) -> ast.AST:
        if isinstance(node, ast.keyword) and node.arg in SAME_WITHOUT:
            return node
        return super().visit(node)


def _mutated(file: str, number: int | None = None) -> tuple[ast.Module, Mutator]:
    """Return a file's syntax tree with one mutation (default: none), and its mutator."""
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    mutator = KeywordsLeftAlone(number, all_mutations)
    for node in _functions(tree):
        mutator.visit(node)
    return tree, mutator


def _functions(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    """Yield the functions of a module and the methods of its classes; those within a function are
    parts of it.
    """
    for node in tree.body:
        for part in node.body if isinstance(node, ast.ClassDef) else [node]:
            if isinstance(part, ast.FunctionDef):
                yield part


def mutants_of(room: str) -> list[PythonMutant]:
    """Return every mutant of a room."""
    mutants = []
    for path in sorted((ROOT / room).rglob("*.py")):
        if path.name not in LEFT_OUT:
            file = str(path.relative_to(ROOT))
            lines = path.read_text(encoding="utf-8").splitlines()
            for number, (line, what) in enumerate(_mutated(file)[1].found):
                mutants.append(
                    PythonMutant(room, file, number, line, lines[line - 1].strip(), what)
                )
    return mutants


def excuses() -> list[PythonExcuse]:
    """Return the excuses of the table."""
    table = tomllib.loads(EXCUSES.read_text(encoding="utf-8"))
    return [PythonExcuse(**excuse) for excuse in table.get("excuse", [])]


def excuse_of(mutant: PythonMutant, known: list[PythonExcuse]) -> PythonExcuse | None:
    """Return the excuse of a mutant that is known to be equivalent."""
    for excuse in known:
        if (excuse.file, excuse.code, excuse.what) == (mutant.file, mutant.code, mutant.what):
            return excuse
    return None


def source_of(mutant: PythonMutant) -> str:
    """Return the file with the mutation."""
    tree, _ = _mutated(mutant.file, mutant.number)
    return ast.unparse(ast.fix_missing_locations(tree))


def sample_of(room: str, number: int, seed: int) -> list[PythonMutant]:
    """Return so many mutants of a room, the same for a seed."""
    mutants = mutants_of(room)
    rng = np.random.default_rng([seed, *room.encode()])
    chosen = rng.choice(len(mutants), min(number, len(mutants)), replace=False)
    return [mutants[k] for k in sorted(chosen.tolist())]


def files_of(room: str, file: str = "") -> list[str]:
    """Return the files of tests of a room and its users. For a mutated file, those that have its
    name come first, and then those that import it.
    """
    paths: list[Path] = []
    for name in ROOMS[room]:
        path = ROOT / name
        paths += sorted(path.rglob("test_*.py")) if path.is_dir() else [path]
    stem = Path(file).stem
    module = re.compile(rf"\b{stem} import |import {stem}\b")

    def far(path: Path) -> tuple[bool, bool]:
        imports = bool(file and module.search(path.read_text(encoding="utf-8")))
        return path.stem != f"test_{stem}", not imports

    return [str(path.relative_to(ROOT)) for path in sorted(paths, key=far)]


def _own_test(mutant: PythonMutant) -> str:
    """Return the name of the file of tests that has the name of the mutated file."""
    return f"test_{Path(mutant.file).stem}.py"


def tests_of(mutant: PythonMutant, lines: LineMap) -> list[int]:
    """Return the tests that run a mutant's line, those to play first at the beginning: those of
    the file's own name, the quick ones, one of each file by turns.
    """
    of_file: dict[str, list[int]] = defaultdict(list)
    for number in sorted(lines.of(mutant.file, mutant.line), key=lines.seconds.__getitem__):
        of_file[lines.tests[number].partition("::")[0]].append(number)
    files = sorted(of_file, key=lambda file: (Path(file).name != _own_test(mutant), file))
    turns = zip_longest(*(of_file[file] for file in files))
    return [number for turn in turns for number in turn if number is not None]


def batches_of(mutant: PythonMutant, lines: LineMap) -> list[tuple[list[str], float]]:
    """Return the calls of pytest that judge a mutant: names of tests or files, and the seconds
    that they take together without mutation (0: not known).
    """
    numbers = tests_of(mutant, lines)
    if not numbers:
        return [(files_of(mutant.room, mutant.file), 0.0)]
    batches: list[tuple[list[str], float]] = []
    left = numbers
    for longest_s in (FIRST_S, TOGETHER_S):
        chosen, behind, sum_s = [], [], 0.0
        for number in left:
            fits = sum_s + lines.seconds[number] <= longest_s
            (chosen if fits else behind).append(number)
            sum_s += lines.seconds[number] if fits else 0.0
        if chosen:
            batches.append(([lines.tests[number] for number in chosen], sum_s))
        left = behind
    # The map knows only the first test that needs what is kept, and no test that is newer.
    own = [file for file in files_of(mutant.room) if Path(file).name == _own_test(mutant)]
    return [*batches, *(([file], 0.0) for file in own)]


def first_failure(tests: Sequence[str], folder: Path, seconds: float | None = None) -> str:
    """Return the first of the tests, or of files of them, that fails in a copy of the sources, ''
    if all pass. If they take longer than `seconds`, that is `TIME`.
    """
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(folder / "src"), str(folder)]),
        "PYTHONWARNINGS": "ignore",
        "COINCID_BUILD": str(build_root() / "mutants"),
    }
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    command += ["-p", "no:randomly"]
    try:
        with program(
            [*command, *tests],
            cwd=folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            encoding="utf-8",
            errors="replace",
        ) as running:
            told, _ = running.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        return TIME
    if running.returncode in (0, NO_TESTS):
        return ""
    failed = FAILED.search(told)
    return failed["name"] if failed else tests[0]


class Copy:
    """A copy of the sources, in which one mutant after the other is played."""

    def __init__(self, folder: Path):
        self.folder = folder
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(ROOT, folder, symlinks=True, ignore=LARGE)
        self._seconds: dict[tuple[str, ...], float] = {}

    def _alone_s(self, tests: Sequence[str]) -> float:
        """Return the time that tests take without mutation. Raises `SystemExit` if one fails."""
        key = tuple(sorted(tests))
        if key not in self._seconds:
            began = time.monotonic()
            if first_failure(tests, self.folder):
                raise SystemExit(f"{' '.join(tests)}: fails without mutation")
            self._seconds[key] = time.monotonic() - began
        return self._seconds[key]

    def killer(self, mutant: PythonMutant, lines: LineMap) -> str:
        """Return the first of the tests that notice a mutant, '' if none does."""
        for tests, known_s in batches_of(mutant, lines):
            failed = self._failure(mutant, tests, known_s or self._alone_s(tests))
            if failed == TIME:  # also on a machine that is slower now
                failed = self._failure(mutant, tests, self._alone_s(tests))
            elif failed:
                self._alone_s([failed])
            if failed:
                return failed
        return ""

    def _failure(self, mutant: PythonMutant, tests: Sequence[str], alone_s: float) -> str:
        """Return the first of the tests that fails with a mutant, as `first_failure` does."""
        mutated = self.folder / mutant.file
        original, stat = mutated.read_bytes(), mutated.stat()
        mutated.write_text(source_of(mutant), encoding="utf-8")
        try:
            return first_failure(tests, self.folder, SLACK_S + SLOWER * alone_s)
        finally:
            mutated.write_bytes(original)
            os.utime(mutated, ns=(stat.st_atime_ns, stat.st_mtime_ns))


class Fates:
    """The fates of earlier runs, in a file. Each is kept as soon as it is known."""

    def __init__(self, path: Path):
        self.path = path
        self._by_key: dict[str, str] = {}
        if path.exists():
            self._by_key = json.loads(path.read_text(encoding="utf-8"))

    def get(self, key: str) -> str | None:
        """Return who killed a mutant ('' = nobody); None if it has not been tried."""
        return self._by_key.get(key)

    def keep(self, key: str, by: str) -> None:
        """Write down who killed a mutant."""
        self._by_key[key] = by
        self.path.parent.mkdir(parents=True, exist_ok=True)
        beside = self.path.with_suffix(".new")
        beside.write_text(json.dumps(self._by_key, indent=1), encoding="utf-8")
        beside.replace(self.path)


def key_of(mutant: PythonMutant, lines: LineMap) -> str:
    """Return the key of a mutant, which changes with its file and with the names of its tests."""
    digest = sha256((ROOT / mutant.file).read_bytes())
    for tests, _ in batches_of(mutant, lines):
        digest.update("\n".join(tests).encode())
    return f"{mutant.file}:{mutant.number}:{digest.hexdigest()[:16]}"


def judge(mutants: list[PythonMutant], fates: Fates, lines: LineMap) -> list[Fate]:
    """Return the fates of mutants. Raises `SystemExit` if a test fails without them."""
    found = []
    excused = excuses()
    known = {}
    for mutant in mutants:
        excuse = excuse_of(mutant, excused)
        if excuse is None:
            known[key_of(mutant, lines)] = mutant
        else:
            found.append(Fate(mutant.room, str(mutant), f"{EQUAL}: {excuse.reason}"))
    _play({key: mutant for key, mutant in known.items() if fates.get(key) is None}, fates, lines)
    for key, mutant in known.items():
        found.append(Fate(mutant.room, str(mutant), fates.get(key) or ""))
    return found


def _play(mutants: dict[str, PythonMutant], fates: Fates, lines: LineMap) -> None:
    """Judge mutants in copies of the sources, and keep the fate of each under its key."""
    if not mutants:
        return
    # Always in the same folders, of which Numba knows the code that it has compiled.
    folder = build_root() / "mutants"
    folder.mkdir(parents=True, exist_ok=True)
    copies: SimpleQueue[Copy] = SimpleQueue()
    left = len(mutants)

    def play(key: str, mutant: PythonMutant) -> None:
        nonlocal left
        sources = copies.get()
        try:
            by = sources.killer(mutant, lines)
        finally:
            copies.put(sources)
        with lock:
            left -= 1
            fates.keep(key, by)
            print(f"{left} left. {by or 'SURVIVED'}: {mutant}", flush=True)

    lock = Lock()
    with FileLock(folder / "sources.lock"):
        for number in range(JOBS):
            copies.put(Copy(folder / f"sources{number}"))
        with ThreadPoolExecutor(JOBS) as pool:
            for done in [pool.submit(play, *item) for item in mutants.items()]:
                done.result()


def report(fates: list[Fate], seed: int) -> str:
    """Return the report as Markdown: the rate of every room, the survivors, and the excuses."""
    lines = [f"# Mutants of Python, seed {seed}", ""]
    lines += ["| room | mutants | killed | equivalent | survivors | rate |"]
    lines += ["| --- | ---: | ---: | ---: | ---: | ---: |"]
    for room in ROOMS:
        total = count([fate for fate in fates if fate.where == room])
        if total.all:
            rate = "" if total.rate is None else f"{total.rate:.0%}"
            numbers = f"{total.all} | {total.killed} | {total.equal} | {total.survived}"
            lines.append(f"| `{room}` | {numbers} | {rate} |")
    lines += ["", "## Survivors", ""]
    lines += [f"* {fate.what}" for fate in fates if fate.survived]
    lines += ["", "## Equivalent", ""]
    lines += [f"* {fate.what} ({fate.by})" for fate in fates if fate.is_equal]
    return "\n".join([*lines, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description="Mutation test of the rooms in Python")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--number", type=int, default=NUMBER, help="mutants of each room")
    parser.add_argument("rooms", nargs="*", metavar="ROOM", help=f"of {', '.join(ROOMS)}")
    options = parser.parse_args()
    unknown = [room for room in options.rooms if room not in ROOMS]
    if unknown:
        parser.error(f"no room {unknown[0]}: must be one of {', '.join(ROOMS)}")
    folder = build_root() / "mutation"
    path = build_root() / line_map.MAP
    if not path.exists():
        line_map.main([])
    chosen = [
        mutant
        for room in options.rooms or ROOMS
        for mutant in sample_of(room, options.number, options.seed)
    ]
    fates = judge(chosen, Fates(folder / "python.json"), line_map.load(path))
    text = report(fates, options.seed)
    (folder / "python.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
