# SPDX-License-Identifier: Apache-2.0
"""Runs of the explorer: the golden model's result, cached stages, and answers only to the newest
request.
"""

import csv
import queue
import threading
import time
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
from bokeh.document import Document

from coincid.model.contract.config import parse_config
from coincid.model.contract.counts import NO_GATE
from coincid.model.contract.gate_counts import GATE_BINS
from coincid.model.contract.result import EVENT_COLUMNS, differences
from coincid.model.golden.frame import golden_result
from coincid.model.shared.errors import InputError
from coincid.study.explore import out, stages
from coincid.study.explore.control_values import check_settings
from coincid.study.explore.messages import Question
from coincid.study.explore.out import SAVES, counts_csv, events_csv
from coincid.study.explore.stages import THREADS, Explorer, Runner, check_on_rtl
from coincid.study.explore.tab import Page
from coincid.study.explore.uploads import Kept, Uploads
from coincid.tb import replay as replay_module

SMALL = {"rows": 16, "cols": 16, "pulses": 20}


def test_a_run_is_the_golden_models_whatever_was_run_before():
    explorer = Explorer()
    gated, led = {"gating": True, "spad_gate": True}, {"frames": 3, "auto": True}
    for values in (
        {},
        {"threshold": 4},
        {"klux": 5.0},
        {"gating": True},
        gated,
        led,
        {"phases": 16},
        {},
    ):
        explored = explorer.run(check_settings(SMALL | values))
        fresh = Explorer().run(check_settings(SMALL | values))
        assert not differences(explored.run.result, fresh.run.result)
        assert not differences(
            explored.run.result, golden_result(explored.settings.config, explored.run.edges)
        )


def test_numbers_agree_with_each_other():
    view = Explorer().run(check_settings(SMALL | {"coincidence": False, "fifo_depth": 1})).view()
    numbers = view.numbers
    assert (
        numbers["committed"] == numbers["events"] + numbers["dropped"]
        and 0 < numbers["sun_share"] <= 1
    )
    assert view.drops[::8, ::8].sum() == numbers["dropped"] > 0
    of_pixel, of_subgroup = view.histogram(3, 5)
    assert of_subgroup.sum() == view.events.bounds[1] and np.all(of_pixel <= of_subgroup)
    hits = sum(view.histogram(row, col)[0].sum() for row in range(8) for col in range(8))
    assert hits == view.events.count[: view.events.bounds[1]].sum()


def test_progress_may_stop_a_run():
    seen = []

    def progress(stage, share):
        assert 0 <= share <= 1
        seen.append(stage)
        if stage == "golden model":
            raise StopIteration

    with pytest.raises(StopIteration):
        Explorer().run(check_settings(SMALL), progress)
    assert seen[0] == "scene" and "depth" not in seen


def test_so_much_light_that_no_memory_holds_its_edges_is_refused(monkeypatch):
    """As many as are allowed are not."""
    explored = Explorer().run(check_settings(SMALL))
    edges = len(explored.run.edges)
    monkeypatch.setattr(stages, "EDGES_MAX", edges)
    assert len(Explorer().run(check_settings(SMALL)).run.edges) == edges
    monkeypatch.setattr(stages, "EDGES_MAX", edges - 1)
    with pytest.raises(InputError, match=f"^edges: more than {edges - 1:,} in so much light"):
        Explorer().run(check_settings(SMALL))


@pytest.mark.parametrize("more", [0, 1])
def test_thirty_million_edges_are_not_too_many(monkeypatch, more):
    class PlayedError(Exception):
        """The photons are drawn."""

    def run(setup, *, cache, workers, watch):
        watch("photons", 1.0, 30_000_000 + more)
        raise PlayedError

    monkeypatch.setattr(stages, "Run", run)
    with pytest.raises(InputError if more else PlayedError):
        Explorer().run(check_settings(SMALL))


