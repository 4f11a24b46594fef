# SPDX-License-Identifier: Apache-2.0
"""Figures: what they read of runs, files of a section and of the page; four surfaces per pixel, and
a point at 150 m.
"""

import re
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest

from coincid.lab.campaign import Processes
from coincid.lab.outcomes import Run
from coincid.model.depth.quality import TOLERANCE_M
from coincid.study.plot_style import new_figure, style
from docs.studies import returns
from docs.studies.figures import __main__ as program
from docs.studies.figures import (
    four_modes,
    interference,
    light_over_distance,
    reconstruction,
    thresholds,
)
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


def far_outcome(found, right=0.0, rms_m=0.0):
    """Return a made-up outcome of a target far away."""
    shares = {"found_share_planes": found, "right_share_planes": right}
    return SimpleNamespace(measures=shares | {"found_rms_m_planes": rms_m})


@pytest.mark.parametrize(
    ("shares", "told"),
    [
        ((0.2, 0.89, 0.9, 0.3, 1, 1, 1, 1), "10 nJ, threshold 2, 2.4 cm RMS"),
        ((0.9, 0, 0, 0, 0, 0, 0, 0), "2.5 nJ, coincidence off, 0.4 cm RMS"),
        ((0, 0, 0, 0, 0, 0, 0, 0.899), "more than 500 nJ"),
    ],
)
def test_the_weakest_pulse_that_finds_a_target_is_told_with_its_own_numbers(shares, told):
    """The share and the precision are means over seeds."""
    best = [
        (k, [far_outcome(share + off, rms_m=0.01 * k + 0.004 + off / 10) for off in (-0.01, 0.01)])
        for k, share in enumerate(shares)
    ]
    assert four_modes._need(best) == told


def test_the_best_threshold_sees_most_then_is_right_most_then_is_the_highest():
    def best(*outcomes):
        table = {
            (0.1, "scan", 1000, threshold, 5.0): [far_outcome(*one)]
            for threshold, one in zip(four_modes.FAR_THRESHOLDS, outcomes, strict=True)
        }
        return four_modes._best(table, 0.1, "scan", 1000, 5.0)[0]

    assert best((0.5, 0.9), (0.7, 0.1), (0.6, 0.9), (0.1, 1.0)) == 1
    assert best((0.7, 0.2), (0.7, 0.1), (0.6, 0.9), (0.1, 1.0)) == 0
    assert best((0.7, 0.2), (0.7, 0.1), (0.7, 0.2), (0.1, 1.0)) == 2


def test_a_mode_reaches_the_farthest_distance_that_is_right():
    """Also if a nearer one is wrong."""
    shares = [0.9, 1, 1, 0.5, 0.9, 0.89, 0, 0]
    assert four_modes._reach(shares) == "16 m"
    assert four_modes._reach([0.89] * len(shares)) == "none"


@pytest.mark.parametrize("schedule", four_modes.SCHEDULES)
def test_the_gate_of_a_far_target_is_that_of_its_schedule(schedule):
    """Around the target, or through the whole range in equal parts of the frame."""
    first, second = four_modes._far(0.4, schedule, 1000, 0, 2.0)
    config = first.config
    cycle_m = config.tick_m * config.sensor.phases
    assert (first.seed, second.seed) == (1, 2)
    assert first.spad_gate == config.gating.all() == (schedule != "none")
    assert not config.coincidence.any() and config.threshold[0] == 1
    assert first.light.signal_per_pulse.max() == pytest.approx(
        2 * four_modes._far(0.4, schedule, 1000, 3, 1.0)[0].light.signal_per_pulse.max()
    )
    start_m, end_m = (
        cycle_m * cycle
        for cycle in (config.gate_start[0], config.gate_start[0] + config.gate_len[0])
    )
    if schedule == "known":
        assert 95 - cycle_m < start_m <= 95 and 105 - 2 * cycle_m < end_m <= 105
        assert not config.frame.gate_every
    if schedule == "scan":
        assert 3 - cycle_m < start_m <= 3
        assert config.frame.gate_every * config.frame.gate_steps == config.pulses == 1000
        steps = config.frame.gate_steps - 1
        assert end_m + steps * config.frame.gate_step * cycle_m > 100


