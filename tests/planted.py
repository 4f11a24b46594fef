# SPDX-License-Identifier: Apache-2.0
"""Typical human mistakes (`planted.toml`), planted one at a time: each must be caught by the
regression or by a proof.

`python -m tests.planted [--all] [NAMES]` plants each bug in a copy of the sources and runs the
proofs and tests that must notice it, all of them part of `make test` or `make formal`, until one
does; with `--all`, every one must. All of them must pass without a bug first, since a check that
always fails notices everything. `test_planted.py` keeps the list in step with the sources.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from queue import Queue

from attrs import frozen

ROOT = Path(__file__).parents[1]
WORKERS = os.cpu_count() or 1
FAILED = 1  # exit code of pytest and of `coincid formal` when something does not hold
PACKAGES = (
    "model",
    "tools",
    "host",
    "hdl",
    "slices",
    "tb",
    "formal",
    "flow",
    "lab",
    "study",
    "board",
    "docs",
    "examples",
    "scripts",
)


@frozen
class Bug:
    """A planted bug, as in `planted.toml`; tests: arguments of pytest."""

    name: str
    file: str
    old: str
    new: str
    proofs: list[str]
    tests: list[list[str]]


def _bugs() -> list[Bug]:
    table = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    return [
        Bug(**bug | {"tests": [table["tests"][name] for name in bug["tests"]]})
        for bug in table["bug"]
    ]


BUGS = _bugs()


def copy_of_sources(folder: Path) -> dict[str, str]:
    """Copy packages and tests, and return the environment in which Python finds them before the
    installed ones.
    """
    for name in ("src", "tests", *PACKAGES):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(
            ROOT / name, folder / name, symlinks=True, ignore=ignored, dirs_exist_ok=True
        )
    for path in ROOT.iterdir():  # tests read the Makefile and pages of the root
        if path.is_file() and not path.name.startswith("."):
            shutil.copy(path, folder / path.name)
    search = os.pathsep.join([str(folder / "src"), str(folder)])
    return os.environ | {"PYTHONPATH": search, "COINCID_BUILD": str(folder / "build")}


def plant(bug: Bug, folder: Path) -> None:
    """Put a bug into a copy of the sources."""
    path = folder / bug.file
    text = path.read_text(encoding="utf-8")
    assert text.count(bug.old) == 1, (
        f"{bug.name}: {bug.file} has {text.count(bug.old)} times {bug.old!r}"
    )
    path.write_text(text.replace(bug.old, bug.new), encoding="utf-8")


def checks_of(bug: Bug) -> dict[str, list[str]]:
    """Return name -> arguments of Python for the proofs and tests that must notice a bug."""
    checks = {f"proof {name}": ["-m", "coincid", "formal", name] for name in bug.proofs}
    for test in bug.tests:
        checks[" ".join(test)] = ["-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *test]
    return checks


def exit_code(check: list[str], folder: Path, environment: dict[str, str]) -> int:
    """Run a check in a copy of the sources."""
    done = subprocess.run(
        [sys.executable, *check], cwd=folder, env=environment, capture_output=True, check=False
    )
    return done.returncode


def notices(code: int) -> bool:
    """Return whether a check that ends with an exit code has noticed a bug: it failed, or a signal
    ended it, as with a wrong address in compiled code.
    """
    return code == FAILED or code < 0


class Workshop:
    """Places for copies of the sources, as many as there are workers.

    A place keeps its path, and the compiled kernels of all copies that stood there: Numba finds
    them by path and content, so only what a bug changes is compiled again.
    """

    def __init__(self, root: Path) -> None:
        self._free: Queue[Path] = Queue()
        for number in range(WORKERS):
            self._free.put(root / str(number))

    @contextmanager
    def copy_with(self, bug: Bug | None) -> Iterator[tuple[Path, dict[str, str]]]:
        """Give a copy of the sources with a bug (None: without one), and its environment."""
        place = self._free.get()
        folder, builds, kernels = place / "sources", place / "builds", place / "kernels"
        for stale in (folder, builds):
            shutil.rmtree(stale, ignore_errors=True)
        kernels.mkdir(parents=True, exist_ok=True)
        builds.mkdir()
        (builds / "numba").symlink_to(kernels)
        environment = copy_of_sources(folder) | {"COINCID_BUILD": str(builds)}
        if bug:
            plant(bug, folder)
        try:
            yield folder, environment
        finally:
            self._free.put(place)


def failing_without_a_bug(checks: dict[str, list[str]], workshop: Workshop) -> list[str]:
    """Return the names of checks that do not pass in an unplanted copy: they prove nothing."""
    with (
        workshop.copy_with(None) as (folder, environment),
        ThreadPoolExecutor(WORKERS) as pool,
    ):
        codes = pool.map(lambda check: exit_code(check, folder, environment), checks.values())
        return [name for name, code in zip(checks, codes, strict=True) if code != 0]


def caught_by(bug: Bug, thorough: bool, workshop: Workshop) -> dict[str, bool]:
    """Return proof or test -> whether it noticed a bug; up to the first that does, unless
    `thorough`.
    """
    result: dict[str, bool] = {}
    with workshop.copy_with(bug) as (folder, environment):
        for name, check in checks_of(bug).items():
            result[name] = notices(exit_code(check, folder, environment))
            if result[name] and not thorough:
                break
    return result


def main() -> None:
    thorough = "--all" in sys.argv
    names = [name for name in sys.argv[1:] if name != "--all"]
    bugs = [bug for bug in BUGS if not names or bug.name in names]
    with tempfile.TemporaryDirectory(prefix="coincid-planted-") as scratch:
        caught = judge(bugs, thorough, Workshop(Path(scratch)))
    print(f"{caught} of {len(bugs)} planted bugs are caught")
    sys.exit(caught < len(bugs))


def judge(bugs: list[Bug], thorough: bool, workshop: Workshop) -> int:
    """Print what catches each bug, and return how many are caught."""
    checks: dict[str, list[str]] = {}
    for bug in bugs:
        checks |= checks_of(bug)
    print(f"{len(checks)} proofs and tests must pass without a bug", flush=True)
    worthless = failing_without_a_bug(checks, workshop)
    if worthless:
        sys.exit("These fail without a bug, so they show nothing: " + "; ".join(worthless))

    def run(bug: Bug) -> bool:
        result = caught_by(bug, thorough, workshop)
        verdicts = [
            f"{what}: {'caught' if caught else 'MISSED'}" for what, caught in result.items()
        ]
        print(f"{bug.name:26}", ", ".join(verdicts), flush=True)
        return all(result.values()) if thorough else any(result.values())

    with ThreadPoolExecutor(WORKERS) as pool:
        return sum(pool.map(run, bugs))


if __name__ == "__main__":
    main()
