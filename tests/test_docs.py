"""What the documentation says is so: snippets run, tables agree with the code, links lead somewhere."""

import contextlib
import io
import re
from pathlib import Path

import pytest

from coincid.cli import app
from coincid.model import latency
from coincid.model.packet import HEADER

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def rows(page, title):
    """Cells of the table whose head begins with `title`."""
    text = page.read_text().split(f"| {title} |", 1)[1]
    table = re.match(r"(?:.*\|\n)+", text)[0].splitlines()[2:]
    return [[cell.strip().strip("`") for cell in line.strip("|").split("|")] for line in table]


def test_readme_snippet_runs():
    snippet, = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    told = io.StringIO()
    with contextlib.redirect_stdout(told):
        exec(compile(snippet, "README.md", "exec"), {})
    events, metres = re.fullmatch(r"(\d+) events, wall at ([\d.]+) m\n", told.getvalue()).groups()
    assert int(events) > 0
    assert abs(float(metres) - 9.7) < 0.05


def test_latency_table():
    table = {name: int(cycles) for name, cycles, *_ in rows(ROOT / "docs" / "architecture.md", "name")}
    assert table == {name: value for name, value in vars(latency).items() if name.isupper()}


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
