# SPDX-License-Identifier: Apache-2.0
"""Downloads from the explorer: the configuration, the events, the picture, the report."""

import csv
import io
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from attrs import frozen

from ...model.contract.result import EVENT_COLUMNS
from ..pictures import Panel, draw_row
from ..plot_style import figure_bytes
from .control_values import config_toml
from .stages import Explored

File: TypeAlias = tuple[str, str, bytes]  # name, media type, content


@frozen
class Save:
    """A download. label: on the page; make(explored, frame): returns the file that the browser saves."""

    label: str
    make: Callable[[Explored, int], File]


def events_csv(explored: Explored) -> str:
    """Return one line per event of all frames; hits: the ID map as hex digits, bit i = pixel i of the subgroup."""
    arrays = explored.run.result
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow([*EVENT_COLUMNS, "hits"])
    maps = [int.from_bytes(row.astype("<u8").tobytes(), "little") for row in arrays["hits"]]
    columns = [arrays[name].astype(np.int64).tolist() for name in EVENT_COLUMNS]
    lines.writerows([*row, f"{hits:x}"] for *row, hits in zip(*columns, maps))
    return text.getvalue()


def picture_png(explored: Explored, frame: int) -> bytes:
    """Return truth and depth of a frame, as `make sim` draws them."""
    view, settings = explored.view(frame), explored.settings
    heading = f"{explored.run.scene.name}, {settings.values['klux']:g} klux"
    figure, _ = draw_row([Panel(settings.values["method"], view.depth_m, view.reason)], view.truth_m, heading)
    return figure_bytes(figure, "png")


def _toml(explored: Explored, frame: int) -> File:
    return "coincid.toml", "application/toml", config_toml(explored.settings).encode()


def _events(explored: Explored, frame: int) -> File:
    return "events.csv", "text/csv", events_csv(explored).encode()


def _picture(explored: Explored, frame: int) -> File:
    return "depth.png", "image/png", picture_png(explored, frame)


SAVES = {
    "toml": Save("configuration (TOML)", _toml),
    "csv": Save("events (CSV)", _events),
    "png": Save("picture (PNG)", _picture),
}
