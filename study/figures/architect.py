# SPDX-License-Identifier: Apache-2.0
"""An architect's questions: background, re-arm gap and window, FIFO and bandwidth, two targets, noisy SPADs."""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...lab.campaign import Processes, grouped
from ...lab.setup import SETTLING
from ...model.contract.parameters import Sensor
from ...model.depth.histograms import by_subgroup
from ...model.light.spad import Spad, dark_count_map
from ..palette import ALARM, GREY, INK, LIGHT_GREY, SERIES
from ..plot_style import legend_below, new_figure, share_axis
from .sections import Comparison, Section, section
from .setups import MANY, PULSES, Outcome, cases, mean, mean_rows, outcome

Outcomes: TypeAlias = dict[tuple[Any, ...], list[Outcome]]  # by the varied settings
METHODS = ("planes", "matched")
WRONG = [f"wrong_share_{method}" for method in METHODS]
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
BANDWIDTH_THRESHOLD, FIFO_DEPTH = 2, 16
NEAR_M, STEPS_M = 5.0, (0.05, 0.10, 0.15, 0.2, 0.25, 0.3, 0.4, 0.6, 1.0)
TWO_KLUX = (5.0, 50.0)
TWO_SOURCES: dict[str, tuple[dict[str, Any], str]] = {  # ways to tell two targets apart: settings of the frame, method
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


def background(run: Processes) -> Section:
    """Compare thresholds 1 to 7, the controller and an oracle, from 1 to 100 klux."""
    settings: dict[str, dict[str, Any]] = {
        str(threshold): {"subgroup": {"threshold": threshold}} for threshold in THRESHOLDS
    }
    settings["off"] = {"subgroup": {"coincidence": False}}
    settings["controller"] = {"subgroup": {"auto": True}, "frame": {"frames": SETTLING + 1}}
    table: Outcomes = grouped(
        {
            (pulses, klux, name): cases(SEEDS, pulses, klux=klux, estimators=METHODS, **settings[name])
            for pulses, klux, name in product(BOTH_PULSES, KLUX, settings)
        },
        outcome,
        run,
    )
    oracle = {}
    for pulses, klux in product(BOTH_PULSES, KLUX):
        best = _oracle({threshold: table[pulses, klux, str(threshold)] for threshold in THRESHOLDS})
        setups = cases(SEEDS, pulses, klux=klux, estimators=METHODS)
        oracle[pulses, klux, "oracle"] = [setup.but(subgroup={"threshold": best}) for setup in setups]
    table |= grouped(oracle, outcome, run)
    text = f"""<p>Controller: the threshold of each subgroup after {SETTLING} frames of other photons of the same light, with the capacity of one
beat per cycle. Oracle: for each subgroup, the threshold with the fewest events among those with the fewest wrong pixels, known from the truth.
Events: events that left the sensor; one stream carries 2.5e8 per second with ID maps. Mean of {SEEDS} seeds, or one seed with {MANY * PULSES}
pulses, where capacity and bounds are {MANY} times as high.</p>
<p>Limits: bandwidth limits low thresholds in bright light; photons limit high thresholds (dark objects give few); and the estimator is the limit
if each pixel is evaluated alone. The controller sends what the stream carries, so it has many events in dim light, and in bright light no fewer
than it must.</p>"""
    figures = [
        (stem, _background_figure(table, pulses), caption)
        for stem, pulses, caption in (
            ("background", PULSES, f"Wrong share and events against background, {PULSES} pulses"),
            ("background_8x", MANY * PULSES, f"The same with {MANY * PULSES} pulses"),
        )
    ]
    return Section(
        "background",
        "Background: thresholds, controller, oracle",
        text,
        figures,
        mean_rows(("pulses", "klux", "setting"), (*WRONG, "events_per_s", "dropped_share"), table),
        [_goal(table), *(_against_best(table, klux) for klux in KLUX)],
    )


def rearm_and_window(run: Processes) -> Section:
    """Vary the tree's blind time and the length of the coincidence window."""
    values = {"rearm": REARM, "window": WINDOWS}
    table: Outcomes = grouped(
        {
            (pulses, name, value, threshold): cases(
                FEW_SEEDS,
                pulses,
                estimators=METHODS,
                sensor={"rearm": value} if name == "rearm" else {},
                subgroup={"threshold": threshold} | ({"window": value} if name == "window" else {}),
            )
            for pulses in BOTH_PULSES
            for name in values
            for value, threshold in product(values[name], SHOWN_THRESHOLDS)
        },
        outcome,
        run,
    )
    figure = new_figure(11, 4.2)
    labels = "re-arm gap R in cycles", "coincidence window W in ticks of 62.5 ps"
    for axis, (name, at), label in zip(figure.subplots(1, 2), values.items(), labels):
        for threshold, colour in SHOWN_THRESHOLDS.items():
            shown = [table[PULSES, name, value, threshold] for value in at]
            _plot_methods(axis, at, shown, colour, f"threshold {threshold}")
        share_axis(axis, xlabel=label, ylabel="share of wrong pixels")
    figure.axes[1].set_xscale("log", base=2)
    legend_below(figure)
    return section(
        "rearm_window",
        "Re-arm gap R and window W",
        """<p>Five objects at 50 klux. R costs the signal of pulses in which noise has just closed a window; fewer noise events
leave the sensor, too. A short window sees only a part of the pulse; a long one counts more noise, blinds the tree for longer
and merges surfaces.</p>""",
        figure,
        f"Share of wrong pixels against R (left) and W (right), {PULSES} pulses; {ALSO_MANY}",
        mean_rows(("pulses", "parameter", "value", "threshold"), (*WRONG, "events_per_s"), table),
    )


def fifo_and_bandwidth(run: Processes) -> Section:
    """Measure the events lost to full FIFOs, by depth and by the capacity of the streams."""
    setups = {}
    for pulses in BOTH_PULSES:
        for (klux, threshold), depth in product(DEPTH_CASES, DEPTHS):
            setups[pulses, klux, threshold, depth, "id", 1] = cases(
                pulses=pulses, klux=klux, subgroup={"threshold": threshold}, sensor={"fifo_depth": depth}
            )
        for (form, streams), klux in product(BANDWIDTHS, KLUX):
            setups[pulses, klux, BANDWIDTH_THRESHOLD, FIFO_DEPTH, form, streams] = cases(
                pulses=pulses,
                klux=klux,
                estimators=() if form == "short" else ("planes",),  # no ID map, no depth; but the losses are the same
                subgroup={"threshold": BANDWIDTH_THRESHOLD},
                frame={"format": form},
                sensor={"streams": streams},
            )
    table: Outcomes = grouped(setups, outcome, run)
    figure = new_figure(11, 4.2)
    left, right = figure.subplots(1, 2)
    for (klux, threshold), colour in DEPTH_CASES.items():
        lost = [mean(table[PULSES, klux, threshold, depth, "id", 1], "dropped_share") for depth in DEPTHS]
        left.plot(DEPTHS, lost, "-o", color=colour, label=f"{klux:g} klux, threshold {threshold}")
    for (form, streams), colour in zip(BANDWIDTHS, SERIES):
        shown = [table[PULSES, klux, BANDWIDTH_THRESHOLD, FIFO_DEPTH, form, streams] for klux in KLUX]
        lost = [mean(outcomes, "dropped_share") for outcomes in shown]
        right.plot(KLUX, lost, "-o", color=colour, label=f"{form}, {streams} stream{'s' * (streams > 1)}")
    left.set(xlabel="FIFO depth in events", title="depth (format id, 1 stream)")
    left.set_xscale("log", base=2)
    right.set(xlabel="background in klux", title=f"bandwidth (threshold {BANDWIDTH_THRESHOLD}, depth {FIFO_DEPTH})")
    for axis in figure.axes:
        axis.set_ylabel("share of committed events dropped")
        axis.legend()
    return section(
        "fifo_bandwidth",
        "FIFO depth and readout bandwidth",
        """<p>A stream carries a 64-bit beat per cycle: in a laser period of 250 cycles, these are 250 events of format short, 125
with ID maps, or 62 with offsets, too, for all 16 subgroups. Above that rate no FIFO helps; below it, a depth of a few events
absorbs random bursts.</p>""",
        figure,
        f"Share of events dropped, {PULSES} pulses; {ALSO_MANY}",
        mean_rows(
            ("pulses", "klux", "threshold", "fifo_depth", "format", "streams"),
            ("dropped_share", "events_per_s", "wrong_share_planes"),
            table,
        ),
    )


def two_targets(run: Processes) -> Section:
    """Measure two surfaces in one subgroup, by the way to tell them apart."""
    table: Outcomes = grouped(
        {
            (pulses, klux, name, step_m): cases(
                FEW_SEEDS,
                pulses,
                scene=f"two-targets:{NEAR_M},{NEAR_M + step_m:.4g}",
                klux=klux,
                estimators=(method,),
                frame=frame,
            )
            for pulses, klux, (name, (frame, method)), step_m in product(
                BOTH_PULSES, TWO_KLUX, TWO_SOURCES.items(), STEPS_M
            )
        },
        outcome,
        run,
    )
    figure = new_figure(11, 4.2)
    steps_cm = 100 * np.array(STEPS_M)
    for axis, klux in zip(figure.subplots(1, 2, sharey=True), TWO_KLUX):
        for name, colour, mark in zip(TWO_SOURCES, SERIES[::2] + SERIES[5:6], ("-o", "--s", "-.v", ":^", "-d")):
            shares = [mean(table[PULSES, klux, name, step_m], "wrong_share") for step_m in STEPS_M]
            axis.plot(steps_cm, shares, mark, color=colour, label=name)
        axis.set(xlabel=f"step behind the target at {NEAR_M:g} m in cm", title=f"{klux:g} klux", xscale="log")
        axis.set_xticks(steps_cm, labels=[f"{step:.0f}" for step in steps_cm])
        axis.set_xticks([], minor=True)
    figure.axes[0].set_ylabel("share of wrong pixels")
    legend_below(figure)
    return section(
        "two_targets",
        "Two targets in one subgroup, minigroup records on and off",
        """<p>Stripes of 4 columns at 5 m and a step behind. One event covers both surfaces if they are closer to each other than the
window (1 ns, 15 cm), and its stamp is that of the nearer one. The minigroups' own stamps tell them apart, but are no sharper
than 500 ps (7.5 cm): they win at about 10 cm and lose where the window is sufficient. Between the window's end and the re-arm,
the tree is blind (up to 30 cm), which costs events of the far surface, but no record of its minigroups.</p>""",
        figure,
        f"Share of wrong pixels against the step, {PULSES} pulses; {ALSO_MANY}",
        mean_rows(("pulses", "klux", "source", "step_m"), ("wrong_share", "events_per_s", "records_per_s"), table),
    )


def noisy_spads(run: Processes) -> Section:
    """Vary dark counts, hot pixels and crosstalk."""
    pixels = Sensor().array_pixels
    hot = [dark_count_map(pixels, median_cps=0, hot_fraction=share, hot_cps=HOT_CPS, seed=1) for share in HOT_SHARES]
    studies = {
        "dark counts of every pixel in 1/s": {rate_cps: Spad(dark_cps=rate_cps) for rate_cps in DARK_CPS},
        f"share of hot pixels ({HOT_CPS / 1e6:g}e6/s)": dict(zip(HOT_SHARES, (Spad(dark_cps=each) for each in hot))),
        "crosstalk probability to each neighbour": {share: Spad(crosstalk_probability=share) for share in CROSSTALK},
    }
    table: Outcomes = grouped(
        {
            (pulses, study, value, threshold): cases(
                FEW_SEEDS, pulses, spad=spad, estimators=METHODS, subgroup={"threshold": threshold}
            )
            for pulses, study in product(BOTH_PULSES, studies)
            for (value, spad), threshold in product(studies[study].items(), SHOWN_THRESHOLDS)
        },
        outcome,
        run,
    )
    figure = new_figure(13, 7.5)
    axes = figure.subplots(2, 3, sharey="row")
    for column, (study, spads) in zip(axes.T, studies.items()):
        at = range(len(spads))
        for threshold, colour in SHOWN_THRESHOLDS.items():
            outcomes, label = [table[PULSES, study, value, threshold] for value in spads], f"threshold {threshold}"
            _plot_methods(column[0], at, outcomes, colour, label)
            events = [mean(one, "events_per_s") / 1e6 for one in outcomes]
            column[1].plot(at, events, "-o", color=colour, label=label)
        for axis in column:
            axis.set_xlabel(study)
            axis.set_xticks(at, labels=[f"{value:g}" for value in spads])
    for axis, label in zip(axes[:, 0], ("share of wrong pixels", "events in 1e6/s")):
        axis.set_ylabel(label)
    legend_below(figure)
    share_axis(axes[0, 0])
    return section(
        "noisy_spads",
        "Dark counts, hot pixels, crosstalk",
        """<p>Five objects at 50 klux (1.2e6 background counts per second in a pixel). Crosstalk fakes coincidences: an avalanche fires
a neighbour, so one noise photon meets a threshold of 2. A hot pixel opens windows and blinds the tree for the others, but counts
only once in a coincidence. With threshold 5, the estimator of planes either finds object 2 (13 % of the pixels) or does not, and
noise that lifts its few photons over the threshold helps.</p>""",
        figure,
        f"Share of wrong pixels (above) and events (below), {PULSES} pulses; {ALSO_MANY}",
        mean_rows(("pulses", "study", "value", "threshold"), (*WRONG, "events_per_s"), table),
    )


def _oracle(fixed: Mapping[int, Sequence[Outcome]]) -> list[int]:
    """Return for each subgroup the threshold with the fewest wrong pixels, and among equals (0.1 pixels) the fewest events."""
    sensor, ranked = Sensor(), []
    for threshold, outcomes in fixed.items():
        wrong = np.mean([by_subgroup(one.wrong["planes"], sensor).sum(axis=1) for one in outcomes], axis=0).round(1)
        events = np.mean([one.stored for one in outcomes], axis=0)
        ranked.append([(*counts, threshold) for counts in zip(wrong, events)])
    return [min(of_subgroup)[2] for of_subgroup in zip(*ranked)]


def _plot_methods(axis: Axes, at: Sequence[float], outcomes: list[list[Outcome]], colour: str, label: str) -> None:
    for method, measure, mark in zip(METHODS, WRONG, MARKS):
        axis.plot(at, [mean(one, measure) for one in outcomes], mark, color=colour, label=f"{label}, {method}")


def _background_figure(table: Outcomes, pulses: int) -> Figure:
    figure = new_figure(13, 5)
    axes = figure.subplots(1, 3)
    names = {"off": "coincidence off"} | {str(threshold): f"threshold {threshold}" for threshold in THRESHOLDS}
    styles = {
        "off": (GREY, "-.", ""),
        **{str(th): (SERIES[th - 1], "-", "") for th in THRESHOLDS},
        "controller": (ALARM, "-", "o"),
        "oracle": (INK, ":", "x"),
    }
    for setting, (colour, line, marker) in styles.items():
        for axis, measure, unit in zip(axes, (*WRONG, "events_per_s"), (1, 1, 1e6)):
            values = [mean(table[pulses, klux, setting], measure) / unit for klux in KLUX]
            axis.plot(KLUX, values, line, marker=marker, color=colour, label=names.get(setting, setting))
    for axis, title in zip(axes, ("estimator of planes", "matched filter")):
        axis.axhline(GOAL_SHARE, color=LIGHT_GREY, linewidth=1)
        axis.set(ylabel="share of wrong pixels", title=f"{title} (grey: {GOAL_SHARE:.0%})")
        share_axis(axis)
    axes[2].set(ylabel="events that leave the sensor in 1e6/s", title="events", yscale="log")
    for axis in axes:
        axis.set(xlabel="background in klux", xscale="log")
    legend_below(figure)
    return figure


def _goal(table: Outcomes) -> Comparison:
    settings = {"controller": "controller", "oracle": "oracle"}
    settings |= {"threshold 2": "2", "threshold 5": "5", "coincidence off": "off"}
    wrong = {name: mean(table[PULSES, GOAL_KLUX, key], "wrong_share") for name, key in settings.items()}
    return Comparison(
        f"wrong at {GOAL_KLUX:g} klux, {PULSES} pulses, estimator of planes",
        f"7 % (the goal: below {GOAL_SHARE:.0%})",
        {name: f"{share:.2%}" for name, share in wrong.items()},
        f"{'reached' if wrong['controller'] < GOAL_SHARE else 'not reached'} by the controller",
    )


def _against_best(table: Outcomes, klux: float) -> Comparison:
    """Compare the controller with the fixed threshold that has the fewest wrong pixels."""
    keys = ["controller", *map(str, THRESHOLDS)]
    numbers = {
        key: (mean(table[PULSES, klux, key], "wrong_share"), mean(table[PULSES, klux, key], "events_per_s"))
        for key in keys
    }
    best = min(keys[1:], key=numbers.__getitem__)
    pairs = zip(table[PULSES, klux, "controller"], table[PULSES, klux, best])
    more = [auto.wrong["planes"].sum() - fixed.wrong["planes"].sum() for auto, fixed in pairs]
    saved = 1 - numbers["controller"][1] / numbers[best][1]
    auto, fixed = (
        f"{numbers[key][0]:.2%} wrong, {numbers[key][1] / 1e6:.1f}e6 events/s" for key in ("controller", best)
    )
    return Comparison(
        f"controller against the best fixed threshold, {klux:g} klux",
        "-",
        {"controller": auto, "best fixed": f"threshold {best}: {fixed}"},
        f"{saved:.1%} fewer events; {np.mean(more):+.1f} ± {np.std(more) / np.sqrt(len(more)):.1f} wrong pixels of 1024",
    )
