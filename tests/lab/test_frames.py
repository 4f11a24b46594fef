# SPDX-License-Identifier: Apache-2.0
"""Runs of more than two frames, on more than one stream."""

import numpy as np
import pytest

from coincid.lab.measures import MEASURES
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.edges import Edges
from coincid.model.scenes.catalogue import load_scene
from coincid.model.shared.errors import InputError

FRAMES = 3
SENSOR = {"rows": 8, "cols": 24, "streams": 2, "fifo_depth": 2}
FRAME = {"frames": FRAMES, "pulses": 12, "period": 60, "minigroup_records": True}


@pytest.fixture(scope="module")
def run():
    setup = Setup.of("letter-f", klux=30.0, sensor=SENSOR, frame=FRAME, estimators=("background",))
    return Run(setup.but(subgroup={"threshold": 1}))


@pytest.mark.parametrize("number", range(FRAMES))
def test_every_measure_of_a_frame_is_that_of_the_frame_alone(run, number):
    among = run.frame(number)
    one = run.setup.but(frame={"frames": 1}, edges=run.frame_edges(number))
    alone = Run(one).frame()
    assert among["edges"] > 100
    assert among["beats"] > 20
    for name in MEASURES:
        assert among[name] == alone[name], name


@pytest.mark.parametrize("number", [0, 1, -1])
def test_a_frame_alone_has_the_picture_and_the_light_of_its_own(number):
    """In a scene that moves: truth and light of a later frame are not those of the first."""
    pictures = np.full((FRAMES, 8, 8), 3.0) + np.arange(FRAMES)[:, None, None]
    scene = load_scene(pictures, 8, 8)
    frame = {"frames": FRAMES, "pulses": 4, "period": 60}
    run = Run(Setup.of(scene, sensor={"rows": 8, "cols": 8}, frame=frame))
    assert np.all(run.alone(number).scene.truth_m == pictures[number])
    own = run.light_of(number % FRAMES).signal_per_pulse
    assert np.array_equal(own, run.alone(number).light_of(0).signal_per_pulse)


def test_frames_have_all_edges_and_events_once(run):
    edges = [run.frame(number)["edges"] for number in range(FRAMES)]
    events = [run.frame(number)["events"] for number in range(FRAMES)]
    assert sum(edges) == len(run.edges)
    assert sum(events) == len(run.result["pulse"])
    rows = np.concatenate([run.frame(number).events for number in range(FRAMES)])
    assert np.array_equal(np.sort(rows), np.arange(len(run.result["pulse"])))
    for number in range(FRAMES):
        own = run.frame(number).edges
        assert run.seen_edges(number).pulses == FRAME["pulses"]
        assert own.pulse.min() >= 0
        assert own.pulse.max() < FRAME["pulses"]


@pytest.mark.parametrize(("workers", "begun"), [(1, [0, 1, 2]), (2, [0, 2])])
def test_a_run_tells_which_part_of_its_frames_is_played(workers, begun):
    """When it begins those that are played side by side; and how many edges there are."""
    told = []
    frame = {"frames": FRAMES, "pulses": 4, "period": 60}
    sensor = {"rows": 8, "cols": 8}
    setup = Setup.of("flat:4", klux=20.0, sensor=sensor, frame=frame, estimators=("background",))
    run = Run(setup, workers=workers, watch=lambda *of: told.append(of))
    _ = run.result
    edges = len(run.edges)
    assert edges > 0
    played = [of[1:] for of in told if of[0] == "golden model"]
    assert played == [(number / FRAMES, edges) for number in begun]
    made = [of[1:] for of in told if of[0] == "photons"]
    assert len(played) + len(made) == len(told) and made == sorted(made)
    assert all(0 <= share <= 1 and number <= edges for share, number in made)


@pytest.mark.parametrize("wrong", [{"pulse": 40}, {"pixel": 64}, {"tick": 10_000}])
def test_edges_of_ones_own_are_checked(wrong):
    """Also the last ones, which a frame of its own would not have."""
    edge = {"pulse": 39, "pixel": 63, "tick": 100}
    setup = Setup.of(
        sensor={"rows": 8, "cols": 8},
        frame={"pulses": 20, "frames": 2},
        edges=one_edge(**edge),
    )
    assert Run(setup).frame(1)["edges"] == 1
    (name,) = wrong
    with pytest.raises(InputError, match=f"{name}.* must be an integer from 0 to"):
        _ = Run(setup.but(edges=one_edge(**edge | wrong))).result


def one_edge(**numbers):
    return Edges(**{name: np.array([value], np.int64) for name, value in numbers.items()})


def test_edges_in_any_order_are_in_their_own_frame():
    """Of four frames, each edge once; those of one frame keep their order."""
    pulse = np.random.default_rng(1).permutation(np.arange(20).repeat(3))
    edges = Edges(pulse=pulse, pixel=np.arange(60), tick=np.arange(60) * 3)
    frame = {"frames": 4, "pulses": 5, "period": 60}
    run = Run(Setup.of(sensor={"rows": 8, "cols": 8}, frame=frame, edges=edges))
    for number in range(4):
        own = run.frame_edges(number)
        expected = pulse // 5 == number
        assert own.pulse.tolist() == (pulse[expected] - 5 * number).tolist()
        assert own.pixel.tolist() == np.arange(60)[expected].tolist()
        assert own.tick.tolist() == (3 * np.arange(60)[expected]).tolist()
        again = run.frame_edges(number - 4)
        assert np.array_equal(again.pixel, own.pixel)
