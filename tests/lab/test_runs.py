# SPDX-License-Identifier: Apache-2.0
"""Runs that follow from others, and stages that are given to a run."""

from functools import cache, partial

import numpy as np
import pytest

from coincid.lab import long_frames, outcomes
from coincid.lab.outcomes import Run, StageCache
from coincid.lab.setup import PhotonInputs, Setup
from coincid.model.contract.config import parse_config
from coincid.model.contract.edges import Edges
from coincid.model.depth.estimate import estimate_depth
from coincid.model.depth.quality import TOLERANCE_M
from coincid.model.golden.frame import Golden
from coincid.model.scenes.scene import Scene
from coincid.model.shared.errors import InputError
from coincid.model.shared.pulse import Pulse

from ..told import Told

SENSOR = {"rows": 8, "cols": 8}
FRAME = {"frames": 3, "pulses": 12, "period": 60, "format": "full"}


@cache
def run():
    return Run(Setup.of("flat:4", klux=20.0, sensor=SENSOR, frame=FRAME, estimators=("maximum",)))


def test_runs_that_follow_from_another_keep_its_workers_its_watch_and_its_cache():
    watch, shared = (lambda *of: None), StageCache()
    one = Run(run().setup, cache=shared, workers=3, watch=watch)
    changed = one.but(subgroup={"threshold": 3})
    alone = one.alone(1, subgroup={"threshold": 3})
    for other in (changed, alone):
        assert (other.workers, other.watch) == (3, watch)
        assert set(other.config.threshold.tolist()) == {3}
    assert changed.cache is shared
    assert (changed.config.frames, alone.config.frames) == (3, 1)
    assert Run(run().setup).workers == 1


def test_a_light_that_is_given_is_that_of_every_frame():
    """Also if the setup has another one, or edges alone."""
    light = Run(run().setup.but(klux=90.0)).light
    given = Run(run().setup, light=light)
    assert all(given.light_of(number) is light for number in (0, 1, 2, -1))
    assert given.light is light
    assert given.frame(1).light is light
    with pytest.raises(InputError, match="frame = 3: must be an integer from -3 to 2"):
        given.light_of(3)


@pytest.mark.parametrize("is_long", [False, True])
def test_edges_and_results_that_are_given_are_not_made_again(is_long, monkeypatch):
    """Also if so many edges would not be kept."""
    edges = run().edges
    if is_long:
        monkeypatch.setattr(long_frames, "EDGES_MAX", 0)
    expected = run().frame(1).counter("stored").tolist()
    given = Run(run().setup.but(seed=9), edges=edges)
    assert given.edges is edges
    for one in (given, Run(given.setup.but(edges=edges))):
        assert not one.is_long
        assert one.frame(1).counter("stored").tolist() == expected
    known = Run(run().setup.but(seed=9), result=run().result)
    assert known.has_result and not given.has_result
    assert known.result is run().result


@pytest.mark.parametrize("scene", [True, False])
def test_a_run_is_told_by_its_scene_or_as_edges(scene):
    config = parse_config({"sensor": {"rows": 16, "cols": 8}, "frame": {"pulses": 7}})
    nothing = Edges(*(np.zeros(0, np.int64) for _ in range(3)))
    wall = Scene(name="wall", distance_m=np.full((16, 8), 5.0), reflectivity=np.full((16, 8), 0.4))
    told = Run(Setup(config=config, scene=wall if scene else None, edges=nothing))
    name = "wall" if scene else "edges"
    assert repr(told) == f"<Run of {name}: 16 x 8 pixels, 1 frame of 7 pulses, engine golden>"
    several = told.but(frame={"frames": 2}, engine="sliced")
    assert repr(several).endswith(": 16 x 8 pixels, 2 frames of 7 pulses, engine sliced>")


@pytest.mark.parametrize("method", ["maximum", "maximum/minigroup", "maximum/subgroup"])
@pytest.mark.parametrize("frame", [0, 2])
def test_a_method_of_a_run_may_name_its_source(method, frame):
    """As an estimator of the setup, too."""
    name, _, source = method.partition("/")
    options = {"source": source} if source else {}
    expected = estimate_depth(run().result, run().config, method=name, frame=frame, **options)
    own = run().but(estimators=(method,))
    for found in (
        run().depth(method, frame=frame),
        run().depth(method=method, frame=frame),
        own.depth(frame=frame),
        own.frame(frame).depth(),
    ):
        assert np.array_equal(found.depth_m, expected.depth_m, equal_nan=True)


