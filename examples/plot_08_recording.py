# SPDX-License-Identifier: Apache-2.0
"""
Replaying a PTU recording
=========================

The sensor can be simulated with photons that an instrument has recorded. This example writes a
PicoQuant PTU file with the photons of a simulated scene. Use the name of your own file instead.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import coincid
from coincid.model.recorded.exchange import read_recording, write_edges
from coincid.model.recorded.recordings import recorded_edges

config = coincid.parse_config({"sensor": {"rows": 8, "cols": 8}, "frame": {"pulses": 200}})
timing = coincid.Timing.from_config(config)
scene = coincid.load_scene("two-targets:4,6", 8, 8)
photons = coincid.generate_edges(
    coincid.scene_light(scene, 20), coincid.Spad(), timing, pulses=200, seed=1
)
path = Path(tempfile.mkdtemp()) / "recording.ptu"
write_edges(path, photons, timing)

# %%
# Channel k of the file is pixel k. Photons that cannot be used are counted by the reason. Then
# the sensor is simulated with the edges. The engine "golden" is the golden model; "sliced" would
# be the RTL.

edges, lost = recorded_edges(read_recording(path), config, timing)
print(f"{path.stat().st_size} bytes, {len(edges)} photons, left out: {lost}")
result = coincid.replay("golden", config, edges)
depth_m = coincid.estimate_depth(result, config).depth_m[:, :, 0]

figure, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
tick_m = config.tick_m
axes[0].hist(edges.tick * tick_m, bins=150, range=(0, 15), color="#999999", label="all photons")
axes[0].hist(
    result["stamp"] * tick_m, bins=150, range=(0, 15), color="#c8501e", label="events, threshold 2"
)
axes[0].set(xlabel="distance in m", ylabel="number", yscale="log")
axes[0].legend()
for axis, picture_m, title in (
    (axes[1], scene.truth_m, "truth in m"),
    (axes[2], depth_m, "from the recording in m"),
):
    image = axis.imshow(picture_m, cmap="viridis_r", vmin=3.5, vmax=6.5)
    axis.set_title(title)
figure.colorbar(image, ax=axes[1:], shrink=0.8)
print(f"largest error: {np.nanmax(np.abs(depth_m - scene.truth_m)) * 100:.1f} cm")
plt.show()
