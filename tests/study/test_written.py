# SPDX-License-Identifier: Apache-2.0
"""Numbers of a report and of a sweep's table stand under their own keys, from made-up runs."""

import io
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
from rich.console import Console

from coincid.lab.measures import SWEPT
from coincid.lab.setup import versions
from coincid.model.contract.config import parse_config
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.study import simulate
from coincid.study.simulate import Played
from coincid.study.sweep import METADATA, write_table

CONFIG = parse_config({"sensor": {"rows": 8, "cols": 16}})
SCHEMES = "off", "fixed", "auto"
MEASURES = {  # measure of a frame: beginning of its key in the report
    "events": "events",
    "dropped": "dropped",
    "beats": "beats",
    "link_load": "load",
    "stream_load": "stream_load",
    "mean_gbps": "mean_gbps",
}


def made_up(number):
    """Return a run whose last frame has measures of its own."""
    frame = {name: 100 * number + k for k, name in enumerate(MEASURES)}
    of_frame = type("Frame", (dict,), {"threshold": np.array([number, 7])})(frame)
    return SimpleNamespace(edge_count=10**number, frame=lambda: of_frame)


def report_of(counters):
    """Return the report of a run of three schemes. counters: int64[subgroups, 11] of each frame."""
    result = SimpleNamespace(config=CONFIG, counters=counters, events=17)
    runs = {name: made_up(number) for number, name in enumerate(SCHEMES, 1)}
    played = Played(runs, result, cycles=5000, checked=77, seconds=4.0, wave=None)
    return simulate._report(played)


def test_each_scheme_has_its_measures_and_all_frames_have_their_sums():
    counters = np.zeros((3, 2, len(COUNTER_NAMES)), np.int64)
    counters[:, :, COUNTER_NAMES.index("dropped")] = [[1, 2], [4, 8], [16, 32]]
    report = report_of(counters)
    for number, name in enumerate(SCHEMES, 1):
        for k, key in enumerate(MEASURES.values()):
            assert report[f"{key}_{name}"] == 100 * number + k
        assert report[f"threshold_{name}"] == [number, 7]
    totals = {
        "cycles": 5000,
        "edges": 1110,
        "events": 17,
        "dropped": 63,
        "mismatches": 0,
        "checked": 77,
        "cycles_per_s": 1250.0,
        "seconds": 4.0,
    }
    assert {name: report[name] for name in totals} == totals


@pytest.mark.parametrize("name", ["dropped", "stored"])
def test_the_sum_of_drops_is_not_known_only_if_their_own_counter_is_full(name):
    counters = np.zeros((1, 2, len(COUNTER_NAMES)), np.int64)
    counters[0, 1, COUNTER_NAMES.index(name)] = CONFIG.sensor.counter_max
    assert (report_of(counters)["dropped"] is None) == (name == "dropped")


def point(key, klux, engine):
    return SimpleNamespace(
        key=key,
        values={"klux": klux},
        settings={"klux": klux, "name": key},
        setup=SimpleNamespace(engine=engine),
    )


def test_a_table_tells_the_versions_of_all_its_engines(tmp_path):
    """Points without an outcome have no row. Each row has its own settings and key."""
    points = [point("a", 5, "golden"), point("lost", 9, "icarus"), point("b", 50, "sliced")]
    spec = SimpleNamespace(points=points, base={"scene": "flat:5"}, axes=[{"klux": [5, 9, 50]}])
    found = {key: dict.fromkeys(SWEPT, number) for number, key in enumerate(("b", "a"))}
    path = tmp_path / "table.parquet"
    write_table(path, spec, found)
    table = pq.read_table(path)
    rows = table.to_pylist()
    assert [(row["klux"], row["point"], row["edges"]) for row in rows] == [
        (5, "a", 1),
        (50, "b", 0),
    ]
    assert [json.loads(row["settings"])["name"] for row in rows] == ["a", "b"]
    told = json.loads(table.schema.metadata[METADATA.encode()])
    assert told["versions"] == {engine: versions(engine) for engine in ("golden", "sliced")}
    assert told["versions"]["golden"]["code"] != told["versions"]["sliced"]["code"]
    assert (told["base"], told["axes"]) == (spec.base, spec.axes)


WRITTEN = [Path("one.png"), Path("two.npz")]


