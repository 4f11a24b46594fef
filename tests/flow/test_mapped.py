# SPDX-License-Identifier: Apache-2.0
"""What is read from OpenSTA's reports and written into its netlists, for made-up blocks."""

import json
import re
from pathlib import Path

import pytest

from coincid.flow import mapped
from coincid.flow.mapped import FLOP, GATE, LATCH, Mapped, least_slacks_ns, without_parameters
from coincid.flow.yosys import LIBERTY
from coincid.hdl.clock_gate import ClockGate
from coincid.hdl.front_end_views import VIEWS
from coincid.hdl.silicon.circuit import MACROS
from coincid.tools.build import ToolchainError

# Of latches: a path's slack is what it has not borrowed of the most that it may borrow.
REPORT = """\
   5.55   slack (MET)
FLOPS
   1.25   slack (MET)
  -0.75   slack (VIOLATED)
   0.40   slack (MET)
LATCHES
max time borrow          0.90
actual time borrow       0.22
   0.00   slack (MET)
OPENING
No paths found.
ENABLES
   0.31   slack (MET)
"""


def test_the_least_slack_of_each_kind_of_end():
    """Neither what comes before the first kind, nor a kind without paths."""
    assert least_slacks_ns(REPORT) == pytest.approx(
        {"FLOPS": -0.75, "LATCHES": 0.68, "ENABLES": 0.31}
    )


def test_latches_that_borrow_nothing_have_the_slack_of_their_path():
    """So have flip-flops, whatever else the report says."""
    report = "FLOPS\n  0.50   slack (MET)\nLATCHES\n  0.70   slack (MET)\n  0.60   slack (MET)\n"
    assert least_slacks_ns(report) == {"FLOPS": 0.5, "LATCHES": 0.6}


def test_no_paths_no_slacks():
    assert least_slacks_ns("FLOPS\nNo paths found.\nLATCHES\nOPENING\nENABLES\n") == {}


def test_parameters_go_and_connections_stay():
    instance = "  coincid_delay #(\n    .FS(32'd7),\n    .N(32'd2)\n  ) line (\n    .a(b)\n  );\n"
    assert without_parameters(instance) == "  coincid_delay line (\n    .a(b)\n  );\n"


def test_numbers_of_cells_by_the_beginning_of_their_names():
    cells = {"DFF_X1": 1, "SDFF_X2": 2, "DLH_X1": 4, "DLL_X1": 8, "TLAT_X1": 16}
    cells |= {"CLKGATE_X1": 32, "CLKGATETST_X1": 64, "NAND2_X1": 128, "XDFF": 256}
    block = Mapped("block", Path(), cells, {}, 1.0)
    assert [block.count(kind) for kind in (FLOP, LATCH, GATE)] == [3, 28, 96]


@pytest.fixture
def asked(monkeypatch, tmp_path):
    """Return the block that is mapped, and the files and commands that Yosys gets for it."""
    unit = ClockGate()
    counted = {
        "NAND2_X1": 7,
        "$scopeinfo": 9,
        "coincid_mutex": 2,
        "$paramod\\coincid_delay\\FS=7": 3,
        "$paramod\\coincid_delay\\FS=9": 4,
        "coincid_delayed": 5,
    }
    statistics = {f"\\{unit.unit_name}": {"num_cells_by_type": counted, "area": "12.5"}}
    text = json.dumps({"modules": statistics})
    (tmp_path / "stat.json").write_text(text, encoding="utf-8")

    def asked(**options):
        got = []

        def yosys_once(place, files, script):
            got.append((files, script))
            return tmp_path

        monkeypatch.setattr(mapped, "yosys_once", yosys_once)
        block = mapped.map_block(unit, **options)
        assert block.folder == tmp_path
        return block, *got[0]

    monkeypatch.setattr(mapped, "library_files", lambda: {LIBERTY: "cells"})
    return asked


def test_macros_count_apart_from_cells(asked):
    """One name for all their parameters; what Yosys notes about scopes is neither."""
    block, _, _ = asked()
    assert block.name == "coincid_clock_gate" and block.area_um2 == 12.5
    assert block.cells == {"NAND2_X1": 7, "coincid_delayed": 5}
    assert block.macros == {"coincid_mutex": 2, "coincid_delay": 7}


