# SPDX-License-Identifier: Apache-2.0
"""Which tests run which line of the Python code: a map for mutants (`python_mutants.py`).

`python -m tests.line_map [PYTEST_ARGS ...]` plays the regression under Coverage.py, and writes
build/mutation/lines.json. That takes twice as long as the regression. Commands that a test starts
count as part of it. What a fixture or a cache keeps is counted for the first test that needs it.

As a plugin of pytest (`-p tests.line_map`) it tells Coverage.py which test runs, and measures how
long each test takes.

Coverage.py is imported where it is needed, because only `scripts/setup mutants` installs it.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import pytest
from attrs import frozen

from coincid.model.shared.files import whole_file
from coincid.tb.toolchain import build_root

from .needs import missing
from .planted import ROOT

MAP = Path("mutation") / "lines.json"  # in the build folder
CONTEXT = "COINCID_TEST"  # environment: the test that runs, for the commands that it starts
TIMES = "COINCID_TEST_TIMES"  # environment: the folder in which processes leave their times
SETTINGS = """\
[run]
parallel = True
data_file = {folder}/lines
context = ${{{context}-}}
include = {root}/*
omit = {root}/.venv/*, {root}/build/*, {root}/tests/*
disable_warnings = no-data-collected, module-not-measured, module-not-imported
"""
_seconds: dict[str, float] = {}


@frozen
class LineMap:
    """Which tests run a line. tests: their names; seconds: how long each takes, under Coverage.py;
    lines: file -> line -> numbers of tests.
    """

    tests: list[str]
    seconds: list[float]
    lines: dict[str, dict[int, list[int]]]

    def of(self, file: str, line: int) -> list[int]:
        """Return the tests that run a line, [] if none does."""
        return self.lines.get(file, {}).get(line, [])


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None):
    import coverage

    running = coverage.Coverage.current()
    os.environ[CONTEXT] = item.nodeid
    if running:
        running.switch_context(item.nodeid)
    began = time.monotonic()
    try:
        return (yield)
    finally:
        _seconds[item.nodeid] = round(time.monotonic() - began, 2)
        del os.environ[CONTEXT]
        if running:
            running.switch_context("")


def pytest_sessionfinish() -> None:
    if TIMES in os.environ:
        path = Path(os.environ[TIMES]) / f"{os.getpid()}.json"
        path.write_text(json.dumps(_seconds), encoding="utf-8")


def record(folder: Path, arguments: list[str]) -> None:
    """Play the regression, and leave its data in a folder. A test that fails is only told: some
    compare what they start with what they know, and see Coverage.py there.
    """
    settings = folder / "settings.ini"
    settings.write_text(
        SETTINGS.format(folder=folder, context=CONTEXT, root=ROOT), encoding="utf-8"
    )
    environment = os.environ | {
        "COVERAGE_PROCESS_START": str(settings),
        "COVERAGE_CORE": "ctrace",  # the other one of Coverage.py knows no tests
        TIMES: str(folder),
    }
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.line_map"]
    subprocess.run([*command, *arguments], cwd=ROOT, env=environment, check=False)


def collect(folder: Path) -> LineMap:
    """Return the map from the data that `record` has left in a folder."""
    import coverage

    seconds: dict[str, float] = {}
    for path in sorted(folder.glob("*.json")):
        seconds |= json.loads(path.read_text(encoding="utf-8"))
    tests = sorted(seconds)
    numbers = {test: number for number, test in enumerate(tests)}
    found: dict[str, dict[int, set[int]]] = defaultdict(lambda: defaultdict(set))
    for path in sorted(folder.glob("lines.*")):
        data = coverage.CoverageData(str(path))
        data.read()
        for file in data.measured_files():
            lines = found[str(Path(file).relative_to(ROOT))]
            for line, contexts in data.contexts_by_lineno(file).items():
                lines[line] |= {numbers[name] for name in contexts if name in numbers}
    sorted_lines = {
        file: {line: sorted(ran) for line, ran in sorted(lines.items()) if ran}
        for file, lines in sorted(found.items())
    }
    return LineMap(tests, [seconds[test] for test in tests], sorted_lines)


def save(lines: LineMap, path: Path) -> None:
    """Write a map."""
    told = {"tests": lines.tests, "seconds": lines.seconds, "lines": lines.lines}
    with whole_file(path, "w") as file:
        json.dump(told, file)


def load(path: Path) -> LineMap:
    """Return a map that `save` has written."""
    told = json.loads(path.read_text(encoding="utf-8"))
    lines = {
        file: {int(line): ran for line, ran in of_file.items()}
        for file, of_file in told["lines"].items()
    }
    return LineMap(told["tests"], told["seconds"], lines)


def main(arguments: list[str]) -> None:
    """Make the map. Raises `SystemExit` without Coverage.py."""
    lacking = missing("mutants")
    if lacking:
        sys.exit(lacking)
    with tempfile.TemporaryDirectory(prefix="coincid-lines-") as folder:
        record(Path(folder), arguments or ["-n", "auto"])
        lines = collect(Path(folder))
    path = build_root() / MAP
    save(lines, path)
    print(f"{len(lines.tests)} tests, {len(lines.lines)} files: {path}")


if __name__ == "__main__":
    main(sys.argv[1:])
