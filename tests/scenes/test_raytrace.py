# SPDX-License-Identifier: Apache-2.0
"""Ray-traced scenes: transients to edges, behaviour without the extra, and the renderer against
closed forms.
"""

import math
import re
from importlib.metadata import PackageNotFoundError
from types import SimpleNamespace

import numpy as np
import pytest
from attrs import evolve, fields_dict
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage, stats

from coincid.model.contract.config import load_config
from coincid.model.depth.estimate import estimate_depth
from coincid.model.light.light import Arrivals, Light
from coincid.model.light.link_budget import Laser, Optics, link_budget
from coincid.model.light.photons import generate_edges
from coincid.model.light.spad import Spad
from coincid.model.light.timing import Timing
from coincid.model.scenes import ray_scene
from coincid.model.scenes.catalogue import RANGE_M, load_scene
from coincid.model.scenes.scene import Scene, scene_light
from coincid.model.scenes.transient import BIN_S, Transient, dominant_surface_m
from coincid.model.shared.constants import SPEED_OF_LIGHT_M_S
from coincid.model.shared.errors import InputError

from ..command import command
from ..transients import synthetic

LEVEL = 1e-3
BARE = Spad(dead_time_s=0, jitter_fwhm_s=0)
BIN_M = BIN_S * SPEED_OF_LIGHT_M_S / 2
TICK_M = Timing().tick_m
BINS_PER_TICK = round(Timing().tick_s / BIN_S)


def photons_in(light):
    """float64[pixels]: photons per pulse in the light's bins."""
    return np.diff(np.r_[0, np.cumsum(light.arrivals.photons)][light.arrivals.first])


def test_energy_is_conserved_from_transient_to_edges():
    """Chi-square over (pixel, tick), and over the counts of single pulses: the edges are those
    photons, Poisson-distributed.
    """
    random = np.random.default_rng(1)
    table = np.zeros((4, 4, 4000 * BINS_PER_TICK))
    for row in table.reshape(16, -1):
        row[random.integers(0, row.size, 12)] = random.exponential(2e-4, 12)
    pulses = 20_000
    light = synthetic(table).light(0.0, system_fwhm_s=0.0)
    edges = generate_edges(light, BARE, Timing(), pulses=pulses, seed=1)
    expected = (
        table.reshape(16, -1, BINS_PER_TICK).sum(2) * pulses * photons_in(light).sum() / table.sum()
    )
    seen = np.bincount(edges.pixel * 8000 + edges.tick, minlength=16 * 8000).reshape(16, 8000)
    assert np.all(seen[:, 4000:] == 0) and np.all(seen[:, :4000][expected == 0] == 0)
    lit = expected > 0
    assert (
        stats.chi2.sf((((seen[:, :4000] - expected)[lit]) ** 2 / expected[lit]).sum(), lit.sum())
        > LEVEL
    )
    per_pulse = np.bincount(edges.pulse, minlength=pulses)
    assert stats.chi2.sf(per_pulse.var() * pulses / per_pulse.mean(), pulses - 1) > LEVEL


@pytest.mark.parametrize(
    ("changed", "factor"),
    [
        ({"laser": Laser(average_power_w=20e-3)}, 2),
        ({"laser": Laser(repetition_hz=4e6)}, 1 / 2),
        ({"laser": Laser(wavelength_nm=940.0)}, 940 / 905),
        ({"optics": Optics(lens_diameter_m=42e-3)}, 4),
        ({"optics": Optics(transmission=0.4)}, 1 / 2),
        ({"optics": Optics(pixels=4096)}, 1 / 4),
    ],
)
def test_the_light_of_a_transient_is_in_proportion_to_laser_and_lens(changed, factor):
    transient = synthetic(np.full((2, 3, 5), 1e-4))
    usual = photons_in(transient.light(0.0))
    assert photons_in(transient.light(0.0, **changed)) == pytest.approx(factor * usual)


def test_one_unit_is_equation_1():
    """The return of a Lambertian surface, r / (pi d^2), gives the link budget's photons, in the
    corrected form.
    """
    table = np.zeros((1, 1, 2000))
    table[0, 0, 1700] = 0.4 / (math.pi * 4.0**2)
    light = synthetic(table).light(50)
    assert photons_in(light)[0] == pytest.approx(
        link_budget(4.0, 0.4, 0, form="corrected").signal_per_pulse, rel=1e-12
    )
    assert light.background_cps[0] == pytest.approx(1.226e6)


@settings(max_examples=20)
@given(photons=st.lists(st.floats(0.01, 3), min_size=1, max_size=4), seed=st.integers(0, 99))
def test_bins_without_width_are_targets(photons, seed):
    """The edges are the same, whether a distribution is given as targets or as bins."""
    start_s = 40e-9 * np.arange(1, len(photons) + 1)
    common = dict(rows=1, cols=1, background_cps=2e6)
    targets = Light(
        distance_m=start_s[None] * SPEED_OF_LIGHT_M_S / 2,
        signal_per_pulse=np.array([photons]),
        **common,
    )
    arrivals = Arrivals(first=[0, len(photons)], start_s=start_s, photons=photons)
    bins = Light(distance_m=np.nan, signal_per_pulse=0.0, arrivals=arrivals, **common)
    a, b = (
        generate_edges(light, Spad(), Timing(), pulses=50, seed=seed) for light in (targets, bins)
    )
    assert np.array_equal(a.pulse, b.pulse)
    assert np.abs(a.tick - b.tick).max(initial=0) <= 1 and np.mean(a.tick == b.tick) > 0.9


