# SPDX-License-Identifier: Apache-2.0
"""The simulated emulator without its RTL: what its Verilog is kept by, and bytes and time of its
port.
"""

import ctypes
import subprocess
from types import SimpleNamespace

import pytest
from attrs import evolve

from coincid.board import simulated
from coincid.board.simulated import READ_CYCLES, ROOM, SimulatedPort, clocks_at, emulator_rtl

from .sensors import SENSOR

EMULATOR = simulated.simulated(SENSOR, 64)
OTHERS = (
    {"buffer_beats": 128},
    {"clocks_per_bit": 5},
    {"sensor": evolve(SENSOR, fifo_depth=8)},
    {"sensor": evolve(SENSOR, window_max=3)},
    {"sensor": evolve(SENSOR, rows=8)},
)


def test_no_emulator_is_taken_for_another(monkeypatch, tmp_path):
    """Its files are kept by all its parameters and by the sources of its room."""
    kept = []

    def emitted(name, parameters, files, *rooms):
        kept.append((name, parameters))
        assert rooms == ("board",)
        folder = tmp_path / str(len(kept))
        folder.mkdir()
        for file, text in files().items():
            (folder / file).write_text(text, encoding="utf-8")
        return folder

    monkeypatch.setattr(simulated, "emitted", emitted)
    monkeypatch.setattr(
        simulated, "emulator_files", lambda of: {simulated.EMULATOR_LIST: f"{of.buffer_beats}.v"}
    )
    for changed in ({}, {}, *OTHERS):
        emulator = evolve(EMULATOR, **changed)
        (file,) = emulator_rtl(emulator)
        assert file == tmp_path / str(len(kept)) / f"{emulator.buffer_beats}.v"
    assert len(set(kept)) == len(kept) - 1 == 1 + len(OTHERS)


def test_no_library_of_a_line_is_taken_for_another(monkeypatch, tmp_path):
    """Its name has its design and the program around it; both are compiled for the same headers."""
    made, commands = [], []

    def once(directory, make):
        made.append(directory)
        make(directory, commands.append)
        return directory

    def unit(top, prefix, sources, options, optimise):
        named = "-".join([top, *sources, *options, optimise])
        return tmp_path / named

    source = tmp_path / "line.cpp"
    source.write_text("// first", encoding="utf-8")
    monkeypatch.setattr(simulated, "SOURCE", source)
    monkeypatch.setattr(simulated, "compile_once", once)
    monkeypatch.setattr(simulated, "verilated_unit", unit)
    monkeypatch.setattr(simulated, "include", lambda: ["-Iheaders"])
    monkeypatch.setattr(simulated, "run_time", lambda: tmp_path / "run-time")
    monkeypatch.setattr(simulated, "objects_in", lambda *of: [folder / "a.o" for folder in of])
    usual = {"sources": ["a"], "top": "top", "options": ["-x"], "optimise": "-O2"}
    others = [{"sources": ["b"]}, {"top": "other"}, {"options": []}, {"optimise": "-O0"}]
    for changed in ({}, *others):
        assert simulated.build_line(**usual | changed) == made[-1] / simulated.LIBRARY
    source.write_text("// changed", encoding="utf-8")
    simulated.build_line(**usual)
    monkeypatch.setattr(simulated, "COMPILER", ("another",))
    simulated.build_line(**usual)
    assert len(set(made)) == len(made) == 3 + len(others)
    own = unit("top", "", ["a"], ["-x"], "-O2")
    objects = [str(own / "a.o"), str(tmp_path / "run-time" / "a.o")]
    assert {str(source), f"-I{own}", "-Iheaders", "-shared", *objects} < {*commands[0]}


@pytest.mark.parametrize(
    ("baud", "clock_mhz", "clocks"),
    [(600_000, 100, 167), (3_000_000, 100, 33), (3_000_000, 62.5, 21), (1526, 100, 65531)],
)
def test_a_simulated_line_has_the_nearest_rate_that_the_clock_makes(baud, clock_mhz, clocks):
    assert clocks_at(baud, clock_mhz) == clocks


