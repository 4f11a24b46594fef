# SPDX-License-Identifier: Apache-2.0
"""
Why coincidence helps, and when it does not
===========================================

A lecture in six figures, from one photon to a picture. Each figure takes a few lines, so change the
numbers and run it again. A tick of the sensor's clock phases is 62.5 ps, which is 9.4 mm of
distance.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.ndimage import gaussian_filter1d

import coincid

KLUX = 50
wall = coincid.simulate(None, "flat:8", klux=KLUX, coincidence=False, link_gbps=0)
tick_m = wall.config.tick_m
period_m = wall.config.frame.period * wall.config.sensor.phases * tick_m
PIXEL = 3 * 32 + 3  # row 3, column 3: in the first subgroup of 8 x 8 pixels
WALL_M = 8

# %%
# One pulse of the laser
# ----------------------
# Each dot is an avalanche of a SPAD in one laser period. The time tells the distance that light
# would have covered, there and back. Most of the avalanches are sunlight. Nothing tells which ones
# came from the wall.

first = wall.edges.pulse == 0
plt.figure(figsize=(8, 3), layout="constrained")
plt.plot(wall.edges.tick[first] * tick_m, wall.edges.pixel[first], ".", markersize=3)
plt.gca().set(xlabel="distance in m", ylabel="pixel", title="avalanches in one laser period")

# %%
# Many pulses, one pixel
# ----------------------
# Sunlight comes at any time, laser light always at the same time. After 100 pulses the wall stands
# out of the histogram of a pixel. This needs a time-to-digital converter (TDC) in every pixel, and
# every avalanche has to leave the chip.

mine = wall.edges.pixel == PIXEL
plt.figure(figsize=(8, 3), layout="constrained")
plt.hist(wall.edges.tick[mine] * tick_m, bins=256, range=(0, period_m))
plt.gca().set(xlabel="distance in m", ylabel="avalanches", title="one pixel in 100 laser periods")

avalanche_bits = np.ceil(np.log2(1024 * period_m / tick_m))  # pixel number and time
periods_per_s = 1 / (wall.config.frame.period * wall.config.sensor.phases * wall.config.tick_s)
all_gbps = len(wall.edges.pixel) / wall.config.pulses * periods_per_s * avalanche_bits / 1e9
print(f"every avalanche of 32 x 32 pixels would take {all_gbps:.0f} Gbit/s")

# %%
# Many pixels, one pulse
# ----------------------
# Sunlight does not know its neighbours, laser light does: the pixels of a subgroup look at nearly
# the same distance. So count, within a window of 1 ns, how many pixels of the subgroup fire.
# Sunlight rarely reaches three. This is coincidence.

window_ticks = int(wall.config.window[0])
near = first & (wall.edges.pixel % 32 < 8) & (wall.edges.pixel // 32 < 8)
starts = np.sort(wall.edges.tick[near])
together = np.searchsorted(starts, starts + window_ticks) - np.arange(len(starts))
plt.figure(figsize=(8, 3), layout="constrained")
plt.stem(starts * tick_m, together, markerfmt=".", basefmt=" ")
plt.gca().set(
    xlabel="distance in m", ylabel="avalanches within 1 ns", title="one subgroup, one period"
)

# %%
# What a threshold buys
# ---------------------
# With a threshold, the sensor sends only the windows that enough pixels share: one time stamp, and
# an ID map with a bit for every pixel that fired. Such an event takes more bits than one avalanche, so
# threshold 1 sends more than all avalanches alone. Each further step makes the stream smaller.

THRESHOLDS = range(1, 6)
frame_s = wall.config.frame_cycles / (wall.config.clock_mhz * 1e6)
LINKS = {  # streams off the chip, Gbit/s of each; 0 = as much as the sensor sends
    "no limit of the link": {"streams": 16, "link_gbps": 0},
    "8 Gbit/s": {"streams": 1, "link_gbps": 8},
    "2 Gbit/s": {"streams": 1, "link_gbps": 2},
}


def runs_of(scene, link):
    """One run per threshold, all of the same photons."""
    return [
        coincid.simulate(None, scene, klux=KLUX, threshold=threshold, **LINKS[link])
        for threshold in THRESHOLDS
    ]


bright = {link: runs_of("five-objects", link) for link in LINKS}
unlimited = bright["no limit of the link"]
stream_gbps = [run["bits"] / frame_s / 1e9 for run in unlimited]
plt.figure(figsize=(8, 3), layout="constrained")
plt.semilogy(THRESHOLDS, stream_gbps, "o-")
plt.gca().set(
    xticks=THRESHOLDS, xlabel="threshold in pixels", ylabel="Gbit/s", title="what the sensor sends"
)

# %%
# What a threshold costs, and when it helps
# -----------------------------------------
# Without a limit of the link, threshold 1 is the best one: the ID map says which pixels fired, and
# the estimator weighs all of it. A higher threshold only throws windows away. So a threshold buys
# bandwidth, and nothing else.
#
# Coincidence helps where the link is the limit. At threshold 1, windows are dropped without regard
# to what they hold; it is better to choose by coincidence which ones are not sent. It does not help
# where a surface is so dim or far that three of its photons rarely come together. `sun-and-shade`
# has such pixels in the shade: there even a full link is better than a threshold of 3. This is why
# each subgroup of this sensor can have a threshold of its own, which follows the light.

dim = {link: runs_of("sun-and-shade", link) for link in LINKS}
scenes = {"five-objects": bright, "sun-and-shade": dim}
figure, axes = plt.subplots(1, 2, figsize=(10, 3.4), sharey=True, layout="constrained")
for axis, (title, runs) in zip(axes, scenes.items(), strict=True):
    for link in LINKS:
        axis.plot(THRESHOLDS, [run["wrong_share"] for run in runs[link]], "o-", label=link)
    axis.set(
        title=title,
        xticks=THRESHOLDS,
        xlabel="threshold in pixels",
        ylabel="share of wrong pixels",
        ylim=0,
    )
axes[0].legend()

# %%
# The picture
# -----------
# Four pictures of the same photons, without a limit of the link. A pixel is wrong if it is off by
# more than 3.45 cm. An ideal TDC in every pixel, with a filter of the pulse's shape, shows what a
# pixel knows without its neighbours. The ID map at threshold 1 keeps all that the pixels know, and
# `planes`, the estimator, also uses that neighbours see nearly the same distance.

every = unlimited[0].edges
ticks = wall.config.frame.period * wall.config.sensor.phases
counts = np.zeros((1024, ticks))
np.add.at(counts, (every.pixel, every.tick), 1)
pulse_ticks = 0.5e-9 / 2.355 / wall.config.tick_s
ideal_m = gaussian_filter1d(counts, pulse_ticks).argmax(axis=1).reshape(32, 32) * tick_m

truth_m = unlimited[0].scene.truth_m
pictures = {"an ideal TDC in every pixel": ideal_m}
for threshold in (1, 2, 3):
    name = f"this sensor, threshold {threshold}"
    pictures[name] = unlimited[threshold - 1].depth().depth_m[:, :, 0]
figure, axes = plt.subplots(1, 4, figsize=(12, 3.4), layout="constrained")
for axis, (name, depth_m) in zip(axes, pictures.items(), strict=True):
    wrong_share = np.mean(~(np.abs(depth_m - truth_m) < 0.0345))
    axis.imshow(depth_m, cmap="viridis_r", vmin=truth_m.min(), vmax=truth_m.max())
    axis.set(title=f"{name}\n{wrong_share:.1%} wrong")
    print(f"{name}: {wrong_share:.1%} of the pixels are wrong")
plt.show()
