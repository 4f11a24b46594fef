# SPDX-License-Identifier: Apache-2.0
"""Sweeps: rows and columns, kept and repeated points, kills of the sweep and of workers, bad specs,
the example.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import matplotlib
import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest
from distributed import Client, LocalCluster
from distributed.scheduler import KilledWorker
from PIL import Image

from coincid.lab import dask_workers
from coincid.lab.measures import MEASURES, SWEPT, Measure
from coincid.model.contract.config import parse_config
from coincid.model.shared.errors import InputError
from coincid.model.shared.files import whole_file
from coincid.study import sweep as job
from coincid.study.sweep_plot import PANELS, write_plot
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
GRID = f"{BASE}[[axis]]\nklux = [5, 50]\n[[axis]]\nsubgroup.threshold = [1, 2, 3]\n"


@pytest.fixture(scope="module")
def threads():
    """A client of workers in this process, which see patches made by tests."""
    with (
        LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
        ) as local,
        Client(local) as client,
    ):
        yield client


@pytest.fixture
def quick(monkeypatch, threads):
    """Sweeps run in this process."""
    monkeypatch.setattr(
        dask_workers, "cluster", lambda workers, scheduler=None: contextlib.nullcontext(threads)
    )


def listening():
    """Return (IP, port) on which this process and its children listen."""
    this = psutil.Process()
    sockets = [
        socket
        for one in (this, *this.children(recursive=True))
        for socket in one.net_connections("inet")
    ]
    return {tuple(socket.laddr) for socket in sockets if socket.status == psutil.CONN_LISTEN}


@pytest.fixture(scope="module")
def processes():
    """A client of a cluster of two processes, with the addresses on which the cluster listens."""
    before = listening()
    with dask_workers.cluster(2) as client:
        client.addresses = listening() - before
        yield client


def sweep(folder, spec=GRID, *options, name="s"):
    """Run the command and return its result; the table is `table(folder)`."""
    (folder / f"{name}.toml").write_text(spec, encoding="utf-8")
    return command(f"sweep {folder}/{name}.toml --out {folder}/{name}.parquet", *options)


def table(folder, name="s"):
    return pq.read_table(folder / f"{name}.parquet")


def points(folder, name="s"):
    return {
        path: path.stat().st_mtime_ns for path in (folder / f"{name}.parquet.points").glob("*.json")
    }


def test_a_row_a_point_in_the_order_of_the_axes(tmp_path, quick):
    result = sweep(tmp_path)
    assert result.exit_code == 0, result.output
    found = table(tmp_path)
    assert found["klux"].to_pylist() == [5.0] * 3 + [50.0] * 3
    assert found["subgroup.threshold"].to_pylist() == [1, 2, 3] * 2
    assert found.column_names == ["klux", "subgroup.threshold", *SWEPT, "settings", "point"]
    assert found.schema.field("events").metadata[b"meaning"].decode() == MEASURES["events"].meaning
    assert [str(found.schema.field(name).type) for name in ("klux", "events")] == [
        "double",
        "int64",
    ]
    metadata = json.loads(found.schema.metadata[job.METADATA.encode()])
    assert metadata["axes"] == [{"klux": [5, 50]}, {"subgroup.threshold": [1, 2, 3]}]
    assert metadata["base"]["sensor"] == {"rows": 8, "cols": 8}
    assert {"coincid", "code", "numpy"} <= metadata["versions"]["golden"].keys()
    for row, settings in zip(
        found.to_pylist(), map(json.loads, found["settings"].to_pylist()), strict=True
    ):
        assert settings.keys() == {*SETTINGS, "configuration"} and settings["klux"] == row["klux"]
        assert settings["configuration"]["subgroup"]["threshold"] == row["subgroup.threshold"]
    with Image.open(tmp_path / "s.png") as picture:
        assert picture.width > 1000


def grid(folder, spec):
    (folder / "s.toml").write_text(spec, encoding="utf-8")
    return read_spec(folder / "s.toml")


def test_lists_of_a_spec_follow_those_of_its_file(tmp_path):
    """Of several tables for a subgroup, the last one holds."""
    for name, thresholds in (("below", {0: 2, 1: 3}), ("over", {1: 5})):
        tables = "".join(
            f"[[override]]\nsubgroups = [{s}]\nthreshold = {threshold}\n"
            for s, threshold in thresholds.items()
        )
        (tmp_path / f"{name}.toml").write_text(tables, encoding="utf-8")
    over = (tmp_path / "over.toml").read_text(encoding="utf-8")
    spec = f"config = '{tmp_path}/below.toml'\n[sensor]\nrows = 8\ncols = 24\n{over}"
    (point,) = grid(tmp_path, spec).points
    assert point.setup.config.threshold.tolist()[:2] == [2, 5]


def test_keys_of_an_axis_vary_together_and_words_lie_over_a_preset(tmp_path):
    found = grid(
        tmp_path,
        """
        config = "fpga"
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
    """,
    )
    assert [tuple(point.values.values()) for point in found.points] == [
        (*size, *sensor, seed)
        for size in ((8, 16), (16, 32))
        for sensor in (("fpga", 3), ("silicon", 4))
        for seed in (1, 2)
    ]
    one = parse_config(found.points[2].settings["configuration"])
    assert (one.sensor.cols, one.sensor.phases, one.window.max(), one.period) == (16, 32, 4, 50)
    assert len(found.keys) == len(found.points)


@pytest.mark.parametrize(
    "spec, clocks_mhz",
    [
        (
            "clock_mhz = 250\n[[axis]]\nconfig = ['fpga', 'silicon']\n[[axis]]\nseed = [1]",
            [250, 250],
        ),
        ("[frame]\nclock_mhz = 250\n[[axis]]\nclock_mhz = [100, 200]", [100, 200]),
        ("[[axis]]\nconfig = ['fpga', 'silicon']", [125, 500]),
    ],
)
def test_the_clock_is_the_configurations(tmp_path, spec, clocks_mhz):
    points = grid(tmp_path, spec).points
    assert [point.setup.config.clock_mhz for point in points] == clocks_mhz
    assert [point.settings["configuration"]["frame"]["clock_mhz"] for point in points] == clocks_mhz


OTHER_VALUES = {
    "scene": "flat:6,0.4",
    "klux": 5.0,
    "background": "even",
    "seed": 2,
    "engine": "sliced",
    "method": "matched",
    "spad_gate": True,
}


def test_every_setting_reaches_the_setup_of_its_point(tmp_path):
    """Whether it is swept or given for all points; the key of a setup has all that it plays."""
    assert OTHER_VALUES.keys() == SETTINGS.keys()
    gate = "[subgroup]\ngating = true\ngate_len = 20\n"
    document = BASE.replace('scene = "flat:5,0.4"\n', "") + gate
    for name, other in OTHER_VALUES.items():
        usual = "flat:5,0.4" if name == "scene" else SETTINGS[name]
        axis = f"[[axis]]\n{name} = [{json.dumps(usual)}, {json.dumps(other)}]\n"
        scene = "" if name == "scene" else 'scene = "flat:5,0.4"\n'
        first, second = grid(tmp_path, f"{scene}{document}{axis}").points
        (given,) = grid(tmp_path, f"{name} = {json.dumps(other)}\n{scene}{document}").points
        assert first.key != second.key, name
        assert second.key == given.key, name


def test_the_base_of_a_grid_has_no_value_of_a_point(tmp_path):
    """It is what the file says besides the axes."""
    axes = "[[axis]]\nframe.pulses = [3, 5]\n[[axis]]\nsensor.fifo_depth = [4, 8]\nklux = [5, 50]\n"
    spec = grid(tmp_path, f"{BASE}{axes}")
    assert spec.base == tomllib.loads(BASE)
    assert [point.setup.config.pulses for point in spec.points] == [3, 3, 5, 5]


def test_keys_of_an_axis_may_repeat_a_value_beside_another_one(tmp_path):
    """Only the values of all keys together come once."""
    axis = "[[axis]]\nklux = [5, 5, 9]\nseed = [1, 2, 1]\n"
    points = grid(tmp_path, f"{BASE}{axis}").points
    assert [tuple(point.values.values()) for point in points] == [(5, 1), (5, 2), (9, 1)]


@pytest.mark.parametrize(("values", "is_legal"), [([1, 2], True), ([1, 2, 3], False)])
def test_a_grid_may_have_as_many_points_as_are_allowed(tmp_path, monkeypatch, values, is_legal):
    monkeypatch.setattr("coincid.study.sweep_spec.POINTS_MAX", 4)
    axes = f"[[axis]]\nseed = {values}\n[[axis]]\nklux = [5, 50]\n"
    if is_legal:
        assert len(grid(tmp_path, f"{BASE}{axes}").points) == 4
        return
    with pytest.raises(InputError, match="points of the grid = 6: must be .*from 1 to 4"):
        grid(tmp_path, f"{BASE}{axes}")


def test_a_scene_that_moves_has_a_frame_for_each_picture_in_a_sweep(tmp_path):
    """Unless the SPEC gives their number."""
    (tmp_path / "pictures").mkdir()
    for number, wall_m in enumerate((3.0, 4.0, 5.0)):
        np.save(tmp_path / "pictures" / f"{number}.npy", np.full((8, 8), wall_m))
    moving = BASE.replace("flat:5,0.4", str(tmp_path / "pictures"))
    for text, frames in ((moving, 3), (f"{moving}frames = 2\n", 2)):
        (point,) = grid(tmp_path, text).points
        assert point.setup.config.frames == frames
        assert point.settings["configuration"]["frame"]["frames"] == frames


def test_points_of_equal_content_are_played_once_and_have_a_row_each(tmp_path, monkeypatch):
    """As 5 and 5.0 klux."""
    played = []

    def campaign(setups, read, workers, **options):
        played.append(list(setups))
        return {key: dict.fromkeys(SWEPT, 1) for key in setups}

    monkeypatch.setattr(job, "campaign", campaign)
    monkeypatch.setattr(job, "write_plot", lambda *given: None)
    spec = grid(tmp_path, f"{BASE}[[axis]]\nklux = [5, 5.0, 50]\n")
    summary = job.sweep(spec, tmp_path / "s.parquet", workers=1, title="s")
    assert [set(keys) for keys in played] == [{spec.points[0].key, spec.points[2].key}]
    assert (summary.rows, summary.finished_before, summary.failed) == (3, 0, {})
    assert table(tmp_path)["klux"].to_pylist() == [5.0, 5.0, 50.0]


def test_the_bar_of_a_sweep_has_the_points_that_are_played(tmp_path, monkeypatch):
    """Those of equal content are one."""

    class Begun(Exception):
        """The work would begin."""

    def begin(total, what):
        raise Begun(total, what)

    monkeypatch.setattr("coincid.cli._progress", begin)
    begun = sweep(tmp_path, f"{BASE}[[axis]]\nklux = [5, 5.0, 50]\n").exception
    assert begun.args == (2, "s.toml")


def test_a_sweep_tells_its_rows_of_all_points_and_its_plot_is_named_as_the_spec(
    tmp_path, monkeypatch
):
    """A row for each point, also of equal content."""
    asked = []

    def played(grid, out, **options):
        asked.append(options["title"])
        return job.Summary(2, 1, {})

    monkeypatch.setattr(job, "sweep", played)
    told = sweep(tmp_path, f"{BASE}[[axis]]\nklux = [5, 5.0, 50]\n").stdout
    assert told == f"{tmp_path}/s.parquet: 2 of 3 points, 1 of them finished before\n"
    assert asked == ["s"]


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
        return grid(tmp_path, BASE.replace("flat:5,0.4", str(tmp_path / "depth.npy"))).points[0].key

    assert key(4.0) == key(4.0) != key(5.0)


def test_scenes_of_a_sweep_reach_as_far_as_its_laser_period(tmp_path):
    """A wall at 110 m is beyond the usual period of 75 m."""
    far = BASE.replace("flat:5,0.4", "flat:110,0.4").replace("period = 40", "period = 400")
    assert np.all(grid(tmp_path, far).points[0].setup.scene.truth_m == 110.0)


@pytest.fixture
def drawn(monkeypatch):
    """The figures that would be saved."""
    figures = []
    monkeypatch.setattr(
        "coincid.study.sweep_plot.save_figure", lambda one, path: figures.append(one)
    )
    return figures


def test_every_panel_of_the_plot_is_labelled_as_what_it_shows():
    words = {
        "wrong_share": "wrong pixels",
        "depth_share": "pixels with depth",
        "right_rms_m": "RMS error of right pixels",
        "commits_per_pulse": "commits per laser pulse",
        "dropped_share": "dropped commits",
        "stream_load": "load of the busiest stream",
    }
    assert {name: label.partition(" in ")[0] for name, (label, _) in PANELS.items()} == words


def test_the_plot_shows_measures_in_the_units_of_its_labels(tmp_path, drawn):
    """Across is the first axis, a line each value of the second; bands span the third.

    Every point and every measure has a value of its own, and those of a band are skewed. No line has
    the brightest colour, which is hard to see on white.
    """
    brightest = matplotlib.colormaps["viridis"](1.0)
    axes = ("klux = [5, 50]", "subgroup.threshold = [1, 2, 3]", "seed = [1, 2, 3, 4]")
    text = "scene = 'flat:5'\n" + "\n".join(f"[[axis]]\n{axis}" for axis in axes)
    spec = grid(tmp_path, text)
    values = 1e-4 * np.arange(len(spec.points)).reshape(2, 3, 4) ** 2  # klux, threshold, seed
    found = {}
    for point in spec.points:
        found[point.key] = {name: k + values[point.at] for k, name in enumerate(PANELS)}
    write_plot(tmp_path / "s.png", "a sweep", spec, found)
    places = drawn[0].axes
    assert len(places) == len(PANELS)
    for k, axis in enumerate(places):
        words = axis.get_ylabel().split(" in ")
        factor = {"%": 100, "mm": 1000}[words[1]] if len(words) == 2 else 1
        shown = (k + values) * factor
        for threshold, line in enumerate(axis.lines):
            assert line.get_xdata().tolist() == [5.0, 50.0]
            assert not np.allclose(line.get_color(), brightest, atol=0.1)
            means = shown[:, threshold].mean(axis=1)
            assert line.get_ydata().tolist() == pytest.approx(means.tolist())
        for threshold, band in enumerate(axis.collections):
            corners = band.get_paths()[0].vertices
            for klux, of_klux in zip([5.0, 50.0], shown[:, threshold], strict=True):
                ends = corners[corners[:, 0] == klux, 1]
                assert (ends.min(), ends.max()) == pytest.approx((of_klux.min(), of_klux.max()))
        assert len(axis.lines) == len(axis.collections) == 3
        assert axis.get_ylim()[0] == 0 < axis.get_ylim()[1]


def test_the_plot_names_what_is_across_what_the_lines_are_and_what_the_bands_span(tmp_path, drawn):
    """With units. Values of lines stand in the legend, each once."""
    axes = ("klux = [5, 50]", "subgroup.window = [10, 20, 30]", "frame.clock_mhz = [400.0, 500.0]")
    text = "scene = 'flat:5'\n" + "\n".join(f"[[axis]]\n{axis}" for axis in axes)
    spec = grid(tmp_path, text)
    found = {point.key: dict.fromkeys(PANELS, 1.0) for point in spec.points}
    write_plot(tmp_path / "s.png", "a sweep", spec, found)
    (figure,) = drawn
    lowest = max(axis.get_subplotspec().rowspan.start for axis in figure.axes)
    for axis in figure.axes:
        is_lowest = axis.get_subplotspec().rowspan.start == lowest
        assert axis.get_xlabel() == ("background light in klux" if is_lowest else "")
        assert [label.get_text() for label in axis.get_xticklabels()] in (["5", "50"], ["", ""], [])
    (legend,) = figure.legends
    assert legend.get_title().get_text() == "subgroup.window in ticks"
    assert [label.get_text() for label in legend.get_texts()] == ["10", "20", "30"]
    assert figure.get_suptitle() == "a sweep; mean and span over system clock in MHz"


@pytest.mark.parametrize(
    ("values", "scale"),
    [([1, 10, 19], "linear"), ([1, 10, 20], "log"), ([0, 10, 100], "linear")],
)
def test_the_plot_is_logarithmic_where_values_span_much_and_shows_all(
    tmp_path, drawn, values, scale
):
    text = f"scene = 'flat:5'\n[[axis]]\nklux = {values}\n"
    spec = grid(tmp_path, text)
    write_plot(
        tmp_path / "s.png",
        "a sweep",
        spec,
        {p.key: dict.fromkeys(PANELS, 1.0) for p in spec.points},
    )
    for axis in drawn[0].axes:
        assert axis.get_xscale() == scale
        assert axis.lines[0].get_xdata().tolist() == values


@pytest.mark.parametrize("several", [False, True])
def test_seeds_are_across_only_if_nothing_else_is_swept(tmp_path, drawn, several):
    """They show noise: with another axis they are neither across nor lines."""
    axes = "[[axis]]\nseed = [1, 2, 3]\n" + "[[axis]]\nklux = [5, 50]\n" * several
    spec = grid(tmp_path, f"{BASE}{axes}")
    values = {point.key: 1.0 + point.at[0] for point in spec.points}
    found = {key: dict.fromkeys(PANELS, value) for key, value in values.items()}
    write_plot(tmp_path / "s.png", "a sweep", spec, found)
    (figure,) = drawn
    assert not figure.legends
    assert figure.axes[-1].get_xlabel() == ("background light in klux" if several else "seed")
    assert figure.get_suptitle() == "a sweep" + "; mean and span over seed" * several
    (line,) = figure.axes[2].lines  # in mm
    assert line.get_xdata().tolist() == ([5.0, 50.0] if several else [1.0, 2.0, 3.0])
    expected = [2000.0, 2000.0] if several else [1000.0, 2000.0, 3000.0]
    assert line.get_ydata().tolist() == pytest.approx(expected)


def test_the_plot_has_gaps_where_no_point_has_a_value(tmp_path, drawn):
    """Because it failed, or the measure has none; a value of 0 is one."""
    axes = "[[axis]]\nklux = [5, 20, 50]\n[[axis]]\nseed = [1, 2]\n"
    spec = grid(tmp_path, f"{BASE}{axes}")
    of_points = [0.0, 4.0, None, 3.0, None, None]
    found = {
        point.key: dict.fromkeys(PANELS, value)
        for point, value in zip(spec.points, of_points, strict=True)
    }
    del found[spec.points[4].key]
    write_plot(tmp_path / "s.png", "a sweep", spec, found)
    (line,) = drawn[0].axes[3].lines
    assert line.get_ydata().tolist() == pytest.approx([2.0, 3.0, np.nan], nan_ok=True)


def test_an_axis_of_several_keys_is_named_by_all_of_them(tmp_path, drawn):
    """Its values have equal distances, and each its unit unless it is that of all."""
    axes = (
        "klux = [5, 500]\nsubgroup.window = [10, 20]",
        "sensor.rows = [8, 16]\nclock_mhz = [125, 500]",
    )
    spec = grid(tmp_path, BASE + "".join(f"[[axis]]\n{axis}\n" for axis in axes))
    found = {point.key: dict.fromkeys(PANELS, 1.0) for point in spec.points}
    write_plot(tmp_path / "s.png", "a sweep", spec, found)
    (figure,) = drawn
    lowest = figure.axes[-1]
    assert lowest.get_xlabel() == "background light in klux, subgroup.window in ticks"
    assert [label.get_text() for label in lowest.get_xticklabels()] == ["5, 10", "500, 20"]
    assert lowest.get_xscale() == "linear"
    assert lowest.lines[0].get_xdata().tolist() == [0.0, 1.0]
    (legend,) = figure.legends
    assert legend.get_title().get_text() == "sensor.rows in pixels, system clock in MHz"
    assert [label.get_text() for label in legend.get_texts()] == ["8, 125", "16, 500"]


@pytest.mark.parametrize(
    ("listed", "shown"),
    [
        ("subgroup.coincidence = [true, false]", ["True", "False"]),
        ("method = ['planes', 'maximum']", ["planes", "maximum"]),
        ("sensor.subgroup = [[8, 8], [4, 8], [4, 4]]", ["[8, 8]", "[4, 8]", "[4, 4]"]),
    ],
)
def test_what_is_no_number_stands_side_by_side_in_its_order(tmp_path, drawn, listed, shown):
    spec = grid(tmp_path, f"{BASE}[[axis]]\n{listed}\n")
    found = {point.key: dict.fromkeys(PANELS, 1.0 + point.at[0]) for point in spec.points}
    write_plot(tmp_path / "s.png", "a sweep", spec, found)
    lowest = drawn[0].axes[-1]
    assert [label.get_text() for label in lowest.get_xticklabels()] == shown
    assert lowest.get_xticks().tolist() == list(range(len(shown)))
    assert lowest.lines[0].get_xdata().tolist() == list(range(len(shown)))


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
        f"coincid: point klux={klux} subgroup.threshold=2: OSError: no such luck"
        for klux in (5, 50)
    ]
    assert table(tmp_path)["subgroup.threshold"].to_pylist() == [1, 3, 1, 3]
    monkeypatch.setitem(MEASURES, "edges", right)
    assert "6 of 6 points, 4 of them finished before" in sweep(tmp_path).stdout
    monkeypatch.setitem(MEASURES, "edges", Measure(int, "edges", lambda frame: 1 / 0))
    assert sweep(tmp_path, GRID.replace("flat:5", "flat:4")).exit_code == 1
    assert not (tmp_path / "s.parquet").exists()
    assert not (tmp_path / "s.png").exists()


def test_killed_in_the_middle_and_started_again(tmp_path, quick):
    spec = GRID.replace("pulses = 10", "pulses = 400").replace("[1, 2, 3]", str(list(range(1, 9))))
    (tmp_path / "s.toml").write_text(spec, encoding="utf-8")
    words = "-m coincid sweep s.toml --out s.parquet --workers 1"
    killed = subprocess.Popen(
        [sys.executable, *words.split()], cwd=tmp_path, start_new_session=True
    )
    while len(points(tmp_path)) < 2:
        assert killed.poll() is None
        time.sleep(0.005)
    os.killpg(killed.pid, signal.SIGKILL)
    assert killed.wait() == -signal.SIGKILL
    kept = points(tmp_path)
    assert 2 <= len(kept) < 16 and not (tmp_path / "s.parquet").exists()
    assert f"16 of 16 points, {len(kept)} of them finished before" in sweep(tmp_path, spec).stdout
    assert kept.items() <= points(tmp_path).items()
    assert sweep(tmp_path, spec, name="through").exit_code == 0
    assert (tmp_path / "s.parquet").read_bytes() == (tmp_path / "through.parquet").read_bytes()


@pytest.mark.leaves("new workers of a cluster that other tests use, too")
def test_lost_workers_lose_nothing(tmp_path, quick, processes, monkeypatch):
    assert sweep(tmp_path).exit_code == 0
    victims = []

    def kill_one(done):
        if done in (1, 3):  # some points are finished, others are not
            alive = (
                one for one in psutil.Process().children() if one.status() != psutil.STATUS_ZOMBIE
            )
            workers = (one for one in alive if any("spawn_main" in word for word in one.cmdline()))
            victims.append(next(one.pid for one in workers if one.pid not in victims))
            os.kill(victims[-1], signal.SIGKILL)

    monkeypatch.setattr(
        dask_workers, "cluster", lambda workers, scheduler=None: contextlib.nullcontext(processes)
    )
    (tmp_path / "lost").mkdir()
    spec, out = read_spec(tmp_path / "s.toml"), tmp_path / "lost" / "s.parquet"
    summary = job.sweep(spec, out, workers=2, title="s", progress=kill_one)
    assert len(victims) == 2 and (summary.rows, summary.finished_before, summary.failed) == (
        6,
        0,
        {},
    )
    for suffix in (".parquet", ".png"):
        assert out.with_suffix(suffix).read_bytes() == (tmp_path / f"s{suffix}").read_bytes()


def test_a_cluster_of_its_own_listens_on_loopback_only_and_serves_other_sweeps(tmp_path, processes):
    assert len(processes.addresses) > 2
    assert {host for host, _ in processes.addresses} == {dask_workers.LOOPBACK}
    assert sweep(tmp_path, GRID, "--scheduler", processes.scheduler.address).exit_code == 0
    assert len(table(tmp_path)) == 6


@pytest.mark.parametrize("address", ["host", "", "xyz://1.2.3.4:5", "tcp://127.0.0.1"])
def test_an_address_that_makes_no_sense(tmp_path, address):
    assert_refused(
        sweep(tmp_path, GRID, "--scheduler", address), f"scheduler = {address!r}: must be"
    )


def test_two_sweeps_at_once_on_one_output(tmp_path, quick):
    with job.Finished(tmp_path / "s.parquet"):
        assert_refused(sweep(tmp_path), "another sweep is writing it")
        assert sweep(tmp_path, name="other").exit_code == 0


def test_a_folder_of_points_that_cannot_be_is_told_with_the_output_and_the_reason(tmp_path):
    """A file has its name."""
    (tmp_path / "s.parquet.points").write_text("mine", encoding="utf-8")
    out = str(tmp_path / "s.parquet")
    assert_refused(sweep(tmp_path), f"out = {out!r}: cannot be written: File exists")
    assert (tmp_path / "s.parquet.points").read_text(encoding="utf-8") == "mine"


def test_an_output_is_free_again_when_its_sweep_ends(tmp_path):
    """Also if the sweep fails."""
    first = job.Finished(tmp_path / "s.parquet")
    with pytest.raises(ZeroDivisionError), first:
        raise ZeroDivisionError
    with job.Finished(tmp_path / "s.parquet") as second:
        assert second.folder == first.folder


def test_what_a_killed_sweep_left_half_written_goes_and_nothing_else(tmp_path):
    """When the next one begins: points, and files that are no sweep's, stay."""
    finished = job.Finished(tmp_path / "s.parquet")
    with finished:
        finished.store("0123456789ab", {"edges": 1})
    for name in (".mine.json", "mine.json.old"):
        (finished.folder / name).write_text("mine", encoding="utf-8")
    kept = set(finished.folder.iterdir())
    killed = whole_file(finished.folder / "ba9876543210.json")
    killed.__enter__()
    assert set(finished.folder.iterdir()) > kept
    with finished:
        assert set(finished.folder.iterdir()) == kept
    assert json.loads((finished.folder / "0123456789ab.json").read_text(encoding="utf-8")) == {
        "edges": 1
    }


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (InputError("frame.period = 1:\n  must be\tmore"), "frame.period = 1: must be more"),
        (ValueError("no\n such  thing"), "ValueError: no such thing"),
        (KeyError("x"), "KeyError: 'x'"),
        (KilledWorker("task", None, 20), "every worker that ran it was lost"),
    ],
    ids=lambda given: type(given).__name__,
)
def test_the_reason_of_a_failed_point_is_one_line(error, told):
    """An error of the input needs no name of its class."""
    assert dask_workers.reason(error) == told


