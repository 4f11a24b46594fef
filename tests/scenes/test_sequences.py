# SPDX-License-Identifier: Apache-2.0
"""Depth pictures in sequence: frame k sees picture k, from files to the result of the sensor."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image
from scipy.io import savemat

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.config import parse_config
from coincid.model.scenes.catalogue import load_scene
from coincid.model.scenes.scene import scene_light
from coincid.model.shared.errors import InputError
from coincid.study.run import simulate

SHAPE = (8, 8)
WALLS_M = (3.0, 4.0, 5.0)
CONFIG = parse_config({"sensor": {"rows": 8, "cols": 8}, "frame": {"pulses": 40, "period": 40}})


def pictures():
    return np.stack([np.full(SHAPE, wall_m) for wall_m in WALLS_M])


def png(path, depth_m):
    Image.fromarray(np.round(depth_m * 1000).astype(np.uint16)).save(path)


def folder_of(at):
    """Return a folder with numbers of different widths, in which names and numbers disagree."""
    folder = at / "frames"
    folder.mkdir()
    for name, picture in zip(("d_9.png", "d_10.png", "d_100.png"), pictures(), strict=True):
        png(folder / name, picture)
    (folder / "times.txt").write_text("no picture", encoding="utf-8")
    return str(folder)


def capitals_of(at):
    folder = Path(folder_of(at))
    for path in list(folder.iterdir()):
        path.rename(folder / path.name.upper())
    return str(folder)


def npz_of(at):
    np.savez(at / "a.npz", depth=pictures(), times=np.arange(3))
    return str(at / "a.npz")


def hdf5_of(at):
    with h5py.File(at / "a.h5", "w") as archive:
        archive["run/depth"] = pictures()
    return f"{at / 'a.h5'}:run/depth"


def mat_of(at):
    savemat(at / "a.mat", {"depth": np.moveaxis(pictures(), 0, 2)})  # as MATLAB's users stack
    return f"{at / 'a.mat'}:depth"


def mat_73_of(at):
    """MATLAB's later files are HDF5, which lists the last axis first."""
    stacked = np.moveaxis(pictures(), 0, 2)
    with h5py.File(at / "b.mat", "w") as archive:
        archive["depth"] = stacked.T
    return str(at / "b.mat")


def in_capitals(of):
    """Return a function that gives the file of another one a name in capitals."""

    def renamed(at):
        path = Path(of(at).partition(":")[0])
        return str(path.rename(path.with_name(path.name.upper())))

    return renamed


def npz_beside_matlab_of(at):
    """Its folder only looks like one of MATLAB's files."""
    folder = at / "of.material"
    folder.mkdir()
    return npz_of(folder)


def npy_of(at):
    np.save(at / "a.npy", (pictures() * 1000).astype(">u2"))
    return str(at / "a.npy")


SOURCES = {
    "a folder": folder_of,
    "a folder of names in capitals": capitals_of,
    "a numbered pattern": lambda at: f"{folder_of(at)}/d_%03d.png",
    "a pattern of names": lambda at: f"{folder_of(at)}/d_*.png",
    "an array": lambda at: pictures(),
    "NPY": npy_of,
    "NPZ": npz_of,
    "HDF5": hdf5_of,
    "MATLAB": mat_of,
    "MATLAB 7.3": mat_73_of,
    "MATLAB in capitals": in_capitals(mat_of),
    "MATLAB 7.3 in capitals": in_capitals(mat_73_of),
    "NPZ in a folder": npz_beside_matlab_of,
}


@pytest.mark.parametrize("source", SOURCES)
def test_frame_k_sees_picture_k(tmp_path, source):
    scene = load_scene(SOURCES[source](tmp_path), *SHAPE)
    assert scene.pictures == 3
    for frame, wall_m in enumerate(WALLS_M):
        assert np.all(scene.at(frame).truth_m == wall_m)
        assert scene.at(frame).pictures == 1


@pytest.mark.parametrize(
    ("pattern", "walls_m"),
    [
        ("d_?.png", [3.0]),
        ("d_??.png", [4.0]),
        ("d_[0-9]0.png", [4.0]),
        ("d_1*.png", [4.0, 5.0]),
        ("d_%d.png", [3.0, 4.0, 5.0]),
        ("d_%012d.png", [3.0, 4.0, 5.0]),
        ("d_%d0.png", [4.0, 5.0]),
    ],
)
def test_a_pattern_stands_for_the_files_that_it_fits(tmp_path, pattern, walls_m):
    """In the order of their numbers; of the first one it is told what was assumed."""
    scene = load_scene(f"{folder_of(tmp_path)}/{pattern}", *SHAPE)
    seen_m = [scene.at(frame).truth_m[0, 0] for frame in range(scene.pictures)]
    assert seen_m == walls_m
    assert f"{pattern}: {len(walls_m)} pictures, one for each frame" in scene.notes[0]
    assert any("along the rays" in note for note in scene.notes[1:])


