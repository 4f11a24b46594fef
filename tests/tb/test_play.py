# SPDX-License-Identifier: Apache-2.0
"""How frames are played, told and compared, with stand-ins for the engines: no RTL is compiled."""

import asyncio
import os
import pickle
import re
from types import SimpleNamespace

import numpy as np
import pytest
from attrs import evolve, frozen

from coincid.hdl.front_end_views import POLYPHASE, VIEWS, Polyphase
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.packet import FRAME_END, FRAME_START, PACKETS, header_field, layout
from coincid.model.contract.parameters import TOP, Sensor
from coincid.model.golden.frame import Golden
from coincid.tb import cosim, play, toolchain
from coincid.tb.frame_record import (
    JOB_VARIABLE,
    MISMATCH,
    PROGRESS,
    RESULT,
    FrameJob,
    Recorded,
    load_job,
    save_job,
)
from coincid.tb.rtl_errors import Mismatch, SimulationError
from coincid.tb.scoreboard import check

from ..random_cases import configured, trouble

CONFIG = configured(
    {"rows": 8, "cols": 16},
    # At another clock than the usual one.
    {
        "period": 60,
        "pulses": 5,
        "format": "full",
        "minigroup_records": True,
        "clock_mhz": 400.0,
    },
    {"threshold": 1, "coincidence": False},
)
FRAMES = 3


@pytest.fixture(scope="module")
def jobs():
    golden = Golden(CONFIG.sensor)
    found = []
    for seed in range(FRAMES):
        edges = trouble(CONFIG, seed, 4.0)
        found.append(FrameJob(CONFIG, edges, golden.frame(CONFIG, edges)))
    return found


def recorded(job):
    """Return the record of a frame that is as predicted."""
    trace = job.expected
    beats = [of_stream.copy() for of_stream in trace.beats]
    return Recorded(beats, trace.beat_cycle, trace.commit_subgroup, trace.commit_cycle, cycles=700)


def kind_of(beat):
    return int(header_field(beat, "kind"))


def heads(trace):
    """Return the first packet of each kind: (its first beat, its kind)."""
    lengths = layout(CONFIG.sensor).lengths(CONFIG.sensor.subgroups)
    found, at = {}, 0
    while at < len(trace.beats[0]):
        kind = kind_of(trace.beats[0][at])
        found.setdefault(kind, at)
        at += int(lengths[kind])
    return found


def test_a_difference_tells_what_came_and_what_was_due(jobs):
    """In this order, for any bit of the header of every kind of packet."""
    trace = jobs[0].expected
    found = heads(trace)
    assert {FRAME_START.code, FRAME_END.code} < found.keys()
    for at in found.values():
        for bit in range(64):
            record = recorded(jobs[0])
            record.beats[0][at] ^= np.uint64(1 << bit)
            with pytest.raises(Mismatch) as raised:
                check(CONFIG.sensor, trace, record)
            told = str(raised.value).rsplit(": ", 1)[1]
            for part in told.split("; "):
                came, due = re.search(r"(?:is )?(\w+), golden model (\w+)$", part).groups()
                came, due = int(came, 0), int(due, 0)
                if "is" in part:
                    name = part.split(" is ")[0]
                    got, want = (
                        _field(beats[0][at], name, kind_of(trace.beats[0][at]))
                        for beats in (record.beats, trace.beats)
                    )
                else:
                    got, want = (int(beats[0][at]) for beats in (record.beats, trace.beats))
                assert (came, due) == (got, want), told


def _field(beat, name, kind):
    """Return a field of the first beat of a packet."""
    at = 0
    if name == "kind":
        return kind_of(beat)
    for field in PACKETS[kind].fields:
        width = field.bits(CONFIG.sensor)
        if field.name == name:
            return int(beat) >> at & (1 << width) - 1
        at += width
    raise AssertionError(f"no field {name}")


