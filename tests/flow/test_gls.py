# SPDX-License-Identifier: Apache-2.0
"""The frames that a netlist must play, and the models of its cells."""

import re

import pytest
from attrs import evolve

from coincid.flow import gls
from coincid.flow.synth import CELLS, GATES
from coincid.model.contract.packet import built_formats
from coincid.model.shared.errors import InputError

from .pair_rule import Pair
from .sensors import SMALL

PLAIN = """\
module kept (input A, output Y);
endmodule
module {flop} (input D, output Q);
  published published;
endmodule
module last (input A);
endmodule
"""


@pytest.fixture(scope="module")
def jobs():
    return gls.random_frames(SMALL, 8)


def test_settings_of_random_frames_vary_each_at_its_own_pace(jobs):
    """So that frames with every pair of them come soon; the controller begins late, because it
    needs a frame before.
    """
    configs = [job.config for job in jobs]
    assert [config.threshold[0] for config in configs] == [1, 2, 3, 1, 2, 3, 1, 2]
    assert [bool(config.coincidence[0]) for config in configs] == [True, True, True, False] * 2
    assert [bool(config.gating[0]) for config in configs] == [True, False] * 4
    assert [bool(config.auto[0]) for config in configs] == [False] * 4 + [True] * 4
    assert [config.frame.minigroup_records for config in configs] == [False, True] * 4
    assert [config.frame.mg_threshold for config in configs] == [1, 2] * 4
    formats = [config.format for config in configs]
    assert len(set(formats)) == 5 and formats[5:] == formats[:3]
    assert {config.pulses for config in configs} == {gls.PULSES}


def test_periods_windows_and_gates_of_random_frames_fit(jobs):
    shortest = 2 * SMALL.guard + 10
    for job in jobs:
        config = job.config
        assert shortest <= config.period < max(60, shortest + 1)
        assert (config.gate_start[0], config.gate_len[0]) == (2, max(config.period - 8, 1))
    windows = {int(job.config.window[0]) for job in jobs}
    assert windows <= set(range(1, SMALL.window_max + 1)) and len(windows) > 3
    assert len({job.config.period for job in jobs}) > 5


@pytest.mark.parametrize(
    "changes",
    [
        {"offsets": 0, "records": 0, "controller": 0},
        {"minigroup": (1, 1)},
        {"coarse_bits": 5},
        {"rule": Pair()},
    ],
    ids=["lean", "single pixels", "short periods", "own rule"],
)
def test_random_frames_fit_their_sensor(changes):
    """What it does not have is not asked of it, and nothing lies beyond its ranges."""
    sensor = evolve(SMALL, **changes)
    jobs = gls.random_frames(sensor, gls.FRAMES)
    assert [job.config.sensor for job in jobs] == [sensor] * gls.FRAMES
    assert all(job.config.period <= sensor.period_max for job in jobs)
    assert {job.config.format for job in jobs} == {*built_formats(sensor)}


def test_random_edges_are_in_range_and_as_many_as_are_meant(jobs):
    """In every pulse, pixel and phase, up to the last tick."""
    for job in jobs:
        edges, config = job.edges, job.config
        assert len(edges.pulse) == int(0.4 * SMALL.subgroups * gls.PULSES * config.period)
        assert set(edges.pulse.tolist()) == set(range(gls.PULSES))
        assert set(edges.pixel.tolist()) == set(range(SMALL.array_pixels))
        assert 0 <= edges.tick.min() and edges.tick.max() < config.period_ticks
        assert edges.tick.max() > 0.8 * config.period_ticks


def test_every_second_stream_of_random_frames_stalls(jobs):
    """Its receiver is ready in three of five cycles; otherwise it is always ready."""
    for n, job in enumerate(jobs):
        if n % 2:
            assert len(job.ready) == job.config.period * gls.PULSES
            assert 0.5 < job.ready.mean() < 0.7
        else:
            assert len(job.ready) == 0


def test_the_seed_makes_the_frames(jobs):
    again, other = gls.random_frames(SMALL, 1), gls.random_frames(SMALL, 1, seed=2)
    assert again[0].edges.tick.tolist() == jobs[0].edges.tick.tolist()
    assert other[0].edges.tick.tolist() != jobs[0].edges.tick.tolist()