@pytest.mark.parametrize("name", ["d_%d.png", "d_1[0].png", "d_?.png", "d_*.png"])
def test_a_file_whose_name_looks_like_a_pattern_is_that_file(tmp_path, name):
    png(tmp_path / "d_10.png", np.full(SHAPE, 5.0))
    png(tmp_path / name, np.full(SHAPE, 3.0))
    scene = load_scene(tmp_path / name, *SHAPE)
    assert scene.pictures == 1
    assert np.all(scene.truth_m == 3)


def test_a_pattern_may_have_several_numbers(tmp_path):
    """The first one counts most; each is a number, not a text."""
    names = ("a2_b10.png", "a2_b9.png", "a10_b1.png")
    for name, wall_m in zip(names, (4.0, 3.0, 5.0), strict=True):
        png(tmp_path / name, np.full(SHAPE, wall_m))
    png(tmp_path / "a2_left.png", np.full(SHAPE, 6.0))
    scene = load_scene(f"{tmp_path}/a%d_b%d.png", *SHAPE)
    assert [scene.at(k).truth_m[0, 0] for k in range(scene.pictures)] == [3.0, 4.0, 5.0]


def test_a_pattern_may_have_the_signs_of_a_copy(tmp_path):
    """A file system permits them; only the number differs."""
    for name, wall_m in (("d+ (1).5.png", 3.0), ("d+ (1).6.png", 4.0), ("d+ (1)x7.png", 5.0)):
        png(tmp_path / name, np.full(SHAPE, wall_m))
    scene = load_scene(f"{tmp_path}/d+ (1).%d.png", *SHAPE)
    assert [scene.at(k).truth_m[0, 0] for k in range(scene.pictures)] == [3.0, 4.0]


@pytest.mark.parametrize("pattern", ["d_%d.png", "d_*.png", "d_?.png", "*.png", "*d_?.png", ""])
def test_copies_beside_a_sequence_are_no_pictures_of_it(tmp_path, pattern):
    """As editors, programs that save pictures, and macOS leave them."""
    for name, wall_m in (("d_1.png", 3.0), ("d_2.png", 4.0)):
        png(tmp_path / name, np.full(SHAPE, wall_m))
        for copy in (f"{name}.bak", f"{name}~", f".#{name}.tmp", f"._{name}"):
            (tmp_path / copy).write_bytes(b"no picture")
    scene = load_scene(f"{tmp_path}/{pattern}", *SHAPE)
    assert [scene.at(k).truth_m[0, 0] for k in range(scene.pictures)] == [3.0, 4.0]


@pytest.mark.parametrize("pattern", [".d_%d.png", ".d_*.png", ".*.png"])
def test_a_pattern_may_ask_for_hidden_files(tmp_path, pattern):
    for name, wall_m in ((".d_1.png", 3.0), (".d_2.png", 4.0), ("d_3.png", 5.0)):
        png(tmp_path / name, np.full(SHAPE, wall_m))
    scene = load_scene(f"{tmp_path}/{pattern}", *SHAPE)
    assert [scene.at(k).truth_m[0, 0] for k in range(scene.pictures)] == [3.0, 4.0]


def test_a_hidden_folder_has_pictures_as_any_other(tmp_path):
    (tmp_path / ".frames").mkdir()
    for name in ("d_1.png", "._d_1.png"):
        png(tmp_path / ".frames" / name, np.full(SHAPE, 3.0))
    assert load_scene(str(tmp_path / ".frames"), *SHAPE).pictures == 1


def test_the_last_frame_counts_from_the_end_of_the_frames_not_of_the_pictures():
    run = simulate(CONFIG, pictures(), frames=2)
    second = run.scene.at(1).truth_m
    assert not np.array_equal(second, run.scene.at(2).truth_m)
    assert np.array_equal(run.frame(-1).scene.truth_m, second)
    assert np.array_equal(run.alone(-1).scene.truth_m, second)
    for part in ("distance_m", "signal_per_pulse"):
        last, of_second = (getattr(run.light_of(frame), part) for frame in (-1, 1))
        assert np.array_equal(last, of_second, equal_nan=True)
    last, of_second = (run.result_of(frame) for frame in (-1, 1))
    assert all(np.array_equal(last[name], of_second[name]) for name in of_second)