BAD = [  # rules of the SPEC; the others' errors name the point
    (
        "[[axis]]\nsubgroup.threshold = [1, 0]",
        "point subgroup.threshold=0: subgroup.threshold = 0",
        "from 1 to 64",
    ),
    (
        "[[axis]]\nsensor.subgroup = [[8, 8], [3, 3]]",
        "point sensor.subgroup=[3,3]: sensor.subgroup = [3, 3]",
    ),
    ("[[axis]]\nthreshold = [1]", "axis[0].threshold", "subgroup.KEY"),
    ("[[axis]]\nsensor = [8]", "axis[0].sensor: cannot be swept", "sensor.KEY"),
    ("klx = 5", "klx", "unknown"),
    ("[[axis]]\nklux = 5", "axis[0].klux = 5", "list"),
    ("[[axis]]\nklux = []", "axis[0].klux = []", "list"),
    ("[[axis]]", "axis[0]", "empty"),
    ("[[axis]]\nklux = [1, 2]\nseed = [1]", "axis[0].seed", "1 values", "klux: 2"),
    ("[[axis]]\nklux = [1, 2, 1]", "klux = 1", "twice"),
    ("[[axis]]\nklux = [1]\n[[axis]]\nklux = [2]", "axis[1].klux", "another axis"),
    (
        "\n".join(f"[[axis]]\nsensor.{key} = {[*range(1, 1000)]}" for key in ("rows", "cols")),
        "998001",
        "1 to 100000",
    ),
    ("[[axis]]\nklux = [-1]", "point klux=-1", "klux = -1", "at least 0"),
    ("clock_mhz = 5\n[frame]\nclock_mhz = 5", "clock_mhz", "one of them"),
    (
        "[[axis]]\nclock_mhz = [1]\n[[axis]]\nframe.clock_mhz = [2]",
        "axis[1].frame.clock_mhz",
        "another axis",
    ),
    ("[[axis]]\nclock_mhz = [1]\nframe.clock_mhz = [2]", "clock_mhz", "another axis"),
    (
        "[[axis]]\nsensor.rows = [8]\n'sensor.rows' = [16]",
        "axis[0].sensor.rows: is given twice",
    ),
    ("[[axis]]\nklux = [1e12]", "point klux=1e+12", "too much ambient light"),
    ("klux = -1", "point the only point", "klux = -1"),
    ("[[axis]]\nseed = [-1]", "seed = -1", "from 0 to"),
    ("[[axis]]\nengine = ['silver']", "engine = 'silver'", "golden, sliced"),
    ("method = 'best'", "method = 'best'", "planes"),
    ("scene = 'flat:99'", "DISTANCE = 99", "from 0.05 to"),
    ("[frame]\nformat = 'short'", "frame.format = 'short'", "id or full"),
    ("config = 'none.toml'", "config = 'none.toml'", "no such file", "silicon"),
    ("[axis]\nklux = [1]", "[[axis]]"),
    ("config = 5", "config = 5: must be the name of a file or one of", "silicon"),
    ("[[axis]]\nconfig = ['fpga', 5]", "point config=5", "config = 5: must be the name"),
    ("scene = 5", "scene = 5: must be a string"),
    ("seeds = [1, 2]", "seeds: unknown setting, must be one of config, scene, klux", "clock_mhz"),
    ("[moon]\nrows = 1", "[moon]: unknown table, must be one of sensor"),
    ("spad_gate = 'yes'", "spad_gate = 'yes'"),
    ("background = 'odd'", "background = 'odd'", "reflected, even"),
    ("sensor = 'silicon'\n[[axis]]\nsensor.rows = [8]", "sensor"),
]