@pytest.mark.parametrize(
    "wrong, words",
    [
        (dict(first=[0, 2]), "first: must ascend from 0 to the 3 bins"),
        (dict(first=[0, 4, 3]), "first: must ascend"),
        (dict(start_s=[1e-9, 3e-9, 2e-9]), "start_s: must ascend in every pixel"),
        (dict(photons=[1.0, -1.0, 0.0]), "photons"),
        (dict(photons=[[1.0, 1.0, 1.0]]), r"photons: has shape \(1, 3\), must have a number per"),
        (dict(first=[0, 1, 3]), "arrivals: has 2 pixels, must have 1"),
    ],
)
def test_wrong_arrivals(wrong, words):
    given = dict(first=[0, 3], start_s=[1e-9, 2e-9, 3e-9], photons=[1.0, 1.0, 1.0]) | wrong
    with pytest.raises(InputError, match=words):
        Light(rows=1, cols=1, distance_m=np.nan, signal_per_pulse=0.0, arrivals=Arrivals(**given))


def test_arrivals_may_restart_in_every_pixel():
    arrivals = Arrivals(first=[0, 2, 2, 3], start_s=[1e-9, 2e-9, 0.0], photons=[1.0, 1.0, 1.0])
    light = Light(rows=1, cols=3, distance_m=np.nan, signal_per_pulse=0.0, arrivals=arrivals)
    assert len(generate_edges(light, BARE, Timing(), pulses=200, seed=1)) > 400


def test_surface_that_fills_most_of_a_pixel():
    sky = np.inf
    samples_m = np.array(
        [
            [5, 5.1, 9, 9.1, 9.2],
            [5, 5.1, 5.2, sky, sky],
            [5, sky, sky, sky, sky],
            [sky] * 5,
            [4, 4, 9, 9, sky],
            [7, 7.1, 9, sky, sky],
        ]
    )
    assert dominant_surface_m(samples_m) == pytest.approx([9.1, 5.1, sky, sky, 4, 7.05])


def test_transient_file_and_depth(tmp_path):
    table = np.zeros((1, 2, 900))
    table[0, 0, [200, 201, 800]] = 1, 2, 1.5
    transient = evolve(synthetic(table, surface_m=[[5.0, 6.0]], ambient=0.3), lost_per_m2=0.25)
    transient.save(tmp_path / "t.npz")
    again = Transient.load(tmp_path / "t.npz")
    for name in fields_dict(Transient):
        assert np.array_equal(getattr(again, name), getattr(transient, name)), name
    assert isinstance(again.lost_per_m2, float)
    assert again.depth_m()[0, 0] == pytest.approx((201 + 1 / 6) * BIN_M) and np.isnan(
        again.depth_m()[0, 1]
    )
    assert again.total_per_m2.tolist() == [[4.5, 0]]
    scene = Scene(name="t", distance_m=[[5.0, 6.0]], reflectivity=0.4, transient=again)
    assert np.array_equal(
        scene.surfaces_m, [[[5, again.depth_m()[0, 0]], [6, np.nan]]], equal_nan=True
    )


def test_shade_lies_on_a_ray_traced_scene_as_on_another_one():
    """The sun leaves as much light as the scene's part of it says."""
    transient = synthetic(np.full((1, 2, 5), 1e-4))
    scene = Scene(
        name="t", distance_m=[[5.0, 6.0]], reflectivity=0.4, transient=transient, sunlit=[[1, 0.1]]
    )
    in_sun, in_shade = (
        scene_light(scene, 50.0).total_background_cps - scene_light(scene, 0.0).total_background_cps
    )
    assert in_sun > 0
    assert in_shade == pytest.approx(0.1 * in_sun)


@pytest.fixture
def stub(monkeypatch, tmp_path):
    """A renderer that returns `stub.transient` for any file, and counts its calls; it does not need
    the extra.
    """
    monkeypatch.setenv("COINCID_BUILD", str(tmp_path / "build"))
    path, transient = tmp_path / "scene.xml", synthetic(np.ones((2, 2, 10)))
    made = SimpleNamespace(
        renders=0, contents=b"1", path=path, transient=transient, beside={}, emitters=3
    )
    made.path.touch()

    def render(*_, **__):
        made.renders += 1
        return made.transient

    read = SimpleNamespace(cameras=2, kind="orthographic")
    tracer = SimpleNamespace(
        render=render,
        read_scene=lambda path: SimpleNamespace(
            files={"scene": made.contents, **made.beside}, emitters=made.emitters, **vars(read)
        ),
    )
    monkeypatch.setattr(ray_scene, "_tracer", lambda: tracer)
    monkeypatch.setattr(ray_scene, "version", lambda name: "1")
    return made


