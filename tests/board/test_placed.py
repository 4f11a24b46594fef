# SPDX-License-Identifier: Apache-2.0
"""What the board's FPGA is told: the PLL's parameters, the placer's goals, and sizes that the
release and the netlist take from their options.
"""

import json
import re
from types import SimpleNamespace

import pytest
from attrs import evolve

from coincid.board import lint as board_lint
from coincid.board import netlist, place, release
from coincid.board.parameters import DEAD_MAX, Emulator
from coincid.board.place import ulx3s
from coincid.board.release import PINS, TOPS, emulator_release
from coincid.board.rtl.ulx3s import (
    BOARD_TOP,
    OSCILLATOR_MHZ,
    board_files,
    board_pins,
    board_verilog,
)
from coincid.board.run import source_settings
from coincid.flow import pnr
from coincid.flow.pnr import BITSTREAM, Placement
from coincid.lab.setup import scene_of
from coincid.model.contract.config import load_config
from coincid.model.light.spad import Spad

from ..command import command
from ..hdl.test_memory import simulated
from .sensors import SENSOR, config

BEATS = 64, 128


@pytest.fixture
def files(monkeypatch):
    """Stand in for the emulator's Verilog, which takes long: return the emulators asked for."""
    asked = []

    def made(emulator, *_, serial=True):
        asked.append(emulator)
        return {"coincid_emulator.f": "", "emulator.v": f"{emulator.buffer_beats} {serial}"}

    monkeypatch.setattr("coincid.board.rtl.ulx3s.emulator_files", made)
    monkeypatch.setattr("coincid.board.release.emulator_files", made)
    return asked


def pll_parameters(text):
    """Return the parameters of the PLL in the board's Verilog."""
    return {name: int(value) for name, value in re.findall(r"\.(CLK\w+)\((\d+)\)", text)}


@pytest.mark.parametrize("clock_mhz", [50, 62.5, 80, 100, 120, 125])
def test_the_pll_makes_the_clock_in_step_with_its_input(clock_mhz, files):
    """Its output has no shift if its coarse phase is the last cycle of its divider."""
    verilog = board_files(Emulator(sensor=SENSOR), clock_mhz)[f"{BOARD_TOP}.v"]
    of = pll_parameters(verilog)
    assert OSCILLATOR_MHZ * of["CLKFB_DIV"] / of["CLKI_DIV"] == clock_mhz
    assert 400 <= clock_mhz * of["CLKOP_DIV"] <= 800
    assert of["CLKOP_CPHASE"] == of["CLKOP_DIV"] - 1
    assert f"{clock_mhz:g} MHz inside" in verilog and f"{OSCILLATOR_MHZ} MHz in" in verilog


@pytest.mark.parametrize("clock_mhz", [80, 100])
def test_the_router_aims_higher_than_the_clock_that_is_checked(clock_mhz, files):
    """By some percent. A user's constraints have the oscillator's own frequency."""
    board = ulx3s(config(clock_mhz=clock_mhz), options="-nobram")
    assert board.goal_mhz == clock_mhz
    assert board.options == "-nobram"

    def oscillator_mhz(pins):
        return float(re.search(r'^FREQUENCY PORT "clk_25mhz" (\S+) MHZ;$', pins, re.MULTILINE)[1])

    assert 1.0 < oscillator_mhz(board.pins) / OSCILLATOR_MHZ < 1.1
    assert oscillator_mhz(board_pins()) == OSCILLATOR_MHZ
    rest = [pins.split("\n", 2)[2] for pins in (board.pins, board_pins())]
    assert rest[0] == rest[1]


def test_the_page_tells_the_board_that_is_placed(files):
    emulator = Emulator(sensor=SENSOR, buffer_beats=256, clocks_per_bit=29)
    board = ulx3s(config(), emulator)
    assert "4 x 4 pixels in 1 subgroups, 4 phases" in board.what
    assert "a frame buffer of 256 beats" in board.what
    assert set(files) == {emulator}
    assert "coincid_subgroup" in board.apart and "coincid_emulator.f" not in board.files
    assert ulx3s(config()).what.count("8192 beats") == 1


