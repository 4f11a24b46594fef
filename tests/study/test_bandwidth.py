# SPDX-License-Identifier: Apache-2.0
"""The bandwidth study: estimate and golden model agree, and its statements about streams hold."""

from pathlib import Path

import numpy as np
import pytest

from coincid.lab.measures import stream_beats
from coincid.model.contract.config import parse_config
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.packet import FORMATS
from coincid.model.golden.frame import Golden
from coincid.model.light.light import Light
from coincid.model.light.photons import generate_edges
from coincid.model.light.spad import Spad
from coincid.model.light.timing import Timing
from coincid.study import bandwidth

from ..command import command
from ..random_cases import configured

PAGE = Path(__file__).parents[2] / "docs" / "performance.md"


@pytest.mark.parametrize(
    ("klux", "threshold", "window"), [(0, 1, 16), (20, 1, 1), (20, 2, 16), (50, 3, 40), (100, 2, 16), (100, 4, 64)]
)
def test_estimate_is_what_the_golden_model_counts(klux, threshold, window):
    """Over many pulses, on planes at several distances, the difference is within what the estimate leaves out."""
    config = configured(
        {"rows": 16, "cols": 32},
        {"pulses": 2000, "minigroup_records": True},
        {"threshold": threshold, "window": window},
        {"subgroups": [1], "coincidence": False},
    )
    distance_m = np.repeat([[4.0] * 12 + [7.0] * 12 + [9.0] * 8], 16, axis=0)
    light, timing = Light.from_scene(distance_m, 0.3, klux), Timing.from_config(config)
    edges = generate_edges(light, Spad(), timing, pulses=config.pulses, seed=3)
    counters = dict(zip(COUNTER_NAMES, Golden(config.sensor).frame(config, edges).counters.T / config.pulses))
    events, records = bandwidth.estimate(config, light, timing, Spad())
    assert events == pytest.approx(counters["committed"], rel=0.1, abs=0.03)
    assert records == pytest.approx(counters["mg_stored"] + counters["mg_dropped"], abs=0.05)


@pytest.mark.parametrize("name", [name for name, packet in FORMATS.items() if not packet.grouped])
def test_beats_are_those_of_the_golden_model_where_nothing_is_lost(name):
    sensor, frame = {"rows": 16, "cols": 16, "streams": 3}, {"pulses": 20, "format": name, "minigroup_records": True}
    config = parse_config({"sensor": sensor, "frame": frame})
    light, timing = Light.from_scene(np.full((16, 16), 5.0), 0.4, 20.0), Timing.from_config(config)
    trace = Golden(config.sensor).frame(config, generate_edges(light, Spad(), timing, pulses=20, seed=1))
    count = dict(zip(COUNTER_NAMES, trace.counters.T))
    assert count["dropped"].sum() == count["mg_dropped"].sum() == 0 < count["mg_stored"].sum()
    assert stream_beats(config, count["committed"], count["mg_stored"]).tolist() == list(map(len, trace.beats))


def test_fewer_streams_lose_and_enough_lose_nothing():
    rows = bandwidth.study(klux=(100.0,), thresholds=(2,), sizes=("32x32",))
    full = [row for row in rows if row.format == "full" and not row.records]
    lost = [row.lost_events for row in full]
    assert [row.lost_streams for row in full] == [1, 2, 4, 8] and full[-1].needed_golden == 8
    assert lost == sorted(set(lost), reverse=True) and lost[-1] == 0 == full[-1].overruns < full[0].overruns
    assert all(row.needed_estimated <= row.needed_golden for row in rows if row.lost_events > 0.01)
    assert all(row.beats_estimated == pytest.approx(row.beats_golden, rel=0.1) for row in rows)


def test_page_has_the_table_of_the_command():
    lines = PAGE.read_text().splitlines()
    table = bandwidth.table(bandwidth.study(klux=(50.0,), thresholds=(2, 3), sizes=("32x32",))).splitlines()
    start = lines.index(table[0])
    assert lines[start : start + len(table)] == table


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--klux", "-1"], "klux"),
        (["--threshold", "65"], "threshold = 65: must be an integer from 1 to 64"),
        (["--size", "8x8"], "size"),
    ],
)
def test_bad_input_is_told_before_anything_runs(arguments, message, tmp_path):
    result = command("bandwidth", *arguments, "--out", tmp_path / "out")
    assert result.exit_code == 2 and message in result.output and not (tmp_path / "out").exists()
