# SPDX-License-Identifier: Apache-2.0
"""Depth files as cameras, data sets and renderers write them. Each case names who does, or where
others met it.
"""

import re
import zipfile

import h5py
import numpy as np
import OpenEXR
import pytest
from PIL import Image
from scipy.io import savemat

import coincid
from coincid.model.scenes.catalogue import load_scene
from coincid.model.scenes.conventions import CONVENTIONS, conventions_table
from coincid.model.scenes.image_files import read_pgm
from coincid.model.scenes.meaning import Meaning
from coincid.model.scenes.view import View
from coincid.model.shared.errors import InputError
from coincid.study.explore.controls import UNITS

from ..commands import ROOT

SHAPE = (4, 4)
HOLE = np.zeros(SHAPE, bool)
HOLE[0] = True


def png(path, samples):
    Image.fromarray(samples).save(path)
    return str(path)


def npy(path, samples):
    np.save(path, samples)
    return str(path)


def exr(path, header=None, **channels):
    usual = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    planes = {
        name: np.broadcast_to(np.float32(value), SHAPE).copy() for name, value in channels.items()
    }
    OpenEXR.File(usual | (header or {}), planes).write(str(path))
    return str(path)


def content(path, data):
    path.write_bytes(data)
    return str(path)


def with_hole(value, mark, dtype):
    return np.where(HOLE, mark, value).astype(dtype)


WALLS = {  # file, options, distance in metres
    "RealSense, OAK: 65535 is no depth": (
        lambda at: png(at / "d.png", with_hole(4000, 65535, "u2")),
        {},
        4,
    ),
    "BOP: 65535 is background": (
        lambda at: png(at / "d.png", with_hole(10000, 65535, "u2")),
        {"unit": "bop"},
        1,
    ),
    "Virtual KITTI: sky at 655.35 m": (
        lambda at: png(at / "d.png", with_hole(4000, 65535, "u2")),
        {"unit": "virtual-kitti"},
        40,
    ),
    "half floats end at 65504": (
        lambda at: npy(at / "d.npy", with_hole(4, 65504, "f4")),
        {"scale": 0.5},
        2,
    ),
    "-1 is no depth": (lambda at: npy(at / "d.npy", with_hole(4, -1, "f4")), {}, 4),
    "-9999 is no depth (rasters)": (lambda at: npy(at / "d.npy", with_hole(4, -9999, "f4")), {}, 4),
    "a far plane at 1000 m": (lambda at: npy(at / "d.npy", with_hole(4, 1000, "f4")), {}, 4),
    "a number of the user's": (
        lambda at: npy(at / "d.npy", with_hole(4, 7, "f4")),
        {"missing": 7},
        4,
    ),
    "a number that single floats do not hold": (
        lambda at: npy(at / "d.npy", with_hole(4, 7.1, "f4")),
        {"missing": 7.1},
        4,
    ),
    "a number of the user's beside 65535": (
        lambda at: png(at / "d.png", with_hole(4000, 65535, "u2")),
        {"missing": 7},
        4,
    ),
    "a number of the user's beside 65504": (
        lambda at: npy(at / "d.npy", with_hole(4, 65504, "f4")),
        {"missing": 7},
        4,
    ),
    "the last of several numbers of the user's": (
        lambda at: npy(at / "d.npy", with_hole(4, 9, "f4")),
        {"missing": [7, 8, 9]},
        4,
    ),
    "a sky of the user's": (lambda at: npy(at / "d.npy", with_hole(4, 60, "f4")), {"sky_m": 50}, 4),
}


@pytest.mark.parametrize("case", WALLS)
def test_samples_without_depth(tmp_path, case):
    write, options, distance_m = WALLS[case]
    read = load_scene(write(tmp_path), *SHAPE, **options)
    assert np.array_equal(read.valid, ~HOLE)
    assert np.all(read.truth_m[~HOLE] == distance_m)
    assert any("no depth" in note or "hold no depth" in note for note in read.notes)


@pytest.mark.parametrize(
    ("missing", "given"), [(None, []), (7, [7]), (0.5, [0.5]), ((8, 9), [8, 9])]
)
@pytest.mark.parametrize(("unit", "of_unit"), [(None, []), ("m", []), ("nyu-raw", [2047])])
def test_numbers_of_the_user_stand_beside_the_usual_ones_and_those_of_the_unit(
    missing, given, unit, of_unit
):
    marks = Meaning(unit=unit, missing=missing).marks
    assert sorted(marks.tolist()) == sorted([*given, 65535, 65504, *of_unit])


def test_the_mask_of_an_array_hides_samples():
    """NumPy's functions for masked arrays, and `numpy.asarray` of them, differ (numpy#4972)."""
    masked = np.ma.masked_array(np.where(HOLE, 1.5, 4.0), mask=HOLE)
    assert np.array_equal(load_scene(masked, *SHAPE).valid, ~HOLE)
    assert np.all(load_scene(np.asmatrix(masked.data), *SHAPE).truth_m[1:] == 4)


