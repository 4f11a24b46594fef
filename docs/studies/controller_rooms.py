# SPDX-License-Identifier: Apache-2.0
"""The threshold controller against constant thresholds, in random rooms (docs/controller.md).

`python -m docs.studies.controller_rooms` writes the table. A pixel sees one distance, like in a
depth file: the rooms of `docs.studies.confidence` with even seeds.
"""

from typing import NamedTuple

import numpy as np

from coincid.lab.setup import SETTLING, Setup
from coincid.model.depth.methods import DEFAULT_METHOD
from coincid.model.shared.markdown import text_table
from coincid.tools.pages import put

from .confidence import SIDE, random_setup
from .kept_measures import kept_measures

ROOMS = range(202, 218, 2)
KLUX = (10.0, 50.0, 100.0)
PULSES = (100, 1000)
LINK_GBPS = 8.0
CONSTANTS = (1, 2, 3, 4, 5)
CONTROLLED = 0  # stands for the controller where others have a threshold
MEASURE = "wrong_share"
FAR_BEHIND = 0.005


class Case(NamedTuple):
    """A frame of a room."""

    room: int
    klux: float
    pulses: int
    threshold: int

    @property
    def key(self) -> str:
        return "_".join(map(str, self))

    def setup(self) -> Setup:
        """Return what is simulated: the photons do not depend on the threshold."""
        auto = self.threshold == CONTROLLED
        return Setup.of(
            random_setup(self.room).scene,
            sensor={"rows": SIDE, "cols": SIDE},
            frame={"frames": SETTLING + 1, "pulses": self.pulses, "link_gbps": LINK_GBPS},
            subgroup={"auto": auto, "threshold": max(CONSTANTS[0], self.threshold)},
            klux=self.klux,
            seed=self.room,
            estimators=(DEFAULT_METHOD,),
        )


def shares() -> dict[Case, float]:
    """Return the share of wrong pixels in the last frame of each case."""
    cases = [
        Case(room, klux, pulses, threshold)
        for pulses in PULSES
        for room in ROOMS
        for klux in KLUX
        for threshold in (CONTROLLED, *CONSTANTS)
    ]
    setups = {case.key: case.setup() for case in cases}
    found = kept_measures("controller-rooms", setups, (MEASURE,))
    return {case: float(found[case.key][MEASURE]) for case in cases}


def make() -> None:
    """Write the table of docs/controller.md."""
    found = shares()
    lines = [_line(pulses, found) for pulses in PULSES]
    head = (
        "laser pulses",
        "best of each room",
        "controller",
        "one constant for all",
        "behind the best, at most",
        f"behind by more than {100 * FAR_BEHIND:g} points",
    )
    put("docs/controller.md", "rooms", text_table(head, lines, left=(4,)))


def _line(pulses: int, found: dict[Case, float]) -> tuple[str, ...]:
    """Return the cells of a number of pulses."""
    scenes = [(room, klux) for room in ROOMS for klux in KLUX]

    def share(scene: tuple[int, float], threshold: int) -> float:
        return found[Case(*scene, pulses, threshold)]

    best = np.array([min(share(scene, one) for one in CONSTANTS) for scene in scenes])
    controlled = np.array([share(scene, CONTROLLED) for scene in scenes])
    by_constant = {one: np.mean([share(scene, one) for scene in scenes]) for one in CONSTANTS}
    constant = min(by_constant, key=lambda one: by_constant[one])
    behind = controlled - best
    worst = int(behind.argmax())
    room, klux = scenes[worst]
    return (
        f"{pulses:,}",
        f"{best.mean():.1%}",
        f"{controlled.mean():.1%}",
        f"{by_constant[constant]:.1%} (threshold {constant})",
        f"{100 * behind[worst]:.1f} points (room {room}, {klux:g} klux: {best[worst]:.1%})",
        f"{np.sum(behind > FAR_BEHIND)} of {len(scenes)}",
    )


if __name__ == "__main__":
    make()
