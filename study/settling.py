# SPDX-License-Identifier: Apache-2.0
"""Settling of the threshold controller, and its movement afterwards.

`python -m coincid.study.settling` prints the table of `docs/controller.md`. Constant light has two meanings. The same
photons in every frame show the rule by itself: it has settled when thresholds and budget return to earlier values, and
the sequence in between is its limit cycle. New photons in every frame show the effect of chance.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from attrs import evolve

from ..model.contract.config import Config, parse_config
from ..model.contract.edges import Edges
from ..model.golden.frame import Golden
from ..model.golden.shape import COUNTER
from ..model.light.photons import generate_edges
from ..model.light.spad import Spad
from ..model.light.timing import Timing
from ..model.scenes.catalogue import load_scene
from ..model.scenes.scene import scene_light

SCENE, PARTS, SEED = "five-objects", (1, 4, 16), 1
KLUX = ((5.0, 5.0), (20.0, 20.0), (50.0, 50.0), (100.0, 100.0), (5.0, 100.0))  # in the left half, and in the right one
FRAMES_MAX = 200  # with the same photons
SETTLING = 8  # frames before those that are evaluated
WATCHED = 32  # frames of new photons after that


class State(NamedTuple):
    """State after a frame. thresholds: int64[subgroups], of the frame; budget: after it; load: commits over capacity."""

    thresholds: np.ndarray
    budget: int
    load: float


class Cycle(NamedTuple):
    """Limit cycle with the same photons: the number of frames before it, its length, and what moves in it."""

    begins: int
    frames: int
    subgroups: int
    load: float


def states(config: Config, frames: Iterator[Edges]) -> Iterator[State]:
    """Yield the state of the controller from reset on, over frames of edges; one stream."""
    golden = Golden(config.sensor)
    for edges in frames:
        trace = golden.frame(config, edges)
        committed = int(trace.counters[:, COUNTER.committed].sum())
        yield State(trace.counters[:, COUNTER.threshold_used], int(trace.budget[0]), committed / config.capacity)


def limit_cycle(config: Config, edges: Edges) -> Cycle | None:
    """Return the limit cycle for the same photons in every frame; None: no state returned within `FRAMES_MAX` frames."""
    seen: dict[tuple[int, ...], int] = {}
    history: list[State] = []
    for number, state in enumerate(states(config, (edges for _ in range(FRAMES_MAX)))):
        key = (*state.thresholds.tolist(), state.budget)
        if key in seen:
            thresholds = np.array([one.thresholds for one in history[seen[key] :]])
            return Cycle(seen[key], number - seen[key], int(np.ptp(thresholds, axis=0).astype(bool).sum()), state.load)
        seen[key] = number
        history.append(state)
    return None


def table(backgrounds: tuple[tuple[float, float], ...] = KLUX) -> Iterator[str]:
    """Yield the rows of a Markdown table: one for each background and capacity, as a part of one beat per cycle."""
    yield "| klux | capacity | same photons: settles after | limit cycle | load | new photons: thresholds that move per frame | range of one | load |"
    yield "| ---: | ---: | ---: | --- | ---: | ---: | ---: | ---: |"
    for klux in backgrounds:
        yield from _rows(*klux)


def _rows(left_klux: float, right_klux: float) -> Iterator[str]:
    config = parse_config({"subgroup": {"auto": True}})
    sensor, pulses = config.sensor, config.pulses
    scene = load_scene(SCENE, sensor.rows, sensor.cols)
    left, right = (scene_light(scene, klux) for klux in (left_klux, right_klux))
    is_left = np.arange(sensor.array_pixels) % sensor.cols < sensor.cols // 2
    light = evolve(left, background_cps=np.where(is_left, left.background_cps, right.background_cps))
    total = SETTLING + WATCHED
    edges = generate_edges(light, Spad(), Timing.from_config(config), pulses=pulses * total, seed=SEED)
    frames = [edges.frame(number, pulses)[0] for number in range(total)]
    for part in PARTS:
        narrow = config.with_frame(capacity=config.capacity // part)
        cycle = limit_cycle(narrow, frames[0])
        watched = list(states(narrow, iter(frames)))[SETTLING:]
        thresholds = np.array([state.thresholds for state in watched])
        moves = np.abs(np.diff(thresholds, axis=0)).astype(bool).sum(axis=1).mean()
        load = np.array([state.load for state in watched])
        spread = np.ptp(thresholds, axis=0).max()
        yield (
            f"| {_klux(left_klux, right_klux)} | {_part(part)} | {_cycle(cycle)} | {moves:.1f} of {sensor.subgroups} | {spread} | "
            f"{load.mean():.2f} ({load.min():.2f} to {load.max():.2f}) |"
        )


def _klux(left: float, right: float) -> str:
    return f"{left:g}" if left == right else f"{left:g}, {right:g}"


def _part(part: int) -> str:
    return f"1/{part}" if part > 1 else "1"


def _cycle(cycle: Cycle | None) -> str:
    if cycle is None:
        return f"not in {FRAMES_MAX} frames | |"
    moves = f"{cycle.frames} frames, {cycle.subgroups} thresholds" if cycle.frames > 1 else "none"
    return f"{cycle.begins} frames | {moves} | {cycle.load:.2f}"


if __name__ == "__main__":
    for line in table():
        print(line, flush=True)
