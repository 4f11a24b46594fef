"""Depth as a cloud of points in space, and as a PLY file that any viewer of clouds opens."""

import numpy as np

from ..model.depth.estimate import Depth
from ..model.light.link_budget import Optics
from ..model.shared.files import FilePath, whole_file

FIELDS = ("x", "y", "z", "confidence")
POINT = np.dtype([(name, "<f4") for name in FIELDS])


def point_cloud(depth: Depth, optics: Optics | None = None) -> np.ndarray:
    """A point for every depth, `POINT`[n]: row by row, the returns of a pixel one after the other; pixels without depth have none.

    x, y, z: metres from the lens, to the right of the picture, down, and along the axis. A pixel sees along the ray through its
    middle, and its depth is the way on that ray. optics: whose field of view the pixels share, evenly spaced in the plane of the
    sensor. confidence: that of the depth.
    """
    optics = optics or Optics()
    rows, cols, _ = depth.depth_m.shape
    right, down = np.meshgrid(_tangents(cols, optics.fov_h_deg), _tangents(rows, optics.fov_v_deg))
    ray = np.stack([right, down, np.ones_like(right)], axis=2)
    ray /= np.linalg.norm(ray, axis=2, keepdims=True)
    seen = ~np.isnan(depth.depth_m)
    points = np.empty(np.count_nonzero(seen), POINT)
    for name, part in zip("xyz", np.moveaxis(ray, 2, 0)):
        points[name] = (part[:, :, None] * depth.depth_m)[seen]
    points["confidence"] = depth.confidence[seen]
    return points


def _tangents(pixels: int, fov_deg: float) -> np.ndarray:
    """Of the angles between the axis and the middles of pixels that share a field of view."""
    return (2 * np.arange(pixels) + 1 - pixels) / pixels * np.tan(np.radians(fov_deg) / 2)


def write_ply(path: FilePath, points: np.ndarray) -> None:
    """Writes points (`point_cloud`) as binary PLY, whole or not at all."""
    header = ["ply", "format binary_little_endian 1.0", "comment metres; x right, y down, z forward"]
    header += [f"element vertex {len(points)}", *(f"property float {name}" for name in FIELDS), "end_header", ""]
    with whole_file(path) as file:
        file.write("\n".join(header).encode() + points.astype(POINT).tobytes())