@pytest.mark.parametrize("mode", four_modes.MODES)
def test_the_gate_of_a_mode_is_around_its_target_and_behind_the_pane(mode):
    coincidence, gate = four_modes.MODES[mode]
    (setup, _) = four_modes._flat(mode, 10.0, 4.9, 0.6, 0.3)
    config = setup.config
    cycle_m = config.tick_m * config.sensor.phases
    assert (config.coincidence.all(), config.gating.all()) == (coincidence, gate is not None)
    assert setup.spad_gate == (gate == "spad")
    first, end = (
        config.gate_start[0] * cycle_m,
        (config.gate_start[0] + config.gate_len[0]) * cycle_m,
    )
    assert 4.0 < first <= 4.3 < 5.5 <= end + cycle_m
    assert setup.light.distance_m[0].tolist() == [4.0, 4.9]
    assert setup.light.signal_per_pulse[0, 0] == 0.3
    (near, _) = four_modes._flat(mode, 10.0, 0.5, 3.0)
    assert near.config.gate_start[0] == 0 and near.light.distance_m.shape[1] == 1


@pytest.mark.parametrize(
    ("chosen", "which", "told"),
    [
        ([(1, 9), (5, 2), (3, 3)], 0, "1 to 3, 5 between them"),
        ([(1, 9), (5, 2), (3, 3)], 1, "9 to 3"),
        ([(4, 1), (4, 1), (2, 1)], 0, "4 to 2"),
        ([(2, 1), (4, 1), (3, 1)], 0, "2 to 3, 4 between them"),
    ],
)
def test_thresholds_are_told_from_the_lowest_to_the_highest_activity(chosen, which, told):
    assert thresholds._ends(chosen, which) == told


def test_simulated_success_is_that_of_each_light_at_each_threshold(monkeypatch):
    """The reflectivity of the wall gives the light."""
    asked = {}

    def noted(seeds, pulses, **given):
        asked[given["scene"], given["subgroup"]["threshold"]] = given
        return [given]

    def grouped(setups, outcome, run):
        return {
            (signal, threshold): [
                SimpleNamespace(measures={"wrong_share": signal + threshold / 1e3})
            ]
            for signal, threshold in setups
        }

    monkeypatch.setattr(thresholds, "cases", noted)
    monkeypatch.setattr(thresholds, "grouped", grouped)
    found = thresholds._simulated(None, 5.0, 100)
    expected = 1 - thresholds.SIGNAL[:, None] - np.array(thresholds.THRESHOLDS) / 1e3
    assert found == pytest.approx(expected)
    assert len(asked) == found.size and {one["klux"] for one in asked.values()} == {5.0}
    brightest = max(float(scene.partition(",")[2]) for scene, _ in asked)
    light = thresholds.signal_per_pulse(thresholds.DISTANCE_M, brightest)
    assert light == pytest.approx(thresholds.SIGNAL[-1], rel=1e-4)


@pytest.mark.parametrize("form", ["literal", "corrected"])
@pytest.mark.parametrize("reading", "AEF")
def test_signal_and_background_are_equal_at_the_distance_of_0_db(form, reading):
    at_m = light_over_distance.zero_m(form, reading)
    nearer, there, farther = light_over_distance.link_budget(
        at_m * np.array([0.99, 1.0, 1.01]),
        light_over_distance.REFLECTIVITY,
        light_over_distance.KLUX,
        form=form,
        sbr_reading=reading,
    ).sbr_db
    assert nearer > 0 > farther and there == pytest.approx(0, abs=1e-3)


