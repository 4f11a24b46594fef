# SPDX-License-Identifier: Apache-2.0
"""Draws ray-NAME.png for each ray-traced scene: its truth, and its depth through the RTL. Needs `make raytrace`.

python -m coincid.study.drawings.raytrace [NAME ...]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from ...lab.setup import SETTLING
from ...model.contract.config import load_config
from ...model.depth.estimate import estimate_depth
from ...model.depth.quality import wrong_share
from ...model.light.photons import generate_edges
from ...model.light.spad import Spad
from ...model.light.timing import Timing
from ...model.scenes.catalogue import load_scene
from ...model.scenes.ray_scene import BUILT_IN, PREFIX
from ...model.scenes.scene import scene_light
from ...model.shared.constants import SPEED_OF_LIGHT_M_S
from ..pictures import Panel, depth_row
from ..simulate import SCHEMES, plan_frames, run_frames
from . import image

KLUX, PULSES, SEED = 50, 400, 1
WINDOW_M = 1e-9 * SPEED_OF_LIGHT_M_S / 2  # surfaces closer than a coincidence window of 1 ns are one to it


def draw(name: str) -> list[tuple[float, float]]:
    """Write the picture; return (wrong by more than a window, wrong by the paper's criterion) for each scheme."""
    config = load_config(None).with_pulses(PULSES)
    timing = Timing.from_config(config)
    scene = load_scene(PREFIX + name, config.sensor.rows, config.sensor.cols)
    edges = generate_edges(scene_light(scene, KLUX), Spad(), timing, pulses=SETTLING * PULSES, seed=SEED)
    plan = plan_frames(config, edges, config.threshold, SETTLING)
    with tempfile.TemporaryDirectory() as folder:
        frames = run_frames(plan, "verilator", Path(folder))
    depths = [estimate_depth(frames.arrays, plan.configs[k], frame=k).depth_m[:, :, 0] for k in plan.shown.values()]
    panels = [
        Panel(title.format(threshold=np.unique(config.threshold)[0]), depth)
        for (title, _), depth in zip(SCHEMES.values(), depths)
    ]
    path = image(f"ray-{name}.png")
    shares = depth_row(
        path, panels, scene.truth_m, f"{scene.name}, {KLUX} klux, {PULSES} laser pulses", tolerance_m=WINDOW_M
    )
    return [(share, wrong_share(depth, scene.truth_m)) for share, depth in zip(shares, depths)]


if __name__ == "__main__":
    for scene_name in sys.argv[1:] or BUILT_IN:
        print(scene_name, *(f"{coarse:.1%} {fine:.1%}" for coarse, fine in draw(scene_name)), sep="  ")
