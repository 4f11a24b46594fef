# SPDX-License-Identifier: Apache-2.0
"""Measures what the reading of depth pictures does to a wall, and how large its library is.

`python -m docs.studies.brought_files` writes a table of docs/advise.md.
"""

from importlib.metadata import files
from pathlib import Path

import numpy as np

from coincid.model.depth.depth import Depth
from coincid.model.light.link_budget import Optics
from coincid.model.scenes.catalogue import load_scene
from coincid.model.scenes.scene import Scene
from coincid.model.shared.markdown import text_table
from coincid.study.point_cloud import point_cloud
from coincid.study.run import simulate
from coincid.tools.pages import put

PAGE, REGION = "docs/advise.md", "brought files"
WALL_M = 4.0
SAMPLES = (480, 640)
SIDE = 32  # of the sensor
NOISE_M = 0.01
SPECKLE_SHARE, SPECKLE_M = 0.01, 0.5
SEED = 1
PULSES = 2000
BLOCK = 8  # pixels, of the means of which a wall is flat or bent
LIBRARY = "OpenImageIO"


def make() -> None:
    """Write the table."""
    rng = np.random.default_rng(SEED)
    noisy_m = rng.normal(WALL_M, NOISE_M, SAMPLES)
    off_mm = 1000 * (_seen_m(noisy_m) - WALL_M)
    speckled_m = np.where(rng.random(SAMPLES) < SPECKLE_SHARE, SPECKLE_M, WALL_M)
    moved = np.mean(_seen_m(speckled_m) != WALL_M)
    rows = [
        (
            f"noise of {1000 * NOISE_M:.0f} mm on the samples of a wall",
            f"moves the wall by {abs(off_mm.mean()):.2f} mm, a pixel by at most {np.abs(off_mm).max():.1f} mm",
        ),
        (
            f"{SPECKLE_SHARE:.0%} of the samples at {SPECKLE_M} m before a wall at {WALL_M:.0f} m",
            f"{moved:.1%} of the pixels move",
        ),
        *_flatness(),
        (f"installation of {LIBRARY}", f"{_megabytes():.0f} MB"),
    ]
    put(PAGE, REGION, text_table(("what", "result"), rows, left=(0, 1)))


def _seen_m(samples_m: np.ndarray) -> np.ndarray:
    return load_scene(samples_m, SIDE, SIDE).truth_m


def _flatness() -> list[tuple[str, str]]:
    """Return the rows about a wall whose picture holds z."""
    wall_m = np.full(SAMPLES, WALL_M)
    run = simulate(None, wall_m, z=True, klux=0, pulses=PULSES, rows=SIDE, cols=SIDE, seed=SEED)
    truth = _z_m(Depth.of(run.scene.truth_m), run.scene)
    found = _z_m(run.depth(), run.scene)
    blocks = found.reshape(SIDE // BLOCK, BLOCK, SIDE // BLOCK, BLOCK).mean(axis=(1, 3))
    off_mm = 1000 * np.abs(found - WALL_M)
    return [
        (
            f"z of the points of a wall at z = {WALL_M:.0f} m, from the picture",
            f"off by at most {1000 * np.abs(truth - WALL_M).max():.3f} mm",
        ),
        (
            f"the same from simulated depth, {PULSES} pulses in the dark",
            f"off by {np.median(off_mm):.1f} mm in the middle pixel, {np.percentile(off_mm, 99):.0f} mm in 1 of 100;"
            f" means of {BLOCK} x {BLOCK} pixels within {1000 * np.ptp(blocks):.1f} mm of each other",
        ),
    ]


def _z_m(depth: Depth, scene: Scene) -> np.ndarray:
    """float64[rows, cols]: z of the points of depth without holes."""
    view = scene.view
    points = point_cloud(depth, Optics(fov_h_deg=view.h_deg, fov_v_deg=view.v_deg))
    z_m: np.ndarray = points["z"].astype(np.float64).reshape(depth.depth_m.shape[:2])
    return z_m


def _megabytes() -> float:
    installed = [Path(str(part.locate())) for part in files(LIBRARY) or []]
    return sum(path.stat().st_size for path in installed if path.exists()) / 1e6


if __name__ == "__main__":
    make()
