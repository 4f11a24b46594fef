# SPDX-License-Identifier: Apache-2.0
"""What programs write into the pages: regions between markers that name the command and carry a
stamp.

    <!-- begin surfaces: python -m docs.studies.surfaces; stamp 0123456789ab -->
    what the command makes
    <!-- end surfaces -->

`docs/pages.toml` lists the programs. A stamp is a digest of everything that the result depends
on (`dependencies.py`), or `unknown`. A region is stale if its stamp is not the digest of today's
sources. Programs write their regions with `put`.
"""

import os
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from attrs import Factory, field, frozen

from ..model.shared.errors import InputError
from ..model.shared.files import whole_file
from ..model.shared.folders import checkout
from .dependencies import Closure, Sources

TABLE = Path("docs") / "pages.toml"
UNKNOWN = "unknown"
# write regions, and change no number
WRITERS = ("coincid.tools.pages", "coincid.tools.dependencies")
FOLDER = "COINCID_PAGES"  # environment: the folder whose pages are written, instead of the checkout
GROUPS = "without"  # key of the table with lists of modules, by name
_BEGIN = re.compile(
    r"^<!-- begin (?P<name>[^:\n]+): (?P<command>.+); stamp (?P<stamp>\w+) -->$", re.MULTILINE
)


@frozen
class Region:
    """A region of a page. text: between the markers, without the empty lines beside them."""

    page: str
    name: str
    command: str
    stamp: str
    text: str


@frozen
class Program:
    """A program that makes regions.

    run: MODULE:FUNCTION, without arguments. writes: names of regions by page. pictures: files
    that its regions show. data: files besides those that its modules name. without: modules that
    it imports inside functions which it does not call; `make pages` checks this. needs: what
    `scripts/setup` must install. cheap: takes some seconds, so tests run it.
    """

    name: str
    command: str
    run: str
    writes: dict[str, list[str]]
    pictures: list[str] = Factory(list)
    data: list[str] = Factory(list)
    without: list[str] = Factory(list)
    needs: list[str] = Factory(list)
    cheap: bool = False
    minutes: float = 0.0

    @property
    def module(self) -> str:
        """The module that is run."""
        return self.run.partition(":")[0]


@frozen(eq=False)
class Pages:
    """The pages of a checkout and their programs. root: the folder of pyproject.toml. cache: as
    of `Sources`.
    """

    root: Path
    cache: Path | None = None
    programs: dict[str, Program] = field(init=False)
    sources: Sources = field(init=False)

    @programs.default
    def _programs(self) -> dict[str, Program]:
        document = tomllib.loads((self.root / TABLE).read_text(encoding="utf-8"))
        groups: dict[str, list[str]] = document.pop(GROUPS, {})
        programs = {}
        for name, table in document.items():
            told: dict[str, Any] = dict(table)
            told["without"] = [
                module for group in told.get("without", []) for module in groups.get(group, [group])
            ]
            try:
                programs[name] = Program(name=name, **told)
            except TypeError as error:
                raise InputError(f"{TABLE}: {name}: {error}") from None
        return programs

    @sources.default
    def _sources(self) -> Sources:
        return Sources(self.root, self.cache)

    def closure(self, program: Program) -> Closure:
        """Return what a program depends on, except for the data files that only the table names."""
        return self.sources.closure(program.module, without=(*program.without, *WRITERS))

    def stamp(self, program: Program) -> str:
        """Return the digest of everything that a program's result depends on."""
        files = [self.root / name for name in program.data]
        return self.sources.digest(
            self.closure(program), program.command, program.run, *program.data, *files
        )

    def stale(self) -> dict[str, list[Region]]:
        """Return the regions whose stamps are not those of today's sources, by program."""
        found = {}
        for name, program in self.programs.items():
            stamp = self.stamp(program)
            old = [region for region in self.regions_of(program) if region.stamp != stamp]
            if old:
                found[name] = old
        return found

    def regions_of(self, program: Program) -> list[Region]:
        """Return the regions that a program writes. Raises `InputError` if a page lacks one."""
        return [self.region(page, name) for page, names in program.writes.items() for name in names]

    def region(self, page: str, name: str) -> Region:
        """Return a region of a page. Raises `InputError` if the page has none of this name."""
        for region in regions(page, (self.root / page).read_text(encoding="utf-8")):
            if region.name == name:
                return region
        raise InputError(f"{page}: has no region '{name}', which {TABLE} lists")

    def writer(self, page: str, name: str) -> Program:
        """Return the program of a region. Raises `InputError` if the table has none."""
        for program in self.programs.values():
            if name in program.writes.get(page, ()):
                return program
        raise InputError(f"{TABLE}: no program writes '{name}' into {page}")