@pytest.mark.parametrize("spec, words", [(spec, words) for spec, *words in BAD])
def test_a_bad_spec_is_refused_before_anything_runs(tmp_path, spec, words):
    assert_refused(sweep(tmp_path, spec), "s.toml", *words)
    assert [path.name for path in tmp_path.iterdir()] == ["s.toml"]


def test_presets_are_not_offered_as_a_spec(tmp_path):
    """They are configurations, which a SPEC may only extend."""
    done = command("sweep", tmp_path / "none.toml")
    assert_refused(done, "none.toml", "no such file")
    assert "silicon" not in done.output


def test_outputs_that_cannot_be(tmp_path):
    (tmp_path / "deep.parquet").mkdir()
    for options, told in (
        (("--out", tmp_path / "x.png"), f"{tmp_path}/x.png': must end with .parquet"),
        (("--out", tmp_path / "s.toml" / "x.parquet"), "s.toml is no folder"),
        (("--out", tmp_path / "deep.parquet"), "is a folder, must be a file"),
        (("--workers", "0"), "workers = 0: must be an integer from 1 to 1024"),
        (("--workers", "1025"), "workers = 1025: must be an integer from 1 to 1024"),
    ):
        assert_refused(sweep(tmp_path, GRID, *options), told)


def test_the_documentation_has_the_columns_and_settings():
    page = DOCS / "sweeps.md"
    told = dict(rows(page, "column"))
    assert [*told] == [*SWEPT]
    for name, meaning in told.items():  # as in the file, and maybe more of it
        assert meaning.startswith(MEASURES[name].meaning), name
    assert {name: default for name, default, _ in rows(page, "setting")} == {
        name: json.dumps(default) for name, default in {"config": None, **SETTINGS}.items()
    }


def test_the_example_parses():
    grid = read_spec(DOCS / "sweep-example.toml")
    assert (len(grid.points), list(grid.points[0].values)) == (
        105,
        ["klux", "subgroup.threshold", "seed"],
    )


def specs():
    """Return the documents' sweeps; one of them has a ray-traced scene."""
    for path in sorted(DOCS.glob("sweep-*.toml")):
        needs = (
            [pytest.mark.needs("raytrace")] if '"ray:' in path.read_text(encoding="utf-8") else []
        )
        yield pytest.param(path, marks=needs, id=path.stem)


@pytest.mark.parametrize("path", list(specs()))
def test_the_documents_sweeps_parse(path):
    assert read_spec(path).points