def told_of(config, **others):
    """Return what the console shows of a made-up report of three schemes."""
    report = {"frames": 5, "checked": 1234, "cycles": 5000, "seconds": 2.0, "cycles_per_s": 2500.0}
    for number, name in enumerate(SCHEMES, 1):
        of_scheme = {
            "threshold": [number, number + number // 2],
            "events": 1_000 * number + 17,
            "dropped": None if number == 2 else 3_000 + number,
            "stream_load": 0.25 * number,
            "load": 0.11 * number,
            "wrong_share": 0.0123 * number,
            "beats": 1_001 * number,
            "mean_gbps": 0.0034 * number,
        }
        report |= {f"{key}_{name}": value for key, value in of_scheme.items()}
        report[f"wrong_share_{name}_peak"] = 0.2 * number
    console = Console(file=io.StringIO(), width=200)
    titles = {name: f"with {name}" for name in SCHEMES}
    simulate._tell(console, ["a note", "[more] :x:"], config, titles, report | others, WRITTEN)
    return console.file.getvalue().splitlines()


def cells_of(line):
    return re.split(r"\s{2,}", line.strip())


def test_the_console_tells_each_number_in_the_unit_of_its_column():
    lines = told_of(CONFIG)
    assert [cells_of(line) for line in lines if line.startswith("with ")] == [
        ["with off", "1", "1,017", "3,001", "25%", "11%", "1.2%", "20.0%"],
        ["with fixed", "2 to 3", "2,017", "unknown", "50%", "22%", "2.5%", "40.0%"],
        ["with auto", "3 to 4", "3,017", "3,003", "75%", "33%", "3.7%", "60.0%"],
    ]
    assert "the controller's thresholds after 5 frames, by subgroup:" in lines
    assert "  3 4" in lines
    assert lines[lines.index("a note") + 1] == "[more] :x:"  # neither markup nor a picture
    assert "results: one.png two.npz" in lines
    checked = "1,234 beats and commits equal the golden model's"
    assert f"5,000 cycles in 2.0 s (2,500 cycles/s): {checked}" in lines
    assert not any("Mbit/s" in line for line in lines)
    (last,) = [line for line in told_of(CONFIG, checked=0) if "cycles/s" in line]
    assert last.endswith("golden model only, no RTL")


def test_the_console_tells_the_mean_rate_of_each_scheme_beside_a_gap():
    lines = told_of(CONFIG.with_frame(gap=90_000))
    (pace,) = [line for line in lines if "Mbit/s" in line]
    assert pace.endswith("mean rate of the link: 3.4, 6.8, 10.2 Mbit/s")


def test_the_console_tells_the_bits_of_counts():
    config = parse_config(
        {"sensor": {"rows": 8, "cols": 16, "counts": 1}, "frame": {"format": "counts"}}
    )
    rows = [cells_of(line) for line in told_of(config) if line.startswith("with ")]
    assert rows == [
        ["with off", "64,064", "25.0%", "11.0%", "1.2%"],
        ["with fixed", "128,128", "50.0%", "22.0%", "2.5%"],
        ["with auto", "192,192", "75.0%", "33.0%", "3.7%"],
    ]


class MadeUpFrame:
    """A frame whose maps and shares follow from its number and its estimator."""

    config = CONFIG

    def __init__(self, number, method=""):
        self.number, self.method = number, method
        self.threshold = np.array([number, 7])
        self.depth_m = np.full((8, 16), number + len(method) / 100)
        self.truth_m = np.full((8, 16), 20.0 + number)
        light = np.stack([self.depth_m / 2, self.depth_m * 3], axis=2)
        self.first = SimpleNamespace(reason=self.depth_m.astype(np.uint8), signal_per_pulse=light)
        self.light = SimpleNamespace(total_signal=np.arange(128.0) + number)

    def by(self, method):
        return MadeUpFrame(self.number, method)

    def __getitem__(self, measure):
        return self.number, self.method, measure


def drawn_of(monkeypatch, name):
    """Return the list of what the function of this name in `pictures` will be asked to draw."""
    drawn = []

    def note(path, panels, truth, heading, blocks=None):
        drawn.append((path, panels, truth, heading, blocks))

    monkeypatch.setattr(f"coincid.study.pictures.{name}", note)
    return drawn


@pytest.mark.parametrize("names", [SCHEMES, SCHEMES[:2]])
def test_each_picture_has_the_depth_of_its_estimator_and_its_shares_have_their_keys(
    names, monkeypatch, tmp_path
):
    """Truth and thresholds are those of the last scheme, which may be the controller's."""
    drawn = drawn_of(monkeypatch, "depth_row")
    seen = {name: MadeUpFrame(number) for number, name in enumerate(names, 1)}
    titles = {name: f"with {name}" for name in names}
    shares = simulate._pictures(tmp_path, "a wall", titles, seen)
    keys = ("depth.png", "planes", ""), ("depth_peak.png", "maximum", "_peak")
    expected = {}
    for (file, method, suffix), (path, panels, truth_m, heading, (told, blocks)) in zip(
        keys, drawn, strict=True
    ):
        assert path == tmp_path / file and heading.startswith("a wall: ")
        assert [panel.title for panel in panels] == list(titles.values())
        for panel, frame in zip(panels, seen.values(), strict=True):
            assert np.array_equal(panel.depth_m, frame.by(method).depth_m)
            assert np.array_equal(panel.reason, frame.by(method).first.reason)
        assert (truth_m == 20.0 + len(names)).all()
        assert told.startswith("the controller's" if "auto" in names else "the thresholds")
        assert blocks.tolist() == [[len(names), 7]]
        for number, name in enumerate(names, 1):
            expected[f"wrong_share_{name}{suffix}"] = number, method, "wrong_share"
            expected[f"wrong_share_{name}{suffix}_15cm"] = number, method, "wrong_share_15cm"
    assert shares == expected


def test_the_picture_of_light_has_the_first_returns_of_each_scheme(monkeypatch, tmp_path):
    """Beside the light of the last one's frame."""
    drawn = drawn_of(monkeypatch, "light_row")
    seen = {name: MadeUpFrame(number) for number, name in enumerate(SCHEMES, 1)}
    titles = {name: f"with {name}" for name in SCHEMES}
    simulate._light_picture(tmp_path / "light.png", "a wall", titles, seen)
    ((path, panels, truth, heading, _),) = drawn
    assert path == tmp_path / "light.png"
    assert heading == "a wall: light, photons per pulse"
    for (title, light), (name, frame) in zip(panels, seen.items(), strict=True):
        assert title == titles[name] and np.array_equal(light, frame.depth_m / 2)
    assert np.array_equal(truth, 3 + np.arange(128.0).reshape(8, 16))


@pytest.mark.parametrize(
    ("engine", "settling", "pictures", "frames"),
    [
        ("golden", None, 1, 8),
        ("sliced", None, 1, 8),
        ("verilator", None, 1, 8),
        ("icarus", None, 1, 2),  # which is slow
        ("icarus", None, 3, 3),
        ("golden", None, 3, 3),
        ("icarus", 5, 1, 5),
        ("golden", 2, 3, 2),
    ],
)
def test_the_controller_has_the_frames_that_are_given_or_those_of_the_pictures(
    engine, settling, pictures, frames
):
    scene = SimpleNamespace(pictures=pictures, later=(None,) * (pictures - 1))
    assert simulate._frames_of(scene, engine, settling) == frames


def test_events_of_all_schemes_together_must_fit_on_a_page():
    """Three millions of them."""

    def frame(stored):
        return SimpleNamespace(counter=lambda name: {"stored": np.array(stored)}[name])

    fits = {"off": frame([900_000, 600_000]), "auto": frame([1_500_000, 0])}
    assert simulate._too_many_for_page(fits) == ""
    told = simulate._too_many_for_page(fits | {"fixed": frame([0, 234])})
    assert told == "report.html is left out: its frames have 3,000,234 events, 3,000,000 fit on it"


def test_counters_that_are_full_are_told_by_their_names():
    result = SimpleNamespace(config=CONFIG, counters=np.zeros((2, 2, len(COUNTER_NAMES)), np.int64))
    assert simulate._told_full(result) == []
    for name in ("stored", "dropped"):
        result.counters[1, 0, COUNTER_NAMES.index(name)] = CONFIG.sensor.counter_max
    (told,) = simulate._told_full(result)
    end = f"{CONFIG.sensor.counter_max:,} (sensor.counter_bits = {CONFIG.sensor.counter_bits})"
    names = ", ".join(name for name in COUNTER_NAMES if name in ("stored", "dropped"))
    assert told == f"note: counters at their end, {end}, have counted more: {names}"


def test_cycles_are_those_of_all_frames_up_to_the_last_beat_of_any_stream(monkeypatch, tmp_path):
    """Frames of the schemes come in turn. An engine tells its cycles itself."""
    added = []
    monkeypatch.setattr(
        simulate,
        "ResultFile",
        lambda config: SimpleNamespace(config=config, add=lambda *given: added.append(given)),
    )

    def frame(number, *last_cycles, **others):
        beat_cycle = [np.array([1, last]) for last in last_cycles]
        return SimpleNamespace(
            beats=number,
            commit_subgroup=None,
            commit_cycle=None,
            beat_cycle=beat_cycle,
            **others,
        )

    runs = {
        "off": SimpleNamespace(config=CONFIG, traces=[frame(0, 9, 19, 4)]),
        "auto": SimpleNamespace(config=CONFIG, traces=[frame(1, 29, 3, 4), frame(2, 1, 2, 39)]),
    }
    golden = simulate.GoldenRuns(runs, 2, 7.5)
    played = simulate.play_runs(golden, "golden", tmp_path)
    assert [given[0] for given in added] == [0, 1, 2]
    assert (played.cycles, played.checked) == (20 + 30 + 40, 0)
    assert (played.seconds, played.wave) == (7.5, None)
    assert simulate._cycles(frame(3, 9, 19, cycles=77)) == 77
