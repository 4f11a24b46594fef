# SPDX-License-Identifier: Apache-2.0
"""What is read from OpenSTA about the asynchronous view. OpenSTA is a stand-in."""

import re

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
