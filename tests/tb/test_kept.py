# SPDX-License-Identifier: Apache-2.0
"""What is compiled once is compiled again after any change of what it is made from."""

from types import SimpleNamespace

import pytest

from coincid.tb import rtl, stress, verilated

TOOL = "/tools/bin/verilator"


@pytest.fixture
def kept(monkeypatch):
    """Return the folders that are asked for; nothing is made in them."""
    found = []

    def once(folder, make):
        found.append(folder)
        return folder

    for module in (rtl, stress):
        monkeypatch.setattr(module, "build_once", once)
    monkeypatch.setattr(verilated, "compile_once", once)
    return found


def test_no_bench_of_a_front_end_is_taken_for_another(kept, monkeypatch, tmp_path):
    """Files by name and text, parameters, and whether flops may fall to either side."""
    done = SimpleNamespace(returncode=0, stdout="{}\n", stderr="")
    monkeypatch.setattr(stress.subprocess, "run", lambda *_, **__: done)
    benches = [tmp_path / "a" / "bench.v", tmp_path / "b" / "bench.v"]
    for number, path in enumerate(benches):
        path.parent.mkdir()
        path.write_text(f"module bench; // {number}", encoding="utf-8")
    usual = {"bench": benches[0], "files": {"one.v": "module one;", "two.vh": "x"}}
    others = [
        {"bench": benches[1]},
        {"files": {"one.v": "module one ;", "two.vh": "x"}},
        {"files": {"one.v": "module one;", "three.vh": "x"}},
        {"parameters": {"N": 1}},
        {"parameters": {"N": 2}},
        {"parameters": {"M": 1}},
        {"aperture": True},
    ]
    for changed in ({}, *others):
        stress.run_bench(**usual | changed)
    assert len(set(kept)) == len(kept) == 1 + len(others)
    stress.run_bench(**usual, arguments=["+seed=2"])  # of the simulator only
    assert kept[-1] == kept[0]


def test_no_unit_of_verilator_is_taken_for_another(kept, monkeypatch, tmp_path):
    monkeypatch.setattr(verilated.toolchain, "verilator", lambda: TOOL)
    sources = [tmp_path / "a" / "unit.v", tmp_path / "b" / "unit.v", tmp_path / "a" / "other.v"]
    for text, path in zip(("", "// changed", ""), sources, strict=True):
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"module unit; {text}", encoding="utf-8")
    usual = {"top": "unit", "prefix": "V", "sources": [sources[0]], "optimise": "-O2"}
    others = [
        {"top": "other"},
        {"prefix": "W"},
        {"sources": [sources[1]]},
        {"sources": [sources[2]]},
        {"options": ["-fno-inline"]},
        {"optimise": "-O1"},
    ]
    for changed in ({}, *others):
        verilated.verilated_unit(**usual | changed)
    monkeypatch.setattr(verilated.toolchain, "verilator", lambda: f"{TOOL}-of-another-version")
    verilated.verilated_unit(**usual)
    assert len(set(kept)) == len(kept) == 2 + len(others)


def test_emitted_verilog_is_that_of_its_parameters_and_rooms(kept, monkeypatch):
    """Of a room that is named beside those of the sensor, too."""
    state = dict.fromkeys(("hdl", "model.contract", "model.shared", "board"), 0)
    monkeypatch.setattr(
        rtl, "sources_digest", lambda *rooms: repr([(room, state[room]) for room in rooms])
    )
    rtl.emitted("name", "parameters", dict, "board")
    rtl.emitted("other", "parameters", dict, "board")
    rtl.emitted("name", "others", dict, "board")
    for room in state:
        state[room] += 1
        rtl.emitted("name", "parameters", dict, "board")
    assert len(set(kept)) == len(kept) == 3 + len(state)