def test_rates_of_a_pixel_are_those_of_signal_background_and_both(monkeypatch):
    """Of all pixels and pulses, in a second."""
    lights = []

    def edges(light, spad, timing, *, pulses, seed):
        lights.append((light.signal_per_pulse.max(), light.background_cps.max()))
        return range(1000 * len(lights))

    monkeypatch.setattr(light_over_distance, "generate_edges", edges)
    distance_m, *rates_cps = light_over_distance._detected_cps(8.0)
    pixels, period_s = light_over_distance.SIDE**2, 500e-9
    per_edge_cps = 1 / (pixels * light_over_distance.PULSES * period_s)
    assert distance_m == 8.0
    assert rates_cps == pytest.approx([1000 * n * per_edge_cps for n in (1, 2, 3)])
    both = lights[2]
    assert min(both) > 0 and lights == [(both[0], 0.0), (0.0, both[1]), both]


def test_the_width_of_a_pulse_is_that_of_the_first_photons_of_its_object(monkeypatch):
    """Without the share of the tick, and without what comes at another time."""
    tick_s = light_over_distance.Timing().tick_s
    distance_m = 1000.5 * tick_s * light_over_distance.SPEED_OF_LIGHT_M_S / 2
    around = np.repeat([998, 999, 1000, 1001, 1002], [10, 20, 40, 20, 10])
    tick = np.concatenate([around, [1000] * 50, [3000] * 9])
    pixel = np.concatenate([np.tile([2, 5], 50), [1] * 50, [2] * 9])
    scene = SimpleNamespace(
        labels=np.array([[7, 8, 9], [8, 7, 9]]), truth_m=np.full((2, 3), distance_m)
    )
    run = SimpleNamespace(scene=scene, edges=SimpleNamespace(tick=tick, pixel=pixel))
    monkeypatch.setattr(light_over_distance, "Run", lambda setup: run)
    monkeypatch.setattr(light_over_distance, "cases", lambda **given: [None])
    label, fwhm_ps, error_ps, at_m, offsets_ps, shares = light_over_distance._pulse_width(9)
    tick_ps = tick_s * 1e12
    sigma_ps = tick_ps * np.sqrt(1.2 - 1 / 12)
    expected_ps = 2 * np.sqrt(2 * np.log(2)) * sigma_ps
    assert (label, at_m) == (9, distance_m)
    assert fwhm_ps == pytest.approx(expected_ps) and error_ps == pytest.approx(fwhm_ps / 200**0.5)
    assert offsets_ps == pytest.approx(tick_ps * np.arange(-2, 3), abs=1e-2)
    assert shares == [0.25, 0.5, 1.0, 0.5, 0.25]


def test_the_first_of_many_photons_comes_in_a_narrower_time():
    """As in a drawn number of photons; of a single one it is the pulse."""
    one_fwhm_s = 2 * np.sqrt(2 * np.log(2)) * 1e-10
    widths_s = [light_over_distance._first_photon_fwhm_s(one, 1e-10) for one in (1e-6, 2.0, 50.0)]
    assert widths_s[0] == pytest.approx(one_fwhm_s, rel=1e-4)
    assert widths_s[0] > widths_s[1] > widths_s[2]
    rng = np.random.default_rng(1)
    first = [rng.normal(size=n).min() for n in rng.poisson(2.0, 40_000) if n]
    assert widths_s[1] == pytest.approx(one_fwhm_s * np.std(first), rel=0.02)


def test_the_largest_ghost_is_of_wrong_pixels_that_agree():
    truth_m = np.full((2, 5), 5.0)
    depth_m = np.array([[3.05, 3.2, 3.4, 9.0, 5.4], [5.0, np.nan, 3.25, 4.6, 5.3]])
    assert interference._same_and_wrong(depth_m, truth_m) == pytest.approx(0.3)
    assert interference._same_and_wrong(truth_m, truth_m) == 0.0


LABELS = np.array([[1, 1, 2, 2], [3, 3, 3, 3]])


