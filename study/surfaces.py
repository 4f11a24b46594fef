# SPDX-License-Identifier: Apache-2.0
"""Errors in real geometry: surfaces that slant, bend and hide each other, with every estimator, and with a bound.

`python -m coincid.study.surfaces [DEPTH,COLOUR ...]` prints a table. The scenes are analytic. A depth file (with its colour
picture after a comma) is used as it is, and at three times the distance. The bound is an oracle: it knows the shape of the
true surface around a pixel and only moves it to its likeliest place. So its remaining error is what the photons leave open.
"""

import os
import sys
from collections.abc import Iterable

import numpy as np
from attrs import frozen

from ..lab.outcomes import Run
from ..lab.setup import Setup
from ..model.contract.config import Config
from ..model.depth.arrivals import pulse_sigma_ticks
from ..model.depth.histograms import by_subgroup, frame_events
from ..model.depth.likelihood import Grid, Guess, log_likelihood, unheard
from ..model.depth.planes import LIGHTS
from ..model.depth.quality import OTHER_SURFACE_M, wrong_share
from ..model.light.light import signal_per_pulse
from ..model.scenes.catalogue import load_scene
from ..model.scenes.scene import Scene
from ..model.shared.constants import SPEED_OF_LIGHT_M_S
from ..model.shared.quantities import Numbers

ROWS = COLS = 32
KLUX, SEEDS = 50.0, (1, 2, 3)
METHODS = "matched", "planes"
FORMATS = "id", "full"
FAR_SCALE = 3.0
REFLECTIVITY = 0.4
TEXTURE_SEED, TEXTURE_PIXELS, TEXTURES = 3, 4, np.geomspace(0.06, 0.8, 8)
ORACLE_PIXELS, ORACLE_BINS = 2, 64  # to each side of a pixel; ticks around the truth


@frozen(eq=False)
class Row:
    """Shares of wrong pixels of a scene in a format: beyond 3.45 cm and beyond 15 cm, by method; dropped: share of events."""

    scene: str
    form: str
    dropped: float
    shares: dict[str, tuple[float, float]]


