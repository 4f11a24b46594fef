# SPDX-License-Identifier: Apache-2.0
"""The bandwidth study: beats are those of the golden model, and the statements about streams hold."""

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

PAGE = Path(__file__).parents[2] / "docs" / "performance.md"


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
    assert [row.streams for row in full] == [1, 2, 4, 8] and full[-1].needed == 8
    assert lost == sorted(set(lost), reverse=True) and lost[-1] == 0 == full[-1].overruns < full[0].overruns


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