@pytest.mark.parametrize("frame", [-1, 3])
def test_a_frame_before_the_first_picture_or_behind_the_last_has_none(frame):
    scene = load_scene(pictures(), *SHAPE)
    with pytest.raises(InputError, match=f"^frames: frame {frame} has no picture: array has 3"):
        scene.at(frame)


@pytest.mark.parametrize("frames", [2, 4, 5])
def test_a_few_columns_are_colours_only_beside_many_rows(frames):
    """A sequence may be narrower than it is long."""
    moving_m = np.full((frames, 9, 3), 4.0)
    if frames > 4:
        with pytest.raises(InputError, match="the last axis looks like colours"):
            load_scene(moving_m, 9, 3)
    else:
        assert load_scene(moving_m, 9, 3).pictures == frames


def test_one_line_tells_how_many_pictures_a_scene_has():
    scene = load_scene(pictures(), *SHAPE)
    assert repr(scene) == "<Scene array: 8 x 8 pixels, 3 to 3 m, picture 1 of 3>"
    assert repr(scene.at(2)) == "<Scene array[2]: 8 x 8 pixels, 5 to 5 m>"


def test_each_picture_has_the_mask_of_its_own():
    """Of a masked array of several pictures."""
    hidden = np.zeros((3, *SHAPE), bool)
    hidden[1, 0, 1] = hidden[2, 1, 0] = True
    scene = load_scene(np.ma.masked_array(pictures(), mask=hidden), *SHAPE)
    for frame in range(3):
        assert np.array_equal(scene.at(frame).valid, ~hidden[frame])


def test_the_sensor_measures_what_moves():
    """The photons of each frame come from its picture, and so does the truth."""
    run = simulate(CONFIG, pictures(), klux=0, seed=3)
    assert run.config.frames == 3
    for number, wall_m in enumerate(WALLS_M):
        frame = run.frame(number)
        assert np.all(frame.truth_m == wall_m)
        own = scene_light(run.setup.scene.at(number), 0)
        assert np.array_equal(frame.light.signal_per_pulse, own.signal_per_pulse)
        assert np.nanmedian(frame.depth_m) == pytest.approx(wall_m, abs=0.02)
    assert run.frame(-1)["wrong_share"] == run.alone(-1)["wrong_share"]


def test_a_scene_that_stands_still_needs_no_sequence():
    """The random numbers are those of the pulses, so equal pictures give the photons of one."""
    still = Run(Setup(config=CONFIG.with_frame(frames=2), scene=load_scene(pictures()[0], *SHAPE)))
    same = load_scene(np.stack([pictures()[0]] * 2), *SHAPE)
    moving = Run(Setup(config=CONFIG.with_frame(frames=2), scene=same))
    for name in ("pulse", "pixel", "tick"):
        assert np.array_equal(
            getattr(still.frame_edges(0), name), getattr(moving.frame_edges(0), name)
        )


def test_there_are_as_many_frames_as_pictures(tmp_path):
    setup = Setup.of(npy_of(tmp_path), sensor={"rows": 8, "cols": 8})
    assert setup.config.frames == 3


def test_the_number_of_frames_may_be_given():
    assert simulate(CONFIG, pictures(), frames=2).config.frames == 2
    with pytest.raises(InputError, match="array has 3, one for each frame; must be at most 3"):
        simulate(CONFIG, pictures(), frames=4)


def test_reflectivities_of_each_picture():
    shares = np.array([0.1, 0.9, 0.4])[:, None, None] * np.ones((3, *SHAPE))
    shares[:, :, 4:] /= 2
    scene = load_scene(pictures(), *SHAPE, reflectivity=shares)
    one = load_scene(pictures(), *SHAPE, reflectivity=shares[1])
    for frame in range(3):
        assert np.array_equal(scene.at(frame).reflectivity[:, :, 0], shares[frame])
        assert np.array_equal(one.at(frame).reflectivity[:, :, 0], shares[1])
    for number in (2, 4):
        others = np.resize(shares, (number, *SHAPE))
        with pytest.raises(InputError, match=f"reflectivity: has {number} pictures, must have 3"):
            load_scene(pictures(), *SHAPE, reflectivity=others)


