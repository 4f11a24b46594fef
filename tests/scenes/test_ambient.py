# SPDX-License-Identifier: Apache-2.0
"""Ambient light across the picture: every form, resampled, in the background of every kind of
scene; and faulty inputs.
"""

import numpy as np
import pytest
from PIL import Image

from coincid.model.scenes.ambient import ambient_klux, told_klux
from coincid.model.scenes.catalogue import load_scene, usual_klux
from coincid.model.scenes.scene import scene_light
from coincid.model.shared.errors import InputError


@pytest.mark.parametrize("text", ["0", "0.0", "50", "0.25", "1e-3", "2.5e2", " 7 "])
def test_the_text_of_a_number_is_the_number(text):
    """Also no light at all, in which case nothing is a file of that name."""
    klux = float(text)
    assert ambient_klux(text, 4, 4) == ambient_klux(klux, 4, 4) == klux
    assert told_klux(text) == told_klux(klux) == klux
    assert np.array_equal(ambient_klux(f"{text}|3", 1, 2), [[klux, 3]])
    assert np.array_equal(ambient_klux(f"3|{text}", 1, 2), [[3, klux]])


def test_halves():
    half = ambient_klux("2|100", 3, 6)
    assert np.all(half[:, :3] == 2) and np.all(half[:, 3:] == 100)
    # the middle one of an odd number is in the sun
    assert ambient_klux("2|100", 1, 5).tolist() == [[2, 2, 100, 100, 100]]
    assert ambient_klux("2|100", 1, 1).tolist() == [[100]]


def test_a_file_may_have_the_sign_of_the_halves_in_its_name(tmp_path):
    path = tmp_path / "left|right.npy"
    np.save(path, np.full((2, 2), 7.0))
    assert np.array_equal(ambient_klux(str(path), 2, 2), np.full((2, 2), 7.0))


@pytest.mark.parametrize("name", ["sun-and-shade", "tunnel"])
def test_a_scene_in_full_sun_is_so_with_its_parameter(name):
    assert (
        usual_klux(name) == usual_klux(f"{name}:0.04") > usual_klux("flat") == usual_klux("flat:5")
    )
    assert usual_klux(name, 100.0) == 0  # a file of histograms, which have their background


def test_an_array_of_light_has_the_shape_of_the_sensor():
    """Or one that broadcasts to it; it is told by its ends."""
    across = np.array([[1.0, 7.0, 3.0, 4.0]])
    assert np.array_equal(ambient_klux(across, 3, 4), np.repeat(across, 3, axis=0))
    assert told_klux(across) == "1 to 7" and told_klux("7|1") == "7|1"
    with pytest.raises(InputError, match=r"klux: has shape \(1, 4\), must be \(4, 3\)"):
        ambient_klux(across, 4, 3)
    with pytest.raises(InputError, match=r"klux\[2, 1\] = -1.0: must be at least 0"):
        ambient_klux(np.where(np.arange(12).reshape(3, 4) == 9, -1.0, 1.0), 3, 4)


def test_array_in_klux_takes_the_mean_of_what_a_pixel_covers(tmp_path):
    klux = np.arange(24.0).reshape(4, 6)
    path = tmp_path / "sun.npy"
    np.save(path, klux)
    assert np.array_equal(ambient_klux(str(path), 4, 6), klux)
    assert np.array_equal(ambient_klux(str(path), 2, 3), klux.reshape(2, 2, 3, 2).mean(axis=(1, 3)))
    assert np.array_equal(ambient_klux(str(path), 8, 12), klux.repeat(2, 0).repeat(2, 1))
    # the middle, with the sensor's aspect ratio
    assert np.array_equal(ambient_klux(str(path), 4, 4), klux[:, 1:5])
    assert np.array_equal(ambient_klux(str(path), 2, 6), klux[1:3])


def test_files_of_light_may_have_capitals_and_commas_in_their_names(tmp_path):
    """The white level stands behind the last comma."""
    np.save(tmp_path / "sun.npy", np.full((2, 2), 7.0))
    (tmp_path / "sun.npy").rename(tmp_path / "SUN.NPY")
    assert np.array_equal(ambient_klux(str(tmp_path / "SUN.NPY"), 2, 2), np.full((2, 2), 7.0))
    Image.fromarray(np.array([[0, 255], [255, 0]], np.uint8)).save(tmp_path / "a,b.png")
    found = ambient_klux(f"{tmp_path / 'a,b.png'},120", 2, 2)
    assert np.array_equal(found, [[0, 120], [120, 0]])


@pytest.mark.parametrize(
    "depth, white", [("u1", 255), ("<u2", 65535), (">u2", 65535), ("i4", 65535)]
)
def test_grey_picture_has_its_white_level(tmp_path, depth, white):
    path = tmp_path / "sun.tif"
    Image.fromarray(np.array([[0, white], [white, 0]], depth)).save(path)
    assert np.array_equal(ambient_klux(f"{path},120", 2, 2), [[0, 120], [120, 0]])


def test_background_follows_map_and_reflectivity():
    scene = load_scene("five-objects", 32, 32)
    light, dark = scene_light(scene, "10|100"), scene_light(scene, 10)
    ratio = (light.background_cps / dark.background_cps).reshape(32, 32)
    assert ratio[:, :16] == pytest.approx(1) and ratio[:, 16:] == pytest.approx(10)
    assert dark.background_cps == pytest.approx(1.226e6 / 5 * scene.reflectivity.ravel() / 0.4)
    assert scene_light(scene, 10, background="even").background_cps == pytest.approx(1.226e6 / 5)
    assert np.array_equal(light.signal_per_pulse, dark.signal_per_pulse)


def test_what_is_wrong_is_named(tmp_path):
    colour, negative, flat = (
        tmp_path / "colour.png",
        tmp_path / "negative.npy",
        tmp_path / "flat.npy",
    )
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(colour)
    np.save(negative, np.full((4, 4), -1.0))
    np.save(flat, np.ones(4))
    np.save(tmp_path / "colour.npy", np.ones((4, 4, 3)))
    for source, message in {
        "-1": "klux = -1.0: must be a number of at least 0",
        "nan": "klux = nan",
        "bright": "klux = 'bright': must be a number, LOW|HIGH",
        "1|2|3": "klux = '1|2|3': must be a number",
        "1|x": "klux = '1|x': must be a number",
        "2|-5": "klux = -5.0",
        str(colour): "needs its white level in klux",
        str(colour.with_suffix(".npy")): "must hold numbers in two dimensions",
        f"{colour},100": "mode RGB, must be grey",
        f"{colour},-1": "klux = -1.0",
        str(negative): "klux[0, 0] = -1.0: must be at least 0",
        str(flat): "must hold numbers in two dimensions",
        "nowhere.npy": "nowhere.npy: no such file",
        "nowhere.png,5": "nowhere.png: no such file",
    }.items():
        with pytest.raises(InputError) as raised:
            ambient_klux(source, 4, 4)
        assert message in str(raised.value)
