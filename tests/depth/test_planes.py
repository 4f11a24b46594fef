# SPDX-License-Identifier: Apache-2.0
"""The estimator of planes: its likelihood, slopes, masks, returns, confidence, and identical bits
for any number of threads.
"""

import numpy as np
import pytest

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.depth import surfaces
from coincid.model.depth.arrivals import pulse_sigma_ticks
from coincid.model.depth.histograms import by_subgroup, frame_events
from coincid.model.depth.light_prior import fall, own_priors
from coincid.model.depth.likelihood import Grid, Guess, log_likelihood
from coincid.model.depth.planes import background_activity
from coincid.model.depth.pulse_ticks import pulse_ticks
from coincid.model.depth.quality import OTHER_SURFACE_M, TOLERANCE_M, wrong_share
from coincid.model.depth.seeds import find_seeds
from coincid.model.depth.surfaces import LIGHTS
from coincid.model.depth.unheard import unheard, windows_of
from coincid.model.light.light import Light, signal_per_pulse
from coincid.model.light.spad import Spad
from coincid.model.scenes.catalogue import load_scene
from coincid.model.scenes.scene import Scene
from coincid.model.scenes.transient import BIN_S
from coincid.model.scenes.view import View
from coincid.model.shared.constants import SPEED_OF_LIGHT_M_S

from ..random_cases import configured
from ..transients import synthetic

ROWS, COLS = 16, 24
DOWN_M, RIGHT_M = 0.02, -0.05  # slopes per pixel


def tilted(near_m=6.0, reflectivity=0.4):
    row, col = np.mgrid[:ROWS, :COLS]
    distance_m = near_m + DOWN_M * row - RIGHT_M * (COLS - col)
    return Scene(
        name="tilted", distance_m=distance_m, reflectivity=np.full((ROWS, COLS), reflectivity)
    )


def estimate(
    scene,
    klux=20.0,
    *,
    frame=None,
    subgroup=None,
    override=(),
    sensor=None,
    spad=None,
    seed=1,
    **options,
):
    sensor = {"rows": scene.rows, "cols": scene.cols} | (sensor or {})
    config = configured(sensor, frame, subgroup, *override)
    setup = Setup(config=config, scene=scene, klux=klux, spad=spad or Spad(), seed=seed)
    return Run(setup).depth(**options)


def test_no_pixel_is_hot_among_masked_ones():
    """The mean of the background is that of the live pixels."""
    mask = format(0xFFFF, "x")  # a quarter of the pixels
    config = configured({"rows": 8, "cols": 8}, {"pulses": 300}, {"mask": mask, "threshold": 1})
    scene = load_scene("flat:20,0.4", 8, 8)
    run = Run(Setup(config=config, scene=scene, klux=100.0))
    pulse = pulse_ticks(config)
    events = frame_events(run.result, config, pulse)
    seed = np.full((1, 64), scene.truth_m[0, 0] / config.tick_m)
    assert np.all(background_activity(events, config.mask, seed, pulse.sigma) == 1.0)


def share(depth, scene, tolerance_m=TOLERANCE_M):
    return wrong_share(depth.depth_m[:, :, 0], scene.truth_m, tolerance_m)


@pytest.mark.parametrize(
    "settings",
    [
        *(
            {},
            {"coincidence": False},
            {"window": 4, "threshold": 1},
            {"threshold": 3},
            {"window": 8},
            {"window": 48},
        ),
        {"gating": True, "gate_start": 15, "gate_len": 20},
    ],
)
def test_a_tilted_plane_whatever_the_window(settings):
    """Time stamps are those of first photons, which are early; the depth is not."""
    scene = tilted()
    depth = estimate(scene, subgroup=settings)
    assert share(depth, scene) < 0.03
    assert abs(np.median(depth.depth_m[:, :, 0] - scene.truth_m)) < 0.01


@pytest.mark.parametrize("near_m", [1.0, 2.0, 4.0])
def test_much_light_leaves_no_bias(near_m):
    """The bias stays small from 12 photons per pulse and pixel to less than one."""
    scene = tilted(near_m, 0.5)
    depth = estimate(scene, 50.0)
    assert share(depth, scene) < 0.05
    assert abs(np.median(depth.depth_m[:, :, 0] - scene.truth_m)) < 0.015


