# SPDX-License-Identifier: Apache-2.0
"""What is told about placements with several seeds, from nextpnr's reports, written by hand."""

import json
import os
import re
import signal
import threading
import time

import numpy as np
import pytest
from attrs import evolve

from coincid.flow import fpga_module, pnr
from coincid.flow.pnr import (
    ASYNCHRONOUS,
    BITSTREAM,
    Board,
    Placement,
    fastest,
    missed,
    skewed,
    write_placement_page,
)
from coincid.flow.ports import port_rows
from coincid.hdl.sensor import FPGA_TOP
from coincid.model.contract.config import load_config
from coincid.model.shared.interrupts import PROGRAMS
from coincid.tools.wheels import run_program

from ..hdl.test_memory import simulated

BOARD = Board(
    title="Placement",
    page="page.md",
    command="coincid pnr",
    what="a design",
    chip="ECP5",
    top="top",
    files={},
    pins="",
    device=(),
    goal_mhz=100.0,
    sampled="spad",
    tick_ns=1.5,
)


@pytest.fixture
def placed(tmp_path):
    """Return a placement with these frequencies of its clocks in MHz."""

    def placed(seed, **fmax_mhz):
        folder = tmp_path / str(seed)
        folder.mkdir()
        fmax = {f"$glbnet${clock}": {"achieved": mhz} for clock, mhz in fmax_mhz.items()}
        (folder / "report.json").write_text(json.dumps({"fmax": fmax}), encoding="utf-8")
        return Placement(seed, folder)

    return placed


def test_the_fastest_placement_is_that_whose_slowest_clock_is_the_fastest(placed):
    """Neither that with the fastest clock of all, nor the fastest on average."""
    uneven = placed(1, bus=90, sensor=300)
    even = placed(2, bus=101, sensor=102)
    slow = placed(3, bus=99, sensor=99)
    assert fastest([uneven, even, slow]) is even
    assert fastest([slow, uneven]) is slow


@pytest.fixture
def routed(tmp_path):
    """Return a placement with these paths, used resources and nets in nextpnr's report."""

    def routed(seed, paths, fmax_mhz, nets=()):
        folder = tmp_path / str(seed)
        folder.mkdir()
        report = {
            "fmax": {net: {"achieved": mhz} for net, mhz in fmax_mhz.items()},
            "critical_paths": paths,
            "utilization": {
                "TRELLIS_COMB": {"used": 31, "available": 47},
                "DCCA": {"used": 3, "available": 5},
                "DP16KD": {"used": 7, "available": 11},
            },
            "detailed_net_timings": list(nets),
        }
        (folder / "report.json").write_text(json.dumps(report), encoding="utf-8")
        (folder / BITSTREAM).write_bytes(bytes(100 + seed))
        return Placement(seed, folder)

    return routed


def path(clock, to, *delays_ns):
    """Return a path through cells `CLOCK_0`, `CLOCK_1`, ... with a wire behind the first."""
    hops = [
        {
            "type": "routing" if n == 1 else "logic",
            "delay": delay_ns,
            "from": {"cell": f"{clock}_{n}"},
            "to": {"cell": f"{clock}_{n + 1}"},
        }
        for n, delay_ns in enumerate(delays_ns)
    ]
    return {"from": clock, "to": to, "path": hops}


def net(driver, event, *delays_ns):
    """Return a net with two delays at each of its ends."""
    ends = [{"delay": list(pair)} for pair in zip(delays_ns[::2], delays_ns[1::2], strict=True)]
    return {"driver": driver, "event": event, "endpoints": ends}


NETS = (
    net("spad[0]$tr_io", ASYNCHRONOUS, 2.0, 2.2, 2.7, 2.5),
    net("spad[1]$tr_io", ASYNCHRONOUS, 4.5, 3.0, 3.5, 3.25),
    net("spad[2]$tr_io", "posedge clk", 1.0, 9.0),
    net("other[0]$tr_io", ASYNCHRONOUS, 1.0, 8.0),
)


def test_the_longest_path_is_one_between_registers_of_one_clock(routed):
    """Not a path between two clocks, nor that with the most hops."""
    paths = [path("a", "a", 1.5, 2.25), path("b", "b", 1, 1, 1), path("a", "b", 9.0)]
    assert routed(1, paths, {}).longest == paths[0]
    assert routed(2, [paths[1], paths[2]], {}).longest == paths[1]


