# SPDX-License-Identifier: Apache-2.0
"""Depth from events: arrivals, histograms, estimators, pictures."""

import gc
import weakref

import numpy as np
import pytest
from PIL import Image
from scipy.stats import poisson

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.depth import estimate
from coincid.model.depth.arrivals import photons_of
from coincid.model.depth.belief import Reason
from coincid.model.depth.depth import Depth
from coincid.model.depth.estimate import estimate_depth
from coincid.model.depth.histograms import SOURCES, frame_events, subgroup_histograms
from coincid.model.depth.methods import METHODS
from coincid.model.depth.peaks import _poisson_cdf
from coincid.model.depth.pulse_ticks import PulseTicks
from coincid.model.depth.quality import (
    TOLERANCE_M,
    off_surfaces,
    range_error,
    wrong_pixels,
    wrong_share,
)
from coincid.model.light.timing import Timing
from coincid.model.scenes.catalogue import load_scene
from coincid.model.shared.constants import SIGMA_PER_FWHM
from coincid.model.shared.errors import InputError
from coincid.model.shared.threads import Threads
from coincid.study.pictures import Panel, depth_row

from ..told import Told

SIGMA_TICKS = 500e-12 * SIGMA_PER_FWHM / Timing().tick_s
PULSE = PulseTicks(SIGMA_TICKS)


def capture(scene, klux, **others):
    """Return (scene, configuration, result) of one run."""
    run = Run(Setup.of(scene, klux=klux, **others))
    return run.scene, run.config, run.result


def depth_of(result, config, **options):
    return estimate_depth(result, config, **options).depth_m[:, :, 0]


def share(scene, config, result, **options):
    return wrong_share(depth_of(result, config, **options), scene.truth_m)


@pytest.fixture(scope="module")
def five_objects():
    """Return results at 50 klux, with coincidence off and at thresholds 1 to 3."""
    return {
        name: capture("five-objects", 50, subgroup=settings)
        for name, settings in (
            ("off", {"coincidence": False}),
            *((th, {"threshold": th}) for th in (1, 2, 3)),
        )
    }


def test_what_counts_as_wrong():
    truth_m = np.array([[5.0, 5.0, 5.0, 5.0, np.nan]])
    depth_m = np.array([[5.0, 5.034, 5.035, np.nan, 3.0]])
    assert wrong_pixels(depth_m, truth_m).tolist() == [[False, False, True, True, False]]
    assert wrong_share(depth_m, truth_m) == 0.5
    assert pytest.approx(0.0345, abs=1e-4) == TOLERANCE_M


def test_off_surfaces():
    surfaces_m = np.array([[5.0, 7.0], [5.0, np.nan], [5.0, 7.0], [np.nan, np.nan], [5.0, np.nan]])
    off = off_surfaces(np.array([7.0, 5.0, 6.0, 3.0, np.nan]), surfaces_m)
    assert np.flatnonzero(off).tolist() == [2, 4]


def test_range_error():
    some_missing = np.array([5.1, 4.9, np.nan, 7.0]), np.array([5.0, 5.0, 5.0, np.nan])
    assert range_error(*some_missing) == pytest.approx((0.0, 0.1))
    assert range_error(np.array([5.2, 5.0]), np.array([5.0, 5.0])) == pytest.approx(
        (0.1, np.sqrt(0.02))
    )
    assert np.isnan(range_error(np.array([np.nan]), np.array([5.0]))).all()


def test_a_depth_of_an_array_is_believed_from_a_half_on_and_has_numbers_of_its_own():
    """What is done to the array later changes no depth."""
    depth_m, confidence = np.array([[5.0, 6.0, np.nan, 8.0]]), np.array([[0.5, 0.499, 0.9, 1.0]])
    depth = Depth.of(depth_m, confidence)
    depth_m[:], confidence[:] = 3.0, 0.0
    assert np.array_equal(depth.depth_m[:, :, 0], [[5.0, 6.0, np.nan, 8.0]], equal_nan=True)
    assert depth.confidence[:, :, 0].tolist() == [[0.5, 0.499, 0.0, 1.0]]
    few, none, right = Reason.FEW_PHOTONS, Reason.NO_LIGHT, Reason.BELIEVED
    assert depth.reason.tolist() == [[right, few, none, right]]


def test_photons_behind_distinct_pixels():
    assert photons_of(np.arange(4), 64) == pytest.approx([0, 1, 2, 3], rel=0.03)
    assert np.all(np.diff(photons_of(np.arange(65), 64)) > 0) and np.isfinite(photons_of(64, 64))


def test_every_hit_is_in_the_histogram_of_its_pixel():
    _, config, result = capture(
        "five-objects", 50, sensor={"rows": 16, "cols": 32, "subgroup": [4, 8]}
    )
    histograms = list(subgroup_histograms(result, config, PULSE))
    assert len(histograms) == config.sensor.subgroups
    for s, histogram in enumerate(histograms):
        of_subgroup = result["subgroup"] == s
        hits = result["hits"][of_subgroup, 0]
        assert histogram.sum(axis=1).tolist() == [
            int(np.sum(hits >> np.uint64(i) & np.uint64(1))) for i in range(32)
        ]
    everywhere = list(subgroup_histograms(result, config, PULSE, source="subgroup"))
    for s, histogram in enumerate(everywhere):
        assert np.all(histogram == histogram[0]) and histogram[0].sum() == np.sum(
            result["subgroup"] == s
        )


