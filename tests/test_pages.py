# SPDX-License-Identifier: Apache-2.0
"""Numbers of the pages: regions and their programs, what makes them stale, what cheap programs
write, and a release.
"""

import importlib.util
import json
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


@pytest.fixture
def made_up(tmp_path):
    """Return a function that makes a checkout of these files, in the room `room`, and returns its
    sources.
    """

    def made(**texts):
        package = tmp_path / PACKAGE
        room = tmp_path / "room"
        (package / "room").mkdir(parents=True)
        (tmp_path / "docs").mkdir()
        (room / "tables").mkdir(parents=True)
        for path in (package, tmp_path / "docs", room):
            (path / "__init__.py").write_text("", encoding="utf-8")
        files = {
            "room/other.py": "",
            "room/third.py": "",
            "room/program.v": "module a;",
            "room/other.v": "module b;",
            "room/tables/one.toml": "a = 1",
            "room/tables/two.toml": "a = 2",
            "room/smoke_words.x": "",
            "room/smoke_lines.x": "",
            "room/__pycache__/other.v": "",
            "requirements.lock": "numpy==2.1\nPillow==11.0  # pictures\n# dask==1\n",
            "requirements-rtl.lock": "cocotb==2.0\nruamel.yaml==0.18\n",
        }
        for name, text in (files | texts).items():
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_text(text, encoding="utf-8")
        return Sources(tmp_path)

    return made


# the text of a program, and what it depends on: modules, files and packages
DEPENDENCIES = [
    ("from . import other", ("other",), (), ()),
    ("from .other import NAME", ("other",), (), ()),
    ("import coincid.room.other", ("other",), (), ()),
    ("def late():\n    from .other import NAME", ("other",), (), ()),
    ("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from . import other", (), (), ()),
    (
        "if TYPE_CHECKING:\n    from . import other\nelse:\n    from . import third",
        ("third",),
        (),
        (),
    ),
    ("if other:\n    from . import third", ("third",), (), ()),
    ("NAME = 'coincid.room.third'", ("third",), (), ()),
    ("NAME = 'third.py'", ("third",), (), ()),
    ("NAME = 'third'", (), (), ()),
    ("NAME = 'other.v'", (), ("other.v",), ()),
    ("NAME = 'a/b/other.v'", (), ("other.v",), ()),
    ("NAME = '.v'", (), ("program.v",), ()),
    ("NAME = 'tables'", (), ("tables/one.toml", "tables/two.toml"), ()),
    ("NAME = f'smoke_{light}.x'", (), ("smoke_lines.x", "smoke_words.x"), ()),
    ("NAME = f'smok{light}.x'", (), ("smoke_lines.x", "smoke_words.x"), ()),
    ("NAME = f'smo{light}.x'", (), (), ()),
    (f"NAME = 'other.v{' ' * 60}'", (), (), ()),
    ("import numpy.fft as fft, os", (), (), ("numpy",)),
    ("from PIL import Image", (), (), ("pillow",)),
    ("NAME = 'ruamel_yaml'", (), (), ("ruamel-yaml",)),
    ("import cocotb_tools.runner\nimport pandas", (), (), ("cocotb",)),
    ("NAME = 'dask'", (), (), ()),
]


@pytest.mark.parametrize(("text", "modules", "files", "packages"), DEPENDENCIES)
def test_a_program_depends_on_what_it_imports_and_names(made_up, text, modules, files, packages):
    """Wherever that stands, except for types."""
    sources = made_up(**{"room/program.py": text + "\n"})
    found = sources.closure("coincid.room.program")
    own = {"coincid", "coincid.room", "coincid.room.program"}
    assert {*found.modules} - own == {f"coincid.room.{name}" for name in modules}
    assert found.data == tuple(sources.root / "room" / name for name in files)
    assert found.packages == packages


def test_versions_of_packages_are_those_of_all_lock_files(made_up):
    """A line of a comment names none."""
    versions = {"numpy": "2.1", "pillow": "11.0", "cocotb": "2.0", "ruamel-yaml": "0.18"}
    assert made_up().versions == versions


