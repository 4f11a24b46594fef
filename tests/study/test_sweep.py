# SPDX-License-Identifier: Apache-2.0
"""Sweeps: rows and columns, kept and repeated points, kills of the sweep and of workers, bad specs, the example."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest
from distributed import Client, LocalCluster
from PIL import Image

from coincid.lab import dask_workers
from coincid.lab.measures import MEASURES, SWEPT, Measure
from coincid.model.contract.config import parse_config
from coincid.model.contract.packet import FORMATS, RECORD, layout
from coincid.model.depth.estimate import estimate_depth
from coincid.model.depth.quality import wrong_share
from coincid.model.golden.frame import golden_result
from coincid.model.light.photons import generate_edges
from coincid.model.light.spad import Spad
from coincid.model.light.timing import Timing
from coincid.model.scenes.catalogue import load_scene
from coincid.model.scenes.scene import scene_light
from coincid.study import sweep as job
from coincid.study.sweep_spec import SETTINGS, read_spec

from ..command import assert_refused, command
from ..test_docs import rows

DOCS = Path(__file__).parents[2] / "docs"
BASE = """
scene = "flat:5,0.4"
[sensor]
rows = 8
cols = 8
[frame]
period = 40
pulses = 10
"""
GRID = (
    BASE
    + """
[[axis]]
klux = [5, 50]
[[axis]]
subgroup.threshold = [1, 2, 3]
"""
)
KILL_S = 120  # only a broken sweep reaches this limit


@pytest.fixture(scope="module")
def threads():
    """A client of workers in this process, which see patches made by tests."""
    with (
        LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as local,
        Client(local) as client,
    ):
        yield client


@pytest.fixture
def quick(monkeypatch, threads):
    """Sweeps run in this process."""
    monkeypatch.setattr(dask_workers, "cluster", lambda workers, scheduler=None: contextlib.nullcontext(threads))


@pytest.fixture(scope="module")
def cluster():
    """A client of a cluster of two processes, and the addresses on which it listens."""
    before = listening()
    with dask_workers.cluster(2) as client:
        yield client, listening() - before


@pytest.fixture
def processes(cluster):
    return cluster[0]


def listening():
    """Return (IP, port) on which this process and its children listen."""
    this = psutil.Process()
    sockets = [
        socket for process in (this, *this.children(recursive=True)) for socket in process.net_connections("inet")
    ]
    return {tuple(socket.laddr) for socket in sockets if socket.status == psutil.CONN_LISTEN}


def sweep(folder, spec=GRID, *options, name="s"):
    """Run the command and return its result; the table is `table(folder)`."""
    (folder / f"{name}.toml").write_text(spec)
    return command(f"sweep {folder}/{name}.toml --out {folder}/{name}.parquet", *options)


def table(folder, name="s"):
    return pq.read_table(folder / f"{name}.parquet")


def files(folder, name="s"):
    """Return the files that a sweep leaves, except the finished points."""
    return [(folder / f"{name}{suffix}").read_bytes() for suffix in (".parquet", ".png")]


def points(folder, name="s"):
    return {path: path.stat().st_mtime_ns for path in (folder / f"{name}.parquet.points").glob("*.json")}


def test_a_row_a_point_in_the_order_of_the_axes(tmp_path, quick):
    result = sweep(tmp_path)
    assert result.exit_code == 0, result.output
    found = table(tmp_path)
    assert found["klux"].to_pylist() == [5.0] * 3 + [50.0] * 3
    assert found["subgroup.threshold"].to_pylist() == [1, 2, 3] * 2
    assert found.column_names == ["klux", "subgroup.threshold", *SWEPT, "settings", "point"]
    metadata = json.loads(found.schema.metadata[job.METADATA.encode()])
    assert metadata["axes"] == [{"klux": [5, 50]}, {"subgroup.threshold": [1, 2, 3]}]
    assert metadata["base"]["sensor"] == {"rows": 8, "cols": 8}
    assert {"coincid", "code", "numpy"} <= metadata["versions"]["golden"].keys()
    for row in found.to_pylist():
        settings = json.loads(row["settings"])
        assert settings.keys() == {*SETTINGS, "configuration"}
        assert (settings["klux"], settings["configuration"]["subgroup"]["threshold"]) == (
            row["klux"],
            row["subgroup.threshold"],
        )
    with Image.open(tmp_path / "s.png") as picture:
        assert picture.width > 1000


def test_measures_are_those_of_the_last_frame(tmp_path, quick):
    """Compute them in another way: from the result's arrays, for two frames of the controller, in full format with records."""
    spec = (
        BASE.replace("flat:5,0.4", "letter-f")
        + """
        frames = 2
        format = "full"
        minigroup_records = true
        auto_bounds = [1, 2, 3, 400, 500, 600]
        capacity = 0
        [subgroup]
        auto = true
        threshold = 3
        [[axis]]
        seed = [3]
    """
    )
    assert sweep(tmp_path, spec).exit_code == 0
    (row,) = table(tmp_path).to_pylist()
    document = json.loads(row["settings"])["configuration"]
    config = parse_config({"sensor": document["sensor"], "frame": document["frame"], "subgroup": document["subgroup"]})
    timing, scene = Timing.from_config(config), load_scene("letter-f", 8, 8)
    edges = generate_edges(scene_light(scene, 50), Spad(), timing, pulses=20, seed=3)
    arrays = golden_result(config, edges)
    assert row["threshold_mean"] == 4
    assert row["edges"] == np.sum(edges.pulse >= 10)
    assert row["events"] == np.sum(arrays["pulse"] >= 10) > 0
    assert row["overruns"] == np.sum(arrays["overrun"][arrays["pulse"] >= 10])
    assert row["mg_records"] == np.sum(arrays["mg_pulse"] >= 10) > 0
    assert row["committed"] == row["events"] + row["dropped"] == 10 * row["commits_per_pulse"]
    parts = layout(config.sensor)
    packets = row["events"] * parts.length(FORMATS["full"]) + row["mg_records"] * parts.length(RECORD)
    assert row["beats"] == packets + 2 + parts.counter_beats
    assert row["stream_load"] == row["beats"] / 400
    depth_m = estimate_depth(arrays, config, frame=1).depth_m[:, :, 0]
    error_m = depth_m - scene.truth_m
    assert row["wrong_share"] == wrong_share(depth_m, scene.truth_m)
    assert row["depth_share"] == np.mean(~np.isnan(depth_m))
    assert row["bias_m"] == pytest.approx(np.nanmean(error_m))
    assert row["rms_m"] == pytest.approx(np.sqrt(np.nanmean(error_m**2)))
    assert abs(row["right_bias_m"]) <= row["right_rms_m"] < 0.035


