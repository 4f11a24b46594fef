"""Draws ray-NAME.png for each ray-traced scene of the project: its truth, and its depth through the RTL. Needs `make raytrace`.

    python docs/images/raytrace.py [NAME ...]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from coincid.model.config import load_config
from coincid.model.depth import estimate_depth, wrong_share
from coincid.model.light import SPEED_OF_LIGHT_M_S, Spad, Timing
from coincid.model.photons import generate_edges
from coincid.model.pictures import Panel, depth_row
from coincid.model.ray_scene import BUILT_IN, PREFIX
from coincid.model.scene import load_scene, scene_light
from coincid.tb.simulate import SCHEMES, run_frames

KLUX, PULSES, SEED = 50, 400, 1
WINDOW_M = 1e-9 * SPEED_OF_LIGHT_M_S / 2  # what a coincidence window of 1 ns holds: nearer surfaces are one to it


def draw(name: str) -> list[tuple[float, float]]:
    """Writes the picture; (wrong by more than a window, wrong as in the paper's Fig. 7) of each scheme."""
    config = load_config(None).with_pulses(PULSES)
    timing = Timing.from_config(config)
    scene = load_scene(PREFIX + name, config.sensor.rows, config.sensor.cols)
    edges = generate_edges(scene_light(scene, KLUX), Spad(), timing, pulses=PULSES, seed=SEED)
    with tempfile.TemporaryDirectory() as folder:
        frames = run_frames(config, edges, "verilator", Path(folder))
    depths = [estimate_depth(frames.arrays, scheme, timing.tick_s, frame=k).depth_m[:, :, 0] for k, scheme in enumerate(frames.configs)]
    panels = [Panel(title.format(threshold=np.unique(config.threshold)[0]), depth) for (title, _), depth in zip(SCHEMES.values(), depths)]
    path = Path(__file__).with_name(f"ray-{name}.png")
    shares = depth_row(path, panels, scene.truth_m, f"{scene.name}, {KLUX} klux, {PULSES} laser pulses", tolerance_m=WINDOW_M)
    return [(share, wrong_share(depth, scene.truth_m)) for share, depth in zip(shares, depths)]


if __name__ == "__main__":
    for scene_name in sys.argv[1:] or BUILT_IN:
        print(scene_name, *(f"{coarse:.1%} {fine:.1%}" for coarse, fine in draw(scene_name)), sep="  ")
