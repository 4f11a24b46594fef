# SPDX-License-Identifier: Apache-2.0
"""Readout bandwidth: the beats that a frame needs, the streams that carry them, and the losses with fewer streams.

The demand comes from two sources: `estimate`, closed formulas from the light, and the golden model, which also knows
what full FIFOs drop. The scene and the sizes are our choice; the paper leaves the readout open.
"""

import math
import os
from collections.abc import Callable, Sequence
from itertools import cycle, product
from pathlib import Path
from typing import Any

import numpy as np
from attrs import astuple, evolve, fields, frozen
from matplotlib.figure import Figure
from scipy import stats

from ..lab.measures import payload_beats, stream_beats
from ..lab.outcomes import Run
from ..lab.setup import Setup
from ..model.contract.config import Config, parse_config
from ..model.contract.packet import FORMAT_NAMES
from ..model.contract.parameters import Sensor
from ..model.contract.pixels import pixel_table
from ..model.light.analytic import busy_s, effective_cps, windows_per_period
from ..model.light.light import Light, background_cps
from ..model.light.link_budget import FORMS
from ..model.light.spad import Spad
from ..model.light.timing import Timing
from ..model.shared.constants import SPEED_OF_LIGHT_M_S
from ..model.shared.errors import check_integer
from ..model.shared.files import whole_file, write_csv
from ..model.shared.quantities import check_choice
from .palette import SERIES
from .plot_style import new_figure, save_figure, style

SCENE, SEED, CORRECTED = "five-objects", 1, FORMS[1]
SIZES = {"32x32": (32, 32), "64x64": (64, 64), "256x128": (128, 256)}  # rows, cols
KLUX = (1.0, 5.0, 20.0, 50.0, 100.0)
THRESHOLDS = (2, 3, 5)
STREAMS = (1, 2, 4, 8, 16, 32, 64)
CSV, TABLE, PLOT = "bandwidth.csv", "bandwidth.md", "bandwidth.png"
SHOWN_KLUX, SHOWN_THRESHOLD, SHOWN_SIZE = 50.0, 2, "32x32"
MEASURED = {  # columns: names of `MEASURES`
    "beats_golden": "beats_asked",
    "lost_events": "dropped_share",
    "lost_records": "mg_dropped_share",
    "overruns": "overruns",
    "late_cycles": "late_cycles",
}


@frozen
class Row:
    """A frame of the study. Beats are those of all streams in a frame, `_estimated` and by the `_golden` model.

    needed: number of streams, by the mean of the estimate, and such that the golden model loses nothing (0: not even
    with the most streams). Losses are shares, by the golden model. format: of the events; with `records`, minigroup
    records are on, too. lost_streams: number of streams of `lost_*`, `overruns` (events that carry the flag) and
    `late_cycles` (from the last period's end to the frame's last beat).
    """

    size: str
    klux: float
    threshold: int
    format: str
    records: bool
    beats_estimated: float
    beats_golden: int
    needed_estimated: int
    needed_golden: int
    lost_streams: int
    lost_events: float
    lost_records: float
    overruns: int
    late_cycles: int


COLUMNS: tuple[tuple[str, Callable[[Row, Row], object]], ...] = (  # of the table: row, row with records
    ("size", lambda row, also: row.size),
    ("klux", lambda row, also: f"{row.klux:g}"),
    ("threshold", lambda row, also: row.threshold),
    ("format", lambda row, also: row.format),
    ("beats per frame: estimate", lambda row, also: f"{row.beats_estimated:,.0f}"),
    ("golden", lambda row, also: f"{row.beats_golden:,}"),
    ("streams: estimate", lambda row, also: row.needed_estimated),
    ("golden", lambda row, also: _streams(row)),
    ("lost with one", lambda row, also: _percent(row.lost_events)),
    ("with records: streams: estimate", lambda row, also: also.needed_estimated),
    ("golden", lambda row, also: _streams(also)),
    ("events lost with one", lambda row, also: _percent(also.lost_events)),
    ("records lost with one", lambda row, also: _percent(also.lost_records)),
)


