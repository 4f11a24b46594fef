# SPDX-License-Identifier: Apache-2.0
"""Makes the tables and pictures of the pages again, lists those that are older than the sources,
and checks a release.

`make pages` runs this program. `docs/pages.toml` lists the programs that write the pages;
`tools/pages.py` explains the markers and the stamps. A program that is done has written its
regions with their new stamps, so an interrupted run continues where it stopped if only what is
stale is made. Each program runs in its own process, which records the files that it reads. If
one of them is not in what the stamp covers, the run fails.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path

from coincid.model.shared.errors import InputError
from coincid.model.shared.folders import build_root
from coincid.tools.pages import WRITERS, Pages, Program

ROOT = Path(__file__).parents[1]
RECORDER = Path(__file__).with_name("recorder")
# Read by every process, and part of no result: the package's front, and the writers of pages.
ALWAYS = {"pyproject.toml", "docs/pages.toml", "docs/recorder/sitecustomize.py"}

NEEDS = ("rtl", "flow", "explore", "sweep")  # of `scripts/setup`, for every program


def all_pages(root: Path = ROOT) -> Pages:
    """Return the pages of a checkout."""
    return Pages(root, build_root() / "pages" / "facts.json")


def chosen(pages: Pages, names: Sequence[str]) -> list[Program]:
    """Return the programs with these names, or of the pages with these names; all if there are
    none. Raises `InputError`.
    """
    if not names:
        return list(pages.programs.values())
    found = []
    for name in names:
        of_name = [
            program
            for program in pages.programs.values()
            if name == program.name
            or name in {Path(page).stem for page in program.writes} | {*program.writes}
        ]
        if not of_name:
            stems = {
                Path(page).stem for program in pages.programs.values() for page in program.writes
            }
            raise InputError(
                f"NAMES: {name}: must be of {', '.join(sorted({*pages.programs, *stems}))}"
            )
        found += [program for program in of_name if program not in found]
    return found


def list_stale(pages: Pages) -> list[str]:
    """Return a line for each program with stale regions: its name, command, duration, and the
    regions by page.
    """
    lines = []
    for name, regions in pages.stale().items():
        program = pages.programs[name]
        by_page: dict[str, list[str]] = {}
        for region in regions:
            by_page.setdefault(region.page, []).append(region.name)
        places = "; ".join(f"{page} ({', '.join(names)})" for page, names in by_page.items())
        lines.append(f"{name:20} {_duration(program):>8}  {places}")
    return lines


def _duration(program: Program) -> str:
    return "seconds" if program.cheap else f"{program.minutes:g} min"


def make(pages: Pages, program: Program) -> None:
    """Run a program, which writes its regions, and check what it read. Raises `InputError`."""
    subprocess.run([ROOT / "scripts" / "setup", *NEEDS, *program.needs], check=True)
    with tempfile.TemporaryDirectory(prefix="coincid-") as folder:
        read = Path(folder) / "read"
        search = os.pathsep.join(filter(None, [str(RECORDER), os.environ.get("PYTHONPATH")]))
        module, _, function = program.run.partition(":")
        code = f"from {module} import {function}; {function}()"
        done = subprocess.run(
            [sys.executable, "-c", f"if __name__ == '__main__': {code}"],
            cwd=ROOT,
            env=os.environ | {"PYTHONPATH": search, "COINCID_READ": str(read)},
        )
        if done.returncode:
            raise InputError(
                f"{program.name}: {program.command} failed with exit code {done.returncode}"
            )
        outside = undeclared(pages, program, read.read_text(encoding="utf-8").splitlines())
    if outside:
        raise InputError(
            f"{program.name}: reads files that its stamp does not cover: {', '.join(outside)}"
        )


def undeclared(pages: Pages, program: Program, read: Iterable[str]) -> list[str]:
    """Return the files that a program has read and does not depend on. read: paths below the
    root.
    """
    closure = pages.closure(program)
    known = {
        str(pages.sources.modules[module].relative_to(pages.root))
        for module in (*closure.modules, *WRITERS)
    }
    known |= {str(path.relative_to(pages.root)) for path in closure.data}
    known |= {*program.data, *program.writes, *program.pictures, *ALWAYS}
    known |= {str(path.relative_to(pages.root)) for path in pages.root.glob("requirements*.lock")}
    outside = set()
    for name in read:
        compiled = re.fullmatch(r"(.*/)?__pycache__/([^.]+)\.[^/]+", name)
        source = f"{compiled[1] or ''}{compiled[2]}.py" if compiled else name
        if source not in known and not inside_machinery(pages, source):
            outside.add(source)
    return sorted(outside)


def inside_machinery(pages: Pages, name: str) -> bool:
    """Return whether a file is only imported by the writers of pages."""
    own = pages.sources.closure(*WRITERS)
    return name in {
        str(pages.sources.modules[module].relative_to(pages.root)) for module in own.modules
    }


def make_all(pages: Pages, programs: Sequence[Program]) -> None:
    """Make the regions of programs, the cheap ones first, and tell the progress."""
    ordered = sorted(programs, key=lambda program: (not program.cheap, program.minutes))
    for number, program in enumerate(ordered, 1):
        print(
            f"[{number}/{len(ordered)}] {program.name}: {program.command} ({_duration(program)})",
            flush=True,
        )
        began = time.monotonic()
        make(pages, program)
        print(
            f"[{number}/{len(ordered)}] {program.name}: done in {time.monotonic() - began:.0f} s",
            flush=True,
        )


def release_faults(pages: Pages) -> list[str]:
    """Return what stands against a release of the version in pyproject.toml."""
    version = tomllib.loads((pages.root / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "version"
    ]
    faults = [f"stale: {line}" for line in list_stale(pages)]
    if not re.search(
        rf"^## \[{re.escape(version)}\] - \d{{4}}-\d\d-\d\d$",
        (pages.root / "CHANGELOG.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    ):
        faults.append(f"CHANGELOG.md: has no section '## [{version}] - DATE'")
    cited = re.search(
        r"^version: (\S+)$", (pages.root / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE
    )
    if cited is None or cited[1] != version:
        faults.append(
            f"CITATION.cff: version = {cited[1] if cited else 'none'}: must be {version}, as in pyproject.toml"
        )
    return faults


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "names", nargs="*", help="programs of docs/pages.toml or names of pages; default: all"
    )
    parser.add_argument(
        "--stale", action="store_true", help="only list the regions that are older than the sources"
    )
    parser.add_argument(
        "--only-stale", action="store_true", help="make only what is older than the sources"
    )
    parser.add_argument(
        "--release", action="store_true", help="fail if something stands against a release"
    )
    given = parser.parse_args()
    pages = all_pages()
    try:
        if given.release:
            faults = release_faults(pages)
            print("\n".join(faults) or "nothing stands against a release")
            return int(bool(faults))
        programs = chosen(pages, given.names)
        if given.stale or given.only_stale:
            stale = pages.stale()
            programs = [program for program in programs if program.name in stale]
        if given.stale:
            lines = list_stale(pages)
            print("\n".join(lines) or "no page is older than the sources")
        else:
            make_all(pages, programs)
        pages.sources.keep()
    except InputError as error:
        print(f"pages: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
