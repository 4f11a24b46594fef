# SPDX-License-Identifier: Apache-2.0
"""The format `counts` from the scene to the page: simulations, sweeps, advice and the explorer."""

import io
import json
import math

import numpy as np
import pytest
from attrs import evolve
from pandas import read_parquet
from rich.console import Console

from coincid.lab import long_frames, measures
from coincid.lab.outcomes import Run
from coincid.lab.pace import frames_per_s
from coincid.lab.setup import Setup
from coincid.model.contract.config import parse_config
from coincid.model.contract.packet import BEAT_BITS
from coincid.model.depth.estimate import estimate_depth
from coincid.model.scenes.catalogue import load_scene
from coincid.model.shared.errors import InputError
from coincid.study.advise import HEADS, Tried, advise
from coincid.study.explore.control_values import check_settings
from coincid.study.show.notebook import run_view
from coincid.study.show.words import number_rows, story
from coincid.study.simulate import (
    ANIMATION,
    COUNTED,
    DEPTH,
    DEPTHS,
    EVENTS,
    LIGHT,
    PAGE,
    REPORT,
    simulate_to_folder,
)

from ..command import assert_refused, command

SIDE = 16
COUNTS = {
    "sensor": {"rows": SIDE, "cols": SIDE, "counts": 1},
    "frame": {"pulses": 300, "format": "counts", "link_gbps": 8.0},
}


def setup(scene="flat:5,0.4", frame=None, **fields):
    return Setup.of(
        scene,
        sensor=COUNTS["sensor"],
        frame=COUNTS["frame"] | (frame or {}),
        **{"klux": 20.0} | fields,
    )


def simulated(out, of):
    """Return the report of a simulation, and what the console shows."""
    console = Console(file=io.StringIO(), width=100)
    report = simulate_to_folder(of, out=out, console=console)
    return report, console.file.getvalue()


def test_simulation_of_counts_leaves_depth_and_its_numbers(tmp_path):
    of = setup("five-objects")
    report, told = simulated(tmp_path, of)
    names = {*COUNTED, LIGHT, EVENTS, DEPTH, PAGE, REPORT}
    assert {path.name for path in tmp_path.iterdir()} == names
    assert json.loads((tmp_path / REPORT).read_text(encoding="utf-8")) == json.loads(
        json.dumps(report)
    )
    arrays = dict(np.load(tmp_path / EVENTS))
    assert len(arrays["pulse"]) == report["events"] == 0
    assert arrays["gate_hits"].shape == (1, 4, 64, 2, 16)
    depth = estimate_depth(arrays, of.config)
    assert np.array_equal(np.load(tmp_path / DEPTH)["depth_m"], depth.depth_m, equal_nan=True)
    assert report["wrong_share_counts"] < 0.05
    assert report["frames"] == 1
    assert report["configuration"]["frame"]["search_pulses"] == 60
    assert f"{BEAT_BITS * report['beats_counts']:,}" in told
    assert "threshold" not in told


def test_a_threshold_of_frames_of_counts_is_refused():
    given = "--engine golden --set counts=1 --set format=counts --threshold 3"
    assert_refused(command(f"sim {given}"), "threshold = 3: must be left out", "frames have counts")


def test_counts_of_a_scene_that_moves(tmp_path):
    walls_m = np.stack([np.full((SIDE, SIDE), wall_m) for wall_m in (3.0, 4.0)])
    report, _ = simulated(tmp_path, setup(load_scene(walls_m, SIDE, SIDE), klux=5.0))
    assert report["frames"] == 2
    written = np.load(tmp_path / DEPTHS)
    assert np.abs(written["depth_m"][..., 0] - walls_m).max() < 0.1
    assert (tmp_path / ANIMATION).exists()


def test_long_frames_of_counts_are_the_same(monkeypatch, tmp_path):
    of = setup("five-objects", {"frames": 2})
    expected = [Run(of).frame(number) for number in range(2)]
    depths_m = [frame.depth_m for frame in expected]
    monkeypatch.setattr(long_frames, "EDGES_MAX", 1000)
    run = Run(of)
    assert run.is_long
    for number in range(2):
        assert np.array_equal(run.frame(number).depth_m, depths_m[number], equal_nan=True)
    report, _ = simulated(tmp_path, setup("five-objects"))
    assert report["wrong_share_counts"] < 0.05


def test_measures_of_counts_are_those_of_their_packets():
    run = Run(setup(frame={"link_gbps": 0}))
    frame = run.frame()
    assert frame["beats"] == sum(len(beats) for beats in frame.trace.beats)
    packets = 4 * 16 * 10  # of ten beats for each of 16 minigroups in 4 subgroups
    assert packets < frame["beats"] < packets + 100
    assert frame["bits"] == BEAT_BITS * frame["beats"]
    periods = 300 * run.config.period
    pauses = 832 * 16 + 32 + 520 * 16 + 32
    seconds = (periods + pauses) / (run.config.clock_mhz * 1e6)
    assert frame["frames_per_s"] == pytest.approx(1 / seconds)
    assert frame["mean_gbps"] == pytest.approx(frame["bits"] / seconds * 1e-9)
    assert frame["events"] == 0
    assert frame["bound_mm"] is None
    of_events = ("dropped_share", "threshold_mean")
    for name in measures.SWEPT:
        assert (frame[name] is None) == (name in of_events), name


