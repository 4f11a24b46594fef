# SPDX-License-Identifier: Apache-2.0
"""
Thresholds and windows against sunlight
=======================================

A threshold discards windows with too few photons. This example counts the events that leave the
sensor and the wrong pixels, for all thresholds, three levels of sunlight and three windows. The
distance of a pixel is the highest point of its histogram after a filter with the shape of the
laser pulse.
"""

import matplotlib.pyplot as plt
import numpy as np

import coincid

thresholds = range(1, 8)


def wrong_share(run):
    """Share of the pixels that are off by more than 230 ps (3.45 cm)."""
    return np.mean(
        ~(np.abs(run.depth(method="matched").depth_m[:, :, 0] - run.scene.truth_m) < 0.0345)
    )


figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
base = coincid.load_config().with_frame(link_gbps=8)
for klux, colour in ((5, "#46327e"), (50, "#277f8e"), (100, "#4ac16d")):
    runs = [coincid.simulate(base.with_settings(threshold=th), klux=klux) for th in thresholds]
    left.plot(
        thresholds, [len(run.events()) for run in runs], "o-", color=colour, label=f"{klux} klux"
    )
    left.plot(thresholds, [run.result["dropped"].sum() for run in runs], "x:", color=colour)
    wrong = [wrong_share(run) for run in runs]
    right.plot(thresholds, wrong, "o-", color=colour, label=f"{klux} klux, window 1 ns")
    print(
        f"{klux} klux: threshold {thresholds[np.argmin(wrong)]} leaves {min(wrong):.1%} wrong pixels"
    )
for window, style in ((4, "--"), (64, ":")):
    runs = [
        coincid.simulate(base.with_settings(threshold=th, window=window), klux=50)
        for th in thresholds
    ]
    right.plot(
        thresholds,
        [wrong_share(run) for run in runs],
        style,
        color="#277f8e",
        label=f"50 klux, {window / 16:g} ns",
    )
left.set(xlabel="threshold in pixels", ylabel="events in a frame of 100 pulses", yscale="symlog")
left.set_title("circles: left the sensor; crosses: dropped, the link was full")
right.set(xlabel="threshold in pixels", ylabel="share of wrong pixels", ylim=(0, 1))
left.legend(fontsize="small")
right.legend(fontsize="small")
plt.show()