def test_what_no_lock_file_has_and_what_is_no_module_are_refused(made_up):
    sources = made_up(**{"room/program.py": "import scipy\n"})
    told = "^coincid.room.program: imports scipy, which no lock file has$"
    with pytest.raises(InputError, match=told):
        sources.closure("coincid.room.program")
    with pytest.raises(InputError, match="^coincid.room.lost: is no module of the project$"):
        sources.closure("coincid.room.lost")


# the text of a module before and after a change, and whether its code is another one
CODE_CHANGES = [
    ("A = 1\n", "A = 2\n", True),
    ("A = 1\n", "# why\n\nA = 1\n", False),
    ("A = 1\n", "A = 1  # why\n", True),  # only whole lines of comments are left out
    ('"""One."""\nA = 1\n', '"""Other.\n\nMore.\n"""\nA = 1\n', False),
    ("def f():\n    return 1\n", 'def f():\n    """One."""\n    return 1\n', False),
    ("class C:\n    a = 1\n", 'class C:\n    """One."""\n\n    a = 1\n', False),
    ('A = """\n# a\n"""\n', 'A = """\n# b\n"""\n', True),
    ('A = """\na\n"""\n', 'A = """\n\na\n"""\n', True),
    ("def f():\n    return 1\n", "def f():\n        return 1\n", True),
]


@pytest.mark.parametrize(("before", "after", "other"), CODE_CHANGES)
def test_comments_docstrings_and_empty_lines_are_no_code(made_up, before, after, other):
    """A line within a text is code, whatever it looks like."""
    sources = made_up(**{"room/other.py": before, "room/third.py": after})
    facts = [sources.facts(f"coincid.room.{name}") for name in ("other", "third")]
    assert (facts[0].digest != facts[1].digest) == other


@pytest.mark.parametrize("kept", [None, "", "[]", "no JSON", '{"a": [1]}'])
def test_what_an_earlier_process_left_changes_nothing(made_up, kept):
    """Nor does its lack; what is left afterwards is what was read, and no more."""
    text = "from . import other\nimport numpy\nNAME = 'other.v'\n"
    root = made_up(**{"room/program.py": text}).root
    cache = root / "build" / "facts.json"
    cache.parent.mkdir()
    if kept is not None:
        cache.write_text(kept, encoding="utf-8")
    plain, first = Sources(root), Sources(root, cache)
    expected = plain.closure("coincid.room.program")
    assert first.closure("coincid.room.program") == expected
    first.keep()
    assert len(json.loads(cache.read_text(encoding="utf-8"))) == len(expected.modules)
    again = Sources(root, cache)
    assert again.closure("coincid.room.program") == expected
    assert again.digest(expected) == plain.digest(expected)
    (root / "room" / "program.py").write_text("import numpy\n", encoding="utf-8")
    assert "coincid.room.other" not in Sources(root, cache).closure("coincid.room.program").modules


def test_what_an_earlier_process_left_is_not_read_again(made_up, monkeypatch):
    root = made_up(**{"room/program.py": "from . import other\n"}).root
    first = Sources(root, root / "facts.json")
    expected = first.closure("coincid.room.program")
    first.keep()
    monkeypatch.setattr(Sources, "_parsed", lambda *given: 1 / 0)
    assert Sources(root, root / "facts.json").closure("coincid.room.program") == expected


@pytest.mark.parametrize(
    ("total", "told"),
    [
        (9, []),
        (10, range(1, 11)),
        (25, [3, 5, 8, 10, 13, 15, 18, 20, 23, 25]),
        (1000, range(100, 1001, 100)),
    ],
)
def test_progress_is_told_ten_times_and_at_the_end(capsys, total, told):
    """Of few tasks, it is not told."""
    for done in range(1, total + 1):
        writing.counted(done, total)
    assert capsys.readouterr().out == "".join(f"  {done} of {total}\n" for done in told)


