# SPDX-License-Identifier: Apache-2.0
"""The benchmark: it measures what it documents, and its slowest engine plays the sensor, too. No
times are asserted.
"""

import itertools
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from coincid.model.contract.edges import Edges
from coincid.model.golden.frame import Golden
from coincid.study import bench
from coincid.tb import pysim
from coincid.tb.frame_record import Recorded
from coincid.tb.rtl_errors import SimulationError
from coincid.tb.scoreboard import check

from ..random_cases import configured, trouble


def test_amaranths_simulator_plays_what_the_golden_model_predicts():
    sensor = {
        "rows": 4,
        "cols": 12,
        "subgroup": [4, 4],
        "streams": 2,
        "phases": 8,
        "window_max": 64,
    }
    frame = {"period": 30, "pulses": 4, "format": "full", "minigroup_records": True}
    config = configured(sensor, frame, {"window": 40, "threshold": 3})
    edges, cycles = trouble(config, 7, 40.0), []
    expected = Golden(config.sensor).frame(config, edges)
    beats, beat_cycle = pysim.play(config, edges, cycles.append)
    assert sum(map(len, beats)) > 100
    found = Recorded(
        beats, beat_cycle, expected.commit_subgroup, expected.commit_cycle, len(cycles)
    )
    check(config.sensor, expected, found)
    assert cycles == list(range(max(int(at[-1]) for at in beat_cycle) + 1))


def test_in_amaranths_simulator_a_stream_goes_on_while_another_ends():
    """All light is on the second stream, which has events left when the first one ends."""
    sensor = {"rows": 4, "cols": 8, "subgroup": [4, 4], "streams": 2, "phases": 8, "window_max": 16}
    config = configured(
        sensor, {"period": 40, "pulses": 2, "format": "full"}, {"window": 1, "threshold": 1}
    )
    light = trouble(config, 3, 60.0)
    right = light.pixel % config.sensor.cols >= 4
    edges = Edges(light.pulse[right], light.pixel[right], light.tick[right])
    expected = Golden(config.sensor).frame(config, edges)
    first, second = expected.beat_cycle
    assert first[-1] in second[:-1]
    beats, beat_cycle = pysim.play(config, edges)
    for stream in range(2):
        assert np.array_equal(beats[stream], expected.beats[stream])
        assert np.array_equal(beat_cycle[stream], expected.beat_cycle[stream])


def test_in_amaranths_simulator_a_frame_that_does_not_end_is_told(monkeypatch):
    """The limit is that of a receiver that takes every beat."""
    sensor = {"rows": 4, "cols": 4, "subgroup": [4, 4], "phases": 4, "window_max": 16}
    config = configured(sensor, {"period": 40, "pulses": 2}, {"window": 4, "threshold": 1})
    asked, cycles = [], []

    def cycle_limit(of, receiver_cycles):
        asked.append((of, receiver_cycles))
        return 9

    monkeypatch.setattr(pysim, "cycle_limit", cycle_limit)
    with pytest.raises(SimulationError, match="^no frame end after 9 cycles: the sensor hangs$"):
        pysim.play(config, trouble(config, 1, 5.0), cycles.append)
    assert cycles == list(range(9))
    assert {*map(repr, asked)} == {repr((config, 0))}


def test_page_shows_every_key():
    page = Path(__file__).parents[2] / "docs" / "performance.md"
    assert re.findall(r"^\| `(\w+)` \|", page.read_text(encoding="utf-8"), re.MULTILINE) == list(
        bench.KEYS
    )


@pytest.mark.parametrize("name", bench.PULSES)
def test_the_rate_of_a_slow_engine_is_that_between_its_first_and_its_last_message(
    name, monkeypatch
):
    """With a clock of our own. The engine plays the first pulses of the frame, and no more."""
    clock_s = iter([10.0, 12.5, 15.0])
    config = configured({"rows": 4, "cols": 4, "subgroup": [4, 4]}, {"pulses": 50})
    pulse = np.arange(50).repeat(2)
    edges = Edges(pulse=pulse, pixel=0 * pulse, tick=np.tile([3, 90], 50))
    played = []

    def play(of, light, progress):
        played.append((of.pulses, light.pulse.tolist()))
        for cycle in (1000, 3000, 6000):
            progress(cycle)

    def play_frames(jobs, engine, folder, progress):
        (job,) = jobs
        assert name == f"cocotb_{engine}" and folder.is_dir()
        play(job.config, job.edges, progress)

    monkeypatch.setattr(bench, "play", play_frames)
    monkeypatch.setattr(bench.pysim, "play", play)
    monkeypatch.setattr(bench, "time", SimpleNamespace(perf_counter=lambda: next(clock_s)))
    assert bench._rate(config, edges, name) == 1000.0
    pulses = bench.PULSES[name]
    assert played == [(pulses, np.arange(min(pulses, 50)).repeat(2).tolist())]


def test_benchmark_measures_every_key(tmp_path, monkeypatch):
    """Measure everything except the engines themselves, which take minutes."""
    numbers = itertools.count(1)

    def measured(*names):
        return {name: 1000.0 * next(numbers) for name in names}

    def in_new_process(function, size, *_, **environment):
        if function is bench._build_s:
            assert environment.keys() == {"COINCID_BUILD"}
            return float(next(numbers))
        return measured(*(key for key in bench.KEYS if key.startswith(f"frame_{size}_")))

    engines = ("golden", "golden_many", "sliced", "sliced_many")
    fast = ("photon_edges_per_s", *(bench.CYCLES_PER_S.format(engine) for engine in engines))
    monkeypatch.setattr(bench, "build_sensor", lambda *_: None)
    monkeypatch.setattr(bench, "_fast_rates", lambda *given: measured(*fast))
    monkeypatch.setattr(bench, "_rate", lambda job, edges, engine: 500.0)
    monkeypatch.setattr(bench, "_in_new_process", in_new_process)
    told, out = [], tmp_path / "new" / "bench.json"
    result = bench.benchmark(out, repeats=3, tell=told.append)
    assert (
        list(result) == list(bench.KEYS) and json.loads(out.read_text(encoding="utf-8")) == result
    )
    assert result["repeats"] == 3 and result["cocotb_icarus_cycles_per_s"] == 500 and told
    ratio = result["golden_cycles_per_s"] / result["sliced_cycles_per_s"]
    assert np.isclose(result["golden_per_sliced"], ratio, rtol=1e-3)
    rows = out.with_suffix(".md").read_text(encoding="utf-8").splitlines()
    assert [row.split("`")[1] for row in rows[2:]] == list(bench.KEYS)
    assert all(row.count("|") == 5 for row in rows)
