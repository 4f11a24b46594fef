# SPDX-License-Identifier: Apache-2.0
"""An architect's questions: background, re-arm gap and window, FIFO and bandwidth, two targets, noisy SPADs."""

from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...lab.setup import SETTLING
from ...model.light.spad import Spad, dark_count_map
from ..plot_style import SERIES, legend_below, new_figure, share_axis
from .cases import MANY, PULSES, Case, Outcome, Runner, Table, mean_of, vary
from .page import Comparison, Row, Section

Outcomes: TypeAlias = dict[tuple[Any, ...], list[Outcome]]  # by the varied settings
METHODS = ("planes", "matched")
MARKS = ("-o", "--s")  # of the methods
KLUX = (1.0, 2.0, 5.0, 10.0, 20.0, 35.0, 50.0, 75.0, 100.0)
THRESHOLDS = tuple(range(1, 8))
SEEDS, FEW_SEEDS = 6, 2  # for the study of the background, for the others
GOAL_KLUX, GOAL_SHARE = 50.0, 0.07
SHOWN_THRESHOLDS = {2: SERIES[0], 3: SERIES[3], 5: SERIES[5]}
REARM, WINDOWS = tuple(range(8)), (4, 8, 16, 32, 64, 128)
DEPTHS = (1, 2, 4, 8, 16, 32, 64)
DEPTH_CASES = {
    (20.0, 1): SERIES[0],
    (50.0, 2): SERIES[2],
    (75.0, 2): SERIES[4],
    (100.0, 2): SERIES[5],
}  # klux, threshold
BANDWIDTHS = (("short", 1), ("id", 1), ("full", 1), ("id", 2), ("id", 4))  # format, streams
BANDWIDTH_THRESHOLD = 2
NEAR_M, STEPS_M = 5.0, (0.05, 0.10, 0.15, 0.2, 0.25, 0.3, 0.4, 0.6, 1.0)
TWO_KLUX = (5.0, 50.0)
TWO_SOURCES: dict[str, tuple[Table, str]] = {  # ways to tell two targets apart: settings of the frame, method
    "ID map, planes": ({}, "planes"),
    "ID map, matched": ({}, "matched"),
    "records off: subgroup's stamp alone": ({}, "matched/subgroup"),
    "records off: offsets of full events": ({"format": "full"}, "matched/minigroup"),
    "records on": ({"minigroup_records": True}, "matched/minigroup"),
}
DARK_CPS = (0.0, 1e3, 1e4, 1e5, 1e6, 5e6)
HOT_SHARES, HOT_CPS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2), 5e6
CROSSTALK = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1)
BOTH_PULSES = (PULSES, MANY * PULSES)
ALSO_MANY = f"the CSV also has {MANY * PULSES} pulses"


def background(run: Runner) -> Section:
    """Compare thresholds 1 to 7, the controller and an oracle, from 1 to 100 klux."""
    settings = {str(threshold): {"threshold": threshold} for threshold in THRESHOLDS} | {"off": {"coincidence": False}}
    cases = {}
    for pulses, klux in _pairs(BOTH_PULSES, KLUX):
        case, seeds = Case(klux=klux, methods=METHODS), SEEDS if pulses == PULSES else 1
        for name, subgroup in settings.items():
            cases[pulses, klux, name] = vary(case, seeds, pulses=pulses, subgroup=subgroup)
        frames = {"frames": SETTLING + 1}
        cases[pulses, klux, "controller"] = vary(case, seeds, pulses=pulses, subgroup={"auto": True}, frame=frames)
    table = run.table(cases)
    oracle = {}
    for pulses, klux in _pairs(BOTH_PULSES, KLUX):
        best = _oracle({threshold: table[pulses, klux, str(threshold)] for threshold in THRESHOLDS})
        seeds = SEEDS if pulses == PULSES else 1
        oracle[pulses, klux, "oracle"] = vary(Case(klux=klux, methods=METHODS), seeds, pulses=pulses, threshold=best)
    table |= run.table(oracle)
    rows: list[Row] = [
        ("pulses", "klux", "setting", *(f"wrong_share_{method}" for method in METHODS), "events_per_s", "dropped_share")
    ]
    rows += [(*key, *_wrong(outcomes), _events(outcomes), _dropped(outcomes)) for key, outcomes in table.items()]
    text = f"""<p>Controller: the threshold of each subgroup after {SETTLING} frames of other photons of the same light, with the capacity of one
beat per cycle. Oracle: for each subgroup, the threshold with the fewest events among those with the fewest wrong pixels, known from the truth.
Events: events that left the sensor; one stream carries 2.5e8 per second with ID maps. Mean of {SEEDS} seeds, or one seed with {MANY * PULSES}
pulses, where capacity and bounds are {MANY} times as high.</p>
<p>Limits: bandwidth limits low thresholds in bright light; photons limit high thresholds (dark objects give few); and the estimator is the limit
if each pixel is evaluated alone. The controller sends what the stream carries, so it has many events in dim light, and in bright light no fewer
than it must.</p>"""
    return Section(
        "background",
        "Background: thresholds, controller, oracle",
        text,
        [
            (
                "background",
                _background_figure(table, PULSES),
                f"Wrong share and events against background, {PULSES} pulses",
            ),
            ("background_8x", _background_figure(table, MANY * PULSES), f"The same with {MANY * PULSES} pulses"),
        ],
        rows,
        [_goal(table), *(_against_best(table, klux) for klux in KLUX)],
    )