def test_a_wrong_counter_is_told_beside_the_right_one(jobs):
    trace = jobs[0].expected
    record = recorded(jobs[0])
    first = len(record.beats[0]) - layout(CONFIG.sensor).counter_beats * CONFIG.sensor.subgroups
    want = int(trace.beats[0][first]) & 0xFFFFFFFF
    record.beats[0][first] ^= np.uint64(1 << 20)
    told = f"counter {COUNTER_NAMES[0]} of subgroup 0 is {want ^ 1 << 20}, golden model {want}$"
    with pytest.raises(Mismatch, match=told):
        check(CONFIG.sensor, trace, record)
    assert kind_of(trace.beats[0][first - 1]) == FRAME_END.code
    assert kind_of(trace.beats[0][0]) == FRAME_START.code


def test_late_beats_and_commits_are_told_with_both_cycles(jobs):
    trace = jobs[0].expected
    due = int(trace.beat_cycle[0][4])
    late = evolve(
        recorded(jobs[0]), beat_cycle=[trace.beat_cycle[0] + (np.arange(len(trace.beats[0])) >= 4)]
    )
    with pytest.raises(Mismatch, match=f"transferred in cycle {due + 1}, golden model {due}$"):
        check(CONFIG.sensor, trace, late)
    due = int(trace.commit_cycle[0])
    cycles = trace.commit_cycle.copy()
    cycles[0] += 1
    told = f"subgroup 0, event 0: stored in cycle {due + 1}, golden model in cycle {due}$"
    with pytest.raises(Mismatch, match=told):
        check(CONFIG.sensor, trace, evolve(recorded(jobs[0]), commit_cycle=cycles))


@pytest.mark.parametrize("wrong", range(FRAMES))
def test_the_sliced_engine_names_the_frame_that_differs(wrong, jobs, monkeypatch, tmp_path):
    """Frames count from 0. Frames without a prediction are only recorded."""
    records = [recorded(job) for job in jobs]
    monkeypatch.setattr(play, "play_side_by_side", lambda chains, progress: [records])
    found, wave = play.play(jobs, "sliced", tmp_path)
    assert wave is None
    checked = [len(job.expected.beats[0]) + len(job.expected.commit_cycle) for job in jobs]
    assert [record.checked for record in found] == checked
    records[wrong].beats[0][3] ^= np.uint64(2)
    with pytest.raises(Mismatch, match=f"^frame {wrong}, stream 0"):
        play.play(jobs, "sliced", tmp_path)
    alone = [evolve(job, expected=None) for job in jobs]
    assert play.play(alone, "sliced", tmp_path)[0] is records


class FakeBuild:
    """A compiled simulator that prints lines and leaves files of the job."""

    def __init__(self, lines=(), records=None, mismatch="", wave=None):
        self.lines, self.records, self.mismatch, self.wave = lines, records, mismatch, wave
        self.given = []

    def run(self, module, *, env, out_dir, echo):
        self.given.append((module, load_job(play.Path(env[JOB_VARIABLE]))))
        for line in self.lines:
            echo(line)
        job = play.Path(env[JOB_VARIABLE])
        if self.mismatch:
            job.with_suffix(MISMATCH).write_text(self.mismatch, encoding="utf-8")
        if self.records is None:
            raise SimulationError("it stopped", out_dir / "sim.log", self.wave)
        job.with_suffix(RESULT).write_bytes(pickle.dumps(self.records))
        return toolchain.SimulationFiles(out_dir / "sim.log", out_dir / "results.xml", self.wave)


@pytest.mark.parametrize("lines", [False, True])
def test_a_simulator_is_given_the_frames_and_its_progress_is_told(lines, jobs, tmp_path):
    build = FakeBuild([f"{PROGRESS} 500", "other 7", f"{PROGRESS} 1000"], [3, 5])
    told = []
    records, run = play.play_in(build, jobs, tmp_path, lines=lines, progress=told.append)
    assert (told, records, run.wave) == ([500, 1000], [3, 5], None)
    ((module, (given, with_lines)),) = build.given
    assert (module, with_lines) == ("coincid.tb.cosim", lines)
    assert [job.edges.tick.tolist() for job in given] == [job.edges.tick.tolist() for job in jobs]
    assert play.play_in(build, jobs, tmp_path)[0] == [3, 5]  # nobody wants the progress