def test_rendered_once_for_each_content(stub):
    for contents, size, renders in (
        (b"1", 2, 1),
        (b"1", 2, 1),
        (b"2", 2, 2),
        (b"1", 2, 2),
        (b"1", 4, 3),
    ):
        stub.contents = contents
        load_scene(str(stub.path), size, 2)
        assert stub.renders == renders


def test_a_rendering_is_kept_for_all_that_it_depends_on(stub, monkeypatch):
    """Files in their places, size, view, range, packages and the code of this project."""

    def is_rendered(rows=2, cols=2, **options):
        before = stub.renders
        ray_scene.ray_scene(str(stub.path), rows, cols, **{"range_m": 50.0} | options)
        assert stub.renders - before in (0, 1)
        return stub.renders > before

    def is_new(**options):
        """Once: it is kept from then on."""
        return is_rendered(**options) and not is_rendered(**options)

    assert is_new()
    for beside in ({"a": b"1", "b": b"23"}, {"a": b"23", "b": b"1"}, {"a": b"12", "b": b"3"}):
        stub.beside = beside
        assert is_new()
    for options in (
        {"rows": 4},
        {"cols": 4},
        {"range_m": 60.0},
        {"optics": Optics(fov_h_deg=30.0)},
        {"optics": Optics(fov_v_deg=30.0)},
    ):
        assert is_new(**options)
    for package in ray_scene.PACKAGES:
        monkeypatch.setattr(ray_scene, "version", lambda name, new=package: str(name == new))
        assert is_new()
    monkeypatch.setattr(ray_scene, "sources_digest", lambda room: "other code")
    assert is_new()


def test_what_is_overridden_is_said(stub):
    kept, emitters, metres = load_scene(str(stub.path), 2, 2).notes
    for words in (
        "first of 2 cameras",
        "orthographic, taken for a perspective one",
        "45 x 45 degrees, 2 x 2 pixels",
    ):
        assert words in kept
    assert (
        "3 emitters left out" in emitters
        and "taken for metres" in metres
        and "warning" not in metres
    )


@pytest.mark.parametrize("emitters", [0, 1])
def test_emitters_are_told_if_there_are_any(stub, emitters):
    stub.emitters = emitters
    notes = " ".join(load_scene(str(stub.path), 2, 2).notes)
    assert (f"{emitters} emitters left out" in notes) == (emitters > 0)


@pytest.mark.parametrize(
    ("surface_m", "range_m", "is_doubtful"),
    [(30.0, 50.0, True), (24.0, 50.0, False), (60.0, 150.0, False), (0.31, 50.0, False)],
)
def test_surfaces_are_doubtful_if_half_of_them_lie_in_the_far_half_of_the_range(
    stub, surface_m, range_m, is_doubtful
):
    """Or very near; the file may have another unit."""
    stub.transient = synthetic(np.ones((2, 2, 10)), surface_m)
    assert bool(load_scene(str(stub.path), 2, 2, range_m=range_m).doubts) == is_doubtful


@pytest.mark.parametrize(
    "surface_m, masked, words",
    [
        (
            [[5, 80], [5, 5]],
            1,
            "1 of 4 pixels at or beyond the laser period's range of 74.95 m are masked",
        ),
        ([[5, 0.01], [5, 5]], 1, "1 of 4 pixels nearer than 0.05 m are masked"),
        ([[5, 5], [np.inf, np.inf]], 2, "2 of 4 pixels without a surface are masked"),
        (
            60.0,
            0,
            "surfaces from 60 to 60 m, the file's units taken for metres, which is doubtful",
        ),
        (0.1, 0, "doubtful"),
    ],
)
def test_pixels_without_a_truth_are_masked(stub, surface_m, masked, words):
    stub.transient = synthetic(np.ones((2, 2, 10)), surface_m)
    scene = load_scene(str(stub.path), 2, 2)
    assert np.isnan(scene.truth_m).sum() == masked
    assert any(re.search(words, told) for told in (*scene.doubts, *scene.notes))
    assert photons_in(scene_light(scene, 50)).min() > 0  # their light stays


@pytest.mark.parametrize(
    ("returned", "lost", "told"),
    [
        (1.0, 10.0, "20.0% of the light comes after 2 laser periods and is left out"),
        (1.0, 0.05, "0.1% of the light comes after 2 laser periods and is left out"),
        (1.0, 0.03, ""),
        (0.0, 0.0, "nothing of the laser's light comes back"),
        (0.0, 1.0, "nothing of the laser's light comes back"),
    ],
)
def test_light_that_does_not_come_back_in_time_is_told_as_a_share_of_all(
    stub, returned, lost, told
):
    """Of 40 bins with light. A hardly noticeable share is not told."""
    stub.transient = evolve(synthetic(np.full((2, 2, 10), returned)), lost_per_m2=lost)
    scene = load_scene(str(stub.path), 2, 2)
    words = " ".join((*scene.doubts, *scene.notes))
    assert (told in words) if told else ("comes after" not in words and "nothing" not in words)
    assert bool(scene.doubts) == (returned == 0)


