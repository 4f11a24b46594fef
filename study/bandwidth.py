# SPDX-License-Identifier: Apache-2.0
"""Readout bandwidth: the beats that a frame needs, the streams that carry them, and the losses with fewer streams.

The golden model counts both. The scene and the sizes are our choice; the paper leaves the readout open.
"""

import os
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from attrs import astuple, evolve, fields, frozen
from matplotlib.figure import Figure

from ..lab.outcomes import Run
from ..lab.setup import Setup
from ..model.contract.config import parse_config
from ..model.contract.packet import FORMAT_NAMES
from ..model.contract.parameters import Sensor
from ..model.light.light import background_cps
from ..model.shared.errors import check_integer
from ..model.shared.files import whole_file, write_csv
from ..model.shared.quantities import check_choice
from . import markdown
from .palette import ORANGE, SERIES
from .plot_style import new_figure, save_figure, style

SCENE, SEED = "five-objects", 1
SIZES = {"32x32": (32, 32), "64x64": (64, 64), "256x128": (128, 256)}  # rows, cols
KLUX = (1.0, 5.0, 20.0, 50.0, 100.0)
THRESHOLDS = (2, 3, 5)
STREAMS = (1, 2, 4, 8, 16, 32, 64)
CSV, TABLE, PLOT = "bandwidth.csv", "bandwidth.md", "bandwidth.png"
SHOWN_KLUX, SHOWN_THRESHOLD, SHOWN_SIZE = 50.0, 2, "32x32"
MEASURED = {  # columns: names of `MEASURES`
    "beats": "beats_asked",
    "lost_events": "dropped_share",
    "lost_records": "mg_dropped_share",
    "overruns": "overruns",
    "late_cycles": "late_cycles",
}


@frozen
class Row:
    """A frame of the study.

    beats: those of all streams if nothing were lost. needed: number of streams that lose nothing (0: not even the most). records:
    minigroup records are on. streams: of the following; losses are shares. overruns: events that carry the flag.
    late_cycles: from the last period's end to the frame's last beat.
    """

    size: str
    klux: float
    threshold: int
    format: str
    records: bool
    beats: int
    needed: int
    streams: int
    lost_events: float
    lost_records: float
    overruns: int
    late_cycles: int


COLUMNS: tuple[tuple[str, Callable[[Row, Row], object]], ...] = (  # of the table: row, row with records
    ("size", lambda row, also: row.size),
    ("klux", lambda row, also: f"{row.klux:g}"),
    ("threshold", lambda row, also: row.threshold),
    ("format", lambda row, also: row.format),
    ("beats per frame", lambda row, also: f"{row.beats:,}"),
    ("streams", lambda row, also: _streams(row)),
    ("lost with one", lambda row, also: _percent(row.lost_events)),
    ("streams with records", lambda row, also: _streams(also)),
    ("events lost with one", lambda row, also: _percent(also.lost_events)),
    ("records lost with one", lambda row, also: _percent(also.lost_records)),
)


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
    for streams in STREAMS:
        if lossless or streams > config.sensor.subgroups:
            break
        frame = run.but(config=evolve(config, sensor=evolve(config.sensor, streams=streams))).frame()
        lossless = not (frame["dropped"] or frame["mg_dropped"])
        measured.append({name: frame[measure] or 0 for name, measure in MEASURED.items()} | {"streams": streams})
    common: dict[str, Any] = {
        "size": size,
        "klux": klux,
        "threshold": int(config.threshold[0]),
        "format": config.format,
        "records": config.frame["minigroup_records"],
        "needed": measured[-1]["streams"] if lossless else 0,
    }
    return [Row(**each | common | {"beats": measured[0]["beats"]}) for each in measured]


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
    one = {(row.size, row.klux, row.threshold, row.format, row.records): row for row in rows if row.streams == 1}
    pairs = [(row, one[*key[:-1], True]) for key, row in one.items() if not row.records]
    cells = ([cell(*pair) for _, cell in COLUMNS] for pair in pairs)
    return "\n".join([*markdown.table([title for title, _ in COLUMNS], cells, left=(0, 3)), ""])


def _streams(row: Row) -> str:
    return str(row.needed or f"> {STREAMS[-1]}")


def _percent(share: float) -> str:
    return f"{share:.1%}" if share else "0"


def _plot(rows: list[Row]) -> Figure:
    """Plot the demand of one size against the background, and the losses of all sizes against the number of streams."""
    config, figure = parse_config({}), new_figure(11, 5)
    demand, loss = figure.subplots(1, 2)
    for name, colour in zip(FORMAT_NAMES, (*SERIES[::2], ORANGE)):
        for threshold, line in zip(THRESHOLDS, ("-o", "--s", ":^")):
            shown = (SHOWN_SIZE, name, threshold, False, 1)
            of = [row for row in rows if (row.size, row.format, row.threshold, row.records, row.streams) == shown]
            beats, label = [row.beats / config.pulses for row in of], f"{name}, threshold {threshold}"
            demand.plot([row.klux for row in of], beats, line, color=colour, label=label)
    demand.axhline(config.period, color="black", linewidth=1)
    demand.annotate("what one stream carries", (KLUX[0], config.period), xytext=(0, 3), textcoords="offset points")
    demand.set(
        xscale="log",
        yscale="log",
        ylim=(2, 1000),
        xlabel="background in klux",
        ylabel="beats of 64 bit a laser period",
        title=f"asked for by {SHOWN_SIZE}",
    )
    for axis in (demand.xaxis, demand.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    demand.legend(loc="lower center", ncols=3, columnspacing=1, fontsize=7.5)
    for size, colour in zip(SIZES, SERIES[1::3]):
        for records, line in ((False, "-o"), (True, "--s")):
            loaded = (size, "id", SHOWN_THRESHOLD, records, SHOWN_KLUX)
            of = [row for row in rows if (row.size, row.format, row.threshold, row.records, row.klux) == loaded]
            label = f"{size} and records" if records else size
            loss.plot(
                [row.streams for row in of], [100 * row.lost_events for row in of], line, color=colour, label=label
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