class Line:
    """Stands for the library: bytes wait for the host, and every call takes its cycles."""

    def __init__(self):
        self.waiting, self.sent, self.cycles, self.calls = b"", b"", 0, []

    def library(self):
        names = "new", "delete", "reset", "connect", "send", "run", "cycle"
        return SimpleNamespace(**{f"coincid_line_{name}": getattr(self, name) for name in names})

    def new(self, clocks_per_bit):
        self.calls.append(("new", clocks_per_bit))
        return self

    def delete(self, line):
        self.calls.append(("delete",))

    def reset(self, line, cycles):
        self.calls.append(("reset", cycles))

    def connect(self, line, connected):
        self.calls.append(("connect", connected))

    def send(self, line, data, length):
        self.sent += data[:length]
        self.cycles += 10 * EMULATOR.clocks_per_bit * length

    def run(self, line, cycles, room, size):
        found, self.waiting = self.waiting[:size], self.waiting[size:]
        ctypes.memmove(room, found, len(found))
        self.cycles += 0 if found else cycles
        return len(found)

    def cycle(self, line):
        return self.cycles


@pytest.fixture
def line(monkeypatch):
    line = Line()
    monkeypatch.setattr(simulated, "_library", lambda path: line.library())
    monkeypatch.setattr(simulated, "build_emulator", lambda emulator: None)
    return line


@pytest.mark.parametrize(
    "data", [b"\0", b"\0\1\0", b"\xff\0\x7e", bytes(range(256)), bytes(ROOM), bytes(ROOM) + b"\1"]
)
def test_bytes_of_every_value_pass_the_port(data, line):
    """Also zeros, and more of them than one reading takes; what was read before is gone."""
    with SimulatedPort(EMULATOR, 100.0) as port:
        line.waiting = b"before"
        assert port.read() == b"before"
        line.waiting = data
        parts = []
        while part := port.read():
            parts.append(part)
        assert b"".join(parts) == data
        port.write(data)
        assert line.sent == data


def test_time_passes_while_a_port_reads_and_writes(line):
    with SimulatedPort(EMULATOR, 50.0) as port:
        assert (port.cycles, port.now()) == (0, 0.0)
        assert port.read() == b""
        assert port.now() == pytest.approx(READ_CYCLES / 50e6)
        port.write(b"abc")
        assert port.cycles == READ_CYCLES + 3 * 10 * EMULATOR.clocks_per_bit
        port.connect(False)
    calls = [("new", 4), ("reset", simulated.RESET_CYCLES), ("connect", False), ("delete",)]
    assert line.calls == calls


# A design that gives back what it hears, a cycle later.
LOOP = """
struct VerilatedContext {};
struct Vemulator {
    unsigned char clk = 0, rst = 0, rx = 1, tx = 1;
    explicit Vemulator(VerilatedContext*) {}
    void eval() { if (clk) tx = rx; }
};
"""


@pytest.fixture(scope="module")
def loop(tmp_path_factory):
    """Compile the program around a design with one that gives back its bytes."""
    folder = tmp_path_factory.mktemp("loop")
    (folder / "Vemulator.h").write_text(LOOP, encoding="utf-8")
    library = folder / simulated.LIBRARY
    command = [*simulated.COMPILER, "-O0", "-shared", "-o", library, simulated.SOURCE]
    subprocess.run([*command, f"-I{folder}"], check=True)
    return library


@pytest.mark.parametrize("clocks", [4, 5, 33])
def test_bytes_take_the_time_of_their_line_and_come_back_through_a_loop(clocks, loop):
    """Of any value, at any rate; none while the cable is out."""
    data = bytes(range(256))
    with SimulatedPort(evolve(EMULATOR, clocks_per_bit=clocks), 100.0, loop) as port:
        for turn in (1, 2):
            port.write(data)
            found = b""
            while part := port.read():
                found += part
            assert found == data
            byte_cycles = 10 * clocks
            spent = port.cycles - turn * READ_CYCLES
            assert turn * len(data) - 1 < spent / byte_cycles <= turn * len(data)
        port.connect(False)
        port.write(data)
        assert port.read() == b""
        port.connect(True)
        before = port.cycles
        assert len(port.read()) == 1 and port.cycles <= before + 20 * clocks


def test_a_design_that_is_given_resets_itself(line, tmp_path):
    SimulatedPort(EMULATOR, 100.0, tmp_path)
    assert line.calls == [("new", 4)]
