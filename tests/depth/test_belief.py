# SPDX-License-Identifier: Apache-2.0
"""Why a depth is not to be believed, and confidence that means what it says."""

import numpy as np
import pytest

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.depth.belief import (
    LAW,
    NOISE_M,
    SENTENCES,
    Lit,
    Reason,
    Signs,
    _folded,
    believe,
    find_signs,
)
from coincid.model.depth.histograms import frame_events
from coincid.model.depth.methods import METHODS
from coincid.model.depth.pulse_ticks import PulseTicks
from coincid.model.depth.quality import TOLERANCE_M
from coincid.model.scenes.scene import Scene
from coincid.model.shared.constants import SPEED_OF_LIGHT_M_S
from coincid.model.shared.threads import Threads
from docs.studies.confidence import (
    NINETY,
    perspective_setup,
    random_setup,
    scene_in_perspective,
    truth_m,
)

SENSOR = {"rows": 16, "cols": 16}
OFF = {"coincidence": False}
SLOPE = 4  # of the features that the law weighs
CYCLE_M = 2e-9 * SPEED_OF_LIGHT_M_S / 2
BEYOND = Scene(
    name="a wall, and one beyond the range", distance_m=np.where(np.arange(16) < 4, 80.0, np.full((16, 16), 6.0)),
    reflectivity=np.full((16, 16), 0.4),
)  # fmt: skip
CASES = {  # reason: scene, klux, frame, subgroup, columns where it holds
    Reason.BELIEVED: ("flat:5,0.4", 10, {}, {}, slice(None)),
    Reason.NO_LIGHT: ("flat:5,0", 0, {}, {}, slice(None)),
    Reason.BACKGROUND: ("flat:70,0.4", 50, {}, {"threshold": 1}, slice(None)),
    Reason.TWO_SURFACES: ("returns:6@0.3,9.37@0.675", 1, {"pulses": 200}, {}, slice(None)),
    Reason.FOLDED: (BEYOND, 1, {"pulses": 6000}, OFF, slice(4)),
    Reason.GATE_EDGE: (
        f"flat:{20 * CYCLE_M:g},0.4", 10, {}, {"gating": True, "gate_start": 20, "gate_len": 40}, slice(None)
    ),
    Reason.EVENTS_LOST: ("flat:20,0.1", 100, {"link_gbps": 0.5}, {"threshold": 1}, slice(None)),
}  # fmt: skip


@pytest.mark.parametrize("reason", CASES)
def test_most_pixels_have_the_reason(reason):
    scene, klux, frame, subgroup, where = CASES[reason]
    run = Run(Setup.of(scene, klux=klux, sensor=SENSOR, frame=frame, subgroup=subgroup))
    found = run.depth("background").reason[:, where]
    assert np.mean(found == reason) > 0.5, {
        SENTENCES[Reason(k)]: int(np.sum(found == k)) for k in np.unique(found)
    }


def test_of_several_reasons_the_one_that_explains_more_is_told():
    """Pixel k has the first k signs: each outweighs those before it."""
    reasons = [
        Reason.FEW_PHOTONS,
        Reason.BACKGROUND,
        Reason.NO_LIGHT,
        Reason.EVENTS_LOST,
        Reason.TWO_SURFACES,
        Reason.FOLDED,
        Reason.GATE_EDGE,
    ]
    pixel = np.arange(len(reasons))[None]
    signs = Signs(
        known=np.zeros(pixel.shape, bool),
        features=np.zeros((*pixel.shape, len(LAW["planes"]) - 1)),
        evidence=np.where(pixel >= 1, 0.0, 100.0),
        total=np.where(pixel >= 2, 0, 9),
        lost=np.where(pixel >= 3, 0.9, 0.0),
        near=np.full(pixel.shape, 9),
        other=np.where(pixel >= 4, 9, 0),
        elsewhere=np.where(pixel >= 4, 100.0, 0.0),
        folded=pixel >= 5,
        at_edge=pixel >= 6,
        seen=np.ones(pixel.shape),
    )
    assert believe(signs, "planes")[1][0].tolist() == reasons


def test_the_gates_edges_are_those_of_its_first_and_its_last_place():
    """A wall is beside no edge where the gate would be after one more step."""
    moving = {"gate_every": 50, "gate_step": 10, "gate_steps": 3, "pulses": 150}
    gate = {"gating": True, "gate_start": 10, "gate_len": 30}
    dark = Run(Setup.of("flat:5,0", klux=0, sensor=SENSOR, frame=moving, subgroup=gate))
    events = frame_events(dark.result, dark.config, PulseTicks(2.0))
    for cycle, is_edge in ((10, True), (60, True), (50, False), (70, False), (30, False)):
        ticks = np.full((16, 16), float(cycle * dark.config.sensor.phases))
        with Threads(1) as threads:
            signs = find_signs(events, dark.config, 2.0, 150, ticks, ticks, False, threads)
        assert np.all(signs.at_edge == is_edge), cycle