CHANNELS = {  # channels of an EXR file, options, distance or part of the error
    "Arnold: Z beside normals": (
        {"R": 0.5, "G": 0.4, "B": 0.3, "Z": 4, "N.X": 0.1, "N.Y": 0.2, "N.Z": 0.7},
        {},
        4,
    ),
    "Blender: a layer called Depth": (
        {"Depth.V": 4, "Normal.X": 0.1, "Normal.Y": 0.2, "Normal.Z": 0.7},
        {},
        4,
    ),
    "one axis beside the Z of a normal": ({"nn.X": 0.1, "nn.Z": 0.7, "Depth.V": 4}, {}, 4),
    "the other axis beside it": ({"nn.Y": 0.1, "nn.Z": 0.7, "Depth.V": 4}, {}, 4),
    "axes of another layer": ({"nn.X": 0.1, "nn.Y": 0.2, "View.Z": 4}, {}, 4),
    "a layer's Z": ({"View.Depth.Z": 4, "View.Combined.R": 0.5}, {}, 4),
    "one channel of any name": ({"V": 4}, {}, 4),
    "one channel beside alpha": ({"V": 4, "A": 1}, {}, 4),
    "one channel of a layer beside its alpha": ({"far.V": 4, "far.alpha": 1}, {}, 4),
    "grey as three equal colours": ({"R": 4, "G": 4, "B": 4}, {}, 4),
    "normals alone": (
        {"nn.X": 0.1, "nn.Y": 0.2, "nn.Z": 0.7},
        {},
        "nn.X, nn.Y, nn.Z, none of which",
    ),
    "colours alone": ({"R": 0.5, "G": 0.4, "B": 0.3}, {}, "R, G, B, none of which"),
    "Mitsuba's AOV": ({"R": 0.5, "dd.y.T": 4, "nn.X": 0.1, "nn.Z": 0.7}, {"unit": "mitsuba"}, 4),
    "pbrt's GBufferFilm": ({"R": 0.5, "Pz": 4, "Nz": 0.7}, {"unit": "pbrt"}, 4),
    "the user's choice": ({"R": 0.5, "Nz": 0.7, "far": 4}, {"channel": "far"}, 4),
    "a choice beside the unit's": ({"T": 9, "far": 4}, {"unit": "mitsuba", "channel": "far"}, 4),
    "a choice that is not there": ({"R": 0.5, "Z": 4}, {"channel": "far"}, "R, Z; must have far"),
}


@pytest.mark.parametrize("case", CHANNELS)
def test_the_channel_of_depth(tmp_path, case):
    channels, options, expected = CHANNELS[case]
    path = exr(tmp_path / "d.exr", **channels)
    if isinstance(expected, str):
        with pytest.raises(InputError, match=re.escape(expected)):
            load_scene(path, *SHAPE, **options)
    else:
        scene = load_scene(path, *SHAPE, **options)
        assert np.all(scene.truth_m == expected)
        if "channel" in options:
            assert "--channel" not in " ".join(scene.notes), "it was chosen already"


@pytest.mark.parametrize("wrong", [3, b"Z", ["Z"], True])
def test_a_channel_that_is_no_name_is_refused(tmp_path, wrong):
    path = exr(tmp_path / "d.exr", R=0.5, Z=4)
    with pytest.raises(InputError, match="^channel = .*: must be str or None$"):
        load_scene(path, *SHAPE, channel=wrong)


@pytest.mark.parametrize("origin", [(0, 0), (3, 5), (-2, 1), (6, -7)])
def test_a_part_of_an_exr_picture_is_at_its_place(tmp_path, origin):
    """The data window of OpenEXR is the part of the display window that is stored, wherever the
    display window begins.
    """
    x, y = origin
    window = {
        "dataWindow": (np.int32([x + 4, y]), np.int32([x + 7, y + 3])),
        "displayWindow": (np.int32([x, y]), np.int32([x + 7, y + 7])),
    }
    read = load_scene(exr(tmp_path / "d.exr", window, Z=4), *SHAPE)
    assert np.array_equal(np.argwhere(read.valid), [[0, 2], [0, 3], [1, 2], [1, 3]])


@pytest.mark.parametrize("origin", [(0, 0), (-2, 5)])
@pytest.mark.parametrize("down", [-2, -1, 0, 1, 2])
@pytest.mark.parametrize("across", [-2, 0, 1])
def test_what_an_exr_picture_stores_beyond_its_display_is_left_out(tmp_path, origin, down, across):
    """On each side; the rest stays at its place, and what is not stored has no depth."""
    x, y = origin
    stored_m = 2.0 + np.arange(16, dtype=np.float32).reshape(SHAPE)
    window = {
        "dataWindow": (np.int32([x + across, y + down]), np.int32([x + across + 3, y + down + 3])),
        "displayWindow": (np.int32([x, y]), np.int32([x + 3, y + 3])),
    }
    read = load_scene(exr(tmp_path / "d.exr", window, Z=stored_m), *SHAPE)
    expected_m = np.full(SHAPE, np.nan)
    for row, col in np.ndindex(SHAPE):
        if 0 <= row - down < 4 and 0 <= col - across < 4:
            expected_m[row, col] = stored_m[row - down, col - across]
    np.testing.assert_array_equal(read.truth_m, expected_m)


