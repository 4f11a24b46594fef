# SPDX-License-Identifier: Apache-2.0
"""The bar on a terminal: the share of its stage that is done."""

import io
import re

from rich.console import Console

from coincid.study.progress import Bar


def shown(*steps):
    """Return what a terminal last shows of a bar behind these calls, (method, arguments)."""
    text = io.StringIO()
    console = Console(file=text, force_terminal=True, width=100)
    with Bar(console) as bar:
        for method, arguments in steps:
            getattr(bar, method)(*arguments)
    lines = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text.getvalue()).replace("\r", "\n").split("\n")
    return [line for line in lines if "%" in line][-1]


def share(line):
    """Return the stage and the percents of a line of the bar."""
    return re.search(r"(\w+) .*?(\d+) %", line).groups()


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
