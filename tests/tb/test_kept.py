# SPDX-License-Identifier: Apache-2.0
"""What is compiled once is compiled again after any change of what it is made from."""

from types import SimpleNamespace

import pytest
from attrs import evolve

from coincid.hdl.front_end_views import Polyphase, view_at
from coincid.model.contract.coincidence import AtLeast, Rule
from coincid.model.contract.parameters import Sensor
from coincid.model.shared.errors import InputError
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
    monkeypatch.setattr(stress.toolchain, "icarus", lambda: "Icarus 1")
    return found


def test_no_bench_of_a_front_end_is_taken_for_another(kept, monkeypatch, tmp_path):
    """Files by name and text, parameters, whether flops may fall to either side, and the version
    that compiles them: the simulator of another one refuses what it has made.
    """
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
    monkeypatch.setattr(stress.toolchain, "icarus", lambda: "Icarus 2")
    stress.run_bench(**usual)
    assert kept[-1] not in kept[:-1]


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
    tools = [
        (verilated.toolchain, "verilator", lambda: f"{TOOL}-of-another-version"),
        (verilated, "VERILATOR", ("--cc",)),
        (verilated, "COMPILER", ("another",)),
    ]
    for tool in tools:
        monkeypatch.setattr(*tool)
        verilated.verilated_unit(**usual)
    assert len(set(kept)) == len(kept) == 1 + len(others) + len(tools)


def test_no_run_time_of_verilator_is_taken_for_another(kept, monkeypatch):
    """It is compiled from the files of one version by one compiler; every unit has the same."""
    monkeypatch.setattr(verilated.toolchain, "verilator", lambda: TOOL)
    assert verilated.run_time() == verilated.run_time()
    changes = [
        (verilated.toolchain, "verilator", lambda: f"{TOOL}-of-another-version"),
        (verilated, "COMPILER", ("another",)),
        (verilated, "RUN_TIME", ("verilated.cpp",)),
        (verilated, "UNOPTIMISED", "-O3"),
    ]
    for change in changes:
        with monkeypatch.context() as patch:
            patch.setattr(*change)
            verilated.run_time()
    assert len(set(kept)) == len(kept) - 1 == 1 + len(changes)


def test_emitted_verilog_is_that_of_its_parameters_and_rooms(kept, monkeypatch, tmp_path):
    """Of a room that is named beside those of the sensor, too, and of what writes it."""
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
    (tmp_path / "rtl.py").write_text("# changed", encoding="utf-8")
    monkeypatch.setattr(rtl, "__file__", str(tmp_path / "rtl.py"))
    rtl.emitted("name", "parameters", dict, "board")
    assert len(set(kept)) == len(kept) == 4 + len(state)


def test_no_verilog_is_taken_for_that_of_another_sensor_or_view(kept, monkeypatch):
    """A user's own view and own rule have versions."""

    def own(base, name, version):
        return type("Own", (base,), {"name": name, "version": version})()

    monkeypatch.setattr(rtl, "listed", lambda path: [path])
    sensor = Sensor(rows=8, cols=8)
    sensors = [
        sensor,
        evolve(sensor, cols=16),
        evolve(sensor, rearm=sensor.rearm + 1),
        evolve(sensor, rule=own(AtLeast, "own", "1")),
        evolve(sensor, rule=own(AtLeast, "own", "2")),
    ]
    views = [
        view_at("async", 400),
        view_at("async", 500),
        own(Polyphase, "own", "1"),
        own(Polyphase, "own", "2"),
    ]
    for one in sensors:
        rtl.rtl(one)
    for view in views:
        rtl.rtl(sensor, view)
    assert len(set(kept)) == len(kept) == len(sensors) + len(views)
    rtl.rtl(sensor)
    assert kept[-1] == kept[0]


@pytest.mark.parametrize("emits", [rtl.rtl, rtl.rtl_in_two])
def test_a_rule_without_a_circuit_has_no_verilog(emits, kept):
    rule = type("Mine", (Rule,), {"name": "mine", "version": "1"})()
    with pytest.raises(InputError, match="sensor.rule = 'mine': has no circuit"):
        emits(Sensor(rows=8, cols=8, rule=rule))
    assert not kept


