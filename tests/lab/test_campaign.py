# SPDX-License-Identifier: Apache-2.0
"""Campaigns with workers that finish in any order: outcomes, errors, kept files and progress."""

import contextlib
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import dask
import pytest

from coincid.lab import campaign as lab_campaign
from coincid.lab import dask_workers
from coincid.lab.campaign import FinishedFiles, Processes, campaign, grouped
from coincid.lab.dask_workers import Dask
from coincid.model.shared.errors import InputError

NAMES = ("events", "wrong_share", "bound_mm")


def setup(key, fails=False):
    return SimpleNamespace(key=key, fails=fails)


def read(one):
    return {"events": len(one.key), "wrong_share": 0.25, "bound_mm": None}


class Workers:
    """Workers that finish the last setup first. played: the keys of the setups, in this order."""

    def __init__(self):
        self.played = []

    def play(self, read, setups):
        for number in reversed(range(len(setups))):
            one = setups[number]
            self.played.append(one.key)
            if one.fails:
                yield number, None, ZeroDivisionError(one.key)
            else:
                yield number, read(one), None


def test_outcomes_are_in_the_order_of_the_setups():
    """Not in that in which they are done."""
    workers = Workers()
    setups = {name: setup(name * length) for name, length in (("c", 3), ("a", 1), ("b", 2))}
    found = campaign(setups, read, workers)
    assert workers.played == ["bb", "a", "ccc"]
    assert list(found) == ["c", "a", "b"]
    assert [one["events"] for one in found.values()] == [3, 1, 2]


def test_what_is_finished_is_kept_and_not_played_again(tmp_path):
    """In the place of its setup; and setups of equal content are played once."""
    finished = FinishedFiles(tmp_path, NAMES)
    campaign({1: setup("a"), 2: setup("bb")}, read, Workers(), finished=finished)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json", "bb.json"]
    workers = Workers()
    told = []
    setups = {
        "new": setup("ccc"),
        "old": setup("bb"),
        "again": setup("ccc"),
        "first": setup("a"),
        "last": setup("dddd"),
    }
    found = campaign(setups, read, workers, finished=finished, progress=told.append)
    assert workers.played == ["dddd", "ccc"]
    assert {key: one["events"] for key, one in found.items()} == {
        "new": 3,
        "old": 2,
        "again": 3,
        "first": 1,
        "last": 4,
    }
    assert list(found) == list(setups)
    assert told == [2, 3, 4]
    assert finished.load("ccc") == read(setup("ccc"))


def test_without_kept_files_equal_setups_are_played_each():
    workers = Workers()
    told = []
    campaign({1: setup("a"), 2: setup("a")}, read, workers, progress=told.append)
    assert workers.played == ["a", "a"]
    assert told == [0, 1, 2]


def test_every_setup_that_fails_has_its_error(tmp_path):
    """Also those whose content failed once for all of them. The others are found and kept."""
    finished = FinishedFiles(tmp_path, NAMES)
    setups = {
        "good": setup("good"),
        "bad": setup("bad", fails=True),
        "worse": setup("worse", fails=True),
        "bad again": setup("bad", fails=True),
        "fine": setup("fine"),
    }
    failed = {"before": ValueError("of another campaign")}
    told = []
    found = campaign(
        setups, read, Workers(), finished=finished, failed=failed, progress=told.append
    )
    assert list(found) == ["good", "fine"]
    assert {key: str(error) for key, error in failed.items()} == {
        "before": "of another campaign",
        "bad": "bad",
        "worse": "worse",
        "bad again": "bad",
    }
    assert told == [0, 1, 2, 3, 4]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fine.json", "good.json"]


def test_the_first_error_ends_a_campaign_that_keeps_none(tmp_path):
    """What was done before it is kept for the next one."""
    finished = FinishedFiles(tmp_path, NAMES)
    setups = {1: setup("a"), 2: setup("bb", fails=True), 3: setup("ccc")}
    with pytest.raises(ZeroDivisionError, match="bb"):
        campaign(setups, read, Workers(), finished=finished)
    assert [path.name for path in tmp_path.iterdir()] == ["ccc.json"]


