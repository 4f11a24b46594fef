# SPDX-License-Identifier: Apache-2.0
"""Draws ray-NAME.png for each ray-traced scene: the truth, and the depth from the RTL. Needs
`make raytrace`.

python -m docs.studies.drawings.raytrace
"""

import tempfile
from pathlib import Path

import numpy as np

from coincid.lab.outcomes import Run
from coincid.lab.setup import SETTLING, Setup, scene_of
from coincid.model.contract.config import load_config
from coincid.model.depth.quality import wrong_share
from coincid.model.scenes.ray_scene import BUILT_IN, PREFIX
from coincid.model.shared.constants import SPEED_OF_LIGHT_M_S
from coincid.model.shared.markdown import text_table
from coincid.study.pictures import Panel, depth_row
from coincid.study.schemes import SCHEMES
from coincid.study.simulate import GoldenRuns, play_runs
from coincid.tools.pages import picture, put

KLUX, PULSES, SEED = 50, 400, 1
TITLES = "coincidence off", "threshold 2", "threshold per subgroup"  # of the schemes
# surfaces within one coincidence window of 1 ns cannot be told apart
WINDOW_M = 1e-9 * SPEED_OF_LIGHT_M_S / 2


def draw(name: str) -> list[tuple[float, float]]:
    """Write the picture; return for each scheme the share wrong by over a window, and by the
    paper's criterion.
    """
    config = load_config(None).with_pulses(PULSES).with_frame(frames=SETTLING + 1)
    scene = scene_of(config, PREFIX + name)
    run = Run(Setup(config=config, scene=scene, klux=KLUX, seed=SEED))
    with tempfile.TemporaryDirectory() as folder:
        golden = GoldenRuns.of(run, config.threshold)
        frames = play_runs(golden, "sliced", Path(folder)).frames
    depths = [frame.depth_m for frame in frames.values()]
    panels = [
        Panel(title.format(threshold=np.unique(config.threshold)[0]), depth)
        for (title, _), depth in zip(SCHEMES.values(), depths, strict=True)
    ]
    path = picture(f"docs/images/ray-{name}.png")
    shares = depth_row(
        path,
        panels,
        scene.truth_m,
        f"{scene.name}, {KLUX} klux, {PULSES} laser pulses",
        tolerance_m=WINDOW_M,
    )
    return [
        (share, wrong_share(depth, scene.truth_m))
        for share, depth in zip(shares, depths, strict=True)
    ]


def make() -> None:
    """Draw the pictures for their page, and write the table of the shares of wrong pixels."""
    rows = []
    for name in BUILT_IN:
        rows.append(
            (name, *(f"{100 * coarse:.1f} % ({100 * fine:.1f})" for coarse, fine in draw(name)))
        )
        print(f"  {name}", flush=True)
    put("docs/raytrace.md", "depth", text_table(("scene", *TITLES), rows, left=range(4)))
    put("docs/raytrace.md", "pictures")


if __name__ == "__main__":
    make()
