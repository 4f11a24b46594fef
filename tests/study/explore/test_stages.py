# SPDX-License-Identifier: Apache-2.0
"""Runs of the explorer: the golden model's result, cached stages, and answers only to the newest
request.
"""

import csv
import queue
import threading
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
from bokeh.document import Document

from coincid.model.contract.config import parse_config
from coincid.model.contract.counts import NO_GATE
from coincid.model.contract.result import EVENT_COLUMNS, differences
from coincid.model.golden.frame import golden_result
from coincid.study.explore import out
from coincid.study.explore.control_values import check_settings
from coincid.study.explore.messages import Question
from coincid.study.explore.out import SAVES, events_csv
from coincid.study.explore.stages import THREADS, Explorer, Runner, check_on_rtl
from coincid.study.explore.tab import Page
from coincid.study.explore.uploads import Kept, Uploads

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
    for kind, save in SAVES.items():
        assert save.content(explored, 0) and save.name.endswith(kind) and "/" in save.media_type
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
    lines = events_csv(explored, 1).decode().splitlines()
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


def test_the_rtl_sends_the_same_words():
    explored = Explorer().run(
        check_settings(SMALL | {"rows": 8, "pulses": 5})
    )  # a sensor that other tests compile, too
    assert check_on_rtl(explored).startswith("Every word agrees: the RTL sent the same frame")
    explored.run.result["count"][0] += 1
    assert "count[0]" in check_on_rtl(explored)
