# SPDX-License-Identifier: Apache-2.0
"""Soak test: many consecutive frames, golden model and RTL (sliced engine) in step, in sunlight and
at saturation.

`python -m tests.soak [--frames N] [--pulses N] [--seed N]` uses a whole array; a short form is part
of the regression.
"""

import argparse
import time
from collections.abc import Iterator

import numpy as np

from coincid.lab.setup import Setup, scene_of
from coincid.model.contract.config import Config
from coincid.model.contract.edges import Edges
from coincid.model.golden.frame import Golden
from coincid.tb.scoreboard import check
from coincid.tb.sliced import SlicedSensor

from .random_cases import configured

KLUX = 50.0
DEAD_TICKS = 128  # 8 ns: at saturation, a pixel fires again as soon as it can
LIGHTS = ("sun", "saturation")


def sunlight(config: Config, frame: int, seed: int) -> Edges:
    """Return the edges of a frame: five objects under `KLUX`."""
    scene = scene_of(config, "five-objects")
    return Setup(config=config, scene=scene, klux=KLUX, seed=seed + frame).photons.edges()


def saturation(config: Config, frame: int, seed: int) -> Edges:
    """Return the edges of a frame in which every pixel fires every 8 ns, each with a phase of its
    own.
    """
    pixels = config.sensor.array_pixels
    first = np.random.default_rng([seed, frame]).integers(0, DEAD_TICKS, pixels)
    total = config.pulses * config.period_ticks
    time_ticks = first[:, None] + DEAD_TICKS * np.arange(total // DEAD_TICKS)
    pulse, tick = np.divmod(time_ticks.ravel(), config.period_ticks)
    return Edges(pulse, np.repeat(np.arange(pixels), time_ticks.shape[1]), tick)


def soak(config: Config, light: str, frames: int, seed: int) -> Iterator[int]:
    """Play `frames` frames; yield after each the number of equal beats and commits. Raises
    `Mismatch` at the first difference.

    Back-pressure changes from frame to frame, so FIFOs overflow in some; the threshold controller
    is on.
    """
    golden, checked = Golden(config.sensor), 0
    make = {"sun": sunlight, "saturation": saturation}[light]
    with SlicedSensor(config.sensor) as sensor:
        for frame in range(frames):
            edges = make(config, frame, seed)
            rng = np.random.default_rng([seed, frame, 1])
            ready = (
                rng.random(config.pulses * config.period) < (1.0, 0.5, 0.05)[frame % 3]
            ).astype(np.uint8)
            expected = golden.frame(config, edges, ready)
            checked += check(config.sensor, expected, sensor.frame(config, edges, ready), frame)
            yield checked


def configuration(sensor: dict, pulses: int) -> Config:
    """Return a configuration with everything on that a frame can have."""
    frame = dict(
        pulses=pulses,
        format="full",
        minigroup_records=True,
        gate_every=3,
        gate_step=5,
        gate_steps=4,
    )
    return configured(
        sensor,
        frame,
        {"auto": True},
        {"subgroups": [1], "gating": True, "gate_start": 40, "gate_len": 150},
        {"subgroups": [0], "coincidence": False},
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="Soak test: golden model and RTL in step")
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--pulses", type=int, default=10, help="laser pulses of a frame")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    for light in LIGHTS:
        begin = time.monotonic()
        for frame, checked in enumerate(
            soak(configuration({}, given.pulses), light, given.frames, given.seed), 1
        ):
            if frame % 100 == 0:
                seconds = time.monotonic() - begin
                print(
                    f"{light}: {frame} frames, {checked:,} beats and commits equal, {seconds:.0f} s",
                    flush=True,
                )


if __name__ == "__main__":
    main()