def test_a_tilted_wall_does_not_turn():
    """Nearer pixels are brighter: half of the wall would be 3.7 mm farther away than the other if the
    same lights were as likely at all distances.
    """
    distance_m = np.tile(np.linspace(2, 3, 32), (32, 1))
    setup = Setup.of(
        Scene(name="turned", distance_m=distance_m, reflectivity=np.full((32, 32), 0.4)),
        klux=50.0,
        sensor={"rows": 32, "cols": 32},
        frame={"pulses": 100, "link_gbps": 0},
        subgroup={"threshold": 1},
    )
    turned_m = []
    for seed in range(1, 5):
        off_m = Run(setup.but(seed=seed), workers=2).frame().depth_m - distance_m
        turned_m.append(np.median(off_m[:, 16:28]) - np.median(off_m[:, 4:16]))
    assert abs(np.mean(turned_m)) < 0.0012


@pytest.mark.parametrize(
    ("scene", "klux", "threshold", "pulses"),
    [("flat:16,0.1", 10, 3, 1000), ("flat:4,0.4", 50, 2, 100)],
)
def test_walls_with_few_hits_do_not_lean(scene, klux, threshold, pulses):
    """A pixel's own peak is skewed then, which a mean of peaks would keep."""
    setup = Setup.of(
        scene,
        klux=klux,
        sensor={"rows": 32, "cols": 32},
        frame={"pulses": pulses},
        subgroup={"threshold": threshold},
    )
    leans_m = []
    for seed in range(1, 13):
        run = Run(setup.but(seed=seed), workers=2)
        off_m = run.frame().depth_m - run.frame().truth_m
        leans_m.append(off_m[abs(off_m) < TOLERANCE_M].mean())
    assert abs(np.mean(leans_m)) < 0.0012


@pytest.mark.parametrize(("klux", "form", "most_m"), [(50.0, "id", 7e-3), (10.0, "full", 6e-3)])
def test_bright_pixels_of_a_wall_tell_their_lights_together(klux, form, most_m):
    """At threshold 1, each alone takes itself for brighter, and the wall for 11 mm farther away."""
    scene = load_scene("flat:1,0.4", 32, 32)
    frame = {"pulses": 100, "format": form, "link_gbps": 0}
    depth = estimate(scene, klux=klux, frame=frame, subgroup={"threshold": 1})
    assert abs(np.mean(depth.depth_m[:, :, 0] - scene.truth_m)) < most_m


@pytest.mark.parametrize(
    ("distance_m", "reflectivity", "threshold"), [(8.07, 0.1, 3), (16.2, 0.4, 2)]
)
def test_walls_without_maps_do_not_lean(distance_m, reflectivity, threshold):
    """Windows count if enough pixels fire, so their winners are early: 17 and 8 mm if the other
    pixels' number told nothing.
    """
    setup = Setup.of(
        f"flat:{distance_m},{reflectivity}",
        klux=50.0,
        sensor={"rows": 16, "cols": 16},
        frame={"pulses": 1000, "format": "short", "link_gbps": 0},
        subgroup={"threshold": threshold},
    )
    off_m = [Run(setup.but(seed=seed)).depth().depth_m[:, :, 0] - distance_m for seed in (1, 2)]
    assert abs(np.mean(off_m)) < 0.005


def test_light_between_the_steps_of_the_grid_has_the_same_time():
    """With half as many steps, 9 % of the pixels take a light for another one, and the time that
    belongs to it.
    """
    setup = Setup.of(
        "flat:4.303,0.4",
        klux=50.0,
        sensor={"rows": 32, "cols": 32},
        frame={"pulses": 100, "format": "compact", "link_gbps": 0},
        subgroup={"threshold": 1},
    )
    wrong = []
    for seed in (21, 22):
        frame = Run(setup.but(seed=seed), workers=2).frame()
        wrong.append(wrong_share(frame.depth_m, frame.truth_m, TOLERANCE_M))
    assert np.mean(wrong) < 0.01