@pytest.fixture(scope="module")
def steps():
    """Return a run of a subgroup of 256 pixels that sees a step each 64 of them."""
    distance_m = np.repeat([4.0, 5.0, 6.0, 7.0], 4)[:, None] * np.ones((16, 16))
    return Run(
        Setup.of(
            load_scene(distance_m, 16, 16),
            klux=1.0,
            sensor={"rows": 16, "cols": 16, "subgroup": [16, 16]},
            frame={"pulses": 60, "format": "full"},
            subgroup={"threshold": 2},
        )
    )


@pytest.mark.parametrize("method", ["maximum", "matched/minigroup", "planes"])
def test_pixels_of_every_word_of_a_map_have_their_own_distance(method, steps):
    """And they are believed, because the hits are their own, too."""
    depth = steps.depth(method)
    off_m = np.abs(depth.depth_m[:, :, 0] - steps.scene.truth_m)
    believed = depth.reason == Reason.BELIEVED
    for word in range(4):
        rows = slice(4 * word, 4 * word + 4)
        assert np.mean(off_m[rows] < 0.1) > 0.95, word
        assert believed[rows].mean() > 0.9, word


@pytest.mark.parametrize(
    "frame", [{"format": "full"}, {"minigroup_records": True, "mg_threshold": 1, "mg_window": 1}]
)
def test_minigroups_tell_surfaces_apart_that_share_a_window(frame):
    captured = capture("two-targets:5,5.1", 5, frame=frame)
    by_minigroup, by_map = (
        share(*captured, method="matched", source=source) for source in ("minigroup", "map")
    )
    assert by_minigroup < 0.2 < by_map


@pytest.mark.parametrize("distance_m", (6.27, 9.27))
def test_background_with_offsets_has_the_distance_of_matched(distance_m):
    """Hits of an open window come whether the tree is armed or not."""
    setup = Setup.of(
        f"flat:{distance_m},0.3",
        klux=10.0,
        sensor={"rows": 16, "cols": 16},
        frame={"pulses": 300, "format": "full"},
    )
    run = Run(setup)
    for method in ("matched", "background"):
        off_m = run.depth(method, source="minigroup").depth_m - distance_m
        assert abs(np.median(off_m)) < 0.006, method


@pytest.mark.parametrize("method", ("matched", "background"))
@pytest.mark.parametrize("gate_len", (15, 40))
def test_background_in_a_gate_is_hardly_a_further_return(method, gate_len):
    """It is denser there than over the whole period."""
    further = []
    for seed in (1, 2, 3):
        setup = Setup.of(
            "flat:9,0.3",
            klux=80.0,
            sensor={"rows": 16, "cols": 16},
            frame={"pulses": 200},
            subgroup={"threshold": 1, "gating": True, "gate_start": 22, "gate_len": gate_len},
            seed=seed,
        )
        depth = Run(setup).depth(method, returns=2)
        further.append(np.mean(~np.isnan(depth.depth_m[:, :, 1])))
    assert np.mean(further) < 0.02


def test_estimators_rank_as_they_should(five_objects):
    planes = {name: share(*run) for name, run in five_objects.items()}
    assert planes[2] < 0.005 and planes[3] < 0.03 and planes["off"] < 0.15
    for name, run in five_objects.items():
        maximum, matched, background = (
            share(*run, method=method) for method in ("maximum", "matched", "background")
        )
        assert planes[name] < background < 1.1 * matched < 1.1 * maximum, name
    assert share(*five_objects[1], method="background") < 0.8 * share(
        *five_objects[1], method="matched"
    )
    assert share(*five_objects[2], method="matched") < share(
        *five_objects[2], method="matched", source="subgroup"
    )
    assert (
        share(*five_objects["off"], method="matched")
        > 0.5
        > 10 * share(*five_objects[3], method="planes")
    )


def test_two_returns_of_one_pixel():
    scene, config, result = capture("two-returns:5,9", 20)
    for method in ("planes", "background"):
        depth = estimate_depth(result, config, method=method, returns=2)
        for target in range(2):
            nearest = np.nanmin(np.abs(depth.depth_m - scene.distance_m[0, 0, target]), axis=2)
            assert np.mean(nearest < TOLERANCE_M) > 0.9
    flat = capture("flat:5,0.4", 20)[2]
    alone = estimate_depth(flat, config, returns=3)
    assert alone.depth_m.shape == (32, 32, 3) and np.isnan(alone.depth_m[:, :, 1:]).all()
    for method in ("matched", "background"):  # a single hit of background is no return
        assert (
            np.isnan(estimate_depth(flat, config, method=method, returns=2).depth_m[:, :, 1]).mean()
            > 0.95
        )


