# SPDX-License-Identifier: Apache-2.0
"""Measures the cost of the paper's parameters: area, bits of an event and readout rate.

The area is that of a subgroup per pixel, in NanGate 45 nm standard cells, without SPADs and wires.
For another process, only ratios of areas are meaningful.
"""

from itertools import cycle
from typing import Any

from matplotlib.figure import Figure

from coincid.flow.mapped import map_block
from coincid.hdl.subgroup import Subgroup
from coincid.lab.measures import event_beats
from coincid.model.contract.config import parse_config, sensor_table
from coincid.model.contract.packet import BEAT_BITS, EVENT_FORMATS, layout
from coincid.model.contract.parameters import CLOCK_MHZ, Sensor
from coincid.model.shared.files import write_csv
from coincid.model.shared.markdown import text_table
from coincid.study.palette import BLUE, GREEN, INK, ORANGE, VIOLET
from coincid.study.plot_style import legend_below, new_figure, save_figure, style
from coincid.tools.pages import picture, put

# parameter: its label, and the values besides the default
SWEEPS: dict[str, tuple[str, list[Any]]] = {
    "subgroup": (
        "pixels of a subgroup (bits of threshold and count)",
        [(4, 4), (8, 4), (8, 8), (16, 16)],
    ),
    "minigroup": ("pixels of a minigroup", [(1, 1), (2, 2), (4, 4)]),
    "phases": ("phases of a clock cycle", [8, 16, 32, 64]),
}
PAGE, IMAGES, TABLE, PICTURE = "docs/cost.md", "docs/images", "cost.csv", "cost.png"
HEADS = "um2 per pixel", "bits of an event, `id`", "bits, `full`", "million events per s, `id`"


def area_per_pixel_um2(sensor: Sensor) -> float:
    """Return the area of a subgroup per pixel, in standard cells."""
    return map_block(Subgroup(sensor)).area_um2 / sensor.pixels


def point(sensor: Sensor) -> dict[str, float]:
    """Return the costs of a sensor: area, and for each format the bits of an event and the million
    events per second of a stream.
    """
    config = parse_config({"sensor": sensor_table(sensor)})
    # the coder takes as many
    cycles = {name: layout(sensor).length(packet) for name, packet in EVENT_FORMATS.items()}
    return (
        {
            "area_um2_per_pixel": round(area_per_pixel_um2(sensor), 1),
            "threshold_bits": sensor.count_bits,
        }
        | {
            f"bits_{name}": round(BEAT_BITS * event_beats(config.with_frame(format=name)))
            for name in EVENT_FORMATS
        }
        | {f"mevents_per_s_{name}": round(CLOCK_MHZ / n, 1) for name, n in cycles.items()}
    )


def sweep() -> list[dict[str, Any]]:
    """Return one row per point of `SWEEPS`."""
    rows = []
    for parameter, (_, values) in SWEEPS.items():
        for value in values:
            size = value[0] * value[1] if isinstance(value, tuple) else value
            rows.append(
                {"parameter": parameter, "value": size} | point(Sensor(**{parameter: value}))
            )
    return rows


def make() -> None:
    """Write picture and table into their page, and the numbers as CSV beside the picture."""
    rows = sweep()
    write_csv(picture(f"{IMAGES}/{TABLE}"), [list(rows[0]), *(list(row.values()) for row in rows)])
    save_figure(_draw(rows), picture(f"{IMAGES}/{PICTURE}"))
    put(PAGE, "picture")
    put(PAGE, "parameters", text_table(("varied", "value", *HEADS), map(_cells, rows)))


def _cells(row: dict[str, Any]) -> list[str]:
    """Return the cells of a row of `sweep`."""
    numbers = (
        f"{row['area_um2_per_pixel']:,.0f}",
        row["bits_id"],
        row["bits_full"],
        row["mevents_per_s_id"],
    )
    return [row["parameter"], row["value"], *map(str, numbers)]


def _draw(rows: list[dict[str, Any]]) -> Figure:
    with style():
        figure = new_figure(10.5, 8.5)
        grid = figure.subplots(3, len(SWEEPS))
        for column, (parameter, (label, _)) in enumerate(SWEEPS.items()):
            points = [row for row in rows if row["parameter"] == parameter]
            at = [row["value"] for row in points]
            area, bits, rate = grid[:, column]
            area.plot(at, [row["area_um2_per_pixel"] / 1000 for row in points], "o-", color=INK)
            for name, colour in zip(EVENT_FORMATS, cycle((GREEN, ORANGE, VIOLET, BLUE, INK))):
                bits.plot(
                    at,
                    [row[f"bits_{name}"] for row in points],
                    "o-",
                    color=colour,
                    label=f"format {name}",
                )
                rate.plot(
                    at,
                    [row[f"mevents_per_s_{name}"] for row in points],
                    "o-",
                    color=colour,
                    label=f"format {name}",
                )
            ticks = [
                f"{row['value']} ({row['threshold_bits']})"
                if parameter == "subgroup"
                else str(row["value"])
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


if __name__ == "__main__":
    make()
