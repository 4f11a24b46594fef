# SPDX-License-Identifier: Apache-2.0
"""Forms of an event word: how many beats an event takes in each, and what a link then carries.

`python -m coincid.study.compact [DEPTH,COLOUR ...]` prints the tables of `docs/compact.md`: means over scenes and lights.
Depth files are used as they are, and at three times the distance.
"""

import os
import sys
from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from ..lab.measures import stream_beats
from ..lab.outcomes import Run
from ..lab.setup import Setup, scene_of
from ..model.contract.config import parse_config
from ..model.contract.packet import BEAT_BITS
from .markdown import table

SCENES = "five-objects", "sun-and-shade", "tunnel", "letter-f"
FAR_SCALE, SEED = 3.0, 1
KLUX, THRESHOLDS = (50.0, 100.0), (1, 2, 3)
LINK_GBPS, LINKS_GBPS = 8.0, (2.0, 4.0, 8.0, 16.0, 32.0)
FORMS = "id", "compact", "full", "compact-full"


def beats_per_event(run: Run) -> float:
    """Return the measured beats of an event, without frame start, frame end and counters."""
    nothing = np.zeros(run.config.sensor.subgroups)
    fixed = stream_beats(run.config, nothing, nothing).sum()
    return float((run.frame().beats.sum() - fixed) / run.frame().counter("stored").sum())


def tables(files: Sequence[str]) -> Iterator[str]:
    """Yield the lines of the tables."""
    config = parse_config({"frame": {"link_gbps": LINK_GBPS}})
    scenes = {name: scene_of(config, name) for name in SCENES}
    for file in files:
        scenes |= {file: scene_of(config, file), f"{file} x {FAR_SCALE:g}": scene_of(config, file, scale=FAR_SCALE)}
    lights = list(product(scenes.values(), KLUX))
    beats, events, wrong = (np.zeros((len(lights), rows, len(FORMS))) for rows in (3, *2 * [len(LINKS_GBPS)]))
    pixels = np.zeros((len(lights), len(THRESHOLDS)))
    for at, (scene, klux) in enumerate(lights):
        run = Run(Setup(config=config, scene=scene, klux=klux, seed=SEED), workers=os.cpu_count() or 1)
        for k, threshold in enumerate(THRESHOLDS):
            of_forms = [run.but(subgroup={"threshold": threshold}, frame={"format": form}) for form in FORMS]
            beats[at, k] = [beats_per_event(one) for one in of_forms]
            pixels[at, k] = of_forms[FORMS.index("compact")].result["count"].mean()
        for k, link_gbps in enumerate(LINKS_GBPS):
            of_forms = [run.but(frame={"format": form, "link_gbps": link_gbps}) for form in FORMS]
            events[at, k] = [one["events"] for one in of_forms]
            wrong[at, k] = [one["wrong_share"] for one in of_forms]
    means = [(f"`{form}`", *column) for form, column in zip(FORMS, beats.mean(axis=0).T)]
    per_photon = (beats[:, :, FORMS.index("compact")] * BEAT_BITS / pixels).mean(axis=0)
    rows = (
        (name, *(f"{mean:.2f}" for mean in of)) for name, *of in [*means, ("bits per photon in `compact`", *per_photon)]
    )
    yield from table(["form", *(f"threshold {threshold}" for threshold in THRESHOLDS)], rows)
    yield ""
    head = ["link, Gbit/s", *(f"{what}, `{form}`" for form in FORMS for what in ("events", "wrong"))]
    shown = np.dstack([events.mean(axis=0), wrong.mean(axis=0)])
    yield from table(
        head,
        (
            (f"{link_gbps:g}", *(cell for number, share in of_link for cell in (f"{number:,.0f}", f"{share:.1%}")))
            for link_gbps, of_link in zip(LINKS_GBPS, shown)
        ),
        left=(),
    )


if __name__ == "__main__":
    for line in tables(sys.argv[1:]):
        print(line, flush=True)