def test_keys_of_an_axis_vary_together_and_words_lie_over_a_preset(tmp_path):
    spec = tmp_path / "s.toml"
    spec.write_text("""
        config = "fpga"
        clock_mhz = 125
        [frame]
        period = 50
        [[axis]]
        sensor.rows = [8, 16]
        "sensor.cols" = [16, 32]
        [[axis]]
        config = ["fpga", "silicon"]
        subgroup.window = [3, 4]
        [[axis]]
        seed = [1, 2]
    """)
    grid = read_spec(spec)
    shown = [tuple(point.values.values()) for point in grid.points]
    assert shown == [
        (*size, *sensor, seed)
        for size in ((8, 16), (16, 32))
        for sensor in (("fpga", 3), ("silicon", 4))
        for seed in (1, 2)
    ]
    one = parse_config(grid.points[2].settings["configuration"])
    assert (one.sensor.cols, one.sensor.phases, one.window.max(), one.period) == (16, 32, 4, 50)
    assert len(grid.keys) == len(grid.points)


def test_the_clock_is_the_configurations(tmp_path):
    spec = tmp_path / "s.toml"
    spec.write_text("clock_mhz = 250\n[[axis]]\nconfig = ['fpga', 'silicon']\n[[axis]]\nseed = [1]\n")
    clocks = [point.settings["configuration"]["frame"]["clock_mhz"] for point in read_spec(spec).points]
    assert clocks == [250, 250]
    spec.write_text("[frame]\nclock_mhz = 250\n[[axis]]\nclock_mhz = [100, 200]\n")
    assert [point.setup.config.clock_mhz for point in read_spec(spec).points] == [100, 200]
    spec.write_text("[[axis]]\nconfig = ['fpga', 'silicon']\n")
    assert [point.setup.config.clock_mhz for point in read_spec(spec).points] == [125, 500]


def test_only_new_points_run_and_stale_ones_are_not_in_the_result(tmp_path, quick):
    sweep(tmp_path)
    before = points(tmp_path)
    assert len(before) == 6
    changed = GRID.replace("[1, 2, 3]", "[2, 4]")
    told = sweep(tmp_path, changed).stdout
    assert "4 of 4 points, 2 of them finished before" in told
    assert table(tmp_path)["subgroup.threshold"].to_pylist() == [2, 4, 2, 4]
    assert before.items() <= points(tmp_path).items()
    assert len(points(tmp_path)) == 8
    assert sweep(tmp_path, changed, name="fresh").exit_code == 0
    assert (tmp_path / "fresh.parquet").read_bytes() == (tmp_path / "s.parquet").read_bytes()


