# SPDX-License-Identifier: Apache-2.0
"""
From photons to the histogram of one pixel
==========================================

Follow one pixel of a flat wall at 6 m in 20 klux of sunlight: its avalanches in every laser
period, the fate of each avalanche in the sensor, and the histogram of the events that left the
sensor.
"""

import matplotlib.pyplot as plt
import numpy as np

import coincid

config = coincid.load_config().with_settings(threshold=3)
run = coincid.simulate(config, "flat:6", klux=20)
pixel = 10 * 32 + 10
mine = run.edges.pixel == pixel

# The golden model gives every avalanche its fate, in the order of the edges.
fates = (
    "opened a window",
    "counted in a window",
    "second hit in a window",
    "masked",
    "gated",
    "tree was not armed",
)
fate = run.result["fate"][mine]

# %%
# The sensor reports a whole window: the time of its first photon and the map of the pixels that
# fired. An avalanche therefore reaches the histogram only if enough neighbours fired in the same
# nanosecond.

events = np.asarray(run.histogram(pixel))
print(
    f"{mine.sum()} avalanches in {config.pulses} pulses, {events.sum()} of them in events that left the sensor"
)

tick_m = config.tick_m
figure, (upper, lower) = plt.subplots(2, 1, figsize=(8, 5.4), sharex=True, layout="constrained")
for value in np.unique(fate):
    chosen = fate == value
    upper.plot(
        run.edges.tick[mine][chosen] * tick_m,
        run.edges.pulse[mine][chosen],
        ".",
        markersize=4,
        label=fates[value],
    )
upper.set(ylabel="laser pulse", title=f"avalanches of pixel {pixel}")
upper.legend(loc="upper right")
bins_m = np.arange(len(events)) * tick_m
lower.step(bins_m, events, where="post", color="#c8501e")
lower.axvline(run.scene.truth_m.flat[pixel], color="black", linewidth=0.8, linestyle=":")
lower.set(
    xlabel="distance in m",
    ylabel="events with this pixel",
    title="histogram; dotted: the true distance",
    xlim=(0, 40),
)
plt.show()