def test_outcomes_of_groups_stay_in_their_groups():
    """Also beside a group of nothing."""
    groups = {
        "few": [setup("a"), setup("bb")],
        "none": [],
        "one": [setup("ccc")],
    }
    found = grouped(groups, lambda one: one.key, Workers())
    assert found == {"few": ["a", "bb"], "none": [], "one": ["ccc"]}
    assert list(found) == list(groups)


RIGHT = '{"events": 3, "wrong_share": 0.5, "bound_mm": null}'


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "3",
        "null",
        "[]",
        '["events", "wrong_share", "bound_mm"]',
        '{"events": 3, "wrong_share": 0.5}',
        '{"wrong_share": 0.5, "events": 3, "bound_mm": null}',
        RIGHT.replace("}", ', "more": 1}'),
        RIGHT.replace("events", "edges"),
    ],
)
def test_a_file_of_another_content_is_no_outcome(text, tmp_path):
    """So the setup is played again."""
    finished = FinishedFiles(tmp_path, NAMES)
    (tmp_path / "a.json").write_text(RIGHT, encoding="utf-8")
    assert finished.load("a") == {"events": 3, "wrong_share": 0.5, "bound_mm": None}
    (tmp_path / "a.json").write_text(text, encoding="utf-8")
    assert finished.load("a") is None
    assert finished.load("b") is None


def test_a_kept_outcome_comes_back_with_the_types_of_its_numbers(tmp_path):
    finished = FinishedFiles(tmp_path / "new" / "folder", NAMES)
    outcome = {"events": 1 << 40, "wrong_share": 1 / 3, "bound_mm": None}
    finished.store("a", outcome)
    found = finished.load("a")
    assert found == outcome
    assert [type(one) for one in found.values()] == [int, float, type(None)]


@pytest.mark.parametrize("workers", [1, 2])
def test_results_of_tasks_are_in_the_order_of_the_tasks(workers, monkeypatch):
    """Though the first of two ends after the second."""
    monkeypatch.setattr(lab_campaign, "worker_processes", ThreadPoolExecutor)
    second_is_done = threading.Event()
    if workers == 1:
        second_is_done.set()

    def double(item):
        if item == 5:
            assert second_is_done.wait(timeout=60)
        else:
            second_is_done.set()
        return 2 * item

    told = []
    with Processes(workers, lambda *done: told.append(done)) as several:
        assert several.map(double, iter([5, 3, 4])) == [10, 6, 8]
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_a_kept_outcome_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    """A file that cannot take its place leaves the one that is there, and nothing else."""
    finished = FinishedFiles(tmp_path, NAMES)
    finished.store("a", read(setup("a")))

    def refused(source, target):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "replace", refused)
    for key in ("a", "bb"):
        with pytest.raises(InputError, match=f"{key}.json: cannot be written: Input/output error"):
            finished.store(key, read(setup("long")))
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]
    assert finished.load("a") == read(setup("a"))


class Asked(Exception):
    """A cluster was asked for."""


@pytest.mark.parametrize(
    ("workers", "setups", "asked"), [(8, 2, 2), (2, 8, 2), (1, 3, 1), (4, 4, 4), (3, 0, None)]
)
@pytest.mark.parametrize("scheduler", [None, "tcp://127.0.0.1:8786"])
def test_a_cluster_has_no_more_workers_than_there_are_setups(
    workers, setups, asked, scheduler, monkeypatch
):
    """Without a setup there is none at all."""
    clusters = []

    def cluster(*given):
        clusters.append(given)
        raise Asked

    monkeypatch.setattr(dask_workers, "cluster", cluster)
    played = Dask(workers, scheduler).play(read, [setup("a")] * setups)
    if asked is None:
        assert list(played) == []
        assert not clusters
        return
    with pytest.raises(Asked):
        next(played)
    assert clusters == [(asked, scheduler)]


