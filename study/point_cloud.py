# SPDX-License-Identifier: Apache-2.0
"""Turns depth into points in space, and writes them as a PLY file for any viewer of point
clouds.
"""

import numpy as np

from ..model.depth.belief import SENTENCES
from ..model.depth.depth import Depth
from ..model.light.link_budget import Optics
from ..model.scenes.view import View
from ..model.shared.arguments import check_kind, given_or_new
from ..model.shared.errors import InputError
from ..model.shared.files import FilePath, check_suffix, whole_file
from ..model.shared.quantities import check_switch

_NORMAL = "nx", "ny", "nz"
_NUMBERS = "x", "y", "z", "confidence", "signal", "signal_error"
POINT = np.dtype([*((name, "<f4") for name in _NUMBERS), ("reason", "u1")])
POINT_WITH_NORMAL = np.dtype([*POINT.descr, *((name, "<f4") for name in _NORMAL)])
_PLY_TYPES = {"<f4": "float", "|u1": "uchar"}


def point_cloud(depth: Depth, optics: Optics | None = None, *, normals: bool = False) -> np.ndarray:
    """Return one point in space per depth, row by row, with the returns of a pixel together; no
    point without depth.

    A pixel looks along the ray through its middle, and its depth is the length along that ray.

    Parameters
    ----------
    depth : Depth
    optics : Optics or None
        The pixels share its field of view and are evenly spaced in the plane of the sensor; None:
        that of the paper.
    normals : bool
        Whether to add the unit normal of the surface, towards the sensor (NaN where the slope is
        not known).

    Returns
    -------
    numpy.ndarray
        Structured array with the fields `x` (to the right), `y` (down) and `z` (along the axis) in
        metres from the lens, `confidence`, `signal` and `signal_error` in photons per pulse (NaN if
        the depth has none), `reason` (uint8, that of the pixel), and `nx`, `ny`, `nz` with normals.

    Raises
    ------
    InputError
        If normals are requested and the depth has no slopes.
    """
    check_kind("depth", depth, Depth)
    check_switch("normals", normals)
    if normals and depth.slope_m is None:
        raise InputError("normals: the depth has no slopes, its method must be planes")
    optics = given_or_new("optics", optics, Optics)
    rows, cols, _ = depth.depth_m.shape
    right, down = View(h_deg=optics.fov_h_deg, v_deg=optics.fov_v_deg).tangents(rows, cols)
    ray = np.stack([right, down, np.ones_like(right)], axis=2)
    ray /= np.linalg.norm(ray, axis=2, keepdims=True)
    seen = ~np.isnan(depth.depth_m)
    points = np.empty(np.count_nonzero(seen), POINT_WITH_NORMAL if normals else POINT)
    for name, part in zip("xyz", np.moveaxis(ray, 2, 0), strict=True):
        points[name] = (part[:, :, None] * depth.depth_m)[seen]
    points["confidence"] = depth.confidence[seen]
    points["signal"] = np.nan if depth.signal_per_pulse is None else depth.signal_per_pulse[seen]
    points["signal_error"] = np.nan if depth.signal_error is None else depth.signal_error[seen]
    points["reason"] = np.broadcast_to(depth.reason[:, :, None], seen.shape)[seen]
    if normals and depth.slope_m is not None:
        normals_of = _normals(depth.depth_m, depth.slope_m, right, down, ray)
        for name, part in zip(_NORMAL, np.moveaxis(normals_of, 3, 0), strict=True):
            points[name] = part[seen]
    return points


def _normals(
    depth_m: np.ndarray, slope_m: np.ndarray, right: np.ndarray, down: np.ndarray, ray: np.ndarray
) -> np.ndarray:
    """float64[rows, cols, returns, 3]: unit normals of the first returns, NaN for others. right,
    down: tangents; ray: unit vectors.
    """
    length = 1 / ray[:, :, 2]
    # movement of a point on the surface from one row to the next, and from one column to the next
    along = []
    for axis, tangent in enumerate((down, right)):
        step = (
            np.gradient(tangent, axis=axis) if tangent.shape[axis] > 1 else np.zeros_like(tangent)
        )
        unit = np.zeros_like(ray)
        unit[:, :, 1 - axis] = 1
        turn = (unit - ray * ray[:, :, [1 - axis]]) * (step / length)[:, :, None]
        along.append(slope_m[:, :, axis, None] * ray + depth_m[:, :, :1] * turn)
    first = np.cross(*along)
    size = np.linalg.norm(first, axis=2, keepdims=True)
    # a surface along the ray, or at distance 0, has no normal
    first = np.divide(first, size, out=np.full_like(first, np.nan), where=size > 0)
    first *= np.where((first * ray).sum(axis=2, keepdims=True) > 0, -1, 1)
    found = np.full((*depth_m.shape, 3), np.nan)
    found[:, :, 0] = first
    return found


def write_ply(path: FilePath, points: np.ndarray) -> None:
    """Write points (`point_cloud`) as binary PLY, whole or not at all. Raises `InputError` for
    another suffix.
    """
    check_suffix(path, ".ply")
    check_kind("points", points, np.ndarray)
    points = _packed(points)
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment metres; x right, y down, z forward",
        "comment signal, signal_error: detected photons per laser pulse, before the dead time",
    ]
    header += [f"comment reason {reason}: {told}" for reason, told in SENTENCES.items()]
    fields = [
        f"property {_PLY_TYPES[points.dtype[name].str]} {name}" for name in points.dtype.names or ()
    ]
    header += [f"element vertex {len(points)}", *fields, "end_header", ""]
    with whole_file(path) as file:
        file.write("\n".join(header).encode() + points.tobytes())


def _packed(points: np.ndarray) -> np.ndarray:
    """Return points with fields of the types of a PLY file, without gaps between them. Raises
    `InputError`.

    An array of some of the fields, as points[["x", "y", "z"]], has gaps in place of the others.
    """
    names = points.dtype.names or ()
    kinds = [points.dtype[name] for name in names]
    legal = all(kind.kind == "f" or kind == np.uint8 for kind in kinds)
    if points.ndim != 1 or not names or not legal:
        raise InputError(
            "points: must be the array of point_cloud, of one dimension and with fields of floats or uint8",
            field="points",
        )
    types = ("<f4" if kind.kind == "f" else "u1" for kind in kinds)
    packed = np.empty(len(points), list(zip(names, types, strict=True)))
    for name in names:
        packed[name] = points[name]
    return packed