def test_colours_of_each_picture(tmp_path):
    folder = folder_of(tmp_path)
    for number in range(3):
        Image.new("L", SHAPE, 255 * (number == 1)).save(tmp_path / f"c{number}.png")
    scene = load_scene(f"{folder},{tmp_path}/c%d.png", *SHAPE)
    assert [scene.at(frame).reflectivity.max() for frame in range(3)] == pytest.approx(
        [0.05, 0.8, 0.05]
    )
    (tmp_path / "colours").mkdir()
    for number in range(3):  # a camera's
        Image.new("RGB", SHAPE, "white").save(tmp_path / "colours" / f"{number}.jpg")
    white = load_scene(folder, *SHAPE, colour=tmp_path / "colours")
    assert [white.at(frame).reflectivity.min() for frame in range(3)] == pytest.approx([0.8] * 3)
    one = load_scene(f"{folder},{tmp_path / 'c1.png'}", *SHAPE)
    assert all(np.all(one.at(frame).reflectivity == 0.8) for frame in range(3))
    (tmp_path / "colours" / "3.jpg").write_bytes((tmp_path / "colours" / "2.jpg").read_bytes())
    with pytest.raises(InputError, match="has 4 pictures, must have one or as many as frames: 3"):
        load_scene(folder, *SHAPE, colour=tmp_path / "colours")
    (tmp_path / "c2.png").unlink()
    with pytest.raises(InputError, match="has 2 pictures, must have one or as many as frames: 3"):
        load_scene(f"{folder},{tmp_path}/c*.png", *SHAPE)


def test_messages_name_the_picture(tmp_path):
    folder = folder_of(tmp_path)
    png(f"{folder}/d_11.png", np.full((4, 8), 4.0))
    with pytest.raises(InputError, match="d_11.png: has 4 x 8 samples, must have 8 x 8 as"):
        load_scene(folder, *SHAPE)
    with pytest.raises(InputError, match=r"x_\*.png: has no pictures, must have files that the"):
        load_scene(f"{folder}/x_*.png", *SHAPE)
    (tmp_path / "arrays").mkdir()
    for frames, name in ((1, "d_1.npy"), (3, "d_2.npy")):
        np.save(tmp_path / "arrays" / name, pictures()[:frames])
    with pytest.raises(
        InputError, match=r"d_2.npy: holds 3 pictures, must hold one, .*\*.npy names"
    ):
        load_scene(f"{tmp_path}/arrays/d_*.npy", *SHAPE)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="empty: has no pictures, must have files that end with"):
        load_scene(str(tmp_path / "empty"), *SHAPE)
    hole = pictures()
    hole[1] = 0
    with pytest.raises(InputError, match=r"array\[1\]: every sample is 0"):
        load_scene(hole, *SHAPE)
    for colours in (2, 3, 4):
        with pytest.raises(InputError, match="the last axis looks like colours"):
            load_scene(np.ones((8, 8, colours)), *SHAPE)


def test_depth_comes_out_as_a_sequence(tmp_path):
    run = simulate(CONFIG, pictures(), klux=0)
    run.save_depths(tmp_path / "d.npz")
    written = np.load(tmp_path / "d.npz")
    assert written["depth_m"].shape == (3, *SHAPE, 1)
    assert np.array_equal(written["truth_m"], pictures())
    run.animate(tmp_path / "d.gif")
    with Image.open(tmp_path / "d.gif") as animation:
        assert animation.n_frames == 3
        assert animation.info["loop"] == 0  # for ever
        for frame in range(3):
            animation.seek(frame)
            assert animation.info["duration"] == 250  # milliseconds
    with pytest.raises(InputError, match=r"d.mp4: must end with .gif or .png"):
        run.animate(tmp_path / "d.mp4")


def test_what_is_written_of_all_frames_is_of_the_chosen_estimator(tmp_path, monkeypatch):
    """Depths and animation, frame by frame."""
    run = simulate(CONFIG, pictures(), klux=0)
    drawn = []
    monkeypatch.setattr(
        "coincid.study.animation.write_animation",
        lambda path, frames, heading: drawn.append(frames),
    )
    of_methods = {}
    for method in ("maximum", "planes"):
        run.save_depths(tmp_path / f"{method}.npz", method)
        run.animate(tmp_path / "d.gif", method)
        of_methods[method] = np.load(tmp_path / f"{method}.npz")["depth_m"]
        for number, frame in enumerate(drawn[-1]):
            expected_m = run.depth(frame=number, method=method).depth_m
            assert np.array_equal(of_methods[method][number], expected_m, equal_nan=True)
            assert np.array_equal(frame.first.depth_m, expected_m, equal_nan=True)
    assert not np.array_equal(*of_methods.values(), equal_nan=True)
