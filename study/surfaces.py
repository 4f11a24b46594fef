# SPDX-License-Identifier: Apache-2.0
"""Measures the errors on surfaces that slant, bend and hide each other.

`python -m coincid.study.surfaces` prints a table of docs/depth.md. The scenes are analytic.
"""

import os
from collections.abc import Iterable

import numpy as np
from attrs import frozen

from ..lab.outcomes import Run
from ..lab.setup import Setup
from ..model.depth.quality import OTHER_SURFACE_M, wrong_share
from ..model.scenes.catalogue import load_scene
from ..model.scenes.scene import Scene
from ..model.shared.markdown import table
from ..model.shared.quantities import Numbers

ROWS = COLS = 32
KLUX, SEEDS = 50.0, (1, 2, 3)
METHODS = "matched", "planes"
FORMATS = "id", "full"
REFLECTIVITY = 0.4
TEXTURE_SEED, TEXTURE_PIXELS, TEXTURES = 3, 4, np.geomspace(0.06, 0.8, 8)


@frozen(eq=False)
class Row:
    """Result for a scene in a format. dropped: share of the events. shares: of pixels off by over 3.45 cm and over 15 cm, by method."""

    scene: str
    form: str
    dropped: float
    shares: dict[str, tuple[float, float]]


def analytic_scenes() -> dict[str, Scene]:
    """Return slanted planes, a roof, a box before a tilted wall and a wave, some also with patches, and the five objects."""
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


def _scene(name: str, distance_m: np.ndarray, reflectivity: Numbers) -> Scene:
    return Scene(name=name, distance_m=distance_m, reflectivity=np.broadcast_to(reflectivity, distance_m.shape))


def measure(scene: Scene, form: str, seeds: Iterable[int] = SEEDS) -> Row:
    """Return the mean result over the seeds."""
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
        for method, depth_m in found.items():
            wrong = wrong_share(depth_m, scene.truth_m), wrong_share(depth_m, scene.truth_m, OTHER_SURFACE_M)
            shares.setdefault(method, []).append(wrong)
    means = {method: tuple(np.mean(values, axis=0).tolist()) for method, values in shares.items()}
    return Row(scene.name, form, dropped / max(1, committed), means)


def main() -> None:
    rows = (measure(scene, form) for scene in analytic_scenes().values() for form in FORMATS)
    cells = (
        (row.scene, row.form, *("{:.1%} / {:.1%}".format(*row.shares[name]) for name in METHODS), f"{row.dropped:.0%}")
        for row in rows
    )
    print("\n".join(table(("scene", "format", *METHODS, "dropped"), cells, left=(0, 1))))


if __name__ == "__main__":
    main()