def test_the_placed_emulator_is_that_of_the_preset(files, monkeypatch):
    written = []
    monkeypatch.setattr(place, "place", lambda board: [board])
    monkeypatch.setattr(place, "write_placement_page", lambda *given: written.append(given))
    place.place_emulator()
    ((board, (placed,)),) = written
    preset = load_config("emulator")
    assert board is placed and board.goal_mhz == preset.clock_mhz
    assert files[0] == Emulator.of(preset)


@pytest.mark.parametrize("kind", TOPS)
@pytest.mark.parametrize("beats", BEATS)
def test_every_kind_of_release_has_the_buffer_that_is_asked_for(kind, beats, files):
    """The line's rate follows the clock where there is a line."""
    released = emulator_release(config(clock_mhz=80), kind, beats)
    (emulator,) = files
    assert emulator.sensor == SENSOR and emulator.buffer_beats == beats
    assert released["emulator.v"] == f"{beats} {kind != 'axi'}"
    assert (PINS in released) == (kind == "ulx3s")
    if kind != "axi":
        assert emulator == evolve(Emulator.of(config(clock_mhz=80)), buffer_beats=beats)


def test_the_netlist_is_that_of_the_emulator_it_is_returned_with(files, monkeypatch, tmp_path):
    """With the buffer and the line that are asked for, and without block RAM."""
    boards = []

    def synthesized(board):
        boards.append(board)
        return tmp_path

    monkeypatch.setattr(netlist, "synthesize", synthesized)
    built = []
    monkeypatch.setattr(netlist, "build_line", lambda *given: built.append(given) or given[0][0])
    emulator, library = netlist.emulator_netlist(config(), 128, 7)
    ((sources, top, options, optimise),) = built
    assert f"module {top}" in (sources[1]).read_text(encoding="utf-8")
    assert options[:-1] == list(netlist.NETLIST_OPTIONS) and optimise == "-O0"
    assert options[-1] == f"-I{sources[-1].parent}" and sources[-1].exists()
    assert (emulator.buffer_beats, emulator.clocks_per_bit) == (128, 7)
    assert files == [emulator] and boards[0].options == "-nobram"
    assert library.parent == tmp_path


# In place of the blocks of the board: they show their wires.
SHOWN = """
module coincid_emulator(input clk, rst, rx, output tx, laser);
  assign tx = ~rx;
  assign laser = clk & ~rst;
endmodule
module coincid_lights(input clk, rst, laser, rx, tx, output [7:0] led);
  assign led = {3'b101, clk, laser, tx, rx, rst};
endmodule
module bench;
  reg clk = 0, rst = 0, rx = 1;
  wire tx;
  wire [7:0] led;
  ulx3s_bench dut (.clk(clk), .rst(rst), .rx(rx), .tx(tx), .led(led));
  task edges(input integer n); repeat (n) begin #5 clk = 1; #5 clk = 0; #1 $write("%0d", led[0]); end endtask
  task show; #1 $display(" %b %b %b %b", led, tx, dut.wifi_gpio0, dut.board.clk); endtask
  initial begin
    edges(20); show;
    rst = 1; edges(1); rst = 0; edges(4); show;
    rx = 0; show;
    clk = 1; show;
  end
endmodule
"""


def test_the_board_for_a_simulation_is_reset_until_its_pll_locks_and_by_its_button(tmp_path):
    """A press of a cycle is a reset of a cycle, behind two registers. Line and lights are wired."""
    models = [path.read_text(encoding="utf-8") for path in (netlist.BENCH, netlist.PLL_MODEL)]
    said = simulated(tmp_path, SHOWN, board_verilog(Emulator(sensor=SENSOR), 100), *models)
    reset = "1" * 16 + "0" * 4
    quiet, busy, high = "10100010 0 1 0", "10100100 1 1 0", "10111100 1 1 1"
    assert said.splitlines() == [f"{reset} {quiet}", f"01000 {quiet}", f" {busy}", f" {high}"]