def test_what_is_brighter_than_white_is_white(stub):
    """Such as the open sky behind a lens; the background keeps its light."""
    stub.transient = synthetic(np.ones((2, 2, 10)), ambient=1.5)
    scene = load_scene(str(stub.path), 2, 2)
    assert np.all(scene.reflectivity == 1)
    assert scene_light(scene, 50).background_cps == pytest.approx(1.226e6 * 1.5 / 0.4)


@pytest.mark.parametrize(
    "surface_m, words",
    [
        (np.inf, "the camera sees no surface"),
        (
            800.0,
            "surfaces from 800 to 800 m, the file's units taken for metres: all are .* beyond the laser period's range of 74.95 m",
        ),
    ],
)
def test_scene_that_cannot_be_told(stub, surface_m, words):
    stub.transient = synthetic(np.ones((2, 2, 10)), surface_m)
    with pytest.raises(InputError, match=words):
        load_scene(str(stub.path), 2, 2)


def test_without_the_extra(monkeypatch, tmp_path):
    def missing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(ray_scene, "version", missing)
    told = command("sim --scene ray:corner --engine golden --out", tmp_path)
    assert told.exit_code == 2
    assert told.stderr == (
        "coincid: ray-traced scenes need mitsuba, which is not installed; run: make raytrace "
        "(without a checkout: pip install 'coincid[raytrace]')\n"
    )


def test_without_llvm(monkeypatch):
    monkeypatch.setattr(ray_scene, "version", lambda name: "1")
    monkeypatch.setattr(ray_scene, "LLVM_LIBRARIES", ("libnothing.so",))
    monkeypatch.delenv(ray_scene.LLVM_VARIABLE, raising=False)
    with pytest.raises(
        InputError, match=r"need the library of LLVM 17 or newer .*libllvm19.* run: make raytrace"
    ):
        load_scene("ray:corner", 8, 8)


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (("libnothing.so", "libc.so.6"), "libc.so.6"),
        (("libnothing.so", "libnone.so", "libm.so.6", "libc.so.6"), "libm.so.6"),
        (("libc.so.6", "libm.so.6", "libnothing.so"), "libc.so.6"),
    ],
)
def test_the_llvm_is_the_first_that_the_loader_finds(monkeypatch, names, found):
    """Those before it are not installed; those after it are not taken."""
    monkeypatch.setattr(ray_scene, "LLVM_LIBRARIES", names)
    assert ray_scene.llvm_library() == found


@pytest.mark.parametrize(
    "source, words",
    [("ray:moon", "must be one of ray:five-objects"), ("nothing.xml", "no such file")],
)
def test_unknown_scene(source, words):
    with pytest.raises(InputError, match=words):
        load_scene(source, 8, 8)


def test_a_folder_is_no_scene(tmp_path):
    """Though its name ends as that of one does."""
    folder = tmp_path / "walls.xml"
    folder.mkdir()
    with pytest.raises(InputError, match=f"^{re.escape(str(folder))}: no such file"):
        load_scene(str(folder), 8, 8)


@pytest.fixture(scope="module")
def tracer():
    """The renderer."""
    return ray_scene._tracer()


CAMERA = '<sensor type="perspective"/>'


def scene_file(path, body, camera=CAMERA):
    path.write_text(f'<scene version="3.0.0">{camera}{body}</scene>', encoding="utf-8")
    return path


def wall(distance_m):
    return (
        '<shape type="rectangle"><bsdf type="diffuse"><rgb name="reflectance" value="0.4"/></bsdf><transform name="to_world">'
        f'<scale value="100"/><rotate y="1" angle="180"/><translate z="{distance_m}"/></transform></shape>'
    )


def rendered(tracer, path, rows=8, cols=8, stop_s=1e-6, fov_h_deg=45, fov_v_deg=45):
    return tracer.render(
        tracer.read_scene(path), rows, cols, fov_h_deg=fov_h_deg, fov_v_deg=fov_v_deg, stop_s=stop_s
    )


@pytest.mark.parametrize("distance_m", [1, 4, 10, 50])
@pytest.mark.needs("raytrace")
def test_flat_wall_is_the_link_budget(tracer, tmp_path, distance_m):
    """The rate is right within 2 %, in the corrected form; the range within a tick."""
    transient = rendered(tracer, scene_file(tmp_path / "wall.xml", wall(distance_m)))
    budget = link_budget(float(distance_m), 0.4, 0, form="corrected")
    assert photons_in(transient.light(0)) == pytest.approx(
        np.full(64, budget.signal_per_pulse), rel=0.02
    )
    across = (np.arange(8 * 64) + 0.5) / 256 - 1  # of the field of view, 64 points per pixel
    square = (across * math.tan(math.pi / 8)) ** 2
    from_geometry_m = distance_m * np.sqrt(1 + square[:, None] + square).reshape(8, 64, 8, 64).mean(
        axis=(1, 3)
    )
    weighed = np.add.reduceat(
        transient.strength_per_m2 * (transient.index + 0.5), transient.first[:-1]
    )
    mean_m = weighed / transient.total_per_m2.ravel() * BIN_M
    assert np.abs(mean_m - from_geometry_m.ravel()).max() < TICK_M
    assert np.abs(transient.surface_m - from_geometry_m).max() < TICK_M
    assert transient.ambient == pytest.approx(np.full((8, 8), 0.4), rel=1e-4)


