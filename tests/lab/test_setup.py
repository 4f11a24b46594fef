# SPDX-License-Identifier: Apache-2.0
"""Setups: what they refuse, what counts in their keys, and what follows from their scene."""

import ast
from functools import cache, partial
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from attrs import frozen

from coincid.lab import setup as lab_setup
from coincid.lab.options import OPTIONS, documented
from coincid.lab.setup import PhotonInputs, Setup, fingerprint, fixed_thresholds, scene_of
from coincid.model.contract.config import parse_config
from coincid.model.contract.parameters import Sensor
from coincid.model.contract.settings import THRESHOLD_MAX
from coincid.model.light.spad import Spad
from coincid.model.scenes.catalogue import load_scene
from coincid.model.shared.errors import SEED_MAX, InputError
from coincid.model.shared.pulse import Pulse

ROOT = Path(__file__).parents[2]
SMALL = {"sensor": {"rows": 8, "cols": 8}, "frame": {"pulses": 4, "period": 60}}
small = partial(Setup.of, "flat:5,0.4", **SMALL)


def test_a_scene_reaches_as_far_as_its_own_laser_period():
    """A wall at 110 m is beyond the usual period of 75 m."""
    config = parse_config({"frame": {"period": 400}})
    assert np.all(scene_of(config, "flat:110").truth_m == 110.0)
    with pytest.raises(InputError, match=r"to 119\.9169"):
        scene_of(config, "flat:120")


def test_a_setup_of_distances_sees_them():
    distance_m = np.linspace(2.0, 9.0, 64).reshape(8, 8)
    seen = Setup.of(distance_m, **SMALL).scene
    assert np.array_equal(seen.truth_m, distance_m)


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("spad", 3, "spad = 3: must be Spad"),
        ("spad", {"dead_time_s": 1e-9}, "spad = {'dead_time_s': 1e-09}: must be Spad"),
        ("estimators", 5, "estimators = 5: must be tuple or list"),
        ("spad_gate", 1, "spad_gate = 1: must be true or false"),
        ("engine", "gold", "engine = 'gold': must be one of golden, sliced, verilator, icarus"),
        ("background", "dark", "background = 'dark': must be one of reflected, even"),
        ("seed", -1, f"seed = -1: must be an integer from 0 to {SEED_MAX}"),
        ("seed", SEED_MAX + 1, f"seed = {SEED_MAX + 1}: must be an integer from 0 to {SEED_MAX}"),
        ("pulse", 3, "pulse = 3: must be a Pulse"),
        ("estimators", "planes", "estimators = 'planes': must be several, such as ('planes',)"),
        ("light", 3.0, "light = 3.0: must be Light or None"),
        ("edges", {}, "edges = {}: must be Edges or None"),
    ],
)
def test_a_setup_refuses_at_once_what_it_cannot_play(field, value, told):
    """Not when somebody asks for its photons."""
    for make in (small, small().but):
        with pytest.raises(InputError) as raised:
            make(**{field: value})
        assert str(raised.value).startswith(told)
        assert raised.value.field == field


@pytest.mark.parametrize("field", ["config", "scene"])
@pytest.mark.parametrize("value", [3, "flat:5"])
def test_a_changed_setup_has_a_configuration_and_a_scene(field, value):
    """The name of a scene is read by `Setup.of` alone."""
    told = {"config": "Config", "scene": "Scene or None"}[field]
    with pytest.raises(InputError, match=f"^{field} = {value!r}: must be {told}$"):
        small().but(**{field: value})


@pytest.mark.parametrize("seed", [OPTIONS["seed"].low, OPTIONS["seed"].default, SEED_MAX])
def test_every_seed_of_the_options_is_legal(seed):
    assert OPTIONS["seed"].low == 0
    assert OPTIONS["seed"].high == SEED_MAX
    assert small(seed=seed).photons.seed == seed


@frozen
class Own:
    """A part of a user's own that has a field."""

    depth_m: float = 1.0
    name: str = "own"
    version: str = "1"


@frozen
class Another(Own):
    """The same under the name of another class."""


DIFFERENT = (
    1, 2, 1.0, True, "1", None, "None", 0, False, "",
    [], (), {}, [1], (1,), [[1]], [1, [2]], [[1, 2]], [[1], 2], [[1], [2]], [1, 2], [2, 1],
    {"a": 1}, {"a": 2}, {"b": 1}, {"a": 1, "b": 2}, {"a": [1, "b"]}, ["a", 1], {1: "a"},
    np.array([1]), np.array([1.0]), np.array([1], np.uint8), np.array([[1]]), np.array(1),
    Own(), Own(depth_m=2.0), Own(version="2"), Own(name="mine"), Another(),
    Spad(), Spad(dead_time_s=9e-9), Pulse.gaussian(1e-10), Pulse.gaussian(2e-10),
)  # fmt: skip


