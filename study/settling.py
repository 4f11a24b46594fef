# SPDX-License-Identifier: Apache-2.0
"""Settling of the threshold controller, and its movement afterwards.

`python -m coincid.study.settling` prints the tables of `docs/controller.md`. Constant light has two meanings. The same
photons in every frame show the rule by itself: it has settled when thresholds, budget and limit return to earlier values,
and the sequence in between is its limit cycle. New photons in every frame show the effect of chance. The second table is
about a change from each light to each other one, with the same photons before it and after it.
"""

from collections.abc import Iterator
from itertools import permutations
from typing import NamedTuple

import numpy as np

from ..lab.outcomes import Run
from ..lab.setup import SETTLING, Setup
from ..model.contract.config import Config
from ..model.contract.edges import Edges
from ..model.golden.frame import Golden, Trace
from ..model.golden.shape import COUNTER
from ..model.shared.markdown import table

SCENE, PARTS, SEED = "five-objects", (1, 4, 16), 1
KLUX = ((5.0, 5.0), (20.0, 20.0), (50.0, 50.0), (100.0, 100.0), (5.0, 100.0))  # in the left half, and in the right one
FRAMES_MAX = 200  # with the same photons
WATCHED = 32  # frames of new photons after that
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


class State(NamedTuple):
    """State after a frame. thresholds: int64[subgroups], of the frame; next: what the next ones depend on; load: commits over capacity."""

    thresholds: np.ndarray
    next: tuple[int, int]
    load: float


class Cycle(NamedTuple):
    """Limit cycle with the same photons: the number of frames before it, its length, and what moves in it."""

    begins: int
    frames: int
    subgroups: int
    load: float


def limit_cycle(config: Config, edges: Edges, golden: Golden) -> Cycle | None:
    """Return the limit cycle for the same photons in every frame; None: no state returned within `FRAMES_MAX` frames."""
    seen: dict[tuple[int, ...], int] = {}
    history: list[State] = []
    for number in range(FRAMES_MAX):
        now = _state(config, golden.frame(config, edges), golden)
        key = (*now.thresholds.tolist(), *now.next)
        if key in seen:
            thresholds = np.array([one.thresholds for one in history[seen[key] :]])
            return Cycle(seen[key], number - seen[key], int(np.ptp(thresholds, axis=0).astype(bool).sum()), now.load)
        seen[key] = number
        history.append(now)
    return None


def _state(config: Config, trace: Trace, golden: Golden) -> State:
    """Return the state of the controller after a frame; one stream."""
    controller = golden.controller
    assert controller.budget is not None and controller.limit is not None
    committed = int(trace.counters[:, COUNTER.committed].sum())
    after = int(controller.budget[0]), int(controller.limit[0])
    return State(trace.counters[:, COUNTER.threshold_used], after, committed / config.capacity)


def rows(backgrounds: tuple[tuple[float, float], ...] = KLUX) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the first table: one for each background and capacity, as a part of one beat per cycle."""
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
    """Yield the rows of the second table: one for each capacity, with the frames that a change of the light takes to settle."""
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