def test_clocks_have_their_names_in_the_verilog(routed):
    placed = routed(1, [], {"$glbnet$clk": 101.0, "$glbnet$bus$TRELLIS": 55.0, "sampler": 77.0})
    assert placed.fmax_mhz == {"clk": 101.0, "bus$TRELLIS": 55.0, "sampler": 77.0}


def test_the_skew_of_a_line_is_that_of_all_its_samplers(routed):
    """Not of lines of other ports, nor of a net with a clock."""
    assert routed(1, [], {}, NETS).skews_ns("spad") == pytest.approx(
        {"spad[0]": 0.7, "spad[1]": 1.5}
    )


def test_a_goal_that_is_just_reached_is_not_missed(routed):
    """A line to its samplers, however, must arrive less than a tick apart."""
    placements = [
        routed(4, [], {"clk": 100.0, "bus": 99.94}, NETS),
        routed(6, [], {"clk": 80.0, "bus": 130.0}),
    ]
    assert missed(BOARD, placements) == [
        "seed 4: bus reaches 99.9 MHz, must be 100",
        "seed 6: clk reaches 80.0 MHz, must be 100",
    ]
    complaint = "the delays of spad[1] to its samplers differ by 1.50 ns, must be less than 1.5"
    assert skewed(BOARD, placements) == [f"seed 4: {complaint}"]
    assert skewed(evolve(BOARD, sampled=""), placements) == []


def test_the_page_tells_the_longest_path_of_all_seeds(routed, tmp_path):
    placements = [
        routed(4, [path("a", "a", 1.5, 2.25)], {"clk": 101.0, "bus": 131.0}, NETS),
        routed(6, [path("b", "b", 2.0, 1.0, 0.75, 0.5)], {"clk": 102.0, "bus": 132.0}, NETS[:1]),
    ]
    page = tmp_path / "page.md"
    write_placement_page(BOARD, placements, page)
    text = page.read_text(encoding="utf-8")
    told = " ".join(text.split())
    assert "places a design on an ECP5. It places one netlist with 2 seeds" in told
    assert "must reach 100 MHz with each seed. The bitstream has 104 bytes." in told
    longest = "takes 4.25 ns, with seed 6. It passes 3 cells from `b_0` to `b_4`."
    assert f"The longest path {longest}" in told
    assert "of `spad` to its samplers differ by at most 1.50 ns" in told
    assert "for 1 of 3 lines, by a tick (1.5 ns) or more" in told
    tables = [line for line in text.splitlines() if line.startswith("| ")]
    assert [line for line in tables if "---" not in line] == [
        "| Fmax in MHz of | seed 4 | seed 6 |",
        "| bus | 131.0 | 132.0 |",
        "| clk | 101.0 | 102.0 |",
        "| resource | used | of |",
        "| TRELLIS_COMB | 31 | 47 |",
        "| DP16KD | 7 | 11 |",
    ]


def test_a_design_is_synthesized_with_its_options_and_its_modules_apart(monkeypatch, tmp_path):
    got = []
    monkeypatch.setattr(pnr, "yosys_once", lambda *given: got.append(given) or tmp_path)
    files = {"a.v": "module a;", "b.v": "module b;"}
    board = evolve(BOARD, files=files, options="-noccu2", apart=("a", "b"))
    assert pnr.synthesize(board) == tmp_path
    (_, given, script) = got[0]
    assert given == files
    steps = "synth_lattice -family ecp5 -noccu2 -top top -run"
    keep = "setattr -mod -set keep_hierarchy 1"
    assert script == [
        "read_verilog a.v b.v",
        f"{keep} a",
        f"{keep} b",
        f"{steps} begin:map_luts",
        "abc9 -W 900",
        "clean",
        f"{steps} map_cells:",
        "write_json netlist.json",
        "write_verilog -noattr netlist.v",
    ]