PAGE = """# A page

<!-- begin one: make one; stamp {one} -->

first

<!-- end one -->

between

<!-- begin two: make two; stamp {two} -->

second

<!-- end two -->
"""
TABLE = """without.slow = ["coincid.room.other", "coincid.room.third"]
[one]
command = "make one"
run = "coincid.room.program:one"
writes."docs/page.md" = ["one"]
[two]
command = "make two"
run = "coincid.room.program:two"
writes."docs/page.md" = ["two"]
without = ["slow", "coincid.room.more"]
"""


@pytest.fixture
def checkout(made_up, monkeypatch):
    """Return a made-up checkout with a page of two regions, the second of which is stale."""
    text = "from . import other, third\nimport numpy\n"
    root = made_up(**{"room/program.py": text, "docs/pages.toml": TABLE}).root
    pages = Pages(root)
    stamp = pages.stamp(pages.programs["one"])
    page = root / "docs" / "page.md"
    page.write_text(PAGE.format(one=stamp, two="unknown"), encoding="utf-8")
    monkeypatch.delenv(writing.FOLDER, raising=False)
    monkeypatch.setattr(writing, "checkout", lambda: root)
    monkeypatch.setattr(writing, "_pages", lambda: Pages(root))
    monkeypatch.setattr(writing, "_stamp", writing._stamp.__wrapped__)
    return root


def test_a_program_is_stale_until_it_writes_its_region(checkout):
    """Nothing else on the page changes, and no other region."""
    page = checkout / "docs" / "page.md"
    ((name, (region,)),) = Pages(checkout).stale().items()
    assert (name, region.name, region.stamp) == ("two", "two", "unknown")
    before = page.read_text(encoding="utf-8")
    writing.put("docs/page.md", "two", "new words")
    stamp = Pages(checkout).stamp(Pages(checkout).programs["two"])
    expected = before.replace("second", "new words").replace("stamp unknown", f"stamp {stamp}")
    assert page.read_text(encoding="utf-8") == expected
    assert Pages(checkout).stale() == {}
    (checkout / "room" / "other.py").write_text("A = 1\n", encoding="utf-8")
    assert set(Pages(checkout).stale()) == {"one"}  # the other one is without it
    writing.put("docs/page.md", "one")
    assert Pages(checkout).stale() == {}
    assert "\n\nfirst\n\n" in page.read_text(encoding="utf-8")


def test_a_group_of_modules_is_left_out_as_each_of_them(checkout):
    programs = Pages(checkout).programs
    assert programs.keys() == {"one", "two"}
    left_out = ["coincid.room.other", "coincid.room.third", "coincid.room.more"]
    assert (programs["one"].without, programs["two"].without) == ([], left_out)


def test_the_folder_of_the_pages_may_be_another_one(checkout, monkeypatch, tmp_path_factory):
    """Then the page of the checkout stays, with the stamp of the checkout on the other one."""
    other = tmp_path_factory.mktemp("other")
    (other / "docs").mkdir()
    before = (checkout / "docs" / "page.md").read_text(encoding="utf-8")
    (other / "docs" / "page.md").write_text(before, encoding="utf-8")
    assert writing.picture("docs/images/a.png") == checkout / "docs" / "images" / "a.png"
    monkeypatch.setenv(writing.FOLDER, str(other))
    assert writing.picture("docs/images/a.png") == other / "docs" / "images" / "a.png"
    writing.put("docs/page.md", "two", "new words")
    assert (checkout / "docs" / "page.md").read_text(encoding="utf-8") == before
    stamp = Pages(checkout).stamp(Pages(checkout).programs["two"])
    text = (other / "docs" / "page.md").read_text(encoding="utf-8")
    assert "new words" in text and f"stamp {stamp} -->" in text