def rearm_and_window(run: Runner) -> Section:
    """Vary the tree's blind time and the length of the coincidence window."""
    values = [*(("rearm", value) for value in REARM), *(("window", value) for value in WINDOWS)]
    keys = [(pulses, *value, threshold) for pulses, value, threshold in _pairs(BOTH_PULSES, values, SHOWN_THRESHOLDS)]
    table = run.table(
        {
            (pulses, name, value, threshold): vary(
                Case(methods=METHODS),
                FEW_SEEDS if pulses == PULSES else 1,
                pulses=pulses,
                sensor={"rearm": value} if name == "rearm" else {},
                subgroup={"threshold": threshold} | ({"window": value} if name == "window" else {}),
            )
            for pulses, name, value, threshold in keys
        }
    )
    rows: list[Row] = [
        ("pulses", "parameter", "value", "threshold", *(f"wrong_share_{method}" for method in METHODS), "events_per_s")
    ]
    rows += [(*key, *_wrong(outcomes), _events(outcomes)) for key, outcomes in table.items()]
    figure = new_figure(11, 4.2)
    for axis, name, at, label in zip(
        figure.subplots(1, 2),
        ("rearm", "window"),
        (REARM, WINDOWS),
        ("re-arm gap R in cycles", "coincidence window W in ticks of 62.5 ps"),
    ):
        for threshold, colour in SHOWN_THRESHOLDS.items():
            _plot_methods(
                axis, at, [table[PULSES, name, value, threshold] for value in at], colour, f"threshold {threshold}"
            )
        axis.set(xlabel=label, ylabel="share of wrong pixels")
        share_axis(axis)
    figure.axes[1].set_xscale("log", base=2)
    legend_below(figure)
    return Section(
        "rearm_window",
        "Re-arm gap R and window W",
        """<p>Five objects at 50 klux. R costs the signal of pulses in which noise has just closed a window; fewer noise events
leave the sensor, too. A short window sees only a part of the pulse; a long one counts more noise, blinds the tree for longer
and merges surfaces.</p>""",
        [
            (
                "rearm_window",
                figure,
                f"Share of wrong pixels against R (left) and W (right), {PULSES} pulses; {ALSO_MANY}",
            )
        ],
        rows,
    )


