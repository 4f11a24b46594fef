# SPDX-License-Identifier: Apache-2.0
"""Numbers of the pages: regions and their programs, what makes them stale, what cheap programs
write, and a release.
"""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from attrs import evolve

from coincid.model.shared.errors import InputError
from coincid.tools import pages as writing
from coincid.tools.dependencies import PACKAGE, Sources
from coincid.tools.pages import Pages, regions, with_region

ROOT = Path(__file__).parents[1]
TEXTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "examples" / "README.md"]
BY_HAND = {"blocks.svg", "async_timing.svg"}  # drawings
PAGES = Pages(ROOT, ROOT / "build" / "pages" / "facts.json")
SLOWEST = ("scene", "timing-diagrams", "waveform")  # of the cheap ones
CHEAP = [
    pytest.param(name, marks=[pytest.mark.long] if name in SLOWEST else [])
    for name, program in PAGES.programs.items()
    if program.cheap
]


def driver():
    """Return the program behind `make pages`."""
    spec = importlib.util.spec_from_file_location("docs_pages", ROOT / "docs" / "pages.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def copy_of_sources(folder):
    """Copy what stamps depend on."""
    package = folder / PACKAGE
    package.mkdir(parents=True)
    for path in (ROOT / PACKAGE).iterdir():
        if path.is_dir() and path.name != "__pycache__":
            shutil.copytree(
                ROOT / path.name, folder / path.name, ignore=shutil.ignore_patterns("__pycache__")
            )
            (package / path.name).symlink_to(folder / path.name)
        elif path.is_file():
            shutil.copy(path, package)
    for path in (
        *ROOT.glob("requirements*.lock"),
        *ROOT.glob("*.md"),
        ROOT / "pyproject.toml",
        ROOT / "CITATION.cff",
    ):
        shutil.copy(path, folder)
    shutil.copytree(ROOT / "docs", folder / "docs")
    return folder


@pytest.fixture(scope="module")
def copied(tmp_path_factory):
    for program in PAGES.programs.values():
        PAGES.closure(program)
    PAGES.sources.keep()
    return copy_of_sources(tmp_path_factory.mktemp("sources"))


def pages_of(folder):
    """Return the pages of a copy; modules that did not change are not parsed again."""
    return Pages(folder, PAGES.cache)


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_marker_is_that_of_a_region_of_the_table(path):
    page, text = str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")
    found = {region.name: region for region in regions(page, text)}
    assert len(re.findall(r"^<!-- (begin|end) ", text, re.MULTILINE)) == 2 * len(found)
    listed = {
        name: program
        for program in PAGES.programs.values()
        for name in program.writes.get(page, ())
    }
    assert found.keys() == listed.keys()
    assert {name: region.command for name, region in found.items()} == {
        n: p.command for n, p in listed.items()
    }


def test_every_picture_is_made_by_one_program_and_shown_in_its_regions():
    made = [picture for program in PAGES.programs.values() for picture in program.pictures]
    assert len(made) == len(set(made))
    assert {Path(name).name for name in made} | BY_HAND == {
        path.name for path in (ROOT / "docs" / "images").iterdir()
    }
    shown = {}
    for path in TEXTS:
        page = str(path.relative_to(ROOT))
        outside = path.read_text(encoding="utf-8")
        for region in regions(page, outside):
            for name in re.findall(r"!\[[^\]]*\]\((?:docs/)?images/([^)]+)\)", region.text):
                shown.setdefault(f"docs/images/{name}", set()).add(
                    PAGES.writer(page, region.name).name
                )
            outside = outside.replace(region.text, "")
        assert {*re.findall(r"!\[[^\]]*\]\((?:docs/)?images/([^)]+)\)", outside)} <= BY_HAND, page
    makers = {
        picture: {program.name}
        for program in PAGES.programs.values()
        for picture in program.pictures
    }
    assert shown == {name: maker for name, maker in makers.items() if not name.endswith(".csv")}


def test_modules_of_the_package_and_of_its_rooms_are_known():
    modules = PAGES.sources.modules
    assert modules["coincid"] == ROOT / PACKAGE / "__init__.py"
    assert modules["coincid.cli"] == ROOT / PACKAGE / "cli.py"
    assert modules["coincid.hdl.tree"] == ROOT / "hdl" / "tree.py"
    assert modules["coincid.model.depth"] == ROOT / "model" / "depth" / "__init__.py"
    assert modules["docs.studies.speed"] == ROOT / "docs" / "studies" / "speed.py"


def test_programs_exist():
    for program in PAGES.programs.values():
        module, _, function = program.run.partition(":")
        text = PAGES.sources.modules[module].read_text(encoding="utf-8")
        assert re.search(rf"^def {function}\(", text, re.MULTILINE), program.name
        assert all((ROOT / name).exists() for name in (*program.data, *program.pictures)), (
            program.name
        )
        assert program.cheap != bool(program.minutes), program.name


def named(before, after):
    """Return the pages with a region whose program has another stamp."""
    changed = {
        name
        for name in before.programs
        if before.stamp(before.programs[name]) != after.stamp(after.programs[name])
    }
    return {page for name in changed for page in before.programs[name].writes}


def changed_to(copied, file, old, new):
    """Return the pages after a change of a file, which is taken back."""
    path = copied / file
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    try:
        return named(PAGES, pages_of(copied))
    finally:
        path.write_text(text, encoding="utf-8")


SHOW_DEPTH = {
    "README.md",
    *(
        f"docs/{page}.md"
        for page in (
            "advise", "compact", "controller", "counts", "depth", "explorer", "gap", "limit", "modes", "paper-figures", "performance", "raytrace",
            "returns", "rivals", "second-lidar", "silicon", "sweeps", "two-surfaces",
        )
    ),
}  # fmt: skip


def test_a_change_of_a_depth_kernel_makes_the_pages_stale_that_show_depth(copied):
    assert named(PAGES, pages_of(copied)) == set()
    assert (
        changed_to(
            copied,
            "model/depth/patchmatch.py",
            "import numpy as np",
            "import numpy as np\n\nOTHER = 1",
        )
        == SHOW_DEPTH
    )


def test_comments_and_docstrings_make_nothing_stale(copied):
    assert changed_to(copied, "model/depth/patchmatch.py", '"""', '"""Other words. ') == set()
    assert changed_to(copied, "hdl/tree.py", "\nfrom ", "\n# a comment\n\nfrom ") == set()


def test_data_files_and_versions_count(copied):
    assert changed_to(copied, "tb/async_stress.v", "module", "module /* */") <= {"docs/async.md"}
    assert changed_to(copied, "docs/studies/power_page.md", "Power", "power") == {
        "docs/counts.md",
        "docs/power.md",
        "docs/silicon.md",
    }
    assert "docs/raytrace.md" in changed_to(
        copied, "requirements-raytrace.lock", "mitsuba==", "mitsuba==1"
    )
    assert changed_to(copied, "requirements-layout.lock", "klayout==", "klayout==1") == {
        "docs/layout.md",
        "docs/silicon.md",
    }


def test_each_file_that_the_table_names_counts(copied):
    """Alone, and for its own programs only."""
    programs_of = {}
    for name, program in PAGES.programs.items():
        for file in program.data:
            programs_of.setdefault(file, set()).add(name)
    pages = pages_of(copied)
    for file, names in programs_of.items():
        path = copied / file
        before = path.read_bytes()
        path.write_bytes(before + b"\n")
        for name in names:
            program = PAGES.programs[name]
            assert pages.stamp(program) != PAGES.stamp(program), (file, name)
        path.write_bytes(before)


def test_what_is_run_and_the_command_that_is_told_count():
    program = PAGES.programs["ports"]
    stamp = PAGES.stamp(program)
    assert PAGES.stamp(evolve(program, run=f"{program.module}:another")) != stamp
    assert PAGES.stamp(evolve(program, command="make another")) != stamp


def test_stamps_ignore_the_folder_and_other_modules(copied):
    (copied / "study" / "other.py").write_text("import numpy\n", encoding="utf-8")
    assert named(PAGES, pages_of(copied)) == set()


def test_what_is_left_out_takes_no_module_with_it_whose_name_only_begins_alike(tmp_path):
    package = tmp_path / PACKAGE
    room = tmp_path / "room"
    (package / "room").mkdir(parents=True)
    (room / "tree").mkdir(parents=True)
    (tmp_path / "docs").mkdir()
    for path in (package, tmp_path / "docs", room, room / "tree"):
        (path / "__init__.py").write_text("", encoding="utf-8")
    (room / "tree" / "leaf.py").write_text("", encoding="utf-8")
    (room / "tree_view.py").write_text("", encoding="utf-8")
    (room / "program.py").write_text(
        "from .tree import leaf\nfrom . import tree_view\n", encoding="utf-8"
    )
    sources = Sources(tmp_path)
    whole = sources.closure("coincid.room.program").modules
    assert {"coincid.room.tree", "coincid.room.tree.leaf"} < {*whole}
    left = sources.closure("coincid.room.program", without=["coincid.room.tree"]).modules
    assert left == ("coincid", "coincid.room", "coincid.room.program", "coincid.room.tree_view")


def test_a_region_is_replaced_whole():
    text = "a\n\n<!-- begin x: make x; stamp unknown -->\n\nold\n\n<!-- end x -->\n\nb\n"
    new = with_region("p", text, "x", "new\n", "make y", "012")
    assert new == "a\n\n<!-- begin x: make y; stamp 012 -->\n\nnew\n\n<!-- end x -->\n\nb\n"
    assert with_region("p", new, "x", None, "make y", "345") == new.replace("012", "345")
    with pytest.raises(InputError, match="p: has no region 'z'"):
        with_region("p", text, "z", "", "make z", "0")
    with pytest.raises(InputError, match="region 'x' does not end"):
        list(regions("p", text.replace("end x", "end y")))


def test_a_program_that_reads_what_its_stamp_does_not_cover_is_found():
    program = PAGES.programs["ports"]
    undeclared = driver().undeclared
    assert (
        undeclared(
            PAGES,
            program,
            ["flow/ports.py", "flow/__pycache__/ports.cpython-311.pyc", "docs/pages.toml"],
        )
        == []
    )
    read = ["model/depth/planes.py", "flow/__pycache__/synth.cpython-311.pyc", "flow/coincid.sdc"]
    assert undeclared(PAGES, program, read) == [
        "flow/coincid.sdc",
        "flow/synth.py",
        "model/depth/planes.py",
    ]


@pytest.mark.parametrize("name", CHEAP)
def test_cheap_programs_write_what_the_pages_show(name, tmp_path):
    program = PAGES.programs[name]
    for page in (*program.writes, *program.pictures):
        (tmp_path / page).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / page, tmp_path / page)
    module, _, function = program.run.partition(":")
    code = f"if __name__ == '__main__': from {module} import {function}; {function}()"
    environment = os.environ | {writing.FOLDER: str(tmp_path)}
    command = [sys.executable, "-c", code]
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, encoding="utf-8"
    )
    assert done.returncode == 0, done.stderr
    for page, names in program.writes.items():
        written = {
            region.name: region.text
            for region in regions(page, (tmp_path / page).read_text(encoding="utf-8"))
        }
        for region in names:
            assert written[region] == PAGES.region(page, region).text, (
                f"{page}: {region}: make pages NAMES={name}"
            )
    for picture in program.pictures:
        if picture.endswith(".svg"):
            assert (tmp_path / picture).read_bytes() == (ROOT / picture).read_bytes(), picture


def test_a_release_is_refused_while_something_stands_against_it(copied, monkeypatch):
    release_faults = driver().release_faults
    pages = pages_of(copied)
    (copied / "pyproject.toml").write_text('[project]\nversion = "9.8.7"\n', encoding="utf-8")
    faults = release_faults(pages)
    assert "CHANGELOG.md: has no section '## [9.8.7] - DATE'" in faults
    assert any(fault.startswith("CITATION.cff: version = ") for fault in faults)
    (copied / "CHANGELOG.md").write_text("## [9.8.7] - 2030-01-01\n", encoding="utf-8")
    (copied / "CITATION.cff").write_text("version: 9.8.7\n", encoding="utf-8")
    assert all(fault.startswith("stale: ") for fault in release_faults(pages))
    monkeypatch.setattr(type(pages), "stale", lambda self: {})
    assert release_faults(pages) == []


def test_names_choose_programs_and_pages():
    program = driver()
    assert [one.name for one in program.chosen(PAGES, ["surfaces"])] == ["surfaces"]
    assert {one.name for one in program.chosen(PAGES, ["depth"])} == {"surfaces", "confidence"}
    with pytest.raises(InputError, match="NAMES: nothing: must be of"):
        program.chosen(PAGES, ["nothing"])