def test_a_depth_has_one_estimator():
    """Of two, one would be ignored."""
    for other in ("maximum", "planes", Told(5.0)):
        with pytest.raises(InputError, match="^method: is the estimator, which is given already$"):
            run().depth("maximum", method=other)
    found, expected = run().depth("maximum", method=None), run().depth("maximum")
    assert np.array_equal(found.depth_m, expected.depth_m, equal_nan=True)


def test_an_estimator_is_told_the_pulse_of_the_setup_unless_another_is_given():
    late = Pulse(time_s=[-1e-10, 0, 1e-10, 3e-9], density=[0, 1, 1, 0])
    wide = Pulse.gaussian(2e-9)
    measured = Run(run().setup.but(pulse=late), edges=run().edges)
    found = []
    for told, options in ((late, {}), (wide, {"pulse": wide}), (None, {"pulse": None})):
        depth = measured.depth("matched", frame=0, **options)
        expected = estimate_depth(
            measured.result, measured.config, method="matched", frame=0, pulse=told
        )
        assert np.array_equal(depth.depth_m, expected.depth_m, equal_nan=True)
        found.append(depth.depth_m)
    assert not np.array_equal(found[0], found[1], equal_nan=True)


def test_an_engine_plays_the_edges_of_a_setup_in_its_view(monkeypatch):
    asked = []

    def replay(*given, **named):
        asked.append((*given, named))
        return {"pulse": np.arange(3)}

    monkeypatch.setattr(outcomes, "replay", replay)
    one = Run(run().setup.but(engine="icarus", view="async"))
    assert one.result["pulse"].tolist() == [0, 1, 2]
    assert asked == [("icarus", one.config, one.edges, {"view": "async"})]


def test_wrong_pixels_of_a_frame_are_those_of_the_papers_criterion():
    scene = Scene(name="wall", distance_m=np.full((8, 8), 5.0), reflectivity=np.full((8, 8), 0.4))
    setup = Setup.of(scene, sensor=SENSOR, frame={"pulses": 5})
    for off_m, wrong in ((0.99 * TOLERANCE_M, False), (1.01 * TOLERANCE_M, True)):
        for told in (Told(5.0 + off_m), Told(5.0 - off_m)):
            frame = Run(setup.but(estimators=(told,))).frame()
            assert frame.wrong.shape == (8, 8)
            assert (frame.wrong == wrong).all()
            assert frame["wrong_share"] == float(wrong)


def test_every_stage_of_a_run_has_its_workers(monkeypatch):
    """A stage that forgets them gives the same, later."""
    told = {}

    def noting(name, function, place):
        def noted(*given, **options):
            told[name] = options["workers"] if "workers" in options else given[place]
            return function(*given, **options)

        return noted

    for owner, name, place in (
        (PhotonInputs, "edges", 1),
        (PhotonInputs, "chunks", 1),
        (Golden, "frames_of", 3),
        (outcomes, "estimate_depth", None),
    ):
        monkeypatch.setattr(owner, name, noting(name, getattr(owner, name), place))
    usual = Run(run().setup, workers=3)
    _ = usual.frame().depth_m
    assert told == {"edges": 3, "chunks": 3, "frames_of": 3, "estimate_depth": 3}
    told.clear()
    monkeypatch.setattr(long_frames, "EDGES_MAX", 0)
    _ = Run(run().setup, workers=2).frame().depth_m
    assert told == {"chunks": 2, "estimate_depth": 2}


@pytest.mark.parametrize("value", [0, 1, False, 2.5, b"planes", ["planes"]], ids=repr)
def test_what_is_no_estimator_is_refused_before_anything_is_computed(value):
    """Most of all the number of a frame, which has a name of its own."""
    whole = Run(run().setup)
    told = f"estimator = {value!r}: must be METHOD or METHOD/SOURCE; a frame is given as frame={value!r}"
    for ask in (whole.depth, partial(whole.frame, 0), lambda value: whole.depth(method=value)):
        with pytest.raises(InputError) as refused:
            ask(value)
        assert str(refused.value) == told
    assert whole._edges is None
