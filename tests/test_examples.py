# SPDX-License-Identifier: Apache-2.0
"""Every example runs by itself in a fresh process, and prints and draws what is written down."""

import re

import pytest

from .drawn_examples import EXAMPLES, played_alone, played_here, recorded

FIRST = "plot_01_first_frame"
QUICK = (  # that take some tenths of a second where the models are compiled
    "plot_02_own_scene",
    "plot_03_photons_to_histogram",
    "plot_05_gating",
    "plot_06_several_targets",
    "plot_08_recording",
)
AGAIN = "python -m tests.drawn_examples"  # writes down what the examples print and draw


def examples():
    """Return the programs; together they take long."""
    for path in sorted(EXAMPLES.glob("plot_*.py")):
        marks = [] if path.stem == FIRST else [pytest.mark.long]
        yield pytest.param(path, id=path.stem, marks=marks)


def test_every_example_is_listed():
    listed = re.findall(r"\]\((\w+\.py)\)", (EXAMPLES / "README.md").read_text(encoding="utf-8"))
    assert sorted(listed) == sorted(path.name for path in EXAMPLES.glob("*.py"))


@pytest.mark.parametrize("example", list(examples()))
def test_example_runs(example, tmp_path):
    """Those of RTL tools have numbers that change with the RTL, which are not written down."""
    found = played_alone(example, tmp_path)
    assert found["prints"] and found["draws"]
    expected = recorded().get(example.stem, found)
    assert found == expected, AGAIN


@pytest.mark.parametrize("name", QUICK)
def test_a_quick_example_prints_and_draws_what_is_written_down(name, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.chdir(EXAMPLES)
    assert played_here(EXAMPLES / f"{name}.py") == recorded()[name], AGAIN