class MadeUpRuns:
    """Runs of the figures of reconstruction: no two numbers are equal. Cases and tasks are the
    settings from which they are made.
    """

    def __init__(self, monkeypatch):
        self.drawn = {}  # title: panels
        self.asked = []
        scene = SimpleNamespace(labels=LABELS, truth_m=np.ones(LABELS.shape))
        for name, one in {
            "cases": self.cases,
            "grouped": self.grouped,
            "Run": lambda setup: SimpleNamespace(scene=scene, setup=setup),
            "outcome": lambda run: self.outcome("RTL", *run.setup),
            "draw_row": self.draw_row,
        }.items():
            monkeypatch.setattr(reconstruction, name, one)

    def cases(self, seeds, pulses, **given):
        self.asked.append(given)
        sensor, threshold = given.get("sensor", {}), given["subgroup"].get("threshold", 0)
        key = str(sensor.get("subgroup")), given["klux"], threshold, pulses
        return [MadeUpSetup((seed, *key)) for seed in range(seeds if pulses == 100 else 1)]

    def wrong(self, *key):
        """bool[rows, cols], as shares."""
        return np.random.default_rng([ord(c) for c in repr(key)]).uniform(size=LABELS.shape)

    def outcome(self, *key):
        methods = {*reconstruction.METHODS, *reconstruction.METHODS_8}
        wrong = {method: self.wrong(*key, method) for method in methods}
        measures = {f"wrong_share_{method}": one.mean() for method, one in wrong.items()}
        measures["events_per_s"] = self.wrong(*key, "events").sum()
        return SimpleNamespace(wrong=wrong, measures=measures, depth_m=wrong)

    def grouped(self, setups, outcome, run):
        return {key: [self.outcome(*one) for one in own] for key, own in setups.items()}

    def map(self, function, tasks):
        return [
            (self.wrong(form, *setup), self.wrong("depth", form, *setup)) for form, setup in tasks
        ]

    def draw_row(self, panels, truth_m, title):
        self.drawn[title] = {panel.title: panel.depth_m for panel in panels}
        return title, []


class MadeUpSetup(tuple):
    """What a setup is made from, with the engine that is asked for."""

    def but(self, engine):
        return MadeUpSetup((engine, *self))


def test_figure_6_has_the_shares_of_each_object_by_source_and_estimator(monkeypatch):
    """Means over the seeds; an object is right below half."""
    runs = MadeUpRuns(monkeypatch)
    found = reconstruction.figure_6(runs, engine="sliced")
    head, *rows = found.rows
    shares = {tuple(row[:-1]): row[-1] for row in rows}
    assert len(shares) == len(rows)
    for panel, (klux, settings, _) in reconstruction.PANELS_6.items():
        first = (0, "None", klux, settings.get("threshold", 0), 100)
        for form in ("literal", "corrected"):
            wrong = runs.wrong(form, *first)
            assert shares[panel, klux, form, 100, "maximum", 2] == wrong[0, 2:].mean()
            assert shares[panel, klux, form, 100, "maximum", "all"] == wrong.mean()
        (comparison,) = (one for one in found.comparisons if one.quantity.startswith(f"6{panel}: "))
        for method in reconstruction.METHODS:
            seeds = [runs.wrong(seed, *first[1:], method) for seed in range(4)]
            wrong = np.mean(seeds, axis=0)
            for label in (1, 2, 3):
                expected = wrong[label == LABELS].mean()
                assert shares[panel, klux, "Monte Carlo", 100, method, label] == pytest.approx(
                    expected
                )
            many = runs.wrong(0, *first[1:4], 800, method)
            assert shares[panel, klux, "Monte Carlo", 800, method, "all"] == many.mean()
            rtl = runs.wrong("RTL", "sliced", *first, method)
            assert shares[panel, klux, "RTL", 100, method, "all"] == rtl.mean()
            right = [str(label) for label in (1, 2, 3) if wrong[label == LABELS].mean() < 0.5]
            told = f"{wrong.mean():.1%} wrong; right: {', '.join(right) or 'none'}"
            assert comparison.ours[f"Monte Carlo, {method}"] == told
        assert comparison.ours["RTL"] == "differs from the golden model"
    assert len(runs.drawn) == len(found.figures) == 3
    of_b = runs.drawn["threshold 5, 50 klux, 100 pulses"]
    assert np.array_equal(
        of_b["Monte Carlo, planes"], runs.wrong(0, "None", 50.0, 5, 100, "planes")
    )
    assert np.array_equal(
        of_b["800 pulses, matched"], runs.wrong(0, "None", 50.0, 5, 800, "matched")
    )


