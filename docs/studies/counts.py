# SPDX-License-Identifier: Apache-2.0
"""Compares counts in gates (`counting.py`) with raw events and with rivals on the same photons, and
says which part of the rule costs what.

`python -m docs.studies.counts` writes the tables of docs/counts.md.
"""

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from coincid.lab.campaign import Processes, campaign
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.config import Config
from coincid.model.contract.pixels import pixel_table
from coincid.model.depth.histograms import by_subgroup
from coincid.model.depth.quality import OTHER_SURFACE_M, wrong_share
from coincid.model.scenes.catalogue import load_scene
from coincid.model.scenes.scene import Scene
from coincid.model.shared.constants import SPEED_OF_LIGHT_M_S
from coincid.model.shared.markdown import text_table
from coincid.tools.pages import counted, put

from .comparison import schemes
from .confidence import scene_in_perspective
from .count_depth import surfaces_of
from .count_kernels import NO_GATE
from .counting import Beside, Rule, count, find_gates, hits_of, memory_bits, sent_bits

PAGE = "docs/counts.md"
SIDE = 32  # rows and columns
EVENT_WINDOW_TICKS = 16  # of the events beside the counts
RULE = Rule()
RIVALS = ("zoomed: 16 bins", "equi-depth: 16 bins")
DEFAULT_LINK_GBPS = 8.0
LINK_THRESHOLD = 2
END_TICKS = 16  # a surface this close to the end of an ideal gate gets another one
UNLIMITED_BITS = 30  # of a counter that is never full


class Case(NamedTuple):
    """A scene in its light. size: of a room, over its own."""

    scene: str
    klux: float
    pulses: int
    size: float = 1.0

    @property
    def name(self) -> str:
        """What a table calls it."""
        larger = f" x {self.size:g}" if self.size != 1 else ""
        return f"{self.scene}{larger}, {self.klux:g} klux, {self.pulses} pulses"


# Rooms with the seeds 20 to 46 and the built-in scenes set the rule; the others did not.
CASES = (
    Case("room 41", 50, 1000),
    Case("room 42", 50, 1000),
    Case("room 43", 100, 1000),
    Case("room 44", 10, 1000),
    Case("room 45", 50, 300),
    Case("room 46", 50, 1000, 2.0),
    Case("room 61", 50, 1000),
    Case("room 62", 100, 1000),
    Case("room 63", 10, 1000),
    Case("room 64", 50, 300),
    Case("five-objects", 100, 1000),
    Case("sun-and-shade", 100, 1000),
)
DIVIDED = (
    Case("room 41", 50, 1000),
    Case("room 44", 10, 1000),
    Case("room 46", 50, 1000, 2.0),
    Case("five-objects", 100, 1000),
)


class Way(NamedTuple):
    """A rule, and where its gates come from."""

    rule: Rule
    margin_ticks: int | None = None  # of gates from the truth (`ideal_gates`); None: found gates


ONE_STEP = RULE._replace(
    wide_steps=0,
    narrow_steps=RULE.wide_steps + RULE.narrow_steps,
    narrow_quarters=8,
    narrow_bits=4,
    peak_bins=2,
)
WAYS = {
    "the rule": Way(RULE),
    "gates from the truth, 40 ticks before it": Way(RULE, margin_ticks=40),
    "gates from the truth, 16 ticks before it": Way(RULE, margin_ticks=16),
    "gates that begin at any quarter of a cycle": Way(RULE._replace(gate_step=1)),
    "wide bins without the neighbours'": Way(RULE._replace(beside=Beside.NONE)),
    "neighbours also of other subgroups": Way(RULE._replace(beside=Beside.ALL)),
    "wide and narrow bins twice as wide": Way(RULE._replace(wide_quarters=32, narrow_quarters=4)),
    "one step to the gates, 64 ticks, 4 bits": Way(ONE_STEP),
    "one step to the gates, 32 ticks, 6 bits": Way(
        ONE_STEP._replace(narrow_quarters=4, narrow_bits=6)
    ),
    "3 bits of a counter": Way(RULE._replace(count_bits=3)),
    "counters that are never full": Way(RULE._replace(count_bits=UNLIMITED_BITS)),
}


