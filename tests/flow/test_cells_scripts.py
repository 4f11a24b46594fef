# SPDX-License-Identifier: Apache-2.0
"""What the flows ask of their tools and read from their answers. The tools are stand-ins, so
nothing has to be installed.
"""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from attrs import evolve

from coincid.flow import mapped, pnr, power, silicon_report, synth
from coincid.flow.mapped import Mapped, map_block, slacks_ns
from coincid.flow.synth import CELLS, ECP5, GATES, Block, Netlist
from coincid.flow.yosys import LIBERTY, bound, cells_script
from coincid.hdl.clock_gate import ClockGate
from coincid.hdl.export import units_files
from coincid.hdl.subgroup import Subgroup
from coincid.model.contract.config import load_config
from coincid.model.contract.parameters import TOP
from coincid.tb.frame_record import FrameJob
from coincid.tools.build import ToolchainError

from .sensors import SMALL

LARGE_GATE, SMALL_GATE = ClockGate(), ClockGate(small=True)


@pytest.fixture
def yosys(monkeypatch, tmp_path):
    """Stand in for Yosys, which leaves `left` (name -> text) in the folder. Return what it was
    given: (files, script).
    """

    def install(module, left):
        given = []

        def run(folder, files, script, *_):
            given.append((dict(files), list(script)))
            for name, text in left.items():
                (tmp_path / name).write_text(text, encoding="utf-8")
            return tmp_path

        monkeypatch.setattr(module, "yosys_once", run)
        library = {LIBERTY: "", "abc.constr": "", "enables.v": ""}
        monkeypatch.setattr(module, "library_files", lambda: library, raising=False)
        return given

    return install


def gate_drive(text):
    """Return the drive of the cell in the Verilog of a clock gate."""
    return int(
        re.search(r"CLKGATE_X(\d+) gate \(\.CK\(clk\), \.E\(enable\), \.GCK\(gated\)", text)[1]
    )


def test_the_clock_gate_of_more_registers_is_the_stronger_cell():
    files = units_files([LARGE_GATE, SMALL_GATE]) | {"other.v": "module other; endmodule"}
    cells = bound(files)
    assert cells.keys() == files.keys() and cells["other.v"] == files["other.v"]
    large, small = (gate_drive(cells[f"{one.unit_name}.v"]) for one in (LARGE_GATE, SMALL_GATE))
    assert large > small
    assert "other.v" in bound({"other.v": ""}) and len(bound({"other.v": ""})) == 1


def test_without_clock_gates_none_are_left():
    """Also where the files had those of cells already."""
    plain = units_files([LARGE_GATE, SMALL_GATE])
    assert bound(bound(plain), gated=False) == plain
    assert any("clockgate" in line for line in cells_script("top"))
    assert not any("clockgate" in line for line in cells_script("top", gated=False))


def test_logic_is_mapped_for_a_part_of_the_cycle():
    """The goal of abc is in picoseconds: less than the cycle of the preset, and more than half."""
    cycle_ps = 1e6 / load_config("silicon").clock_mhz
    (line,) = [line for line in cells_script("top") if line.startswith("abc ")]
    goal_ps = float(re.search(r" -D (\S+)", line)[1])
    assert cycle_ps / 2 < goal_ps < cycle_ps


@pytest.mark.parametrize("gated", [True, False])
def test_a_block_has_clock_gates_only_if_it_is_asked_for_them(gated, yosys):
    """In its script and in its files; the script reads no file that is not there."""
    unit = Subgroup(SMALL)
    cells = {
        "DFF_X1": 3,
        "$scopeinfo": 5,
        "$paramod$7\\coincid_delay": 2,
        "coincid_delay": 4,
        "coincid_window": 8,
    }
    statistics = {"modules": {f"\\{unit.unit_name}": {"num_cells_by_type": cells, "area": "9.5"}}}
    given = yosys(mapped, {"stat.json": json.dumps(statistics)})
    found = map_block(unit, changed={"own.v": "module own; endmodule"}, gated=gated)
    ((files, script),) = given
    assert any("CLKGATE" in text for name, text in files.items() if name.endswith(".v")) == gated
    assert any("clockgate" in line for line in script) == gated
    (read,) = [line for line in script if line.startswith("read_verilog")]
    assert set(read.split()[2:]) == {*files} - {LIBERTY, "abc.constr", "enables.v"}
    assert files["own.v"] == "module own; endmodule"
    assert (found.name, found.area_um2) == (unit.unit_name, 9.5)
    assert found.cells == {"DFF_X1": 3}
    assert found.macros == {"coincid_delay": 6, "coincid_window": 8}


