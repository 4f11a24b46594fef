"""What the documentation says is so: snippets run, tables agree with the code, links lead somewhere."""

import contextlib
import io
import re
from pathlib import Path

import pytest

from coincid.cli import app
from coincid.model.contract import latency
from coincid.model.contract.packet import HEADER, Kind, header_field
from coincid.study.drawings import waveform as picture

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def rows(page, title):
    """Cells of the table whose head begins with `title`."""
    text = page.read_text().split(f"| {title} |", 1)[1]
    table = re.match(r"(?:.*\|\n)+", text)[0].splitlines()[2:]
    return [[cell.strip().strip("`") for cell in line.strip("|").split("|")] for line in table]


def test_readme_snippet_runs():
    (snippet,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    told = io.StringIO()
    with contextlib.redirect_stdout(told):
        exec(compile(snippet, "README.md", "exec"), {})
    events, metres = re.fullmatch(r"(\d+) events, wall at ([\d.]+) m\n", told.getvalue()).groups()
    assert int(events) > 0
    assert abs(float(metres) - 9.7) < 0.05


def test_latency_table():
    table = {name: int(cycles) for name, cycles, *_ in rows(ROOT / "docs" / "architecture.md", "name")}
    assert table == {name: value for name, value in vars(latency).items() if name.isupper()}


def test_waveform_picture_shows_the_stages():
    """The simulation behind the picture: each stage where the page says, and the word that it decodes."""
    values = picture.simulate()
    opens, closes = picture.EDGES[1][1], picture.EDGES[-1][1]  # cycles of the window of four photons

    def first(name, begin):
        return next(cycle for cycle, value in enumerate(values[name]) if cycle >= begin and value)

    assert first("spad", opens) == opens
    assert first("root", opens) == opens + 2
    assert first("inside", opens) == opens + 3
    assert [bin(values["hits"][cycle]).count("1") for cycle in (opens + 4, opens + 5, opens + 6)] == [1, 3, 4]
    assert first("closed", opens + 4) == closes + 7
    assert first("commit", 0) == closes + latency.COMMIT
    sent = closes + latency.COMMIT + latency.STORE_TO_GRANT + latency.GRANT_TO_BEAT + latency.BEAT_TO_PORT
    assert first("tvalid", opens) == sent
    fields = {name: header_field(values["tdata"][sent], name) for name in HEADER}
    assert fields == {
        "kind": Kind.EVENT_ID,
        "overrun": 0,
        "subgroup": 0,
        "pulse": 0,
        "count": 4,
        "winner": 9,
        "stamp": 8 * 32 + 22,
    }
    assert values["tdata"][sent + 1] == sum(1 << pixel for pixel, *_ in picture.EDGES[1:])


def test_header_table():
    table = {name: bits for name, bits, _ in rows(ROOT / "docs" / "contract.md", "header field")}
    assert table == {name: f"{lsb + width - 1}:{lsb}" for name, (lsb, width) in HEADER.items()}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files(page):
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text()):
        assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_named_files_and_commands_exist(page):
    text = page.read_text()
    for name in re.findall(r"`((?:model|hdl|tb|docs|scripts|tests)/[\w/.]*)`", text):
        assert (ROOT / name).exists(), name
    commands = {command.name or command.callback.__name__ for command in app.registered_commands}
    assert set(re.findall(r"`coincid (\w+)", text)) <= commands
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert set(re.findall(r"(?:^|`)make (\w+)", text, re.MULTILINE)) <= targets
