# SPDX-License-Identifier: Apache-2.0
"""The simulated emulator without its RTL: what its Verilog is kept by, and bytes and time of its
port.
"""

import ctypes
from types import SimpleNamespace

import pytest
from attrs import evolve

from coincid.board import simulated
from coincid.board.simulated import READ_CYCLES, ROOM, SimulatedPort, emulator_rtl

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


def test_a_design_that_is_given_resets_itself(line, tmp_path):
    SimulatedPort(EMULATOR, 100.0, tmp_path)
    assert line.calls == [("new", 4)]
