# SPDX-License-Identifier: Apache-2.0
"""The documentation is true: snippets run, tables agree with the code, links lead somewhere."""

import ast
import contextlib
import io
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command

from coincid.cli import app
from coincid.model.contract import latency
from coincid.model.contract.packet import FORMATS, HEADER, header_field
from coincid.model.contract.preset_files import PRESETS
from coincid.study.sweep import sweep
from coincid.study.sweep_spec import read_spec
from docs import conf
from docs.studies.drawings import waveform as picture

from .command import command
from .commands import BLOCK

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def rows(page, title):
    """Return the cells of the table whose head begins with `title`."""
    text = page.read_text(encoding="utf-8").split(f"| {title} |", 1)[1]
    table = re.match(r"(?:.*\|\n)+", text)[0].splitlines()[2:]
    return [[cell.strip().strip("`") for cell in line.strip("|").split("|")] for line in table]


def printed(page):
    """Run the Python blocks of a page; return what they print and their names."""
    told, names = io.StringIO(), {}
    with contextlib.redirect_stdout(told):
        for code in blocks(page, "python"):
            exec(compile(code, page.name, "exec"), names)
    return told.getvalue(), names


def test_readme_snippet_runs():
    told, _ = printed(ROOT / "README.md")
    events, metres = re.fullmatch(r"(\d+) events, wall at ([\d.]+) m\n", told).groups()
    assert int(events) > 0
    assert abs(float(metres) - 9.7) < 0.05


def blocks(page, language):
    """Return the fenced blocks of a page in a language; "": without one."""
    return [
        block for name, block in BLOCK.findall(page.read_text(encoding="utf-8")) if name == language
    ]


def test_all_python_blocks_are_tested():
    """By this file, `test_extend.py` and `board/test_emulator.py`; a block on another page needs a test, too."""
    tested = {
        "README.md",
        "advise.md",
        "light.md",
        "explorer.md",
        "experiments.md",
        "sweeps.md",
        "board.md",
        "extend.md",
        "limit.md",
    }
    assert {page.name for page in PAGES if blocks(page, "python")} == tested