@pytest.mark.parametrize(("fov_h_deg", "fov_v_deg"), [(80, 20), (20, 80)])
@pytest.mark.needs("raytrace")
def test_a_field_of_view_need_not_be_square(tracer, tmp_path, fov_h_deg, fov_v_deg):
    """Columns and rows see a flat wall where they lie, each with its own angle, and all is lit."""
    rows, cols = 3, 5
    path = scene_file(tmp_path / "wall.xml", wall(4))
    transient = rendered(tracer, path, rows, cols, fov_h_deg=fov_h_deg, fov_v_deg=fov_v_deg)
    left, up = (
        ((np.arange(64 * n) + 0.5) / (32 * n) - 1) * math.tan(math.radians(angle) / 2)
        for n, angle in ((cols, fov_h_deg), (rows, fov_v_deg))
    )
    points_m = 4 * np.sqrt(1 + up[:, None] ** 2 + left**2)
    from_geometry_m = points_m.reshape(rows, 64, cols, 64).mean(axis=(1, 3))
    assert np.abs(transient.surface_m - from_geometry_m).max() < TICK_M
    lit = link_budget(4.0, 0.4, 0, form="corrected").signal_per_pulse
    assert photons_in(transient.light(0)) == pytest.approx(np.full(rows * cols, lit), rel=0.02)


@pytest.mark.needs("raytrace")
def test_the_renderer_agrees_with_mitsubas_own(tracer):
    """Compare all light of a corner and of the five objects with the path integrator and a
    projector; one common constant.
    """
    import mitsuba as mi

    ratios = []
    for name in ("corner", "five-objects"):
        scene = tracer.read_scene(ray_scene.SCENES / f"{name}.xml")
        shapes = mi.parser.instantiate(scene.config, scene.state).shapes()
        film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
        same = {f"shape{i}": shape for i, shape in enumerate(shapes)} | {
            "type": "scene",
            "laser": {"type": "projector", "irradiance": 1.0, "fov": 45.0},
            "camera": {"type": "perspective", "fov": 45.0, "film": film},
        }
        steady = np.array(
            mi.render(
                mi.load_dict(same),
                integrator=mi.load_dict({"type": "path", "max_depth": 24}),
                spp=4096,
            )
        )[:, :, 0]
        ratios.append(rendered(tracer, ray_scene.SCENES / f"{name}.xml").total_per_m2 / steady)
    # pixels; Mitsuba's projector gives pi times the irradiance
    assert np.allclose(ratios, 1 / math.pi, rtol=0.06)
    assert np.mean(ratios, axis=(1, 2)) == pytest.approx([1 / math.pi] * 2, rel=0.005)


@pytest.mark.parametrize(
    ("kind", "inside", "scale"),
    [
        ("thinlens", '<float name="aperture_radius" value="0.1"/>', ""),
        ("orthographic", "", '<scale x="2" y="0.5" z="3"/>'),
    ],
)
@pytest.mark.parametrize(("target", "ball_at"), [("1,2,8", (2, 3, 8)), ("4,2,7", (4.8, 3, 6.4))])
@pytest.mark.needs("raytrace")
def test_users_camera(tracer, tmp_path, target, ball_at, kind, inside, scale):
    """The camera's position and direction are used, its scale and film are not; left is left and top
    is top in the picture.
    """
    ball = (
        '<shape type="sphere"><bsdf type="diffuse"/><float name="radius" value="0.5"/>'
        '<transform name="to_world"><translate x="1" y="1" z="5"/></transform></shape>'
    )
    straight = rendered(tracer, scene_file(tmp_path / "a.xml", ball))
    assert set(zip(*np.nonzero(np.isfinite(straight.surface_m)), strict=True)) <= {
        (row, col) for row in range(4) for col in range(4)
    }
    camera = (
        f'<sensor type="{kind}">{inside}<transform name="to_world">{scale}'
        f'<lookat origin="1,2,3" target="{target}" up="0,1,0"/></transform><film type="hdrfilm"/>'
        '<sampler type="independent"/></sensor>'
    )
    moved = ball.replace('x="1" y="1" z="5"', 'x="{}" y="{}" z="{}"'.format(*ball_at))
    elsewhere = rendered(
        tracer,
        scene_file(
            tmp_path / "b.xml",
            moved + '<integrator type="path"/><emitter type="constant"/>',
            camera,
        ),
    )
    assert elsewhere.surface_m == pytest.approx(straight.surface_m, rel=1e-5, nan_ok=True)


