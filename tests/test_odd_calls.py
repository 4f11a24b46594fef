# SPDX-License-Identifier: Apache-2.0
"""Calls of the library with arrays that have a mask and with names that are no files, and the
command in odd surroundings: a right result, or a sentence.
"""

import inspect
import os
import stat
import subprocess
import sys

import numpy as np
import pytest

import coincid
from coincid.model.contract.config import changes_of_text
from coincid.model.contract.edges import checked_edges
from coincid.model.light.light import Arrivals, Interferer
from coincid.model.light.link_budget import link_budget
from coincid.model.light.photons import edges_at_most
from coincid.model.recorded.exchange import read_recording, write_edges
from coincid.model.scenes.ambient import ambient_klux
from coincid.model.shared.errors import InputError
from coincid.model.shared.files import whole_file
from coincid.model.shared.pulse import Pulse

from .command import assert_refused, command

SHAPE = (8, 8)
SMALL = {"rows": 8, "cols": 8, "subgroup": (4, 4), "pulses": 5, "method": "maximum"}
DISTANCE_M = np.full(SHAPE, 5.0)
SHARE = np.full(SHAPE, 0.4)
HIDDEN = np.zeros(SHAPE, bool)
HIDDEN[0, 1] = True


def hiding(array):
    return np.ma.array(array, mask=HIDDEN)


def light(**changes):
    given = {"distance_m": 5.0, "signal_per_pulse": 1.0} | changes
    return coincid.Light(rows=8, cols=8, **given)


@pytest.mark.parametrize("distance_m", [DISTANCE_M, DISTANCE_M.astype(np.int64)])
def test_a_hidden_distance_is_no_target(distance_m):
    scene = coincid.Scene(name="wall", distance_m=hiding(distance_m), reflectivity=SHARE)
    assert np.array_equal(np.isnan(scene.truth_m), HIDDEN)
    made = light(distance_m=hiding(distance_m).ravel())
    assert np.array_equal(np.isnan(made.distance_m[:, 0]), HIDDEN.ravel())
    made = coincid.Light.from_scene(hiding(distance_m), SHARE, 5.0)
    assert np.array_equal(np.isnan(made.distance_m[:, 0]), HIDDEN.ravel())