def test_every_seed_places_the_same_netlist_for_the_goal(monkeypatch, tmp_path):
    """With a folder of its own, in which are pins, log and bitstream."""
    netlist = tmp_path / "netlist"
    netlist.mkdir()
    (netlist / pnr.NETLIST).write_text("cells", encoding="utf-8")

    def run_wheel(wheel, name, options, folder):
        (folder / name).write_text(" ".join(options), encoding="utf-8")
        return f"log of {name}"

    monkeypatch.setattr(pnr, "synthesize", lambda board: netlist)
    monkeypatch.setattr(pnr, "run_wheel", run_wheel)
    board = evolve(BOARD, pins="LOCATE", device=("--85k", "--package", "CABGA"))
    placements = pnr.place(board)
    assert [placement.seed for placement in placements] == [1, 2, 3, 4, 5]
    assert len({placement.folder for placement in placements}) == 5
    for placement in placements:
        folder = placement.folder
        options = (folder / "run_nextpnr_ecp5").read_text(encoding="utf-8")
        assert options.startswith(f"--85k --package CABGA --seed {placement.seed} --freq 100 ")
        assert "--timing-allow-fail --lpf-allow-unconstrained" in options
        assert "--json netlist.json --lpf board.lpf --report report.json" in options
        assert options.endswith("--detailed-timing-report --textcfg board.config")
        packed = (folder / "run_ecppack").read_text(encoding="utf-8")
        assert packed == f"board.config {BITSTREAM}"
        assert (folder / pnr.PINS).read_text(encoding="utf-8") == "LOCATE"
        assert (folder / pnr.NETLIST).read_text(encoding="utf-8") == "cells"
        told = (folder / "nextpnr.log").read_text(encoding="utf-8")
        assert told == "log of run_nextpnr_ecp5"


def test_an_interrupt_of_a_placement_ends_its_programs(monkeypatch, tmp_path):
    """Those that run, and the seeds that wait do not begin."""
    (tmp_path / "netlist").mkdir()
    (tmp_path / "netlist" / pnr.NETLIST).write_text("cells", encoding="utf-8")
    begun, ended = tmp_path / "begun", tmp_path / "ended"

    def run_wheel(wheel, name, options, folder):
        return run_program(["sh", "-c", f"touch {begun}; sleep 9; touch {ended}"], folder, name)

    def interrupt():
        while not begun.exists():
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(pnr, "synthesize", lambda board: tmp_path / "netlist")
    monkeypatch.setattr(pnr, "run_wheel", run_wheel)
    interrupting = threading.Thread(target=interrupt)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a parent may ignore it
    interrupting.start()
    with pytest.raises(KeyboardInterrupt):
        pnr.place(BOARD)
    interrupting.join()
    signal.signal(signal.SIGINT, before)
    assert not ended.exists() and not PROGRAMS
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == ["netlist"]


def test_the_page_of_the_module_has_all_its_placements(monkeypatch):
    written = []
    monkeypatch.setattr(fpga_module, "fpga_module", lambda: BOARD)
    monkeypatch.setattr(fpga_module, "place", lambda board: [f"{board.top} {n}" for n in range(3)])
    monkeypatch.setattr(fpga_module, "write_placement_page", lambda *given: written.append(given))
    fpga_module.place_fpga_module()
    assert written == [(BOARD, ["top 0", "top 1", "top 2"])]


# pads of a chip with four columns and three rows, in no order: side by side, as a board sees them
PADS_IN_ORDER = [
    ("L2A", 2, 0, "A"), ("L2B", 2, 0, "B"), ("L1A", 1, 0, "A"),
    ("T1A", 0, 1, "A"), ("T1B", 0, 1, "B"), ("T2A", 0, 2, "A"),
    ("R1A", 1, 3, "A"), ("R2A", 2, 3, "A"), ("R2B", 2, 3, "B"),
    ("B2A", 3, 2, "A"), ("B1A", 3, 1, "A"), ("B1B", 3, 1, "B"),
]  # fmt: skip
OF_WRAPPER = """\
// a wrapper
module coincid_ecp5 (
  input clk_in,
  input rst_in,
  input [3:0] spad,
  output [1:0] said,
  output last
);
"""