def test_slacks_are_those_at_the_clock_asked_for(monkeypatch, tmp_path):
    asked = []

    def run(command, folder, name):
        asked.append((folder / command[-1]).read_text(encoding="utf-8"))
        return answer

    monkeypatch.setattr(mapped, "run_program", run)
    (tmp_path / mapped.NETLIST).write_text("a #(\n    .N(1)\n  ) b (c);\n", encoding="utf-8")
    answer = "FLOPS\n  0.50   slack (MET)\nLATCHES\nOPENING\nENABLES\n  0.25   slack (MET)\n"
    assert slacks_ns(tmp_path, "block", 2.5) == {"FLOPS": 0.5, "ENABLES": 0.25}
    (script,) = asked
    assert "create_clock -name clk -period 2.5 [get_ports clk]" in script
    assert "link_design block" in script
    netlist = tmp_path / re.search(r"read_verilog (\S+)", script)[1]
    assert netlist.read_text(encoding="utf-8") == "a b (c);\n"
    answer = "Warning 1: odd\nError: no such cell\nFLOPS\n"
    with pytest.raises(ToolchainError, match="sta: Error: no such cell"):
        slacks_ns(tmp_path, "block", 2.5)
    answer = "FLOPS\nNo paths found.\nLATCHES\nOPENING\nENABLES\n"
    with pytest.raises(ToolchainError, match="no path in block"):
        slacks_ns(tmp_path, "block", 2.5)


GATE_BLOCKS = {
    "top": Block("top", 1, {"NAND": 2, "$_DFF_P_": 3}, levels=5),
    "coincid_a": Block("a", 7, {"NAND": 11, "$_DFF_P_": 13}, levels=17),
}
MAPPED_BLOCKS = {
    ECP5: {
        "top": Block("top", 1, {"LUT4": 19, "CCU2C": 23, "TRELLIS_FF": 29}),
        "coincid_a": Block("a", 7, {"LUT4": 31, "DP16KD": 37, "TRELLIS_FF": 41}),
        "only_here": Block("only_here", 2, {"LUT4": 43}),
    },
    CELLS: {
        "top": Block("top", 1, {"INV_X1": 47}, area_um2=53.0),
        "coincid_a": Block("a", 7, {"INV_X1": 59}, area_um2=61.0),
        "only_here": Block("only_here", 2, {"INV_X1": 67}, area_um2=71.0),
    },
}
MADE_UP = {
    "fpga": (
        "fpga",
        ["top | 1 | 2 | 3 | 5 | 19 | 23 | 0 | 29", "a | 7 | 11 | 13 | 17 | 31 | 0 | 37 | 41"],
        "only_here | 2 |  |  |  | 43 | 0 | 0 | 0",
        f"{2 + 7 * 11} | {3 + 7 * 13} | 17 | {19 + 7 * 31 + 86} | 23 | {7 * 37} | {29 + 7 * 41}",
    ),
    "silicon": (
        "silicon",
        ["top | 1 | 2 | 3 | 5 | 47 | 53", "a | 7 | 11 | 13 | 17 | 59 | 61"],
        "only_here | 2 |  |  |  | 67 | 71",
        f"{2 + 7 * 11} | {3 + 7 * 13} | 17 | {47 + 7 * 59 + 134} | {53 + 7 * 61 + 142}",
    ),
}


@pytest.mark.parametrize("preset", MADE_UP)
def test_the_last_row_of_the_cost_is_the_sum_of_all_instances(preset, monkeypatch):
    """Gates are all cells except flip-flops, in the rows and in the sum; levels do not add."""
    name, rows, other, total = MADE_UP[preset]
    made = {GATES: GATE_BLOCKS} | MAPPED_BLOCKS

    def synthesized(sensor, target, top=TOP):
        assert (top != TOP) == (target == ECP5)
        return Netlist(target, Path(), [], made[target])

    monkeypatch.setattr(synth, "synthesize", synthesized)
    monkeypatch.setattr(synth, "whole_blocks", lambda config, netlist: [f"{netlist.target} whole"])
    text = synth.report(name, load_config(preset))
    shown = [
        " | ".join(cell.strip() for cell in line.strip("|").split("|"))
        for line in text.splitlines()
        if line.startswith("|")
    ]
    assert shown[2:] == [*rows, other, f"**sensor** |  | {total}"]
    assert ("whole" in text) == (preset == "silicon")