def setup(case: Case) -> Setup:
    """Return the setup of a case: no limit of the link, threshold 1."""
    return Setup.of(
        _scene(case),
        sensor={"rows": SIDE, "cols": SIDE},
        frame={"pulses": case.pulses, "link_gbps": 0},
        subgroup={"threshold": 1},
        klux=case.klux,
        estimators=("planes",),
    )


def _scene(case: Case) -> Scene:
    kind, _, seed = case.scene.partition(" ")
    if kind != "room":
        return load_scene(case.scene, SIDE, SIDE)
    return scene_in_perspective(int(seed), case.size)


class Found(NamedTuple):
    """What counts show."""

    depth_m: np.ndarray  # float64[rows, cols]
    outside: float  # share of the pixels whose surface is in no gate


def find(run: Run, way: Way) -> Found:
    """Return what the counts of a run's photons show."""
    config = run.config
    rule = way.rule
    sensor = config.sensor
    pulses = config.pulses
    hits = hits_of(run.edges, sensor)
    if way.margin_ticks is None:
        start = find_gates(hits, sensor, rule, pulses, config.period)
    else:
        start = ideal_gates(run.scene.truth_m, rule, config, way.margin_ticks)
    counts = count(hits, start, sensor, rule, range(rule.first_pulses(pulses), pulses))
    depth_m = surfaces_of(counts, config).time[:, :, 0] * _tick_m(config)
    return Found(depth_m, _outside(run.scene.truth_m, start, rule, config))


def _outside(truth_m: np.ndarray, start: np.ndarray, rule: Rule, config: Config) -> float:
    """Return the share of the pixels whose surface is in no gate."""
    sensor = config.sensor
    quarter = by_subgroup(truth_m / _tick_m(config), sensor)[:, :, None] / sensor.quarter_ticks
    first = start[:, pixel_table(sensor).minigroup]
    inside = (first >= 0) & (quarter >= first) & (quarter < first + rule.bins)
    return float(1 - np.mean(inside.any(axis=2)))


def _tick_m(config: Config) -> float:
    return config.tick_s * SPEED_OF_LIGHT_M_S / 2