def regions(page: str, text: str) -> Iterator[Region]:
    """Yield the regions in the text of a page. Raises `InputError` for a marker without its
    partner.
    """
    begun = 0
    for begin in _BEGIN.finditer(text):
        name = begin["name"]
        end = text.find(f"\n{_end(name)}\n", begin.end())
        if begin.start() < begun or end < 0:
            raise InputError(f"{page}: region '{name}' does not end before the next one begins")
        begun = end
        yield Region(
            page, name, begin["command"], begin["stamp"], text[begin.end() : end].strip("\n")
        )


def with_region(
    page: str, text: str, name: str, content: str | None, command: str, stamp: str
) -> str:
    """Return the text of a page with another content of a region (None: the same), command and
    stamp. Raises `InputError`.
    """
    begin = re.search(rf"^<!-- begin {re.escape(name)}: .+ -->$", text, re.MULTILINE)
    end = text.find(f"\n{_end(name)}\n", begin.end()) if begin else -1
    if begin is None or end < 0:
        raise InputError(f"{page}: has no region '{name}'")
    inner = text[begin.end() : end].strip("\n") if content is None else content.strip("\n")
    return f"{text[: begin.start()]}<!-- begin {name}: {command}; stamp {stamp} -->\n\n{inner}\n{text[end:]}"


def _end(name: str) -> str:
    return f"<!-- end {name} -->"


def put(page: str, name: str, content: str | None = None) -> None:
    """Write a region of a page, with the stamp of today's sources; the page appears whole.

    page: such as "docs/depth.md". content: Markdown; None: only the picture of this region was
    made again. Raises `InputError` without a checkout, and for a region that the page or the
    table lacks.
    """
    pages = _pages()
    program = pages.writer(page, name)
    path = folder() / page
    text = with_region(
        page, path.read_text(encoding="utf-8"), name, content, program.command, _stamp(program.name)
    )
    with whole_file(path, "w") as file:
        file.write(text)


def put_page(page: str, name: str, text: str, out: Path | None = None) -> None:
    """Write a text whose first line is the title of the page: below the title of `page`, or with
    it to the file `out`.
    """
    if out is None:
        put(page, name, text.partition("\n")[2])
        return
    with whole_file(out, "w") as file:
        file.write(text)


def counted(done: int, total: int) -> None:
    """Tell the progress of a program: a tenth of its tasks is done."""
    if total >= 10 and done * 10 // total > (done - 1) * 10 // total:
        print(f"  {done} of {total}", flush=True)


def picture(name: str) -> Path:
    """Return the path of a picture, such as "docs/images/depth.png". Raises `InputError` without
    a checkout.
    """
    return folder() / name


def folder() -> Path:
    """Return the folder whose pages are written. Raises `InputError` without a checkout."""
    if chosen := os.environ.get(FOLDER):
        return Path(chosen)
    return _root()


def _root() -> Path:
    found = checkout()
    if found is None:
        raise InputError(
            "docs/: pages and their pictures are written in a checkout of the project only"
        )
    return found


@cache
def _pages() -> Pages:
    return Pages(_root())


@cache
def _stamp(program: str) -> str:
    """Return the stamp of a program, as the sources were when this process first asked."""
    return _pages().stamp(_pages().programs[program])
