# SPDX-License-Identifier: Apache-2.0
"""Kinds of pictures that hold depth only at second sight, or none: nothing of them is read in
silence. Each case names who writes such files.
"""

import re

import h5py
import numpy as np
import OpenEXR
import pytest
from PIL import Image, ImageOps, TiffImagePlugin
from scipy.io import savemat

from coincid.model.scenes.catalogue import load_scene
from coincid.model.shared.errors import InputError

from .test_brought_files import HOLE, SHAPE, content, exr, npy, png

WALL_MM = np.full(SHAPE, 4000, np.uint16)
SEED = 20261127  # of damages
DAMAGES = 60  # of each file
HEAD_BYTES = 400  # in which they are


def tiff(path, samples, **tags):
    """Write a TIFF of floats with tags t274 (orientation), t42113 (GDAL's number of no data)."""
    told = TiffImagePlugin.ImageFileDirectory_v2()
    for name, value in tags.items():
        told[int(name[1:])] = value
    Image.fromarray(samples.astype(np.float32)).save(path, tiffinfo=told)
    return str(path)


def parts(path, **channels):
    """Write an EXR file with one part for each channel, as Blender and Nuke do."""
    form = {"type": OpenEXR.scanlineimage}
    written = [
        OpenEXR.Part({"name": name} | form, {channel: np.full(SHAPE, value, np.float32)})
        for name, (channel, value) in channels.items()
    ]
    OpenEXR.File(written).write(str(path))
    return str(path)


def image(path, mode, colour, **options):
    Image.new(mode, SHAPE, colour).save(path, **options)
    return str(path)