TIFF_OF_DOUBLES = bytes.fromhex("49492a00080000000900") + b"".join(
    np.array([tag, kind], "<u2").tobytes() + np.array([1, value], "<u4").tobytes()
    for tag, kind, value in (
        (256, 3, 4),
        (257, 3, 4),
        (258, 3, 64),
        (259, 3, 1),
        (262, 3, 1),
        (273, 4, 122),
        (278, 3, 4),
        (279, 4, 128),
        (339, 3, 3),
    )
) + bytes(4) + np.full(16, 4.0).tobytes()  # fmt: skip


@pytest.mark.parametrize(
    ("white", "stored"), [(1, "u1"), (255, "u1"), (256, ">u2"), (65535, ">u2")]
)
def test_numbers_of_a_pgm_file_are_as_wide_as_its_largest_needs(tmp_path, white, stored):
    numbers = np.array([[0, 1, white], [white, 1, 0]])
    content(tmp_path / "d.pgm", b"P5 3 2 %d\n" % white + numbers.astype(stored).tobytes())
    assert np.array_equal(read_pgm(tmp_path / "d.pgm"), numbers)


@pytest.mark.parametrize(
    "head", [b"P5", b"P5 3 2", b"P5 3 x 255 ", b"P2 3.5 2 255\n", b"P5 3 2 255"]
)
def test_a_grey_pgm_file_begins_with_its_size_and_white(tmp_path, head):
    path = content(tmp_path / "d.pgm", head)
    with pytest.raises(InputError, match=r"d\.pgm: is not a grey PGM file$"):
        load_scene(path, *SHAPE)


FILES = {  # file with a wall at 4 m
    "PGM in millimetres, with a maximum of 10000": lambda at: content(
        at / "d.pgm", b"P5\n# by a camera\n4 4\n10000\n" + np.full(SHAPE, 4000, ">u2").tobytes()
    ),
    "PGM as text": lambda at: content(at / "d.pgm", b"P2 4 4 10000\n" + b"4000 " * 16),
    "PGM as text, with another picture behind it": lambda at: content(
        at / "d.pgm", (b"P2 4 4 10000\n" + b"4000 " * 16) + (b"P2 4 4 10000\n" + b"5000 " * 16)
    ),
    "PGM with another picture behind it": lambda at: content(
        at / "d.pgm", 2 * (b"P5 4 4 10000\n" + np.full(SHAPE, 4000, ">u2").tobytes())
    ),
    "PFM with the scale +1.0": lambda at: content(
        at / "d.pfm", b"Pf\n4 4\n+1.0\n" + np.full(16, 4, ">f4").tobytes()
    ),
    "PFM with a comment": lambda at: content(
        at / "d.pfm", b"Pf\n# by a program\n4 4\n-1.0\n" + np.full(16, 4, "<f4").tobytes()
    ),
    "TIFF of doubles": lambda at: content(at / "d.tif", TIFF_OF_DOUBLES),
    "a big-endian array": lambda at: npy(at / "d.npy", np.full(SHAPE, 4000, ">u2")),
}


@pytest.mark.parametrize("case", FILES)
def test_numbers_are_read_as_they_are(tmp_path, case):
    assert np.all(load_scene(FILES[case](tmp_path), *SHAPE).truth_m == 4)


@pytest.mark.parametrize("distance_m", [4, 9])
def test_sun_rgbd_in_a_big_endian_array(tmp_path, distance_m):
    """Its bits are rotated, so those of distances beyond 8.192 m are at both ends."""
    number = 1000 * distance_m
    bits = np.full(SHAPE, (number << 3 | number >> 13) & 0xFFFF, ">u2")
    read = load_scene(npy(tmp_path / "d.npy", bits), *SHAPE, unit="sun-rgbd")
    assert np.all(read.truth_m == distance_m)


def test_disparities_of_kitti(tmp_path):
    """The development kit stores 256 numbers per pixel; without that, 20 m become 8 cm, and the
    note says so.
    """
    disparity = np.full(SHAPE, round(721.5 * 0.54 / 20 * 256), np.uint16)
    path = png(tmp_path / "d.png", disparity)
    for unit in ("disparity/256:721.5,0.54", "kitti-disparity:721.5,0.54"):
        assert load_scene(path, *SHAPE, unit=unit).truth_m == pytest.approx(20, abs=0.01)
    plain = load_scene(path, *SHAPE, unit="disparity:721.5,0.54")
    assert any("disparity/256:721.5,0.54 it is 20 m" in doubt for doubt in plain.doubts)
    (tmp_path / "calib.txt").write_text("cam0=[721.5 0 0]\nbaseline=540\n", encoding="utf-8")
    beside = load_scene(path, *SHAPE, unit="middlebury")
    assert any("with the unit kitti-disparity it is 20 m" in doubt for doubt in beside.doubts)
    with pytest.raises(InputError, match="three numbers at most"):
        load_scene(path, *SHAPE, unit="disparity:184704,0.54,0,5000")