NUMBERS = {  # of every pixel: nothing can stand for one that is hidden
    "klux": lambda: coincid.simulate(None, "flat:5", klux=hiding(SHARE), **SMALL),
    "reflectivity": lambda: coincid.load_scene(DISTANCE_M, *SHAPE, reflectivity=hiding(SHARE)),
    "sunlit": lambda: coincid.Scene(
        name="wall", distance_m=DISTANCE_M, reflectivity=SHARE, sunlit=hiding(SHARE)
    ),
    "signal_per_pulse": lambda: light(signal_per_pulse=hiding(SHARE).ravel()),
    "background_cps": lambda: light(background_cps=hiding(SHARE).ravel()),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_a_hidden_number_that_is_needed_is_refused(name):
    with pytest.raises(InputError, match=rf"{name}\[.*1.*\] = nan: must be "):
        NUMBERS[name]()


@pytest.mark.parametrize("pictures", [1, 2])
def test_a_reflectivity_may_be_hidden_where_the_distance_is(pictures):
    def several(array):
        return array if pictures == 1 else np.ma.stack([array] * pictures)

    plain = coincid.load_scene(several(hiding(DISTANCE_M)), *SHAPE, reflectivity=0.4)
    both = coincid.load_scene(
        several(hiding(DISTANCE_M)), *SHAPE, reflectivity=several(hiding(SHARE))
    )
    assert np.array_equal(plain.truth_m, both.truth_m, equal_nan=True)
    assert np.array_equal(plain.reflectivity[~HIDDEN], both.reflectivity[~HIDDEN])


@pytest.mark.parametrize("name", ["pulse", "pixel", "tick"])
def test_columns_of_edges_with_hidden_elements_are_refused(name):
    columns = {one: np.array([0, 1]) for one in ("pulse", "pixel", "tick")}
    columns[name] = np.ma.array(columns[name], mask=[False, True])
    with pytest.raises(InputError, match=f"{name}: has masked elements"):
        checked_edges(columns, pixels=2, pulses=2, period_ticks=2)


@pytest.fixture(scope="module")
def run():
    return coincid.simulate(None, "flat:5", **SMALL)


def scene(**changes):
    return coincid.Scene(**{"name": "own", "distance_m": DISTANCE_M, "reflectivity": 0.4} | changes)


def arrivals(**changes):
    return Arrivals(**{"first": [0, 1], "start_s": [0.0], "photons": [1.0]} | changes)


def lit(spad=None, **changes):
    return edges_at_most(light(**changes), spad or coincid.Spad(), coincid.Timing())


OF_ARRAYS = {  # what takes an array, or a list in its place, by the name of which it is told
    "distance_m": [
        lambda array: scene(distance_m=array),
        lambda array: light(distance_m=array),
        lambda array: coincid.Light.from_scene(array, 0.4, 5.0),
        lambda array: link_budget(array, 0.4, 5.0),
    ],
    "reflectivity": [
        lambda array: scene(reflectivity=array),
        lambda array: coincid.load_scene(DISTANCE_M, *SHAPE, reflectivity=array),
        lambda array: coincid.Light.from_scene(DISTANCE_M, array, 5.0),
    ],
    "klux": [
        lambda array: coincid.Light.from_scene(DISTANCE_M, 0.4, array),
        lambda array: ambient_klux(array, *SHAPE),
        lambda array: coincid.scene_light(scene(), array),
    ],
    "sunlit": [lambda array: scene(sunlit=array)],
    "labels": [lambda array: scene(labels=array)],
    "missing": [lambda array: coincid.load_scene(DISTANCE_M, *SHAPE, missing=array)],
    "signal_per_pulse": [lambda array: light(signal_per_pulse=array)],
    "system_fwhm_s": [lambda array: light(system_fwhm_s=array)],
    "background_cps": [
        lambda array: light(background_cps=array),
        lambda array: arrivals(background_cps=array),
    ],
    "first": [lambda array: arrivals(first=array)],
    "start_s": [lambda array: arrivals(start_s=array)],
    "photons": [lambda array: arrivals(photons=array)],
    "photons_per_pulse": [lambda array: lit(interferer=Interferer(photons_per_pulse=array))],
    "dark_cps": [
        lambda array: lit(coincid.Spad(dark_cps=array)),
        lambda array: link_budget(4.0, 0.4, 5.0, spad=coincid.Spad(dark_cps=array)),
    ],
    "tap_width_lsb": [lambda array: coincid.Timing(tap_width_lsb=array)],
    "pulse.time_s": [lambda array: Pulse(time_s=array, density=[0.0, 1.0])],
    "pulse.density": [lambda array: Pulse(time_s=[-1e-9, 1e-9], density=array)],
    "subgroup.threshold": [lambda array: coincid.parse_config({}).with_settings(threshold=array)],
    "subgroup.mask": [lambda array: coincid.parse_config({}).with_settings(mask=array)],
    "frame.auto_bounds": [lambda array: coincid.parse_config({}).with_frame(auto_bounds=array)],
}


@pytest.mark.parametrize("name", OF_ARRAYS)
def test_lists_of_different_lengths_are_no_array(name):
    """Nor are numbers beside lists."""
    for make in OF_ARRAYS[name]:
        for wrong in ([[0.1, 0.2], [0.3]], [[0.1], 0.2]):
            with pytest.raises(InputError, match=rf"^{name}(:| = |\[)"):
                make(wrong)


def test_a_sequence_without_pictures_is_refused():
    with pytest.raises(InputError, match="^array: has no pictures, must have at least one$"):
        coincid.load_scene(np.ones((0, *SHAPE)), *SHAPE)


NO_PATHS = (None, b"a.npz", 5, 1.5, ["a.npz"], np.array("a.npz"), object())
WITH_PATH = {
    "load_edges": lambda run, path: coincid.load_edges(path, pixels=1, pulses=1, period_ticks=1),
    "read_result": lambda run, path: coincid.read_result(path),
    "write_result": lambda run, path: coincid.write_result(path, run.result),
    "write_ply": lambda run, path: coincid.write_ply(path, run.point_cloud()),
    "Run.save": lambda run, path: run.save(path),
    "Run.save_depth": lambda run, path: run.save_depth(path),
    "Run.save_depths": lambda run, path: run.save_depths(path),
    "Run.animate": lambda run, path: run.animate(path),
    "Run.to_ply": lambda run, path: run.to_ply(path),
    "Edges.save": lambda run, path: run.edges.save(path),
    "Depth.save": lambda run, path: run.depth().save(path),
    "read_recording": lambda run, path: read_recording(path),
    "write_edges": lambda run, path: write_edges(path, run.edges, coincid.Timing()),
    "Pulse.load": lambda run, path: Pulse.load(path),
}


@pytest.mark.parametrize("name", WITH_PATH)
def test_what_is_no_name_of_a_file_is_refused(name, run):
    for path in NO_PATHS:
        with pytest.raises(InputError, match=r"path = .*: must be the name of a file"):
            WITH_PATH[name](run, path)


def test_every_path_of_the_library_is_among_them():
    """That of `load_config` may also be the name of a preset, and has a sentence of its own."""
    found = set()
    for name in coincid.__all__:
        one = getattr(coincid, name)
        functions = {name: one}
        if inspect.isclass(one):
            members = inspect.getmembers(
                one, lambda it: inspect.isfunction(it) or inspect.ismethod(it)
            )
            functions = {f"{name}.{member}": it for member, it in members if member[0] != "_"}
        for told, function in functions.items():
            if inspect.isroutine(function) and "path" in inspect.signature(function).parameters:
                found.add(told)
    assert {"load_config", "read_result", "Run.save"} <= found
    assert found - {"load_config"} <= set(WITH_PATH)


def test_a_pipe_in_place_of_a_file_stays(tmp_path, run):
    path = tmp_path / "pipe.npz"
    os.mkfifo(path)
    with pytest.raises(InputError, match=r"pipe.npz: cannot be written: is a device or a pipe"):
        run.save(path)
    words = "photons --scene flat:5 --set rows=8 --set cols=8 --set pulses=5 --out"
    assert_refused(command(words, path), "pipe.npz", "is a device or a pipe, must be a file")
    assert stat.S_ISFIFO(path.stat().st_mode)
    assert [one.name for one in tmp_path.iterdir()] == ["pipe.npz"]


@pytest.mark.parametrize("letter", ["a", "é"])
def test_a_file_may_have_the_longest_name(tmp_path, letter):
    longest = os.pathconf(tmp_path, "PC_NAME_MAX")
    name = letter * (longest // len(letter.encode()))
    with whole_file(tmp_path / name, "w") as file:
        file.write("whole")
    assert [one.name for one in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("more", ["rows = 9", "[frame]\nrows = 9"])
def test_a_value_of_several_keys_is_refused(more):
    text = f"threshold=3\n{more}"
    assert changes_of_text(["threshold=3\n"]) == {"threshold": 3}
    assert changes_of_text([text]) == {"threshold": text.partition("=")[2]}
    assert_refused(command("show --set", text), "subgroup.threshold = ", "must be an integer")


@pytest.mark.parametrize("told", ["", "yesterday", "-1", "1.5", "²"])
def test_a_time_of_the_build_that_is_no_number_changes_nothing(tmp_path, told):
    """Libraries read it while they are imported."""
    words = "photons --scene flat:5 --set rows=8 --set cols=8 --set pulses=5 --out edges.npz"
    done = subprocess.run(
        [sys.executable, "-m", "coincid", *words.split()],
        cwd=tmp_path,
        env=os.environ | {"SOURCE_DATE_EPOCH": told},
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")