def test_places_that_a_gate_does_not_reach_in_a_frame_have_no_edge():
    moving = {"gate_every": 50, "gate_step": 10, "gate_steps": 8, "pulses": 120}
    gate = {"gating": True, "gate_start": 10, "gate_len": 30}
    dark = Run(Setup.of("flat:5,0", klux=0, sensor=SENSOR, frame=moving, subgroup=gate))
    events = frame_events(dark.result, dark.config, PulseTicks(2.0))
    for cycle, is_edge in ((60, True), (110, False)):
        ticks = np.full((16, 16), float(cycle * dark.config.sensor.phases))
        with Threads(1) as threads:
            signs = find_signs(events, dark.config, 2.0, 120, ticks, ticks, False, threads)
        assert np.all(signs.at_edge == is_edge), cycle


@pytest.mark.parametrize(
    ("ticks", "hits", "is_folded"),
    [
        (1000.0, 3, True),
        (3000.0, 3, True),
        (3500.0, 3, False),  # a dark pixel that may be there
        (1000.0, 30, True),
        (1500.0, 30, False),
        (1000.0, 0, False),
        (np.nan, 3, False),
    ],
)
def test_light_falls_with_the_square_of_the_distance_unless_it_comes_from_beyond_the_range(
    ticks, hits, is_folded
):
    """A pixel of a wall at 4000 ticks, from which all others have 200 hits in 1000 pulses."""
    pulses = 1000
    near = np.full((2, 16), 200)
    time = np.full(near.shape, 4000.0)
    near[1, 3], time[1, 3] = hits, ticks
    found = _folded(Lit(near, near / pulses, pulses), time)
    assert found[1, 3] == is_folded
    assert found.sum() == is_folded


@pytest.mark.parametrize("subgroup", [(4, 8), (8, 4)])
@pytest.mark.parametrize("axis", (0, 1))
def test_the_slope_is_that_from_subgroup_to_subgroup(subgroup, axis):
    """Rows of subgroups are as far apart as a subgroup is high, columns as it is wide."""
    sensor = {"rows": 32, "cols": 32, "subgroup": list(subgroup)}
    dark = Run(Setup.of("flat:5,0", klux=0, sensor=sensor, frame={"pulses": 2}))
    events = frame_events(dark.result, dark.config, PulseTicks(2.0))
    step_m = 0.02
    ticks = 5 / dark.config.tick_m + np.indices((32, 32))[axis] * step_m / dark.config.tick_m
    with Threads(1) as threads:
        signs = find_signs(events, dark.config, 2.0, 2, ticks, np.ones((32, 32)), False, threads)
    slope_m = np.exp(signs.features[:, :, SLOPE]) - NOISE_M
    assert slope_m == pytest.approx(subgroup[axis] * step_m, rel=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_ninety_per_cent_are_ninety_per_cent(method):
    """In rooms that were not used to set the law."""
    sure, right = [], []
    for seed in range(1001, 1009):
        run = Run(random_setup(seed))
        depth = run.depth(method, frame=run.config.frames - 1)
        sure.append(depth.confidence[:, :, 0].ravel())
        right.append(np.abs(depth.depth_m[:, :, 0] - truth_m(run.scene)).ravel() <= TOLERANCE_M)
    sure, right = np.concatenate(sure), np.concatenate(right)
    ninety = (sure >= NINETY[0]) & (sure < NINETY[1])
    limit = 0.05 if method == "planes" else 0.12  # peaks know nothing of slants
    assert abs(right.mean() - sure.mean()) < limit
    share = right[ninety].mean()
    noise = np.sqrt(share * (1 - share) / ninety.sum())  # of the few pixels that are as sure
    assert abs(share - sure[ninety].mean()) < limit + noise


def test_confidence_holds_at_a_threshold_that_costs_most_events():
    """In rooms in perspective, that were not used to set the law either."""
    sure, right = [], []
    for seed in range(3):
        run = Run(perspective_setup(seed, threshold=3, pulses=100))
        depth = run.depth("planes")
        sure.append(depth.confidence[:, :, 0])
        right.append(np.abs(depth.depth_m[:, :, 0] - run.scene.truth_m) <= TOLERANCE_M)
    assert abs(np.mean(right) - np.mean(sure)) < 0.07


def test_a_file_says_why(tmp_path):
    depth = Run(Setup.of("flat:5,0", klux=0, sensor=SENSOR)).depth()
    depth.save(tmp_path / "depth.npz")
    with np.load(tmp_path / "depth.npz") as kept:
        assert np.array_equal(kept["reason"], depth.reason) and np.isnan(kept["depth_m"]).all()
        assert kept["sentences"][kept["reason"][0, 0]] == SENTENCES[Reason.NO_LIGHT]


@pytest.mark.parametrize("larger", [1 / 3, 1.0])
def test_standard_errors_hold_in_rooms(larger):
    """Of the right pixels, in rooms in perspective: near and bright ones, and larger ones."""
    errors = []
    for seed in (100, 101, 102):
        setup = Setup.of(
            scene_in_perspective(seed, larger),
            sensor={"rows": 32, "cols": 32},
            frame={"pulses": 300, "link_gbps": 0},
            subgroup={"threshold": 2},
            klux=50.0,
            seed=seed,
        )
        run = Run(setup)
        depth = run.depth("planes")
        off_m = np.abs(depth.depth_m[:, :, 0] - run.scene.truth_m)
        errors.append((off_m / depth.error_m[:, :, 0])[off_m < TOLERANCE_M])
    errors = np.concatenate(errors)
    assert 0.63 < np.mean(errors < 1) < 0.83
    assert 0.9 < np.mean(errors < 2)