@pytest.fixture
def module_of(monkeypatch, tmp_path):
    """Return the board of the module for a made-up chip; the Verilog is left out."""
    sites = {
        name: {"row": row, "col": col, "pio": pio}
        for name, row, col, pio in sorted(PADS_IN_ORDER, reverse=True)
    }
    pads = tmp_path / fpga_module.PADS
    pads.parent.mkdir(parents=True)
    packages = {fpga_module.PACKAGE: sites, "OTHER": {"X": {"row": 9, "col": 99, "pio": "A"}}}
    pads.write_text(json.dumps({"packages": packages}), encoding="utf-8")
    wrapper = tmp_path / "ecp5.v"
    wrapper.write_text(OF_WRAPPER, encoding="utf-8")
    sensors = []

    def files_of(names):
        def files(sensor):
            sensors.append(sensor)
            return dict.fromkeys(names, "")

        return files

    own = [fpga_module.FILE_LIST, f"{fpga_module.TOP}.v", "coincid_tree.v"]
    monkeypatch.setattr(fpga_module, "verilog_files", files_of(own))
    monkeypatch.setattr(fpga_module, "fpga_files", files_of(["coincid_fpga.v"]))
    monkeypatch.setattr(fpga_module, "wheel_folder", lambda wheel: tmp_path)
    monkeypatch.setattr(fpga_module, "WRAPPER", wrapper)
    board = fpga_module.fpga_module()
    assert len(set(sensors)) == 1
    return board, sensors[0]


def test_the_module_that_is_placed_is_that_of_the_preset(module_of):
    """Its tick, in which the lines of a SPAD must arrive, is that of its clock and phases."""
    board, sensor = module_of
    preset = load_config("fpga")
    assert evolve(sensor, rows=preset.sensor.rows, cols=preset.sensor.cols) == preset.sensor
    assert sensor.subgroups == 2 and "two subgroups" in board.what
    assert board.goal_mhz == preset.clock_mhz
    assert board.tick_ns == pytest.approx(preset.tick_s * 1e9)
    assert f" {board.sampled}" in OF_WRAPPER and board.top in OF_WRAPPER
    assert board.files == {"coincid_tree.v": "", "coincid_fpga.v": "", "ecp5.v": OF_WRAPPER}
    assert fpga_module.PACKAGE in board.device and fpga_module.PACKAGE in board.chip


def test_ports_of_the_module_lie_along_the_edge_of_the_chip_bit_by_bit(module_of):
    """From the lower left corner upwards and round; the placer chooses the pin of the clock."""
    board, _ = module_of
    located = re.findall(r'^LOCATE COMP "(.*)" SITE "(.*)";$', board.pins, re.MULTILINE)
    ports = ["rst_in", *(f"spad[{k}]" for k in range(4)), "said[0]", "said[1]", "last"]
    pads = [name for name, *_ in PADS_IN_ORDER]
    assert located == list(zip(ports, pads, strict=False))
    assert len(board.pins.splitlines()) == len(ports)


def connected(text, instance):
    """Return what an instance in a Verilog text has at each of its ports."""
    _, _, ports = text.partition(f" {instance} (")
    ports, ended, _ = ports.partition("\n  );")
    assert ended
    return dict(re.findall(r"\.(\w+)\(([^()]*)\)", ports))


def test_the_wrapper_has_a_pin_for_every_port_of_the_module():
    """Of the same name, width and direction; SPADs follow one another, subgroup by subgroup."""
    text = fpga_module.WRAPPER.read_text(encoding="utf-8")
    head, _, _ = text.partition(");")
    declared = re.findall(r"^  (in|out)put (?:\[(\d+):0\] )?(\w+)", head, re.MULTILINE)
    pins = {name: (way, int(high or 0) + 1) for way, high, name in declared}
    sensor = evolve(load_config("fpga").sensor, rows=8, cols=16)
    ports = {row.name: (row.direction, row.width) for row in port_rows(sensor, FPGA_TOP)}
    found = connected(text, "sensor")
    assert found.keys() == ports.keys()
    own = {"clk": "clk", "rst": "reset[1]", "phase_clocks": "phase_clocks", "test_enable": "1'b0"}
    own |= {"line_0": "spad[63:0]", "line_1": "spad[127:64]"}
    own |= {"s_axi_awprot": "3'd0", "s_axi_arprot": "3'd0"}
    assert {name: found[name] for name in own} == own
    for name in ports.keys() - own.keys():
        assert (found[name], pins[name]) == (name, ports[name])
    assert pins.keys() - ports.keys() == {"clk_in", "rst_in", "spad"}