def deep(path):
    """Write an EXR file with two samples in each pixel, as of smoke before a wall."""
    samples = np.empty(SHAPE, object)
    for place in np.ndindex(*SHAPE):
        samples[place] = np.array([4, 5], np.float32)
    form = {"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.deepscanline}
    OpenEXR.File(form, {"Z": samples}).write(str(path))
    return str(path)


def pages(path, samples):
    first, *others = [Image.fromarray(one) for one in samples]
    first.save(path, save_all=True, append_images=others)
    return str(path)


def pfm(path, samples, scale=b"-1.0"):
    return content(path, b"Pf\n4 4\n" + scale + b"\n" + samples.astype("<f4").tobytes())


READ = {  # file, options, distance in metres, part of a note ("" if none is needed)
    "the depth part of several (Blender)": (
        lambda at: parts(at / "d.exr", beauty=("R", 0.5), depth=("Z", 4)),
        {},
        4,
        "is the channel Z",
    ),
    "the left of two eyes": (
        lambda at: parts(at / "d.exr", left=("Z", 4), right=("Z", 5)),
        {},
        4,
        "takes another one (right.Z)",
    ),
    "the right of two eyes": (
        lambda at: parts(at / "d.exr", left=("Z", 4), right=("Z", 5)),
        {"channel": "right.Z"},
        5,
        "",
    ),
    "a layer of three equal colours (Blender's file output)": (
        lambda at: exr(at / "d.exr", R=0.5, **{"depth.R": 4, "depth.G": 4, "depth.B": 4}),
        {},
        4,
        "is the channel depth.R",
    ),
    "Middlebury's scale 1/255 is no factor": (
        lambda at: pfm(at / "d.pfm", np.full(SHAPE, 4), b"-0.003922"),
        {},
        4,
        "",
    ),
    "pages of a TIFF": (
        lambda at: pages(at / "d.tif", np.float32([np.full(SHAPE, 4), np.full(SHAPE, 5)])),
        {},
        4,
        "is the first of 2 pictures",
    ),
    "an animated PNG": (
        lambda at: pages(at / "d.png", np.uint8([np.full(SHAPE, 90), np.full(SHAPE, 120)])),
        {"unit": "cm"},
        0.9,
        "is the first of 2 pictures",
    ),
    "grey with alpha": (lambda at: image(at / "d.png", "LA", (90, 9)), {"unit": "cm"}, 0.9, "Y"),
    "three equal colours": (
        lambda at: image(at / "d.png", "RGB", (90, 90, 90)),
        {"unit": "cm"},
        0.9,
        "is the channel R",
    ),
    "a JPEG of depth": (
        lambda at: image(at / "d.jpg", "L", 90),
        {"unit": "cm"},
        0.9,
        "compression changes distances",
    ),
    "half floats": (lambda at: npy(at / "d.npy", np.full(SHAPE, 4, np.float16)), {}, 4, ""),
    "signed 16 bits": (lambda at: tiff(at / "d.tif", WALL_MM / 1000), {}, 4, ""),
    "an archive with an object beside": (
        lambda at: (np.savez(at / "d.npz", a=np.array([None]), d=WALL_MM), str(at / "d.npz"))[1],
        {},
        4,
        "",
    ),
}


@pytest.mark.parametrize("case", READ)
def test_pictures_that_are_depth(tmp_path, case):
    write, options, distance_m, note = READ[case]
    scene = load_scene(write(tmp_path), *SHAPE, **options)
    assert scene.truth_m == pytest.approx(np.full(SHAPE, distance_m))
    assert any(note in one for one in scene.notes)


HOLES = {  # file whose upper row has no depth
    "GDAL's tag of no data, any number": lambda at: tiff(
        at / "d.tif", np.where(HOLE, 7, 4), t42113="7"
    ),
    "GDAL's -9999": lambda at: tiff(at / "d.tif", np.where(HOLE, -9999, 4), t42113="-9999"),
    "the lowest signed integer": lambda at: npy(
        at / "d.npy", np.where(HOLE, -(1 << 31), 4000).astype(np.int32)
    ),
    "the highest integer": lambda at: npy(
        at / "d.npy", np.where(HOLE, (1 << 32) - 1, 4000).astype(">u4")
    ),
    "infinity": lambda at: pfm(at / "d.pfm", np.where(HOLE, np.inf, 4)[::-1]),
    "1e10 (Blender)": lambda at: npy(at / "d.npy", np.where(HOLE, 1e10, 4)),
}


@pytest.mark.parametrize("case", HOLES)
def test_holes_by_any_mark(tmp_path, case):
    scene = load_scene(HOLES[case](tmp_path), *SHAPE)
    assert np.array_equal(scene.valid, ~HOLE) and np.all(scene.truth_m[~HOLE] == 4)


REFUSED = {  # file, options, part of the error
    "colours of a layer called depth": (
        lambda at: exr(at / "d.exr", **{"depth.R": 4, "depth.G": 3, "depth.B": 2}),
        {},
        "depth.R, depth.G, depth.B, none of which",
    ),
    "depth in two bytes of a colour picture": (
        lambda at: image(at / "d.png", "RGBA", (160, 15, 0, 255)),
        {"unit": "mm"},
        "R, G, B, A, none of which",
    ),
    "three colours of 16 bits that differ": (
        lambda at: content(
            at / "d.ppm",
            b"P6 4 4 65535\n" + np.tile([4000, 4001, 4000], 16).astype(">u2").tobytes(),
        ),
        {},
        "R, G, B, none of which",
    ),
    "a colour PFM": (
        lambda at: content(
            at / "d.pfm", b"PF\n4 4\n-1\n" + np.tile([1, 2, 3], 16).astype("<f4").tobytes()
        ),
        {},
        "R, G, B, none of which",
    ),
    "CMYK": (lambda at: image(at / "d.tif", "CMYK", (9, 20, 30, 40)), {}, "none of which"),
    "a palette": (
        lambda at: image(at / "d.gif", "RGB", (9, 20, 30)),
        {"unit": "cm"},
        "none of which|must be a depth file",
    ),
    "one bit": (lambda at: image(at / "d.png", "1", 1), {}, "8 bit picture"),
    "several samples in a pixel": (
        lambda at: deep(at / "d.exr"),
        {},
        r"d\.exr: is a deep picture, must have one sample per pixel$",
    ),
    "8 bits in an array": (lambda at: npy(at / "d.npy", np.full(SHAPE, 90, np.uint8)), {}, "8 bit"),
    "a table of fields": (
        lambda at: npy(at / "d.npy", np.zeros(SHAPE, [("z", "f4")])),
        {},
        "must hold numbers",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_pictures_that_are_no_depth(tmp_path, case):
    write, options, words = REFUSED[case]
    with pytest.raises(InputError, match=words):
        load_scene(write(tmp_path), *SHAPE, **options)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_pictures_stand_upright(tmp_path, orientation):
    """Depth as Pillow turns it, and colours alike (phones write the tag)."""
    depth_m = np.arange(2.0, 18.0).reshape(SHAPE)
    path = tiff(tmp_path / "d.tif", depth_m, t274=orientation)
    with Image.open(path) as picture:
        upright = np.asarray(ImageOps.exif_transpose(picture))
    assert np.array_equal(load_scene(path, *SHAPE).truth_m, upright)
    light = tiff(tmp_path / "c.tif", depth_m / 20, t274=orientation)
    found = load_scene(path, *SHAPE, colour=light).reflectivity[:, :, 0]
    assert found == pytest.approx(0.05 + 0.75 * upright / 20)


def written(at):
    """Yield a file of every accepted kind."""
    yield png(at / "d.png", WALL_MM)
    yield tiff(at / "d.tif", np.full(SHAPE, 4))
    yield content(at / "d.pgm", b"P5 4 4 65535\n" + WALL_MM.astype(">u2").tobytes())
    yield pfm(at / "d.pfm", np.full(SHAPE, 4))
    yield exr(at / "d.exr", Z=4)
    yield npy(at / "d.npy", WALL_MM)
    np.savez(at / "d.npz", depth=WALL_MM)
    yield str(at / "d.npz")
    with h5py.File(at / "d.h5", "w") as archive:
        archive["depth"] = WALL_MM
    yield str(at / "d.h5")
    savemat(at / "d.mat", {"depth": WALL_MM})
    yield str(at / "d.mat")


def test_damaged_files_of_every_kind(tmp_path):
    """A part of a file, and an empty one, is an error with the name of the file."""
    for path in written(tmp_path):
        assert np.all(load_scene(path, *SHAPE).truth_m == 4)
        with open(path, "rb") as file:
            whole = file.read()
        for share in (0.0, 0.4, 0.7):
            content(tmp_path / path.rpartition("/")[2], whole[: int(share * len(whole))])
            with pytest.raises(InputError, match=re.escape(path)):
                load_scene(path, *SHAPE)


def test_a_file_with_some_wrong_bytes_is_a_scene_or_an_error_of_one_line(tmp_path):
    """Except for MATLAB files, whose reader in SciPy does not survive all of them."""
    rng = np.random.default_rng(SEED)
    for path in written(tmp_path):
        if path.endswith(".mat"):
            continue
        with open(path, "rb") as file:
            whole = file.read()
        for _ in range(DAMAGES):
            damaged = np.frombuffer(whole, np.uint8).copy()
            at = rng.integers(0, min(len(whole), HEAD_BYTES), rng.integers(1, 4))
            damaged[at] = rng.choice([0, 1, 127, 128, 255], len(at))
            content(tmp_path / path.rpartition("/")[2], damaged.tobytes())
            try:
                with np.errstate(all="raise"):
                    load_scene(path, *SHAPE)
            except InputError as error:
                assert "\n" not in str(error) and len(str(error)) < 600, path


def test_a_signaling_nan_is_no_depth(tmp_path):
    """As some programs write it; a conversion to double tells it as invalid."""
    samples = np.full(SHAPE, 4, np.float32)
    samples.view(np.uint32)[1, 2] = 0x7FA00000
    with np.errstate(all="raise"):
        truth_m = load_scene(npy(tmp_path / "d.npy", samples), *SHAPE).truth_m
    assert np.isnan(truth_m[1, 2]) and np.sum(truth_m == 4) == truth_m.size - 1


def test_a_file_is_a_file_whatever_its_name(tmp_path, monkeypatch):
    """`array` is the name of distances in memory, of which nothing is assumed."""
    monkeypatch.chdir(tmp_path)
    depth_mm = np.full((8, 8), 4000, np.uint16)
    Image.fromarray(depth_mm).save("array.png")
    of_file = load_scene("array.png", 8, 8)
    in_memory = load_scene(depth_mm / 1000, 8, 8)
    assert any("along the rays" in note for note in of_file.notes)
    assert not any("along the rays" in note for note in in_memory.notes)