def test_the_sky_is_at_a_distance_before_the_scale(tmp_path):
    distance_m = np.full(SHAPE, 4.0)
    distance_m[0, 0] = 40.0
    path = npy(tmp_path / "d.npy", distance_m)
    halved = load_scene(path, *SHAPE, unit="m", sky_m=30, scale=0.5)
    assert np.isnan(halved.truth_m[0, 0]) and np.nanmax(halved.truth_m) == 2
    larger = load_scene(npy(tmp_path / "e.npy", distance_m[1:]), 3, 4, unit="m", sky_m=30, scale=10)
    assert np.all(larger.truth_m == 40)


@pytest.mark.parametrize("offset_px", [3, 0, -3])
def test_the_offset_of_a_disparity_is_in_pixels_however_many_numbers_a_pixel_has(
    tmp_path, offset_px
):
    """A number of 0 is no disparity, whatever the offset is."""
    numbers = np.full(SHAPE, round((800 * 0.2 / 4 - offset_px) * 16), np.uint16)
    numbers[1, 2] = 0
    path = png(tmp_path / "d.png", numbers)
    truth_m = load_scene(path, *SHAPE, unit=f"disparity/16:800,0.2,{offset_px}").truth_m
    assert np.argwhere(np.isnan(truth_m)).tolist() == [[1, 2]]
    assert np.nanmin(truth_m) == np.nanmax(truth_m) == 4


def test_numbers_that_mean_no_depth_are_told(tmp_path):
    samples = np.full(SHAPE, 4000, np.uint16)
    path = npy(tmp_path / "d.npy", samples)
    assert "no depth" not in " ".join(load_scene(path, *SHAPE).notes)
    samples[0, :3] = 7, 65535, 7
    path = npy(tmp_path / "d.npy", samples)
    told = f"{path}: 3 samples are 7 or 65535, which is taken for no depth"
    assert told in load_scene(path, *SHAPE, missing=7).notes


@pytest.mark.parametrize("unit", ["sun-rgbd", "nyu-raw"])
@pytest.mark.parametrize("wrong", [-1, 0x10000])
def test_bits_that_are_moved_are_16(tmp_path, unit, wrong):
    """In integers of any size."""
    samples = np.full(SHAPE, {"sun-rgbd": 4000 << 3, "nyu-raw": 0xED03}[unit], np.int64)
    assert load_scene(npy(tmp_path / "d.npy", samples), *SHAPE, unit=unit).valid.all()
    samples[2, 1] = wrong
    with pytest.raises(InputError, match=f"d.npy: holds int64, must hold 16-bit .* unit {unit}$"):
        load_scene(npy(tmp_path / "d.npy", samples), *SHAPE, unit=unit)


@pytest.mark.parametrize("unit", ["sun-rgbd", "nyu-raw"])
def test_the_largest_number_of_16_bits_is_a_hole_also_where_bits_are_moved(tmp_path, unit):
    samples = np.full(SHAPE, {"sun-rgbd": 4000 << 3, "nyu-raw": 0xED03}[unit], np.uint16)
    samples[0, 0] = 0xFFFF
    truth_m = load_scene(npy(tmp_path / "d.npy", samples), *SHAPE, unit=unit).truth_m
    assert np.argwhere(np.isnan(truth_m)).tolist() == [[0, 0]]


@pytest.mark.parametrize(
    ("samples", "unit", "range_m", "told"),
    [
        (5 * np.arange(80, 121), "m", 75, "with the unit cm it is 5 m"),  # not 0.1 m of TUM
        (np.arange(4980, 5021), "mm", 3, "integers millimetres, unless a unit is given"),
    ],
)
def test_a_refusal_proposes_a_unit_that_makes_distances_usual(
    tmp_path, samples, unit, range_m, told
):
    path = npy(tmp_path / "d.npy", np.tile(samples, (40, 1)))
    with pytest.raises(InputError, match=told):
        load_scene(path, 8, 8, unit=unit, range_m=range_m)


def test_nyus_raw_files_are_recognized(tmp_path):
    """The toolbox swaps the bytes of the raw PGM files, and turns the Kinect's 11 bits into
    metres.
    """
    number = np.full(SHAPE, 1005, np.uint16) + np.arange(4, dtype=np.uint16)
    raw_m = 351.3 / (1092.5 - number)
    path = npy(tmp_path / "d.npy", number.byteswap())
    assert load_scene(path, *SHAPE, unit="nyu-raw").truth_m == pytest.approx(raw_m)
    try:
        told = " ".join(load_scene(path, *SHAPE, unit="nyu").doubts)
    except InputError as error:
        told = str(error)
    assert "with the unit nyu-raw it is 4" in told


def of_a_room(millimetres_max):
    """uint16[64, 64]: a floor of as many distances in millimetres as a room has."""
    return np.linspace(900, millimetres_max, 64 * 64).reshape(64, 64).astype(np.uint16)


