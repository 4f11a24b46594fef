# SPDX-License-Identifier: Apache-2.0
"""Forms of an event word: how many beats an event takes in each, and what a link then carries.

`python -m coincid.study.compact [DEPTH,COLOUR ...]` prints the tables of `docs/compact.md`. The first one counts forms on
the events of the same frames, in the order in which they leave; the form that was built is measured. The last one changes
the length of an event by which the threshold controller reckons. Depth files are used as they are, and at three times the
distance. The candidates are our own.
"""

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from itertools import product

import numpy as np

from ..lab.measures import stream_beats
from ..lab.outcomes import Run
from ..lab.setup import SETTLING, Setup, scene_of
from ..model.contract.config import parse_config
from ..model.contract.groups import LARGE_PIXELS, groups
from ..model.contract.packet import BEAT_BITS, FORMATS
from ..model.contract.parameters import bits_for
from ..model.scenes.scene import Scene

SCENES = "five-objects", "sun-and-shade", "tunnel", "letter-f"
FAR_SCALE, SEED = 3.0, 1
KLUX, THRESHOLDS = (50.0, 100.0), (1, 2, 3)
LINK_GBPS, LINKS_GBPS = 8.0, (2.0, 4.0, 8.0, 16.0, 32.0)
COMPARED = "id", "compact", "full", "compact-full"
RECKONED = 3, 4, 6, 8  # pixels of an event by which a stream's capacity may be reckoned
MARK_BITS = 6  # of a beat that says where its first event begins
Form = Callable[["Frame"], np.ndarray]


class Frame:
    """Events of a frame in the order in which they leave: pixels, and whether their pulse is new; widths of their fields."""

    def __init__(self, run: Run) -> None:
        sensor, events = run.config.sensor, run.result
        self.pixels = events["count"]
        self.new_pulse = np.diff(events["pulse"], prepend=-1) != 0
        self.number_bits = bits_for(sensor.subgroups - 1) + bits_for(run.config.period_ticks - 1)
        self.pixel_bits, self.map_bits = sensor.winner_bits, sensor.pixels


def _one_beat(frame: Frame) -> np.ndarray:
    """One beat for up to four pixels, and the map in a second one for more."""
    return np.where(frame.pixels <= 4, 1, 2)


