# SPDX-License-Identifier: Apache-2.0
"""Progress of long work: where no bar moves, a line says every few seconds what is going on."""

import io
import time

from rich.console import Console

from coincid.study import progress


def test_a_long_stage_says_that_it_lasts(monkeypatch):
    monkeypatch.setattr(progress, "LINE_EVERY_S", 0.05)
    text = io.StringIO()
    with progress.Bar(Console(file=text), lines=True) as bar:
        bar.stage("photons")
        while text.getvalue().count("photons: 0 s") < 2:
            time.sleep(0.01)
        bar.stage("depth")
    lines = text.getvalue().splitlines()
    assert lines[0] == "photons" and lines[1] == "photons: 0 s" and "depth" in lines
