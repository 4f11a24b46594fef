# SPDX-License-Identifier: Apache-2.0
"""Measures how the threshold controller settles, and how its thresholds move afterwards.

`python -m coincid.study.settling` prints the tables of `docs/controller.md`. Constant light can mean two things. With the same
photons in every frame, only the rule acts: it has settled when thresholds, budget and limit return to earlier values, and the
frames between the two occurrences are its limit cycle. With new photons in every frame, chance acts, too. The second table is
for changes from each light to each other one; the photons are the same in all frames before a change, and in all after it.
"""

from collections.abc import Iterator
from itertools import permutations
from typing import NamedTuple

import numpy as np

from ..lab.outcomes import Run
from ..lab.setup import SETTLING, Setup
from ..model.contract.config import Config
from ..model.contract.edges import Edges
from ..model.golden.frame import Golden
from ..model.golden.shape import COUNTER
from ..model.shared.markdown import table

SCENE, PARTS, SEED = "five-objects", (1, 4, 16), 1
KLUX = ((5.0, 5.0), (20.0, 20.0), (50.0, 50.0), (100.0, 100.0), (5.0, 100.0))  # in the left and in the right half
FRAMES_MAX = 200  # frames with the same photons
WATCHED = 32  # frames with new photons after the controller has settled
HEAD = (
    "klux",
    "capacity",
    "same photons: settles after",
    "limit cycle",
    "load",
    "new photons: thresholds that move per frame",
    "range of one",
    "load",
)
CHANGES_HEAD = "capacity", "changes", "settle after, mean", "at most", "limit cycles"


class Cycle(NamedTuple):
    """Limit cycle with the same photons: frames before it, its length, the subgroups whose threshold moves, and the load."""

    begins: int
    frames: int
    subgroups: int
    load: float


def limit_cycle(config: Config, edges: Edges, golden: Golden) -> Cycle | None:
    """Return the limit cycle for the same photons in every frame; None: no state came back within `FRAMES_MAX` frames."""
    states: list[tuple[int, ...]] = []  # after each frame: budget and limit of the only stream, and the thresholds
    controller = golden.controller
    for number in range(FRAMES_MAX):
        counters = golden.frame(config, edges).counters
        assert controller.budget is not None and controller.limit is not None
        after = int(controller.budget[0]), int(controller.limit[0])
        state = (*after, *counters[:, COUNTER.threshold_used].tolist())
        if state in states:
            begins = states.index(state)
            moves = np.ptp(np.array(states[begins:])[:, len(after) :], axis=0) > 0
            load = int(counters[:, COUNTER.committed].sum()) / config.capacity
            return Cycle(begins, number - begins, int(moves.sum()), load)
        states.append(state)
    return None


def rows(backgrounds: tuple[tuple[float, float], ...] = KLUX) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the first table: one for each background and each part of the default capacity."""
    for klux in backgrounds:
        start = _run(*klux, frames=SETTLING + WATCHED)
        for part in PARTS:
            narrow = start.but(frame={"capacity": start.config.capacity // part})
            watched = [narrow.frame(number) for number in range(SETTLING, SETTLING + WATCHED)]
            thresholds = np.array([one.threshold for one in watched])
            moves = np.abs(np.diff(thresholds, axis=0)).astype(bool).sum(axis=1).mean()
            load = np.array([one["capacity_share"] for one in watched])
            yield (
                ", ".join(f"{level:g}" for level in dict.fromkeys(klux)),
                _part(part),
                *_cycle(limit_cycle(narrow.config, narrow.frame_edges(0), Golden(narrow.config.sensor))),
                f"{moves:.1f} of {narrow.config.sensor.subgroups}",
                str(np.ptp(thresholds, axis=0).max()),
                f"{load.mean():.2f} ({load.min():.2f} to {load.max():.2f})",
            )


def changes(backgrounds: tuple[tuple[float, float], ...] = KLUX) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the second table: for each capacity, the frames that the controller takes to settle after a change."""
    lights = [_run(*klux, frames=1) for klux in backgrounds]
    for part in PARTS:
        cycles = [_after_change(before, after, part) for before, after in permutations(lights, 2)]
        settled = [cycle.begins for cycle in cycles if cycle is not None and cycle.frames == 1]
        mean, most = f"{np.mean(settled):.1f} frames", f"{max(settled)} frames"
        yield _part(part), str(len(cycles)), mean, most, str(len(cycles) - len(settled))


def _after_change(before: Run, after: Run, part: int) -> Cycle | None:
    config = before.config.with_frame(capacity=before.config.capacity // part)
    golden = Golden(config.sensor)
    limit_cycle(config, before.frame_edges(0), golden)
    return limit_cycle(config, after.frame_edges(0), golden)


def _run(left_klux: float, right_klux: float, frames: int) -> Run:
    klux = f"{left_klux:g}|{right_klux:g}"
    return Run(Setup.of(SCENE, frame={"frames": frames}, subgroup={"auto": True}, klux=klux, seed=SEED))


def _part(part: int) -> str:
    return f"1/{part}" if part > 1 else "1"


def _cycle(cycle: Cycle | None) -> tuple[str, str, str]:
    if cycle is None:
        return f"not in {FRAMES_MAX} frames", "", ""
    moves = f"{cycle.frames} frames, {cycle.subgroups} thresholds" if cycle.frames > 1 else "none"
    return f"{cycle.begins} frames", moves, f"{cycle.load:.2f}"


if __name__ == "__main__":
    print("\n".join([*table(HEAD, rows(), left=(3,)), "", *table(CHANGES_HEAD, changes(), left=())]))