def camera_at(kind, origin, target, inside=""):
    looking = f'<lookat origin="{origin}" target="{target}" up="0,1,0"/>'
    return (
        f'<sensor type="{kind}"><transform name="to_world">{looking}</transform>{inside}</sensor>'
    )


@pytest.mark.needs("raytrace")
def test_of_several_cameras_the_first_one_is_read(tracer, tmp_path):
    """With its kind, its place and its axes: left, up and forward, as columns. Emitters are counted,
    also those that are part of a shape.
    """
    cameras = camera_at("orthographic", "1,2,3", "5,2,3") + camera_at(
        "perspective", "4,5,6", "4,5,9"
    )
    lamp = '<shape type="sphere"><emitter type="area"/></shape>'
    path = scene_file(tmp_path / "two.xml", lamp + '<emitter type="constant"/>' + wall(4), cameras)
    read = tracer.read_scene(str(path))
    assert (read.path, read.cameras, read.kind, read.emitters) == (path, 2, "orthographic", 2)
    assert read.position == pytest.approx([1, 2, 3])
    assert read.axes == pytest.approx(np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]), abs=1e-6)
    usual = tracer.read_scene(scene_file(tmp_path / "one.xml", wall(4)))
    assert (usual.cameras, usual.kind, usual.emitters) == (1, "perspective", 0)
    assert np.array_equal(usual.position, np.zeros(3)) and np.array_equal(usual.axes, np.eye(3))


@pytest.mark.needs("raytrace")
def test_what_is_not_the_scenes_is_left_out(tracer, tmp_path):
    """Film, sampler, integrator and emitters, wherever they stand; surfaces and media stay."""
    film = '<film type="hdrfilm"/><sampler type="independent"/>'
    medium = '<medium type="homogeneous" name="interior"/>'
    cube = f'<shape type="cube"><bsdf type="null"/>{medium}</shape>'
    lamp = '<shape type="sphere"><bsdf type="diffuse"/><emitter type="area"/></shape>'
    body = f'{lamp}{cube}<integrator type="path"/><emitter type="constant"/>'
    camera = camera_at("perspective", "0,0,0", "0,0,1", film)
    read = tracer.read_scene(scene_file(tmp_path / "all.xml", body, camera))
    names = {node.props.plugin_name(): node for node in read.state.nodes}

    def parts_of(node):
        kinds = (node.props.type(name) for name in node.props.keys())
        return sum(kind.name == "ResolvedReference" for kind in kinds)

    assert parts_of(names["scene"]) == 3  # camera, sphere and cube
    assert parts_of(names["perspective"]) == 0
    assert parts_of(names["sphere"]) == 1
    assert parts_of(names["cube"]) == 2


@pytest.mark.needs("raytrace")
def test_a_camera_in_a_medium_and_a_file_without_a_scene_are_refused(tracer, tmp_path):
    medium = '<medium type="homogeneous" name="medium"/>'
    for kind in ("perspective", "thinlens"):
        camera = camera_at(kind, "0,0,0", "0,0,1", medium)
        path = scene_file(tmp_path / "inside.xml", wall(4), camera)
        with pytest.raises(InputError) as told:
            tracer.read_scene(path)
        place = "the camera is inside a medium, must be outside of its border"
        assert str(told.value) == f"{path}: {place}"
    flat = (
        '<sensor type="perspective"><transform name="to_world"><scale x="0"/></transform></sensor>'
    )
    path = scene_file(tmp_path / "flat.xml", wall(4), flat)
    with pytest.raises(InputError) as told:
        tracer.read_scene(path)
    needed = "the camera's to_world must be a rotation and a translation"
    assert str(told.value) == f"{path}: {needed}"
    path = tmp_path / "ball.xml"
    path.write_text('<shape version="3.0.0" type="sphere"/>', encoding="utf-8")
    with pytest.raises(InputError) as told:
        tracer.read_scene(path)
    assert str(told.value) == f"{path}: holds a sphere, must hold a scene"


@pytest.mark.needs("raytrace")
def test_files_beside_a_scene(tracer, tmp_path, monkeypatch):
    """Meshes and included files come from the scene's own folder, and belong to the key of a cached
    rendering.
    """
    monkeypatch.setenv("COINCID_BUILD", str(tmp_path / "build"))
    truth_m = []
    for folder, z in (("a", 4), ("b", 6), ("b", 8)):
        (tmp_path / folder).mkdir(exist_ok=True)
        path = scene_file(tmp_path / folder / "s.xml", '<include filename="mesh.xml"/>')
        scene_file(
            path.parent / "mesh.xml",
            '<shape type="obj"><string name="filename" value="m.obj"/></shape>',
            camera="",
        )
        (path.parent / "m.obj").write_text(
            f"v -20 -20 {z}\nv 20 -20 {z}\nv 0 20 {z}\nf 1 3 2\n", encoding="utf-8"
        )
        truth_m.append(np.nanmin(load_scene(str(path), 4, 4).truth_m))
    assert truth_m == pytest.approx([4 * 1.011, 6 * 1.011, 8 * 1.011], rel=0.01)