@pytest.mark.parametrize(
    "address",
    ["", "localhost", "tcp://", "tcp://localhost", "tcp://localhost:port", "moon://localhost:8786"],
)
def test_what_is_no_address_of_a_scheduler_is_refused_at_once(address):
    told = "^scheduler = .*: must be an address such as tcp://HOST:8786"
    with pytest.raises(InputError, match=told), dask_workers.cluster(1, address):
        raise AssertionError("there is no cluster")


def test_a_worker_with_another_version_plays_nothing(monkeypatch):
    """Its numbers could differ."""
    monkeypatch.setattr(dask_workers, "versions", lambda engine: {"code": f"of {engine}"})
    read_there = []
    monkeypatch.setattr(dask_workers, "read_batch", lambda *given: read_there.append(given))
    golden = [SimpleNamespace(engine="golden")]
    with pytest.raises(RuntimeError, match=r"versions are not the sweep's: .*of golden.*, .*other"):
        dask_workers._read_batch(read, golden, [None], {"code": "other"})
    assert not read_there


class LocalCluster:
    """Stands in for the workers of this machine. ended: whether they have ended."""

    ended = False

    def __init__(self, **given):
        self.given = given

    def __enter__(self):
        return self

    def __exit__(self, *raised):
        self.ended = True


def test_a_cluster_of_its_own_is_of_this_machine_and_outlives_lost_workers(monkeypatch):
    """Nobody else reaches it, a worker plays one setup at a time, and the campaign takes Ctrl-C."""
    setting = "distributed.scheduler.allowed-failures"
    before = dask.config.get(setting)
    asked = {}

    def local(**given):
        asked.update(given, lost=dask.config.get(setting))
        return LocalCluster()

    monkeypatch.setattr(dask_workers, "LocalCluster", local)
    monkeypatch.setattr(
        dask_workers, "Client", lambda scheduler, **options: contextlib.nullcontext(scheduler)
    )
    with dask_workers.cluster(3) as client:
        assert isinstance(client, LocalCluster)
    assert client.ended
    assert (asked["n_workers"], asked["threads_per_worker"]) == (3, 1)
    places = asked["host"], asked["scheduler_kwargs"]["dashboard_address"]
    assert places == ("127.0.0.1", "127.0.0.1:0")
    assert asked["dashboard_address"] is None and not asked["scheduler_kwargs"]["dashboard"]
    assert asked["memory_limit"] is None
    assert "signal.SIG_IGN" in asked["preload"]
    assert (asked["lost"], dask.config.get(setting)) == (20, before)


@pytest.mark.parametrize("error", [OSError("no more processes"), RuntimeError("no start")])
def test_workers_that_do_not_start_are_told_with_their_number(error, monkeypatch):
    def refused(**given):
        raise error

    monkeypatch.setattr(dask_workers, "LocalCluster", refused)
    told = rf"^workers = 3: they do not start \({error}\)$"
    with pytest.raises(InputError, match=told), dask_workers.cluster(3):
        raise AssertionError("there is no cluster")


@pytest.mark.parametrize("address", [None, "tcp://127.0.0.1:8786"])
def test_a_scheduler_that_does_not_answer_is_told_and_its_workers_end(address, monkeypatch):
    """Those of a cluster of its own."""
    local = LocalCluster()

    def client(scheduler, **options):
        assert scheduler is local or scheduler == address
        raise OSError("timed out")

    monkeypatch.setattr(dask_workers, "LocalCluster", lambda **given: local)
    monkeypatch.setattr(dask_workers, "Client", client)
    told = r"^scheduler = .*: no Dask scheduler answers \(timed out\)$"
    with pytest.raises(InputError, match=told), dask_workers.cluster(1, address):
        raise AssertionError("there is no cluster")
    assert local.ended == (address is None)