def test_whole_blocks_are_shown_by_pixel_at_the_clock_of_the_preset(monkeypatch):
    """The pitch is the side of a square of a pixel's area; the slack is the least of all kinds."""
    config = evolve(load_config("silicon"), sensor=SMALL).with_frame(clock_mhz=400.0)
    clocks_ns = []
    cells = {"DFF_X1": 2, "DLH_X1": 3, "CLKGATE_X1": 5, "NAND2_X1": 7}

    def slacks(folder, block, clock_ns):
        clocks_ns.append(clock_ns)
        return {"FLOPS": 0.5, "LATCHES": -0.25, "ENABLES": 0.75}

    def block_of(unit, view):
        return Mapped(unit.unit_name, Path(), cells, {"coincid_delay": 11}, 1600.0)

    monkeypatch.setattr(synth, "map_block", block_of)
    monkeypatch.setattr(synth, "slacks_ns", slacks)
    monkeypatch.setattr(synth, "scan_chain", lambda netlist: "A scan chain.")
    netlist = Netlist(CELLS, Path(), ["coincid_readout_1"], {})
    lines = synth.whole_blocks(config, netlist)
    assert set(clocks_ns) == {2.5}
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in lines
        if line.startswith("| ")
    ]
    of_block = {row[0]: row[1:] for row in rows if len(row) == 11 and row[1].isdigit()}
    pixels = {"minigroup": SMALL.minigroup_pixels, "subgroup": SMALL.pixels}
    for name, number in pixels.items():
        share = 1600 / number
        shown = [f"{share:.0f}", f"{math.sqrt(share):.1f}", "-0.25", "+0.75"]
        assert of_block[name] == ["17", "2", "3", "5", "11", "1600", *shown]
    assert ["readout_1", "-0.25"] in rows


LIBRARY = "".join(
    f"  cell ({name}) {{\n    area : {area};\n  }}\n"
    for name, area in (
        ("DFF_X1", 4.0),
        ("SDFF_X1", 5.5),
        ("CLKGATE_X8", 7.0),
        ("CLKGATETST_X8", 9.25),
        ("NAND2_X1", 1.0),
    )
)


def test_a_scan_chain_goes_through_all_instances(monkeypatch):
    """Flip-flops and clock gates have another cell; their numbers add over blocks."""
    monkeypatch.setattr(synth, "library_files", lambda: {LIBERTY: LIBRARY})
    blocks = {
        "top": Block("top", 1, {"DFF_X1": 2, "NAND2_X1": 100}, area_um2=200.0),
        "a": Block("a", 10, {"DFF_X1": 3, "CLKGATE_X8": 4}, area_um2=100.0),
    }
    told = synth.scan_chain(Netlist(CELLS, Path(), [], blocks))
    assert "(40 CLKGATE_X8 by CLKGATETST_X8, 32 DFF_X1 by SDFF_X1)" in told
    more_um2 = 32 * 1.5 + 40 * 2.25
    assert f" {round(more_um2)} um2 more, {more_um2 / 1200:.1%} of the area" in told


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


CELL = """\
  cell ({name}) {{
    cell_leakage_power : 1;
    pin (A) {{ direction : input; capacitance : 2.0; }}
    pin (Z) {{ direction : output; }}
  }}
"""
FLAT = {
    "cells": {
        "inv": {"type": "INV_X1", "connections": {"A": [2], "Z": [3]}},
        "module_0.tree.inv": {"type": "INV_X1", "connections": {"A": [3], "Z": ["x"]}},
        "module_0.tree": {"type": "$scopeinfo", "connections": {}},
        "module_0": {"type": "$scopeinfo", "connections": {}},
        "module_0.inv": {"type": "INV_X1", "connections": {"A": ["1"], "Z": []}},
    },
    "netnames": {
        "clk": {"bits": [2]},
        "bus": {"bits": ["0", 3]},
        "module_0.tree.a": {"bits": [3]},
    },
}


@pytest.fixture
def small_design(monkeypatch, tmp_path, yosys):
    library = "nom_voltage : 1.25;\n" + "".join(
        CELL.format(name=name) for name in ("INV_X1", "BUF_X4")
    )
    flat = json.dumps({"modules": {TOP: FLAT}})
    (tmp_path / LIBERTY).write_text(library, encoding="utf-8")
    (tmp_path / power.NETLIST).write_text("", encoding="utf-8")
    yosys(power, {power.FLAT: flat, LIBERTY: library})
    synthesized = Netlist(CELLS, tmp_path, [], {})
    monkeypatch.setattr(power, "synthesize", lambda sensor, target: synthesized)
    return power.design(SMALL)


def test_cells_of_a_flat_netlist_belong_to_the_blocks_in_their_names(small_design):
    """Blocks in blocks, too. Constants and open pins are no nets."""
    instances = [(one.block, one.kind, one.nets) for one in small_design.instances]
    assert instances == [
        ("", "INV_X1", {"A": 2, "Z": 3}),
        ("module_0.tree", "INV_X1", {"A": 3}),
        ("module_0", "INV_X1", {}),
    ]
    assert small_design.scopes == ["", "module_0", "module_0.tree"]
    assert small_design.names == {2: [("clk", 0)], 3: [("bus", 1), ("module_0.tree.a", 0)]}
    assert small_design.library.keys() == {"INV_X1", "BUF_X4"}
    assert small_design.supply_v == 1.25


