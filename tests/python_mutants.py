# SPDX-License-Identifier: Apache-2.0
"""Mutants of the rooms in Python: a sample of each room, judged by its tests and those of its users.

`python -m tests.python_mutants [--seed N] [--number N] [ROOM ...]` writes
build/mutation/python.md. The golden model has more of them (`golden_mutants.py`), so it is no room
here. A run that was stopped continues: fates are kept in build/mutation/python.json, as long as
neither the mutated file nor a test of the room has changed.

A mutant that no test can notice has an excuse in `python_excuses.toml`. It is not judged.
"""

import argparse
import ast
import json
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from attrs import frozen
from filelock import FileLock

from coincid.tb.toolchain import build_root

from .fates import EQUAL, Fate, count
from .golden_mutants import Mutator
from .planted import ROOT

# Room -> its tests and those of its users, the quickest first: the first that fails decides, and
# those behind it are not played.
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
SLACK_S = 60.0  # a mutant may take so much longer than the room without mutation,
SLOWER = 3  # and so many times as long
NO_TESTS = pytest.ExitCode.NO_TESTS_COLLECTED  # all tests of a file are `long`
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
    """A mutant of a file. number: of the mutation; line, code, what: where it is and what it does."""

    file: str
    number: int
    line: int
    code: str
    what: str

    def __str__(self) -> str:
        return f"{self.file}, line {self.line}: {self.what}"


def _mutated(file: str, number: int | None = None) -> tuple[ast.Module, Mutator]:
    """Return a file's syntax tree with one mutation (default: none), and its mutator."""
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    mutator = Mutator(number)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            mutator.visit(node)
    return tree, mutator


def mutants_of(room: str) -> list[PythonMutant]:
    """Return every mutant of a room."""
    mutants = []
    for path in sorted((ROOT / room).glob("*.py")):
        if path.name not in LEFT_OUT:
            file = str(path.relative_to(ROOT))
            lines = path.read_text(encoding="utf-8").splitlines()
            for number, (line, what) in enumerate(_mutated(file)[1].found):
                mutants.append(PythonMutant(file, number, line, lines[line - 1].strip(), what))
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


def passes(test: str, folder: Path, seconds: float | None = None) -> bool:
    """Return whether a file of tests passes in a copy of the sources.

    One that takes longer than `seconds` does not.
    """
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(folder / "src"), str(folder)]),
        "PYTHONWARNINGS": "ignore",
        "COINCID_BUILD": str(build_root() / "mutants"),
    }
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    command += ["-p", "no:randomly"]
    try:
        done = subprocess.run(
            [*command, test],
            cwd=folder,
            env=environment,
            timeout=seconds,
            capture_output=True,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode in (0, NO_TESTS)


class Copy:
    """A copy of the sources, in which one mutant after the other is played."""

    def __init__(self, folder: Path):
        self.folder = folder
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(ROOT, folder, symlinks=True, ignore=LARGE)
        self._seconds: dict[str, float] = {}

    def limit_s(self, test: str) -> float:
        """Return the time that a file of tests may take. Raises `SystemExit` if it fails without
        mutation.
        """
        if test not in self._seconds:
            began = time.monotonic()
            if not passes(test, self.folder):
                raise SystemExit(f"{test} fails without mutation")
            self._seconds[test] = time.monotonic() - began
        return SLACK_S + SLOWER * self._seconds[test]

    def killer(self, mutant: PythonMutant, tests: list[str]) -> str:
        """Return the first file of tests that notices a mutant, '' if there is none."""
        mutated = self.folder / mutant.file
        original, stat = mutated.read_bytes(), mutated.stat()
        for test in tests:
            limit_s = self.limit_s(test)
            mutated.write_text(source_of(mutant), encoding="utf-8")
            passed = passes(test, self.folder, limit_s)
            mutated.write_bytes(original)
            os.utime(mutated, ns=(stat.st_atime_ns, stat.st_mtime_ns))
            if not passed:
                return test
        return ""


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


def key_of(room: str, mutant: PythonMutant) -> str:
    """Return the key of a mutant, which changes with its file and with the tests of its room."""
    digest = sha256((ROOT / mutant.file).read_bytes())
    for name in ROOMS[room]:
        path = ROOT / name
        for test in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(test.read_bytes())
    return f"{mutant.file}:{mutant.number}:{digest.hexdigest()[:16]}"


def judge_room(room: str, mutants: list[PythonMutant], fates: Fates) -> list[Fate]:
    """Return the fates of a room's mutants. Raises `SystemExit` if its tests fail without them."""
    found = []
    excused = excuses()
    known = {}
    for mutant in mutants:
        excuse = excuse_of(mutant, excused)
        if excuse is None:
            known[key_of(room, mutant)] = mutant
        else:
            found.append(Fate(room, str(mutant), f"{EQUAL}: {excuse.reason}"))
    if any(fates.get(key) is None for key in known):
        # Always in the same folder, of which Numba knows the code that it has compiled.
        folder = build_root() / "mutants" / "sources"
        folder.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(f"{folder}.lock"):
            copy = Copy(folder)
            for key, mutant in known.items():
                if fates.get(key) is None:
                    fates.keep(key, copy.killer(mutant, files_of(room, mutant.file)))
                    print(f"{room}: {fates.get(key) or 'SURVIVED'}: {mutant}", flush=True)
    for key, mutant in known.items():
        found.append(Fate(room, str(mutant), fates.get(key) or ""))
    return found


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
    kept = Fates(folder / "python.json")
    fates = []
    for number, room in enumerate(options.rooms or ROOMS, 1):
        mutants = sample_of(room, options.number, options.seed)
        print(f"{room} ({number} of {len(options.rooms or ROOMS)}): {len(mutants)} mutants")
        fates += judge_room(room, mutants, kept)
    text = report(fates, options.seed)
    (folder / "python.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
