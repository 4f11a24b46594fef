# SPDX-License-Identifier: Apache-2.0
"""The emulator for a board: its netlist boots and sends frames as predicted, its Verilog lints, its
PLL and pins are the board's.
"""

import re
from functools import cache
from types import MappingProxyType

import numpy as np
import pytest
from attrs import astuple, evolve

from coincid.board.driver import EmulatorDriver
from coincid.board.lint import lint_emulator
from coincid.board.netlist import emulator_netlist
from coincid.board.parameters import Emulator
from coincid.board.place import ulx3s
from coincid.board.release import PINS, TOPS, emulator_release, write_emulator
from coincid.board.rtl.ulx3s import BOARD_TOP, OSCILLATOR_MHZ, pll
from coincid.board.run import Session
from coincid.board.serial_transport import SerialTransport
from coincid.board.simulated import PATIENCE_S, SimulatedPort
from coincid.board.source_model import SourceSettings
from coincid.model.contract.config import load_config
from coincid.model.shared.errors import InputError

from ..file_digests import expected, of_emulator, smallest_emulator
from .sensors import SENSOR, config


@pytest.mark.long
def test_the_netlist_boots_and_sends_frames():
    """The FPGA's cells behind the board's pins, from their initial values; no reset, and later one
    by the button.
    """
    settings = SourceSettings(
        background=np.array([6000]),
        tick=np.full((1, 16), 30),
        level=np.full((1, 16), 128),
        spread=2,
        seed=3,
    )
    emulator, library = emulator_netlist(config(), 64)
    with SimulatedPort(emulator, 100, library) as port:
        assert port.read() == b""  # the PLL locks in this time
        session = Session(
            EmulatorDriver(SerialTransport(port, patience_s=PATIENCE_S)), config(), settings
        )
        assert session.driver.sensor == SENSOR
        words = sum(len(session.frame()) for _ in range(2))
        assert (
            words > 20 and session.tally.recoveries == 0 and session.driver.transport.repeats == 0
        )
        port.reset()
        session.frame()
        assert session.tally.recoveries == 1 and session.tally.frames == 3


@cache
def released(kind):
    return MappingProxyType(smallest_emulator(kind))


@pytest.mark.xdist_group("boards")
@pytest.mark.parametrize("kind", TOPS)
def test_what_is_exported_changes_only_on_purpose(kind):
    assert of_emulator(released(kind)) == expected()["emulators"][kind]


@pytest.mark.xdist_group("boards")
@pytest.mark.parametrize("kind", TOPS)
def test_what_is_exported_lints(kind):
    files = released(kind)
    assert f"module {TOPS[kind]}" in files[f"{TOPS[kind]}.v"] and "registers.md" in files
    assert not any(lint_emulator(files, TOPS[kind]).values())


@pytest.mark.parametrize("clock_mhz", [50, 62.5, 80, 100, 120, 125])
def test_pll(clock_mhz):
    found = pll(clock_mhz)
    assert OSCILLATOR_MHZ * found.feedback / found.reference == clock_mhz
    assert 400 <= clock_mhz * found.output <= 800


def dividers_of(clock_mhz):
    """Return all dividers of the PLL that make a clock: the data sheet's limits, one by one."""
    return {
        (reference, feedback, output)
        for reference in range(1, 9)
        for feedback in range(1, 81)
        for output in range(1, 129)
        if OSCILLATOR_MHZ * feedback == clock_mhz * reference and 400 <= clock_mhz * output <= 800
    }


@pytest.mark.parametrize("eighths", [4, 5, 8, 23, 24, 41, 80, 81, 128, 256, 257])
def test_the_pll_makes_every_clock_that_it_can(eighths):
    """Multiples of an eighth of the oscillator; others have no dividers."""
    clock_mhz = OSCILLATOR_MHZ * eighths / 8
    possible = dividers_of(clock_mhz)
    if possible:
        assert astuple(pll(clock_mhz)) in possible
    else:
        with pytest.raises(InputError, match=f"^frame.clock_mhz = {clock_mhz:g}: the board's PLL"):
            pll(clock_mhz)
    with pytest.raises(InputError, match="the board's PLL does not make it"):
        pll(clock_mhz + OSCILLATOR_MHZ / 9)


