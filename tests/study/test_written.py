# SPDX-License-Identifier: Apache-2.0
"""Numbers of a report and of a sweep's table stand under their own keys, from made-up runs."""

import json
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest

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