def fifo_and_bandwidth(run: Runner) -> Section:
    """Measure the events lost to full FIFOs, by depth and by the capacity of the streams."""
    cases = {}
    for pulses in BOTH_PULSES:
        for (klux, threshold), depth in _pairs(DEPTH_CASES, DEPTHS):
            cases[pulses, klux, threshold, depth, "id", 1] = vary(
                Case(klux=klux), pulses=pulses, subgroup={"threshold": threshold}, sensor={"fifo_depth": depth}
            )
        for (form, streams), klux in _pairs(BANDWIDTHS, KLUX):
            methods = (
                () if form == "short" else ("planes",)
            )  # without an ID map there is no depth, but the losses are the same
            cases[pulses, klux, BANDWIDTH_THRESHOLD, 16, form, streams] = vary(
                Case(klux=klux, methods=methods),
                pulses=pulses,
                subgroup={"threshold": BANDWIDTH_THRESHOLD},
                frame={"format": form},
                sensor={"streams": streams},
            )
    table = run.table(cases)
    rows: list[Row] = [
        (
            "pulses",
            "klux",
            "threshold",
            "fifo_depth",
            "format",
            "streams",
            "dropped_share",
            "events_per_s",
            "wrong_share_planes",
        )
    ]
    rows += [
        (*key, _dropped(outcomes), _events(outcomes), *(_wrong(outcomes) or ("",))) for key, outcomes in table.items()
    ]
    figure = new_figure(11, 4.2)
    left, right = figure.subplots(1, 2)
    for (klux, threshold), colour in DEPTH_CASES.items():
        lost = [_dropped(table[PULSES, klux, threshold, depth, "id", 1]) for depth in DEPTHS]
        left.plot(DEPTHS, lost, "-o", color=colour, label=f"{klux:g} klux, threshold {threshold}")
    for (form, streams), colour in zip(BANDWIDTHS, SERIES):
        lost = [_dropped(table[PULSES, klux, BANDWIDTH_THRESHOLD, 16, form, streams]) for klux in KLUX]
        right.plot(KLUX, lost, "-o", color=colour, label=f"{form}, {streams} stream{'s' * (streams > 1)}")
    left.set(
        xlabel="FIFO depth in events", ylabel="share of committed events dropped", title="depth (format id, 1 stream)"
    )
    left.set_xscale("log", base=2)
    right.set(
        xlabel="background in klux",
        ylabel="share of committed events dropped",
        title=f"bandwidth (threshold {BANDWIDTH_THRESHOLD}, depth 16)",
    )
    left.legend()
    right.legend()
    return Section(
        "fifo_bandwidth",
        "FIFO depth and readout bandwidth",
        """<p>A stream carries a 64-bit beat per cycle: in a laser period of 250 cycles, these are 250 events of format short, 125
with ID maps, or 62 with offsets, too, for all 16 subgroups. Above that rate no FIFO helps; below it, a depth of a few events
absorbs random bursts.</p>""",
        [("fifo_bandwidth", figure, f"Share of events dropped, {PULSES} pulses; {ALSO_MANY}")],
        rows,
    )


def two_targets(run: Runner) -> Section:
    """Measure two surfaces in one subgroup, by the way to tell them apart."""
    table = run.table(
        {
            (pulses, klux, name, step_m): vary(
                Case(scene=f"two-targets:{NEAR_M},{NEAR_M + step_m:.4g}", klux=klux, methods=(TWO_SOURCES[name][1],)),
                FEW_SEEDS if pulses == PULSES else 1,
                pulses=pulses,
                frame=TWO_SOURCES[name][0],
            )
            for pulses, klux, name, step_m in _pairs(BOTH_PULSES, TWO_KLUX, TWO_SOURCES, STEPS_M)
        }
    )
    rows: list[Row] = [("pulses", "klux", "source", "step_m", "wrong_share", "events_per_s", "records_per_s")]
    rows += [
        (*key, *_wrong(outcomes), _events(outcomes), mean_of(outcomes, lambda o: float(o.mg_stored.sum() / o.frame_s)))
        for key, outcomes in table.items()
    ]
    figure = new_figure(11, 4.2)
    steps_cm = 100 * np.array(STEPS_M)
    for axis, klux in zip(figure.subplots(1, 2, sharey=True), TWO_KLUX):
        for name, colour, mark in zip(TWO_SOURCES, SERIES[::2] + SERIES[5:6], ("-o", "--s", "-.v", ":^", "-d")):
            shares = [_wrong(table[PULSES, klux, name, step_m])[0] for step_m in STEPS_M]
            axis.plot(steps_cm, shares, mark, color=colour, label=name)
        axis.set(xlabel=f"step behind the target at {NEAR_M:g} m in cm", title=f"{klux:g} klux", xscale="log")
        axis.set_xticks(steps_cm, labels=[f"{step:.0f}" for step in steps_cm])
        axis.set_xticks([], minor=True)
    figure.axes[0].set_ylabel("share of wrong pixels")
    legend_below(figure)
    return Section(
        "two_targets",
        "Two targets in one subgroup, minigroup records on and off",
        """<p>Stripes of 4 columns at 5 m and a step behind. One event covers both surfaces if they are closer to each other than the
window (1 ns, 15 cm), and its stamp is that of the nearer one. The minigroups' own stamps tell them apart, but are no sharper
than 500 ps (7.5 cm): they win at about 10 cm and lose where the window is sufficient. Between the window's end and the re-arm,
the tree is blind (up to 30 cm), which costs events of the far surface, but no record of its minigroups.</p>""",
        [("two_targets", figure, f"Share of wrong pixels against the step, {PULSES} pulses; {ALSO_MANY}")],
        rows,
    )


