# SPDX-License-Identifier: Apache-2.0
"""What a page shows of runs with every pair of features (`result_pairs.py`), and digests of it.

`python -m tests.study.show.view_pairs` writes the digests again; a change that means to change what is
shown says so in CHANGELOG.md.
"""

from pathlib import Path
from typing import Any

import numpy as np

from coincid.lab.outcomes import Run
from coincid.study.explain import meaning, warnings
from coincid.study.show.figures import (
    cursor_columns,
    histogram_columns,
    histogram_title,
    light_columns,
    map_columns,
    map_scales,
    period_columns,
)
from coincid.study.show.frame_content import FrameView
from coincid.study.show.notebook import run_view
from coincid.study.show.words import number_rows, object_table, story, where_to_look

from ...digests import digest, write_digests
from ...feature_pairs import Case
from ...lab.result_pairs import CASES, setup_of

DIGESTS = Path(__file__).with_suffix(".json")
DECIMALS = 5  # of a column, whose pictures are float32
LAST_PULSE = 39  # that every frame has


def view_of(case: Case, number: int) -> FrameView:
    """Return the view of the last frame of a case."""
    run = Run(setup_of(case, number))
    return run_view(run, run.config.frames - 1)


def words(view: FrameView) -> list[Any]:
    """Return what a page says of a frame and of its configuration."""
    return [
        meaning(view.config),
        warnings(view.config),
        number_rows(view),
        object_table(view),
        where_to_look(view),
        story(view),
    ]


def columns(view: FrameView) -> list[Any]:
    """Return the columns of the figures of a frame, with the cursor on its last but one pixel."""
    sensor = view.config.sensor
    row = sensor.rows - 1
    col = sensor.cols - 2
    subgroup = view.subgroup_of(row, col)
    return [
        map_columns(view),
        map_scales([view, view]),
        cursor_columns(view, row, col),
        histogram_columns(view, row, col),
        histogram_title(view, row, col),
        light_columns(view, subgroup),
        period_columns(view, view.period(subgroup, LAST_PULSE)),
        period_columns(view, view.timeline.period(0, 0)),
    ]


def rounded(value: Any) -> Any:
    """Return columns with floats as processors agree on them."""
    if isinstance(value, dict):
        return {name: rounded(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(each) for each in value]
    if isinstance(value, np.ndarray | np.floating | float):
        return np.asarray(value).tolist() if np.asarray(value).dtype.kind != "f" else _few(value)
    return value


def _few(value: Any) -> Any:
    return np.asarray(value, np.float64).round(DECIMALS).tolist()


def digests_of(case: Case, number: int) -> dict[str, str]:
    """Return the digests of words and columns of a case."""
    view = view_of(case, number)
    return {"words": digest(words(view)), "columns": digest(rounded(columns(view)))}


if __name__ == "__main__":
    write_digests(DIGESTS, [digests_of(case, number) for number, case in enumerate(CASES)])
