# SPDX-License-Identifier: Apache-2.0
"""The controller compared with constant thresholds.

`python -m coincid.study.constant_thresholds [DEPTH,COLOUR ...]` prints the table of `docs/controller.md`. In each scene and light,
all thresholds from 1 to 7 see the same photons as the controller after the frames in which it settles. The best of the
seven, chosen in hindsight for each scene, is the best that a constant can reach; the best one for all scenes is what a
user can program.
"""

import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..lab.outcomes import Run
from ..lab.setup import SETTLING, Setup, fixed_thresholds
from ..model.contract.parameters import Sensor
from ..model.scenes.ambient import Ambient
from .markdown import table

METHODS = {"planes": "planes", "maximum": "peaks"}  # estimator: its name in the table
SCENES: tuple[tuple[str, Ambient], ...] = (
    ("five-objects", 20.0),
    ("five-objects", 50.0),
    ("five-objects", 100.0),
    ("five-objects", "2|100"),
    ("letter-f", 50.0),
    ("flat:7", "10|100"),
    ("sun-and-shade", 60.0),
    ("sun-and-shade", 100.0),
    ("tunnel", 100.0),
)
FILE_KLUX: tuple[Ambient, ...] = (50.0, "5|100")  # light for depth files
THRESHOLDS = fixed_thresholds(Sensor())
SEED = 1
HEAD = (
    "pixels",
    "link, Gbit/s",
    "estimator",
    "best of each scene",
    "controller",
    "one constant for all",
    "controller behind the best, at most",
)


class Stream(NamedTuple):
    """A sensor and the rate of its stream's link: pixels per side, and Gbit/s."""

    pixels: int
    link_gbps: float


STREAMS = Stream(32, 32), Stream(32, 8), Stream(64, 32)


class Shares(NamedTuple):
    """Shares of wrong pixels in a scene, by the paper's criterion. fixed: float64[7], for the thresholds from 1 on."""

    fixed: np.ndarray
    controller: float


def shares(source: str, klux: Ambient, stream: Stream) -> dict[str, Shares]:
    """Return the shares by estimator of `METHODS`."""
    setup = Setup.of(
        source,
        sensor={"rows": stream.pixels, "cols": stream.pixels, "streams": 1},
        frame={"link_gbps": stream.link_gbps, "frames": SETTLING + 1},
        subgroup={"auto": True},
        klux=klux,
        seed=SEED,
    )
    run = Run(setup, workers=os.cpu_count() or 1)
    fixed = [run.alone(-1, subgroup={"auto": False, "threshold": threshold}) for threshold in THRESHOLDS]

    def wrong(method: str) -> Shares:
        *constant, controller = (one.frame(estimator=method)["wrong_share"] for one in (*fixed, run))
        return Shares(np.array(constant), controller or 0.0)

    return {method: wrong(method) for method in METHODS}


def rows(
    scenes: Sequence[tuple[str, Ambient]] = SCENES, streams: Sequence[Stream] = STREAMS
) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table: means over the scenes by stream and estimator, and the controller's worst scene."""
    for stream in streams:
        found = [shares(*scene, stream) for scene in scenes]
        for method, name in METHODS.items():
            fixed = np.array([one[method].fixed for one in found])
            controller = np.array([one[method].controller for one in found])
            constant = fixed.mean(axis=0)
            behind = 100 * (controller - fixed.min(axis=1))
            source, klux = scenes[int(behind.argmax())]
            yield (
                f"{stream.pixels} x {stream.pixels}",
                f"{stream.link_gbps:g}",
                name,
                f"{fixed.min(axis=1).mean():.1%}",
                f"{controller.mean():.1%}",
                f"{constant.min():.1%} (threshold {THRESHOLDS[int(constant.argmin())]})",
                f"{behind.max():.1f} points ({Path(source).name}, {_klux(klux)})",
            )


def _klux(klux: Ambient) -> str:
    return f"{klux if isinstance(klux, str) else format(klux, 'g')} klux".replace("|", " and ")


if __name__ == "__main__":
    files = [(source, klux) for source in sys.argv[1:] for klux in FILE_KLUX]
    print("\n".join(table(HEAD, rows((*SCENES, *files)), left=(0, 2, 6))))
