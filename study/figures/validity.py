# SPDX-License-Identifier: Apache-2.0
"""Limits of the corrected equations: expected counts of a pixel against Monte Carlo."""

from itertools import product

import numpy as np

from ...lab.campaign import Processes, campaign
from ...lab.outcomes import Run
from ...lab.setup import Setup
from ...model.light.analytic import VALID_DEAD_FRACTION, histogram
from ...model.light.light import Light, background_cps
from ...model.light.link_budget import FORMS
from ...model.light.spad import Spad
from ...model.light.timing import Timing
from ...model.shared.constants import SPEED_OF_LIGHT_M_S
from ..palette import DARK_GREY, LIGHT_GREY, SERIES
from ..plot_style import SOURCES, legend_below, new_figure
from .sections import Comparison, Row, Section, section
from .setups import MANY

KLUX = (1.0, 5.0, 20.0, 50.0, 100.0, 200.0, 400.0, 1000.0, 2000.0)
DISTANCE_M, SIGNAL = 9.7, 0.05  # 3.2 photons per pulse in the subgroup: a dark object
THRESHOLDS, WINDOW_TICKS, PULSES = (2, 5), 16, 1000
AROUND_S = 2e-9  # around the time of flight: counts as signal
PIXELS = 64
COUNTS = ("signal", "noise")


def validity(run: Processes) -> Section:
    """Show counts of a pixel near the target and elsewhere, as a ratio to Monte Carlo, against background."""
    setups = {key: _setup(*key) for key in product((PULSES, MANY * PULSES), THRESHOLDS, KLUX)}
    counted = campaign(setups, _counts, run)
    ratios = [name for form in FORMS for name in (f"{form}_to_monte_carlo", f"{form}_standard_error")]
    rows: list[Row] = [("pulses", "threshold", "klux", "counts", "monte_carlo", *FORMS, *ratios)]
    for key, (measured, expected) in counted.items():
        for i, name in enumerate(COUNTS):
            values = [value for form in FORMS for value in _ratio(expected[form][i], measured[i], key[0])]
            rows.append((*key, name, measured[i], *(expected[form][i] for form in FORMS), *values))
    figure = new_figure(11, 4.2)
    limit_klux = VALID_DEAD_FRACTION / Spad().dead_time_s / background_cps(1)
    for axis, (i, name) in zip(figure.subplots(1, 2), enumerate(COUNTS)):
        for threshold, colour in zip(THRESHOLDS, (SERIES[0], SERIES[4])):
            for form in FORMS:
                of_klux = [(klux, *counted[MANY * PULSES, threshold, klux]) for klux in KLUX]
                points = [
                    (klux, *_ratio(expected[form][i], measured[i], MANY * PULSES))
                    for klux, measured, expected in of_klux
                    if _seen(measured[i], MANY * PULSES, 100)
                ]
                at, ratio, error = np.transpose(points)
                look = {"color": colour, "linestyle": SOURCES[form]["linestyle"], "marker": "o"}
                axis.errorbar(at, ratio, error, **look, label=f"threshold {threshold}, {form}")
        axis.axvline(limit_klux, color=DARK_GREY, linewidth=1, label="stated validity of corrected")
        axis.axhline(1, color=LIGHT_GREY, linewidth=1)
        axis.set(xlabel="background in klux", ylabel="analytic / Monte Carlo", xscale="log", yscale="log")
        axis.set_title(f"{name} counts of a pixel")
    legend_below(figure, 5)
    worst = {
        form: max(
            abs(expected[form][i] / measured[i] - 1)
            for (pulses, _, klux), (measured, expected) in counted.items()
            for i in range(2)
            if klux < limit_klux and _seen(measured[i], pulses, 2000)
        )
        for form in FORMS
    }
    return section(
        "validity",
        "Where the corrected equations end",
        f"""<p>A dark target ({PIXELS * SIGNAL:.1f} photons per pulse in the subgroup) at {DISTANCE_M} m: mean counts per pixel and pulse
within {AROUND_S * 1e9:g} ns of the time of flight, and elsewhere, relative to those of Monte Carlo. The corrected form assumes that pixels
that have just fired are ready at the next window. It claims to hold while noise times dead time is below {VALID_DEAD_FRACTION:g}, here up
to {limit_klux:.0f} klux. Bars: standard error of Monte Carlo.</p>""",
        figure,
        f"Ratio of analytic counts to Monte Carlo, {MANY * PULSES} pulses; the CSV also has {PULSES}",
        rows,
        Comparison(
            "largest deviation within the stated validity",
            "-",
            {form: f"{value:.1%}" for form, value in worst.items()},
            "Corrected: with the statistics of Monte Carlo. Literal: (16a) assumes one window of noise per pulse, while there are "
            "some hundred; (18) divides by the root of the jitter, so that the signal's bins sum to 14.6 times the right value; "
            "no mixed coincidences in (13) and (15).",
        ),
    )


def _setup(pulses: int, threshold: int, klux: float) -> Setup:
    sensor = {"rows": 8, "cols": 8, "fifo_depth": 1024}
    subgroup = {"threshold": threshold, "window": WINDOW_TICKS}
    light = Light(rows=8, cols=8, distance_m=DISTANCE_M, signal_per_pulse=SIGNAL, background_cps=background_cps(klux))
    return Setup.of(sensor=sensor, frame={"pulses": pulses}, subgroup=subgroup, light=light)


def _counts(run: Run) -> tuple[list[float], dict[str, list[float]]]:
    """Return the counts of a pixel and pulse near the target and elsewhere: (Monte Carlo, by form)."""
    config, result, timing = run.config, run.result, Timing.from_config(run.config)
    flight_s = 2 * DISTANCE_M / SPEED_OF_LIGHT_M_S
    share_left = 1 - (run["dropped_share"] or 0.0)  # drops of a full FIFO are excluded here
    near = np.abs((result["stamp"] + 0.5) * timing.tick_s - flight_s) < AROUND_S
    measured = [float(result["count"][part].sum() / (PIXELS * config.pulses * share_left)) for part in (near, ~near)]
    time_s = (np.arange(config.period_ticks) + 0.5) * timing.tick_s
    near = np.abs(time_s - flight_s) < AROUND_S
    expected = {}
    for form in FORMS:
        mean = histogram(
            DISTANCE_M,
            SIGNAL,
            run.light.background_cps[0],
            threshold=int(config.threshold[0]),
            window_ticks=WINDOW_TICKS,
            pulses=1,
            form=form,
            sensor=config.sensor,
            timing=timing,
        )[0]
        expected[form] = [float(mean[part].sum()) for part in (near, ~near)]
    return measured, expected


def _ratio(expected: float, measured: float, pulses: int) -> tuple[float, float]:
    """Return `expected` over `measured` counts of a pixel and pulse, and the standard error from the number of counts."""
    if not measured:
        return float("nan"), float("nan")
    ratio = expected / measured
    return ratio, ratio / np.sqrt(measured * PIXELS * pulses)


def _seen(measured: float, pulses: int, least: int) -> bool:
    """Return whether the mean `measured` is based on at least `least` counts."""
    return measured * PIXELS * pulses >= least
