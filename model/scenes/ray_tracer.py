# SPDX-License-Identifier: Apache-2.0
"""Ray tracing: from a Mitsuba scene to transients (`transient.py`), with mitransient's
volumetric path tracer.

Laser and camera are our own. Both are at one point, which sees and lights rows x cols pixels of
equal size on a plane that faces it. Each light path ends at a surface or in a medium that the
laser lights. The way there and back is added up, and so is the light. The sums are integers,
which do not depend on the order, so the number of threads does not change a bit of the result.

Importing this module loads Mitsuba (`ray_scene.py` finds its LLVM first), in the variant
`VARIANT`: one wavelength, and colours count by their luminance.
"""

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from attrs import frozen

from ..shared.constants import SPEED_OF_LIGHT_M_S
from ..shared.errors import InputError
from ..shared.files import FilePath
from .transient import BIN_S, Transient, dominant_surface_m, sparse

VARIANT = "llvm_ad_mono"
mi.set_variant(VARIANT)
mi.set_log_level(mi.LogLevel.Error)

from mitransient.integrators.transient_prbvolpath import TransientPRBVolpathIntegrator  # noqa: E402 (wants the variant)

SAMPLE_SIDE = 32  # samples of a pixel form a square of this side, one in each cell of a grid
GEOMETRY_SIDE = 16  # the same for the surfaces alone
VERTICES_MAX, ROULETTE_FROM = 24, 6
CROSSINGS_MAX = 32  # panes, mirrors and borders of media that a path passes in a row
TABLE_BINS = 1 << 23  # bins that are filled at the same time
UNIT = 1 << 36  # of the integer sums: 1 / m2 of a sample
STRENGTH_MAX_PER_M2 = 1e5  # limit for a sample
CONE_SLACK = 1 + 1e-4  # tolerance for rounding at the border of the laser's beam
STRAIGHT = mi.BSDFFlags.Null | mi.BSDFFlags.DeltaTransmission
BIN_M = BIN_S * SPEED_OF_LIGHT_M_S
_NOT_OURS = {
    mi.ObjectType.Emitter,
    mi.ObjectType.Integrator,
    mi.ObjectType.Film,
    mi.ObjectType.Sampler,
}


class Retroreflective(mi.BSDF):
    """BSDF `retroreflective`: sends `reflectance` (0.2) of the light back to its origin, within
    `divergence` (sigma, 1 degree).

    The lobe is a von Mises-Fisher law around the direction of incidence. The defaults give 104
    cd/lx/m2 if source and eye are at one place, like a road sign of the simplest sheeting; a
    white wall gives 0.3.
    """

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.reflectance = props.get("reflectance", 0.2)
        divergence = props.get("divergence", 1.0)
        if not 0 <= self.reflectance <= 1 or not 0.01 <= divergence <= 45:
            raise RuntimeError(
                "retroreflective: reflectance must be from 0 to 1, divergence from 0.01 to 45 degrees"
            )
        self.concentration = 1 / math.radians(divergence) ** 2
        self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
        self.m_flags = self.m_components[0]

    def sample(self, ctx, si, sample1, sample2, active):
        local = mi.warp.square_to_von_mises_fisher(sample2, self.concentration)
        sampled = dr.zeros(mi.BSDFSample3f)
        sampled.wo = mi.Frame3f(si.wi).to_world(local)
        sampled.pdf = mi.warp.square_to_von_mises_fisher_pdf(local, self.concentration)
        sampled.eta = 1.0
        sampled.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
        sampled.sampled_component = 0
        active = active & (si.wi.z > 0) & (sampled.wo.z > 0)
        return sampled, dr.select(active, mi.Spectrum(self.reflectance), 0)

    def eval_pdf(self, ctx, si, wo, active):
        pdf = mi.warp.square_to_von_mises_fisher_pdf(
            mi.Frame3f(si.wi).to_local(wo), self.concentration
        )
        pdf = dr.select(active & (si.wi.z > 0) & (wo.z > 0), pdf, 0)
        return mi.Spectrum(pdf * self.reflectance), pdf

    def eval(self, ctx, si, wo, active):
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(self, ctx, si, wo, active):
        return self.eval_pdf(ctx, si, wo, active)[1]

    def to_string(self):
        return f"Retroreflective[reflectance={self.reflectance}]"