@pytest.mark.parametrize("target", [GATES, CELLS])
def test_own_models_take_the_place_of_published_ones(target, monkeypatch, tmp_path):
    """Of the cells with random values only; all others stay as they are published."""
    own = gls.FLOPS.read_text(encoding="utf-8")
    flop = re.findall(r"^module (\S+)", own, flags=re.MULTILINE)[0]
    (tmp_path / "share").mkdir()
    published = {GATES: tmp_path / "share" / "simcells.v", CELLS: tmp_path / gls.CELL_MODELS}
    published[target].write_text(PLAIN.format(flop=flop), encoding="utf-8")
    monkeypatch.setattr(gls, "wheel_folder", lambda wheel: tmp_path)
    monkeypatch.setattr(gls, "cells_folder", lambda: tmp_path)
    text = gls.cell_models(target)
    assert text.endswith(own)
    published_rest = text.removesuffix(own)
    assert re.findall(r"^module (\S+)", published_rest, flags=re.MULTILINE) == ["kept", "last"]
    assert published_rest.count("endmodule") == 2


def test_each_netlist_is_told_with_its_words_and_its_cycles(monkeypatch):
    """When it has been played, and in turn."""
    played = []

    def gate_level(sensor, target):
        assert sensor == gls.SENSOR
        played.append(target)
        return 10 * len(played), 1000 * len(played)

    monkeypatch.setattr(gls, "gate_level", gate_level)
    lines = gls.gate_levels()
    assert next(lines) == f"{GATES}: 10 words and commits in 1000 cycles, 0 mismatches"
    assert played == [GATES]
    assert list(lines) == [f"{CELLS}: 20 words and commits in 2000 cycles, 0 mismatches"]


def test_a_netlist_is_compiled_with_the_models_of_its_own_cells(monkeypatch, tmp_path):
    """Under a name that tells its cells and its sensor, with the nets that a caller wants dumped."""
    built = []

    def build(simulator, sources, top, *, key, scopes):
        built.append((simulator, sources[0], sources[1].read_text(encoding="utf-8"), top, key))
        return scopes

    netlist = type("Synthesized", (), {"folder": tmp_path})
    monkeypatch.setattr(gls, "synthesize", lambda sensor, target: netlist)
    monkeypatch.setattr(gls, "cell_models", lambda target: f"models of {target}")
    monkeypatch.setattr(gls, "sensor_key", lambda sensor: "small")
    monkeypatch.setattr(gls.toolchain, "build", build)
    assert gls.netlist_build(SMALL, GATES) == ()
    assert gls.netlist_build(SMALL, CELLS, ["top.a"]) == ["top.a"]
    assert built == [
        ("icarus", tmp_path / "netlist.v", f"models of {target}", gls.TOP, f"{target}-small")
        for target in (GATES, CELLS)
    ]


def test_cells_that_are_not_installed_are_told_with_what_installs_them(monkeypatch):
    monkeypatch.setattr(gls, "cells_folder", lambda: None)
    with pytest.raises(InputError, match="^the standard cells are not installed; run: scripts/set"):
        gls.cell_models(CELLS)


def test_a_netlist_plays_the_frames_that_are_asked_for(monkeypatch):
    """So many of this seed, in a folder of its own for each target."""
    played = []
    monkeypatch.setattr(gls, "netlist_build", lambda sensor, target: (sensor, target))
    monkeypatch.setattr(gls, "random_frames", lambda *given: given)
    monkeypatch.setattr(gls, "sensor_key", lambda sensor: "small")
    monkeypatch.setattr(gls, "played", lambda *given: played.append(given) or (1, 2))
    assert gls.gate_level(SMALL, GATES, frames=4, seed=9) == (1, 2)
    assert gls.gate_level(SMALL, CELLS) == (1, 2)
    assert played == [
        ((SMALL, GATES), (SMALL, 4, 9), f"{GATES}-small"),
        ((SMALL, CELLS), (SMALL, gls.FRAMES, 1), f"{CELLS}-small"),
    ]


def test_totals_of_played_frames(monkeypatch):
    """Words and commits first, then cycles."""

    class Record:
        def __init__(self, checked, cycles):
            self.checked, self.cycles = checked, cycles

    records = [Record(3, 100), Record(5, 1000)]
    asked = []
    monkeypatch.setattr(
        gls, "play_in", lambda *of, lines: asked.append((*of, lines)) or (records, None)
    )
    for lines in (False, True):
        assert gls.played("a build", [], "name", lines) == (8, 1100)
        build, jobs, folder, told = asked[-1]
        assert (build, jobs, folder.name, told) == ("a build", [], "name", lines)