@pytest.mark.needs("raytrace")
def test_a_rendering_of_another_view_is_another_one(tracer, tmp_path, monkeypatch):
    """Not the one that was kept."""
    monkeypatch.setenv("COINCID_BUILD", str(tmp_path / "build"))
    path = str(scene_file(tmp_path / "s.xml", wall(4)))
    corners_m = []
    for angle_deg in (20.0, 60.0, 20.0):
        optics = Optics(fov_h_deg=angle_deg, fov_v_deg=angle_deg)
        scene = ray_scene.ray_scene(path, 4, 4, range_m=50.0, optics=optics)
        corners_m.append(scene.truth_m[0, 0])
    assert corners_m[0] == corners_m[2] < corners_m[1] - 0.1


@pytest.mark.needs("raytrace")
def test_threads_do_not_change_a_bit(tracer):
    import drjit as dr

    threads, made = dr.thread_count(), []
    try:
        for n in (1, 2, 2):
            dr.set_thread_count(n)
            transient = rendered(tracer, ray_scene.SCENES / "corner.xml")
            made.append(
                [
                    getattr(transient, name).tobytes()
                    for name in ("first", "index", "strength_per_m2", "ambient", "surface_m")
                ]
            )
    finally:
        dr.set_thread_count(threads)
    assert made[0] == made[1] == made[2]


@pytest.mark.needs("raytrace")
def test_depth_of_single_returns_is_the_geometrys(tracer):
    """For the five objects, depth is right within a tick wherever a pixel and its neighbours see
    one surface.
    """
    transient = rendered(tracer, ray_scene.SCENES / "five-objects.xml", 32, 32, stop_s=0.5e-6)
    depth_m, surface_m = transient.depth_m(), transient.surface_m
    single = ndimage.maximum_filter(surface_m, 3) - ndimage.minimum_filter(surface_m, 3) < 0.2
    for pixel in np.flatnonzero(single):
        bins = slice(*transient.first[pixel : pixel + 2])
        near = np.abs((transient.index[bins] + 0.5) * BIN_M - depth_m.flat[pixel]) < 0.1
        single.flat[pixel] = (
            transient.strength_per_m2[bins][near].sum() > 0.9 * transient.total_per_m2.flat[pixel]
        )
    assert single.sum() > 300
    assert np.abs(depth_m - surface_m)[single].max() < TICK_M


@pytest.mark.parametrize("incidence_deg", [0, 60])
@pytest.mark.needs("raytrace")
def test_a_retroreflector_sends_its_share_back_to_the_source(tracer, incidence_deg):
    """From any direction in front of it, in a lobe of 1 degree: 104 cd/lx/m2, as docs/raytrace.md
    tells. Nothing comes from behind.
    """
    import drjit as dr
    import mitsuba as mi

    bsdf = mi.load_dict({"type": "retroreflective"})

    def hit_from(angle_deg, n=1):
        angle = math.radians(angle_deg)
        hit = dr.zeros(mi.SurfaceInteraction3f, n)
        hit.wi = mi.Vector3f(math.sin(angle), 0, math.cos(angle))
        return hit

    def sent_back(angle_deg, off_deg=0.0):
        other = hit_from(angle_deg + off_deg)
        args = mi.BSDFContext(), hit_from(angle_deg), other.wi
        value, density = (float(np.array(part).item()) for part in bsdf.eval_pdf(*args, True))
        assert value == pytest.approx(0.2 * density)
        assert float(np.array(bsdf.eval(*args, True)).item()) == value
        assert float(np.array(bsdf.pdf(*args, True)).item()) == density
        return value

    assert sent_back(incidence_deg) == pytest.approx(104.5, abs=0.1)
    for off_deg in (-1.0, 1.0):
        shares = sent_back(incidence_deg, off_deg) / sent_back(incidence_deg)
        assert shares == pytest.approx(math.exp(-0.5), rel=1e-3)
    assert sent_back(180 - incidence_deg) == 0
    assert sent_back(89.5, 1.0) == sent_back(90.5, -1.0) == 0
    n = 4096
    random = mi.load_dict({"type": "independent"})
    random.seed(1, n)
    for angle_deg, share in ((incidence_deg, 0.2), (90.5, 0.0), (180 - incidence_deg, 0.0)):
        hit = hit_from(angle_deg, n)
        drawn, weight = bsdf.sample(mi.BSDFContext(), hit, random.next_1d(), random.next_2d(), True)
        assert np.unique(np.array(weight)) == pytest.approx([share])
        cosine = np.array(dr.dot(drawn.wo, hit.wi))
        off_deg = np.degrees(np.arccos(np.minimum(cosine, 1.0)))
        assert np.sqrt(np.mean(off_deg**2) / 2) == pytest.approx(1.0, rel=0.05)