@pytest.mark.parametrize(
    ("wave", "words"),
    [(None, "no waveform was asked for"), ("a.fst", "waveform a.fst")],
)
def test_a_difference_in_a_simulator_is_told_with_its_files(wave, words, jobs, tmp_path):
    build = FakeBuild(mismatch="frame 2: differs", wave=wave)
    told = re.escape(f"frame 2: differs ({words}; log {tmp_path / 'sim.log'})")
    with pytest.raises(Mismatch, match=f"^{told}$"):
        play.play_in(build, jobs, tmp_path)
    with pytest.raises(SimulationError, match="it stopped"):
        play.play_in(FakeBuild(), jobs, tmp_path)


@pytest.fixture
def bench(monkeypatch):
    """Stand in for the bench in the simulator: each frame takes 700 cycles."""
    seen = []

    class Bench:
        def __init__(self, dut, sensor, clock_mhz):
            self.sensor = sensor
            seen.append(("made", clock_mhz))

        async def reset(self):
            seen.append(("reset",))

        async def play(self, config, edges, ready, board, progress):
            seen.append(("frame", len(edges), board is not None))
            progress(500)
            if board is not None and board.frame == self.fails_in:
                raise Mismatch(f"frame {board.frame}: differs")
            return Recorded([], [], None, None, cycles=700)

        fails_in = None

    monkeypatch.setattr(cosim, "SensorBench", Bench)
    return Bench, seen


def play_job(path, frames):
    """Play frames as the simulator does, and return the progress that it prints."""
    os.environ |= save_job(path, frames)
    try:
        asyncio.run(cosim.play_job.func(SimpleNamespace()))
    finally:
        del os.environ[JOB_VARIABLE]


def test_progress_in_a_simulator_goes_on_from_frame_to_frame(bench, jobs, tmp_path, capsys):
    _, seen = bench
    frames = [jobs[0], evolve(jobs[1], expected=None), jobs[2]]
    play_job(tmp_path / "job", frames)
    printed = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert printed == [[PROGRESS, str(500 + 700 * k)] for k in range(FRAMES)]
    lit = [("frame", len(job.edges), job.expected is not None) for job in frames]
    assert seen == [("made", CONFIG.clock_mhz), ("reset",), *lit]
    records = pickle.loads((tmp_path / "job").with_suffix(RESULT).read_bytes())
    assert [record.cycles for record in records] == [700] * FRAMES


def test_a_difference_in_a_simulator_is_left_beside_the_job(bench, jobs, tmp_path):
    of_bench, _ = bench
    of_bench.fails_in = 1
    with pytest.raises(Mismatch, match="frame 1"):
        play_job(tmp_path / "job", jobs)
    left = (tmp_path / "job").with_suffix(MISMATCH).read_text(encoding="utf-8")
    assert left == "frame 1: differs"
    assert not (tmp_path / "job").with_suffix(RESULT).exists()


@pytest.mark.parametrize("simulator", ["icarus", "verilator"])
def test_no_compiled_design_is_taken_for_another(simulator, monkeypatch, tmp_path):
    """Everything that it is compiled from and with is in the name of its folder."""
    monkeypatch.setattr(toolchain, "compile_once", lambda directory, make: directory)
    monkeypatch.setattr(toolchain, "_first_line", lambda *command: "tool 1")
    monkeypatch.setattr(toolchain, "_compiles", lambda *headers: True)
    sources = []
    for name, text in (("a", "module toy; endmodule"), ("b", "module toy(); endmodule")):
        (tmp_path / name).mkdir()
        sources.append(tmp_path / name / "toy.v")
        sources[-1].write_text(text, encoding="utf-8")
    usual = {"sources": [sources[0]], "top": "toy", "key": "toy"}
    others = [
        {"sources": [sources[1]]},
        {"key": "other"},
        {"waves": True},
        {"options": ["-DFAST"]},
    ]
    if simulator == "verilator":
        others += [{"public": ["toy.x"]}, {"blocks": ["toy"]}, {"delays": True}]
    else:
        others += [{"scopes": ["toy"]}, {"scopes": ["toy", "toy.x"]}]
    found = [toolchain.build(simulator, **usual | changed).directory for changed in ({}, *others)]
    monkeypatch.setattr(toolchain, "_first_line", lambda *command: "tool 2")
    found.append(toolchain.build(simulator, **usual).directory)
    if simulator == "verilator":  # whose C++ is compiled, with a part of cocotb
        for name, value in (("version", lambda name: "9.9"), ("MAKE_OPTIONS", ("OPT_FAST=-O0",))):
            monkeypatch.setattr(toolchain, name, value)
            found.append(toolchain.build(simulator, **usual).directory)
    assert len(set(found)) == len(found)


