# SPDX-License-Identifier: Apache-2.0
"""The bar on a terminal: the share of its stage that is done."""

import io
import re
import threading
from types import SimpleNamespace

import pytest
from rich.console import Console

from coincid.study import progress
from coincid.study.progress import Bar

PATIENCE_S = 60.0  # that only a failure needs


def all_shown(*steps, lines=False):
    """Return the lines that a terminal shows of a bar behind these calls, (method, arguments)."""
    text = io.StringIO()
    with Bar(Console(file=text, force_terminal=True, width=100), lines=lines) as bar:
        for method, arguments in steps:
            getattr(bar, method)(*arguments)
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text.getvalue())
    return [line for line in re.split(r"[\r\n]", plain) if line.strip()]


def shown(*steps):
    """Return the last of these lines with a share."""
    return [line for line in all_shown(*steps) if "%" in line][-1]


def share(line):
    """Return the stage and the percents of a line of the bar."""
    return re.search(r"(\w+) .*?(\d+) %", line).groups()


def test_a_bar_is_gone_at_its_end():
    """Results stand where it was."""
    text = io.StringIO()
    with Bar(Console(file=text, force_terminal=True, width=100)) as bar:
        bar.at("photons", 3, 10)
    _, last, behind = text.getvalue().rpartition("%")
    assert last and "\x1b[2K" in behind


def test_a_stage_shows_the_part_of_its_own_total():
    """Whether it begins with its first part or before it."""
    assert share(shown(("at", ("photons", 3, 10)))) == ("photons", "30")
    steps = [("at", ("photons", 3, 10)), ("at", ("photons", 7, 10))]
    assert share(shown(*steps)) == ("photons", "70")
    assert share(shown(*steps, ("at", ("depth", 1, 4)))) == ("depth", "25")
    assert share(shown(("stage", ("golden", 50)), ("done", (20,)))) == ("golden", "40")


def test_a_total_may_change_and_a_new_stage_begins_at_nothing():
    steps = [("stage", ("golden", 50)), ("done", (20, 200))]
    assert share(shown(*steps)) == ("golden", "10")
    assert share(shown(*steps, ("stage", ("depth", 9)))) == ("depth", "0")


@pytest.mark.parametrize("lines", (False, True))
def test_a_terminal_shows_the_share_of_the_stage_that_runs(lines):
    """And no line beside it, nor the stages before."""
    begun = ("at", ("photons", 0, 8)), ("at", ("photons", 4, 8))
    last = all_shown(*begun, lines=lines)[-1]
    assert "photons" in last and " 50 %" in last
    every = all_shown(("at", ("photons", 3, 8)), ("at", ("depth", 1, 4)), lines=lines)
    assert "depth" in every[-1] and " 25 %" in every[-1]
    assert not any("photons" in line for line in every[-2:])
    assert not any("photons: " in line for line in every)


def test_without_a_terminal_nothing_is_shown_unless_lines_are_asked_for():
    for lines, told in ((False, ""), (True, "photons\ndepth\n")):
        text = io.StringIO()
        with Bar(Console(file=text), lines=lines) as bar:
            for stage in (("photons", 0, 8), ("photons", 8, 8), ("depth", 0, 2)):
                bar.at(*stage)
        assert text.getvalue() == told


class Told(io.StringIO):
    """Text that knows when a line that begins so has come twice."""

    def __init__(self, line):
        super().__init__()
        self._line, self.twice = line, threading.Event()

    def write(self, text):
        written = super().write(text)
        if self.getvalue().count(self._line) >= 2:
            self.twice.set()
        return written


def test_a_long_stage_says_that_it_lasts(monkeypatch):
    """Every few seconds; here, sooner."""
    assert 2 <= progress.LINE_EVERY_S <= 10
    monkeypatch.setattr(progress, "LINE_EVERY_S", 0.05)
    text = Told("photons: ")
    with Bar(Console(file=text), lines=True) as bar:
        bar.stage("photons")
        assert text.twice.wait(PATIENCE_S)
        bar.stage("depth")
    lines = text.getvalue().splitlines()
    assert lines[0] == "photons" and "depth" in lines
    assert re.fullmatch(r"photons: \d+ s", lines[1])


@pytest.mark.parametrize("terminal", (False, True))
@pytest.mark.parametrize("lines", (False, True))
def test_stages_that_last_are_watched_only_where_lines_tell_of_them(terminal, lines):
    """Up to the end of the bar."""
    others = set(threading.enumerate())
    with Bar(Console(file=io.StringIO(), force_terminal=terminal), lines=lines):
        watching = set(threading.enumerate()) - others
        own = [thread for thread in watching if thread.name == "progress"]
        assert len(own) == (lines and not terminal)
    for thread in own:
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


def test_a_stage_that_has_just_begun_does_not_say_that_it_lasts(monkeypatch):
    monkeypatch.setattr(progress, "LINE_EVERY_S", 0.01)
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: 5.0))
    text = io.StringIO()
    with Bar(Console(file=text), lines=True) as bar:
        bar.stage("photons")
        threading.Event().wait(0.1)
    assert text.getvalue() == "photons\n"


def test_a_stage_that_lasts_tells_its_own_seconds(monkeypatch):
    """Not those of the stages before it."""
    now_s = 100.0
    monkeypatch.setattr(progress, "LINE_EVERY_S", 0.05)
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: now_s))
    text = Told("depth: 7 s")
    with Bar(Console(file=text), lines=True) as bar:
        bar.stage("photons")
        now_s = 160.0
        bar.stage("depth")
        now_s = 167.0
        assert text.twice.wait(PATIENCE_S)
