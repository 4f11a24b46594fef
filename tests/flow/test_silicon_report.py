# SPDX-License-Identifier: Apache-2.0
"""What is read from OpenSTA about the asynchronous view. OpenSTA is a stand-in."""

import re

import pytest

from coincid.flow import silicon_report
from coincid.hdl.silicon.circuit import Circuit

from .sensors import SMALL

ENDS = """\
Warning 1: line 3, module coincid_delay not found. Creating black box for it.
Warning 2: clock taps has no source.
PATHS
clk spads
                                Required  Actual
Endpoint                           Delay   Delay   Slack
--------------------------------------------------------
front/flop/D (DFF_X1)               1.98    0.75    1.23

clk roots
No paths found.
spads clk
                                Required  Actual
Endpoint                           Delay   Delay   Slack
--------------------------------------------------------
tdc/flop/D (DFF_X1)                 0.50    0.60   -0.10
"""


def test_paths_of_the_asynchronous_view_have_required_and_taken_in_order(monkeypatch, tmp_path):
    """A pair of clocks without a path has no row. Black boxes are expected, so no complaint."""
    scripts = []

    def run(command, folder, name):
        scripts.append((folder / command[-1]).read_text(encoding="utf-8"))
        return ENDS

    monkeypatch.setattr(silicon_report, "run_program", run)
    text = "module top;\nendmodule\nmodule \\x.coincid_or2 ;\n  y;\nendmodule\nmodule last;\nendmodule\n"
    (tmp_path / silicon_report.MAPPED).write_text(text, encoding="utf-8")
    complaints, paths = silicon_report.timing(tmp_path, "top", "own.sdc")
    assert complaints == ["Warning 2: clock taps has no source."]
    assert paths == [("clk", "spads", 1.98, 0.75), ("spads", "clk", 0.5, 0.6)]
    timed = (tmp_path / silicon_report.TIMED).read_text(encoding="utf-8")
    assert timed == "module top;\nendmodule\nmodule last;\nendmodule\n"
    (script,) = scripts
    assert "link_design top" in script and "read_sdc own.sdc" in script
    pairs = re.findall(r"-from \[get_clocks (\w+)\] -to \[get_clocks (\w+)\]", script)
    assert len(set(pairs)) == len(silicon_report.CLOCKS) ** 2


def test_a_netlist_is_mapped_from_its_own_files(monkeypatch, tmp_path):
    """Not from those that an earlier run has left beside them."""
    scripts = []
    monkeypatch.setattr(silicon_report, "run_yosys", lambda folder, *script: scripts.append(script))
    monkeypatch.setattr(silicon_report, "library_files", lambda: {"enables.v": "", "lib": ""})
    for name in ("b.v", "a.v", "timing.tcl", silicon_report.MAPPED, silicon_report.TIMED):
        (tmp_path / name).write_text("", encoding="utf-8")
    silicon_report.mapped(tmp_path, "top")
    assert "read_verilog -sv a.v b.v" in scripts[0]
    assert scripts[0][-1].endswith(f" {silicon_report.MAPPED}")


def flop(kind, clock, polarity, width=1, **pins):
    connections = {"CLK": [clock], "Q": list(range(100, 100 + width))} | pins
    return {"type": kind, "parameters": {"CLK_POLARITY": polarity}, "connections": connections}


