# SPDX-License-Identifier: Apache-2.0
"""
Your own RGB-D scene
====================

A scene can be a depth picture (PNG of 16 bits, in millimetres). A colour picture of the same
view is optional; its brightness becomes the reflectivity. This example draws both pictures. Use
the names of your own files instead.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import coincid

# A room: a far wall, a floor that reaches to the camera, and a dark ball in front of the wall.
row, col = np.mgrid[0:240, 0:320]
depth_mm = np.minimum(7000, 4200 * 240 / np.maximum(row, 1) + 600)
ball = np.hypot(row - 110, col - 150) < 55
depth_mm[ball] = 3500
brightness = np.where(row > 150, 120, 210)
brightness[ball] = 60
folder = Path(tempfile.mkdtemp())
Image.fromarray(depth_mm.astype(np.uint16)).save(folder / "depth.png")
Image.fromarray(np.repeat(brightness[:, :, None], 3, axis=2).astype(np.uint8)).save(
    folder / "colour.png"
)

# %%
# On the command line the same is `make sim SCENE=depth.png,colour.png KLUX=20`.

run = coincid.simulate(scene=f"{folder / 'depth.png'},{folder / 'colour.png'}", klux=20)
for note in run.scene.notes:
    print(note.replace(str(folder), "."))
depth = run.depth()

figure, axes = plt.subplots(1, 4, figsize=(12, 3), layout="constrained")
axes[0].imshow(brightness, cmap="gray", vmin=0, vmax=255)
axes[0].set_title("colour picture")
axes[1].imshow(run.scene.truth_m, cmap="viridis_r", vmin=3, vmax=7.5)
axes[1].set_title("truth: 32 x 32 pixels")
image = axes[2].imshow(depth.depth_m[:, :, 0], cmap="viridis_r", vmin=3, vmax=7.5)
axes[2].set_title("estimated distance in m")
figure.colorbar(image, ax=axes[1:3], shrink=0.8)
confidence = axes[3].imshow(depth.confidence[:, :, 0], cmap="magma", vmin=0, vmax=1)
axes[3].set_title("confidence")
figure.colorbar(confidence, ax=axes[3], shrink=0.8)
plt.show()
