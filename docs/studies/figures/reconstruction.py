# SPDX-License-Identifier: Apache-2.0
"""Draws Figs. 6 and 8 of the paper: the scene without coincidence, with one threshold, and with
other sizes of groups.
"""

from itertools import product
from typing import Any

import numpy as np

from coincid.lab.campaign import Processes, grouped
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.pixels import pixel_table
from coincid.model.depth.quality import wrong_pixels
from coincid.model.light.analytic import histogram
from coincid.model.light.link_budget import FORMS
from coincid.model.light.timing import Timing
from coincid.model.scenes.scene import Scene
from coincid.model.shared.constants import SPEED_OF_LIGHT_M_S
from coincid.study.pictures import Panel, draw_row

from .sections import Comparison, Row, Section
from .setups import MANY, PULSES, Outcome, cases, mean, outcome

METHODS = ("maximum", "matched", "background", "planes")
SEEDS = 4
RIGHT = 0.5  # an object with a smaller share of wrong pixels is called right
# panel: klux, settings of the subgroups, the paper's text
PANELS_6: dict[str, tuple[float, dict[str, Any], str]] = {
    "a": (5.0, {"coincidence": False}, "up to 11.9 % wrong; objects 1, 3, 4 right"),
    "b": (50.0, {"threshold": 5}, "objects 1, 3, 4 right"),
    "c": (50.0, {"threshold": 2}, "objects 2, 5 right"),
}
KLUX_8 = 50.0
THRESHOLDS_8 = (1, 2, 3, 4, 5, 7)
PANELS_8 = {  # panel: subgroup, minigroup; those of (c) are the paper's, the others are our choice
    "a": ((16, 16), (4, 4)),
    "b": ((4, 4), (2, 2)),
    "c": ((8, 8), (2, 2)),
}
METHODS_8 = ("maximum", "matched", "planes", "matched/minigroup")
STREAMS_8 = 4


def figure_6(run: Processes, engine: str | None = None) -> Section:
    """Show scheme 1 at 5 klux, and thresholds 5 and 2 at 50 klux."""
    rows: list[Row] = [("panel", "klux", "source", "pulses", "estimator", "object", "wrong_share")]
    figures, comparisons = [], []
    for panel, (klux, settings, paper) in PANELS_6.items():
        setups = {
            ("Monte Carlo", pulses): cases(
                SEEDS, pulses, klux=klux, subgroup=settings, estimators=METHODS
            )
            for pulses in (PULSES, MANY * PULSES)
        }
        measured, first = grouped(setups, outcome, run), setups["Monte Carlo", PULSES][0]
        analytic = dict(
            zip(FORMS, run.map(_analytic, [(form, first) for form in FORMS]), strict=True)
        )
        one, many = (outcomes[0] for outcomes in measured.values())
        if engine:
            measured["RTL", PULSES] = [outcome(Run(first.but(engine=engine)))]
        scene = Run(first).scene
        for form in FORMS:
            rows += _object_rows((panel, klux, form, PULSES, "maximum"), analytic[form][0], scene)
        for (source, pulses), outcomes in measured.items():
            for method in METHODS:
                rows += _object_rows(
                    (panel, klux, source, pulses, method), _mean_wrong(outcomes, method), scene
                )
        name = "coincidence off" if panel == "a" else f"threshold {settings['threshold']}"
        shown = [Panel(f"analytic, {form}", analytic[form][1]) for form in FORMS]
        shown += [Panel(f"Monte Carlo, {method}", one.depth_m[method]) for method in METHODS]
        ours = {f"analytic, {form}": _summary(analytic[form][0], scene) for form in FORMS}
        for method in METHODS:
            wrong = _mean_wrong(measured["Monte Carlo", PULSES], method)
            ours[f"Monte Carlo, {method}"] = _summary(wrong, scene)
        if engine:
            _add_rtl(shown, ours, measured["RTL", PULSES][0], one)
        shown.append(Panel(f"{MANY * PULSES} pulses, matched", many.depth_m["matched"]))
        figure, _ = draw_row(shown, scene.truth_m, f"{name}, {klux:g} klux, {PULSES} pulses")
        figures.append((f"fig6{panel}", figure, f"Fig. 6{panel}: {name}, {klux:g} klux"))
        comparisons.append(Comparison(f"6{panel}: {name}, {klux:g} klux", paper, ours))
    return Section(
        "fig6", "Fig. 6: without coincidence, and with one threshold", figures, rows, comparisons
    )