@pytest.mark.parametrize("link_gbps", [0.0, 1.0])
def test_the_light_is_learned_from_the_frame(link_gbps):
    """Also where the link drops most windows, and single pixels say little about their light."""
    scene = tilted(1.5, 0.3)
    run = Run(Setup.of(scene, sensor={"rows": ROWS, "cols": COLS}, frame={"link_gbps": link_gbps}))
    config, result = run.config, run.result
    assert (result["dropped"].sum() > result["stored"].sum()) == (link_gbps > 0)
    pulse = pulse_ticks(config)
    events = frame_events(result, config, pulse)
    time = by_subgroup(scene.truth_m / config.tick_m, config.sensor)
    light = by_subgroup(signal_per_pulse(scene.truth_m, scene.reflectivity[:, :, 0]), config.sensor)
    never = unheard(windows_of(events, config, config.pulses, pulse), config, pulse)
    levels = log_likelihood(
        events, config, pulse, config.pulses, Grid(1, LIGHTS, None), never,
        np.rint(time).astype(np.int64) - 8, 16, guess=Guess(time, light),
    )  # fmt: skip
    share = np.exp(own_priors(levels.prior, LIGHTS, fall(time.ravel())))
    light = light.ravel()[:, None]
    near = (light / 3 < LIGHTS) & (light * 3 > LIGHTS)
    assert np.all((share * near).sum(axis=1) > 0.75)


def test_seeds_are_not_biased(monkeypatch):
    """They are middles of their bins, which are five ticks wide."""
    seen, scene = [], tilted()
    monkeypatch.setattr(
        surfaces, "find_seeds", lambda *levels: seen.append(find_seeds(*levels)) or seen[-1]
    )
    run = Run(Setup.of(scene, sensor={"rows": ROWS, "cols": COLS}, klux=20.0))
    run.depth()
    step = round(surfaces.COARSE_SIGMAS * pulse_sigma_ticks(run.config))
    error_ticks = seen[0].time(step) - scene.truth_m / run.config.tick_m
    assert abs(np.mean(error_ticks)) < 1 < step / 2


def test_many_photons_leave_no_error():
    scene = tilted()
    depth = estimate(scene, 1.0, frame={"pulses": 1000})
    assert np.percentile(np.abs(depth.depth_m[:, :, 0] - scene.truth_m), 99) < 0.025