@pytest.fixture
def asked(monkeypatch):
    """Return what a bench of the front end is asked for; it tells some counts."""
    found = []

    def run_bench(bench, files, *, arguments, aperture):
        found.append((bench.name, files[stress.INCLUDE], arguments, aperture))
        return ["a line before", '{"edges": 5}']

    monkeypatch.setattr(stress, "run_bench", run_bench)
    monkeypatch.setattr(stress.Front, "files", lambda self: {stress.INCLUDE: self.include()})
    return found


def test_a_bench_is_compiled_from_its_files_with_its_parameters(monkeypatch, tmp_path):
    """Files that others include are there, and are no sources. It runs where it was compiled, with
    the arguments of the simulator, and says its lines.
    """
    bench = tmp_path / "bench.v"
    bench.write_text("module bench;", encoding="utf-8")
    monkeypatch.setattr(stress, "build_root", lambda: tmp_path)
    monkeypatch.setattr(stress.toolchain, "icarus", lambda: "Icarus 1")
    compiled, run = [], []

    def compile_in(scratch, log, command):
        texts = {path.name: path.read_text(encoding="utf-8") for path in scratch.iterdir()}
        compiled.append((texts, log.parent == scratch, command))

    def simulated(command, *, cwd, **_):
        run.append((command, cwd.parent == tmp_path / "bench" and (cwd / "a.v").exists()))
        return SimpleNamespace(returncode=0, stdout="one\ntwo\n\n", stderr="")

    monkeypatch.setattr(stress, "compile_in", compile_in)
    monkeypatch.setattr(stress.subprocess, "run", simulated)
    files = {"a.v": "module a;", "front.vh": "wire w;"}
    for _ in range(2):
        said = stress.run_bench(
            bench, files, parameters={"N": 5, "K": 0}, arguments=["+seed=2"], aperture=True
        )
        assert said == ["one", "two"]
    ((texts, log_is_there, command),) = compiled
    assert texts == {**files, "bench.v": "module bench;"} and log_is_there
    assert command[:2] == ["iverilog", "-g2012"] and command[-2:] == ["a.v", "bench.v"]
    assert command[command.index("-s") + 1] == "bench"
    assert command[command.index("-o") + 1] == "bench.vvp"
    assert {"-Pbench.N=4'd5", "-Pbench.K=1'd0", "-DCOINCID_APERTURE_PS=20"} < set(command)
    assert run == [(["vvp", "-n", "bench.vvp", "+seed=2"], True)] * 2


def test_a_stress_test_has_its_edges_its_seed_and_its_sensor(asked):
    told = stress.stress(3000, 7, sensor=Sensor(rows=4, cols=4, subgroup=(4, 4), phases=8))
    assert told == {"edges": 5}
    ((bench, include, arguments, aperture),) = asked
    assert (bench, aperture) == ("async_stress.v", True)
    assert arguments == ["+edges=3000", "+seed=7"]
    assert "localparam PIXELS = 16;" in include and "localparam PHASES = 8;" in include
    stress.stress(1)
    assert asked[1][2] == ["+edges=1", "+seed=1"]
    assert "localparam PIXELS = 64;" in asked[1][1]


@pytest.mark.parametrize("edges", [0, stress.EDGES_MAX + 1, 2.5])
def test_a_number_of_edges_that_no_stress_test_has_is_refused(edges, asked):
    with pytest.raises(InputError, match=f"edges = .*from 1 to {stress.EDGES_MAX}"):
        stress.stress(edges)
    assert not asked


@pytest.mark.parametrize(
    ("code", "printed", "complaint", "told"),
    [
        (1, "a line\n", " no such file\n", "no such file"),
        (0, "", "", "it printed nothing"),
        (0, "\n", "a warning", "a warning"),
        (1, "", "", "it printed nothing"),
    ],
)
def test_a_bench_that_fails_or_says_nothing_is_no_result(
    code, printed, complaint, told, kept, monkeypatch, tmp_path
):
    bench = tmp_path / "bench.v"
    bench.write_text("module bench;", encoding="utf-8")
    done = SimpleNamespace(returncode=code, stdout=printed, stderr=complaint)
    monkeypatch.setattr(stress.subprocess, "run", lambda *_, **__: done)
    with pytest.raises(stress.ToolchainError, match=f"^bench: the simulation failed: {told}$"):
        stress.run_bench(bench, {})
