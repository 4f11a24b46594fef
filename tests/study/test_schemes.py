# SPDX-License-Identifier: Apache-2.0
"""What `coincid sim` adds to a configuration, and the runs of its schemes."""

from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.config import parse_config
from coincid.model.scenes.catalogue import load_scene
from coincid.study.progress import Bar
from coincid.study.schemes import (
    PROGRESS_PARTS,
    best_threshold,
    long_scheme_runs,
    scheme_runs,
    seeing_all,
)
from coincid.study.schemes import _take_best as take_best
from coincid.study.simulate import LINK_FORMAT, LINK_GBPS, with_link


@pytest.mark.parametrize(
    ("of_the_configuration", "asked", "taken"),
    [
        (None, None, LINK_GBPS),
        (None, 0.0, 0.0),  # no limit
        (None, 3.0, 3.0),
        (0.0, None, 0.0),
        (5.0, None, 5.0),
        (5.0, 0.0, 0.0),
        (5.0, 3.0, 3.0),
    ],
)
def test_the_link_is_the_one_that_was_asked_for(of_the_configuration, asked, taken):
    frame = {} if of_the_configuration is None else {"link_gbps": of_the_configuration}
    config = with_link(parse_config({"frame": frame}), asked)
    assert (config.frame.link_gbps, config.format) == (taken, LINK_FORMAT)
    chosen = parse_config({"frame": frame | {"format": "full"}})
    assert with_link(chosen, asked).format == "full"


def moving_run(controller):
    """Return a run of a wall that comes nearer, with a hole in its last picture only."""
    walls_m = np.stack([np.full((4, 8), wall_m) for wall_m in (9.0, 6.0, 3.0)])
    walls_m[-1, 0, 0] = np.nan
    sensor = {
        "rows": 4,
        "cols": 8,
        "subgroup": [4, 4],
        "phases": 8,
        "window_max": 32,
        "controller": controller,
    }
    frame = {"frames": 3, "pulses": 12, "period": 80}
    setup = Setup.of("flat:5", sensor=sensor, frame=frame, klux=20.0)
    return Run(setup.but(scene=load_scene(walls_m, 4, 8)))


@pytest.mark.parametrize(
    ("sensor", "form", "still", "moving"),
    [
        ({"controller": 1}, "id", ["auto"], ["auto"]),
        ({"controller": 0}, "id", [], ["fixed"]),
        ({"controller": 1, "counts": 1}, "counts", [], ["counts"]),
        ({"controller": 0, "counts": 1}, "counts", [], ["counts"]),
    ],
)
def test_all_frames_are_for_the_controller_and_for_what_moves(sensor, form, still, moving):
    """Another scheme of a still scene has one frame, because its frames are alike."""
    config = parse_config({"sensor": {"rows": 8, "cols": 8} | sensor, "frame": {"format": form}})
    walls_m = np.full((2, 8, 8), 5.0)
    assert seeing_all(config, load_scene(walls_m[0], 8, 8)) == still
    assert seeing_all(config, load_scene(walls_m, 8, 8)) == moving


class Recording(Bar):
    """amounts: the finished amounts that its last stage showed."""

    def stage(self, name, total=None):
        super().stage(name, total)
        self.amounts = []

    def done(self, amount, total=None):
        super().done(amount, total)
        self.amounts.append(amount)


@pytest.mark.parametrize("threshold", [None, 2])
@pytest.mark.parametrize("controller", [0, 1])
def test_schemes_of_a_long_run_see_the_pictures_of_their_frames(controller, threshold):
    """As those of a run that keeps its edges: the last picture, or all of them."""
    run = moving_run(controller)
    given = None if threshold is None else np.full_like(run.config.threshold, threshold)
    fixed = np.full_like(run.config.threshold, best_threshold(run)) if given is None else given
    usual = scheme_runs(run, fixed)
    with Recording(Console(quiet=True)) as bar:
        long, found = long_scheme_runs(run, given, bar)
    assert found.tolist() == fixed.tolist()
    assert bar.amounts == sorted(bar.amounts)
    assert 0 < bar.amounts[0] < PROGRESS_PARTS == bar.amounts[-1]
    assert list(long) == list(usual)
    for name, one in long.items():
        other = usual[name]
        assert one.config.frames == other.config.frames, name
        for number in range(one.config.frames):
            frame, expected = one.frame(number), other.frame(number)
            np.testing.assert_array_equal(frame.truth_m, expected.truth_m, err_msg=name)
            np.testing.assert_array_equal(frame.depth_m, expected.depth_m, err_msg=name)
            np.testing.assert_array_equal(frame.threshold, expected.threshold, err_msg=name)
            assert frame["edges"] == expected["edges"]


@pytest.mark.parametrize(
    ("shares", "best"),
    [
        ([0.5, 0.2, 0.2, 0.4, 0.2, 0.9, 0.2], 2),
        ([0.5, 0.4, 0.3, 0.3, 0.2, 0.9, 0.1], 7),
        ([0.1, 0.1, 0.3, 0.3, 0.2, 0.9, 0.1], 1),
        ([None] * 7, 1),  # without any truth
    ],
)
def test_the_best_threshold_is_the_lowest_of_those_with_the_fewest_wrong_pixels(shares, best):
    """Also of a long run, of which the runs of all others are given up."""
    asked = []

    def alone(number, subgroup):
        asked.append((number, subgroup["coincidence"], subgroup["auto"]))
        return {"wrong_share": shares[subgroup["threshold"] - 1]}

    run = SimpleNamespace(config=parse_config({}), alone=alone)
    assert best_threshold(run) == best
    assert asked == [(-1, True, False)] * 7
    of_thresholds = {1 + k: {"wrong_share": share} for k, share in enumerate(shares)}
    runs = of_thresholds | {"off": {"wrong_share": 0.0}}
    assert take_best(runs, range(1, 8)) == (best, of_thresholds[best])
    assert list(runs) == ["off"]
