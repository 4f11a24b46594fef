# SPDX-License-Identifier: Apache-2.0
"""Scenes: built-in ones, and depth files that are good, damaged or not depth files."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from coincid.model.light.light import Light
from coincid.model.scenes.catalogue import RANGE_M, load_scene
from coincid.model.scenes.depth_file import BRIGHTEST, DARKEST, depth_scene
from coincid.model.scenes.image_files import centre_crop, covered_samples
from coincid.model.scenes.pixel_surface import GAP_SHARE
from coincid.model.scenes.scene import Scene, scene_light
from coincid.model.scenes.transient import SURFACE_GAP_M
from coincid.model.scenes.view import View
from coincid.model.shared.errors import InputError


def png(path, millimetres):
    Image.fromarray(np.asarray(millimetres, np.uint16)).save(path)
    return path


def npy(path, samples):
    np.save(path, samples)
    return path


def test_five_objects_has_the_papers_ranges():
    scene = load_scene("five-objects", 32, 32)
    assert (scene.truth_m.min(), scene.truth_m.max()) == (4.3, 9.7)
    assert (scene.reflectivity.min(), scene.reflectivity.max()) == (0.08, 0.6)
    assert set(scene.labels.ravel()) == {1, 2, 3, 4, 5}
    for label in range(1, 6):
        assert len(np.unique(scene.truth_m[scene.labels == label])) == 1
    subgroups = scene.labels.reshape(4, 8, 4, 8).swapaxes(1, 2).reshape(16, 64)
    # edges are visible to the sensor
    assert sum(len(np.unique(labels)) > 1 for labels in subgroups) >= 8


@pytest.mark.parametrize("size", [(8, 8), (16, 16), (32, 16), (64, 64)])
def test_built_in_scenes_at_any_size(size):
    for name in (
        "five-objects",
        "letter-f",
        "flat",
        "two-targets",
        "two-returns:4,6",
        "sun-and-shade",
        "tunnel",
    ):
        scene = load_scene(name, *size)
        assert scene.truth_m.shape == scene.valid.shape == scene.labels.shape == size
        assert scene.valid.all()


def test_letter_f_is_no_image_of_itself():
    shape = load_scene("letter-f", 32, 32).labels
    images = [turned for k in range(4) for turned in (np.rot90(shape, k), np.rot90(shape.T, k))]
    assert sum(np.array_equal(shape, image) for image in images) == 1


def test_sun_and_shade_has_dark_and_bright_things_on_both_sides():
    scene = load_scene("sun-and-shade:0.05", 32, 32)
    assert set(np.unique(scene.sunlit)) == {0.05, 1.0}
    assert np.all(np.diff(scene.sunlit, axis=1) >= 0)  # the sun is on the right
    for side in (0.05, 1.0):
        reflectivity = scene.reflectivity[scene.sunlit == side]
        assert reflectivity.min() <= 0.12 and reflectivity.max() >= 0.4
    light = scene_light(scene, 100)
    same = scene.reflectivity[:, :, 0].ravel() == 0.5
    in_the_sun = scene.sunlit.ravel() == 1
    assert light.background_cps[same & in_the_sun] == pytest.approx(2 * 1.226e6 * 0.5 / 0.4)
    assert light.background_cps[same & ~in_the_sun] == pytest.approx(0.1 * 1.226e6 * 0.5 / 0.4)


def test_tunnel_is_symmetric_and_bright_at_its_end():
    scene = load_scene("tunnel", 32, 32)
    assert np.array_equal(scene.truth_m[:8], scene.truth_m[:8, ::-1])
    assert np.all(np.diff(scene.truth_m[0, :16]) <= 0) or np.all(
        np.diff(scene.truth_m[16, 26:]) < 0
    )
    assert (
        scene.truth_m[scene.sunlit == 1].min() >= 14 and scene.truth_m[scene.sunlit < 1].max() < 14
    )


@pytest.mark.parametrize("rows, cols", [(12, 24), (24, 12)])
def test_points_of_the_tunnel_are_on_its_walls_or_on_the_one_behind_its_exit(rows, cols):
    """Two metres from the axis, up to the exit; distances are along the rays."""
    scene = load_scene("tunnel", rows, cols)
    right, down = View().tangents(rows, cols)
    along_m = scene.truth_m / View().ray_per_z(rows, cols)
    from_axis_m = along_m * np.maximum(np.abs(right), np.abs(down))
    walls, behind, truck = (scene.labels == label for label in (1, 2, 3))
    assert np.all(walls | behind | truck) and truck.any()
    assert from_axis_m[walls] == pytest.approx(np.full(walls.sum(), 2.0))
    assert along_m[walls].max() <= 11 and along_m[behind] == pytest.approx(
        np.full(behind.sum(), 14)
    )
    assert np.all(np.maximum(np.abs(right), np.abs(down))[behind] * 11 < 2)
    assert np.array_equal(scene.sunlit == 1, behind)
    for part, reflectivity in ((walls, 0.15), (behind, 0.5), (truck, 0.08)):
        assert np.all(scene.reflectivity[part] == reflectivity)


def test_parameters_in_the_name():
    scene = load_scene("flat:12.5,0.3", 4, 8)
    assert np.all(scene.truth_m == 12.5) and np.all(scene.reflectivity == 0.3)
    stripes = load_scene("two-targets:5,9", 8, 8).truth_m
    assert np.all(stripes[:, :4] == 5) and np.all(stripes[:, 4:] == 9)
    mesh = load_scene("two-returns:5,9,0.4", 8, 8)
    assert (
        mesh.distance_m.shape == (8, 8, 2)
        and np.all(mesh.truth_m == 5)
        and np.all(mesh.reflectivity == 0.2)
    )
    four = load_scene("returns:4,4.15@0.3,4.3,4.45", 8, 8)
    assert four.distance_m.shape == (8, 8, 4) and np.array_equal(
        four.distance_m[7, 7], [4, 4.15, 4.3, 4.45]
    )
    assert np.array_equal(four.reflectivity[0, 0], [0.1, 0.3, 0.1, 0.1])


@pytest.mark.parametrize(
    "name", ["flat:{}", "two-targets:4,{}", "two-returns:4,{}", "returns:4,{}@0.3"]
)
def test_distances_in_the_name_end_with_the_range(name):
    far = load_scene(name.format(90), 8, 8, range_m=100)
    assert far.distance_m.max() == 90
    with pytest.raises(InputError, match="= 60.0: must be a number from 0.05 to 50"):
        load_scene(name.format(60), 8, 8, range_m=50)


DEFAULTS = {  # scene: distances, reflectivity of each surface, least share of the sun
    "flat": ([10.0], 0.4, 1.0),
    "flat:3": ([3.0], 0.4, 1.0),
    "two-targets": ([5.0, 9.0], 0.4, 1.0),
    "two-targets:4": ([4.0, 9.0], 0.4, 1.0),
    "two-targets:4,6": ([4.0, 6.0], 0.4, 1.0),
    "two-returns": ([5.0, 9.0], 0.2, 1.0),
    "two-returns:4": ([4.0, 9.0], 0.2, 1.0),
    "returns:4,6,7,8": ([4.0, 6.0, 7.0, 8.0], 0.1, 1.0),
    "sun-and-shade": (None, None, 0.01),
    "tunnel": (None, None, 0.01),
}


@pytest.mark.parametrize("name", DEFAULTS)
def test_parameters_that_are_left_out_have_their_usual_values(name):
    distances_m, reflectivity, shade = DEFAULTS[name]
    scene = load_scene(name, 8, 16)
    if distances_m is not None:
        assert np.unique(scene.distance_m).tolist() == distances_m
        assert np.unique(scene.reflectivity).tolist() == [reflectivity]
    assert scene.sunlit.min() == shade


DRAWN = {  # scene: label -> distance, reflectivity, rows and columns from the first to the last
    "five-objects": {
        1: (9.7, 0.60, (0, 31), (0, 31)),
        2: (7.2, 0.08, (9, 20), (2, 12)),
        3: (8.4, 0.55, (0, 31), (18, 22)),
        4: (4.3, 0.45, (17, 29), (21, 29)),
        5: (6.1, 0.10, (23, 31), (6, 16)),
    },
    "sun-and-shade": {
        1: (9.0, 0.50, (0, 31), (14, 31)),
        2: (12.5, 0.10, (0, 31), (0, 13)),
        4: (7.4, 0.12, (15, 29), (22, 29)),
        5: (5.6, 0.45, (4, 10), (24, 28)),
    },
    "tunnel": {3: (8.2, 0.08, (15, 25), (9, 17))},
}


@pytest.mark.parametrize("name", DRAWN)
def test_objects_of_the_built_in_scenes_are_where_they_were(name):
    """Numbers of the pages are of these scenes."""
    scene = load_scene(name, 32, 32)
    for label, (distance_m, reflectivity, rows, cols) in DRAWN[name].items():
        here = scene.labels == label
        row, col = np.nonzero(here)
        assert ((row.min(), row.max()), (col.min(), col.max())) == (rows, cols)
        assert np.unique(scene.truth_m[here]).tolist() == [distance_m]
        assert np.unique(scene.reflectivity[here]).tolist() == [reflectivity]


def test_the_shadow_slants_from_the_right_at_the_top_to_the_left_at_the_bottom():
    sunlit = load_scene("sun-and-shade", 32, 32).sunlit
    first = np.argmax(sunlit == 1, axis=1)
    assert (first[0], first[-1]) == (18, 14) and np.all(np.diff(first) <= 0)


@pytest.mark.parametrize(
    "name, words",
    [
        ("flat:0", "DISTANCE = 0.0: must be a number from"),
        ("flat:75,0.4", "DISTANCE"),
        ("flat:5,1.5", "REFLECTIVITY = 1.5: must be a number from 0 to 1"),
        ("flat:five", "DISTANCE = 'five'"),
        ("flat:nan", "DISTANCE"),
        ("flat:1,0.4,7", "must be flat:DISTANCE,REFLECTIVITY"),
        ("letter-f:1", "must be letter-f"),
        ("returns", "returns: METRES = '': must be a number from"),
        ("returns:4,80", "returns: METRES = 80.0: must be"),
        ("returns:4@2", "returns: REFLECTIVITY = 2.0: must be a number from 0 to 1"),
        ("returns:4@", "returns: REFLECTIVITY = '': must be a number from 0 to 1"),
        ("returns:@0.3", "returns: METRES = '': must be a number from"),
        ("returns:4,,6", "returns: METRES = '': must be a number from"),
        ("two-targets:,9", "two-targets: NEAR = '': must be a number from"),
        ("flat:5,", "flat: REFLECTIVITY = '': must be a number from 0 to 1"),
        ("letter-g", "five-objects, letter-f"),
    ],
)
def test_bad_names(name, words):
    with pytest.raises(InputError, match=words):
        load_scene(name, 8, 8)


@pytest.mark.parametrize("shape", [(0, 3), (3, 0), (2, 2, 0)])
def test_a_scene_has_pixels_and_targets(shape):
    told = re.escape(str(shape if len(shape) == 3 else (*shape, 1)))
    with pytest.raises(InputError, match=f"^distance_m: has shape {told}, must have a target"):
        Scene(name="nothing", distance_m=np.ones(shape), reflectivity=0.4)


SIDES = st.integers(1, 40)


@given(height=SIDES, width=SIDES, rows=SIDES, cols=SIDES)
def test_a_crop_is_the_largest_part_in_the_middle_with_the_aspect_ratio_of_the_sensor(
    height, width, rows, cols
):
    """To half a sample; one more is left out at the bottom and on the right, if they are odd."""
    top, left, high, wide = centre_crop(height, width, rows, cols)
    assert high == height or wide == width
    if high < height:
        assert abs(high - width * rows / cols) <= 0.5 or high == 1
    if wide < width:
        assert abs(wide - height * cols / rows) <= 0.5 or wide == 1
    assert height - high - 2 * top in (0, 1) and width - wide - 2 * left in (0, 1)


@given(height=SIDES, width=SIDES, rows=SIDES, cols=SIDES)
def test_a_pixel_covers_the_samples_that_begin_in_it(height, width, rows, cols):
    """Of a smaller picture, it takes the sample in which it begins."""
    row, col, pixel = covered_samples(height, width, rows, cols)
    down, across = pixel[:, 0] // cols, pixel[0] % cols
    assert np.array_equal(pixel, down[:, None] * cols + across)
    for samples, at, number, pixels in (
        (height, row.ravel(), down, rows),
        (width, col, across, cols),
    ):
        if samples >= pixels:
            assert at.tolist() == list(range(samples))
            assert np.all(number * samples <= at * pixels)
            assert np.all(at * pixels < (number + 1) * samples)
        else:
            assert number.tolist() == list(range(pixels))
            assert np.all(at * pixels <= number * samples)
            assert np.all(number * samples < (at + 1) * pixels)


@settings(max_examples=60, deadline=None)
@given(
    samples=hnp.arrays(
        np.float64, hnp.array_shapes(min_dims=2, max_dims=2, max_side=12), elements=st.floats(1, 20)
    ),
    rows=st.integers(1, 9),
    cols=st.integers(1, 9),
)
def test_a_pixel_takes_the_median_of_the_surface_with_most_samples(samples, rows, cols):
    truth_m = load_scene(samples, rows, cols).truth_m
    top, left, height, width = centre_crop(*samples.shape, rows, cols)
    row, col, pixel = covered_samples(height, width, rows, cols)
    values = samples[top + row, left + col]
    for k in range(rows * cols):
        covered = np.sort(values[pixel == k])
        gap = np.diff(covered) > np.maximum(SURFACE_GAP_M, GAP_SHARE * covered[1:])
        surfaces = np.split(covered, np.flatnonzero(gap) + 1)
        assert truth_m[k // cols, k % cols] == pytest.approx(np.median(max(surfaces, key=len)))


def test_speckle_and_noise_leave_a_wall_where_it_is():
    """Flying pixels of time of flight cameras (librealsense#1246), and their noise: the nearest
    sample is none of them.
    """
    rng = np.random.default_rng(0)
    wall_m = np.full((480, 480), 4.0)
    wall_m[rng.random(wall_m.shape) < 0.01] = 0.5
    assert np.all(load_scene(wall_m, 32, 32).truth_m == 4)
    noisy_m = rng.normal(4, 0.01, (64, 64))
    for side in (8, 16, 32):
        assert abs(load_scene(noisy_m, side, side).truth_m.mean() - 4) < 0.001


def test_an_edge_is_kept_and_a_hole_stays_one():
    depth_m = np.full((8, 8), 4.0)
    depth_m[:, 5:] = 9.0
    edge = load_scene(depth_m, 2, 2).truth_m
    assert np.array_equal(edge, [[4, 9], [4, 9]])  # three of four columns of the right pixels
    for missing, seen in ((8, True), (9, False)):
        depth_m[:4, :4] = 4.0
        depth_m[:4, :4].flat[:missing] = 0
        assert load_scene(depth_m, 2, 2).valid[0, 0] == seen


def test_reflectivity_is_that_of_the_surface_which_the_pixel_takes():
    depth_m = np.tile([4.0, 4.0, 9.0, 4.0], (4, 1))
    reflectivity = np.where(depth_m == 9, 0.9, 0.2)
    scene = load_scene(depth_m, 1, 1, reflectivity=reflectivity)
    assert scene.truth_m == 4 and scene.reflectivity == pytest.approx(0.2)


def test_scaled_distances_and_too_much_signal(tmp_path):
    """A wall at 1 m sends ten times the signal that the sensor is made for; at 3 m about the right
    one.
    """
    np.save(tmp_path / "wall.npy", np.full((4, 4), 1.0))
    near, far, half = (
        load_scene(str(tmp_path / "wall.npy"), 4, 4, scale=scale) for scale in (1.0, 3.0, 0.5)
    )
    for scene, scale in ((far, 3), (half, 0.5)):
        assert np.array_equal(scene.distance_m, scale * near.distance_m)
        assert any(f"distances times {scale:g}" in note for note in scene.notes)
    assert not any("times" in note for note in near.notes)
    assert "SCALE=4" in "".join(scene_light(near, 50).notes()) and not scene_light(far, 50).notes()
    for source in ("flat:5", "ray:corner"):
        with pytest.raises(InputError, match="depth files only"):
            load_scene(source, 4, 4, scale=3.0)
    with pytest.raises(InputError, match="scale = 0"):
        load_scene(str(tmp_path / "wall.npy"), 4, 4, scale=0.0)


def test_crop_is_in_the_middle_and_is_noted(tmp_path):
    depth_mm = np.full((4, 12), 9000)
    depth_mm[:, 4:8] = 2000
    scene = depth_scene(png(tmp_path / "wide.png", depth_mm), 4, 4)
    assert np.all(scene.truth_m == 2.0)
    assert any("middle 4 x 4 of 4 x 12" in note for note in scene.notes)


def test_reflectivity_comes_from_the_colour_of_the_very_sample(tmp_path):
    depth = png(tmp_path / "depth.png", np.tile([[2000, 6000]], (8, 4)))
    colour = tmp_path / "colour.png"
    Image.fromarray(np.tile(np.array([[0, 255]], np.uint8), (8, 4))).convert("RGB").save(colour)
    for scene in (load_scene(f"{depth},{colour}", 4, 4), load_scene(depth, 4, 4, colour=colour)):
        assert np.all(scene.truth_m == 2.0) and np.allclose(scene.reflectivity, 0.05)
    assert np.all(load_scene(depth, 4, 4, reflectivity=0.7).reflectivity == 0.7)


def test_reflectivity_is_the_luminance_of_the_part_that_is_kept(tmp_path):
    colours = np.zeros((3, 9, 3), np.uint8)
    colours[:, 3:6] = 255 * np.eye(3)  # red, green, blue
    Image.fromarray(colours).save(tmp_path / "colour.png")
    scene = load_scene(
        png(tmp_path / "depth.png", np.full((3, 9), 2000)), 3, 3, colour=tmp_path / "colour.png"
    )
    luminance = [0.2126, 0.7152, 0.0722]  # of the primaries of sRGB (ITU-R BT.709)
    assert np.allclose(
        scene.reflectivity[:, :, 0], DARKEST + (BRIGHTEST - DARKEST) * np.array(luminance)
    )


def test_a_finer_colour_picture_is_read_at_the_middle_of_each_sample(tmp_path):
    depth = png(tmp_path / "depth.png", np.full((4, 4), 2000))
    grey = np.zeros((12, 12), np.uint8)
    grey[1::3, 1::3] = 255  # the middles of 3 x 3 samples
    Image.fromarray(grey).convert("RGB").save(tmp_path / "colour.png")
    scene = load_scene(depth, 4, 4, colour=tmp_path / "colour.png")
    assert np.allclose(scene.reflectivity, BRIGHTEST)


@pytest.mark.parametrize(("cols", "is_legal"), [(97, False), (99, True), (101, True), (103, False)])
def test_a_colour_picture_has_nearly_the_shape_of_the_depth(tmp_path, cols, is_legal):
    """Up to a fiftieth, as by rounding."""
    depth = png(tmp_path / "depth.png", np.full((100, 100), 2000))
    colour = png(tmp_path / "colour.png", np.full((100, cols), 65535))
    if is_legal:
        assert np.all(load_scene(depth, 4, 4, colour=colour).reflectivity == BRIGHTEST)
    else:
        with pytest.raises(InputError, match=f"has 100 x {cols} samples, must have the shape"):
            load_scene(depth, 4, 4, colour=colour)


@pytest.mark.parametrize("kind", ("8 bits", "16 bits", "16 bits, big-endian", "32 bits"))
def test_white_of_every_kind_of_grey_picture_is_the_brightest(tmp_path, kind):
    grey = np.tile(np.linspace(0, 1, 4), (4, 1))
    if kind == "8 bits":
        picture = Image.fromarray(np.round(grey * 255).astype(np.uint8))
    elif kind == "32 bits":
        picture = Image.fromarray(np.round(grey * 65535).astype(np.int32))
    else:
        order = ">" if "big" in kind else "<"
        picture = Image.fromarray(np.round(grey * 65535).astype(f"{order}u2"))
    picture.save(tmp_path / "grey.tif")
    depth = png(tmp_path / "depth.png", np.full((4, 4), 2000))
    seen = load_scene(depth, 4, 4, colour=tmp_path / "grey.tif").reflectivity[0, :, 0]
    assert seen[[0, -1]] == pytest.approx([DARKEST, BRIGHTEST])
    linear = ((1 / 3 + 0.055) / 1.055) ** 2.4  # IEC 61966-2-1
    assert seen[1] == pytest.approx(DARKEST + (BRIGHTEST - DARKEST) * linear)


def test_every_grey_has_the_light_of_the_standard(tmp_path):
    """IEC 61966-2-1, whose dark greys are in proportion to their light."""
    grey = np.arange(256, dtype=np.uint8).reshape(16, 16)
    Image.fromarray(grey).save(tmp_path / "grey.png")
    depth = png(tmp_path / "depth.png", np.full((16, 16), 2000))
    seen = load_scene(depth, 16, 16, colour=tmp_path / "grey.png").reflectivity.ravel()
    for level, found in enumerate(seen.tolist()):
        share = level / 255
        light = share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4
        assert found == pytest.approx(DARKEST + (BRIGHTEST - DARKEST) * light)


@pytest.mark.parametrize("colour", ["none.png", "no,ne.png", "a,b/none.png"])
def test_a_colour_picture_that_is_not_there_is_told_by_its_own_name(tmp_path, colour):
    """Behind that of a depth file that is there."""
    depth = png(tmp_path / "depth.png", np.full((4, 4), 2000))
    with pytest.raises(InputError, match=f"^{re.escape(str(tmp_path / colour))}: no such file"):
        load_scene(f"{depth},{tmp_path / colour}", 4, 4)


def test_invalid_samples_become_a_mask_and_a_note(tmp_path):
    depth_m = np.full((8, 8), 5.0)
    depth_m[0, 0], depth_m[0, 1], depth_m[1, 0], depth_m[1, 1] = 0, np.nan, -1, RANGE_M
    scene = depth_scene(npy(tmp_path / "holes.npy", depth_m), 8, 8)
    assert np.array_equal(np.argwhere(~scene.valid), [[0, 0], [0, 1], [1, 0], [1, 1]])
    assert all(
        any(word in note for note in scene.notes)
        for word in ("negative", "beyond", "no depth", "4 of 64 pixels")
    )
    assert depth_scene(npy(tmp_path / "holes.npy", depth_m), 4, 4).valid.sum() == 15


@pytest.mark.parametrize(
    ("bad_m", "what"),
    [
        (-1.5, "negative"),
        (80.0, "at or beyond the laser period's range of 74.95 m"),
        (RANGE_M, "at or beyond the laser period's range of 74.95 m"),
        (0.02, "below 0.05 m"),
    ],
)
@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("rows", [1, 3])
def test_one_number_out_of_range_is_a_mark_unless_it_is_a_near_distance(bad_m, what, several, rows):
    """Such marks may be many. Other samples out of range may be a tenth; of more, the first is told."""
    depth_m = np.full((20, 20), 5.0)
    depth_m[-rows:] = bad_m
    if several:
        depth_m[-rows, 0] *= 1.001
    number = 20 * rows
    if not several and bad_m != 0.02:
        scene = load_scene(depth_m, 20, 20)
        told = f"array: {number} samples {what} left out (all {bad_m:.6g} m, taken for no depth)"
        assert told in scene.notes
    elif rows == 1:
        scene = load_scene(depth_m, 20, 20)
        assert f"array: {number} samples {what} left out" in scene.notes
    else:
        told = f"^array: 15% of the samples are {what} \\(such as {depth_m[-rows, 0]:.6g} m\\), must be"
        with pytest.raises(InputError, match=told):
            load_scene(depth_m, 20, 20)
        return
    assert np.array_equal(scene.valid, depth_m == 5)


@pytest.mark.parametrize(
    ("distance_m", "is_seen"),
    [(0.0499, False), (0.05, True), (np.nextafter(RANGE_M, 0), True), (RANGE_M, False)],
)
def test_the_nearest_distance_of_a_picture_is_seen_and_that_of_the_range_is_not(
    distance_m, is_seen
):
    depth_m = np.full((8, 8), 5.0)
    depth_m[2, 3] = distance_m
    assert load_scene(depth_m, 8, 8).valid[2, 3] == is_seen


@pytest.mark.parametrize(("seen", "is_enough"), [(9, False), (10, True)])
def test_a_tenth_of_the_pixels_must_have_a_depth(seen, is_enough):
    depth_m = np.zeros((10, 10))
    depth_m.flat[:seen] = 5.0
    if is_enough:
        assert load_scene(depth_m, 10, 10).valid.sum() == seen
    else:
        with pytest.raises(InputError, match=r"array: 9.0% of the sensor's pixels have a usable"):
            load_scene(depth_m, 10, 10)


@pytest.mark.parametrize(
    "samples, words",
    [
        (np.zeros((8, 8)), "every sample is 0 or NaN"),
        (np.full((8, 8), np.nan), "every sample is 0 or NaN"),
        (np.full((8, 8), -2.0), "negative"),
        (np.full((8, 8), 5000.0), "range of 74.95 m .*the unit mm"),
        (np.full((8, 8), np.inf), "every sample is 0 or NaN"),
        (np.full((8, 8), 80_000), "range of 74.95 m"),
        (np.eye(32) * 3, "must be at least 10%"),
        (np.ones((8, 8, 3)), "two dimensions"),
        (np.ones(64), "two dimensions"),
        (np.ones((0, 8)), "two dimensions"),
        (np.ones((8, 8), complex), "must hold numbers"),
        (np.ones((8, 8), bool), "must hold numbers"),
    ],
)
def test_unusable_depth(tmp_path, samples, words):
    with pytest.raises(InputError, match=words):
        depth_scene(npy(tmp_path / "bad.npy", samples), 32, 32)


def test_files_that_are_no_depth(tmp_path):
    colour = tmp_path / "colour.png"
    Image.new("RGB", (8, 8), "white").save(colour)
    Image.new("L", (8, 8), 90).save(tmp_path / "grey.png")
    whole = png(tmp_path / "depth.png", np.full((64, 64), 3000)).read_bytes()
    (tmp_path / "cut.png").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.npy").write_text("no array", encoding="utf-8")
    (tmp_path / "depth.exr").write_bytes(b"v/1\x01")
    np.savez(tmp_path / "many.npz", a=np.ones(3))
    (tmp_path / "many.npz").rename(tmp_path / "many.npy")
    for name, words in (
        ("colour.png", "colour or 8 bit"),
        ("grey.png", "colour or 8 bit"),
        ("cut.png", "readable"),
        ("text.npy", "readable"),
        ("many.npy", "NPZ"),
        ("depth.exr", "readable picture"),
        ("none.npy", "no such file"),
        ("none.png", "no such file"),
    ):
        with pytest.raises(InputError, match=words):
            load_scene(tmp_path / name, 8, 8)
    with pytest.raises(InputError, match="another one is given"):
        load_scene(f"{tmp_path / 'depth.png'},{colour}", 8, 8, colour=colour)


@pytest.mark.parametrize("name", ["tunnel", "flat:5"])
def test_a_file_with_the_name_of_a_built_in_scene_is_that_file(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    png(tmp_path / "d.png", np.full((4, 4), 3000))
    (tmp_path / "d.png").rename(name)
    assert np.all(load_scene(name, 4, 4).truth_m == 3)


def test_an_empty_name_is_not_the_folder_where_one_is(tmp_path, monkeypatch):
    png(tmp_path / "d.png", np.full((4, 4), 3000))
    monkeypatch.chdir(tmp_path)
    assert load_scene(".", 4, 4).pictures == 1
    with pytest.raises(InputError, match=r"^: no such file \(built-in scenes: "):
        load_scene("", 4, 4)


@pytest.mark.parametrize("suffix", ["png", "pgm", "pfm", "exr", "npy", "npz"])
def test_a_depth_file_that_is_gone_is_told(tmp_path, suffix):
    """As between the moment in which it was found and that in which it is read."""
    path = tmp_path / f"gone.{suffix}"
    with pytest.raises(InputError, match=rf"^{re.escape(str(path))}: no such file$"):
        depth_scene(path, 4, 4)


def pfm(path, samples):
    path.write_bytes(
        b"Pf\n%d %d\n-1.0\n" % samples.shape[::-1] + samples[::-1].astype("<f4").tobytes()
    )
    return path


def exr(path, **channels):
    import OpenEXR

    header = {"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(
        header, {name.replace("_", "."): samples for name, samples in channels.items()}
    ).write(str(path))
    return path


def rotated(millimetres):
    return (millimetres << 3 | millimetres >> 13).astype(np.uint16)


RAMP_M = np.linspace(1, 4, 64).reshape(8, 8).round(2)


@pytest.mark.parametrize(
    ("write", "unit"),
    [
        (lambda at: png(at / "d.png", np.round(RAMP_M * 1000).astype(np.uint16)), None),
        (lambda at: png(at / "d.png", np.round(RAMP_M * 5000).astype(np.uint16)), "tum"),
        (lambda at: png(at / "d.png", np.round(RAMP_M * 5000).astype(np.uint16)), "1/5000"),
        (
            lambda at: png(at / "d.png", rotated(np.round(RAMP_M * 1000).astype(np.uint16))),
            "sun-rgbd",
        ),
        (lambda at: npy(at / "d.npy", RAMP_M), None),
        (lambda at: npy(at / "d.npy", np.round(RAMP_M * 1000).astype(int)), None),
        (lambda at: npy(at / "d.npy", RAMP_M * 100), "cm"),
        (lambda at: pfm(at / "d.pfm", RAMP_M), None),
        (lambda at: pfm(at / "d.pfm", 800 * 0.2 / RAMP_M - 3), "disparity:800,0.2,3"),
        (
            lambda at: exr(
                at / "d.exr", Z=RAMP_M.astype(np.float32), R=np.zeros((8, 8), np.float32)
            ),
            None,
        ),
        (lambda at: exr(at / "d.exr", View_Depth_Z=RAMP_M.astype(np.float16)), None),
    ],
)
def test_depth_files_in_their_units(tmp_path, write, unit):
    read = load_scene(str(write(tmp_path)), 8, 8, unit=unit)
    assert np.allclose(read.truth_m, RAMP_M, atol=2e-3)


def test_middleburys_calibration_lies_beside_the_file(tmp_path):
    path = pfm(tmp_path / "disp0.pfm", np.where(RAMP_M > 3.5, np.inf, 900 * 0.1 / RAMP_M - 20))
    with pytest.raises(InputError, match="needs disparity:FOCAL_PX,BASELINE_M or a calib.txt"):
        load_scene(str(path), 8, 8, unit="middlebury")
    (tmp_path / "calib.txt").write_text(
        "cam0=[900 0 10; 0 900 10; 0 0 1]\ndoffs=20\nbaseline=100\nwidth=8\n", encoding="utf-8"
    )
    read = load_scene(str(path), 8, 8, unit="middlebury").truth_m
    assert np.array_equal(np.isnan(read), RAMP_M > 3.5)  # what has no disparity stays a hole
    assert np.allclose(read[RAMP_M <= 3.5], RAMP_M[RAMP_M <= 3.5], atol=1e-4)


@pytest.mark.parametrize(
    "text",
    [
        "cam0=[900 0 10]\n",
        "baseline=100\n",
        "cam0=[]\nbaseline=100\n",
        "cam0=[a 0 10]\nbaseline=100\n",
        "cam0=[900 0 10]\nbaseline=wide\n",
        "cam0=[900 0 10]\nbaseline=100\ndoffs=few\n",
    ],
)
def test_a_calibration_without_its_numbers_is_told_as_one_that_is_missing(tmp_path, text):
    (tmp_path / "calib.txt").write_text(text, encoding="utf-8")
    path = pfm(tmp_path / "disp0.pfm", 900 * 0.1 / RAMP_M)
    with pytest.raises(InputError, match=r"disp0\.pfm: is read as disparities, which needs disp"):
        load_scene(str(path), 8, 8, unit="middlebury")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_a_calibration_without_an_offset_has_none(tmp_path, encoding):
    """Editors may begin a text with a mark of the byte order."""
    (tmp_path / "calib.txt").write_text("cam0=[900 0 10]\nbaseline=100\n", encoding=encoding)
    path = pfm(tmp_path / "disp0.pfm", 900 * 0.1 / RAMP_M)
    assert np.allclose(load_scene(str(path), 8, 8, unit="middlebury").truth_m, RAMP_M, atol=1e-4)


@pytest.mark.parametrize(
    "unit", ["m:5", "mm:800,0.2", "tum:5", "1/5000:1", "1/0", "1/", "disparity/0:8,1", "metres", ""]
)
def test_what_is_no_unit_is_refused(unit):
    """Also one with numbers that go with disparities only."""
    with pytest.raises(InputError, match=f"^unit = '{re.escape(unit)}': must be one of m, cm"):
        load_scene(np.full((4, 4), 4.0), 4, 4, unit=unit)


@pytest.mark.parametrize("unit", ["disparity", "disparity/16", "kitti-disparity"])
@pytest.mark.parametrize(
    "numbers", ["a,b", ",", "800", "0,1", "800,0", "800,-1", "-8,1", "nan,1", "8,inf", "8,1,nan"]
)
def test_disparities_need_a_focal_length_and_a_baseline_above_0(unit, numbers):
    told = f"unit = '{unit}:{numbers}': must be {unit}:FOCAL_PX,BASELINE_M[,OFFSET_PX]: "
    with pytest.raises(InputError, match=f"^{re.escape(told)}"):
        load_scene(np.full((4, 4), 4.0), 4, 4, unit=f"{unit}:{numbers}")


@pytest.mark.parametrize("unit", ["sun-rgbd", "nyu-raw"])
@pytest.mark.parametrize("number", [4.0, -1, 1 << 16])
def test_units_of_16_bits_are_those_of_integers_of_16_bits(unit, number):
    """Whatever type holds them: the bits of others would be those of other numbers."""
    samples = np.full((4, 4), 3000 if isinstance(number, int) else 3000.0)
    samples = samples.astype(type(number))
    samples[1, 2] = number
    told = f"^array: holds {samples.dtype}, must hold 16-bit integers for the unit {unit}$"
    with pytest.raises(InputError, match=told):
        load_scene(samples, 4, 4, unit=unit)


@pytest.mark.parametrize(
    ("samples", "words"),
    [
        (
            np.full((8, 8), 10_000, np.uint16) + 5 * np.arange(8, dtype=np.uint16),
            "with the unit tum it is 2 m",
        ),
        (rotated(np.full((8, 8), 1501, np.uint16)), "with the unit sun-rgbd it is 1.5 m"),
        (np.full((8, 8), 3500.0), "with the unit mm it is 3.5 m"),
    ],
)
def test_the_unit_that_would_fit(tmp_path, samples, words):
    try:
        told = " ".join(load_scene(str(npy(tmp_path / "d.npy", samples)), 8, 8).doubts)
    except InputError as error:
        told = str(error)
    assert words in told


def test_distances_as_an_array():
    read = load_scene(
        np.arange(2, 6).reshape(2, 2), 4, 4, reflectivity=np.array([[0.1, 0.2], [0.3, 0.4]])
    )
    assert read.truth_m[0, 0] == 2 and read.truth_m[3, 3] == 5
    assert read.reflectivity[0, 0] == 0.1 and read.reflectivity[3, 3] == 0.4


@pytest.mark.parametrize("is_file", [False, True])
def test_an_array_may_have_a_last_axis_of_one(tmp_path, is_file):
    """As some programs stack pictures; it is no sequence. So may reflectivities."""
    depth_m = np.arange(2.0, 18.0).reshape(4, 4)
    source = str(npy(tmp_path / "d.npy", depth_m[:, :, None])) if is_file else depth_m[:, :, None]
    scene = load_scene(source, 4, 4)
    assert scene.pictures == 1 and np.array_equal(scene.truth_m, depth_m)
    shares = depth_m / 20
    for reflectivity in (shares, shares[:, :, None], shares[None]):
        scene = load_scene(source, 4, 4, reflectivity=reflectivity)
        assert np.array_equal(scene.reflectivity[:, :, 0], shares)
    masked = np.ma.masked_array(depth_m[:, :, None], depth_m[:, :, None] == 7)
    assert np.array_equal(load_scene(masked, 4, 4).valid, depth_m != 7)


def test_a_pixel_has_its_nearest_target_whichever_comes_first():
    """It is invalid if it has none at all."""
    distance_m = np.array([[[np.nan, 5.0], [7.0, 3.0], [4.0, np.nan], [np.nan, np.nan]]])
    scene = Scene(name="own", distance_m=distance_m, reflectivity=0.4)
    assert scene.valid.tolist() == [[True, True, True, False]]
    assert np.array_equal(scene.truth_m, [[5.0, 3.0, 4.0, np.nan]], equal_nan=True)
    assert repr(scene) == "<Scene own: 1 x 4 pixels, 3 to 7 m>"


def test_a_scene_without_any_target_says_so():
    nothing = Scene(name="dark", distance_m=np.full((2, 3), np.nan), reflectivity=0.4)
    assert repr(nothing) == "<Scene dark: 2 x 3 pixels, no target>"


@pytest.mark.parametrize("wrong", ["five", "", 1j, 2**2000, object()])
@pytest.mark.parametrize("name", ["distance_m", "reflectivity", "klux"])
def test_light_of_a_scene_is_made_of_numbers(name, wrong):
    """Also where they are elements of an array, and not all of them are wrong."""
    given = {"distance_m": [[4.0, 5.0]], "reflectivity": [[0.4, 0.4]], "klux": [[5.0, 5.0]]}
    given[name] = [[given[name][0][0], wrong]]
    with pytest.raises(InputError, match=rf"^{name}(: must hold numbers|\[0, 1\] = nan: must be) "):
        Light.from_scene(**given)


def scene_of(distance_m, reflectivity, klux):  # noqa: ARG001 as of `Light.from_scene`
    return Scene(name="own", distance_m=distance_m, reflectivity=reflectivity)


def test_what_is_wrong_with_the_light_of_a_scene_is_told_as_it_was_given():
    scene = load_scene("flat:5", 4, 4)
    with pytest.raises(
        InputError, match="^klux = 1000000000000.0: is too much ambient light"
    ) as refused:
        scene_light(scene, 1e12)
    assert refused.value.field == "klux"
    with pytest.raises(InputError, match="^background = 'dark': must be one of"):
        scene_light(scene, 5, background="dark")
    with pytest.raises(InputError, match="^system_fwhm_s"):
        scene_light(scene, 5, system_fwhm_s=-1.0)


@pytest.mark.parametrize("shape", [(), (4,), (2, 3, 4, 1)])
@pytest.mark.parametrize("make", [scene_of, Light.from_scene])
def test_distances_have_rows_columns_and_perhaps_targets(make, shape):
    told = f"distance_m: has {len(shape)} dimensions, must have 2 or 3: rows, cols, targets"
    with pytest.raises(InputError, match=f"^{told}$"):
        make(np.full(shape, 4.0), 0.4, 5.0)


@pytest.mark.parametrize(
    ("source", "options", "words"),
    [
        (None, {}, "scene = None: must be a Scene, a name or file"),
        ("five-objects", {"unit": "mm"}, "goes with depth files only"),
        ("letter-f", {"colour": "a.png"}, "colour = 'a.png': goes with depth files only"),
        ("ray:corner", {"colour": "a.png"}, "colour = 'a.png': goes with depth files only"),
        ("flat:5", {"reflectivity": 0.9}, "reflectivity: goes with depth files and arrays"),
        (np.ones((4, 4)), {"unit": "ft"}, "unit = 'ft': must be one of m, cm, mm, 1/N"),
        (np.ones((4, 4)), {"reflectivity": np.ones(3)}, "reflectivity"),
        (__file__, {}, "is no scene, must be a depth file"),
    ],
)
def test_scenes_that_are_none(source, options, words):
    with pytest.raises(InputError, match=re.escape(words)):
        load_scene(source, 4, 4, **options)


@pytest.mark.parametrize("source", ["array", "wall.npy", "walls.npz", "walls.npz:near"])
def test_a_channel_goes_with_pictures_only(source, tmp_path):
    """An array of a file is named behind the file's name."""
    near_m = np.full((8, 8), 4.0)
    np.save(tmp_path / "wall.npy", near_m)
    np.savez(tmp_path / "walls.npz", near=near_m)
    given = near_m if source == "array" else str(tmp_path / source)
    assert load_scene(given, 8, 8).distance_m[0, 0] == 4
    with pytest.raises(InputError, match="channel = 'near': goes with pictures; FILE:NAME names"):
        load_scene(given, 8, 8, channel="near")


@pytest.mark.parametrize(
    ("field", "low", "high"),
    [
        ("distance_m", 0.05, 1e6),
        ("reflectivity", 0.0, 1.0),
        ("sunlit", 0.0, 1.0),
        ("labels", -(2**31) + 1, 2**31 - 1),
    ],
)
def test_the_ends_of_the_range_of_each_array_of_a_scene_are_legal(field, low, high):
    """They are kept as they are, and so are all numbers between them."""
    arrays = {"distance_m": 4.0, "reflectivity": 0.4, "sunlit": 1.0, "labels": 1}
    arrays = {name: np.full((2, 3), number, float) for name, number in arrays.items()}
    arrays[field][0] = low, (low + high) / 2, high
    kept = getattr(Scene(name="own", **arrays), field).reshape(2, 3)
    assert np.array_equal(kept, arrays[field])


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("distance_m", 0.0, "distance_m[1, 2] = 0.0: must be at least 0.05 or NaN"),
        ("reflectivity", 1.01, "reflectivity[1, 2] = 1.01: must be from 0 to 1"),
        ("reflectivity", -0.01, "reflectivity[1, 2] = -0.01: must be from 0 to 1"),
        ("sunlit", 1.01, "sunlit[1, 2] = 1.01: must be from 0 to 1"),
        ("sunlit", -0.01, "sunlit[1, 2] = -0.01: must be from 0 to 1"),
        ("labels", 2.0**31, "labels[1, 2] = 2147483648.0: must be from -2147483647 to 2147483647"),
        (
            "labels",
            -(2.0**31),
            "labels[1, 2] = -2147483648.0: must be from -2147483647 to 2147483647",
        ),
        ("labels", 2.5, "labels[1, 2] = 2.5: must be an integer"),
        ("labels", -0.5, "labels[1, 2] = -0.5: must be an integer"),
    ],
)
def test_each_array_of_a_scene_has_its_range(field, value, words):
    arrays = {"distance_m": 4.0, "reflectivity": 0.4, "sunlit": 1.0, "labels": 1}
    arrays = {name: np.full((2, 3), number, float) for name, number in arrays.items()}
    Scene(name="own", **arrays)
    arrays[field][1, 2] = value
    with pytest.raises(InputError, match=re.escape(words)):
        Scene(name="own", **arrays)