@pytest.mark.parametrize("mean", (1e-3, 0.4, 7.0))
def test_accidents_are_as_frequent_as_poissons_law_says(mean):
    """The chance of at most so many hits, from which the confidence of further returns follows."""
    cdf = getattr(_poisson_cdf, "py_func", _poisson_cdf)  # as it is where nothing is compiled
    for count in range(12):
        assert cdf(float(count), mean) == pytest.approx(poisson.cdf(count, mean), rel=1e-12)


def test_frames_are_told_apart():
    scene, config, result = capture("flat:10,0.3", 5, frame={"frames": 2, "pulses": 50})
    first, second = (depth_of(result, config, frame=frame) for frame in range(2))
    assert not np.array_equal(first, second)
    assert wrong_share(first, scene.truth_m) == wrong_share(second, scene.truth_m) == 0
    with pytest.raises(InputError, match="from 0 to 1"):
        depth_of(result, config, frame=2)


@pytest.mark.parametrize(
    ("method", "parts"), [("planes", 2), ("background", 2), (Told(5.0), 1)], ids=str
)
def test_every_part_of_an_estimate_has_its_threads(method, parts, monkeypatch):
    """One that forgets them gives the same, later: surfaces, and their light."""
    told = []
    monkeypatch.setattr(
        estimate, "Threads", lambda workers: told.append(workers) or Threads(workers)
    )
    _, config, result = capture("flat:5", 5, sensor={"rows": 8, "cols": 8}, frame={"pulses": 20})
    for workers in (3, None):
        depth = estimate_depth(result, config, method=method, workers=workers)
        assert depth.signal_per_pulse is not None
    assert told == [3] * parts + [None] * parts


@pytest.mark.parametrize("method", METHODS)
def test_a_depth_with_its_light_keeps_no_events(method, monkeypatch):
    """Those of a long run do not fit into memory beside those of its next frame."""
    stamps = []

    def noted(*given):
        events = frame_events(*given)
        stamps.append(weakref.ref(events.stamp))
        return events

    monkeypatch.setattr(estimate, "frame_events", noted)
    _, config, result = capture("flat:5", 5, sensor={"rows": 8, "cols": 8}, frame={"pulses": 20})
    depth = estimate_depth(result, config, method=method).with_light()
    gc.collect()
    assert [stamp() for stamp in stamps] == [None]
    assert np.isfinite(depth.signal_per_pulse).any()


def test_bad_input(five_objects):
    _, config, result = five_objects[2]
    for options, words in (
        ({"method": "magic"}, "maximum, matched, background, planes"),
        ({"source": "pixel", "method": "matched"}, "map, minigroup, subgroup"),
        ({"returns": 0}, "from 1 to 8"),
        ({"system_fwhm_s": 0}, "system_fwhm_s"),
        ({"source": "minigroup", "method": "matched"}, "format full or minigroup_records"),
    ):
        with pytest.raises(InputError, match=words):
            depth_of(result, config, **options)
    with pytest.raises(InputError, match="format must be id or full"):
        depth_of(
            {name: array for name, array in result.items() if name != "hits"},
            config,
            method="matched",
        )
    assert set(SOURCES) == {"map", "minigroup", "subgroup"}


def test_picture_of_a_row(tmp_path, five_objects):
    scene, config, result = five_objects[2]
    truth_m = scene.truth_m.copy()
    truth_m[:2, :2] = np.nan
    panels = [
        Panel("planes", depth_of(result, config)),
        Panel("maximum", depth_of(result, config, method="maximum")),
    ]
    shares = depth_row(tmp_path / "a.png", panels, truth_m, "five objects")
    assert shares == [wrong_share(panel.depth_m, truth_m) for panel in panels]
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.width > 2 * picture.height and not picture.text
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match="cannot be written"):
        depth_row(tmp_path / "file" / "c.png", panels, truth_m)


@pytest.mark.parametrize(
    ("further_m", "line"),
    [
        (None, "<Depth: 2 x 3 pixels, 1 return, 4 to 6 m, 50% to be believed>"),
        (9.0, "<Depth: 2 x 3 pixels, 2 returns, 4 to 6 m, 50% to be believed>"),
    ],
)
def test_one_line_tells_of_the_first_returns(further_m, line):
    """Also where further ones are beyond them, and some pixels have no distance."""
    first_m = np.array([[4.0, 5.0, np.nan], [5.5, 6.0, 5.0]])
    sure = np.array([[1.0, 1.0, 1.0], [0.0, 1.0, 0.0]])
    if further_m is None:
        assert repr(Depth.of(first_m, sure)) == line
        return
    both_m = np.stack([first_m, np.full(first_m.shape, further_m)], axis=2)
    assert repr(Depth.of(both_m, sure)) == line


def test_one_line_tells_that_there_is_no_distance():
    assert repr(Depth.of(np.full((2, 3), np.nan))) == "<Depth: 2 x 3 pixels, 1 return, no distance>"
