# SPDX-License-Identifier: Apache-2.0
"""
Several targets
===============

In the scene `two-returns` every pixel sees two surfaces, like a pane and the wall behind it.
With `returns=2` the estimator reports both. After a window the tree is blind until the next
cycle. Surfaces that are closer than this time and the window (up to half a metre here) are
reported as one.
"""

import matplotlib.pyplot as plt
import numpy as np

import coincid

NEAR_M = 5.0
steps_m = (0.15, 0.3, 0.6, 1.0, 2.0)
config = coincid.load_config().with_frame(pulses=200)

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
seen = []
for step_m in steps_m:
    run = coincid.simulate(config, f"two-returns:{NEAR_M},{NEAR_M + step_m}", klux=20)
    depth_m = np.sort(run.depth(returns=2).depth_m, axis=2)
    both = np.all(np.abs(depth_m - [NEAR_M, NEAR_M + step_m]) < 0.05, axis=2)
    seen.append(both.mean())
    print(f"{step_m} m apart: {both.mean():.1%} of the pixels have both distances within 5 cm")

left.plot(steps_m, seen, "o-", color="#277f8e")
left.set(
    xlabel="distance between the surfaces in m",
    ylabel="share of pixels with both surfaces",
    ylim=(0, 1.05),
)
right.hist(depth_m.ravel(), bins=np.arange(4.5, 8, 0.02), color="#c8501e")
right.set(
    xlabel="distance in m",
    ylabel="returns",
    title=f"both returns of all pixels, {step_m} m apart",
    yscale="log",
)
plt.show()