def figure_8(run: Processes, engine: str | None = None) -> Section:
    """Show sizes of subgroups and minigroups, each at its best threshold."""
    rows: list[Row] = [
        (
            "panel",
            "subgroup",
            "minigroup",
            "source",
            "pulses",
            "threshold",
            "estimator",
            "wrong_share",
            "events_per_s",
        )
    ]
    figures, comparisons = [], []

    def setups(panel: str, threshold: int, pulses: int = PULSES) -> list[Setup]:
        subgroup, minigroup = map(list, PANELS_8[panel])
        sensor = {"subgroup": subgroup, "minigroup": minigroup, "streams": STREAMS_8}
        settings: dict[str, Any] = {
            "sensor": sensor,
            "frame": {"format": "full"},
            "subgroup": {"threshold": threshold},
        }
        return cases(SEEDS, pulses, klux=KLUX_8, estimators=METHODS_8, **settings)

    every = {key: setups(*key) for key in product(PANELS_8, THRESHOLDS_8)}
    by_threshold = grouped(every, outcome, run)
    tasks = {(*key, form): (form, group[0]) for key, group in every.items() for form in FORMS}
    analytic = dict(zip(tasks, run.map(_analytic, tasks.values()), strict=True))
    # (wrong share, threshold) by panel and source
    best: dict[tuple[str, str], tuple[float, int]] = {}
    for (panel, threshold), outcomes in by_threshold.items():
        for form in FORMS:
            wrong = float(analytic[panel, threshold, form][0].mean())
            rows.append((*_labels(panel), form, PULSES, threshold, "maximum", wrong, ""))
            best[panel, form] = min(best.get((panel, form), (np.inf, 0)), (wrong, threshold))
        rows += _rows_8(panel, "Monte Carlo", PULSES, threshold, outcomes)
        for method in METHODS_8:
            wrong = mean(outcomes, f"wrong_share_{method}")
            best[panel, method] = min(best.get((panel, method), (np.inf, 0)), (wrong, threshold))
    matched = {panel: best[panel, "matched"][1] for panel in PANELS_8}
    many = grouped(
        {panel: setups(panel, matched[panel], MANY * PULSES) for panel in PANELS_8}, outcome, run
    )
    for panel, outcomes in many.items():
        rows += _rows_8(panel, "Monte Carlo", MANY * PULSES, matched[panel], outcomes)
        shown, ours = [], {}
        for form in FORMS:
            ours[f"analytic, {form}"] = "{:.1%} (threshold {})".format(*best[panel, form])
        for method in METHODS_8:
            share, threshold = best[panel, method]
            shown.append(
                Panel(
                    f"{method}, threshold {threshold}",
                    by_threshold[panel, threshold][0].depth_m[method],
                )
            )
            ours[f"Monte Carlo, {method}"] = f"{share:.1%} (threshold {threshold})"
        depth_m = outcomes[0].depth_m["matched"]
        shown.append(Panel(f"{MANY * PULSES} pulses, matched, threshold {matched[panel]}", depth_m))
        if engine:
            threshold = best[panel, "planes"][1]
            rtl = outcome(Run(every[panel, threshold][0].but(engine=engine)))
            rows += _rows_8(panel, "RTL", PULSES, threshold, [rtl])
            _add_rtl(shown, ours, rtl, by_threshold[panel, threshold][0])
        _, subgroup, minigroup = _labels(panel)
        title = f"subgroup {subgroup}, minigroup {minigroup}, {KLUX_8:g} klux"
        figure, _ = draw_row(shown, Run(every[panel, threshold][0]).scene.truth_m, title)
        figures.append(
            (
                f"fig8{panel}",
                figure,
                f"Fig. 8{panel}: {title}: each estimator at its best threshold",
            )
        )
        paper = "7 % wrong" if panel == "c" else "worse than (c)"
        comparisons.append(Comparison(f"8{panel}: {title}", paper, ours))
    return Section("fig8", "Fig. 8: sizes of subgroups and minigroups", figures, rows, comparisons)