def ideal_gates(truth_m: np.ndarray, rule: Rule, config: Config, margin_ticks: int) -> np.ndarray:
    """int64[subgroups, minigroups, gates]: first quarters of gates that begin so long before the
    nearest surface of a minigroup that no earlier gate has.
    """
    sensor = config.sensor
    ticks = by_subgroup(truth_m / _tick_m(config), sensor)
    minigroup = pixel_table(sensor).minigroup
    start = np.full((sensor.subgroups, sensor.minigroups, rule.gates), NO_GATE)
    step_ticks = rule.gate_step * sensor.quarter_ticks
    for s, group in np.ndindex(start.shape[:2]):
        left = ticks[s, minigroup == group]
        least = 0
        for gate in range(rule.gates):
            left = left[left > least - END_TICKS]
            if not len(left):
                break
            first = max(least, int(left.min()) - margin_ticks)
            start[s, group, gate] = rule.gate_step * (first // step_ticks)
            least = (start[s, group, gate] + rule.bins) * sensor.quarter_ticks
    return start


class Seen(NamedTuple):
    """Wrong shares of a case, (beyond 3.4 cm, beyond 15 cm), and bits of a frame."""

    counts: tuple[float, float]
    outside: float  # of all gates
    events: tuple[float, float]  # threshold 1, no limit of the link
    event_bits: float
    linked: tuple[float, float]  # threshold 2, the default link
    rivals: list[tuple[float, float]]


def _shares(depth_m: np.ndarray, run: Run) -> tuple[float, float]:
    truth_m = run.scene.truth_m
    return wrong_share(depth_m, truth_m), wrong_share(depth_m, truth_m, OTHER_SURFACE_M)


def unlimited(setup: Setup) -> Setup:
    """Return a setup in which every window becomes an event that leaves the sensor: each subgroup
    has its own stream.
    """
    config = setup.config.with_sensor(streams=setup.config.sensor.subgroups)
    return setup.but(
        config=config,
        frame={"format": "id", "link_gbps": 0},
        subgroup={"window": EVENT_WINDOW_TICKS, "threshold": 1},
    )


def look(run: Run) -> Seen:
    """Return what counts, events and rivals make of a run's photons."""
    every = Run(unlimited(run.setup), cache=run.cache).frame(estimator="planes")
    linked = run.but(
        frame={"link_gbps": DEFAULT_LINK_GBPS}, subgroup={"threshold": LINK_THRESHOLD}
    ).frame(estimator="planes")
    rivals = schemes(run, RIVALS)
    found = find(run, Way(RULE))
    return Seen(
        counts=_shares(found.depth_m, run),
        outside=found.outside,
        events=_shares(every.depth_m, run),
        event_bits=float(every["bits"] or 0),
        linked=_shares(linked.depth_m, run),
        rivals=[_shares(rivals[name].depth_m[:, :, 0], run) for name in RIVALS],
    )


def divide(run: Run) -> list[tuple[float, float]]:
    """Return the wrong shares of all ways."""
    return [_shares(find(run, way).depth_m, run) for way in WAYS.values()]


def _words(shares: tuple[float, float]) -> str:
    return " / ".join(f"{share:.1%}" for share in shares)


def scene_rows(run: Processes) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table of scenes."""
    found = campaign({case: setup(case) for case in CASES}, look, run)
    for case, seen in found.items():
        events = f"{_words(seen.events)} ({seen.event_bits / 1e6:.0f} Mbit)"
        rivals = [_words(one) for one in seen.rivals]
        counts = _words(seen.counts)
        outside = f"{seen.outside:.1%}"
        yield (case.name, counts, outside, events, _words(seen.linked), *rivals)


def loss_rows(run: Processes) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table of ways."""
    setups = {case: setup(case) for case in DIVIDED}
    found = campaign(setups, divide, run)
    config = next(iter(setups.values())).config
    memory = partial(
        memory_bits, sensor=config.sensor, pulses=config.pulses, period_cycles=config.period
    )
    for number, (name, way) in enumerate(WAYS.items()):
        bits = f"{memory(way.rule):.0f}"
        yield (name, bits, *(_words(found[case][number]) for case in DIVIDED))


def budget() -> str:
    """Return the sentence about memory and bits."""
    config = setup(CASES[0]).config
    arguments = (RULE, config.sensor, config.pulses, config.period)
    groups = config.sensor.subgroups * config.sensor.minigroups
    frame_kbit = sent_bits(*arguments) * groups / 1e3
    return (
        f"With {config.pulses} pulses, a pixel has {memory_bits(*arguments):g} bits of memory, "
        f"and {frame_kbit:.0f} kbit leave the {SIDE} x {SIDE} pixels in a frame."
    )


def make() -> None:
    """Write the tables into the page."""
    put(PAGE, "budget", budget())
    with Processes(progress=counted) as run:
        head = (
            "scene",
            "counts",
            "in no gate",
            "events, threshold 1, no limit of the link",
            f"events, threshold {LINK_THRESHOLD}, {DEFAULT_LINK_GBPS:g} Gbit/s",
            *RIVALS,
        )
        put(PAGE, "scenes", text_table(head, scene_rows(run)))
        ways = ("what changes", "bits per pixel", *(case.name for case in DIVIDED))
        put(PAGE, "loss", text_table(ways, loss_rows(run)))


if __name__ == "__main__":
    make()
