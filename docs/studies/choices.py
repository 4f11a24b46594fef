# SPDX-License-Identifier: Apache-2.0
"""Measures the cost of the parts that a sensor may leave out: area, power, and the wrong pixels in
the scene of `make sim`.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from coincid.flow.mapped import map_block
from coincid.hdl.front_end_views import POLYPHASE, VIEWS
from coincid.hdl.subgroup import Subgroup
from coincid.lab.outcomes import Run
from coincid.lab.setup import SETTLING, Setup, seeded
from coincid.model.contract.config import load_config, sensor_table
from coincid.model.contract.packet import built_formats
from coincid.model.contract.parameters import CLOCK_MHZ, Sensor
from coincid.model.shared.files import write_csv
from coincid.model.shared.markdown import text_table
from coincid.study.schemes import best_threshold
from coincid.tools.pages import picture, put

from .power_against_light import DARK, MIDDLE, measure

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
TABLE = "docs/images/cost_choices.csv"
HEADS = "um2", "um2, asynchronous", "mW, dark", "mW, 50 klux", "mW between frames", "wrong pixels"


def choices() -> list[dict[str, Any]]:
    """Return one row per choice: area and power of a subgroup, and the wrong pixels in the scene of
    `make sim`.
    """
    asynchronous, rows = VIEWS["async"].at(CLOCK_MHZ), []
    for name, parameters in CHOICES.items():
        sensor = Sensor(**parameters)
        areas = [
            map_block(Subgroup(sensor, view), view).area_um2 / sensor.pixels
            for view in (POLYPHASE, asynchronous)
        ]
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
    """Return the share of wrong pixels in the better of the formats in groups, with the controller
    or else the best threshold.
    """
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


def text(rows: Sequence[dict[str, Any]]) -> str:
    """Return the rows of `choices` as Markdown."""
    cells = []
    for row in rows:
        name, um2, um2_async, dark, lit, between, wrong = row.values()
        cells.append(
            (
                name,
                f"{um2:.1f}",
                f"{um2_async:.1f}",
                f"{dark:.2f}",
                f"{lit:.2f}",
                f"{between:.2f}",
                f"{wrong:.2f} %",
            )
        )
    return text_table(("sensor", *HEADS), cells)


def make() -> None:
    """Write the table into its page, and as CSV beside the pictures."""
    rows = choices()
    write_csv(picture(TABLE), [list(rows[0]), *(list(row.values()) for row in rows)])
    put("docs/silicon.md", "choices", text(rows))


if __name__ == "__main__":
    make()
