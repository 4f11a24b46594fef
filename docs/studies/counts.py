# SPDX-License-Identifier: Apache-2.0
"""Compares the format `counts` with raw events and with rivals on the same photons, and says which
part of its rule costs what (`counting.py`), and what leaves a large array.

`python -m docs.studies.counts` writes the tables of docs/counts.md.
"""

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from coincid.lab.campaign import Processes, campaign
from coincid.lab.measures import stream_beats
from coincid.lab.outcomes import Run
from coincid.lab.pace import frames_per_s
from coincid.lab.setup import Setup
from coincid.model.contract.config import Config
from coincid.model.contract.counts import NO_GATE as NO_CYCLE
from coincid.model.contract.counts import pause_cycles
from coincid.model.contract.packet import BEAT_BITS
from coincid.model.contract.parameters import QUARTERS
from coincid.model.contract.pixels import pixel_table
from coincid.model.depth.histograms import by_subgroup
from coincid.model.depth.quality import OTHER_SURFACE_M, wrong_share
from coincid.model.scenes.catalogue import load_scene
from coincid.model.scenes.scene import Scene
from coincid.model.shared.markdown import text_table
from coincid.tools.pages import counted, put

from .comparison import schemes
from .confidence import scene_in_perspective
from .count_depth import surfaces_of
from .count_kernels import NO_GATE
from .counting import Beside, Rule, count, find_gates, hits_of, memory_bits

PAGE = "docs/counts.md"
SIDE = 32  # rows and columns
EVENT_WINDOW_TICKS = 16  # of the events beside the counts
RULE = Rule()
ARRAY = (128, 256)  # rows and columns
ARRAY_FRAMES_PER_S = 30
ARRAY_PULSES = (1_000, 10_000)
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


ARRAY_CASE = Case("room 41", 50, 1000)
ARRAY_EVENTS: dict[str, dict[str, Any]] = {
    "threshold 1, format id": {"frame": {"format": "id"}, "subgroup": {"threshold": 1}},
    "threshold 2, format compact": {"frame": {"format": "compact"}, "subgroup": {"threshold": 2}},
}


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


def in_counts(setup: Setup) -> Setup:
    """Return a setup in the format `counts`."""
    return setup.but(config=setup.config.with_sensor(counts=1).with_frame(format="counts"))


def built(run: Run) -> Run:
    """Return the run of the same photons in the format `counts`."""
    return Run(in_counts(run.setup), cache=run.cache)


class Found(NamedTuple):
    """What counts show."""

    depth_m: np.ndarray  # float64[rows, cols]
    outside: float  # share of the pixels whose surface is in no gate


def find_built(run: Run) -> Found:
    """Return what the sensor shows of a run's photons in the format `counts`."""
    frame = built(run).frame()
    cycle = frame.result["gate_cycle"][0].astype(np.int64)
    start = np.where(cycle == NO_CYCLE, NO_GATE, cycle * QUARTERS)
    return Found(frame.depth_m, _outside(run.scene.truth_m, start, RULE, run.config))


def find(run: Run, way: Way) -> Found:
    """Return what the counts of a run's photons show by a rule that is not built."""
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
    return config.tick_m


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
    found = find_built(run)
    return Seen(
        counts=_shares(found.depth_m, run),
        outside=found.outside,
        events=_shares(every.depth_m, run),
        event_bits=float(every["bits"] or 0),
        linked=_shares(linked.depth_m, run),
        rivals=[_shares(rivals[name].depth_m[:, :, 0], run) for name in RIVALS],
    )


def divide(run: Run) -> list[tuple[float, float]]:
    """Return the wrong shares of the rule that is built, and of all ways."""
    found = [find_built(run), *(find(run, way) for way in WAYS.values())]
    return [_shares(one.depth_m, run) for one in found]


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
    ways = {"the rule": Way(RULE)} | WAYS
    for number, (name, way) in enumerate(ways.items()):
        bits = f"{memory(way.rule):.0f}"
        yield (name, bits, *(_words(found[case][number]) for case in DIVIDED))


def budget() -> str:
    """Return the sentences about memory, bits and pauses."""
    config = in_counts(setup(CASES[0])).config
    sensor = config.sensor
    memory = memory_bits(RULE, sensor, config.pulses, config.period)
    pauses = pause_cycles(sensor.minigroups)
    periods = sum(pauses) / config.period
    return (
        f"With {config.pulses} pulses, a pixel has {memory:g} bits of memory, and"
        f" {sent_bits(config) / 1e3:.0f} kbit leave the {SIDE} x {SIDE} pixels in a frame. Its"
        f" pauses take {pauses[0]:,} and {pauses[1]:,} cycles, the time of {periods:.0f} periods."
    )


def sent_bits(config: Config, events: np.ndarray | None = None) -> float:
    """Return the bits that leave the sensor in a frame. events: number[subgroups]; None: none."""
    none = np.zeros(config.sensor.subgroups)
    return BEAT_BITS * float(stream_beats(config, none if events is None else events, none).sum())


def array_rows(run: Processes) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table of a large array.

    The events of each subgroup are the mean of those of a small array that sees the same light.
    """
    small = setup(ARRAY_CASE)
    seen = campaign({name: small.but(**way) for name, way in ARRAY_EVENTS.items()}, _events, run)
    for pulses in ARRAY_PULSES:
        for name, events in seen.items():
            config = _array_config(ARRAY_EVENTS[name]["frame"]["format"], pulses)
            of_subgroup = events * pulses / ARRAY_CASE.pulses
            yield _array_row(
                f"events, {name}", config, np.full(config.sensor.subgroups, of_subgroup)
            )
        yield _array_row("counts", _array_config("counts", pulses))


def _events(run: Run) -> float:
    """Return the events that a subgroup commits in a frame, as a mean."""
    return float(run.frame().counter("committed").mean())


def _array_config(packets: str, pulses: int) -> Config:
    """Return the configuration of the large array, without a limit of the link."""
    return Setup.of(
        None,
        sensor={"rows": ARRAY[0], "cols": ARRAY[1], "counts": int(packets == "counts")},
        frame={"pulses": pulses, "format": packets, "link_gbps": 0},
    ).config


def _array_row(name: str, config: Config, events: np.ndarray | None = None) -> tuple[str, ...]:
    """Return a row of the table: pulses, words, bits, their rate, and frames per second."""
    bits = sent_bits(config, events)
    link_frames_per_s = DEFAULT_LINK_GBPS * 1e9 / bits
    most_frames_per_s = min(frames_per_s(config), link_frames_per_s)
    return (
        f"{config.pulses:,}",
        name,
        _told(bits / 1e6),
        _told(bits * ARRAY_FRAMES_PER_S * 1e-9),
        _told(frames_per_s(config)),
        _told(most_frames_per_s),
    )


def _told(number: float) -> str:
    """Return a number with three digits at least, and not as a power of ten."""
    return f"{number:,.0f}" if number >= 100 else f"{number:,.3g}"


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
        array = (
            "pulses",
            "words",
            "Mbit per frame",
            f"Gbit/s at {ARRAY_FRAMES_PER_S} frames/s",
            "frames/s without a limit of the link",
            f"frames/s on {DEFAULT_LINK_GBPS:g} Gbit/s",
        )
        put(PAGE, "array", text_table(array, array_rows(run)))


if __name__ == "__main__":
    make()