def test_different_contents_have_different_fingerprints():
    """Also of nested containers with the same leaves."""
    found = [fingerprint(value) for value in DIFFERENT]
    for one, other in combinations(range(len(DIFFERENT)), 2):
        assert found[one] != found[other], (DIFFERENT[one], DIFFERENT[other])
    assert fingerprint(1, 2) != fingerprint(2, 1) != fingerprint([2, 1])


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"a": 1, "b": 2}, {"b": 2, "a": 1}),
        (np.int64(3), 3),
        (np.float64(0.5), 0.5),
        (np.bool_(True), True),
        (np.arange(6).reshape(2, 3).T, np.arange(6).reshape(2, 3).T.copy()),
        (np.arange(6)[::2], np.array([0, 2, 4])),
        (Own(), Own()),
        (Pulse.gaussian(1e-10), Pulse.gaussian(1e-10)),
    ],
)
def test_equal_contents_have_equal_fingerprints(one, other):
    """In any order of a dictionary, and however an array lies in memory."""
    assert fingerprint(one) == fingerprint(other)
    assert fingerprint([one]) == fingerprint([other])


def rooms_of(path):
    """Return the rooms that a file imports, `model` as a whole."""
    found = set()
    depth = len(path.relative_to(ROOT).parts)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level == depth and node.module:
            found.add(node.module.partition(".")[0])
    return found


@cache
def with_all_that_they_import(room):
    """Return a room, the rooms that it imports, and those that these import."""
    found = set()
    left = {room}
    while left:
        one = left.pop()
        found.add(one)
        for path in (ROOT / one).rglob("*.py"):
            left |= rooms_of(path) - found
    return found


@pytest.mark.parametrize("engine", ["golden", "sliced", "verilator", "icarus"])
def test_the_code_of_an_outcome_is_that_of_all_rooms_that_compute_it(engine, monkeypatch):
    """Else a kept outcome would be taken for that of other code."""
    asked = []
    monkeypatch.setattr(lab_setup, "sources_digest", lambda *rooms: asked.extend(rooms) or "code")
    known = lab_setup.versions.__wrapped__(engine)
    assert known["code"] == "code"
    assert {"coincid", "numba", "numpy", "scipy"} < known.keys()
    of_rtl = with_all_that_they_import("tb") - {"model", "lab"}
    assert {"hdl", "slices"} <= of_rtl
    assert set(asked) == {"model", "lab"} | (of_rtl if engine != "golden" else set())


def test_fixed_thresholds_are_those_of_the_controller():
    assert list(fixed_thresholds(Sensor())) == list(range(1, THRESHOLD_MAX + 1))
    assert THRESHOLD_MAX == 7


def test_a_scene_that_moves_has_a_frame_for_each_picture_unless_a_number_is_written():
    scene = load_scene(np.stack([np.full((8, 8), far_m) for far_m in (3.0, 4.0, 5.0)]), 8, 8)
    frame = {"pulses": 4, "period": 60}
    assert Setup.of(scene, sensor=SMALL["sensor"], frame=frame).config.frames == 3
    for frames in (1, 5):
        given = Setup.of(scene, sensor=SMALL["sensor"], frame=frame | {"frames": frames})
        assert given.config.frames == frames
    assert small().config.frames == 1


def test_each_picture_of_a_scene_that_moves_has_the_pulses_of_its_frame():
    """And photons of its own: no frame begins with those of another."""
    scene = load_scene(np.full((3, 8, 8), 4.0), 8, 8)
    photons = Setup.of(scene, klux=20.0, sensor=SMALL["sensor"], frame=SMALL["frame"]).photons
    starts = [part["pulse_start"] for part in photons._parts()]
    assert starts == [0, 4, 8]
    edges = photons.edges()
    frames = [edges.frame(number, 4)[0] for number in range(3)]
    assert all(len(of_frame) for of_frame in frames)
    assert not np.array_equal(frames[0].tick, frames[1].tick)


def test_photons_tell_how_many_there_are_until_all_are_made():
    told = []
    photons = small(klux=50.0).photons
    edges = photons.edges(watch=lambda *of: told.append(of))
    assert edges.pulse[-1] == 3
    assert told[-1] == ("photons", 1.0, len(edges))


def test_the_told_share_of_photons_never_falls(monkeypatch):
    """Also if a part of the pulses is dark."""
    photons = small(klux=50.0).photons
    edges, told = photons.edges(), []
    assert photons.pulses == 4
    parts = [edges.take(edges.pulse == pulse) for pulse in (0, 1)]
    monkeypatch.setattr(PhotonInputs, "chunks", lambda *of: iter([*parts, edges.take(slice(0))]))
    photons.edges(watch=lambda *of: told.append(of))
    first, both = len(parts[0]), len(parts[0]) + len(parts[1])
    assert told == [("photons", 0.25, first), ("photons", 0.5, both), ("photons", 0.5, both)]


def test_a_scene_is_taken_as_it_is_or_made_for_the_pixels_of_a_configuration():
    config = parse_config({"sensor": {"rows": 8, "cols": 24}})
    scene = scene_of(config, "flat:5,0.4")
    assert scene.truth_m.shape == (8, 24)
    assert scene_of(config, scene) is scene


def test_a_docstring_has_the_options_of_its_own_function():
    @documented
    def function(scene, seed, other):
        """Do something.

        {options}
        """

    assert function.__doc__ == "\n".join(
        [
            "Do something.",
            "",
            f"scene : {OPTIONS['scene'].kind}",
            f"    {OPTIONS['scene'].doc}",
            "seed : int",
            "    Seed of the photons.",
        ]
    )
