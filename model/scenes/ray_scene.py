# SPDX-License-Identifier: Apache-2.0
"""Ray-traced scenes by name or file: rendered now or taken from the cache, with notes for the user.

Ref: paper V, "a simulator based on Monte Carlo ray tracing models"; everything else is our
choice. Mitsuba and mitransient are an optional extra; nothing here imports them before a scene
is requested.
"""

import ctypes
import os
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from ..light.light import NEAREST_M
from ..light.link_budget import Optics
from ..shared.arguments import given_or_new
from ..shared.constants import SPEED_OF_LIGHT_M_S
from ..shared.errors import InputError
from ..shared.folders import build_root
from ..shared.sources import digest, sources_digest
from .scene import Scene
from .transient import Transient

if TYPE_CHECKING:
    from .ray_tracer import RayScene

PREFIX = "ray:"
BUILT_IN = ("five-objects", "glass", "corner", "retroreflector", "fog")
SCENES = Path(__file__).with_name("ray_scenes")  # folder of the built-in scenes
PACKAGES = ("mitsuba", "mitransient", "drjit")
INSTALL = "make raytrace (without a checkout: pip install 'coincid[raytrace]')"
# Names that the loader knows. Older versions are missing because they crash: they do not know
# the code that Dr.Jit emits.
LLVM_LIBRARIES = (
    "libLLVM.so.19.1",
    "libLLVM.so.20.1",
    "libLLVM.so.21.1",
    "libLLVM.so.18.1",
    "libLLVM-17.so.1",
    "libLLVM.dylib",
)
LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
RECORDED_PERIODS = 2  # laser periods; light that arrives even later is left out
LOST_SHARE_MAX = 1e-3  # share of the returning light up to which there is no note
# limits of the median beyond which metres are in doubt
DOUBTFUL_NEAR_M, DOUBTFUL_FAR_SHARE = (0.3, 0.5)


def is_ray_scene(source: str) -> bool:
    """Return whether `source` names a scene for the ray tracer."""
    return source.startswith(PREFIX) or source.lower().endswith(".xml")


def ray_scene(
    source: str, rows: int, cols: int, *, range_m: float, optics: Optics | None = None
) -> Scene:
    """Return the ray-traced scene `source`, rendered at rows x cols or taken from the cache.
    Raises `InputError`.

    source: `ray:NAME`, or a Mitsuba scene file (.xml, metres). range_m: range of the laser
    period. optics: the pixels share its field of view. Pixels without a usable surface (none,
    too near, at or beyond the range) are masked and noted; their light stays.
    """
    optics = given_or_new("optics", optics, Optics)
    path = _path(source)
    name = source if path.parent == SCENES else path.name
    tracer = _tracer()
    scene = tracer.read_scene(path)
    view = {
        "fov_h_deg": optics.fov_h_deg,
        "fov_v_deg": optics.fov_v_deg,
        "stop_s": RECORDED_PERIODS * 2 * range_m / SPEED_OF_LIGHT_M_S,
    }
    cached = build_root() / "raytrace" / f"{_key(scene, rows, cols, view)}.npz"
    if not cached.exists():
        tracer.render(scene, rows, cols, **view).save(cached)
    transient = Transient.load(cached)
    distance_m, doubts, notes = _surfaces(name, transient, range_m)
    if path.parent != SCENES:
        notes = _about(name, scene, rows, cols, optics) + notes
    return Scene(
        name=name,
        distance_m=distance_m,
        reflectivity=np.clip(transient.ambient, 0, 1),
        transient=transient,
        doubts=tuple(doubts),
        notes=tuple(notes),
    )


def _path(source: str) -> Path:
    if not source.startswith(PREFIX):
        path = Path(source)
        if not os.path.isfile(path):  # unlike Path.is_file, it takes any name
            raise InputError(
                f"{path}: no such file (built-in scenes for the ray tracer: {', '.join(PREFIX + name for name in BUILT_IN)})"
            )
        return path
    name = source.removeprefix(PREFIX)
    if name not in BUILT_IN:
        raise InputError(
            f"scene {source}: must be one of {', '.join(PREFIX + name for name in BUILT_IN)}, or an .xml file"
        )
    return SCENES / f"{name}.xml"