HINTS = {  # samples, options, unit of the hint; "": none
    "TUM: 0.05 % of a real picture are no multiples of 5": (of_a_room(1500) * 5, {}, "tum"),
    "TUM, whose unit is given wrongly": (of_a_room(1500) * 5, {"unit": "realsense"}, "tum"),
    "TUM with its unit": (of_a_room(1500) * 5, {"unit": "tum"}, ""),
    "TUM, with the scale that makes metres of it": (of_a_room(1500) * 5, {"scale": 0.2}, ""),
    "centimetres, with the scale that makes metres of them": (
        of_a_room(4000) // 10,
        {"scale": 10},
        "",
    ),
    "SUN RGB-D: 3 % of a real picture are no multiples of 8": (of_a_room(950) << 3, {}, "sun-rgbd"),
    "SUN RGB-D with its unit": (of_a_room(950) << 3, {"unit": "sun-rgbd"}, ""),
    "millimetres": (of_a_room(7900), {}, ""),
    "millimetres, with the unit of TUM": (of_a_room(4000), {"unit": "tum"}, "mm"),
    "millimetres of 1 m, with that of SUN RGB-D": (of_a_room(1100), {"unit": "sun-rgbd"}, "mm"),
    "steps of 5 mm, which TUM's unit would bring too near": (
        np.linspace(60, 190, 64 * 64).reshape(64, 64).astype(np.uint16) * 5,
        {},
        "",
    ),
    "a wall, which is a multiple of 5 by accident": (np.full((64, 64), 4000, np.uint16), {}, ""),
    "what millimetres would bring too far, with the unit of TUM": (
        np.linspace(15000, 25000, 64 * 64).reshape(64, 64).astype(np.uint16),
        {"unit": "tum"},
        "",
    ),
    "disparities that are given, of something near": (
        np.full((64, 64), 1601, np.uint16),
        {"unit": "disparity/16:100,0.1"},
        "",
    ),
    "centimetres of a street, as they are given": (of_a_room(3000), {"unit": "cm"}, ""),
}


@pytest.mark.parametrize("case", HINTS)
def test_samples_of_another_data_set_are_told(tmp_path, case):
    """Also if their median is usual: 1.2 m of TUM are 6 m as millimetres."""
    samples, options, unit = HINTS[case]
    strays = samples.copy()
    strays[0, :2] += 1
    doubts = " ".join(load_scene(png(tmp_path / "d.png", strays), 8, 8, **options).doubts)
    assert re.findall(r"with the unit ([\w-]+)", doubts) == ([unit] if unit else [])
    assert bool(doubts) == bool(unit)


OUTDOORS = ("kitti", "virtual-kitti", "airsim", "airsim-ray", "blender", "mitsuba", "pbrt")


@pytest.mark.parametrize("name", OUTDOORS)
def test_distances_of_a_street_are_usual_in_data_sets_of_streets(tmp_path, name):
    """20 m in the middle, which a room does not have."""
    per_metre = {"kitti": 256, "virtual-kitti": 100}.get(name, 1)
    samples = np.linspace(15, 25, 64 * 64).reshape(64, 64) * per_metre
    if per_metre > 1:
        samples = samples.astype(np.uint16)
    path = npy(tmp_path / "d.npy", samples)
    assert load_scene(path, 8, 8, unit=name).doubts == ()


def skewed(middle):
    """uint16[64, 64]: samples of many values whose mean is far above their median."""
    samples = np.arange(64 * 64).reshape(64, 64) % 97 + middle - 48
    samples[:20] = 4 * middle
    return samples.astype(np.uint16)


@pytest.mark.parametrize(("name", "per_metre", "times"), [("tum", 5000, 5), ("sun-rgbd", 8000, 8)])
def test_medians_of_a_hint_are_those_of_the_samples(tmp_path, name, per_metre, times):
    samples = times * skewed(900)
    doubts = load_scene(npy(tmp_path / "d.npy", samples), 8, 8).doubts
    middle = np.median(samples)
    told = f"with the unit {name} the median distance is {middle / per_metre:.3g} m"
    assert f"{told}, not {middle / 1000:.3g} m" in " ".join(doubts)


def test_numbers_of_a_doubt_are_those_of_the_samples(tmp_path):
    """The share is that of the samples, not of their values."""
    samples = skewed(2000)
    share = np.mean(samples % 5 == 0)
    assert share > 2 * np.mean(np.unique(samples) % 5 == 0)
    doubts = load_scene(npy(tmp_path / "d.npy", samples), 8, 8, unit="tum").doubts
    told = (
        f"only {share:.0%} of the samples are multiples of 5, as tum writes them; with the unit mm"
    )
    assert f"{told} the median distance is {np.median(samples) / 1000:.3g} m" in " ".join(doubts)


@pytest.mark.parametrize(("most", "is_told"), [(65530, True), (65540, False)])
def test_samples_of_more_than_16_bits_are_those_of_no_data_set(tmp_path, most, is_told):
    samples = of_a_room(1500).astype(np.int64) * 5
    samples[0, 0] = most
    assert bool(load_scene(npy(tmp_path / "d.npy", samples), 8, 8).doubts) == is_told


