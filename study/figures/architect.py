# SPDX-License-Identifier: Apache-2.0
"""An architect's questions: re-arm gap, window, and noisy SPADs, each against wrong pixels and events."""

from collections.abc import Mapping
from itertools import product
from typing import Any

from ...lab.campaign import Processes, grouped
from ...model.contract.parameters import Sensor
from ...model.light.spad import Spad, dark_count_map
from ..palette import SERIES
from ..plot_style import legend_below, new_figure, share_axis
from .sections import Section, section
from .setups import PULSES, cases, mean, mean_rows, outcome

METHODS = {"planes": "-o", "matched": "--s"}  # estimator: its line
THRESHOLDS = {2: SERIES[0], 3: SERIES[3], 5: SERIES[5]}
SEEDS = 2
HOT_CPS = 5e6
PARAMETERS = {  # what varies: for each of its values, fields of `Setup.of`
    "re-arm gap R in cycles": {rearm: {"sensor": {"rearm": rearm}} for rearm in range(8)},
    "coincidence window W in ticks of 62.5 ps": {
        window: {"subgroup": {"window": window}} for window in (4, 8, 16, 32, 64, 128)
    },
}
SPADS = {
    "dark counts of every pixel in 1/s": {
        rate_cps: {"spad": Spad(dark_cps=rate_cps)} for rate_cps in (0.0, 1e3, 1e4, 1e5, 1e6, 5e6)
    },
    f"share of hot pixels ({HOT_CPS / 1e6:g}e6/s)": {
        share: {
            "spad": Spad(
                dark_cps=dark_count_map(
                    Sensor().array_pixels, median_cps=0, hot_fraction=share, hot_cps=HOT_CPS, seed=1
                )
            )
        }
        for share in (0.0, 0.01, 0.02, 0.05, 0.1, 0.2)
    },
    "crosstalk probability to each neighbour": {
        share: {"spad": Spad(crosstalk_probability=share)} for share in (0.0, 0.005, 0.01, 0.02, 0.05, 0.1)
    },
}


def rearm_and_window(run: Processes) -> Section:
    """Vary the tree's blind time and the length of the coincidence window."""
    return _varied(run, "rearm_window", "Re-arm gap R and window W", PARAMETERS)


def noisy_spads(run: Processes) -> Section:
    """Vary dark counts, hot pixels and crosstalk."""
    return _varied(run, "noisy_spads", "Dark counts, hot pixels, crosstalk", SPADS)


def _varied(run: Processes, name: str, title: str, studies: Mapping[str, Mapping[Any, dict[str, Any]]]) -> Section:
    """Return a section with a column for each study: wrong pixels above, events below, over what varies."""
    setups = {}
    for (study, values), threshold in product(studies.items(), THRESHOLDS):
        for value, fields in values.items():
            subgroup = {"threshold": threshold} | fields.get("subgroup", {})
            setups[study, value, threshold] = cases(SEEDS, estimators=tuple(METHODS), **fields | {"subgroup": subgroup})
    table = grouped(setups, outcome, run)
    figure = new_figure(4.4 * len(studies), 7.5)
    axes = figure.subplots(2, len(studies), sharey="row", squeeze=False)
    for (above, below), (study, values) in zip(axes.T, studies.items()):
        at = range(len(values))
        for threshold, colour in THRESHOLDS.items():
            shown, label = [table[study, value, threshold] for value in values], f"threshold {threshold}"
            for method, mark in METHODS.items():
                wrong = [mean(one, f"wrong_share_{method}") for one in shown]
                above.plot(at, wrong, mark, color=colour, label=f"{label}, {method}")
            below.plot(at, [mean(one, "events_per_s") / 1e6 for one in shown], "-o", color=colour)
        for axis in (above, below):
            axis.set_xticks(at, labels=[f"{value:g}" for value in values])
        below.set_xlabel(study)
    share_axis(axes[0, 0], ylabel="share of wrong pixels")
    axes[1, 0].set_ylabel("events in 1e6/s")
    legend_below(figure)
    measures = (*(f"wrong_share_{method}" for method in METHODS), "events_per_s")
    rows = mean_rows(("study", "value", "threshold"), measures, table)
    return section(
        name, title, figure, f"Five objects at 50 klux, {PULSES} pulses: wrong pixels (above) and events (below)", rows
    )
