# SPDX-License-Identifier: Apache-2.0
"""Setups of a campaign in batches, and the told progress of long frames."""

from concurrent.futures import Future
from itertools import chain
from types import SimpleNamespace

import numpy as np
import pytest

from coincid.lab import campaign
from coincid.lab.campaign import TOGETHER_MAX, Processes, batches, read_batch
from coincid.lab.long_frames import play_last_frame, play_long_frames
from coincid.lab.setup import Setup, seeded
from coincid.model.contract.config import parse_config
from coincid.model.contract.edges import Edges
from coincid.model.golden.frame import Golden

SENSORS = [parse_config({"sensor": {"rows": rows, "cols": 8}}).sensor for rows in (8, 16)]
CONFIG = parse_config(
    {"sensor": {"rows": 8, "cols": 8}, "frame": {"frames": 3, "pulses": 5, "period": 60}}
)


def setups(engine, *numbers):
    """Return setups of an engine, so many of each sensor, in turn."""
    queue = [[sensor] * number for sensor, number in zip(SENSORS, numbers, strict=False)]
    mixed = [of.pop() for _ in range(max(numbers)) for of in queue if of]
    return [SimpleNamespace(engine=engine, config=SimpleNamespace(sensor=one)) for one in mixed]


@pytest.mark.parametrize("workers", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("numbers", [(1,), (2,), (5,), (7,), (16, 3), (9, 9)])
def test_setups_are_spread_over_the_workers(numbers, workers):
    """Each once, in batches of one sensor. No worker gets a second batch while a batch has room."""
    given = setups("sliced", *numbers)
    found = batches(given, workers)
    assert sorted(chain(*found)) == list(range(len(given)))
    for batch in found:
        assert 0 < len(batch) <= TOGETHER_MAX
        assert len({id(given[k].config.sensor) for k in batch}) == 1
    for sensor, number in zip(SENSORS, numbers, strict=False):
        of_sensor = [one for one in found if given[one[0]].config.sensor is sensor]
        assert len(of_sensor) <= max(workers, -(-number // TOGETHER_MAX))
        assert len(of_sensor) >= min(workers, number) / 2


def test_a_batch_has_no_more_setups_than_the_engine_plays_at_once():
    """Its words have a lane for each of 512 subgroups."""
    large = parse_config({"sensor": {"rows": 128, "cols": 128}}).sensor  # of 256 subgroups
    given = [SimpleNamespace(engine="sliced", config=SimpleNamespace(sensor=large))] * 5
    assert batches(given, 1) == [[0, 1], [2, 3], [4]]


@pytest.mark.parametrize("engine", ["golden", "verilator"])
def test_other_engines_play_one_setup_at_a_time(engine):
    assert batches(setups(engine, 3, 2), 2) == [[0], [1], [2], [3], [4]]


def test_setups_that_cannot_be_played_together_are_played_alone(monkeypatch):
    """So an error of one of them is not that of the others."""

    def together(jobs):
        raise ValueError("one of them")

    def read(run):
        if run.setup.seed == 2:
            raise ValueError("the second")
        return run.setup.seed

    monkeypatch.setattr(campaign, "replay_together", together)
    wall = Setup.of("flat:5", sensor={"rows": 8, "cols": 8}, frame={"pulses": 4}, engine="sliced")
    outcomes = read_batch(read, seeded(wall, 3))
    assert [found for found, _ in outcomes] == [1, None, 3]
    assert [str(error or "") for _, error in outcomes] == ["", "the second", ""]


def test_all_setups_of_a_batch_fail_if_its_process_is_lost():
    class Lost:
        def submit(self, *_):
            future = Future()
            future.set_exception(OSError("lost"))
            return future

    processes = Processes(2)
    processes._pool = Lost()
    played = list(processes.play(str, setups("sliced", 5)))
    assert sorted(number for number, _, _ in played) == list(range(5))
    assert {str(error) for _, _, error in played} == {"lost"}
    assert processes.done == processes.total == 5


def chunks():
    """Yield a frame and a half, the rest up to the last pulse, and nothing more."""
    pulse = np.repeat(np.arange(15), 2)
    edges = Edges(pulse, np.arange(30) % 64, np.arange(30) * 7)
    yield edges.take(edges.pulse < 8)
    yield edges.take(edges.pulse >= 8)


TOLD = [(5 / 15, 10), (8 / 15, 16), (10 / 15, 20), (15 / 15, 30)]


def test_the_told_share_of_a_long_run_ends_with_all():
    """It is that of the pulses that are done, beside the edges so far."""
    told = []
    golden = Golden(CONFIG.sensor)
    play_long_frames(golden, CONFIG, chunks(), lambda *done: told.append(done))
    assert told == [pytest.approx(one) for one in TOLD]
    told.clear()
    players = [(golden, CONFIG.with_frame(frames=1))]
    play_last_frame(players, 3, chunks(), progress=lambda *done: told.append(done))
    assert told == [pytest.approx(one) for one in TOLD]