def test_what_is_no_depth_picture_is_doubted(tmp_path):
    """Swapped bytes, and noise; a smooth scene with edges, holes and some noise is not."""
    rng = np.random.default_rng(7)
    steps = of_a_room(3000)
    steps[:, 32:] += 1500
    steps[10:20, 10:30] = 0
    noisy = steps + rng.integers(0, 60, steps.shape).astype(np.uint16)
    noise = rng.integers(1000, 5000, steps.shape).astype(np.uint16)
    for samples, words in (
        (steps, ""),
        (noisy, ""),
        (noisy.byteswap(), "bytes of the samples seem to be swapped"),
        (noise, "as in noise"),
        (np.where(steps == 0, 65535, noise).astype(np.uint16), "as in noise"),  # with other holes
        (noise / 1000, "as in noise"),
        (noise / 10_000, "as in noise"),  # all nearer than 1 m
        (np.full((64, 64), 4000, np.uint16), ""),
    ):
        doubts = load_scene(npy(tmp_path / "d.npy", samples), 8, 8).doubts
        assert len(doubts) == bool(words) and words in " ".join(doubts)
    raw = np.minimum(noisy // 8 + 500, 1000).astype(np.uint16)  # as the Kinect sends it
    path = npy(tmp_path / "raw.npy", raw.byteswap())
    assert load_scene(path, 8, 8, unit="nyu-raw").doubts == ()


def test_a_small_picture_has_too_few_samples_for_a_doubt(tmp_path):
    """A scene of a few steps would look like noise."""
    samples = np.random.default_rng(7).integers(1000, 5000, (16, 16)).astype(np.uint16)
    assert load_scene(npy(tmp_path / "d.npy", samples), 8, 8).doubts == ()


@pytest.mark.parametrize("axis", [0, 1])
def test_noise_on_a_slope_is_no_doubt(tmp_path, axis):
    """Distant samples differ far more than neighbours, whether it rises downwards or sideways."""
    slope = np.linspace(1500, 6000, 64).astype(np.uint16)
    samples = np.repeat(np.expand_dims(slope, 1 - axis), 64, axis=1 - axis)
    samples += np.random.default_rng(3).integers(0, 60, samples.shape).astype(np.uint16)
    assert load_scene(npy(tmp_path / "d.npy", samples), 8, 8).doubts == ()


def test_a_doubt_warns_who_calls_the_library(tmp_path):
    path = png(tmp_path / "d.png", of_a_room(1500) * 5)
    with pytest.warns(UserWarning, match="with the unit tum"):
        coincid.simulate(None, path, pulses=1, rows=8, cols=8)


def test_a_wall_of_z_is_flat_in_space(tmp_path):
    """Depth cameras and renderers store z (librealsense's projection, Blender's Z pass)."""
    path = npy(tmp_path / "d.npy", np.full((8, 12), 4.0))
    for options in ({"z": True}, {"z": np.True_}, {"z": True, "fov_deg": 90}):
        read = load_scene(path, 8, 12, **options)
        right, down = read.view.tangents(8, 12)
        along = read.truth_m / np.sqrt(1 + right**2 + down**2)
        assert along == pytest.approx(4, abs=1e-9)
    assert read.view.h_deg == pytest.approx(90) and np.tan(
        np.radians(read.view.v_deg / 2)
    ) == pytest.approx(8 / 12)
    plain = load_scene(path, 8, 12)
    assert np.all(plain.truth_m == 4) and any("--z" in note for note in plain.notes)
    assert not any("--z" in note for note in load_scene(path, 8, 12, unit="hypersim").notes)


def test_a_wall_of_z_is_seen_as_far_as_its_rays_are_within_the_range(tmp_path):
    path = npy(tmp_path / "d.npy", np.full((8, 12), 4.0))
    range_m = 4.4
    read = load_scene(path, 8, 12, z=True, range_m=range_m)
    along_m = 4.0 * read.view.ray_per_z(8, 12)
    assert 0 < np.mean(along_m >= range_m) < 0.5
    assert np.array_equal(read.valid, along_m < range_m)


def test_a_cropped_picture_has_a_smaller_view():
    part = View.of_part(90, (480, 640), (480, 480))
    assert part.h_deg == pytest.approx(part.v_deg) and np.tan(
        np.radians(part.h_deg / 2)
    ) == pytest.approx(0.75)


@pytest.mark.parametrize("shape", [(8, 8), (8, 24), (24, 8)])
def test_the_field_of_view_of_a_file_is_that_of_its_whole_picture(tmp_path, shape):
    """Of which the sensor sees the middle. How much farther the corners would be is told."""
    path = npy(tmp_path / "d.npy", np.full(shape, 4.0))
    view = load_scene(path, 8, 8, fov_deg=90).view
    half = 8 / shape[1]
    tangents = np.tan(np.radians([view.h_deg / 2, view.v_deg / 2]))
    assert tangents == pytest.approx([half, half])
    corner = np.hypot(1, np.sqrt(2) * half * 63 / 64) - 1
    notes = " ".join(load_scene(path, 8, 8, fov_deg=90).notes)
    assert f"--z makes the corners {corner:.0%} farther" in notes
    assert "--z makes the corners 15% farther" in " ".join(load_scene(path, 8, 8).notes)


@pytest.mark.parametrize(
    ("fov_deg", "part"), [(0.001, "h_deg = 0.000125"), (178.99, "v_deg = 179.6")]
)
def test_a_field_of_view_that_the_sensors_part_cannot_have_is_told_by_its_name(fov_deg, part):
    """The part is narrower or higher than the whole."""
    distance_m = np.full((8, 24) if fov_deg < 1 else (24, 8), 4.0)
    with pytest.raises(InputError, match=f"^fov_deg = {fov_deg}: .*{part}") as raised:
        load_scene(distance_m, 24, 8, fov_deg=fov_deg)
    assert raised.value.field == "fov_deg"


def test_grey_pictures_give_the_reflectivity_by_their_type(tmp_path):
    grey = np.full(SHAPE, 60, np.uint8)
    grey[2:] = 20
    wall = npy(tmp_path / "wall.npy", np.full(SHAPE, 4.0))
    of_8 = load_scene(wall, *SHAPE, colour=png(tmp_path / "8.png", grey)).reflectivity
    of_16 = load_scene(
        wall, *SHAPE, colour=png(tmp_path / "16.png", grey.astype(np.uint16) * 257)
    ).reflectivity
    assert of_16 == pytest.approx(of_8) and len(np.unique(of_8)) == 2
    Image.fromarray(np.where(grey == 60, 1, 0).astype(np.float32)).save(tmp_path / "f.tif")
    of_floats = load_scene(wall, *SHAPE, colour=tmp_path / "f.tif").reflectivity
    assert np.unique(of_floats) == pytest.approx([0.05, 0.8])
    with pytest.raises(InputError, match="must have the shape of the depth's 4 x 4"):
        load_scene(wall, *SHAPE, colour=png(tmp_path / "wide.png", np.zeros((4, 16), np.uint8)))


@pytest.mark.parametrize("shape", [(4, 8), (8, 4)])
@pytest.mark.parametrize("kind", ["u1", "u2", "f4"])
def test_a_grey_picture_that_is_not_square_gives_each_pixel_its_own_light(tmp_path, kind, shape):
    grey = np.linspace(0, 1, 32).reshape(shape)
    white = 1 if kind == "f4" else np.iinfo(kind).max
    Image.fromarray((grey * white).astype(kind)).save(tmp_path / "light.tif")
    wall = npy(tmp_path / "wall.npy", np.full(shape, 4.0))
    seen = load_scene(wall, *shape, colour=tmp_path / "light.tif").reflectivity.ravel()
    assert np.all(np.diff(seen) > 0)
    assert seen[[0, -1]] == pytest.approx([0.05, 0.8])


def test_a_folder_with_a_comma(tmp_path):
    folder = tmp_path / "a,b"
    folder.mkdir()
    wall = npy(folder / "d.npy", np.full(SHAPE, 4.0))
    colour = png(folder / "c,1.png", np.zeros(SHAPE, np.uint8))
    assert np.all(load_scene(f"{wall},{colour}", *SHAPE).reflectivity == 0.05)


def test_of_several_commas_the_last_one_that_fits_divides_depth_and_colour(tmp_path):
    """Files of all pairs may be there, or of none."""
    npy(tmp_path / "w.npy", np.full(SHAPE, 4.0))
    npy(tmp_path / "w.npy,a.npy", np.full(SHAPE, 5.0))
    png(tmp_path / "a.npy,b.png", np.zeros(SHAPE, np.uint8))
    png(tmp_path / "b.png", np.full(SHAPE, 255, np.uint8))
    scene = load_scene(f"{tmp_path}/w.npy,a.npy,{tmp_path}/b.png", *SHAPE)
    assert np.all(scene.truth_m == 5.0)
    assert np.all(scene.reflectivity == 0.8)
    with pytest.raises(InputError, match=r"^none\.png: "):
        load_scene(f"{tmp_path}/w.npy,a.npy,none.png", *SHAPE)
    with pytest.raises(InputError, match="a,b/depth.png: no such file"):
        load_scene(f"{tmp_path}/a,b/depth.png,colour.png", *SHAPE)


def test_one_table_of_conventions():
    assert conventions_table() in (ROOT / "docs" / "advise.md").read_text(encoding="utf-8")
    assert {one.name for one in CONVENTIONS} < set(UNITS)


def test_arrays_in_archives(tmp_path):
    """Hypersim writes HDF5; MATLAB 7.3 writes HDF5 with columns first; other MATLAB files are
    read by SciPy.
    """
    depth_m = np.arange(2.0, 18.0).reshape(SHAPE)
    np.savez(tmp_path / "a.npz", depth=depth_m, mask=np.ones(SHAPE, np.uint16), k=np.ones(3))
    with h5py.File(tmp_path / "b.h5", "w") as archive:
        archive["dataset"] = depth_m
    with h5py.File(tmp_path / "c.mat", "w") as archive:
        archive["frame/depth"] = depth_m.T
    savemat(tmp_path / "d.mat", {"depth": depth_m})
    for name in ("b.h5", "c.mat", "d.mat"):  # as Windows has them
        (tmp_path / f"2{name.upper()}").write_bytes((tmp_path / name).read_bytes())
    for source in (
        "a.npz:depth",
        "b.h5",
        "b.h5:dataset",
        "c.mat:frame/depth",
        "d.mat",
        "d.mat:depth",
        "2B.H5",
        "2C.MAT",
        "2D.MAT:depth",
    ):
        assert np.array_equal(load_scene(str(tmp_path / source), *SHAPE).truth_m, depth_m)
    for source in ("a.npz", "a.npz:none"):
        with pytest.raises(InputError, match="two dimensions depth, mask; must name one"):
            load_scene(str(tmp_path / source), *SHAPE)
    others = {"camera": "left", "lens": {"f": 1.4}, "names": np.array([["a", 2]], object)}
    savemat(tmp_path / "g.mat", {"depth": depth_m, **others})  # they are no pictures
    assert np.array_equal(load_scene(str(tmp_path / "g.mat"), *SHAPE).truth_m, depth_m)
    with h5py.File(tmp_path / "h.mat", "w") as archive:  # the same in MATLAB 7.3
        for name, kind in (
            ("camera", "char"),
            ("names", "cell"),
            ("lens/focus", "function_handle"),
        ):
            archive[name] = np.ones((4, 1), np.uint16)
            archive[name].attrs["MATLAB_class"] = np.bytes_(kind)
        archive["#refs#/b"] = np.ones(SHAPE)  # a part of a cell
        archive["depth"] = depth_m.T
        archive["depth"].attrs["MATLAB_class"] = "double"
    assert np.array_equal(load_scene(str(tmp_path / "h.mat"), *SHAPE).truth_m, depth_m)
    moving_m = np.stack([depth_m, depth_m + 1])
    np.savez(tmp_path / "f.npz", depth=depth_m, moving=moving_m, k=np.ones(3))
    still, moving = (load_scene(f"{tmp_path}/f.npz{name}", *SHAPE) for name in ("", ":moving"))
    assert np.array_equal(still.truth_m, depth_m) and still.pictures == 1
    assert moving.pictures == 2
    colour = png(tmp_path / "c.png", np.zeros(SHAPE, np.uint8))
    assert np.all(load_scene(f"{tmp_path / 'a.npz'}:depth,{colour}", *SHAPE).reflectivity == 0.05)
    evening = tmp_path / "run 18:30, left"
    evening.mkdir()
    np.savez(evening / "a.npz", depth=depth_m, other=depth_m + 1)
    assert np.array_equal(load_scene(f"{evening}/a.npz:depth", *SHAPE).truth_m, depth_m)
    (tmp_path / "e.mat").write_bytes(b"no archive")
    with pytest.raises(InputError, match="e.mat: is not a readable archive"):
        load_scene(str(tmp_path / "e.mat"), *SHAPE)


@pytest.mark.parametrize("version", [(1, 0), (2, 0)])
def test_arrays_of_an_archive_may_have_either_header_of_numpy(tmp_path, version):
    """The later one, which NumPy writes for long headers, has a longer length."""
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        with archive.open("depth.npy", "w") as member:
            np.lib.format.write_array(member, np.full(SHAPE, 4.0), version=version)
    assert np.all(load_scene(str(tmp_path / "a.npz"), *SHAPE).truth_m == 4)


def write_npz(path, arrays):
    np.savez(path, **arrays)


def write_hdf5(path, arrays):
    with h5py.File(path, "w") as archive:
        archive.update(arrays)


ARCHIVES = {"npz": write_npz, "h5": write_hdf5, "mat": savemat}


@pytest.mark.parametrize("suffix", ARCHIVES)
@pytest.mark.parametrize(
    ("shapes", "told"),
    [
        ({"far": (3, 4, 4), "near": (2, 4, 4)}, "none, of three dimensions far, near; must name"),
        (
            {"far": SHAPE, "moving": (2, 4, 4), "near": SHAPE},
            "far, near, of three dimensions moving; must name",
        ),
        ({"deep": (2, 2, 4, 4)}, "none; must name"),
    ],
)
def test_arrays_of_an_archive_are_told_by_their_dimensions(tmp_path, suffix, shapes, told):
    path = tmp_path / f"a.{suffix}"
    ARCHIVES[suffix](path, {name: np.full(shape, 4.0) for name, shape in shapes.items()})
    with pytest.raises(InputError) as error:
        load_scene(str(path), *SHAPE)
    assert str(error.value).startswith(f"{path}: has the arrays of two dimensions {told} one of")
    assert str(error.value).endswith(f"them, as {path}:NAME")


@pytest.mark.parametrize("suffix", [*ARCHIVES, "npy", "png", "pfm", "exr"])
def test_a_suffix_may_be_in_capitals(tmp_path, suffix):
    """As some cameras and most files from Windows have it."""
    small = tmp_path / f"d.{suffix}"
    depth_m = np.full(SHAPE, 4.0)
    if suffix in ARCHIVES:
        ARCHIVES[suffix](small, {"depth": depth_m})
    elif suffix == "npy":
        np.save(small, depth_m)
    elif suffix == "png":
        png(small, np.full(SHAPE, 4000, np.uint16))
    elif suffix == "pfm":
        content(small, b"Pf\n4 4\n-1.0\n" + np.full(16, 4, "<f4").tobytes())
    else:
        exr(small, Z=4)
    large = small.rename(tmp_path / f"D.{suffix.upper()}")
    assert np.all(load_scene(str(large), *SHAPE).truth_m == 4)