def test_code_about_light_prints_what_the_page_says():
    page = ROOT / "docs" / "light.md"
    said = re.sub(r"```python\n.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    lines = printed(page)[0].splitlines()
    assert len(lines) > 10 and [line for line in lines if line not in said] == []


def test_the_bound_is_what_the_page_says():
    page = ROOT / "docs" / "limit.md"
    told = printed(page)[0].strip()
    assert told and f"prints `{told}`" in page.read_text(encoding="utf-8")


def test_notebook_block_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, names = printed(ROOT / "docs" / "explorer.md")
    assert len(names["run"].events()) > 0 and (tmp_path / "points.ply").exists()


def test_a_scene_that_moves(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    told, _ = printed(ROOT / "docs" / "advise.md")
    assert np.abs(np.array(ast.literal_eval(told), float) - [4, 4.5, 5]).max() < 0.05
    assert Path("depths.npz").exists() and Path("depths.gif").exists()


def test_a_study_is_one_file(tmp_path):
    """The page's study runs as a program, on all cores, and draws."""
    (code,) = blocks(ROOT / "docs" / "experiments.md", "python")
    (tmp_path / "thresholds.py").write_text(code, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "thresholds.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        encoding="utf-8",
    )
    table = ast.literal_eval(done.stdout)
    assert list(table) == ["klux", "threshold", "wrong_share", "events_per_s"]
    assert table["wrong_share"][1] < 0.1 < table["wrong_share"][3]
    assert (tmp_path / "thresholds.png").exists()


def test_sweep_blocks_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = ROOT / "docs" / "sweeps.md"
    (axes,) = blocks(page, "toml")
    Path("spec.toml").write_text(axes, encoding="utf-8")
    assert len(read_spec("spec.toml").points) == 27
    small = "[frame]\npulses = 10\n[sensor]\nrows = 8\ncols = 8\n[[axis]]\nklux = [5, 50]\n[[axis]]\nsubgroup.threshold = [2]\n"
    Path("small.toml").write_text(small, encoding="utf-8")
    Path("build").mkdir()
    sweep(read_spec("small.toml"), Path("build/sweep.parquet"), workers=1, title="small")
    printed(page)


def test_recording_example_runs(tmp_path, monkeypatch):
    """Run the commands of the page's example, one after the other."""
    monkeypatch.chdir(tmp_path)
    (example,) = [
        block for block in blocks(ROOT / "docs" / "recordings.md", "") if block.startswith("printf")
    ]
    first, *lines = example.splitlines()
    subprocess.run(["sh", "-c", first], check=True)
    for line in lines:
        program, words = line.split(maxsplit=1)
        result = command(words)
        assert program == "coincid" and result.exit_code == 0, (line, result.output)
    assert Path("result.npz").exists()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_in_blocks_have_their_options(page):
    """Every option that a block gives to `coincid` exists in that command."""
    commands = get_command(app).commands
    for block in blocks(page, ""):
        lines = re.sub("#.*", "", block.replace("\\\n", " "))
        for name, given in re.findall(r"^(?:\.venv/bin/)?coincid (\w+)(.*)", lines, re.MULTILINE):
            known = {option for parameter in commands[name].params for option in parameter.opts}
            assert set(re.findall(r"--[\w-]+", given)) <= known, given


def test_latency_table():
    table = {
        name: int(cycles) for name, cycles, *_ in rows(ROOT / "docs" / "architecture.md", "name")
    }
    assert table == {name: value for name, value in vars(latency).items() if name.isupper()}


def test_the_page_of_files_names_every_preset():
    text = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
    named = re.search(r"which\s+have a name instead of a path: (.*?)\.", text, re.DOTALL)[1]
    assert set(re.findall("`(.+?)`", named)) == set(PRESETS)


def test_places_of_behaviours_exist():
    """Every class and function in the table *Where is it?* is defined in a file of its row."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    table = page.split("| behaviour |", 1)[1].split("\n\n", 1)[0]
    for row in table.splitlines()[2:]:
        quoted = re.findall("`(.+?)`", row.split("|", 2)[2])
        files = [name for name in quoted if "/" in name]
        source = "\n".join((ROOT / name).read_text(encoding="utf-8") for name in files)
        for name in set(quoted) - set(files):
            for part in name.split("."):
                defined = rf"\b(?:class|def) {part}\b|^ *{part}\b.* = "
                assert re.search(defined, source, re.MULTILINE), f"{name} is not in {files}"


def test_waveform_picture_shows_the_stages():
    """In the simulation behind the picture, each stage is where the page says, and so is the
    decoded word.
    """
    values = picture.one_period()
    # cycles of the window with four photons
    opens, closes = picture.EDGES[1][1], picture.EDGES[-1][1]

    def first(name, begin):
        return next(cycle for cycle, value in enumerate(values[name]) if cycle >= begin and value)

    assert first("spad", opens) == opens
    assert first("root", opens) == opens + 1
    assert (
        next(c for c, word in enumerate(picture.covered(values)) if c >= opens and word)
        == opens + 2
    )
    assert [
        bin(values["hits"][cycle]).count("1") for cycle in (opens + 4, opens + 5, opens + 6)
    ] == [1, 3, 4]
    assert first("closed", opens + 4) == closes + 7
    assert first("commit", 0) == closes + latency.COMMIT
    sent = (
        closes
        + latency.COMMIT
        + latency.STORE_TO_GRANT
        + latency.GRANT_TO_BEAT
        + latency.BEAT_TO_PORT
    )
    assert first("tvalid", opens) == sent
    fields = dict(
        kind=FORMATS["id"].code,
        overrun=0,
        subgroup=0,
        pulse=0,
        count=4,
        winner=9,
        stamp=8 * 32 + 22,
    )
    assert {name: header_field(values["tdata"][sent], name) for name in HEADER} == fields
    assert values["tdata"][sent + 1] == sum(1 << pixel for pixel, *_ in picture.EDGES[1:])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files(page):
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_named_files_and_commands_exist(page):
    text = page.read_text(encoding="utf-8")
    for name in re.findall(r"`((?:model|hdl|tb|docs|scripts|tests)/[\w/.]*)`", text):
        assert (ROOT / name).exists(), name
    assert set(re.findall(r"`coincid (\w+)", text)) <= get_command(app).commands.keys()
    targets = set(
        re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    )
    assert set(re.findall(r"(?:^|`)make (\w+)", text, re.MULTILINE)) <= targets


def as_restructured(*lines, what="function"):
    """Return the lines of a docstring as the site reads them."""
    read = list(lines)
    conf.plain_text(None, what, "name", None, None, read)
    return read


@pytest.mark.parametrize(
    ("line", "read"),
    [
        ("rows * cols, a|b, C:\\x", r"rows \* cols, a\|b, C:\\x"),
        ("those of `Config`, and `a*b`", r"those of ``Config``\ , and ``a*b``\ "),
        ("a name_ and name_of", r"a name\_ and name_of"),
        ("one ` alone * two", r"one  alone \* two"),
        ("several `name`s", r"several ``name``\ s"),
    ],
)
def test_docstrings_are_plain_text_but_for_names_in_backticks(line, read):
    assert as_restructured(line) == [read]


def test_headings_lists_and_steps_of_docstrings_stay():
    """A heading that the style of NumPy has is left to its reader; others are sentences."""
    assert as_restructured("Returns", "-------", "a * b") == ["Returns", "-------", "a * b"]
    assert as_restructured("Files", "-----", "a") == ["Files:", "", "a"]
    assert as_restructured("* first", "  goes on", "* second") == [
        "* first",
        "  goes on",
        "* second",
    ]
    assert as_restructured("head:", "  inner", "    deep") == ["| head:", "|   inner", "|     deep"]
    assert as_restructured("one line", "and another") == ["one line", "and another"]
    assert as_restructured("float: m", what="property") == ["float -- m"]
    assert as_restructured("float: m") == ["float: m"]


def test_the_contents_of_the_site_are_those_of_the_index():
    """A part for each heading, with the pages that its list links, and the reference at the end."""
    index = """# Title

* [not a part](before.md)

## To use

* [one](one.md) is first, then [aside](aside.md)
* [home](../README.md)
text with [a link](no.md)

## To read

* [deep](studies/two.md)
* [elsewhere](https://a.example/b.md)
"""
    parts = re.findall(r":caption: (.*)\n\n((?:/.*\n)*)", conf.contents(index))
    assert [(caption, pages.split()) for caption, pages in parts] == [
        ("To use", ["/docs/one", "/README"]),
        ("To read", ["/docs/studies/two"]),
        ("Reference", ["/gallery/index", "/api/index"]),
    ]


def test_the_site_has_every_page_of_the_documentation_in_its_contents():
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^/docs/(.*)$", conf.contents(index), re.MULTILINE))
    assert listed == {page.stem for page in PAGES[1:]} - {"index"}
