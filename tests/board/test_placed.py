# SPDX-License-Identifier: Apache-2.0
"""What the board's FPGA is told: the PLL's parameters, the placer's goals, and sizes that the
release and the netlist take from their options.
"""

import re

import pytest
from attrs import evolve

from coincid.board import netlist, place
from coincid.board.parameters import DEAD_MAX, Emulator
from coincid.board.place import ulx3s
from coincid.board.release import TOPS, emulator_release
from coincid.board.rtl.ulx3s import BOARD_TOP, OSCILLATOR_MHZ, board_files, board_pins
from coincid.board.run import source_settings
from coincid.lab.setup import scene_of
from coincid.model.contract.config import load_config
from coincid.model.light.spad import Spad

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
    if kind != "axi":
        assert emulator == evolve(Emulator.of(config(clock_mhz=80)), buffer_beats=beats)


def test_the_netlist_is_that_of_the_emulator_it_is_returned_with(files, monkeypatch, tmp_path):
    """With the buffer and the line that are asked for, and without block RAM."""
    boards = []

    def synthesized(board):
        boards.append(board)
        return tmp_path

    monkeypatch.setattr(netlist, "synthesize", synthesized)
    monkeypatch.setattr(netlist, "build_line", lambda sources, *_: sources[0])
    emulator, library = netlist.emulator_netlist(config(), 128, 7)
    assert (emulator.buffer_beats, emulator.clocks_per_bit) == (128, 7)
    assert files == [emulator] and boards[0].options == "-nobram"
    assert library.parent == tmp_path


@pytest.mark.parametrize("clock_mhz", [50, 80, 125, 233, 400, 1000])
def test_a_pixel_of_the_source_is_dead_for_at_least_its_dead_time(clock_mhz):
    """In whole cycles, at least one and at most as many as the source can count."""
    seconds = Spad().dead_time_s
    legal = [n for n in range(1, DEAD_MAX + 1) if n * 1e-6 / clock_mhz >= seconds * (1 - 1e-9)]
    expected = legal[0] if legal else DEAD_MAX
    of = config(clock_mhz=clock_mhz)
    settings = source_settings(of, scene_of(of, "flat:3,0.4"), 5.0)
    assert settings.dead_cycles == expected
