# SPDX-License-Identifier: Apache-2.0
"""Flows on one small block: the cells and depth of its netlist, and its behaviour."""

import json
import re
import subprocess

import pytest
from attrs import evolve

from coincid.flow import pnr
from coincid.flow.gls import cell_models, gate_level
from coincid.flow.liberty import cell_areas
from coincid.flow.logic_depth import depths
from coincid.flow.silicon_report import CLOCKS, timing, write
from coincid.flow.smoke import SMOKE, smoke_test
from coincid.flow.synth import CELLS, ECP5, GATES, Block, Netlist, scan_chain, synthesize
from coincid.flow.yosys import LIBERTY, cells_folder
from coincid.hdl.silicon.circuit import Circuit
from coincid.tools.build import ToolchainError
from coincid.tools.wheels import run_yosys

from ..command import command
from .sensors import SMALL

LEAN_SMALL = evolve(SMALL, offsets=0, records=0, controller=0, counter_bits=9, held=0)
TOY = """
module leaf(input clk, input [7:0] a, output reg q);
  always @(posedge clk) q <= ^a;
endmodule
module toy(input clk, input [7:0] a, output reg [3:0] n);
  wire q;
  leaf parity(clk, a, q);
  always @(posedge clk) n <= {n[2:0], q & n[3]};
endmodule
"""
TO_GATES = (
    "dfflegalize -cell $_DFF_P_ x",
    "abc -g AND,XOR",
    "flatten",
    "opt_clean",
    "write_json toy.json",
)


def test_depth_by_block(tmp_path):
    (tmp_path / "toy.v").write_text(TOY, encoding="utf-8")
    run_yosys(
        tmp_path,
        "read_verilog toy.v",
        "hierarchy -top toy",
        "proc",
        "synth -noabc -top toy",
        *TO_GATES,
    )
    found = depths(
        json.loads((tmp_path / "toy.json").read_text(encoding="utf-8"))["modules"]["toy"]
    )
    assert found == {"": 1, "parity": 3}  # an AND; eight inputs, three levels of XOR


def test_a_path_ends_at_the_port_of_a_block_that_stays():
    """Two gates lead to a block, and one from it to an output."""
    gate = {"type": "$_AND_", "port_directions": {"A": "input", "B": "input", "Y": "output"}}
    block = {"type": "memory", "port_directions": {"d": "input", "q": "output"}}
    cells = {
        "g": gate | {"connections": {"A": [2], "B": [3], "Y": [4]}},
        "h": gate | {"connections": {"A": [4], "B": [3], "Y": [5]}},
        "inner": block | {"connections": {"d": [5], "q": [6]}},
        "k": gate | {"connections": {"A": [6], "B": [2], "Y": [7]}},
    }
    ports = {
        "a": {"direction": "input", "bits": [2, 3]},
        "y": {"direction": "output", "bits": [7]},
    }
    assert depths({"cells": cells, "ports": ports}) == {"": 2}


def gates_in_a_row(*kinds):
    """Return cells from net 2 on, each behind the one before it."""
    return {
        f"gate_{n}": {
            "type": kind,
            "port_directions": {"A": "input", "Y": "output"},
            "connections": {"A": [n], "Y": [n + 1]},
        }
        for n, kind in enumerate(kinds, 2)
    }


@pytest.mark.parametrize("free", ["$_NOT_", "$_BUF_"])
def test_inverters_and_buffers_are_no_levels(free):
    cells = gates_in_a_row(free, "$_AND_", free, free, "$_MUX_", free)
    ports = {
        "a": {"direction": "input", "bits": [2]},
        "y": {"direction": "output", "bits": [8]},
    }
    assert depths({"cells": cells, "ports": ports}) == {"": 2}


@pytest.mark.parametrize(
    ("name", "block"),
    [
        (r"$auto$ff$1", ""),
        (r"$flatten\a.$auto$ff$1", "a"),
        (r"$flatten\a.\b.$auto$ff$1", "a.b"),
        (r"$flatten\a.\b_2.\c.$procdff$3", "a.b_2.c"),
    ],
)
def test_a_register_is_one_of_the_innermost_block_that_holds_it(name, block):
    """Its depth is that of its data."""
    flop = {
        "type": "$_DFF_P_",
        "port_directions": {"D": "input", "Q": "output", "C": "input"},
        "connections": {"D": [4], "Q": [9], "C": [2]},
    }
    cells = gates_in_a_row("$_AND_", "$_OR_") | {name: flop}
    ports = {"a": {"direction": "input", "bits": [2]}}
    assert depths({"cells": cells, "ports": ports}) == {block: 2}