mi.register_bsdf("retroreflective", Retroreflective)


@frozen(eq=False)
class RayScene:
    """A parsed scene file (`path`) without its emitters, film, sampler and integrator.

    position, axes: of the camera; columns of `axes` (float64[3, 3]): its left, up and forward.
    emitters: number of emitters left out. cameras: number in the file; the first one is used.
    kind: its plugin. files: everything that the scene is made of, by name.
    """

    path: Path
    state: Any
    config: Any
    position: np.ndarray
    axes: np.ndarray
    emitters: int
    cameras: int
    kind: str
    files: dict[str, bytes]


def read_scene(path: FilePath) -> RayScene:
    """Parse a scene file. Raises `InputError`."""
    config = mi.parser.ParserConfig(VARIANT)
    config.merge_meshes = False
    try:
        with _files_beside(path):
            state = mi.parser.parse_file(config, str(path))
            mi.parser.transform_all(config, state)
            files = _contents(state)
    except Exception as error:  # plugins raise any exception
        raise InputError(_one_line(path, error)) from None
    nodes = state.nodes
    kinds = [node.type for node in nodes]
    if kinds[0] != mi.ObjectType.Scene:
        raise InputError(f"{path}: holds a {nodes[0].props.plugin_name()}, must hold a scene")
    cameras = [node.props for node in nodes if node.type == mi.ObjectType.Sensor]
    if not cameras:
        raise InputError(
            f'{path}: has no camera, must have a <sensor type="perspective"> that says where the LiDAR stands and looks'
        )
    camera = cameras[0]
    for node in nodes:
        for name in list(node.props.keys()):
            if node.props.type(name) == mi.Properties.Type.ResolvedReference:
                kind = kinds[node.props[name].index()]
                if kind == mi.ObjectType.Medium and node.type == mi.ObjectType.Sensor:
                    raise InputError(
                        f"{path}: the camera is inside a medium, must be outside of its border"
                    )
                if kind in _NOT_OURS:
                    del node.props[name]
    position, axes = _pose(path, camera)
    emitters = kinds.count(mi.ObjectType.Emitter)
    return RayScene(
        Path(path),
        state,
        config,
        position,
        axes,
        emitters,
        len(cameras),
        camera.plugin_name(),
        files,
    )


@contextmanager
def _files_beside(path: FilePath) -> Iterator[None]:
    """Add the scene's folder to the places where its files are searched, for this scene only."""
    before = mi.file_resolver()
    resolver = mi.FileResolver(before)
    resolver.prepend(str(Path(path).resolve().parent))
    mi.set_file_resolver(resolver)
    try:
        yield
    finally:
        mi.set_file_resolver(before)


def _one_line(path: FilePath, error: Exception) -> str:
    """Return Mitsuba's message about `path`, without the lines of its own source."""
    words = " ".join(
        part.split("] ", 1)[-1] if part.startswith("[") else part.strip()
        for part in str(error).splitlines()
    )
    return f"{path}: is not a scene that Mitsuba reads ({words})"