def analytic_scenes() -> dict[str, Scene]:
    """Return slanted planes, a roof, a box before a tilted wall, a wave, with even and patched reflectivity; five objects."""
    y, x = np.mgrid[:ROWS, :COLS] + 0.5
    x, y = x / COLS, y / ROWS
    shapes = {
        "plane, 5 to 6 m": 5 + x,
        "plane, 4 to 8 m": 4 + 4 * x,
        "plane, tilted both ways": 5 + (x + 2 * y) * 2 / 3,
        "roof": 5 + 3 * np.abs(x - 0.5),
        "tilted wall and box": np.where((np.abs(x - 0.5) < 0.16) & (np.abs(y - 0.45) < 0.19), 4.2, 5 + 2 * y),
        "wave": 6 + 0.5 * np.sin(6.4 * x) * np.cos(5.3 * y),
    }
    patches = np.random.default_rng(TEXTURE_SEED).choice(TEXTURES, (ROWS // TEXTURE_PIXELS, COLS // TEXTURE_PIXELS))
    texture = np.kron(patches, np.ones((TEXTURE_PIXELS, TEXTURE_PIXELS)))
    scenes = {name: _scene(name, distance_m, REFLECTIVITY) for name, distance_m in shapes.items()}
    for name in ("plane, 5 to 6 m", "tilted wall and box", "wave"):
        patched = f"{name}, patches"
        scenes[patched] = _scene(patched, shapes[name], texture)
    return scenes | {"five objects": load_scene("five-objects", ROWS, COLS)}


def file_scenes(sources: Iterable[str]) -> dict[str, Scene]:
    """Return each depth file as it is, and with its distances times `FAR_SCALE`."""
    scenes = {}
    for source in sources:
        near = load_scene(source, ROWS, COLS)
        far = f"{near.name}, {FAR_SCALE:g} times as far"
        scenes[near.name] = near
        scenes[far] = _scene(far, near.distance_m * FAR_SCALE, near.reflectivity)
    return scenes


def _scene(name: str, distance_m: np.ndarray, reflectivity: Numbers) -> Scene:
    return Scene(name=name, distance_m=distance_m, reflectivity=np.broadcast_to(reflectivity, distance_m.shape))


def measure(scene: Scene, form: str, seeds: Iterable[int] = SEEDS) -> Row:
    """Return the means over the seeds."""
    start = Run(
        Setup.of(scene, sensor={"rows": ROWS, "cols": COLS}, frame={"format": form}, klux=KLUX),
        workers=os.cpu_count() or 1,
    )
    shares: dict[str, list[tuple[float, float]]] = {}
    dropped, committed = 0, 0
    for seed in seeds:
        run = start.but(seed=seed)
        dropped, committed = dropped + run.result["dropped"].sum(), committed + run.result["committed"].sum()
        found = {method: run.depth(method).depth_m[:, :, 0] for method in METHODS}
        found["oracle"] = oracle_m(run.result, run.config, scene)
        for method, depth_m in found.items():
            wrong = wrong_share(depth_m, scene.truth_m), wrong_share(depth_m, scene.truth_m, OTHER_SURFACE_M)
            shares.setdefault(method, []).append(wrong)
    means = {method: tuple(np.mean(values, axis=0).tolist()) for method, values in shares.items()}
    return Row(scene.name, form, dropped / max(1, committed), means)


def oracle_m(result: dict[str, np.ndarray], config: Config, scene: Scene) -> np.ndarray:
    """float64[rows, cols]: the true surface around each pixel, moved to its likeliest place."""
    tick_m = config.tick_s * SPEED_OF_LIGHT_M_S / 2
    sigma_ticks = pulse_sigma_ticks(config)
    truth = np.nan_to_num(scene.truth_m) / tick_m
    first = np.rint(truth).astype(np.int64) - ORACLE_BINS // 2
    light = signal_per_pulse(scene.truth_m, scene.reflectivity[:, :, 0])
    guess = Guess(by_subgroup(truth, config.sensor), by_subgroup(light, config.sensor))
    grid = Grid(1, LIGHTS, np.full(len(LIGHTS), -np.log(len(LIGHTS)), np.float32))
    events = frame_events(result, config, sigma_ticks)
    level = log_likelihood(
        events,
        config,
        sigma_ticks,
        config.pulses,
        grid,
        unheard(events, config, config.pulses, sigma_ticks),
        by_subgroup(first, config.sensor),
        ORACLE_BINS,
        guess=guess,
    ).level
    level = np.where(scene.valid[:, :, None], level - level.max(axis=2, keepdims=True), 0)
    around = np.pad(level, ((ORACLE_PIXELS, ORACLE_PIXELS), (ORACLE_PIXELS, ORACLE_PIXELS), (0, 0)))
    size = 2 * ORACLE_PIXELS + 1
    total = np.sum([around[r : r + ROWS, c : c + COLS] for r in range(size) for c in range(size)], axis=0)
    chance = np.exp(total - total.max(axis=2, keepdims=True))
    chance /= chance.sum(axis=2, keepdims=True)
    moved = chance @ (np.arange(ORACLE_BINS) + 0.5 - ORACLE_BINS // 2) + np.rint(truth) - truth
    return scene.truth_m + moved * tick_m


def table(rows: Iterable[Row]) -> str:
    """Return the rows as a Markdown table: per cent beyond 3.45 cm / beyond 15 cm."""
    names = (*METHODS, "oracle")
    lines = ["| scene | format | " + " | ".join(names) + " | dropped |", "| --- | --- |" + " ---: |" * (len(names) + 1)]
    for row in rows:
        shares = " | ".join("{:.1%} / {:.1%}".format(*row.shares[name]) for name in names)
        lines.append(f"| {row.scene} | {row.form} | {shares} | {row.dropped:.0%} |")
    return "\n".join(lines) + "\n"


def main(sources: list[str]) -> None:
    scenes = analytic_scenes() | file_scenes(sources)
    print(table(measure(scene, form) for scene in scenes.values() for form in FORMATS), end="")


if __name__ == "__main__":
    main(sys.argv[1:])