def test_report_shows_counted_hits_in_place_of_events():
    run = Run(setup())
    view = run_view(run)
    hits = int(run.result["gate_hits"].sum())
    assert view.numbers["counted"] == hits > 0
    assert f"{hits:,} hits" in story(view)
    rows = dict(number_rows(view))
    assert rows["counted hits"] == f"{hits:,}"
    assert "windows" not in rows
    own, of_subgroup = view.histogram(3, 3)
    near = int(view.depth_m[3, 3] / 0.15)
    assert own[near - 1 : near + 2].sum() > 0.5 * own.sum() > 0
    assert of_subgroup.sum() == run.result["gate_hits"][0, 0].sum()


SWEEP = """
scene = "flat:5,0.4"
klux = 20
[sensor]
rows = 8
cols = 8
counts = 1
[frame]
pulses = 200
[[axis]]
frame.format = ["id", "compact", "counts"]
"""


def test_sweep_over_formats_with_counts(tmp_path):
    (tmp_path / "formats.toml").write_text(SWEEP, encoding="utf-8")
    done = command(f"sweep {tmp_path}/formats.toml --out {tmp_path}/out.parquet --workers 1")
    assert done.exit_code == 0, done.output
    table = read_parquet(tmp_path / "out.parquet").set_index("frame.format")
    assert table.loc["counts", "events"] == 0 < table.loc["id", "events"]
    assert table.loc["counts", "beats"] < table.loc["id", "beats"]
    assert table.loc["counts", "wrong_share"] < 0.05


def test_sweep_refuses_methods_of_events(tmp_path):
    text = SWEEP.replace("klux = 20", 'klux = 20\nmethod = "maximum"')
    (tmp_path / "formats.toml").write_text(text, encoding="utf-8")
    done = command(f"sweep {tmp_path}/formats.toml --out {tmp_path}/out.parquet")
    assert_refused(done, "point frame.format=counts", "method = 'maximum'", "planes", "no events")


def test_sensor_without_counts_refuses_the_format():
    done = command("sim --engine golden --set format=counts")
    assert_refused(done, "frame.format", "sensor.counts = 0")


def events(scene, counts):
    sensor = COUNTS["sensor"] | {"counts": counts, "controller": 0}
    return Setup.of(scene, sensor=sensor, frame={"pulses": 200}, klux=20.0)


def test_advice_tries_counts_where_the_sensor_has_them():
    advice = advise(events("five-objects", 1), klux=20.0)
    counted = [one for one in advice.links if one.config.counting]
    assert len(counted) == len({one.link_gbps for one in counted}) == len(advice.links) / 3
    other = [one for one in advice.links if not one.config.counting]
    assert max(one.bits for one in counted) < min(one.bits for one in other)
    assert advice.counts == ""
    sentence = evolve(advice, best=counted[0]).sentence
    assert "ake the format counts and a link of 1 Gbit/s" in sentence
    assert "window" not in sentence


def test_advice_tells_what_counts_would_do():
    with_counts = advise(events("five-objects", 1), klux=20.0)
    without = advise(events("five-objects", 0), klux=20.0)
    counted = next(one for one in with_counts.links if one.config.counting)
    assert f"{counted.bits:,} bits per frame" in without.counts
    assert f"{counted.wrong:.1%} of the pixels would be wrong" in without.counts
    assert not any(one.config.counting for one in without.tried)


@pytest.mark.parametrize(
    ("frame", "subgroup", "threshold", "window_ns"),
    [
        ({"format": "counts"}, {}, "none", math.nan),
        ({"format": "counts"}, {"threshold": 3, "window": 12}, "none", math.nan),
        ({}, {"threshold": 3, "window": 12}, "3", 3.0),
        ({}, {"auto": True, "window": 20}, "controller", 5.0),
    ],
)
def test_a_row_of_an_advice_has_the_threshold_and_window_that_its_format_has(
    frame, subgroup, threshold, window_ns
):
    """With ticks of 0.25 ns. The other cells are numbers that no two of them share."""
    frame = {"link_gbps": 2.5, "pulses": 70, "clock_mhz": 500.0} | frame
    tables = {"sensor": COUNTS["sensor"] | {"phases": 8}, "frame": frame, "subgroup": subgroup}
    config = parse_config(tables)
    shares = {"wrong": 0.1, "far": 0.2, "error_mm": 30.0, "bits": 4, "dropped": 0.5, "load": 0.6}
    row = Tried(config=config, **shares).row()
    assert len(row) == len(HEADS)
    assert row[0] == threshold
    assert row[1] == pytest.approx(window_ns, nan_ok=True)
    cells = (config.format, 2.5, *shares.values(), frames_per_s(config))
    assert row[2:] == cells


def test_explorer_builds_the_sensor_with_counts_if_they_are_chosen():
    assert check_settings({"format": "id"}).config.sensor.counts == 0
    chosen = check_settings({"format": "counts", "pulses": 200})
    assert chosen.config.sensor.counts == 1
    assert chosen.config.counting
    assert Run(chosen.setup()).frame()["wrong_share"] < 0.1
    with pytest.raises(InputError, match="method = 'maximum'"):
        check_settings({"format": "counts", "method": "maximum"}).setup()