def _pose(path: FilePath, camera: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return position and axes; scale and shear of the transform are dropped, but a mirror image
    is kept.
    """
    if "to_world" not in camera.keys():
        return np.zeros(3), np.eye(3)
    matrix = np.array(camera["to_world"].matrix, np.float64)
    length = np.linalg.norm(matrix[:3, :3], axis=0)
    if matrix.shape != (4, 4) or not np.all(np.isfinite(matrix)) or length.min() <= 0:
        raise InputError(f"{path}: the camera's to_world must be a rotation and a translation")
    return matrix[:3, 3], matrix[:3, :3] / length


def _contents(state: Any) -> dict[str, bytes]:
    """Return the scene's files and those that they name, by the names that they use."""
    files = {str(path): Path(str(path)).read_bytes() for path in state.files}
    for node in state.nodes:
        for name in node.props.keys():
            if node.props.type(name) == mi.Properties.Type.String:
                path = str(mi.file_resolver().resolve(node.props[name]))
                if os.path.isfile(path):
                    files[node.props[name]] = Path(path).read_bytes()
    return files


class _Lidar(TransientPRBVolpathIntegrator):
    """Path tracer whose only light is the laser, at the camera. Connections to the laser pass
    panes and media.

    They go straight through surfaces that transmit without scattering, which is right for panes
    but not for lenses.
    Units: radiance for a laser of 1 W.
    """

    def __init__(self, scene: RayScene, tan_h: float, tan_v: float):
        super().__init__(mi.Properties())
        self.max_depth, self.rr_depth, self.hide_emitters = VERTICES_MAX, ROULETTE_FROM, False
        self.tan_h, self.tan_v = tan_h, tan_v
        # Variables and not literals: in a product with the literal 0, Dr.Jit 1.5.0 gives that
        # literal the size of the other factor, wherever else it is used.
        self.position = mi.Point3f(*_opaque(scene.position))
        self.axes = [mi.Vector3f(*_opaque(axis)) for axis in scene.axes.T]
        self.inverse = [mi.Vector3f(*_opaque(row)) for row in np.linalg.inv(scene.axes)]

    def irradiance(self, p):
        """Return W/m2 at `p` on a surface that faces the laser; a plane that faces the camera is
        lit evenly in the view.
        """
        local = mi.Vector3f(*(dr.dot(row, p - self.position) for row in self.inverse))
        reach = CONE_SLACK * local.z
        inside = (
            (local.z > 0)
            & (dr.abs(local.x) <= self.tan_h * reach)
            & (dr.abs(local.y) <= self.tan_v * reach)
        )
        square = dr.squared_norm(local)
        cosine = local.z * dr.rsqrt(square)
        return dr.select(
            inside, dr.rcp(4 * self.tan_h * self.tan_v * cosine * cosine * cosine * square), 0
        )

    @dr.syntax
    def sample_emitter(
        self, mei, si, active_medium, active_surface, scene, sampler, medium, channel, active, **_
    ):
        """Return (irradiance, direction to the laser) for vertices in a medium and on surfaces."""
        vertex = dr.zeros(mi.Interaction3f)
        vertex[active_medium] = mei
        vertex[active_surface] = si
        active = mi.Bool(active)
        to_laser = dr.zeros(mi.DirectionSample3f)
        to_laser.p = self.position
        to_laser.d = self.position - vertex.p
        to_laser.dist = dr.norm(to_laser.d)
        to_laser.d /= to_laser.dist
        to_laser.pdf, to_laser.delta = mi.Float(1), mi.Bool(True)
        light = mi.Spectrum(self.irradiance(vertex.p))
        active &= light.x > 0
        medium = dr.select(active, medium, dr.zeros(mi.MediumPtr))
        medium[active_surface & si.is_medium_transition()] = si.target_medium(to_laser.d)
        ray = vertex.spawn_ray_to(to_laser.p)
        left = mi.Float(ray.maxt)
        straight = mi.BSDFContext()
        straight.type_mask = +STRAIGHT
        while dr.hint(active, label="to the laser"):
            ray.maxt = left
            hit = scene.ray_intersect(ray, active)
            inside = active & (medium != None)  # noqa: E711 (an array of pointers)
            leg = medium.sample_interaction(ray, 0.5, channel, inside)
            leg.t = dr.minimum(left, hit.t)
            light[inside] *= medium.transmittance_eval_pdf(leg, hit, inside)[0]
            active &= hit.is_valid()
            passed, weight = hit.bsdf(ray).sample(
                straight, hit, sampler.next_1d(active), sampler.next_2d(active), active
            )
            goes_on = mi.has_flag(passed.sampled_type, mi.BSDFFlags.Null) | mi.has_flag(
                passed.sampled_type, mi.BSDFFlags.DeltaTransmission
            )
            light[active] *= dr.select(goes_on, weight, 0)
            active &= light.x > 0
            left -= hit.t
            ray = hit.spawn_ray(ray.d)
            crossed = active & hit.is_medium_transition()
            medium[crossed] = hit.target_medium(ray.d)
        return light, to_laser

    @dr.syntax
    def surfaces(self, scene, sampler, ray):
        """Return (distance, ambient) of each ray.

        distance: to the first surface that scatters, infinite into the sky. ambient: brightness
        of the ray under light that is the same everywhere, where media scatter all light that
        they take.
        """
        active, through, medium = mi.Bool(True), mi.Float(1), dr.zeros(mi.MediumPtr)
        distance, clear, eta, crossings = mi.Float(0), mi.Float(1), mi.Float(1), mi.UInt32(0)
        while dr.hint(active, label="to the first surface"):
            hit = scene.ray_intersect(ray, active)
            inside = active & (medium != None)  # noqa: E711
            leg = medium.sample_interaction(ray, 0.5, 0, inside)
            leg.t = mi.Float(hit.t)
            clear[inside] *= medium.transmittance_eval_pdf(leg, hit, inside)[0].x
            distance[active] += dr.select(hit.is_valid(), hit.t * eta, dr.inf)
            active &= hit.is_valid()
            sampled, weight = hit.bsdf(ray).sample(
                mi.BSDFContext(), hit, sampler.next_1d(active), sampler.next_2d(active), active
            )
            through[active] *= weight.x
            active &= mi.has_flag(sampled.sampled_type, mi.BSDFFlags.Delta) | mi.has_flag(
                sampled.sampled_type, mi.BSDFFlags.Null
            )
            eta[active] *= sampled.eta
            ray[active] = hit.spawn_ray(hit.to_world(sampled.wo))
            crossed = active & hit.is_medium_transition()
            medium[crossed] = hit.target_medium(ray.d)
            crossings += 1
            active &= crossings < CROSSINGS_MAX
        return distance, 1 - clear + clear * through


def _opaque(values: np.ndarray) -> list[Any]:
    return [dr.opaque(mi.Float, value) for value in values.tolist()]


def render(
    scene: RayScene, rows: int, cols: int, *, fov_h_deg: float, fov_v_deg: float, stop_s: float
) -> Transient:
    """Return the transients of rows x cols pixels in the field of view, for flights up to
    `stop_s`. Raises `InputError`.
    """
    try:
        with _files_beside(scene.path):
            world = mi.parser.instantiate(scene.config, scene.state)
    except Exception as error:  # plugins raise any exception
        raise InputError(_one_line(scene.path, error)) from None
    _check_media(world, scene.path)
    tan_h, tan_v = (math.tan(math.radians(angle) / 2) for angle in (fov_h_deg, fov_v_deg))
    lidar = _Lidar(scene, tan_h, tan_v)
    pixels, bins = rows * cols, math.ceil(stop_s / BIN_S)
    block = max(1, min(pixels, TABLE_BINS // bins))
    counts: list[np.ndarray] = []
    index: list[np.ndarray] = []
    strength: list[np.ndarray] = []
    ambient, surface_m, lost = [], [], 0
    with dr.suspend_grad():
        for first in range(0, pixels, block):
            n = min(block, pixels - first)
            distance, seen = (
                np.array(part, np.float64).reshape(n, -1)
                for part in lidar.surfaces(
                    world, *_rays(lidar, rows, cols, first, n, GEOMETRY_SIDE, seed=2 * first)[:2]
                )
            )
            surface_m.append(dominant_surface_m(distance))
            ambient.append(seen.mean(axis=1))
            table, beyond = _histogram(lidar, world, rows, cols, first, n, bins)
            lost += beyond
            for where, part in zip((counts, index, strength), sparse(table), strict=True):
                where.append(part)
    return Transient(
        first=np.r_[0, np.cumsum(np.concatenate(counts))],
        index=np.concatenate(index),
        strength_per_m2=np.concatenate(strength) / (UNIT * SAMPLE_SIDE**2),
        lost_per_m2=lost / (UNIT * SAMPLE_SIDE**2),
        ambient=np.concatenate(ambient).reshape(rows, cols),
        surface_m=np.concatenate(surface_m).reshape(rows, cols),
    )


def _check_media(world: Any, path: FilePath) -> None:
    """Refuse heterogeneous media: mitransient 1.3.1 omits the way between null collisions, so
    times are too short.
    """
    media = [
        medium
        for shape in world.shapes()
        for medium in (shape.interior_medium(), shape.exterior_medium())
        if medium
    ]
    if any(not medium.is_homogeneous() for medium in media):
        raise InputError(
            f"{path}: has a heterogeneous medium, must be homogeneous (times of flight in others are not followed)"
        )


def _rays(
    lidar: _Lidar, rows: int, cols: int, first: int, n: int, side: int, seed: int
) -> tuple[Any, Any, Any]:
    """Return (sampler, rays, pixel of each ray in the block): side x side rays for each pixel,
    one per cell of a grid.
    """
    lanes = n * side * side
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, lanes)
    lane = dr.arange(mi.UInt32, lanes)
    local, cell = lane // (side * side), lane % (side * side)
    pixel = local + dr.opaque(mi.UInt32, first)
    u = (mi.Float(cell % side) + sampler.next_1d()) / side
    v = (mi.Float(cell // side) + sampler.next_1d()) / side
    left = (1 - 2 * (mi.Float(pixel % cols) + u) / cols) * lidar.tan_h
    up = (1 - 2 * (mi.Float(pixel // cols) + v) / rows) * lidar.tan_v
    to_left, to_up, forward = lidar.axes
    return (
        sampler,
        mi.Ray3f(lidar.position, dr.normalize(left * to_left + up * to_up + forward)),
        local,
    )


def _histogram(
    lidar: _Lidar, world: Any, rows: int, cols: int, first: int, n: int, bins: int
) -> tuple[np.ndarray, int]:
    """Return (uint64[n, bins], later light): sums over the samples of a pixel, in `UNIT`."""
    sampler, ray, local = _rays(lidar, rows, cols, first, n, SAMPLE_SIDE, seed=2 * first + 1)
    table, beyond = dr.zeros(mi.UInt64, n * bins), dr.zeros(mi.UInt64, 1)
    to_strength = 4 * lidar.tan_h * lidar.tan_v  # from radiance for 1 W to the unit of `Transient`

    def add_transient(radiance, way_m, _, active):
        value = mi.UInt64(dr.minimum(radiance.x * to_strength, STRENGTH_MAX_PER_M2) * UNIT + 0.5)
        active = active & (radiance.x > 0)
        recorded = way_m < bins * BIN_M
        dr.scatter_add(table, value, local * bins + mi.UInt32(way_m / BIN_M), active & recorded)
        dr.scatter_add(beyond, value, 0, active & ~recorded)

    lidar.sample(
        mode=dr.ADMode.Primal,
        scene=world,
        sampler=sampler,
        ray=ray,
        β=mi.Spectrum(1),
        δL=None,
        state_in=None,
        active=mi.Bool(True),
        add_transient=add_transient,
    )
    dr.eval(table, beyond)
    return np.array(table).reshape(n, bins), int(np.array(beyond)[0])