def test_a_point_knows_what_a_scene_file_holds(tmp_path):
    def key(depth_m):
        np.save(tmp_path / "depth.npy", np.full((8, 8), depth_m))
        (tmp_path / "s.toml").write_text(BASE.replace("flat:5,0.4", str(tmp_path / "depth.npy")))
        return read_spec(tmp_path / "s.toml").points[0].key

    assert key(4.0) == key(4.0) != key(5.0)


def test_a_point_that_fails_is_named_and_the_others_are_kept(tmp_path, quick, monkeypatch):
    right = MEASURES["edges"]

    def wrong(frame):
        if (frame.config.threshold == 2).all():
            raise OSError("no such\nluck")
        return right.of(frame)

    monkeypatch.setitem(MEASURES, "edges", Measure(int, "edges", wrong))
    result = sweep(tmp_path)
    assert result.exit_code == 1
    assert result.stderr.splitlines() == [
        f"coincid: point klux={klux} subgroup.threshold=2: OSError: no such luck" for klux in (5, 50)
    ]
    assert table(tmp_path)["subgroup.threshold"].to_pylist() == [1, 3, 1, 3]
    monkeypatch.setitem(MEASURES, "edges", right)
    assert "6 of 6 points, 4 of them finished before" in sweep(tmp_path).stdout
    monkeypatch.setitem(MEASURES, "edges", Measure(int, "edges", lambda frame: 1 / 0))
    assert sweep(tmp_path, GRID.replace("flat:5", "flat:4")).exit_code == 1
    assert not (tmp_path / "s.parquet").exists()


def test_killed_in_the_middle_and_started_again(tmp_path, quick):
    spec = GRID.replace("pulses = 10", "pulses = 400").replace("[1, 2, 3]", str(list(range(1, 9))))
    assert sweep(tmp_path, spec, name="through").exit_code == 0
    (tmp_path / "killed.toml").write_text(spec)
    words = "-m coincid sweep killed.toml --out killed.parquet --workers 1"
    killed = subprocess.Popen([sys.executable, *words.split()], cwd=tmp_path, start_new_session=True)
    begun = time.monotonic()
    while len(points(tmp_path, "killed")) < 2:
        assert killed.poll() is None and time.monotonic() - begun < KILL_S
        time.sleep(0.005)
    os.killpg(killed.pid, signal.SIGKILL)
    assert killed.wait() == -signal.SIGKILL
    kept = points(tmp_path, "killed")
    assert 2 <= len(kept) < 16
    assert not (tmp_path / "killed.parquet").exists()
    assert f"16 of 16 points, {len(kept)} of them finished before" in sweep(tmp_path, spec, name="killed").stdout
    assert kept.items() <= points(tmp_path, "killed").items()
    assert (tmp_path / "killed.parquet").read_bytes() == (tmp_path / "through.parquet").read_bytes()


def test_lost_workers_lose_nothing(tmp_path, quick, processes):
    assert sweep(tmp_path).exit_code == 0
    first = files(tmp_path)
    (tmp_path / "lost").mkdir()
    (tmp_path / "lost" / "s.toml").write_text(GRID)
    victims = []

    def kill_one(done):
        if done in (1, 3):  # some points are finished, others are not
            children = psutil.Process().children()  # one that has ended has no command line
            others = (
                child for child in children if child.pid not in victims and child.status() != psutil.STATUS_ZOMBIE
            )
            victims.append(next(child.pid for child in others if any("spawn_main" in word for word in child.cmdline())))
            os.kill(victims[-1], signal.SIGKILL)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dask_workers, "cluster", lambda workers, scheduler=None: contextlib.nullcontext(processes))
        summary = job.sweep(
            read_spec(tmp_path / "s.toml"), tmp_path / "lost" / "s.parquet", workers=2, title="s", progress=kill_one
        )
    assert len(victims) == 2
    assert (summary.rows, summary.kept, summary.failed) == (6, 0, {})
    assert files(tmp_path / "lost") == first


def test_a_cluster_of_its_own_listens_on_loopback_only(cluster):
    assert len(cluster[1]) > 2
    assert {host for host, _ in cluster[1]} == {dask_workers.LOOPBACK}


def test_a_scheduler_elsewhere(tmp_path, processes):
    assert sweep(tmp_path, GRID, "--scheduler", processes.scheduler.address).exit_code == 0
    assert len(table(tmp_path)) == 6


@pytest.mark.parametrize("address", ["host", "", "xyz://1.2.3.4:5", "tcp://127.0.0.1"])
def test_an_address_that_makes_no_sense(tmp_path, address):
    result = sweep(tmp_path, GRID, "--scheduler", address)
    assert result.exit_code == 2
    assert f"scheduler = {address!r}: must be" in result.stderr