def test_the_wrappers_clocks_come_a_tick_after_one_another():
    """The oscillator runs at the output's divider times the clock; its phases count in periods and
    eighths of a period.
    """
    text = fpga_module.WRAPPER.read_text(encoding="utf-8")
    preset = load_config("fpga")
    values = {name: int(number) for name, number in re.findall(r"\.(CLK\w+)\((\d+)\)", text)}
    outputs = "CLKOP", "CLKOS", "CLKOS2", "CLKOS3"
    assert values["CLKI_DIV"] == values["CLKFB_DIV"] == 1
    assert len({values[f"{name}_DIV"] for name in outputs}) == 1
    oscillator_ns = 1000 / preset.clock_mhz / values["CLKOP_DIV"]
    after_ns = [
        oscillator_ns * (values[f"{name}_CPHASE"] + values[f"{name}_FPHASE"] / 8)
        for name in outputs
    ]
    tick_ns = preset.tick_s * 1e9
    assert np.diff(after_ns) == pytest.approx([tick_ns] * (preset.sensor.phases // 2 - 1))
    pll = connected(text, "pll")
    clocks = {"CLKI": "clk_in", "CLKFB": "clk", "CLKOP": "clk", "LOCK": "locked"}
    clocks |= {name: f"phase_clocks[{k}]" for k, name in enumerate(outputs[1:])}
    assert clocks.items() <= pll.items()


# In place of the sensor and the PLL: the bench shows the reset of the one, and what the other is
# told; it locks after some cycles.
OF_THE_WRAPPER = """
module EHXPLLL #(
  parameter CLKI_DIV = 0, CLKFB_DIV = 0, FEEDBK_PATH = "", CLKOP_ENABLE = "", CLKOP_DIV = 0,
  parameter CLKOP_CPHASE = 0, CLKOP_FPHASE = 0, CLKOS_ENABLE = "", CLKOS_DIV = 0, CLKOS_CPHASE = 0,
  parameter CLKOS_FPHASE = 0, CLKOS2_ENABLE = "", CLKOS2_DIV = 0, CLKOS2_CPHASE = 0, CLKOS2_FPHASE = 0,
  parameter CLKOS3_ENABLE = "", CLKOS3_DIV = 0, CLKOS3_CPHASE = 0, CLKOS3_FPHASE = 0
) (
  input CLKI, CLKFB, RST, STDBY, PHASESEL0, PHASESEL1, PHASEDIR, PHASESTEP, PHASELOADREG, PLLWAKESYNC,
  input ENCLKOP, output CLKOP, CLKOS, CLKOS2, CLKOS3, output reg LOCK
);
  assign CLKOP = CLKI;
  initial begin
    LOCK = 0;
    $display("%s %s %s %s %s", FEEDBK_PATH, CLKOP_ENABLE, CLKOS_ENABLE, CLKOS2_ENABLE, CLKOS3_ENABLE);
    #1 $display("%b", {RST, STDBY, PHASESEL0, PHASESEL1, PHASEDIR, PHASESTEP, PHASELOADREG, PLLWAKESYNC, ENCLKOP});
    #30 LOCK = 1;
  end
endmodule
module bench;
  reg clk = 0, rst = 0;
  coincid_ecp5 dut (.clk_in(clk), .rst_in(rst));
  task edges(input integer n); repeat (n) begin
    #5 clk = 1;
    #1 $write("%0d", dut.sensor.rst);
    #4 clk = 0;
  end endtask
  initial begin
    #2 edges(6);
    rst = 1; edges(1); rst = 0; edges(4);
  end
endmodule
"""


def test_the_wrapper_is_reset_until_its_pll_locks_and_by_its_pin(tmp_path):
    """A pulse of a cycle is a reset of a cycle, behind two registers. Nothing else is asked of the
    PLL than its clocks.
    """
    text = fpga_module.WRAPPER.read_text(encoding="utf-8")
    ports = ", ".join(connected(text, "sensor"))
    sensor = f"module coincid_fpga({ports}); input {ports}; endmodule"
    said = simulated(tmp_path, text, sensor, OF_THE_WRAPPER)
    paths, controls, resets = said.splitlines()
    assert paths == "CLKOP ENABLED ENABLED ENABLED ENABLED"
    assert controls == "0" * 9
    assert resets == "111100" + "01000"


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
    board = evolve(BOARD, pins="LOCATE", device=("--85k",), goal_mhz=80.0)
    usual = (board, netlists[0], 3)
    others = [
        (board, netlists[1], 3),
        (board, netlists[0], 4),
        (evolve(board, pins="OTHER"), netlists[0], 3),
        (evolve(board, device=("--45k",)), netlists[0], 3),
        (evolve(board, goal_mhz=80.5), netlists[0], 3),
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