def _granules(frame: Frame) -> np.ndarray:
    """Half beats: one for an event with two pixels, one for five more, one for a new pulse."""
    halves = 1 + frame.new_pulse + -(-np.maximum(frame.pixels - 2, 0) // 5)
    return np.minimum(halves, 4 + frame.new_pulse) / 2


def _bits(frame: Frame) -> np.ndarray:
    """Packed to the bit, 8 bits for a new pulse; every beat says where its first event begins."""
    pixels = np.minimum(frame.pixels * frame.pixel_bits, frame.pixel_bits + frame.map_bits)
    return (frame.number_bits + 1 + 8 * frame.new_pulse + 1 + 3 + pixels) / (BEAT_BITS - MARK_BITS)


FORMS: dict[str, Form] = {
    "`id`": lambda frame: np.full(len(frame.pixels), 2),
    "one beat for up to four pixels": _one_beat,
    "half beats": _granules,
    "packed to the bit, a mark in every beat": _bits,
}


def beats_per_event(run: Run) -> float:
    """Return the measured beats of an event, without frame start, frame end and counters."""
    nothing = np.zeros(run.config.sensor.subgroups)
    fixed = stream_beats(run.config, nothing, nothing).sum()
    return float((run.frame().beats.sum() - fixed) / run.frame().counter("stored").sum())


def of_forms(run: Run) -> dict[str, float]:
    """Return the mean beats of an event in each form."""
    frame = Frame(run)
    found = {name: float(form(frame).mean()) for name, form in FORMS.items()}
    found["groups: `compact`"] = beats_per_event(run)
    found["groups with offsets: `compact-full` (`full`: 4)"] = beats_per_event(
        run.but(frame={"format": "compact-full"})
    )
    found["bits per photon in `compact`"] = found["groups: `compact`"] * BEAT_BITS / float(frame.pixels.mean())
    return found


def of_links(run: Run) -> dict[str, float]:
    """Return events and share of wrong pixels of the compared formats, in the order of the table."""
    found = {}
    for form in COMPARED:
        at = run.but(frame={"format": form})
        found[f"events, `{form}`"] = float(at.frame().counter("stored").sum())
        found[f"wrong, `{form}`"] = float(at["wrong_share"] or 0.0)
    return found


def of_capacities(run: Run) -> dict[int, float]:
    """Return the share of wrong pixels under the settled controller, by the pixels of an event in the stream's capacity."""
    led, found = run.but(frame={"frames": 1 + SETTLING}, subgroup={"auto": True}), {}
    config, form = led.config, FORMATS[led.config.format]
    bits = {pixels: groups(config.sensor).listed_bits(form, config.period_ticks, pixels) for pixels in RECKONED}
    for pixels in RECKONED:
        capacity = config.capacity * bits[LARGE_PIXELS] // bits[pixels]
        found[pixels] = float(led.but(frame={"capacity": capacity})["wrong_share"] or 0.0)
    return found


def tables(files: Sequence[str]) -> Iterator[str]:
    """Yield the lines of the tables: means over all scenes and lights."""
    config = parse_config({"frame": {"format": "compact", "link_gbps": LINK_GBPS}})
    scenes: dict[str, Scene] = {name: scene_of(config, name) for name in SCENES}
    for file in files:
        scenes |= {file: scene_of(config, file), f"{file} x {FAR_SCALE:g}": scene_of(config, file, scale=FAR_SCALE)}
    by_threshold: dict[int, list[dict[str, float]]] = {threshold: [] for threshold in THRESHOLDS}
    by_link: dict[float, list[dict[str, float]]] = {link_gbps: [] for link_gbps in LINKS_GBPS}
    by_capacity: list[dict[int, float]] = []
    for scene, klux in product(scenes.values(), KLUX):
        run = Run(Setup(config=config, scene=scene, klux=klux, seed=SEED), workers=os.cpu_count() or 1)
        for threshold, forms in by_threshold.items():
            forms.append(of_forms(run.but(subgroup={"threshold": threshold})))
        for link_gbps, links in by_link.items():
            links.append(of_links(run.but(frame={"link_gbps": link_gbps})))
        by_capacity.append(of_capacities(run))
    yield f"| form | {' | '.join(f'threshold {threshold}' for threshold in THRESHOLDS)} |"
    yield "| --- |" + " ---: |" * len(THRESHOLDS)
    for name in by_threshold[THRESHOLDS[0]][0]:
        means = [np.mean([each[name] for each in column]) for column in by_threshold.values()]
        yield f"| {name} | {' | '.join(f'{mean:.2f}' for mean in means)} |"
    yield ""
    names = list(by_link[LINKS_GBPS[0]][0])
    yield f"| link, Gbit/s | {' | '.join(names)} |"
    yield "| ---: |" + " ---: |" * len(names)
    for link_gbps, links in by_link.items():
        means = [np.mean([each[name] for each in links]) for name in names]
        shown = [f"{mean:.1%}" if name.startswith("wrong") else f"{mean:,.0f}" for name, mean in zip(names, means)]
        yield f"| {link_gbps:g} | {' | '.join(shown)} |"
    yield ""
    yield f"| pixels of an event | {' | '.join(map(str, RECKONED))} |"
    yield "| --- |" + " ---: |" * len(RECKONED)
    wrong = [np.mean([each[pixels] for each in by_capacity]) for pixels in RECKONED]
    yield f"| wrong | {' | '.join(f'{mean:.1%}' for mean in wrong)} |"


if __name__ == "__main__":
    for line in tables(sys.argv[1:]):
        print(line, flush=True)