def floor(far_m, near_m=4.0, rows=32, cols=16, reflectivity=0.4, parts=64):
    """A floor in perspective: the light of a pixel comes from all distances that it sees, nearer
    parts are brighter.
    """
    inner = (np.arange(rows * parts) + 0.5) / parts  # rows, and places in them
    distance_m = 1 / (1 / far_m + (1 / near_m - 1 / far_m) * inner / rows)
    bins = (distance_m * 2 / SPEED_OF_LIGHT_M_S / BIN_S).astype(np.int64)
    table = np.zeros((rows, bins.max() + 1))
    np.add.at(
        table, (np.arange(len(bins)) // parts, bins), reflectivity / (np.pi * distance_m**2) / parts
    )
    truth_m = np.repeat(distance_m.reshape(rows, parts).mean(axis=1)[:, None], cols, axis=1)
    light = synthetic(np.repeat(table[:, None], cols, axis=1), truth_m, reflectivity)
    return Scene(name="floor", distance_m=truth_m, reflectivity=light.ambient, transient=light)


@pytest.mark.parametrize(("far_m", "wrong_max"), [(9.0, 0.05), (14.0, 0.25)])
def test_the_pulse_of_a_slanted_surface_is_spread(far_m, wrong_max):
    """The far pixels of these floors see a third of a metre of depth each, and a whole metre."""
    scene = floor(far_m)
    assert share(estimate(scene), scene) < wrong_max


def test_pixels_that_see_one_distance_each_keep_narrow_pulses():
    scene = floor(9.0)
    points = Scene(name="points", distance_m=scene.truth_m, reflectivity=scene.reflectivity)
    assert share(estimate(points), points) < 0.03


def test_slopes_and_standard_errors():
    scene = tilted()
    depth = estimate(scene)
    down, right = np.moveaxis(depth.slope_m, 2, 0)
    assert np.median(down) == pytest.approx(DOWN_M, abs=0.004) and np.median(
        right
    ) == pytest.approx(RIGHT_M, abs=0.004)
    error_m = np.abs(depth.depth_m[:, :, 0] - scene.truth_m)
    assert 0.3 < np.median(error_m / depth.error_m[:, :, 0]) < 1.5


@pytest.mark.parametrize("pulses", [100, 1000])
def test_standard_errors_hold_on_a_curved_surface(pulses):
    """A plane through the pixels around a pixel misses it by more than the noise."""
    y, x = np.mgrid[:32, :32] / 32
    distance_m = 6 + 0.5 * np.sin(6.4 * x) * np.cos(5.3 * y)
    scene = Scene(name="wave", distance_m=distance_m, reflectivity=np.full((32, 32), 0.4))
    errors = scaled_errors(scene, pulses)
    assert 0.6 < np.mean(errors < 1) < 0.82
    assert 0.85 < np.mean(errors < 2)


def test_pixels_of_a_wall_share_what_exceeds_their_noise():
    """Alone, they take small discs and curved surfaces by chance: 2.1 mm, and errors of 3.3 mm."""
    spread_m = []
    error_m = []
    for wall_m in (2.5, 3.5, 4.0, 5.0, 6.0):
        wall = np.full((32, 32), wall_m)
        scene = Scene(name="wall", distance_m=wall, reflectivity=np.full((32, 32), 0.4))
        depth = estimate(scene, 50.0, frame={"pulses": 100, "link_gbps": 0})
        spread_m.append(np.std(depth.depth_m))
        error_m.append(np.mean(depth.error_m))
    assert np.mean(spread_m) < 1.95e-3
    assert np.mean(error_m) < 2.6e-3


def test_standard_errors_hold_for_pixels_that_fire_in_nearly_every_pulse():
    """Each pixel sees a distance of its own, with 5 to 9 photons per pulse: it knows its light to a
    few per cent, and its time follows from that light.
    """
    distance_m = 1.2 + 0.25 * np.random.default_rng(0).random((16, 16))
    scene = Scene(name="alone", distance_m=distance_m, reflectivity=np.full((16, 16), 0.5))
    errors = scaled_errors(scene, pulses=1000)
    assert 0.6 < np.mean(errors < 1) < 0.8
    assert 0.88 < np.mean(errors < 2)


def test_standard_errors_hold_where_each_pixel_is_off_the_surface():
    """The surface through its neighbours alone would have an error of 5.4 mm, and say 3.8 mm."""
    own_m = 6e-3 * np.random.default_rng(3).standard_normal((32, 32))
    scene = Scene(name="rough", distance_m=8 + own_m, reflectivity=np.full((32, 32), 0.4))
    depth = estimate(scene, 50.0, frame={"pulses": 1000, "link_gbps": 0})
    errors = scaled_by_their_own(depth, scene)
    assert 0.6 < np.mean(errors < 1) < 0.8
    assert 0.9 < np.mean(errors < 2)
    assert np.sqrt(np.mean((depth.depth_m[:, :, 0] - scene.truth_m) ** 2)) < 5.0e-3


def scaled_errors(scene, pulses):
    """Return the errors of the right pixels, by their standard errors."""
    depth = estimate(scene, 50.0, frame={"pulses": pulses, "link_gbps": 0})
    return scaled_by_their_own(depth, scene)


def scaled_by_their_own(depth, scene):
    """Return the errors of the right pixels of an estimate, by their standard errors."""
    off_m = np.abs(depth.depth_m[:, :, 0] - scene.truth_m)
    return (off_m / depth.error_m[:, :, 0])[off_m < TOLERANCE_M]


def rms_behind_lens_m(view, rows, cols, turned):
    """RMS error of a wall at 8 m in a view, turned by so much."""
    right, down = view.tangents(rows, cols)
    distance_m = 8 / (1 - turned * right) * view.ray_per_z(rows, cols)
    scene = Scene(name="seen", distance_m=distance_m, reflectivity=np.full((rows, cols), 0.4))
    depth = estimate(scene, 50.0, frame={"pulses": 1000, "link_gbps": 0})
    return np.sqrt(np.mean((depth.depth_m[:, :, 0] - scene.truth_m) ** 2))


@pytest.mark.parametrize(("turned", "most_m"), [(0.0, 2.2e-3), (0.6, 3.2e-3)])
def test_a_wall_behind_a_lens_is_as_sharp_as_one_without(turned, most_m):
    """Its distances do not change evenly from pixel to pixel: even one that faces the sensor is
    farther away at the edges of the view. Without the lens, the errors are 3.5 and 5.4 mm.
    """
    assert rms_behind_lens_m(View(), 16, 16, turned) < most_m


@pytest.mark.parametrize(
    ("view", "most_m"), [(View(), 2.2e-3), (View.of_part(45.0, (16, 32), (16, 32)), 1.4e-3)]
)
def test_a_lens_is_found_whether_pixels_or_the_view_are_square(view, most_m):
    """With the other kind of lens alone, the errors are 2.7 and 1.6 mm."""
    assert rms_behind_lens_m(view, 16, 32, 0.6) < most_m


def test_offsets_tell_more_than_maps():
    """The error that all pixels share is left out: it is one random number per frame."""
    scene, errors = tilted(), []
    for form, wrong_max in (("short", 0.5), ("id", 0.05), ("full", 0.05)):
        of_frames = []
        for seed in (0, 1, 2):
            depth = estimate(scene, frame={"format": form}, sensor={"streams": 6}, seed=seed)
            assert share(depth, scene) < wrong_max
            of_frames.append((depth.depth_m[:, :, 0] - scene.truth_m).std())
        errors.append(np.mean(of_frames))
    assert errors == sorted(errors, reverse=True)


def test_masked_and_hot_pixels_take_their_surroundings():
    scene = tilted()
    dark_cps = np.zeros(ROWS * COLS)
    dark_cps[[50, 200, 300]] = 5e6
    depth = estimate(
        scene,
        override=[{"subgroups": [1], "mask": "ff00ffffffffffff"}],
        spad=Spad(dark_cps=dark_cps),
    )
    assert share(depth, scene) < 0.03


@pytest.mark.parametrize("pulses", [1000, 5000])
@pytest.mark.parametrize("gating", [False, True])
def test_dim_light_needs_no_gate_and_bears_one(pulses, gating):
    """About one photon per pixel comes back in a thousand pulses; more pulses and a gate never make
    it worse.
    """
    scene = load_scene("flat:45,0.1", ROWS, COLS)
    around = {"coincidence": False, "gating": gating, "gate_start": 130, "gate_len": 40}
    depth = estimate(scene, 10.0, frame={"pulses": pulses}, subgroup=around)
    assert share(depth, scene, OTHER_SURFACE_M) < 0.01


def test_edges_of_objects_stay_sharp():
    row, col = np.mgrid[:ROWS, :COLS]
    box = (row > 3) & (row < 11) & (col > 5) & (col < 15)
    scene = Scene(
        name="box",
        distance_m=np.where(box, 4.0, 6 + 0.05 * row),
        reflectivity=np.full((ROWS, COLS), 0.4),
    )
    assert share(estimate(scene), scene) < 0.02


def test_no_confidence_where_a_pixel_rules_out_its_plane():
    """Some pixels see only the pane before a wall, but their neighbours' plane is that of the
    wall.
    """
    signal = np.array([[0.25, 0.4]])
    light = Light(
        rows=16, cols=16, distance_m=[[4.0, 4.9]], signal_per_pulse=signal, background_cps=2.5e5
    )
    depth = Run(Setup.of(sensor={"rows": 16, "cols": 16}, light=light, seed=4)).depth()
    ruled_out = np.isnan(depth.error_m[:, :, 0])
    assert (
        ruled_out.any()
        and not depth.confidence[ruled_out].any()
        and not np.isnan(depth.depth_m).any()
    )


def test_threads_change_nothing():
    scene = tilted()
    one, two, three = (estimate(scene, returns=2, workers=workers) for workers in (1, 2, 3))
    assert np.mean(~np.isnan(one.depth_m[:, :, 1])) < 0.01  # there is one surface
    for other in (two, three):
        for name in ("depth_m", "confidence", "error_m", "slope_m"):
            assert np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True)