def test_the_results_before_and_that_of_a_are_kept():
    """So going back and forth between three settings draws no photons again."""
    explorer, stages_of = Explorer(), []
    for klux in (1.0, 2.0, 3.0, 1.0, 2.0, 3.0):
        told = set()
        settings = check_settings(SMALL | {"rows": 8, "cols": 8, "klux": klux})
        explorer.run(settings, lambda stage, share, told=told: told.add(stage))
        stages_of.append(told)
    assert all("photons" in told for told in stages_of[:3])
    assert not any("photons" in told for told in stages_of[3:])


def test_the_time_of_a_result_is_that_of_its_run_in_seconds():
    began = time.perf_counter()
    explored = Explorer().run(check_settings(SMALL))
    assert 0 < explored.seconds <= time.perf_counter() - began


def test_every_stage_is_told_and_its_shares_now_and_then(monkeypatch):
    now = [50.0]
    monkeypatch.setattr(stages.time, "monotonic", lambda: now[0])
    got, done = [], threading.Event()

    def deliver(number, kind, outcome):
        got.append(outcome)
        if kind == "done":
            done.set()

    def work(progress):
        for stage, share, passed in (
            ("a", 0.0, 0.01),
            ("a", 0.1, 0.2),
            ("a", 0.2, 0.01),
            ("b", 0.3, 0.01),
            ("b", 0.4, 0.09),
            ("b", 0.5, 0.09),
        ):
            now[0] += passed
            progress(stage, share)

    runner = Runner(deliver)
    runner.start(work)
    assert done.wait(60)
    assert got == [("begins", 0.0), ("a", 0.0), ("a", 0.1), ("b", 0.3), ("b", 0.5), None]
    runner.close()


@pytest.mark.parametrize("end", [Runner.cancel, Runner.close])
def test_work_that_fails_after_its_end_is_not_told(end):
    got, begun, go = [], threading.Event(), threading.Event()

    def fails(progress):
        begun.set()
        go.wait(60)
        raise ValueError("of no use")

    runner = Runner(lambda *answer: got.append(answer[1]))
    runner.start(fails)
    assert begun.wait(60)
    end(runner)
    go.set()
    runner._pool.shutdown(wait=True)
    assert got == ["progress"]


def test_only_the_newest_answer_is_delivered():
    got, begun, go = queue.Queue(), threading.Event(), threading.Event()

    def slow(progress):
        begun.set()
        go.wait(60)
        progress("late", 0.5)
        return "old"

    def bad(progress):
        raise ValueError("of no use")

    runner = Runner(lambda *answer: answer[1] == "progress" or got.put(answer))
    runner.start(slow)
    assert begun.wait(60)
    newest = runner.start(lambda progress: "new")
    go.set()
    assert got.get(timeout=60) == (newest, "done", "new")
    newest = runner.start(bad)
    assert got.get(timeout=60)[:2] == (newest, "failed") and got.empty()
    runner.close()


def test_a_job_begins_while_three_cancelled_ones_are_still_ending():
    """They may be in a long step, which tells no progress."""
    begun, go, got = queue.Queue(), threading.Event(), queue.Queue()

    def busy(progress):
        begun.put("")
        go.wait(60)

    runner = Runner(lambda *answer: answer[1] == "progress" or got.put(answer))
    for _ in range(3):
        runner.start(busy)
        begun.get(timeout=60)
    newest = runner.start(lambda progress: "new")
    try:
        assert got.get(timeout=30) == (newest, "done", "new")
    finally:
        go.set()
        runner.close()


def test_work_that_is_cancelled_before_it_begins_is_never_done():
    """Neither that which an order took back, nor that which a newer one replaced."""
    begun, go, played = threading.Barrier(THREADS + 1), threading.Event(), []

    def busy(progress):
        begun.wait(60)
        go.wait(60)

    def work(name):
        return lambda progress: played.append(name)

    got = queue.Queue()
    runner = Runner(lambda *answer: answer[1] == "progress" or got.put(answer))
    for _ in range(THREADS):
        runner.start(busy)
    begun.wait(60)
    runner.start(work("taken back"))
    runner.cancel()
    runner.start(work("replaced"))
    newest = runner.start(work("newest"))
    go.set()
    assert got.get(timeout=60) == (newest, "done", None)
    assert played == ["newest"]
    runner.close()