def test_figure_8_has_each_estimator_at_its_own_best_threshold(monkeypatch):
    """In each size of groups, and more pulses at the best threshold of `matched`."""
    runs = MadeUpRuns(monkeypatch)
    found = reconstruction.figure_8(runs)
    _, *rows = found.rows
    numbers = {tuple(row[:-2]): row[-2:] for row in rows}
    assert len(numbers) == len(rows)
    for panel, (subgroup, minigroup) in reconstruction.PANELS_8.items():
        sizes = panel, "{}x{}".format(*subgroup), "{}x{}".format(*minigroup)
        (comparison,) = (one for one in found.comparisons if one.quantity.startswith(f"8{panel}: "))
        best = {}
        for method in reconstruction.METHODS_8:
            for threshold in reconstruction.THRESHOLDS_8:
                key = str(list(subgroup)), 50.0, threshold, 100
                seeds = [runs.outcome(seed, *key) for seed in range(4)]
                wrong, events = (
                    np.mean([one.measures[name] for one in seeds])
                    for name in (f"wrong_share_{method}", "events_per_s")
                )
                row = numbers[*sizes, "Monte Carlo", 100, threshold, method]
                assert row == pytest.approx((wrong, events))
                best[method] = min(best.get(method, (2, 0)), (wrong, threshold))
            told = "{:.1%} (threshold {})".format(*best[method])
            assert comparison.ours[f"Monte Carlo, {method}"] == told
        of_form = [
            (runs.wrong("literal", 0, str(list(subgroup)), 50.0, threshold, 100).mean(), threshold)
            for threshold in reconstruction.THRESHOLDS_8
        ]
        assert comparison.ours["analytic, literal"] == "{:.1%} (threshold {})".format(*min(of_form))
        threshold = best["matched"][1]
        many = runs.outcome(0, str(list(subgroup)), 50.0, threshold, 800)
        row = numbers[*sizes, "Monte Carlo", 800, threshold, "planes"]
        assert row[0] == many.measures["wrong_share_planes"]
        (title,) = (title for title in runs.drawn if f"subgroup {sizes[1]}," in title)
        assert title == f"subgroup {sizes[1]}, minigroup {sizes[2]}, 50 klux"
        shown = runs.drawn[title]
        share, own = best["planes"]
        first = runs.wrong(0, str(list(subgroup)), 50.0, own, 100, "planes")
        assert np.array_equal(shown[f"planes, threshold {own}"], first)
        assert f"800 pulses, matched, threshold {threshold}" in shown
    assert {one["frame"]["format"] for one in runs.asked} == {"full"}


@pytest.mark.parametrize(
    ("words", "page", "engine", "folder"),
    [
        ("figures", "figures", None, "build/figures"),
        ("modes --rtl", "modes", "sliced", "build/modes"),
        ("compare --out own/place", "compare", None, "own/place"),
    ],
)
def test_figures_are_written_into_their_folder(
    monkeypatch, tmp_path, capsys, words, page, engine, folder
):
    asked = []

    def write(*given):
        asked.append(given[:3])
        return [given[1] / "a.png", given[1] / "index.html"]

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(program, "write", write)
    monkeypatch.setattr("sys.argv", ["figures", *words.split()])
    assert program.main() == 0
    assert asked == [(program.PAGES[page], Path(folder), engine)]
    assert capsys.readouterr().out == f"{folder}/index.html\n"
    assert (tmp_path / folder).is_dir()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("compare --rtl", "--rtl: no frame of compare is played on the RTL"),
        ("moon", "invalid choice: 'moon'"),
        ("figures --out file", "file"),
    ],
)
def test_figures_that_cannot_be_made_are_refused_in_a_sentence(
    monkeypatch, tmp_path, capsys, words, told
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    monkeypatch.setattr(program, "write", lambda *given: 1 / 0)
    monkeypatch.setattr("sys.argv", ["figures", *words.split()])
    try:
        code = program.main()
    except SystemExit as ended:
        code = ended.code
    assert code == 2 and told in capsys.readouterr().err
