# SPDX-License-Identifier: Apache-2.0
"""Sets the law of confidence (`model/depth/belief.py`) for the format `counts`, and tries it on
other scenes.

`python -m docs.studies.count_confidence` prints the weights of the law, and writes a table for
scenes that were not used to set them into docs/counts.md. The scenes and settings are those of
`confidence.py`, as far as they do not need ray tracing, with more pulses.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from coincid.lab.campaign import Processes, campaign
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.depth.arrivals import SYSTEM_FWHM_S
from coincid.model.depth.belief import LAW, chance_of_right
from coincid.model.depth.estimate import find_returns
from coincid.model.depth.methods import DEFAULT_METHOD
from coincid.model.depth.quality import off_surfaces, wrong_pixels
from coincid.model.shared.markdown import text_table
from coincid.model.shared.threads import Threads
from coincid.tools.pages import counted, put

from .confidence import (
    NINETY,
    PIXELS_MIN,
    SEEN_SEEDS,
    SET,
    TRIED,
    Seen,
    law,
    perspective_setup,
    random_setup,
    truth_m,
)

METHOD = "counts"  # name of the law
SEEN = "seen"  # beside the features of the law: probability that gates have the light
PULSES = (200, 400, 1000)
TRIED_SEEDS = range(26, 32)  # of rooms in perspective


def in_counts(setup: Setup, pulses: int) -> Setup:
    """Return a setup in the format `counts`, with so many pulses."""
    config = setup.config.with_sensor(counts=1).with_frame(
        format="counts", pulses=pulses, frames=1, link_gbps=0
    )
    return setup.but(config=config)


def setups_of(seeds: range) -> dict[int, Setup]:
    """Return random scenes, by their seed."""
    return {seed: in_counts(random_setup(seed), PULSES[seed // 2 % len(PULSES)]) for seed in seeds}


def rooms_of(seeds: range) -> dict[tuple[int, int], Setup]:
    """Return rooms in perspective at two sizes and in two lights, by seed and number of pulses."""
    rooms = {}
    for seed in seeds:
        for number, pulses in enumerate(PULSES):
            rooms[seed, pulses] = in_counts(perspective_setup(seed, 1 + number, pulses), pulses)
    return rooms


def look(run: Run) -> Seen:
    """Return the pixels of the frame as the law sees them."""
    right_m = truth_m(run.scene)
    config = run.config
    with Threads(1) as alone:
        found = find_returns(
            run.result,
            config,
            DEFAULT_METHOD,
            "map",
            0,
            returns=1,
            threads=alone,
            system_fwhm_s=SYSTEM_FWHM_S,
        )
        signs = found.signs(config, alone)
    known = signs.known & ~np.isnan(right_m)
    depth_m = found.ticks[:, :, 0] * config.tick_m
    return Seen(
        features={METHOD: signs.features[known], SEEN: signs.seen[known]},
        right={METHOD: ~wrong_pixels(depth_m, right_m)[known]},
        on_surface={METHOD: ~off_surfaces(depth_m, run.scene.surfaces_m)[known]},
    )


def rows(seen: Mapping[str, Sequence[Seen]]) -> Iterator[Sequence[str]]:
    """Yield the rows of the table: pixels that are right, and of those with a confidence of 90 %
    and of more.
    """
    for name, runs in seen.items():
        features = np.concatenate([one.features[METHOD] for one in runs])
        right = np.concatenate([one.right[METHOD] for one in runs])
        seen_there = np.concatenate([one.features[SEEN] for one in runs])
        sure = seen_there * chance_of_right(features, LAW[METHOD])
        cells = [f"{right.mean():.0%} of {len(right)}"]
        for chosen in ((sure >= NINETY[0]) & (sure < NINETY[1]), sure >= NINETY[1]):
            own = right[chosen]
            enough = len(own) >= PIXELS_MIN
            cells.append(f"{own.mean():.0%} of {len(own)}" if enough else f"({len(own)} pixels)")
        yield name, *cells


def make() -> None:
    """Print the law, and write the table."""
    with Processes(progress=counted) as run:
        looked = list(campaign(setups_of(SET), look, run).values())
        looked += list(campaign(rooms_of(SEEN_SEEDS), look, run).values())
        random = campaign(setups_of(TRIED), look, run)
        rooms = list(campaign(rooms_of(TRIED_SEEDS), look, run).values())
    print(f'    "{METHOD}": ({", ".join(f"{weight:.3g}" for weight in law(looked, METHOD))}),')
    unseen = {
        "random, one distance per pixel": [one for seed, one in random.items() if seed % 2 == 0],
        "random, mixed": [one for seed, one in random.items() if seed % 2],
        "rooms in perspective": rooms,
    }
    head = ("scenes", "right, of all", "right, of those with about 90 %", "of those with more")
    put("docs/counts.md", "confidence of counts", text_table(head, rows(unseen)))


if __name__ == "__main__":
    make()
