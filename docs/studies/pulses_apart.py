# SPDX-License-Identifier: Apache-2.0
"""Asks how many laser pulses a frame should have, and which threshold, if the laser's mean power and
the frames per second are fixed.

`python -m docs.studies.pulses_apart` writes the tables of docs/gap.md.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from attrs import evolve

from coincid.lab.pace import gap_for, pulse_energy_j
from coincid.lab.setup import Setup
from coincid.model.light.link_budget import Laser
from coincid.model.scenes.scene import scene_light
from coincid.model.shared.markdown import text_table
from coincid.tools.pages import put

from .confidence import SIDE, scene_in_perspective
from .kept_measures import kept_measures

PAGE = "docs/gap.md"
RATE_PER_S = 30.0
PULSES = (100, 300, 1_000, 3_000, 10_000)
ROOMS = (40, 41)
LARGER = 3.0  # than a room for people
KLUX = (10.0, 100.0)
THRESHOLDS = (1, 2, 3)
LARGE = (256, 128)  # rows and columns of the sensor whose link is asked for
LARGE_GBPS = 8.0
AREAS = LARGE[0] * LARGE[1] // SIDE**2  # simulated sensors in the large one
NO_LIMIT_GBPS = 0.0
MEASURES = ("wrong_share", "mean_gbps", "dropped_share")
_LASER = Laser()
PRESET_J = _LASER.average_power_w / _LASER.repetition_hz  # pulses of `scene_light`


class Case(NamedTuple):
    """A frame of a room."""

    room: int
    klux: float
    pulses: int
    apart: bool  # or back to back
    link_gbps: float
    threshold: int

    @property
    def key(self) -> str:
        return "_".join(f"{part:g}" for part in self)

    def setup(self) -> Setup:
        """Return what is simulated. The pulses of a frame have the energy of all its time, also
        where they are back to back.
        """
        scene = scene_in_perspective(self.room, LARGER)
        setup = Setup.of(
            scene,
            sensor={"rows": SIDE, "cols": SIDE},
            frame={"pulses": self.pulses, "link_gbps": self.link_gbps, "format": "compact"},
            subgroup={"threshold": self.threshold},
            seed=self.room,
        )
        apart = setup.config.with_frame(gap=gap_for(setup.config, RATE_PER_S))
        light = scene_light(scene, self.klux)
        signal_per_pulse = light.signal_per_pulse * pulse_energy_j(apart) / PRESET_J
        return setup.but(
            config=apart if self.apart else setup.config,
            light=evolve(light, signal_per_pulse=signal_per_pulse),
        )


Measured: TypeAlias = dict[Case, dict[str, Any]]  # measures by name, of each case


def cases(apart: bool, link_gbps: float) -> list[Case]:
    """Return all cases with pulses apart, or back to back, and one link."""
    return [
        Case(room, klux, pulses, apart, link_gbps, threshold)
        for klux in KLUX
        for pulses in PULSES
        for room in ROOMS
        for threshold in THRESHOLDS
    ]


def measured(asked: Sequence[Case]) -> Measured:
    """Return the measures of each case."""
    setups = {case.key: case.setup() for case in asked}
    found = kept_measures("pulses-apart", setups, MEASURES)
    return {case: found[case.key] for case in asked}


def make() -> None:
    """Write the tables into the page."""
    without_limit = measured(cases(apart=True, link_gbps=NO_LIMIT_GBPS))
    put(PAGE, "pulses", pulses_table(without_limit))
    link_gbps = LARGE_GBPS / AREAS
    back_to_back = measured(cases(apart=False, link_gbps=link_gbps))
    apart = measured(cases(apart=True, link_gbps=link_gbps))
    put(PAGE, "link", link_table(back_to_back, apart))


def pulses_table(found: Measured) -> str:
    """Return the table of a link without limit."""
    rows = [
        (
            f"{klux:g} klux",
            f"{pulses:,}",
            f"{1e9 * _energy_j(found, pulses):,.0f} nJ",
            _by_threshold(found, klux, pulses, "wrong_share", "{:.1%}"),
            _by_threshold(found, klux, pulses, "dropped_share", "{:.0%}"),
            _by_threshold(found, klux, pulses, "mean_gbps", "{:.1f}", AREAS),
        )
        for klux in KLUX
        for pulses in PULSES
    ]
    thresholds = " / ".join(map(str, THRESHOLDS))
    head = (
        "light",
        "pulses",
        "energy of one",
        f"wrong at {thresholds}",
        f"dropped at {thresholds}",
        f"Gbit/s for {LARGE[0]} x {LARGE[1]} at {thresholds}",
    )
    return text_table(head, rows)


def link_table(back_to_back: Measured, apart: Measured) -> str:
    """Return the table of a link with a limit."""
    rows = [
        (
            f"{klux:g} klux",
            f"{pulses:,}",
            _by_threshold(back_to_back, klux, pulses, "wrong_share", "{:.1%}"),
            _by_threshold(apart, klux, pulses, "wrong_share", "{:.1%}"),
        )
        for klux in KLUX
        for pulses in PULSES
    ]
    thresholds = " / ".join(map(str, THRESHOLDS))
    head = (
        "light",
        "pulses",
        f"back to back: wrong at {thresholds}",
        f"apart: wrong at {thresholds}",
    )
    return text_table(head, rows)


def _energy_j(found: Measured, pulses: int) -> float:
    """Return the energy of each of so many pulses of a frame."""
    case = next(case for case in found if case.pulses == pulses)
    return pulse_energy_j(case.setup().config)


def _by_threshold(
    found: Measured, klux: float, pulses: int, measure: str, form: str, factor: float = 1.0
) -> str:
    """Return the mean of a measure over the rooms, for each threshold."""
    means = []
    for threshold in THRESHOLDS:
        values = [
            measures[measure]
            for case, measures in found.items()
            if (case.klux, case.pulses, case.threshold) == (klux, pulses, threshold)
        ]
        means.append(form.format(factor * float(np.mean(values))))
    return " / ".join(means)


if __name__ == "__main__":
    make()