@frozen
class OwnWords(Polyphase):
    """A user's view of words, which is not the one that is used where none is named."""

    name = "own words"


OF_VIEWS = VIEWS | {"own words": OwnWords()}


@pytest.mark.parametrize("name", OF_VIEWS)
def test_only_a_view_of_words_is_built_without_delays(name, monkeypatch):
    """Its modules are compiled once for all instances; the time in the others is seen by tests."""
    asked = []
    monkeypatch.setattr(play, "rtl", lambda sensor, view: ["a.v"])
    monkeypatch.setattr(
        play.toolchain, "build", lambda *given, **named: asked.append((given, named))
    )
    view = OF_VIEWS[name].at(500.0)
    play.build_sensor(Sensor(), "icarus", True, view)
    ((given, named),) = asked
    assert given == ("icarus", ["a.v"], TOP) and named["waves"]
    words = name != "async"
    assert named["delays"] == (not words) == (len(named["blocks"]) == 0)
    assert named["public"] == [f"{TOP}.stored_of_*", *([] if words else [f"{TOP}.timing"])]


@pytest.mark.parametrize("engine", ("sliced", "icarus"))
def test_an_engine_is_prepared_by_its_own_build(engine, monkeypatch):
    built = []
    monkeypatch.setattr(play, "build_library", lambda *given: built.append(("sliced", *given)))
    monkeypatch.setattr(play, "build_sensor", lambda *given: built.append(given))
    play.prepare(engine, Sensor(), True, POLYPHASE)
    own = ("sliced", Sensor()) if engine == "sliced" else (Sensor(), "icarus", True, POLYPHASE)
    assert built == [own]


@pytest.mark.parametrize("name", OF_VIEWS)
def test_a_simulator_gets_all_that_is_asked_of_it(name, jobs, monkeypatch, tmp_path):
    """Its records and its waveform come back."""
    asked, told = [], []
    run = toolchain.SimulationFiles(tmp_path / "log", tmp_path / "xml", tmp_path / "a.fst")

    def build_sensor(sensor, simulator, waves=False, view=POLYPHASE):
        return sensor, simulator, waves, view

    def play_in(build, frames, out_dir, *, lines=False, progress=None):
        asked.append((build, frames, out_dir, lines))
        progress(5)
        return ["records"], run

    monkeypatch.setattr(play, "build_sensor", build_sensor)
    monkeypatch.setattr(play, "play_in", play_in)
    view = OF_VIEWS[name]
    found = play.play(jobs, "icarus", tmp_path, waves=True, progress=told.append, view=view)
    assert found == (["records"], run.wave)
    build = CONFIG.sensor, "icarus", True, view
    assert asked == [(build, jobs, tmp_path, not view.by_words)]
    assert told == [5]


def test_the_sliced_engine_tells_its_progress(jobs, monkeypatch, tmp_path):
    told = []

    def play_side_by_side(chains, progress):
        assert chains == [jobs]
        progress(7)
        return [[recorded(job) for job in jobs]]

    monkeypatch.setattr(play, "play_side_by_side", play_side_by_side)
    play.play(jobs, "sliced", tmp_path, progress=told.append)
    assert told == [7]