def _tracer() -> ModuleType:
    """Return the module that needs the extra. Raises `InputError` if the extra or its LLVM is
    missing.
    """
    try:
        for package in PACKAGES:
            version(package)
    except PackageNotFoundError:
        raise InputError(
            f"ray-traced scenes need {package}, which is not installed; run: {INSTALL}"
        ) from None
    if LLVM_VARIABLE not in os.environ:
        os.environ[LLVM_VARIABLE] = llvm_library()
    os.environ.setdefault("DRJIT_CACHE_DIR", str(build_root() / "raytrace" / "kernels"))
    from . import ray_tracer

    return ray_tracer


def llvm_library() -> str:
    """Return the LLVM that the loader finds, by its name there. Raises `InputError`."""
    for name in LLVM_LIBRARIES:
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return name
    raise InputError(
        f"ray-traced scenes need the library of LLVM 17 or newer (Debian: libllvm19), which is not installed; run: {INSTALL}"
    )


def _key(scene: "RayScene", rows: int, cols: int, view: dict[str, float]) -> str:
    """Return a hash of everything that determines the rendering: scene files, view, versions,
    and our own code.
    """
    packages = [(name, version(name)) for name in PACKAGES]
    code = sources_digest("model.scenes")
    return digest(
        repr((rows, cols, view, packages, code)),
        *(content for _, content in sorted(scene.files.items())),
    )


def _surfaces(
    name: str, transient: Transient, range_m: float
) -> tuple[np.ndarray, list[str], list[str]]:
    """Return distance_m, with NaN where there is no truth, and doubts and notes about it."""
    surface_m = transient.surface_m
    there = np.isfinite(surface_m)
    near, far = there & (surface_m < NEAREST_M), there & (surface_m >= range_m)
    if not there.any():
        raise InputError(
            f"{name}: the camera sees no surface, must look at one (it looks along its +z, as in Mitsuba)"
        )
    nearest_m, farthest_m = surface_m[there].min(), surface_m[there].max()
    span = f"{name}: surfaces from {nearest_m:.4g} to {farthest_m:.4g} m, the file's units taken for metres"
    if not (there & ~near & ~far).any():
        raise InputError(
            f"{span}: all are below {NEAREST_M:g} m or at or beyond the laser period's range of {range_m:.4g} m"
        )
    median_m = np.median(surface_m[there])
    doubts = []
    notes = []
    if median_m < DOUBTFUL_NEAR_M or median_m > DOUBTFUL_FAR_SHARE * range_m:
        doubts.append(f"{span}, which is doubtful")
    else:
        notes.append(span)
    for what, where in (
        ("without a surface", ~there),
        (f"nearer than {NEAREST_M:g} m", near),
        (f"at or beyond the laser period's range of {range_m:.4g} m", far),
    ):
        if where.any():
            notes.append(f"{name}: {where.sum()} of {where.size} pixels {what} are masked")
    returned = transient.total_per_m2.sum()
    if returned == 0:
        doubts.append(f"{name}: nothing of the laser's light comes back")
    elif transient.lost_per_m2 > LOST_SHARE_MAX * (returned + transient.lost_per_m2):
        notes.append(
            f"{name}: {transient.lost_per_m2 / (returned + transient.lost_per_m2):.1%} of the light comes after "
            f"{RECORDED_PERIODS} laser periods and is left out"
        )
    return np.where(there & ~near & ~far, surface_m, np.nan), doubts, notes


def _about(name: str, scene: "RayScene", rows: int, cols: int, optics: Optics) -> list[str]:
    """Return notes on which parts of a user's file are used, and which are not."""
    first = "" if scene.cameras == 1 else f"the first of {scene.cameras} cameras, "
    kind = (
        ""
        if scene.kind in ("perspective", "thinlens")
        else f" (a {scene.kind}, taken for a perspective one)"
    )
    notes = [
        f"{name}: {first}position and direction of the camera{kind} kept; field of view {optics.fov_h_deg:g} x {optics.fov_v_deg:g} "
        f"degrees, {rows} x {cols} pixels, sampler and integrator are the sensor's"
    ]
    if scene.emitters:
        notes.append(
            f"{name}: {scene.emitters} emitters left out: the laser lights the scene, and klux stands for the sky"
        )
    return notes