def test_the_report_has_the_edge_and_the_reset_of_each_clock():
    """An inverter in a clock turns the edge; numbers of instances are left out."""
    cells = {
        "a": flop("$dff", 2, "1", width=3),
        "b": flop("$adff", 3, "0", width=2, ARST=[4]),
        "c": flop("$adff", 3, "1", ARST=[4]),
        "d": flop("$dff", 5, "1", width=4),
        "other": {"type": "$and", "connections": {"A": [2], "B": [3], "Y": [9]}},
        "turned": {"type": "$not", "connections": {"A": [2], "Y": [5]}},
    }
    names = {"clk": [2], "tree_7.root": [3], "bank_1.reset": [4], "clk_n": [5]}
    module = {"cells": cells, "netnames": {name: {"bits": bits} for name, bits in names.items()}}
    paths = [("clk", "spads", 1.98, 0.75), ("spads", "clk", 0.5, 0.6)]
    text = silicon_report.report(SMALL, Circuit(), module, paths)
    built = f"of 1 subgroups of 16 SPADs, {Circuit().banks_of(SMALL)} window bank(s), R = {SMALL.rearm};"
    assert built in text and "for a cycle of 2 ns:" in text
    rows = [line[2:-2].split(" | ") for line in text.splitlines() if line.startswith("| ")]
    assert [row for row in rows if "---" not in row[0]] == [
        ["clock", "edge", "flip-flops", "asynchronous reset"],
        ["`clk`", "rising", "3", "none"],
        ["`clk`", "falling", "4", "none"],
        ["`tree_*.root`", "rising", "1", "`bank_*.reset`"],
        ["`tree_*.root`", "falling", "2", "`bank_*.reset`"],
        ["from clock", "to clock", "required ns", "taken ns"],
        ["clk", "spads", "1.98", "0.75"],
        ["spads", "clk", "0.50", "0.60"],
    ]


@pytest.mark.parametrize("kind", ["$dlatch", "$adlatch", "$dlatchsr", "$sr"])
def test_every_kind_of_latch_is_found(kind):
    cells = {"one": {"type": kind}, "flop": {"type": "$dff"}, "or": {"type": "$or"}}
    assert silicon_report.latches({"cells": cells}) == ["one"]


KINDS = "dff dffe adff adffe aldff aldffe dffsr dffsre sdff sdffe sdffce"


@pytest.mark.parametrize("kind", KINDS.split())
@pytest.mark.parametrize("inverter", ["$not", "$_NOT_"])
def test_every_kind_of_flip_flop_counts_at_its_edge(kind, inverter):
    cells = {
        "one": flop(f"${kind}", 3, "1", width=2),
        "turned": {"type": inverter, "connections": {"A": [2], "Y": [3]}},
    }
    module = {"cells": cells, "netnames": {"clk": {"bits": [2]}}}
    assert silicon_report.domains(module) == [silicon_report.Domain("clk", True, "", 2)]


@pytest.fixture
def written(monkeypatch, tmp_path):
    """Return a function that writes a report, with these latches and complaints of the tools."""

    def written(latches=(), complaints=()):
        cells = {name: {"type": "$dlatch"} for name in latches}
        module = {"cells": cells, "netnames": {}}
        monkeypatch.setattr(silicon_report, "netlist", lambda *_: ("top", module))
        monkeypatch.setattr(silicon_report, "mapped", lambda *_: None)
        monkeypatch.setattr(silicon_report, "timing", lambda *_: (list(complaints), []))
        return silicon_report.write(SMALL, Circuit(), tmp_path)

    return written


def test_latches_and_complaints_are_errors_and_leave_no_report(written, tmp_path):
    """Both are told, each by itself or together."""
    latches, complaints = ["a.latch", "b.latch"], ["Warning 2: clock taps has no source."]
    for given in ((latches, ()), ((), complaints), (latches, complaints)):
        with pytest.raises(ValueError) as refused:
            written(*given)
        told = ", ".join(one for part in given for one in part)
        assert str(refused.value).endswith(f" do not hold on: {told}")
        assert not list(tmp_path.glob("*.md"))


def test_the_constraints_that_are_written_begin_with_the_clock_of_the_circuit(written):
    """Its cycle is in nanoseconds; the lines are those of the module, which has no top."""
    top, report, sdc = written()
    first, rest = sdc.read_text(encoding="utf-8").split("\n", 1)
    cycle_ns = 1000 / Circuit().clock_mhz
    assert first == f"create_clock -name clk -period {cycle_ns:g} [get_ports clk]"
    assert "words_*" in rest and "spad_0" not in rest
    assert (top, report.exists()) == ("top", True)
    assert f"a cycle of {cycle_ns:g} ns" in report.read_text(encoding="utf-8")
