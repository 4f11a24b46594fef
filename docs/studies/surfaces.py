# SPDX-License-Identifier: Apache-2.0
"""Measures the errors on surfaces that slant, bend and hide each other.

`python -m docs.studies.surfaces` writes a table of docs/depth.md. The scenes are analytic.
"""

from collections.abc import Iterator

import numpy as np

from coincid.lab.campaign import Processes, grouped
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup, seeded
from coincid.model.scenes.catalogue import load_scene
from coincid.model.scenes.scene import Scene
from coincid.model.shared.markdown import text_table
from coincid.model.shared.quantities import Numbers
from coincid.tools.pages import counted, put

ROWS = COLS = 32
KLUX, SEEDS = 50.0, 3
METHODS = "matched", "planes"
FORMATS = "id", "full"
REFLECTIVITY = 0.4
TEXTURE_SEED, TEXTURE_PIXELS, TEXTURES = 3, 4, np.geomspace(0.06, 0.8, 8)


def analytic_scenes() -> dict[str, Scene]:
    """Return slanted planes, a roof, a box before a tilted wall and a wave, some also with patches,
    and the five objects.
    """
    y, x = np.mgrid[:ROWS, :COLS] + 0.5
    x, y = x / COLS, y / ROWS
    shapes = {
        "plane, 5 to 6 m": 5 + x,
        "plane, 4 to 8 m": 4 + 4 * x,
        "plane, tilted both ways": 5 + (x + 2 * y) * 2 / 3,
        "roof": 5 + 3 * np.abs(x - 0.5),
        "tilted wall and box": np.where(
            (np.abs(x - 0.5) < 0.16) & (np.abs(y - 0.45) < 0.19), 4.2, 5 + 2 * y
        ),
        "wave": 6 + 0.5 * np.sin(6.4 * x) * np.cos(5.3 * y),
    }
    patches = np.random.default_rng(TEXTURE_SEED).choice(
        TEXTURES, (ROWS // TEXTURE_PIXELS, COLS // TEXTURE_PIXELS)
    )
    texture = np.kron(patches, np.ones((TEXTURE_PIXELS, TEXTURE_PIXELS)))
    scenes = {name: _scene(name, distance_m, REFLECTIVITY) for name, distance_m in shapes.items()}
    for name in ("plane, 5 to 6 m", "tilted wall and box", "wave"):
        patched = f"{name}, patches"
        scenes[patched] = _scene(patched, shapes[name], texture)
    return scenes | {"five objects": load_scene("five-objects", ROWS, COLS)}


def _scene(name: str, distance_m: np.ndarray, reflectivity: Numbers) -> Scene:
    return Scene(
        name=name,
        distance_m=distance_m,
        reflectivity=np.broadcast_to(reflectivity, distance_m.shape),
    )


def setup(scene: Scene, form: str) -> Setup:
    """Return the setup of a scene in a format."""
    return Setup.of(
        scene,
        sensor={"rows": ROWS, "cols": COLS},
        frame={"format": form},
        klux=KLUX,
        estimators=METHODS,
    )


def look(run: Run) -> list[float]:
    """Return the dropped share of the events, then for each method the shares of pixels off by over
    3.45 cm and over 15 cm.
    """
    frames = [run.frame(estimator=method) for method in METHODS]
    shares = [frame[name] for frame in frames for name in ("wrong_share", "wrong_share_15cm")]
    return [share or 0.0 for share in (run["dropped_share"], *shares)]


def rows(run: Processes) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table: means over the seeds."""
    scenes = analytic_scenes().values()
    setups = {
        (scene.name, form): seeded(setup(scene, form), SEEDS)
        for scene in scenes
        for form in FORMATS
    }
    for key, seen in grouped(setups, look, run).items():
        dropped, *shares = np.mean(seen, axis=0)
        yield (
            *key,
            *(
                "{:.1%} / {:.1%}".format(*pair)
                for pair in zip(shares[::2], shares[1::2], strict=True)
            ),
            f"{dropped:.0%}",
        )


def make() -> None:
    """Write the table into its page."""
    with Processes(progress=counted) as run:
        put(
            "docs/depth.md",
            "surfaces",
            text_table(("scene", "format", *METHODS, "dropped"), rows(run), left=(0, 1)),
        )


if __name__ == "__main__":
    make()