def test_two_sweeps_at_once_on_one_output(tmp_path, quick):
    with job.Finished(tmp_path / "s.parquet"):
        result = sweep(tmp_path)
        assert result.exit_code == 2
        assert "another sweep is writing it" in result.stderr
        assert sweep(tmp_path, name="other").exit_code == 0
    assert sweep(tmp_path).exit_code == 0


BAD = {
    "threshold 0": (
        "[[axis]]\nsubgroup.threshold = [1, 0]",
        "point subgroup.threshold=0",
        "subgroup.threshold = 0",
        "from 1 to 64",
    ),
    "together": (
        "[[axis]]\nframe.period = [40, 60]\n[subgroup]\ngating = true\ngate_start = 50",
        "frame.period=40",
        "gate_start = 50",
        "from 0 to 39",
    ),
    "unknown key": ("[[axis]]\nsubgroup.treshold = [1]", "subgroup.treshold", "threshold"),
    "unknown axis": ("[[axis]]\nthreshold = [1]", "axis[0].threshold", "subgroup.KEY"),
    "unknown setting": ("klx = 5", "klx", "unknown"),
    "no list": ("[[axis]]\nklux = 5", "axis[0].klux = 5", "list"),
    "no values": ("[[axis]]\nklux = []", "axis[0].klux = []", "list"),
    "no keys": ("[[axis]]", "axis[0]", "empty"),
    "unequal": ("[[axis]]\nklux = [1, 2]\nseed = [1]", "axis[0].seed", "1 values", "klux: 2"),
    "twice in one": ("[[axis]]\nklux = [1, 2, 1]", "klux = 1", "twice"),
    "twice": ("[[axis]]\nklux = [1]\n[[axis]]\nklux = [2]", "axis[1].klux", "another axis"),
    "too many": (
        "\n".join(f"[[axis]]\nsensor.{key} = {list(range(1, 1000))}" for key in ("rows", "cols")),
        "998001",
        "from 1 to 100000",
    ),
    "light": ("[[axis]]\nklux = [-1]", "point klux=-1", "klux = -1", "at least 0"),
    "clock": ("clock_mhz = 0\n[[axis]]\nseed = [1]", "frame.clock_mhz = 0", "from 0.001 to 100000"),
    "clock in two places": ("clock_mhz = 5\n[frame]\nclock_mhz = 5", "clock_mhz", "one of them"),
    "clock swept twice": (
        "[[axis]]\nclock_mhz = [1]\n[[axis]]\nframe.clock_mhz = [2]",
        "axis[1].frame.clock_mhz",
        "another axis",
    ),
    "seed": ("[[axis]]\nseed = [-1]", "seed = -1", "from 0 to"),
    "engine": ("[[axis]]\nengine = ['silver']", "engine = 'silver'", "golden, sliced"),
    "method": ("method = 'best'", "method = 'best'", "planes"),
    "scene": ("scene = 'flat:99'", "DISTANCE = 99", "from 0.05 to"),
    "no ID map": ("[frame]\nformat = 'short'", "frame.format = 'short'", "id or full"),
    "config": ("config = 'none.toml'", "config = 'none.toml'", "no such file", "silicon"),
    "table": ("[axis]\nklux = [1]", "[[axis]]"),
    "text for a table": ("sensor = 'silicon'\n[[axis]]\nsensor.rows = [8]", "sensor"),
    "not TOML": ("klux:", "TOML"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_spec_is_refused_before_anything_runs(tmp_path, name):
    spec, *words = BAD[name]
    result = sweep(tmp_path, spec)
    assert_refused(result, "s.toml", *words)
    assert [path.name for path in tmp_path.iterdir()] == ["s.toml"]


def test_outputs_that_cannot_be(tmp_path):
    for out, word in (("x.png", ".parquet"), ("s.toml/x.parquet", "no folder")):
        result = sweep(tmp_path, GRID, "--out", tmp_path / out)
        assert (result.exit_code, word in result.stderr) == (2, True)
    assert sweep(tmp_path, GRID, "--workers", "0").exit_code == 2


def test_the_documentation_has_the_columns_and_settings():
    page = DOCS / "sweeps.md"
    assert [name for name, _ in rows(page, "column")] == [*SWEPT]
    assert {name: default for name, default, _ in rows(page, "setting")} == {
        name: json.dumps(default) for name, default in {"config": None, **SETTINGS}.items()
    }


def test_the_example_parses():
    grid = read_spec(DOCS / "sweep-example.toml")
    assert (len(grid.points), list(grid.points[0].values)) == (105, ["klux", "subgroup.threshold", "seed"])
    assert all(read_spec(path).points for path in DOCS.glob("sweep-*.toml"))