@pytest.mark.parametrize(
    "make, says",
    [
        (lambda: ulx3s(config(clock_mhz=101.3)), "the board's PLL does not make it"),
        (lambda: ulx3s(config(clock_mhz=20)), "6.67|baud"),
        (
            lambda: Emulator(sensor=SENSOR, clocks_per_bit=3),
            "clocks_per_bit = 3: must be an integer from 4 to 65536",
        ),
        (lambda: Emulator(sensor=SENSOR, clocks_per_bit=65537), "clocks_per_bit = 65537: must be"),
        (
            lambda: emulator_release(config(), "zynq", 64),
            "kind = 'zynq': must be one of ulx3s, serial, axi",
        ),
    ],
)
def test_what_is_refused(make, says):
    with pytest.raises(InputError, match=says):
        make()


def of_subgroups(number):
    return evolve(SENSOR, cols=number * SENSOR.subgroup[1])


@pytest.mark.parametrize(
    ("field", "low", "high", "built"),
    [
        ("sensor.subgroups", 1, 256, lambda number: Emulator(sensor=of_subgroups(number))),
        ("buffer_beats", 64, 65536, lambda beats: Emulator(sensor=SENSOR, buffer_beats=beats)),
        ("clocks_per_bit", 4, 65536, lambda clocks: Emulator(sensor=SENSOR, clocks_per_bit=clocks)),
    ],
)
def test_the_ends_of_every_range_can_be_built_and_nothing_beyond(field, low, high, built):
    built(low)
    built(high)
    # no sensor has fewer than one subgroup
    for beyond in (low - 1, high + 1) if field != "sensor.subgroups" else (high + 1,):
        with pytest.raises(InputError) as refused:
            built(beyond)
        assert str(refused.value).startswith(f"{field} = {beyond}: ")
        assert (refused.value.field, refused.value.low, refused.value.high) == (field, low, high)


def test_an_emulator_has_one_stream_and_a_buffer_of_a_power_of_two():
    with pytest.raises(InputError, match="^sensor.streams = 2: must be 1 in an emulator"):
        Emulator(sensor=evolve(of_subgroups(2), streams=2))
    with pytest.raises(InputError, match="^buffer_beats = 96: must be a power of two from 64 to"):
        Emulator(sensor=SENSOR, buffer_beats=96)


def test_the_presets_are_what_a_board_needs():
    of = load_config("emulator")
    assert Emulator.of(of).clocks_per_bit == 29 and pll(of.clock_mhz).feedback == 7
    assert load_config("emulator-axi").sensor.subgroups > of.sensor.subgroups


@pytest.mark.parametrize(("clock_mhz", "clocks"), [(12, 4), (80, 27), (100, 33), (125, 42)])
def test_the_line_has_the_nearest_rate_that_the_clock_makes(clock_mhz, clocks):
    assert Emulator.of(config(clock_mhz=clock_mhz)).clocks_per_bit == clocks


@pytest.mark.xdist_group("boards")
def test_every_port_of_the_board_has_its_pin():
    files = released("ulx3s")
    ports = re.findall(
        r"^  (?:input|output) (?:\[(\d+):0\] )?(\w+)", files[f"{BOARD_TOP}.v"], re.MULTILINE
    )
    bits = {
        f"{name}[{k}]" if msb else name for msb, name in ports for k in range(int(msb or 0) + 1)
    }
    located = re.findall(r'^LOCATE COMP "(.*)" SITE "(\w+)";$', files[PINS], re.MULTILINE)
    assert {bit for bit, _ in located} == bits and len({site for _, site in located}) == len(
        bits
    ) == 13


@pytest.mark.parametrize("clock_mhz", [1, 9, 10.5, 11.7, 20])
def test_a_clock_that_makes_no_line_is_refused(clock_mhz):
    """A bit has four clocks at least, and its rate is right to 2 %."""
    told = f"frame.clock_mhz = {clock_mhz:g}: does not make 3000000 baud to 2%"
    with pytest.raises(InputError, match=told):
        Emulator.of(config(clock_mhz=clock_mhz))
    assert Emulator.of(config(clock_mhz=36.7)).clocks_per_bit == 12


def test_the_files_of_an_emulator_are_written_whole_or_not_at_all(tmp_path):
    """In the order in which they are given. A file that fails is the one of before."""
    folder = tmp_path / "deep" / "out"
    texts = {"b.v": "module b;\n", "a.v": "// \u00e4\n"}
    assert write_emulator(folder, texts) == [folder / "b.v", folder / "a.v"]
    for name, text in texts.items():
        assert (folder / name).read_bytes() == text.encode()
    no_text = "\ud800"
    with pytest.raises(UnicodeEncodeError):
        write_emulator(folder, {"b.v": "changed", "a.v": no_text, "c.v": no_text})
    left = {path.name: path.read_text(encoding="utf-8") for path in folder.iterdir()}
    assert left == texts | {"b.v": "changed"}
