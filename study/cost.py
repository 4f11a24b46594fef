# SPDX-License-Identifier: Apache-2.0
"""Measures the cost of the paper's parameters: area, bits of an event and readout rate.

It also measures the cost of the parts that a sensor may leave out. The area is that of a
subgroup per pixel, in NanGate 45 nm standard cells, without SPADs and wires. For another process, only ratios of areas are
meaningful.
"""

from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ..flow.mapped import map_block
from ..hdl.front_end_views import POLYPHASE, VIEWS
from ..hdl.subgroup import Subgroup
from ..lab.measures import event_beats
from ..lab.outcomes import Run
from ..lab.setup import SETTLING, Setup, seeded
from ..model.contract.config import load_config, parse_config, sensor_table
from ..model.contract.packet import BEAT_BITS, FORMATS, built_formats, layout
from ..model.contract.parameters import CLOCK_MHZ, Sensor
from ..model.shared import markdown
from ..model.shared.files import write_csv
from .palette import BLUE, GREEN, INK, ORANGE, VIOLET
from .plot_style import legend_below, new_figure, save_figure, style
from .power_against_light import DARK, MIDDLE, measure
from .simulate import best_threshold

SWEEPS: dict[str, tuple[str, list[Any]]] = {  # parameter: its label, and the values besides the default
    "subgroup": ("pixels of a subgroup (bits of threshold and count)", [(4, 4), (8, 4), (8, 8), (16, 16)]),
    "minigroup": ("pixels of a minigroup", [(1, 1), (2, 2), (4, 4)]),
    "phases": ("phases of a clock cycle", [8, 16, 32, 64]),
}
CHOICES: dict[str, dict[str, Any]] = {  # parameters besides the preset `silicon`
    "`silicon`": {},
    "no coarse offsets": {"offsets": 0},
    "no minigroup records": {"records": 0},
    "no threshold controller": {"controller": 0},
    "counters of 16 bits": {"counter_bits": 16},
    "coarse counter of 8 bits": {"coarse_bits": 8},
    "FIFO of 8 events": {"fifo_depth": 8},
    "`lean`: all of them": load_config("lean").written()["sensor"],
}
SCENE, SCENE_KLUX, SCENE_GBPS, SEEDS = "sun-and-shade", 100.0, 8.0, 3
TABLE, CHOICES_TABLE, PICTURE = "cost.csv", "cost_choices.csv", "cost.png"


def area_per_pixel_um2(sensor: Sensor) -> float:
    """Return the area of a subgroup per pixel, in standard cells."""
    return map_block(Subgroup(sensor)).area_um2 / sensor.pixels


def point(sensor: Sensor) -> dict[str, float]:
    """Return the costs of a sensor: area, and for each format the bits of an event and the million events per second of a stream."""
    config = parse_config({"sensor": sensor_table(sensor)})
    cycles = {name: layout(sensor).length(packet) for name, packet in FORMATS.items()}  # the coder takes as many
    return (
        {"area_um2_per_pixel": round(area_per_pixel_um2(sensor), 1), "threshold_bits": sensor.count_bits}
        | {f"bits_{name}": round(BEAT_BITS * event_beats(config.with_frame(format=name))) for name in FORMATS}
        | {f"mevents_per_s_{name}": round(CLOCK_MHZ / n, 1) for name, n in cycles.items()}
    )


def sweep() -> list[dict[str, Any]]:
    """Return one row per point of `SWEEPS`."""
    rows = []
    for parameter, (_, values) in SWEEPS.items():
        for value in values:
            size = value[0] * value[1] if isinstance(value, tuple) else value
            rows.append({"parameter": parameter, "value": size} | point(Sensor(**{parameter: value})))
    return rows


def choices() -> list[dict[str, Any]]:
    """Return one row per choice: area and power of a subgroup, and the wrong pixels in the scene of `make sim`."""
    asynchronous, rows = VIEWS["async"].at(CLOCK_MHZ), []
    for name, parameters in CHOICES.items():
        sensor = Sensor(**parameters)
        areas = [map_block(Subgroup(sensor, view), view).area_um2 / sensor.pixels for view in (POLYPHASE, asynchronous)]
        (dark, lit), between = measure(lambda told: None, (DARK, MIDDLE), **parameters)
        rows.append(
            {
                "choice": name,
                "um2_per_pixel": round(areas[0], 1),
                "um2_per_pixel_async": round(areas[1], 1),
                "mw_dark": round(dark.total.total, 2),
                "mw_50_klux": round(lit.total.total, 2),
                "mw_between_frames": round(between.total, 2),
                "wrong_percent": round(100 * wrong_share(sensor), 2),
            }
        )
    return rows


def wrong_share(sensor: Sensor) -> float:
    """Return the share of wrong pixels in the better of the formats in groups, with the controller or else the best threshold."""
    wrong = []
    for name in set(built_formats(sensor)) & {"compact", "compact-full"}:
        frame = {"format": name, "link_gbps": SCENE_GBPS, "frames": SETTLING + 1}
        setup = Setup.of(SCENE, sensor=sensor_table(sensor), frame=frame, klux=SCENE_KLUX)
        wrong.append(np.mean([_wrong(Run(one)) for one in seeded(setup, SEEDS)]))
    return float(min(wrong))


def _wrong(run: Run) -> float:
    if run.config.sensor.controller:
        found = run.but(subgroup={"auto": True}).frame()
    else:
        found = run.alone(-1, subgroup={"threshold": best_threshold(run)}).frame()
    return found["wrong_share"] or 0.0


def write_pages(folder: Path) -> list[str]:
    """Write tables and picture to `folder`; return the lines of the table of choices."""
    rows, chosen = sweep(), choices()
    for name, table in ((TABLE, rows), (CHOICES_TABLE, chosen)):
        write_csv(folder / name, [list(table[0]), *(list(row.values()) for row in table)])
    save_figure(_draw(rows), folder / PICTURE)
    return markdown.table(list(chosen[0]), [list(row.values()) for row in chosen])


def _draw(rows: list[dict[str, Any]]) -> Figure:
    with style():
        figure = new_figure(10.5, 8.5)
        grid = figure.subplots(3, len(SWEEPS))
        for column, (parameter, (label, _)) in enumerate(SWEEPS.items()):
            points = [row for row in rows if row["parameter"] == parameter]
            at = [row["value"] for row in points]
            area, bits, rate = grid[:, column]
            area.plot(at, [row["area_um2_per_pixel"] / 1000 for row in points], "o-", color=INK)
            for name, colour in zip(FORMATS, cycle((GREEN, ORANGE, VIOLET, BLUE, INK))):
                bits.plot(at, [row[f"bits_{name}"] for row in points], "o-", color=colour, label=f"format {name}")
                rate.plot(
                    at, [row[f"mevents_per_s_{name}"] for row in points], "o-", color=colour, label=f"format {name}"
                )
            ticks = [
                f"{row['value']} ({row['threshold_bits']})" if parameter == "subgroup" else str(row["value"])
                for row in points
            ]
            for axis in (area, bits, rate):
                axis.set_xscale("log", base=2)
                axis.set_xticks(at, ticks)
                axis.margins(y=0.1)
                axis.set_ylim(0)
            rate.set_xlabel(label)
        grid[0, 0].set_ylabel("area per pixel in 1000 um2\n(NanGate 45 nm)")
        grid[1, 0].set_ylabel("bits of an event")
        grid[2, 0].set_ylabel(f"million events per s\nand stream, {CLOCK_MHZ:g} MHz")
        legend_below(figure)
    return figure