def test_a_page_has_its_title_where_it_is_a_file_of_its_own(checkout, tmp_path_factory):
    """In the page of the checkout there is a title already."""
    out = tmp_path_factory.mktemp("out") / "new" / "page.md"
    before = (checkout / "docs" / "page.md").read_text(encoding="utf-8")
    writing.put_page("docs/page.md", "two", "# Title\n\nwords\n", out)
    assert out.read_text(encoding="utf-8") == "# Title\n\nwords\n"
    assert (checkout / "docs" / "page.md").read_text(encoding="utf-8") == before
    writing.put_page("docs/page.md", "two", "# Title\n\nwords\n")
    assert "-->\n\nwords\n\n<!-- end two" in (checkout / "docs" / "page.md").read_text(
        encoding="utf-8"
    )


@pytest.mark.parametrize(
    ("region", "told"),
    [
        ("three", "^docs/pages.toml: no program writes 'three' into docs/page.md$"),
        ("one", "^docs/page.md: has no region 'one'"),
    ],
)
def test_a_region_that_the_table_or_the_page_lacks_is_refused(checkout, region, told):
    page = checkout / "docs" / "page.md"
    page.write_text(
        page.read_text(encoding="utf-8").replace("begin one", "begin x"), encoding="utf-8"
    )
    before = page.read_text(encoding="utf-8")
    with pytest.raises(InputError, match=told):
        writing.put("docs/page.md", region, "new")
    assert page.read_text(encoding="utf-8") == before


def test_a_region_that_the_table_lists_and_the_page_lacks_is_told_with_both(checkout):
    """A region of another name on the page does not take its place."""
    page = checkout / "docs" / "page.md"
    text = page.read_text(encoding="utf-8").replace("begin two", "begin x")
    page.write_text(text.replace("end two", "end x"), encoding="utf-8")
    told = "^docs/page.md: has no region 'two', which docs/pages.toml lists$"
    with pytest.raises(InputError, match=told):
        Pages(checkout).stale()


def test_a_key_that_no_program_has_is_told_with_its_program(checkout):
    table = checkout / "docs" / "pages.toml"
    table.write_text(TABLE + "minuts = 3\n", encoding="utf-8")
    with pytest.raises(InputError, match="^docs/pages.toml: two: .*minuts"):
        Pages(checkout)


def test_without_a_checkout_no_page_is_written(monkeypatch):
    monkeypatch.delenv(writing.FOLDER, raising=False)
    monkeypatch.setattr(writing, "checkout", lambda: None)
    with pytest.raises(InputError, match="^docs/: .* in a checkout of the project only$"):
        writing.picture("docs/images/a.png")


@pytest.mark.parametrize(
    "text",
    [
        PAGE.replace("<!-- end one -->\n", ""),
        PAGE.replace("<!-- end two -->\n", ""),
        PAGE.replace("<!-- end one -->\n", "") + "\n<!-- end one -->\n",
        PAGE.replace("first", "<!-- begin three: a; stamp b -->\n\n<!-- end three -->"),
    ],
    ids=["first", "last", "across", "inner"],
)
def test_a_region_ends_before_the_next_one_begins(text):
    with pytest.raises(
        InputError, match="^p: region '.*' does not end before the next one begins$"
    ):
        list(regions("p", text.format(one="a", two="b")))


def test_a_region_is_replaced_whole():
    text = "a\n\n<!-- begin x: make x; stamp unknown -->\n\nold\n\n<!-- end x -->\n\nb\n"
    new = with_region("p", text, "x", "new\n", "make y", "012")
    assert new == "a\n\n<!-- begin x: make y; stamp 012 -->\n\nnew\n\n<!-- end x -->\n\nb\n"
    assert with_region("p", new, "x", None, "make y", "345") == new.replace("012", "345")
    with pytest.raises(InputError, match="p: has no region 'z'"):
        with_region("p", text, "z", "", "make z", "0")
    endless = text.replace("end x", "end y")
    with pytest.raises(InputError, match="p: has no region 'x'"):
        with_region("p", endless, "x", "new", "make y", "0")
    with pytest.raises(InputError, match="region 'x' does not end"):
        list(regions("p", endless))


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