def test_a_loop_is_reported():
    gate = {"type": "$_AND_", "port_directions": {"A": "input", "B": "input", "Y": "output"}}
    pins = {"g": {"A": [2], "B": [4], "Y": [3]}, "h": {"A": [3], "B": [2], "Y": [4]}}
    cells = {name: gate | {"connections": of} for name, of in pins.items()}
    ports = {"a": {"direction": "input", "bits": [2]}, "y": {"direction": "output", "bits": [4]}}
    with pytest.raises(ValueError, match="loop"):
        depths({"cells": cells, "ports": ports})


def test_yosys_errors_are_told(tmp_path):
    with pytest.raises(ToolchainError, match="no-such-command"):
        run_yosys(tmp_path, "no-such-command")


def test_a_long_log_of_yosys_is_told_from_its_end(tmp_path):
    """Where the error is."""
    lines = [f"log line {number}." for number in range(100)]
    with pytest.raises(ToolchainError) as told:
        run_yosys(tmp_path, *lines, "no-such-command")
    text = str(told.value)
    assert "no-such-command" in text
    assert "line 99." in text and "line 0." not in text


@pytest.mark.long
def test_blocks_of_a_small_sensor():
    gates, fpga = synthesize(SMALL, GATES), synthesize(SMALL, ECP5)
    minigroup = gates.blocks["coincid_minigroup"]
    assert minigroup.instances == SMALL.minigroups
    assert minigroup.flops > 2 * SMALL.minigroup_pixels * (SMALL.phase_bits + 1)
    assert all(1 <= block.levels <= 20 for name, block in gates.blocks.items() if block.total > 200)
    flops = sum(block.instances * block.flops for block in gates.blocks.values())
    assert gates.total(lambda block: block.flops) == flops
    assert set(fpga.blocks) == set(gates.blocks)
    assert fpga.total(lambda block: block.count("LUT4")) > 500
    assert fpga.total(lambda block: block.flops) < flops  # memories are RAM there


@pytest.mark.needs("cells")
def test_cost_of_a_scan_chain(tmp_path):
    cells = {"DFF_X1": 100, "NAND2_X1": 7, "CLKGATE_X8": 2, "DLH_X1": 50}
    block = Block(name="block", instances=3, cells=cells, area_um2=1000.0)
    told = scan_chain(Netlist(CELLS, tmp_path, [], {"top": block}))
    areas = cell_areas((cells_folder() / LIBERTY).read_text(encoding="utf-8"))
    more = 300 * (areas["SDFF_X1"] - areas["DFF_X1"])
    more += 6 * (areas["CLKGATETST_X8"] - areas["CLKGATE_X8"])
    assert "300 DFF_X1 by SDFF_X1" in told and "6 CLKGATE_X8 by CLKGATETST_X8" in told
    assert f"{round(more)} um2 more, {more / 3000:.1%} of the area" in told
    assert more > 400


@pytest.mark.long
@pytest.mark.parametrize("target", [GATES, pytest.param(CELLS, marks=pytest.mark.needs("cells"))])
def test_netlist_behaves(target):
    checked, cycles = gate_level(SMALL, target, frames=4)
    assert checked > 200 and cycles > 1000


@pytest.mark.long
@pytest.mark.parametrize("sensor", [SMALL, LEAN_SMALL], ids=["polyphase", "lean"])
@pytest.mark.parametrize("target", [GATES, pytest.param(CELLS, marks=pytest.mark.needs("cells"))])
def test_netlist_comes_from_unknown_values(sensor, target, tmp_path):
    """Nothing is known at power-on, and a reset defines what matters: the smoke test of the export
    passes.
    """
    models = tmp_path / "models.v"
    models.write_text(without_random_values(cell_models(target)), encoding="utf-8")
    bench = tmp_path / "smoke.v"
    bench.write_text(smoke_test(sensor), encoding="utf-8")
    netlist = synthesize(sensor, target).folder / "netlist.v"
    text = netlist.read_text(encoding="utf-8")
    assert not re.search(r"^\s*reg .* = |^\s*initial", text, re.MULTILINE)
    program = tmp_path / "smoke.vvp"
    compiled = ["iverilog", "-g2012", "-s", SMOKE, "-o", program, netlist, models, bench]
    subprocess.run(compiled, check=True)
    done = subprocess.run(["vvp", "-n", program], capture_output=True, encoding="utf-8")
    assert re.fullmatch(r"PASS: \d+ checks\n", done.stdout), done.stdout[-2000:]


def without_random_values(models: str) -> str:
    """Return models of cells whose flip-flops and latches begin with X, and keep an X."""
    text = re.sub(r"^ *initial \w+ = \$random;\n", "", models, flags=re.MULTILINE)
    text = re.sub(r"(\w+) === 1'b0 \|\| \1 === 1'b1 \? \1 : \$random", r"\1", text)
    assert "$random" not in text
    return text