def test_every_black_box_is_a_macro():
    boxes = re.findall(r"^module (\w+)", MACROS.read_text(encoding="utf-8"), re.MULTILINE)
    assert len(boxes) > 3
    for box in boxes:
        for kind in (box, f"$paramod\\{box}\\WIDTH=4", f"$paramod$0123\\{box}"):
            assert mapped.MACRO.match(kind)[1] == box


def test_a_block_is_mapped_with_clock_gates_of_the_library_unless_without(asked):
    _, files, script = asked()
    assert list(files)[-1] == LIBERTY and "CLKGATE_X8 gate" in files["coincid_clock_gate.v"]
    assert script[:2] == [
        f"read_liberty -lib {LIBERTY}",
        "read_verilog -sv coincid_clock_gate.v",
    ]
    assert script[-2:] == [
        f"tee -q -o stat.json stat -json -liberty {LIBERTY}",
        "write_verilog -simple-lhs -noexpr -noattr netlist.v",
    ]
    assert "synth -flatten -noabc -top coincid_clock_gate" in script
    assert any(line.startswith("clockgate ") for line in script)
    _, files, script = asked(gated=False)
    assert "CLKGATE" not in files["coincid_clock_gate.v"]
    assert not any(line.startswith("clockgate ") for line in script)


def test_a_changed_file_takes_the_place_of_that_of_the_view(asked):
    view = VIEWS["async"]
    name = view.macros[0].name
    _, files, script = asked(view=view, changed={name: "changed", "more.v": "more"})
    assert (files[name], files["more.v"]) == ("changed", "more")
    for path in (*view.cells, *view.macros[1:]):
        assert files[path.name] == path.read_text(encoding="utf-8")
    assert set(script[1].split()[2:]) == files.keys() - {LIBERTY}


@pytest.mark.parametrize("answer", ["Error: no pin a\nError: no pin b\n", "No paths found.\n"])
def test_what_a_timing_tool_cannot_tell_is_an_error(monkeypatch, tmp_path, answer):
    """The first complaint, or that there is no path."""
    (tmp_path / "netlist.v").write_text("module b;\nendmodule\n", encoding="utf-8")
    monkeypatch.setattr(mapped, "run_program", lambda *_: answer)
    expected = "sta: Error: no pin a$" if "Error" in answer else "sta: no path in b$"
    with pytest.raises(ToolchainError, match=expected):
        mapped.slacks_ns(tmp_path, "b", 2.0)
    script = (tmp_path / "b.tcl").read_text(encoding="utf-8")
    assert "create_clock -name clk -period 2 [get_ports clk]" in script
    assert "read_verilog b.timed.v" in script


def test_slacks_are_those_at_the_clock_asked_for(monkeypatch, tmp_path):
    asked = []

    def run(command, folder, name):
        asked.append((folder / command[-1]).read_text(encoding="utf-8"))
        return answer

    monkeypatch.setattr(mapped, "run_program", run)
    (tmp_path / mapped.NETLIST).write_text("a #(\n    .N(1)\n  ) b (c);\n", encoding="utf-8")
    answer = "FLOPS\n  0.50   slack (MET)\nLATCHES\nOPENING\nENABLES\n  0.25   slack (MET)\n"
    assert mapped.slacks_ns(tmp_path, "block", 2.5) == {"FLOPS": 0.5, "ENABLES": 0.25}
    (script,) = asked
    assert "create_clock -name clk -period 2.5 [get_ports clk]" in script
    assert "link_design block" in script
    netlist = tmp_path / re.search(r"read_verilog (\S+)", script)[1]
    assert netlist.read_text(encoding="utf-8") == "a b (c);\n"
    answer = "Warning 1: odd\nError: no such cell\nFLOPS\n"
    with pytest.raises(ToolchainError, match="sta: Error: no such cell"):
        mapped.slacks_ns(tmp_path, "block", 2.5)
    answer = "FLOPS\nNo paths found.\nLATCHES\nOPENING\nENABLES\n"
    with pytest.raises(ToolchainError, match="no path in block"):
        mapped.slacks_ns(tmp_path, "block", 2.5)