@pytest.mark.needs("raytrace")
def test_pane_and_fog_take_their_share(tracer, tmp_path):
    """A pane transmits by Fresnel's law, there and back; fog takes exp(-2 sigma d) of the wall's
    light, and glows in the sun. What is behind the laser shades nothing.
    """
    clear = rendered(tracer, scene_file(tmp_path / "clear.xml", wall(10)))
    pane = (
        '<shape type="rectangle"><bsdf type="thindielectric"/><transform name="to_world"><scale value="9"/><translate z="3"/>'
        "</transform></shape>"
    )
    back = '<shape type="disk"><bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>'
    back += '<transform name="to_world"><scale value="9"/><translate z="-2"/></transform></shape>'
    behind = rendered(tracer, scene_file(tmp_path / "pane.xml", wall(10) + pane + back))
    # Mitsuba's air and BK7, at normal incidence
    once = (1.000277 - 1.5046) ** 2 / (1.000277 + 1.5046) ** 2
    passes = (1 - once) / (1 + once)
    assert (behind.total_per_m2 / clear.total_per_m2)[3:5, 3:5] == pytest.approx(
        np.full((2, 2), passes**2), rel=0.03
    )
    fog = (
        '<medium type="homogeneous" id="fog"><float name="sigma_t" value="0.1"/><float name="albedo" value="0"/></medium>'
        '<shape type="cube"><bsdf type="null"/><ref name="interior" id="fog"/><transform name="to_world">'
        '<scale x="9" y="9" z="3"/><translate z="5"/></transform></shape>'
    )
    foggy = rendered(tracer, scene_file(tmp_path / "fog.xml", wall(10) + fog))
    across = ((np.arange(8) + 0.5) / 4 - 1) * math.tan(math.pi / 8)
    ways_m = 6 * np.sqrt(1 + across[:, None] ** 2 + across**2)  # through the cube
    assert np.mean(
        foggy.total_per_m2 / clear.total_per_m2 / np.exp(-0.2 * ways_m)
    ) == pytest.approx(1, rel=0.015)
    assert foggy.ambient == pytest.approx(1 + (0.4 - 1) * np.exp(-0.1 * ways_m), rel=0.01)


CLEAR = '<medium type="homogeneous" id="clear"/>'
UNEVEN = (
    '<medium type="heterogeneous" id="uneven"><volume name="sigma_t" type="constvolume">'
    '<float name="value" value="1"/></volume></medium>'
)


def cube(**sides):
    """Return a cube with these media, by the side of its surface."""
    media = "".join(f'<ref name="{side}" id="{medium}"/>' for side, medium in sides.items())
    return f'<shape type="cube"><bsdf type="null"/>{media}</shape>'


@pytest.mark.parametrize(
    "body, words",
    [
        ('<shape type="nosuch"/>', 'Plugin "nosuch" not found'),
        ('<shape type="ply"><string name="filename" value="none.ply"/></shape>', "none.ply"),
        (
            '<shape type="sphere"><float name="radius" value="wide"/></shape>',
            "could not parse floating point value",
        ),
        ("<shape", "is not a scene that Mitsuba reads"),
        *(
            (CLEAR + UNEVEN + cubes, "heterogeneous medium, must be homogeneous")
            for cubes in (
                cube(interior="uneven"),
                cube(exterior="uneven"),
                cube(interior="clear", exterior="uneven"),
                cube() + cube(interior="uneven", exterior="clear"),
            )
        ),
        (
            '<shape type="sphere"><bsdf type="retroreflective"><float name="divergence" value="0"/></bsdf></shape>',
            "divergence from 0.01 to 45",
        ),
        (None, "has no camera"),
    ],
)
@pytest.mark.needs("raytrace")
def test_broken_scenes(tracer, tmp_path, body, words):
    path = scene_file(tmp_path / "broken.xml", body or "", camera="" if body is None else CAMERA)
    with pytest.raises(InputError, match=words) as told:
        load_scene(str(path), 8, 8, range_m=RANGE_M)
    assert "\n" not in str(told.value) and str(told.value).startswith(str(path))


@pytest.mark.needs("raytrace")
def test_a_scene_runs_from_photon_to_depth(tracer, tmp_path, monkeypatch):
    """A user's file, on the command line: a ball before a wall, each at its depth."""
    monkeypatch.setenv("COINCID_BUILD", str(tmp_path / "build"))
    ball = '<shape type="sphere"><bsdf type="diffuse"/><float name="radius" value="1"/><point name="center" x="0" y="0" z="5"/></shape>'
    path = scene_file(tmp_path / "ball.xml", wall(9) + ball)
    (tmp_path / "small.toml").write_text("[sensor]\nrows = 16\ncols = 16\n", encoding="utf-8")
    told = command(
        f"sim --scene {path} --engine golden --klux 2 --pulses 200 --config {tmp_path}/small.toml --out {tmp_path}/out"
    )
    assert told.exit_code == 0, told.output
    config = load_config(tmp_path / "small.toml").with_pulses(200)
    depth_m = estimate_depth(
        dict(np.load(tmp_path / "out" / "events.npz")), config, frame=1
    ).depth_m[:, :, 0]
    assert depth_m[7:9, 7:9] == pytest.approx(np.full((2, 2), 4.01), abs=0.05)
    assert np.median(np.abs(depth_m - load_scene(str(path), 16, 16).truth_m)) < 0.15