def estimate(config: Config, light: Light, timing: Timing, spad: Spad) -> tuple[np.ndarray, np.ndarray]:
    """Return (committed events, minigroup records) of each subgroup in a laser period, float64[subgroups], by formulas.

    Background opens windows at random. A pulse is detected if it finds the tree armed, or a window open. Surfaces that
    are closer to each other than the window count as one; pixels of a group are assumed to be equal, with its mean.
    """
    sensor, table = config.sensor, pixel_table(config.sensor)
    n, subgroups, laser_hz = sensor.pixels, sensor.subgroups, 1 / timing.period_s
    cycle_s = timing.phases * timing.tick_s
    open_s = (config.period - sensor.guard) * cycle_s
    noise_cps, signal_cps = effective_cps(
        light.background_cps[:, None], light.signal_per_pulse * laser_hz, spad.dead_time_s, laser_hz, CORRECTED
    )
    noise_cps, fired = (
        np.min(noise_cps, axis=1),
        np.asarray(signal_cps) / laser_hz,
    )  # per pixel; per pixel and target, in a pulse

    events = np.zeros(subgroups)
    noise = np.bincount(table.subgroup, noise_cps, subgroups) / n
    for s in range(subgroups):
        threshold = config.threshold[s] if config.coincidence[s] else 1
        window_ticks = int(config.window[s]) if config.coincidence[s] else 1
        window_s, busy = window_ticks * timing.tick_s, busy_s(window_ticks, sensor.rearm, timing)
        in_window = -np.expm1(-noise[s] * window_s)
        armed = 1 / (1 + n * noise[s] * busy)
        events[s] = windows_per_period(n * noise[s], open_s, busy, CORRECTED) * stats.binom.sf(
            threshold - 2, n - 1, in_window
        )
        own = table.subgroup == s
        surface = np.floor(np.nan_to_num(2 * light.distance_m[own] / SPEED_OF_LIGHT_M_S) / window_s)
        _, number = np.unique(surface, return_inverse=True)
        of_surface = np.bincount(number.ravel(), fired[own].ravel()) / n
        seen = armed + (1 - armed) * window_s / busy
        events[s] += seen * stats.binom.sf(threshold - 1, n, np.minimum(of_surface + in_window, 1)).sum()

    m, threshold, window_s = (
        sensor.minigroup_pixels,
        config.frame["mg_threshold"],
        (config.frame["mg_window"] - 0.5) * cycle_s,
    )
    group = table.subgroup * sensor.minigroups + table.minigroup[table.inside]
    noise = np.bincount(group, noise_cps) / m
    signal = np.bincount(group, fired.sum(axis=1)) / m
    in_window = -np.expm1(-noise * window_s)
    by_noise = m * noise * open_s * stats.binom.sf(threshold - 2, m - 1, in_window)
    latched = 1 - np.exp(-by_noise) * stats.binom.cdf(threshold - 1, m, np.minimum(signal + in_window, 1))
    records = 1 - np.prod(1 - latched.reshape(subgroups, -1), axis=1)
    return events, records if config.frame["minigroup_records"] else np.zeros(subgroups)


def study(
    klux: Sequence[float] | None = None,
    thresholds: Sequence[int] | None = None,
    sizes: Sequence[str] | None = None,
    tell: Callable[[str], None] = lambda line: None,
) -> list[Row]:
    """Return rows for all combinations (None: the defaults above), each for 1, 2, 4... streams up to a sufficient number.

    `tell` is called with one line per frame. Raises `InputError`.
    """
    klux, thresholds, sizes = klux or KLUX, thresholds or THRESHOLDS, sizes or tuple(SIZES)
    for level in klux:
        background_cps(level)
    for threshold in thresholds:
        check_integer("threshold", threshold, 1, Sensor().pixels)
    for size in sizes:
        check_choice("size", size, tuple(SIZES))
    rows = []
    for size, level in product(sizes, klux):
        tell(f"{size}, {level:g} klux")
        sensor = dict(zip(("rows", "cols"), SIZES[size]))
        start = Run(Setup.of(SCENE, sensor=sensor, klux=level, seed=SEED), workers=os.cpu_count() or 1)
        for threshold, records, form in product(thresholds, (False, True), FORMAT_NAMES):
            frame = {"minigroup_records": records, "format": form}
            rows += _with_streams(size, level, start.but(subgroup={"threshold": threshold}, frame=frame))
    return rows


