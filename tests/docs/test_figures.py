# SPDX-License-Identifier: Apache-2.0
"""Figures: what they read of runs, files of a section and of the page; four surfaces per pixel, and
a point at 150 m.
"""

import re
from xml.etree import ElementTree

import pytest

from coincid.lab.campaign import Processes
from coincid.lab.outcomes import Run
from coincid.model.depth.quality import TOLERANCE_M
from coincid.study.plot_style import new_figure, style
from docs.studies import returns
from docs.studies.figures import light_over_distance, reconstruction
from docs.studies.figures.sections import Comparison, Section, write_figures_page, write_section
from docs.studies.figures.setups import cases, mean, mean_rows, outcome

METHODS = ("planes", "matched/subgroup")
SMALL = {"scene": "letter-f", "klux": 20, "sensor": {"rows": 8, "cols": 16}, "estimators": METHODS}


def section(value=0.1):
    with style():
        figure = new_figure(3, 2)
        figure.subplots().plot([0, 1], [0, value])
    return Section(
        "demo",
        "a < b",
        [("demo_a", figure, "caption & more")],
        [("x", "y"), (1, 1 / 3), ("a,b", "")],
        [
            Comparison("quantity", "7 %", {"literal": "1", "corrected": "2"}),
            Comparison("other", "-", {"RTL": "3"}),
        ],
        "text & more",
    )


def test_rows_are_means_over_seeds():
    assert [one.seed for one in cases(2, **SMALL)] == [1, 2]
    (setup,) = cases(2, 20, subgroup={"threshold": 3}, frame={"frames": 2}, **SMALL)
    (blind,) = cases(1, 20, frame={"format": "short"}, **SMALL | {"estimators": ()})
    found, without = outcome(Run(setup)), outcome(Run(blind))
    assert 0 < found.measures["events"] == found.measures["events_per_s"] * 20 * 500e-9
    assert (
        found.measures["wrong_share"]
        == found.measures["wrong_share_planes"]
        == found.wrong["planes"].mean()
    )
    assert mean([found, found], "events") == found.measures["events"]
    rows = mean_rows(("key",), ("dropped", "wrong_share"), {("one",): [found], ("two",): [without]})
    assert rows == [
        ("key", "dropped", "wrong_share"),
        ("one", 0.0, found.measures["wrong_share"]),
        ("two", 0.0, ""),
    ]
    with pytest.raises(ValueError, match="threshold"):
        cases(subgroup={"threshold": 0})


def test_files_of_a_section_have_the_same_bytes_again(tmp_path):
    for folder in ("one", "two"):
        write_section(tmp_path / folder, section())
        write_figures_page(tmp_path / folder, "title", "introduction", [section()])
    one, two = (
        {path.name: path.read_bytes() for path in (tmp_path / folder).iterdir()}
        for folder in ("one", "two")
    )
    assert one == two and one.keys() == {"demo.csv", "demo_a.png", "demo_a.svg", "index.html"}
    assert one["demo.csv"].decode().split() == ["x,y", "1,0.333333", '"a,b",']


def test_page_is_html_with_every_number(tmp_path):
    write_figures_page(tmp_path, "title", "", [section()])
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    # whose tags are balanced
    ElementTree.fromstring(re.sub("<(!doctype|meta|img)[^>]*>", "", text))
    assert (
        "a &lt; b" in text
        and "caption &amp; more" in text
        and "text &amp; more" in text
        and "demo_a.svg" in text
    )
    assert "<td>7 %</td><td>1</td><td>2</td><td></td>" in text


@pytest.mark.long
def test_paper_figures_with_a_second_engine(monkeypatch):
    monkeypatch.setattr(reconstruction, "SEEDS", 1)
    monkeypatch.setattr(reconstruction, "PANELS_6", {"c": reconstruction.PANELS_6["c"]})
    monkeypatch.setattr(light_over_distance, "MONTE_CARLO_M", (32.0,))
    monkeypatch.setattr(light_over_distance, "SIDE", 1)
    with style(), Processes(1) as run:
        six = reconstruction.figure_6(run, engine="golden")
        two, five = light_over_distance.figure_2(run), light_over_distance.figure_5(run)
    assert six.comparisons[0].ours["RTL"] == "the same depth in every pixel"
    shares = {(row[2], row[3], row[4]): row[6] for row in six.rows[1:] if row[5] == "all"}
    assert {source for source, *_ in shares} == {"literal", "corrected", "Monte Carlo", "RTL"}
    assert shares["RTL", 100, "planes"] == shares["Monte Carlo", 100, "planes"] < 0.01
    assert shares["Monte Carlo", 100, "maximum"] > 0.01
    assert abs(shares["corrected", 100, "maximum"] - shares["Monte Carlo", 100, "maximum"]) < 0.05
    assert shares["Monte Carlo", 800, "matched"] < shares["Monte Carlo", 100, "matched"]
    assert two.comparisons[0].ours["reading E"] == "3.92 m" and two.comparisons[0].ours[
        "reading A"
    ].startswith("0.05")
    assert [one.ours["literal"] for one in five.comparisons] == ["500 ps", "500 ps"]
    assert all(len(row) == len(part.rows[0]) for part in (six, two, five) for row in part.rows)


@pytest.mark.parametrize("step_m", returns.STEPS_M)
def test_four_surfaces_in_every_histogram(step_m):
    shares = returns.all_found(Run(returns.setup(returns.NEAREST_M[0], step_m)))
    assert min(shares.values()) >= 0.95


def test_a_cycle_hides_its_second_surface_in_bright_light():
    slow, fast = (
        returns.all_found(Run(returns.setup(4.0, 0.15, photons=0.6, pulses=1000, faster=faster)))[
            "map"
        ]
        for faster in (False, True)
    )
    assert slow < 0.05 and fast > 0.9


def test_a_point_at_150_m():
    near, far = (
        abs(returns.point_error_m(Run(returns.point(0.1, 10.0, 1000, 0, nj)))) for nj in (2.0, 0.01)
    )
    assert near < TOLERANCE_M < far