def noisy_spads(run: Runner) -> Section:
    """Vary dark counts, hot pixels and crosstalk."""
    hot = [
        Spad(dark_cps=dark_count_map(1024, median_cps=0, hot_fraction=share, hot_cps=HOT_CPS, seed=1))
        for share in HOT_SHARES
    ]
    studies = {
        "dark counts of every pixel in 1/s": dict(zip(DARK_CPS, (Spad(dark_cps=rate) for rate in DARK_CPS))),
        f"share of hot pixels ({HOT_CPS / 1e6:g}e6/s)": dict(zip(HOT_SHARES, hot)),
        "crosstalk probability to each neighbour": {share: Spad(crosstalk_probability=share) for share in CROSSTALK},
    }
    table = run.table(
        {
            (pulses, study, value, threshold): vary(
                Case(spad=spad, methods=METHODS),
                FEW_SEEDS if pulses == PULSES else 1,
                pulses=pulses,
                subgroup={"threshold": threshold},
            )
            for pulses in BOTH_PULSES
            for study, spads in studies.items()
            for value, spad in spads.items()
            for threshold in SHOWN_THRESHOLDS
        }
    )
    rows: list[Row] = [
        ("pulses", "study", "value", "threshold", *(f"wrong_share_{method}" for method in METHODS), "events_per_s")
    ]
    rows += [(*key, *_wrong(outcomes), _events(outcomes)) for key, outcomes in table.items()]
    figure = new_figure(13, 7.5)
    axes = figure.subplots(2, 3, sharey="row")
    for column, (study, spads) in zip(axes.T, studies.items()):
        for threshold, colour in SHOWN_THRESHOLDS.items():
            outcomes = [table[PULSES, study, value, threshold] for value in spads]
            _plot_methods(column[0], range(len(spads)), outcomes, colour, f"threshold {threshold}")
            column[1].plot(
                range(len(spads)),
                [_events(one) / 1e6 for one in outcomes],
                "-o",
                color=colour,
                label=f"threshold {threshold}",
            )
        for axis in column:
            axis.set_xlabel(study)
            axis.set_xticks(range(len(spads)), labels=[f"{value:g}" for value in spads])
    for axis, label in zip(axes[:, 0], ("share of wrong pixels", "events in 1e6/s")):
        axis.set_ylabel(label)
    legend_below(figure)
    share_axis(axes[0, 0])
    return Section(
        "noisy_spads",
        "Dark counts, hot pixels, crosstalk",
        """<p>Five objects at 50 klux (1.2e6 background counts per second in a pixel). Crosstalk fakes coincidences: an avalanche fires
a neighbour, so one noise photon meets a threshold of 2. A hot pixel opens windows and blinds the tree for the others, but counts
only once in a coincidence. With threshold 5, the estimator of planes either finds object 2 (13 % of the pixels) or does not, and
noise that lifts its few photons over the threshold helps.</p>""",
        [("noisy_spads", figure, f"Share of wrong pixels (above) and events (below), {PULSES} pulses; {ALSO_MANY}")],
        rows,
    )


def _pairs(first: Iterable[Any], *others: Iterable[Any]) -> list[tuple[Any, ...]]:
    """Return all combinations, with the last one varying fastest."""
    combinations: list[tuple[Any, ...]] = [(one,) for one in first]
    for other in others:
        combinations = [(*so_far, one) for so_far in combinations for one in other]
    return combinations


def _wrong(outcomes: list[Outcome]) -> list[float]:
    """Return the mean share of wrong pixels for each of the case's methods."""
    methods = outcomes[0].case.methods
    return [float(np.mean([outcome.wrong_share(method) for outcome in outcomes])) for method in methods]


def _events(outcomes: list[Outcome]) -> float:
    return mean_of(outcomes, lambda outcome: outcome.events_per_s)


def _dropped(outcomes: list[Outcome]) -> float:
    return mean_of(outcomes, lambda outcome: 1 - outcome.stored.sum() / max(1, outcome.committed.sum()))


