# SPDX-License-Identifier: Apache-2.0
"""Downloads from the explorer: the configuration, the events and the picture."""

import csv
import io
from collections.abc import Callable

import numpy as np
from attrs import frozen

from ...model.contract.counts import NO_GATE
from ...model.contract.gate_counts import GATE_BINS
from ...model.contract.pixels import pixel_table
from ...model.contract.result import EVENT_COLUMNS, map_numbers
from ..pictures import Panel, draw_row
from ..plot_style import figure_bytes
from .control_values import config_toml
from .stages import Explored


@frozen
class Save:
    """A download. label: on the page; name, media_type: of the file; content(explored, frame):
    returns its bytes.
    """

    label: str
    name: str
    media_type: str
    content: Callable[[Explored, int], bytes]


def events_csv(explored: Explored, frame: int) -> bytes:
    """Return a CSV with one line per event of all frames. hits: the ID map in hex, bit i = pixel i
    of the subgroup.
    """
    arrays = explored.run.result
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow([*EVENT_COLUMNS, "hits"])
    maps = map_numbers(arrays["hits"]).tolist()
    columns = [arrays[name].astype(np.int64).tolist() for name in EVENT_COLUMNS]
    lines.writerows([*row, f"{hits:x}"] for *row, hits in zip(*columns, maps, strict=True))
    return text.getvalue().encode()


def counts_csv(explored: Explored, frame: int) -> bytes:
    """Return a CSV with one line per gate of a pixel, of all frames. pixel: its number in the
    subgroup; gate_cycle: the first cycle of the gate, empty if there is none; hits0 and so on: in the
    order of time; count_pulses: in which the pixel counted.
    """
    arrays = explored.run.result
    minigroup = pixel_table(explored.run.config.sensor).minigroup
    gate_cycle = arrays["gate_cycle"][:, :, minigroup]
    hits = arrays["gate_hits"]
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    bins = [f"hits{one}" for one in range(GATE_BINS)]
    lines.writerow(["frame", "subgroup", "pixel", "gate", "gate_cycle", *bins, "count_pulses"])
    for place in np.ndindex(gate_cycle.shape):
        cycle = int(gate_cycle[place])
        known = "" if cycle == NO_GATE else cycle
        lines.writerow([*place, known, *hits[place].tolist(), arrays["count_pulses"][place[:3]]])
    return text.getvalue().encode()


def _output_csv(explored: Explored, frame: int) -> bytes:
    """Return what the sensor sent: events, or in the format `counts` counts."""
    write = counts_csv if explored.run.config.counting else events_csv
    return write(explored, frame)


def picture_png(explored: Explored, frame: int) -> bytes:
    """Return truth and depth of a frame, as `make sim` draws them."""
    view, settings = explored.view(frame), explored.settings
    heading = f"{explored.run.scene.name}, {settings.told_klux()}"
    figure, _ = draw_row(
        [Panel(settings.values["method"], view.depth_m, view.reason)], view.truth_m, heading
    )
    return figure_bytes(figure, "png")


SAVES = {
    "toml": Save(
        "configuration (TOML)",
        "coincid.toml",
        "application/toml",
        lambda explored, frame: config_toml(explored.settings).encode(),
    ),
    "csv": Save("events (CSV)", "events.csv", "text/csv", _output_csv),
    "png": Save("picture (PNG)", "depth.png", "image/png", picture_png),
}
