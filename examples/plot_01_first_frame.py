# SPDX-License-Identifier: Apache-2.0
"""
First frame
===========

Simulate one frame of the scene `sun-and-shade` and estimate the distance of every pixel: with
coincidence off, with one threshold for all subgroups, and with the controller on the chip. The
example uses the golden model instead of the
RTL: it gives the same words in the same clock cycles, and needs no RTL tool.
"""

import matplotlib.pyplot as plt
import numpy as np

import coincid

# The default sensor has 32 x 32 pixels in subgroups of 8 x 8, and a frame has 100 laser pulses.
# The link carries 8 Gbit/s. The controller takes some frames to find a threshold for every
# subgroup, so the last of six frames is shown.
config = coincid.load_config().with_frame(link_gbps=8)
settings = {
    "coincidence off": config.with_settings(coincidence=False),
    "2 pixels within 1 ns": config.with_settings(threshold=2),
    "thresholds by the controller": config.with_frame(frames=6).with_settings(auto=True),
}
runs = {
    name: coincid.simulate(one, "sun-and-shade", klux=50, seed=1) for name, one in settings.items()
}

# %%
# Every event is one row: its time, the number of pixels that fired, and the first of them.

run = runs["2 pixels within 1 ns"]
print(run.events()[:5])

# %%
# A pixel is wrong if it is off by more than 3.45 cm, the paper's criterion.

truth_m = run.scene.truth_m
figure, axes = plt.subplots(1, 5, figsize=(15, 3.2), layout="constrained")
axes[0].imshow(run.light.background_cps.reshape(32, 32) / 1e6, cmap="inferno")
axes[0].set_title("background in million counts/s")
figure.colorbar(axes[0].images[0], ax=axes[0], shrink=0.8)
pictures = {"true distance in m": truth_m}
for name, run in runs.items():
    last = run.config.frames - 1
    depth_m = run.depth(frame=last).depth_m[:, :, 0]
    wrong_share = np.mean(~(np.abs(depth_m - truth_m) < 0.0345))
    print(
        f"{name}: {wrong_share:.1%} of the pixels are wrong, {run.result['dropped'][last].sum()} events were dropped"
    )
    pictures[name] = depth_m
for axis, (title, picture_m) in zip(axes[1:], pictures.items(), strict=True):
    image = axis.imshow(picture_m, cmap="viridis_r", vmin=truth_m.min(), vmax=truth_m.max())
    axis.set_title(title)
figure.colorbar(image, ax=axes[1:], shrink=0.8)
plt.show()