def _oracle(fixed: dict[int, list[Outcome]]) -> tuple[int, ...]:
    """Return for each subgroup the threshold with the fewest wrong pixels, and among equals (0.1 pixels) the fewest events."""
    sensor = next(iter(fixed.values()))[0].case.config().sensor
    (sr, sc), cols = sensor.subgroup, sensor.cols // sensor.subgroup[1]
    best = []
    for s in range(sensor.subgroups):
        row, col = s // cols * sr, s % cols * sc
        here = slice(row, row + sr), slice(col, col + sc)
        ranked = [
            (
                round(float(np.mean([o.wrong("planes")[here].sum() for o in outcomes])), 1),
                float(np.mean([o.stored[s] for o in outcomes])),
                threshold,
            )
            for threshold, outcomes in fixed.items()
        ]
        best.append(min(ranked)[2])
    return tuple(best)


def _plot_methods(axis: Axes, at: Sequence[float], outcomes: list[list[Outcome]], colour: str, label: str) -> None:
    for method, mark, shares in zip(METHODS, MARKS, np.transpose([_wrong(one) for one in outcomes])):
        axis.plot(at, shares, mark, color=colour, label=f"{label}, {method}")


def _background_figure(table: Outcomes, pulses: int) -> Figure:
    figure = new_figure(13, 5)
    axes = figure.subplots(1, 3)
    styles = {
        "off": ("#999999", "-.", ""),
        **{str(th): (SERIES[th - 1], "-", "") for th in THRESHOLDS},
        "controller": ("#e31a1c", "-", "o"),
        "oracle": ("#222222", ":", "x"),
    }
    for setting, (colour, line, marker) in styles.items():
        name = (
            f"threshold {setting}" if setting.isdigit() else f"coincidence {setting}" if setting == "off" else setting
        )
        chosen = [table[pulses, klux, setting] for klux in KLUX]
        for axis, values in zip(
            axes, (*np.transpose([_wrong(one) for one in chosen]), [_events(one) / 1e6 for one in chosen])
        ):
            axis.plot(KLUX, values, line, marker=marker, color=colour, label=name)
    for axis, title in zip(axes, ("estimator of planes", "matched filter")):
        axis.axhline(GOAL_SHARE, color="#bbbbbb", linewidth=1)
        axis.set(
            xlabel="background in klux",
            ylabel="share of wrong pixels",
            title=f"{title} (grey: {GOAL_SHARE:.0%})",
            xscale="log",
        )
        share_axis(axis)
    axes[2].set(
        xlabel="background in klux",
        ylabel="events that leave the sensor in 1e6/s",
        title="events",
        xscale="log",
        yscale="log",
    )
    legend_below(figure)
    return figure


def _goal(table: Outcomes) -> Comparison:
    ours = {
        name: f"{_wrong(table[PULSES, GOAL_KLUX, key])[0]:.2%}"
        for name, key in (
            ("controller", "controller"),
            ("oracle", "oracle"),
            ("threshold 2", "2"),
            ("threshold 5", "5"),
            ("coincidence off", "off"),
        )
    }
    reached = _wrong(table[PULSES, GOAL_KLUX, "controller"])[0] < GOAL_SHARE
    return Comparison(
        f"wrong at {GOAL_KLUX:g} klux, {PULSES} pulses, estimator of planes",
        f"7 % (the goal: below {GOAL_SHARE:.0%})",
        ours,
        "reached by the controller" if reached else "not reached by the controller",
    )


def _against_best(table: Outcomes, klux: float) -> Comparison:
    """Compare the controller with the fixed threshold that has the fewest wrong pixels."""
    fixed = min(
        (table[PULSES, klux, str(threshold)] for threshold in THRESHOLDS),
        key=lambda one: (_wrong(one)[0], _events(one)),
    )
    auto = table[PULSES, klux, "controller"]
    more = [a.wrong("planes").sum() - f.wrong("planes").sum() for a, f in zip(auto, fixed)]
    saved = 1 - _events(auto) / _events(fixed)
    return Comparison(
        f"controller against the best fixed threshold, {klux:g} klux",
        "-",
        {
            "controller": f"{_wrong(auto)[0]:.2%} wrong, {_events(auto) / 1e6:.1f}e6 events/s",
            "best fixed": f"threshold {fixed[0].case.subgroup['threshold']}: {_wrong(fixed)[0]:.2%} wrong, "
            f"{_events(fixed) / 1e6:.1f}e6 events/s",
        },
        f"{saved:.1%} fewer events; {np.mean(more):+.1f} ± {np.std(more) / np.sqrt(len(more)):.1f} wrong pixels of 1024",
    )