def played_by(monkeypatch, client):
    """Let a client stand in for that of a cluster."""
    monkeypatch.setattr(dask_workers, "cluster", lambda *given: contextlib.nullcontext(client))
    monkeypatch.setattr(dask_workers, "as_completed", lambda tasks, loop: iter(tasks))


def test_a_scheduler_that_is_lost_ends_the_campaign(monkeypatch):
    """Not as an error of the setup that was played: it runs again next time."""

    class Lost:
        def result(self):
            raise dask_workers.FutureCancelledError("task", "lost")

    class Client:
        loop = None

        def submit(self, *given, **options):
            return Lost()

    played_by(monkeypatch, Client())
    monkeypatch.setattr(dask_workers, "evolve", lambda setup, scene: setup)
    monkeypatch.setattr(dask_workers, "batches", lambda setups, workers: [[0]])
    one = SimpleNamespace(key="a", scene=None, engine="golden")
    failed = {}
    with pytest.raises(dask_workers.SchedulerLost, match="finished points are kept: start the sw"):
        campaign({1: one}, read, Dask(1), failed=failed)
    assert not failed


def test_what_a_batch_could_not_play_is_the_error_of_each_of_its_setups(monkeypatch):
    """And of no other one: a worker that refuses it says why."""

    class Task:
        def __init__(self, played):
            self.played = played

        def result(self):
            if len(self.played) > 1:
                raise RuntimeError("the worker's versions are not the sweep's")
            return [(read(one), None) for one in self.played]

    class Client:
        loop = None

        def submit(self, function, *given, **options):
            return Task(given[1]) if function is dask_workers._read_batch else None

    played_by(monkeypatch, Client())
    monkeypatch.setattr(dask_workers, "evolve", lambda setup, scene: setup)
    monkeypatch.setattr(dask_workers, "batches", lambda setups, workers: [[0, 2], [1], [3, 4]])
    setups = {name: SimpleNamespace(key=name, scene=None, engine="golden") for name in "abcde"}
    failed = {}
    told = []
    found = campaign(setups, read, Dask(2), failed=failed, progress=told.append)
    assert list(found) == ["b"]
    assert list(failed) == ["a", "c", "d", "e"]
    assert {dask_workers.reason(error) for error in failed.values()} == {
        "RuntimeError: the worker's versions are not the sweep's"
    }
    assert told == [0, 1, 2, 3, 4, 5]


def test_a_batch_is_played_with_its_own_scenes_and_versions(monkeypatch):
    """Not with those of the first setup: the engine of another batch has other versions."""

    class Task:
        def __init__(self, result):
            self.result = result

    class Client:
        loop = None

        def submit(self, function, *given, **options):
            if function is dask_workers._read_batch:
                read, bare, scenes, versions = given
                given = read, bare, [scene.result() for scene in scenes], versions
            return Task(lambda: function(*given))

    monkeypatch.setattr(dask_workers, "versions", lambda engine: {"code": f"of {engine}"})
    played_by(monkeypatch, Client())
    monkeypatch.setattr(
        dask_workers,
        "evolve",
        lambda setup, scene: SimpleNamespace(**vars(setup) | {"scene": scene}),
    )
    monkeypatch.setattr(dask_workers, "batches", lambda setups, workers: [[0, 2], [1]])
    monkeypatch.setattr(
        dask_workers, "read_batch", lambda read, setups: [(read(one), None) for one in setups]
    )
    engines = "golden", "sliced", "golden"
    scenes = [object() for _ in engines]
    setups = [
        SimpleNamespace(engine=engine, scene=scene)
        for engine, scene in zip(engines, scenes, strict=True)
    ]
    played = {number: found for number, *found in Dask(2).play(lambda one: one, setups)}
    assert [played[number][1] for number in range(3)] == [None] * 3
    assert [played[number][0].scene for number in range(3)] == scenes