def _with_streams(size: str, klux: float, run: Run) -> list[Row]:
    """Return the rows of one frame: with 1 stream, 2, ... until nothing is lost."""
    config, measured, lossless = run.config, list[dict[str, Any]](), False
    expected = [
        config.pulses * each for each in estimate(config, run.light, Timing.from_config(config), run.setup.spad)
    ]
    for streams in STREAMS:
        if lossless or streams > config.sensor.subgroups:
            break
        frame = run.but(config=evolve(config, sensor=evolve(config.sensor, streams=streams))).frame()
        lossless = not (frame["dropped"] or frame["mg_dropped"])
        measured.append({name: frame[measure] or 0 for name, measure in MEASURED.items()} | {"lost_streams": streams})
    beats = payload_beats(config, *expected).sum()  # counters leave after the last period
    common: dict[str, Any] = {
        "size": size,
        "klux": klux,
        "threshold": int(config.threshold[0]),
        "format": config.format,
        "records": config.frame["minigroup_records"],
        "beats_estimated": float(stream_beats(config, *expected).sum()),
        "needed_estimated": math.ceil(beats / config.frame_cycles),
        "needed_golden": measured[-1]["lost_streams"] if lossless else 0,
    }
    return [Row(**each | common | {"beats_golden": measured[0]["beats_golden"]}) for each in measured]


def write_study(out_dir: Path, rows: list[Row]) -> list[Path]:
    """Write the rows as CSV, a Markdown table of demand and losses, and a plot. Return the paths."""
    out_dir = Path(out_dir)
    write_csv(out_dir / CSV, [[field.name for field in fields(Row)], *map(astuple, rows)])
    with whole_file(out_dir / TABLE, "w") as file:
        file.write(table(rows))
    with style():
        save_figure(_plot(rows), out_dir / PLOT)
    return [out_dir / name for name in (CSV, TABLE, PLOT)]


def table(rows: list[Row]) -> str:
    """Return the demand of each size and format, and the losses of one stream, at every background and threshold."""
    titles = [title for title, _ in COLUMNS]
    lines = [f"| {' | '.join(titles)} |", "| --- | ---: | ---: | --- |" + " ---: |" * (len(titles) - 4)]
    one = {(row.size, row.klux, row.threshold, row.format, row.records): row for row in rows if row.lost_streams == 1}
    for key, row in one.items():
        if not row.records:
            cells = (str(cell(row, one[*key[:-1], True])) for _, cell in COLUMNS)
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def _streams(row: Row) -> str:
    return str(row.needed_golden or f"> {STREAMS[-1]}")


def _percent(share: float) -> str:
    return f"{share:.1%}" if share else "0"


def _plot(rows: list[Row]) -> Figure:
    """Plot the demand of one size against the background, and the losses of all sizes against the number of streams."""
    config, figure = parse_config({}), new_figure(11, 5)
    demand, loss = figure.subplots(1, 2)
    for name, colour in zip(FORMAT_NAMES, cycle(SERIES[1::3])):
        for threshold, line, mark in zip(THRESHOLDS, ("-", "--", ":"), "os^"):
            shown = (SHOWN_SIZE, name, threshold, False, 1)
            of = [row for row in rows if (row.size, row.format, row.threshold, row.records, row.lost_streams) == shown]
            klux, label = [row.klux for row in of], f"{name}, threshold {threshold}"
            demand.plot(klux, [row.beats_estimated / config.pulses for row in of], line, color=colour)
            demand.plot(klux, [row.beats_golden / config.pulses for row in of], mark, color=colour, label=label)
    demand.axhline(config.period, color="black", linewidth=1)
    demand.annotate("what one stream carries", (KLUX[0], config.period), xytext=(0, 3), textcoords="offset points")
    demand.set(
        xscale="log",
        yscale="log",
        ylim=(2, 1000),
        xlabel="background in klux",
        ylabel="beats of 64 bit a laser period",
        title=f"asked for by {SHOWN_SIZE} (lines: estimate, marks: golden model)",
    )
    for axis in (demand.xaxis, demand.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    demand.legend(loc="lower center", ncols=3, columnspacing=1)
    for size, colour in zip(SIZES, SERIES[1::3]):
        for records, line in ((False, "-o"), (True, "--s")):
            loaded = (size, "id", SHOWN_THRESHOLD, records, SHOWN_KLUX)
            of = [row for row in rows if (row.size, row.format, row.threshold, row.records, row.klux) == loaded]
            label = f"{size} and records" if records else size
            loss.plot(
                [row.lost_streams for row in of], [100 * row.lost_events for row in of], line, color=colour, label=label
            )
    loss.set_xscale("log", base=2)
    loss.set_xticks(STREAMS, labels=[str(streams) for streams in STREAMS])
    loss.set(
        xlabel="streams, a beat per cycle each",
        ylabel="committed events dropped in %",
        ylim=(-2, 100),
        title=f"lost with fewer (id, threshold {SHOWN_THRESHOLD}, {SHOWN_KLUX:g} klux)",
    )
    loss.legend(loc="upper right")
    return figure