def test_the_check_of_settings_that_have_changed_is_never_told():
    """Its verdict would stand beside other settings."""
    doc = Document()
    page = Page(doc, {}, Uploads(), Kept())
    page._checker._deliver = lambda *what: None
    checked = page._checker.start(lambda progress: None)
    page._asked(Question(number=2, values={"threshold": "no number"}))
    page._checked(checked, "done", "every word agrees")
    assert not page.link.rtl_check
    current = page._checker.start(lambda progress: None)
    page._checked(current, "done", "every word agrees")
    assert page.link.rtl_check["text"] == "every word agrees"
    page.close()


def test_what_is_saved():
    explored = Explorer().run(check_settings(SMALL))
    names = {name: (save.name, save.media_type) for name, save in SAVES.items()}
    assert names == {
        "toml": ("coincid.toml", "application/toml"),
        "csv": ("events.csv", "text/csv"),
        "png": ("depth.png", "image/png"),
    }
    for save in SAVES.values():
        assert save.content(explored, 0)
    rows = list(csv.DictReader(events_csv(explored, 0).decode().splitlines()))
    assert len(rows) == len(explored.run.result["pulse"])
    assert int(rows[0]["count"]) == int(rows[0]["hits"], 16).bit_count()
    assert (
        parse_config(tomllib.loads(SAVES["toml"].content(explored, 0).decode())).pulses
        == SMALL["pulses"]
    )


def test_the_saved_events_are_the_arrays_of_all_frames():
    """A line for each event, with every number as it is, however many pulses the frames have."""
    columns = {name: np.array([-1, 5, 2**40]) + k for k, name in enumerate(EVENT_COLUMNS)}
    columns["overrun"] = np.array([False, True, True])
    hits = np.array([[0, 0], [10, 0], [255, 1 << 63]], np.uint64)
    explored = SimpleNamespace(run=SimpleNamespace(result={**columns, "hits": hits}))
    lines = events_csv(explored, 1).decode().split("\n")
    assert lines.pop() == ""
    assert lines[0] == ",".join([*EVENT_COLUMNS, "hits"])
    for n, hexadecimal in enumerate(("0", "a", f"8{'0' * 29}ff")):
        numbers = [str(int(columns[name][n])) for name in EVENT_COLUMNS]
        assert lines[n + 1] == ",".join([*numbers, hexadecimal])
    assert len(lines) == 4


def test_a_saved_picture_is_that_of_the_frame_that_is_shown(monkeypatch):
    """With the name of its estimator, and the light."""
    drawn = []

    def noted(panels, truth_m, heading):
        drawn.append((panels[0], heading))
        return None, []

    monkeypatch.setattr(out, "draw_row", noted)
    monkeypatch.setattr(out, "figure_bytes", lambda figure, kind: kind.encode())
    values = {"frames": 3, "method": "maximum", "klux": 7.0, "sun": "left half"}
    explored = Explorer().run(check_settings(SMALL | values))
    for frame in (1, 0, 2):
        assert SAVES["png"].content(explored, frame) == b"png"
        panel, heading = drawn[-1]
        assert np.array_equal(panel.depth_m, explored.view(frame).depth_m, equal_nan=True)
        assert np.array_equal(panel.reason, explored.view(frame).reason)
        assert panel.title == "maximum"
        assert heading == "five-objects, 7 klux on the left half, 5 klux on the right"


def test_counts_are_saved_in_place_of_events():
    explored = Explorer().run(check_settings(SMALL | {"format": "counts", "klux": 80.0}))
    rows = list(csv.DictReader(SAVES["csv"].content(explored, 0).decode().splitlines()))
    result = explored.run.result
    assert np.isnan(explored.view().bound_mm).all()  # which is that of events
    assert len(rows) == 2 * result["count_pulses"].size
    hits = np.array([[int(row[name]) for name in row if name.startswith("hits")] for row in rows])
    assert (
        np.array_equal(hits.reshape(result["gate_hits"].shape), result["gate_hits"]) and hits.any()
    )
    opened = {int(row["gate_cycle"]) for row in rows if row["gate_cycle"]}
    assert opened == set(result["gate_cycle"].ravel().tolist()) - {NO_GATE}