def test_transitions_are_counted_in_all_blocks_over_the_cycles_of_the_clock(
    small_design, monkeypatch, tmp_path
):
    """The clock's cycle is 2.5 ns, and the frame ends with the last cycle of its last period."""
    config = evolve(load_config("silicon"), sensor=SMALL)
    config = config.with_frame(clock_mhz=400.0, period=60, pulses=1, frames=1)
    dumped = []

    def build(sensor, target, scopes):
        dumped.append((target, list(scopes)))

    def play(build, frames, out):
        out.mkdir(parents=True)
        end_ps = 5000 + config.frame_cycles * 2500
        lines = [
            f"$scope module {TOP} $end $var wire 1 ! laser $end $var wire 1 $ rst $end",
            "$var wire 1 # net $end $upscope $end $enddefinitions $end",
            "#0 0! 1$ 0#",
            "#2500 0$",
            "#5000 1! 1#",
            "#7500 0! 0#",
            f"#{end_ps - 1} 1#",
            f"#{end_ps} 0#",
        ]
        (out / f"{TOP}.vcd").write_text("\n".join([*lines, ""]), encoding="utf-8")

    monkeypatch.setattr(power, "netlist_build", build)
    monkeypatch.setattr(power, "play_in", play)
    monkeypatch.setattr(power, "build_root", lambda: tmp_path / "root")
    toggles = power.count_toggles(SMALL, [FrameJob(config, None)])
    assert dumped == [(CELLS, [TOP, f"{TOP}.module_0", f"{TOP}.module_0.tree"])]
    assert {name: int(counts.sum()) for name, counts in toggles.items()} == {
        "laser": 2,
        "rst": 0,
        "net": 3,
    }
    assert all(isinstance(counts, np.ndarray) for counts in toggles.values())


BOARD = pnr.Board(
    title="",
    page="",
    command="",
    what="",
    chip="",
    top="top",
    files={"top.v": "module top; endmodule"},
    pins="LOCATE",
    device=("--85k",),
    goal_mhz=80.0,
    options="-nobram",
    apart=("one", "other"),
)


def test_no_placement_is_taken_for_another(monkeypatch, tmp_path):
    """Whatever changes the placement makes a new one, also a netlist of the same design."""
    runs = []

    def run(package, function, options, folder):
        runs.append((function, list(options), sorted(path.name for path in folder.iterdir())))
        return "log"

    monkeypatch.setattr(pnr, "run_wheel", run)
    netlists = [tmp_path / name for name in ("top-1", "top-2")]
    for folder in netlists:
        folder.mkdir()
        (folder / pnr.NETLIST).write_text(folder.name, encoding="utf-8")
    usual = (BOARD, netlists[0], 3)
    others = [
        (BOARD, netlists[1], 3),
        (BOARD, netlists[0], 4),
        (evolve(BOARD, pins="OTHER"), netlists[0], 3),
        (evolve(BOARD, device=("--45k",)), netlists[0], 3),
        (evolve(BOARD, goal_mhz=80.5), netlists[0], 3),
    ]
    placed = [pnr.place_and_route(*case) for case in (usual, *others)]
    assert len({one.folder for one in placed}) == len(placed)
    assert [one.seed for one in placed] == [3, 3, 4, 3, 3, 3]
    assert pnr.place_and_route(*usual).folder == placed[0].folder
    assert (placed[1].folder / pnr.NETLIST).read_text(encoding="utf-8") == "top-2"
    assert (placed[3].folder / pnr.PINS).read_text(encoding="utf-8") == "OTHER"
    (function, options, there), (packer, _, _) = runs[:2]
    assert (function, packer, len(runs)) == ("run_nextpnr_ecp5", "run_ecppack", 2 * len(placed))
    assert there == sorted((pnr.PINS, pnr.NETLIST))
    assert options[0] == "--85k"
    assert options[options.index("--seed") + 1] == "3"
    assert options[options.index("--freq") + 1] == "80"


def test_the_synthesis_for_a_board_follows_its_description(yosys):
    given = yosys(pnr, {})
    pnr.synthesize(BOARD)
    ((files, script),) = given
    assert files == BOARD.files and script[0] == "read_verilog top.v"
    kept = [line.split()[-1] for line in script if "keep_hierarchy 1" in line]
    assert kept == ["one", "other"]
    steps = [line for line in script if line.startswith("synth_lattice")]
    assert len(steps) == 2
    assert all(" -nobram " in line and " -top top " in line for line in steps)
    assert max(script.index(line) for line in script if "keep_hierarchy" in line) < script.index(
        steps[0]
    )