@pytest.mark.parametrize("clock_mhz", [50, 80, 125, 233, 400, 1000])
def test_a_pixel_of_the_source_is_dead_for_at_least_its_dead_time(clock_mhz):
    """In whole cycles, at least one and at most as many as the source can count."""
    seconds = Spad().dead_time_s
    legal = [n for n in range(1, DEAD_MAX + 1) if n * 1e-6 / clock_mhz >= seconds * (1 - 1e-9)]
    expected = legal[0] if legal else DEAD_MAX
    of = config(clock_mhz=clock_mhz)
    settings = source_settings(of, scene_of(of, "flat:3,0.4"), 5.0)
    assert settings.dead_cycles == expected


@pytest.fixture
def building(monkeypatch, tmp_path):
    """Let `coincid emulator` build nothing; return what its parts are given, and its placements.

    Of three placements, the second one is the fastest.
    """
    given = {}

    def note(name, result):
        def noted(*values):
            given[name] = values
            return result

        return noted

    placements = []
    for seed, mhz in ((1, 90.0), (2, 99.0), (3, 95.0)):
        folder = tmp_path / f"seed-{seed}"
        folder.mkdir()
        report = {"fmax": {"clk": {"achieved": mhz}}}
        (folder / "report.json").write_text(json.dumps(report), encoding="utf-8")
        (folder / BITSTREAM).write_bytes(b"bits of %d" % seed)
        placements.append(Placement(seed, folder))
    (tmp_path / "a.v").write_bytes(bytes(2500))
    board = SimpleNamespace(top="top", page="docs/page.md", goal_mhz=95.0)
    monkeypatch.setattr(release, "emulator_release", note("release", {"a.v": ""}))
    monkeypatch.setattr(release, "write_emulator", note("written", [tmp_path / "a.v"]))
    monkeypatch.setattr(board_lint, "lint_emulator", note("lint", {"verilator": ""}))
    monkeypatch.setattr(place, "ulx3s", note("board", board))
    monkeypatch.setattr(pnr, "place", note("placed", placements))
    monkeypatch.setattr(pnr, "write_placement_page", note("page", None))
    return given


@pytest.mark.parametrize("kind", TOPS)
def test_every_kind_of_emulator_has_its_own_preset_and_top(building, tmp_path, kind):
    """Unless another one is given. Only for the board, something is placed."""
    preset = load_config("emulator-axi" if kind == "axi" else "emulator")
    out = tmp_path / "out"
    done = command(f"emulator {kind} --buffer-beats 128 --out {out}")
    (settings, asked, beats) = building["release"]
    assert (settings.sensor, settings.clock_mhz) == (preset.sensor, preset.clock_mhz)
    assert (asked, beats) == (kind, 128)
    assert building["lint"] == ({"a.v": ""}, TOPS[kind])
    assert building["written"] == (out, {"a.v": ""})
    assert f"{out}: 1 files, 2 kB" in done.output
    assert ("placed" in building) == (kind == "ulx3s")
    command(f"emulator {kind} --config fpga --set clock_mhz=100 --out {out}")
    assert building["release"][0].sensor == load_config("fpga").sensor


def test_the_bitstream_of_a_board_is_that_of_the_fastest_placement(building, tmp_path):
    """A clock that misses its goal in another one is in the exit code."""
    out = tmp_path / "out"
    out.mkdir()
    page = tmp_path / "page.md"
    for words, told, shown in (("", None, "docs/page.md"), (f"--page {page}", page, page)):
        done = command(f"emulator --buffer-beats 256 --out {out} {words}")
        assert (out / "top.bit").read_bytes() == b"bits of 2"
        assert f"{out / 'top.bit'}\n{shown}\n" in done.stdout
        assert building["page"][2] == told
        assert done.exit_code == 1
        assert done.stderr == "coincid: seed 1: clk reaches 90.0 MHz, must be 95\n"
    settings, emulator = building["board"]
    assert emulator == Emulator.of(settings, 256)


def test_an_emulator_in_which_lint_finds_something_is_not_placed(building, monkeypatch, tmp_path):
    monkeypatch.setattr(board_lint, "lint_emulator", lambda *_: {"icarus": "odd\n"})
    done = command(f"emulator --out {tmp_path}")
    assert done.exit_code == 1 and "icarus: found\nodd" in done.stdout
    assert "placed" not in building