def test_saved_counts_name_their_place_and_their_gate():
    """A line per frame, subgroup, pixel and gate; a gate is that of the pixel's minigroup."""
    size = {"rows": 4, "cols": 16, "subgroup": [4, 8]}
    config = parse_config({"sensor": size | {"counts": 1}, "frame": {"format": "counts"}})
    frames, subgroups, pixels, gates = 3, 2, 32, 2  # 8 minigroups of 2 x 2 pixels
    gate_cycle = 1000 + np.arange(frames * subgroups * 8 * gates).reshape(frames, subgroups, 8, 2)
    gate_cycle[1, 1, 2, 0] = NO_GATE
    hits = np.arange(frames * subgroups * pixels * gates * GATE_BINS)
    hits = hits.reshape(frames, subgroups, pixels, gates, GATE_BINS)
    pulses = 10_000 + np.arange(frames * subgroups * pixels).reshape(frames, subgroups, pixels)
    result = {"gate_cycle": gate_cycle, "gate_hits": hits, "count_pulses": pulses}
    explored = SimpleNamespace(run=SimpleNamespace(config=config, result=result))
    text, end = counts_csv(explored, 1).decode().rsplit("\n", 1)
    assert end == ""
    lines = [line.split(",") for line in text.split("\n")]
    names = [f"hits{one}" for one in range(GATE_BINS)]
    assert lines[0] == ["frame", "subgroup", "pixel", "gate", "gate_cycle", *names, "count_pulses"]
    expected = []
    for frame, subgroup, pixel, gate in np.ndindex(frames, subgroups, pixels, gates):
        row, col = divmod(pixel, 8)
        cycle = gate_cycle[frame, subgroup, row // 2 * 4 + col // 2, gate]
        counted = hits[frame, subgroup, pixel, gate]
        numbers = [frame, subgroup, pixel, gate, "" if cycle == NO_GATE else cycle, *counted]
        expected.append([str(one) for one in (*numbers, pulses[frame, subgroup, pixel])])
    assert lines[1:] == expected


@pytest.mark.parametrize(("frames", "told"), [(1, "frame"), (3, "3 frames")])
def test_the_verdict_of_the_check_counts_frames_words_and_events(monkeypatch, frames, told):
    """Of all streams; its share is that of all frames."""
    explored = Explorer().run(check_settings(SMALL | {"frames": frames, "streams": 2}))
    run, config = explored.run, explored.settings.config
    asked, shares = [], []

    def replayed(engine, its_config, edges, *, progress):
        asked.append((engine, its_config, edges))
        for share in (0.25, 1.0, 1.5):
            progress(share * config.frame_cycles * frames)
        return run.result

    monkeypatch.setattr(replay_module, "replay", replayed)
    verdict = check_on_rtl(explored, lambda stage, share: shares.append((stage, share)))
    assert asked == [("sliced", config, run.edges)]
    assert [share for stage, share in shares if stage == "RTL"] == pytest.approx([0.25, 1, 1])
    words = sum(len(stream) for trace in run.traces for stream in trace.beats)
    assert all(len(stream) for trace in run.traces for stream in trace.beats)
    events = len(run.result["pulse"])
    assert (
        verdict == f"Every word agrees: the RTL sent the same {told}, {words:,} words"
        f" with {events:,} events, each in the same cycle of commit."
    )
    changed = run.result | {"count": run.result["count"] + 1}
    monkeypatch.setattr(replay_module, "replay", lambda *given, progress: changed)
    assert check_on_rtl(explored).startswith("The RTL and the golden model differ: ")


def test_the_rtl_sends_the_same_words():
    explored = Explorer().run(
        check_settings(SMALL | {"rows": 8, "pulses": 5})
    )  # a sensor that other tests compile, too
    assert check_on_rtl(explored).startswith("Every word agrees: the RTL sent the same frame")
    explored.run.result["count"][0] += 1
    assert "count[0]" in check_on_rtl(explored)
