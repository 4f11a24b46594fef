# SPDX-License-Identifier: Apache-2.0
"""Maps of a frame in a scene with several targets per pixel, in an array that is no square."""

import numpy as np
import pytest

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.pixels import pixel_table
from coincid.model.scenes.scene import Scene
from coincid.study.show.frame_content import FrameView

ROWS, COLS, TARGETS = 8, 24, 3


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(5)
    distance_m = rng.uniform(2, 9, (ROWS, COLS, TARGETS))
    distance_m[rng.random(distance_m.shape) < 0.3] = np.nan
    reflectivity = rng.uniform(0.05, 0.3, distance_m.shape)
    return Scene(name="random", distance_m=distance_m, reflectivity=reflectivity)


@pytest.fixture(scope="module")
def view(scene):
    setup = Setup.of(
        scene,
        sensor={"rows": ROWS, "cols": COLS, "fifo_depth": 1},
        frame={"pulses": 20, "link_gbps": 4.0},
        klux=20.0,
    )
    config = setup.config.with_settings(threshold=[1, 2, 3])
    return FrameView("a frame", Run(setup.but(config=config)).frame())


def test_reflectivity_is_that_of_the_nearest_target(scene, view):
    for row, col in np.ndindex(ROWS, COLS):
        targets = [
            (distance_m, share)
            for distance_m, share in zip(
                scene.distance_m[row, col], scene.reflectivity[row, col], strict=True
            )
            if not np.isnan(distance_m)
        ]
        shown = view.reflectivity[row, col]
        assert np.isnan(shown) if not targets else shown == min(targets)[1]


def test_light_of_a_pixel_is_that_of_all_its_targets(scene, view):
    config = view.config
    signal = 0.613 * scene.reflectivity / 0.4 * (4 / scene.distance_m) ** 2
    assert np.allclose(view.signal, np.nansum(signal, axis=2))
    period_s = config.period / (config.clock_mhz * 1e6)
    assert view.background.shape == (ROWS, COLS)
    assert np.all(view.background > 0) and np.all(view.background < 1.226e6 * 3 * period_s)


def test_numbers_of_subgroups_lie_on_their_pixels(view):
    subgroup = pixel_table(view.config.sensor).subgroup.reshape(ROWS, COLS)
    assert np.array_equal(view.threshold, 1.0 + subgroup)
    drops = np.bincount(subgroup.ravel(), view.drops.ravel()) / 64
    assert drops.sum() == view.numbers["dropped"] > 0
    assert np.array_equal(view.drops, drops[subgroup])
    for pixel in (0, 30, 77, 191):
        row, col = divmod(pixel, COLS)
        assert view.subgroup_of(row, col) == subgroup[row, col]
        of_pixel, of_subgroup = view.histogram(row, col)
        assert np.all(of_pixel <= of_subgroup)
        span = slice(*view.events.bounds[subgroup[row, col] :][:2])
        assert of_subgroup.sum() == len(view.events.stamp[span])