@pytest.mark.needs("cells")
def test_a_timing_tool_takes_the_constraints_of_the_asynchronous_view(tmp_path):
    """OpenSTA accepts the constraints (`write` raises if it complains), and every clock has a timed
    path.
    """
    top, report, sdc = write(SMALL, Circuit(), tmp_path)
    text = report.read_text(encoding="utf-8")
    lines = text[text.index("| from clock") :].splitlines()
    rows = {tuple(line.strip("| ").split(" | ")[:2]) for line in lines if line.startswith("| ")}
    assert {clock for pair in rows for clock in pair} >= set(CLOCKS)
    assert {
        ("clk", "spads"),
        ("clk", "roots"),
        ("spads", "clk"),
        ("roots", "clk"),
        ("ends", "clk"),
    } <= rows
    sdc.write_text(
        sdc.read_text(encoding="utf-8").replace("*window_*/ended", "*no_such_pin*/ended"),
        encoding="utf-8",
    )
    complaints, _ = timing(tmp_path, top, sdc.name)
    assert any("no_such_pin" in line for line in complaints)


@pytest.mark.long
def test_pnr_names_the_seed_that_misses(monkeypatch, tmp_path):
    """The clock, or the delays from a SPAD's line to its samplers: a tick of the preset is 1 ns."""

    def sampled(line, delays):
        endpoints = [{"delay": [delay, delay]} for delay in delays]
        return {"driver": f"{line}$tr_io", "event": pnr.ASYNCHRONOUS, "endpoints": endpoints}

    def placed(board, netlist, seed):
        folder = tmp_path / str(seed)
        folder.mkdir(exist_ok=True)
        hop = {"type": "logic", "delay": 7.9, "from": {"cell": "a"}, "to": {"cell": "b"}}
        used = dict.fromkeys(pnr.USED, {"used": 1, "available": 2})
        fmax = {
            "$glbnet$clk": {"achieved": reached_mhz if seed == 3 else 130.0, "constraint": 125.0}
        }
        path = {"from": "posedge clk", "to": "posedge clk", "path": [hop]}
        nets = [
            sampled("spad[0]", [2.0, 2.5, 2.9]),
            sampled("spad[1]", [3.0, 3.0 + (skew if seed == 2 else 0.1)]),
            sampled("rst_in", [1.0, 9.0]),
        ]
        report = {"fmax": fmax, "utilization": used, "critical_paths": [path]}
        report["detailed_net_timings"] = nets
        (folder / "report.json").write_text(json.dumps(report), encoding="utf-8")
        (folder / pnr.BITSTREAM).write_bytes(b"bits")
        return pnr.Placement(seed, folder)

    monkeypatch.setattr(pnr, "synthesize", lambda board: tmp_path)
    monkeypatch.setattr(pnr, "place_and_route", placed)
    too_skewed = "warning: seed 2: the delays of spad[1] to its samplers differ by 1.20 ns"
    for reached_mhz, skew, code, complaint in (
        (125.1, 0.5, 0, ""),
        (124.9, 0.5, 1, "seed 3: clk reaches 124.9 MHz"),
        (125.1, 1.2, 0, too_skewed),
    ):
        result = command("pnr --out", tmp_path / "page.md")
        assert result.exit_code == code
        assert complaint in result.stderr and bool(result.stderr) == bool(complaint)
        page = (tmp_path / "page.md").read_text(encoding="utf-8")
        assert f"| clk | 130.0 | 130.0 | {reached_mhz} | 130.0 | 130.0 |" in page
        told = " ".join(page.split())
        assert f"differ by at most {max(skew, 0.9):.2f} ns" in told
        assert f"for {int(skew > 1)} of 10 lines" in told


def test_a_constant_is_no_level():
    """Gates count from the inputs and registers on, also where one of their own is a constant."""
    gate = {"type": "$_AND_", "port_directions": {"A": "input", "B": "input", "Y": "output"}}
    plain = {"type": "$_NOT_", "port_directions": {"A": "input", "Y": "output"}}
    cells = {
        "g": gate | {"connections": {"A": [2], "B": ["1"], "Y": [3]}},
        "h": gate | {"connections": {"A": ["0"], "B": ["x"], "Y": [4]}},
        "n": plain | {"connections": {"A": [4], "Y": [5]}},
    }
    ports = {
        "a": {"direction": "input", "bits": [2]},
        "y": {"direction": "output", "bits": [3, 5, "1"]},
    }
    assert depths({"cells": cells, "ports": ports}) == {"": 1}