def _labels(panel: str) -> tuple[str, str, str]:
    """Return the first columns of Fig. 8's CSV: panel, subgroup, minigroup."""
    (rows, cols), (minigroup_rows, minigroup_cols) = PANELS_8[panel]
    return panel, f"{rows}x{cols}", f"{minigroup_rows}x{minigroup_cols}"


def _rows_8(
    panel: str, source: str, pulses: int, threshold: int, outcomes: list[Outcome]
) -> list[Row]:
    """Return rows of Fig. 8's CSV, one per estimator."""
    start, events_per_s = (
        (*_labels(panel), source, pulses, threshold),
        mean(outcomes, "events_per_s"),
    )
    return [
        (*start, method, mean(outcomes, f"wrong_share_{method}"), events_per_s)
        for method in METHODS_8
    ]


def _mean_wrong(outcomes: list[Outcome], method: str) -> np.ndarray:
    return np.mean([one.wrong[method] for one in outcomes], axis=0)


def _object_rows(start: tuple[object, ...], wrong: np.ndarray, scene: Scene) -> list[Row]:
    """Return the rows of Fig. 6's CSV: wrong share of each object, and of all."""
    objects = [
        (int(label), float(wrong[scene.labels == label].mean()))
        for label in np.unique(scene.labels)
    ]
    return [(*start, label, share) for label, share in (*objects, ("all", float(wrong.mean())))]


def _summary(wrong: np.ndarray, scene: Scene) -> str:
    right = [
        str(label)
        for label in np.unique(scene.labels)
        if wrong[scene.labels == label].mean() < RIGHT
    ]
    return f"{wrong.mean():.1%} wrong; right: {', '.join(right) or 'none'}"


def _add_rtl(shown: list[Panel], ours: dict[str, str], rtl: Outcome, golden: Outcome) -> None:
    """Add the panel of the RTL, and whether its depth equals that of the golden model."""
    shown.append(Panel("RTL, planes", rtl.depth_m["planes"]))
    same = all(
        np.array_equal(rtl.depth_m[method], golden.depth_m[method], equal_nan=True)
        for method in golden.depth_m
    )
    ours["RTL"] = "the same depth in every pixel" if same else "differs from the golden model"


def _analytic(task: tuple[str, Setup]) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of `SEEDS` draws in which a pixel is wrong, and the depth of the first draw;
    float64[rows, cols] each.
    """
    form, setup = task
    config, run, timing = setup.config, Run(setup), Timing.from_config(setup.config)
    sensor, light, table = config.sensor, run.light, pixel_table(config.sensor)
    depth_m = np.full((SEEDS, sensor.array_pixels), np.nan)
    for s in range(sensor.subgroups):
        pixel = np.flatnonzero(table.subgroup == s)
        pixel = pixel[np.argsort(table.inside[pixel])]
        flight_s = 2 * light.distance_m[pixel, 0] / SPEED_OF_LIGHT_M_S
        expected = histogram(
            light.distance_m[pixel, 0],
            light.signal_per_pulse[pixel, 0],
            light.background_cps[pixel],
            form=form,
            threshold=int(config.threshold[s]),
            window_ticks=int(config.window[s]),
            pulses=config.pulses,
            scheme=2 if config.coincidence[s] else 1,
            sensor=sensor,
            timing=timing,
        )
        lead_s = _lead_s(expected, flight_s, timing)
        for draw in range(SEEDS):
            counts = np.random.default_rng([setup.seed, draw, s]).poisson(expected)
            peak_s = np.where(
                counts.any(axis=1), (counts.argmax(axis=1) + 0.5) * timing.tick_s, np.nan
            )
            depth_m[draw, pixel] = (peak_s + lead_s) * SPEED_OF_LIGHT_M_S / 2
    pictures_m = depth_m.reshape(SEEDS, sensor.rows, sensor.cols)
    wrong = wrong_pixels(pictures_m, run.scene.truth_m)
    return wrong.mean(axis=0), pictures_m[0]


def _lead_s(expected: np.ndarray, flight_s: np.ndarray, timing: Timing) -> np.ndarray:
    """Return the time by which the peak of each expected histogram precedes the time of flight
    (within a nanosecond).
    """
    time_s = (np.arange(expected.shape[1]) + 0.5) * timing.tick_s
    near = np.abs(time_s - flight_s[:, None]) < 1e-9
    return flight_s - time_s[np.where(near, expected, -1).argmax(axis=1)]
