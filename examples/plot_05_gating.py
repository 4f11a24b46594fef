# SPDX-License-Identifier: Apache-2.0
"""
Gating and progressive gating
=============================

Every pixel sees a bright pane at 3 m and a wall behind it at 9 m. A gate that opens after the
light of the pane has passed hides the pane. A progressive gate opens later from pulse to pulse,
and so scans the whole range.
"""

import matplotlib.pyplot as plt
import numpy as np

import coincid

# the distance that light covers, there and back, in one clock cycle: 0.3 m
CYCLE_M = 2e-9 * 299_792_458 / 2
base = coincid.load_config().with_frame(pulses=200)
ungated = base
gated = base.with_settings(gating=True, gate_start=20, gate_len=20)
moving = base.with_frame(gate_every=10, gate_step=5, gate_steps=20).with_settings(
    gating=True, gate_start=0, gate_len=10
)

figure, axes = plt.subplots(3, 1, figsize=(8, 7), sharex=True, layout="constrained")
cases = {
    "no gate": ungated,
    "gate from 6 to 12 m": gated,
    "progressive gate of 3 m: every 10 pulses it moves on by 1.5 m": moving,
}
for axis, (title, config) in zip(axes, cases.items(), strict=True):
    run = coincid.simulate(config, "two-returns:3,9", klux=50)
    events = run.events()
    subgroup = events["subgroup"] == 5
    distance_m = events["stamp"][subgroup] * config.tick_m
    axis.plot(distance_m, events["pulse"][subgroup], ".", color="#277f8e", markersize=4)
    if config.gating.any():
        step = (
            config.frame.gate_every
            and np.arange(200) // config.frame.gate_every * config.frame.gate_step
        )
        start = (config.gate_start[5] + step) * CYCLE_M * np.ones(200)
        axis.fill_betweenx(
            range(200), start, start + config.gate_len[5] * CYCLE_M, color="#f2c879", alpha=0.4
        )
    axis.set(title=title, ylabel="laser pulse", xlim=(0, 32))
    found_m = np.nanmedian(run.depth().depth_m[:, :, 0])
    print(f"{title}: {len(events)} events, most pixels at {found_m:.2f} m")
axes[-1].set_xlabel("distance of the events of one subgroup in m; shaded: the gate")
plt.show()
